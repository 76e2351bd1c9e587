//! Navigation: what becomes of fixes.

pub mod ins_feedback;
