//! Navigation with fields: filters that carry a position on.

pub mod field_navigator;
pub mod sensing;
