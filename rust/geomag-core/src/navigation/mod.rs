//! Navigation with fields: filters that carry a position on, and what becomes of fixes.

pub mod field_navigator;
pub mod ins_feedback;
pub mod navigator;
pub mod sensing;
