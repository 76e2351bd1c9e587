//! Where a navigator is after a step.

use geomag_core::navigation::navigator::NavigatorStep;
use pyo3::prelude::*;

use crate::arrays::shaped;
use crate::error::PyRes;

fn two_by_two<'py>(py: Python<'py>, c: &[[f64; 2]; 2]) -> PyRes<Bound<'py, PyAny>> {
    shaped(py, c.as_flattened().to_vec(), &[2, 2])
}

/// Where a `Navigator` is after a step.
///
/// `x`, `y` is the corrected place; `covariance_m2` is to be believed, `protection_level_m` is exceeded with the probability that was asked for.
/// A step whose `status` is not `tracking` says why in `reason`.
#[pyclass(frozen, name = "NavigatorStep", module = "geomag")]
pub struct PyNavigatorStep {
    pub inner: NavigatorStep,
}

#[pymethods]
impl PyNavigatorStep {
    /// East or longitude, corrected, map units.
    #[getter]
    fn x(&self) -> f64 {
        self.inner.x
    }

    /// North or latitude, corrected, map units.
    #[getter]
    fn y(&self) -> f64 {
        self.inner.y
    }

    /// Covariance of the place as reported, square metres, east-north.
    #[getter]
    fn covariance_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        two_by_two(py, &self.inner.covariance_m2)
    }

    /// The filter's own covariance, before the running NIS widens it, square metres.
    #[getter]
    fn covariance_filter_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        two_by_two(py, &self.inner.covariance_filter_m2)
    }

    /// Indicated minus true velocity as estimated, m/s (east, north).
    #[getter]
    fn velocity_error_m_s(&self) -> (f64, f64) {
        self.inner.velocity_error_m_s.into()
    }

    /// Indicated minus true heading as estimated, degrees clockwise.
    #[getter]
    fn heading_error_deg(&self) -> f64 {
        self.inner.heading_error_deg
    }

    /// Rotation of the platform about the east and the north axis as estimated, milliradians.
    #[getter]
    fn tilt_error_mrad(&self) -> (f64, f64) {
        self.inner.tilt_error_mrad.into()
    }

    /// Error of the sensor as estimated, map's unit.
    #[getter]
    fn bias(&self) -> f64 {
        self.inner.bias
    }

    /// `acquiring`, `tracking`, `coasting` or `lost`.
    #[getter]
    fn status(&self) -> &'static str {
        self.inner.status.as_str()
    }

    /// Why, in words.
    #[getter]
    fn reason(&self) -> &'static str {
        self.inner.reason.as_str()
    }

    /// `waiting` (no reading, or one that waits for its batch), `updated`, `downweighted` or `off_map`.
    #[getter]
    fn outcome(&self) -> &'static str {
        self.inner.outcome.as_str()
    }

    /// Normalised innovation squared; None where no measurement was taken.
    #[getter]
    fn nis(&self) -> Option<f64> {
        self.inner.nis
    }

    /// Running mean of these: 1 where the covariance is right.
    #[getter]
    fn running_nis(&self) -> f64 {
        self.inner.running_nis
    }

    /// Radius that the error exceeds with probability `integrity_risk`, metres.
    #[getter]
    fn protection_level_m(&self) -> f64 {
        self.inner.protection_level_m
    }

    /// Time of the newest fix used, seconds; None before any.
    #[getter]
    fn last_fix(&self) -> Option<f64> {
        self.inner.last_fix_s
    }

    /// Resets of the position so far.
    #[getter]
    fn resets(&self) -> u32 {
        self.inner.resets
    }

    fn __repr__(&self) -> String {
        let s = &self.inner;
        format!(
            "NavigatorStep({} ({}), x {:.6}, y {:.6}, sigma {:.1} m east, {:.1} m north, within {:.1} m)",
            s.status.as_str(),
            s.reason.as_str(),
            s.x,
            s.y,
            s.covariance_m2[0][0].sqrt(),
            s.covariance_m2[1][1].sqrt(),
            s.protection_level_m
        )
    }
}
