//! A linear Kalman filter of errors, with a gate on its innovations.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::estimate::{Estimate, check_max_nis, noise_factor};
use crate::error::{Error, Result, require_finite};

/// A linear Kalman filter whose measurements must first pass a test.
///
/// The state is an error, kept small by feeding it back; nothing here knows what kind. Mean and covariance are those of every other
/// filter: an [`Estimate`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorStateFilter {
    estimate: Estimate,
}

/// What became of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Update {
    /// Normalised innovation squared: chi-square with as many degrees of freedom as the measurement has elements.
    pub nis: f64,
    /// Whether it passed the gate and was used.
    pub accepted: bool,
}

impl ErrorStateFilter {
    /// A filter from its first state and covariance, which may be singular.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::NotPositiveDefinite`] for a covariance that is none.
    pub fn new(state: DVector<f64>, covariance: &DMatrix<f64>) -> Result<Self> {
        require_finite("state", state.as_slice())?;
        square("covariance", covariance, state.len())?;
        Ok(Self { estimate: Estimate::known(state, covariance)? })
    }

    /// Refuses contents that no filter of `n` states can have.
    pub(crate) fn check(&self, n: usize) -> Result<()> {
        if self.estimate.len() != n {
            return Err(Error::shape("state", format!("({n},)"), format!("({},)", self.estimate.len())));
        }
        self.estimate.check()
    }

    /// The estimated error.
    pub fn state(&self) -> &[f64] {
        self.estimate.mean()
    }

    /// Its covariance.
    pub fn covariance(&self) -> DMatrix<f64> {
        self.estimate.covariance()
    }

    /// x <- F x, P <- F P F' + Q.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::NotPositiveDefinite`] for a noise that is no covariance.
    pub fn predict(&mut self, transition: &DMatrix<f64>, noise: &DMatrix<f64>) -> Result<()> {
        let n = self.estimate.len();
        square("transition", transition, n)?;
        square("process noise", noise, n)?;
        require_finite("transition", transition.as_slice())?;
        let noise = noise_factor("process noise", n, noise.as_slice())?;
        let moved = transition * DVector::from_column_slice(self.estimate.mean());
        self.estimate.move_linear(moved, transition, &noise)
    }

    /// Takes the measurement z = H x + v, cov v = R, if its normalised innovation squared is at most `max_nis`.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Invalid`] (`max_nis`), [`Error::NotPositiveDefinite`] for an innovation
    /// covariance that is not.
    pub fn update(
        &mut self,
        measurement: &DVector<f64>,
        matrix: &DMatrix<f64>,
        noise: &DMatrix<f64>,
        max_nis: f64,
    ) -> Result<Update> {
        let (n, m) = (self.estimate.len(), measurement.len());
        if matrix.shape() != (m, n) {
            return Err(Error::shape("measurement matrix", format!("({m}, {n})"), format!("{:?}", matrix.shape())));
        }
        square("measurement noise", noise, m)?;
        require_finite("measurement", measurement.as_slice())?;
        check_max_nis(Some(max_nis))?;
        let noise = noise_factor("measurement noise", m, noise.as_slice())?;
        let residual = measurement - matrix * DVector::from_column_slice(self.estimate.mean());
        let innovation = self.estimate.correct_linear(residual, matrix, &noise, Some(max_nis))?;
        Ok(Update { nis: innovation.nis, accepted: innovation.accepted })
    }
}

fn square(what: &str, matrix: &DMatrix<f64>, n: usize) -> Result<()> {
    if matrix.shape() == (n, n) {
        Ok(())
    } else {
        Err(Error::shape(what, format!("({n}, {n})"), format!("{:?}", matrix.shape())))
    }
}
