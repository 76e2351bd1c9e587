//! A linear Kalman filter of errors, with a gate on its innovations.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::estimate::check_gate;
use crate::error::{Error, Result, require_finite};

/// A linear Kalman filter whose measurements must first pass a test.
///
/// The state is an error, kept small by feeding it back; nothing here knows what kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorStateFilter {
    state: DVector<f64>,
    covariance: DMatrix<f64>,
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
    /// A filter from its first state and covariance.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::NotPositiveDefinite`] for a covariance with a negative variance.
    pub fn new(state: DVector<f64>, covariance: DMatrix<f64>) -> Result<Self> {
        let n = state.len();
        square("covariance", &covariance, n)?;
        require_finite("state", state.as_slice())?;
        require_finite("covariance", covariance.as_slice())?;
        if let Some(i) = (0..n).find(|&i| covariance[(i, i)] < 0.0) {
            return Err(Error::NotPositiveDefinite {
                what: "covariance".into(),
                detail: format!("variance {i} is {}", covariance[(i, i)]),
            });
        }
        Ok(Self { state, covariance })
    }

    /// Refuses contents that no filter of `n` states can have.
    pub(crate) fn check(&self, n: usize) -> Result<()> {
        if self.state.len() != n {
            return Err(Error::shape("state", format!("({n},)"), format!("({},)", self.state.len())));
        }
        square("covariance", &self.covariance, n)?;
        Self::new(self.state.clone(), self.covariance.clone()).map(drop)
    }

    /// The estimated error.
    pub fn state(&self) -> &DVector<f64> {
        &self.state
    }

    /// Its covariance.
    pub fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }

    /// x <- F x, P <- F P F' + Q.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`].
    pub fn predict(&mut self, transition: &DMatrix<f64>, noise: &DMatrix<f64>) -> Result<()> {
        let n = self.state.len();
        square("transition", transition, n)?;
        square("process noise", noise, n)?;
        require_finite("transition", transition.as_slice())?;
        require_finite("process noise", noise.as_slice())?;
        self.state = transition * &self.state;
        self.covariance = symmetric(&(transition * &self.covariance * transition.transpose() + noise));
        Ok(())
    }

    /// Takes the measurement z = H x + v, cov v = R, if its normalised innovation squared is at most `gate`.
    ///
    /// The covariance is updated in Joseph's form, P <- (I - K H) P (I - K H)' + K R K', which stays positive
    /// (Groves, eq. 3.58).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Invalid`] (gate), [`Error::NotPositiveDefinite`] for an innovation
    /// covariance that is not.
    pub fn update(
        &mut self,
        measurement: &DVector<f64>,
        matrix: &DMatrix<f64>,
        noise: &DMatrix<f64>,
        gate: f64,
    ) -> Result<Update> {
        let (n, m) = (self.state.len(), measurement.len());
        if matrix.shape() != (m, n) {
            return Err(Error::shape("measurement matrix", format!("({m}, {n})"), format!("{:?}", matrix.shape())));
        }
        square("measurement noise", noise, m)?;
        require_finite("measurement", measurement.as_slice())?;
        check_gate(Some(gate))?;
        require_finite("measurement noise", noise.as_slice())?;
        let innovation = measurement - matrix * &self.state;
        let spread = symmetric(&(matrix * &self.covariance * matrix.transpose() + noise));
        let factor = spread.cholesky().ok_or_else(|| Error::NotPositiveDefinite {
            what: "innovation covariance".into(),
            detail: "H P H' + R has no Cholesky factor".into(),
        })?;
        let nis = innovation.dot(&factor.solve(&innovation));
        if nis.is_nan() || nis > gate {
            return Ok(Update { nis, accepted: false });
        }
        // K' = S^-1 H P.
        let gain = factor.solve(&(matrix * &self.covariance)).transpose();
        self.state += &gain * innovation;
        let left = DMatrix::identity(n, n) - &gain * matrix;
        self.covariance = symmetric(&(&left * &self.covariance * left.transpose() + &gain * noise * gain.transpose()));
        Ok(Update { nis, accepted: true })
    }
}

fn square(what: &str, matrix: &DMatrix<f64>, n: usize) -> Result<()> {
    if matrix.shape() == (n, n) {
        Ok(())
    } else {
        Err(Error::shape(what, format!("({n}, {n})"), format!("{:?}", matrix.shape())))
    }
}

fn symmetric(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    0.5 * (matrix + matrix.transpose())
}
