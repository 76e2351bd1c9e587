//! The extended Kalman filter in square-root form.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::estimate::{Estimate, Innovation, check_max_nis, noise_factor};
use crate::error::{Error, Result, require_finite};
use crate::state::Saved;

/// An extended Kalman filter: the caller gives predicted values and their Jacobians.
///
/// Cheaper than the unscented filter where gradients are known, and as good where the field is straight within the
/// position error. On linear models it is the Kalman filter.
///
/// ```
/// use geomag_core::kalman::ExtendedKalmanFilter;
/// let mut filter = ExtendedKalmanFilter::new(&[0.0], &[1.0])?;
/// filter.predict(&[0.5], &[1.0], &[1.0])?;
/// filter.update(&[2.5], &[0.5], &[1.0], &[2.0], None)?;
/// assert!((filter.estimate().mean()[0] - 1.5).abs() < 1e-12);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExtendedKalmanFilter {
    estimate: Estimate,
    innovation: Option<Innovation>,
}

impl Saved for ExtendedKalmanFilter {
    const NAME: &'static str = "ExtendedKalmanFilter";

    fn check(&self) -> Result<()> {
        self.estimate.check()?;
        self.innovation.as_ref().map_or(Ok(()), |i| i.check(self.estimate.len()))
    }
}

impl ExtendedKalmanFilter {
    /// From a mean of n numbers and a covariance (row-major, n x n).
    ///
    /// # Errors
    /// As [`Estimate::new`].
    pub fn new(mean: &[f64], covariance: &[f64]) -> Result<Self> {
        Ok(Self { estimate: Estimate::new(mean, covariance)?, innovation: None })
    }

    /// Mean and covariance.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    pub(crate) fn from_estimate(estimate: Estimate) -> Self {
        Self { estimate, innovation: None }
    }

    pub(crate) fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }

    /// Replaces mean and covariance.
    ///
    /// # Errors
    /// As [`Estimate::new`]; [`Error::Shape`] for another number of states.
    pub fn set(&mut self, mean: &[f64], covariance: &[f64]) -> Result<()> {
        self.estimate.set(mean, covariance)
    }

    /// The newest innovation; `None` before the first update.
    pub fn innovation(&self) -> Option<&Innovation> {
        self.innovation.as_ref()
    }

    /// Moves the state to `state = f(x)` with the Jacobian of `f` and process noise `q` (row-major, n x n).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::NotPositiveDefinite`]; the filter is then left as it was.
    pub fn predict(&mut self, state: &[f64], jacobian: &[f64], q: &[f64]) -> Result<()> {
        let n = self.estimate.len();
        if state.len() != n {
            return Err(Error::shape("predicted state", format!("({n},)"), format!("({},)", state.len())));
        }
        let jacobian = rectangle("Jacobian of the motion", n, n, jacobian)?;
        let noise = noise_factor("process noise Q", n, q)?;
        self.estimate.move_linear(DVector::from_column_slice(state), &jacobian, &noise)
    }

    /// Takes in a measurement `z` expected to be `expected = h(x)` with the Jacobian of `h` (row-major, m x n) and noise
    /// covariance `r` (row-major, m x m). With a `max_nis`, a measurement whose NIS exceeds it changes nothing.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Invalid`] (`max_nis`), [`Error::NotPositiveDefinite`]; the filter is
    /// then left as it was.
    pub fn update(
        &mut self,
        z: &[f64],
        expected: &[f64],
        jacobian: &[f64],
        r: &[f64],
        max_nis: Option<f64>,
    ) -> Result<&Innovation> {
        let (n, m) = (self.estimate.len(), z.len());
        if m == 0 || expected.len() != m {
            return Err(Error::shape(
                "expected measurement",
                format!("({},)", m.max(1)),
                format!("({},)", expected.len()),
            ));
        }
        require_finite("measurement z", z)?;
        check_max_nis(max_nis)?;
        let jacobian = rectangle("Jacobian of the measurement", m, n, jacobian)?;
        let noise = noise_factor("measurement noise R", m, r)?;
        let residual = DVector::from_iterator(m, z.iter().zip(expected).map(|(z, e)| z - e));
        let innovation = self.estimate.correct_linear(residual, &jacobian, &noise, max_nis)?;
        Ok(self.innovation.insert(innovation))
    }
}

fn rectangle(what: &str, rows: usize, columns: usize, values: &[f64]) -> Result<DMatrix<f64>> {
    if values.len() != rows * columns {
        return Err(Error::shape(what, format!("({rows}, {columns})"), format!("{} numbers", values.len())));
    }
    require_finite(what, values)?;
    Ok(DMatrix::from_row_slice(rows, columns, values))
}
