//! The scaled unscented Kalman filter in square-root form.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::estimate::{Estimate, Innovation, check_max_nis, noise_factor, outer};
use crate::error::{Error, Result, require_finite, require_positive};
use crate::state::Saved;

/// What is asked of sigma points, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! scaling_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            scaling [
                (alpha: number = 1.0; "float";
                    "Spread: sigma points lie `alpha sqrt(n + kappa)` standard deviations away. 1 for fields that bend within the position"
                    "error; 1e-3, which is often seen, samples the slope at one point and loses the track in steep fields.")
                (beta: number = 2.0; "float";
                    "Weight of the centre; 2 is best for normal states.")
                (kappa: number = 0.0; "float";
                    "Usually 0, or 3 - n.")
            ]
        }
    };
}

scaling_options!(record {
    /// How far the sigma points lie from the mean and how the centre is weighted (Julier 2002; Wan & van der Merwe 2000).
    Scaling
});

impl Scaling {
    pub(crate) fn validate(self, states: usize) -> Result<Self> {
        require_positive("alpha", self.alpha)?;
        require_finite("beta, kappa", &[self.beta, self.kappa])?;
        require_positive("n + kappa", states as f64 + self.kappa)?;
        Ok(self)
    }

    /// `n + lambda`.
    fn spread(self, states: usize) -> f64 {
        self.alpha * self.alpha * (states as f64 + self.kappa)
    }
}

/// An unscented Kalman filter for any motion and any measurement.
///
/// With `d_i` the propagated sigma points less the propagated centre and `m = sum W_i d_i`, the textbook covariance
/// `sum W_i (d_i - m)(d_i - m)' + W0c m m'` is `sum W_i d_i d_i' + (beta - alpha^2) m m'`: for `beta >= alpha^2` a sum of
/// squares, whatever `alpha`. Its factor comes from one orthogonal transformation, as does that of the corrected
/// covariance; nothing is subtracted and the covariance stays positive definite. Other weights take the textbook form.
/// Sigma points are drawn anew for every call.
///
/// ```
/// use geomag_core::kalman::{Scaling, UnscentedKalmanFilter};
/// use geomag_core::error::Error;
/// let mut filter = UnscentedKalmanFilter::new(&[0.0, 1.0], &[4.0, 0.0, 0.0, 1.0], Scaling::default())?;
/// filter.predict(|x, out| { out[0] = x[0] + x[1]; out[1] = x[1]; Ok::<_, Error>(()) }, &[0.1, 0.0, 0.0, 0.1])?;
/// let innovation = filter.update(&[1.5], |x, out| { out[0] = x[0]; Ok::<_, Error>(()) }, &[0.5], None)?;
/// assert!((innovation.covariance[(0, 0)] - 5.6).abs() < 1e-12);
/// # Ok::<(), Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UnscentedKalmanFilter {
    estimate: Estimate,
    scaling: Scaling,
    innovation: Option<Innovation>,
}

impl Saved for UnscentedKalmanFilter {
    const NAME: &'static str = "UnscentedKalmanFilter";

    fn check(&self) -> Result<()> {
        self.estimate.check()?;
        self.scaling.validate(self.estimate.len())?;
        self.innovation.as_ref().map_or(Ok(()), |i| i.check(self.estimate.len()))
    }
}

impl UnscentedKalmanFilter {
    /// From a mean of n numbers, a covariance (row-major, n x n) and the scaling.
    ///
    /// # Errors
    /// As [`Estimate::new`]; [`Error::Invalid`] for a scaling without spread.
    pub fn new(mean: &[f64], covariance: &[f64], scaling: Scaling) -> Result<Self> {
        Self::from_estimate(Estimate::new(mean, covariance)?, scaling)
    }

    /// From an estimate.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a scaling without spread.
    pub fn from_estimate(estimate: Estimate, scaling: Scaling) -> Result<Self> {
        scaling.validate(estimate.len())?;
        Ok(Self { estimate, scaling, innovation: None })
    }

