//! Kalman filters that know vectors, not fields.

pub mod error_state;
