//! Kalman filters for any state and any measurement: vectors, not magnetism.
//!
//! The unscented and the extended filter carry the Cholesky factor of their covariance and turn it by orthogonal
//! transformations, so that the covariance is symmetric positive definite by construction (Kaminski, Bryson & Schmidt
//! 1971; Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems*, sect. 3.2.8).

pub mod error_state;
mod estimate;
mod extended;
pub(crate) mod regression;
mod unscented;

pub(crate) use estimate::square as symmetric;
pub use estimate::{Estimate, Innovation};
pub use extended::ExtendedKalmanFilter;
pub use unscented::{Scaling, UnscentedKalmanFilter};

pub use crate::statistics::{chi_square_cdf, chi_square_quantile};

/// Greatest number of states, and of numbers in a measurement: a square matrix of them takes 128 MiB.
pub const MAX_STATES: usize = 4096;

#[cfg(test)]
mod tests;