    /// Mean and covariance.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    pub(crate) fn estimate_mut(&mut self) -> &mut Estimate {
        &mut self.estimate
    }

    /// The scaling.
    pub fn scaling(&self) -> Scaling {
        self.scaling
    }

    /// The newest innovation; `None` before the first update.
    pub fn innovation(&self) -> Option<&Innovation> {
        self.innovation.as_ref()
    }

    /// Replaces mean and covariance.
    ///
    /// # Errors
    /// As [`Estimate::new`]; [`Error::Shape`] for another number of states.
    pub fn set(&mut self, mean: &[f64], covariance: &[f64]) -> Result<()> {
        self.estimate.set(mean, covariance)
    }

    /// The 2n + 1 sigma points, one a column: the mean, then plus, then minus the columns of the scaled factor.
    pub fn sigma_points(&self) -> DMatrix<f64> {
        let n = self.estimate.len();
        let c = self.scaling.spread(n).sqrt();
        DMatrix::from_fn(n, 2 * n + 1, |i, k| {
            let away = match k {
                0 => 0.0,
                k if k <= n => c * self.estimate.factor[(i, k - 1)],
                k => -c * self.estimate.factor[(i, k - 1 - n)],
            };
            self.estimate.mean[i] + away
        })
    }

    /// Moves the state on by `f(state, out)` with process noise `q` (row-major, n x n, may be singular).
    ///
    /// # Errors
    /// Those of `f`; [`Error::Shape`], [`Error::NotFinite`], [`Error::NotPositiveDefinite`] of `q` or of what `f` makes
    /// of the state, which is then left as it was.
    pub fn predict<E: From<Error>>(
        &mut self,
        f: impl FnMut(&[f64], &mut [f64]) -> std::result::Result<(), E>,
        q: &[f64],
    ) -> std::result::Result<(), E> {
        let n = self.estimate.len();
        let noise = noise_factor("process noise Q", n, q)?;
        self.predict_with(one_by_one(f), &noise)
    }

    /// Takes in a measurement `z` of `h(state, out)` with noise covariance `r` (row-major, m x m).
    ///
    /// With a `max_nis`, a measurement whose NIS exceeds it changes nothing.
    ///
    /// # Errors
    /// Those of `h`; [`Error::Shape`], [`Error::NotFinite`] (measurement, `h`), [`Error::Invalid`] (`max_nis`),
    /// [`Error::NotPositiveDefinite`]. The state is then left as it was.
    pub fn update<E: From<Error>>(
        &mut self,
        z: &[f64],
        h: impl FnMut(&[f64], &mut [f64]) -> std::result::Result<(), E>,
        r: &[f64],
        max_nis: Option<f64>,
    ) -> std::result::Result<&Innovation, E> {
        let noise = noise_factor("measurement noise R", z.len(), r)?;
        self.update_with(z, one_by_one(h), &noise, max_nis)
    }

    /// [`UnscentedKalmanFilter::predict`] with all sigma points (one a column) in one call and the factor of the noise.
    pub(crate) fn predict_with<E: From<Error>>(
        &mut self,
        mut f: impl FnMut(&DMatrix<f64>, &mut DMatrix<f64>) -> std::result::Result<(), E>,
        noise: &DMatrix<f64>,
    ) -> std::result::Result<(), E> {
        let n = self.estimate.len();
        let mut moved = DMatrix::zeros(n, 2 * n + 1);
        f(&self.sigma_points(), &mut moved)?;
        let spread = self.spread_of(&moved);
        let mean = moved.column(0) + &spread.mean;
        if spread.centre >= 0.0 {
            let mut columns = DMatrix::zeros(n, 3 * n + 1);
            columns.view_mut((0, 0), (n, 2 * n)).copy_from(&spread.columns);
            columns.column_mut(2 * n).axpy(spread.centre.sqrt(), &spread.mean, 0.0);
            columns.view_mut((0, 2 * n + 1), (n, n)).copy_from(noise);
            self.estimate.replace(mean, &columns)?;
        } else {
            let covariance = spread.covariance() + outer(noise);
            self.estimate.replace_full(mean, &covariance, "predicted covariance")?;
        }
        Ok(())
    }

    /// [`UnscentedKalmanFilter::update`] with all sigma points in one call and the factor of the noise.
    pub(crate) fn update_with<E: From<Error>>(
        &mut self,
        z: &[f64],
        mut h: impl FnMut(&DMatrix<f64>, &mut DMatrix<f64>) -> std::result::Result<(), E>,
        noise: &DMatrix<f64>,
        max_nis: Option<f64>,
    ) -> std::result::Result<&Innovation, E> {
        let (n, m) = (self.estimate.len(), z.len());
        if m == 0 {
            return Err(Error::shape("measurement z", "at least one number", "none").into());
        }
        require_finite("measurement z", z)?;
        check_max_nis(max_nis)?;
        let mut seen = DMatrix::zeros(m, 2 * n + 1);
        h(&self.sigma_points(), &mut seen)?;
        let spread = self.spread_of(&seen);
        let residual = DVector::from_column_slice(z) - seen.column(0) - &spread.mean;
        // Columns of the factor, plus and minus: the states' own deviations, weighted.
        let weight = 0.5_f64.sqrt();
        let innovation = if spread.centre >= 0.0 {
            let mut joint = DMatrix::zeros(m + n, 2 * n + 1 + m);
            joint.view_mut((0, 0), (m, 2 * n)).copy_from(&spread.columns);
            joint.column_mut(2 * n).rows_mut(0, m).axpy(spread.centre.sqrt(), &spread.mean, 0.0);
            joint.view_mut((0, 2 * n + 1), (m, m)).copy_from(noise);
            for j in 0..n {
                for i in j..n {
                    let away = weight * self.estimate.factor[(i, j)];
                    joint[(m + i, j)] = away;
                    joint[(m + i, n + j)] = -away;
                }
            }
            self.estimate.correct(residual, &joint, max_nis)?
        } else {
            let factor = weight * &self.estimate.factor;
            let cross = &factor * (spread.columns.columns(0, n) - spread.columns.columns(n, n)).transpose();
            let covariance = spread.covariance() + outer(noise);
            self.estimate.correct_full(residual, &covariance, &cross, max_nis)?
        };
        Ok(self.innovation.insert(innovation))
    }

    fn spread_of(&self, points: &DMatrix<f64>) -> Spread {
        let n = self.estimate.len();
        let weight = 0.5 / self.scaling.spread(n);
        let mut columns = points.columns(1, 2 * n).into_owned();
        let centre = points.column(0);
        let mut mean = DVector::zeros(points.nrows());
        for mut column in columns.column_iter_mut() {
            column -= &centre;
            mean.axpy(weight, &column, 1.0);
            column *= weight.sqrt();
        }
        Spread { columns, mean, centre: self.scaling.beta - self.scaling.alpha * self.scaling.alpha }
    }
}

/// Transformed sigma points about the transformed centre.
struct Spread {
    /// Weighted differences, one a column.
    columns: DMatrix<f64>,
    /// Weighted mean of the differences.
    mean: DVector<f64>,
    /// `beta - alpha^2`, the weight of the mean's square.
    centre: f64,
}

impl Spread {
    fn covariance(&self) -> DMatrix<f64> {
        &self.columns * self.columns.transpose() + self.centre * &self.mean * self.mean.transpose()
    }
}

/// A function of one point as one of all points.
fn one_by_one<E>(
    mut f: impl FnMut(&[f64], &mut [f64]) -> std::result::Result<(), E>,
) -> impl FnMut(&DMatrix<f64>, &mut DMatrix<f64>) -> std::result::Result<(), E> {
    move |points, out| {
        let (n, m) = (points.nrows(), out.nrows());
        for (point, out) in points.as_slice().chunks_exact(n).zip(out.as_mut_slice().chunks_exact_mut(m)) {
            f(point, out)?;
        }
        Ok(())
    }
}
