//! What is to be expected of a planned track.

use geomag_core::matching::posterior::Prediction;
use pyo3::prelude::*;

use crate::arrays::shaped;
use crate::error::PyRes;

/// What is to be expected of a fix along a planned track; made by `predict_many`.
///
/// `bound_m2` and `covariance_m2` suppose that the right place is found; `fix_probability` and `wrong_share` say how often,
/// counted over `flights` simulated flights.
#[pyclass(frozen, name = "Prediction", module = "geomag")]
pub struct PyPrediction {
    pub inner: Prediction,
}

#[pymethods]
impl PyPrediction {
    /// Cramer-Rao bound of the newest position for white normal errors of the stated size, square metres, east-north, (2, 2).
    #[getter]
    fn bound_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.bound_m2.concat(), &[2, 2])
    }

    /// Expected covariance of the fix: the bound with tails, correlation and registration, square metres, east-north, (2, 2).
    #[getter]
    fn covariance_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.covariance_m2.concat(), &[2, 2])
    }

    /// Samples after which twice the expected standard deviation is within the tolerance; none if never.
    #[getter]
    fn samples_to_fix(&self) -> Option<usize> {
        self.inner.samples_to_fix
    }

    /// Share of the simulated flights that were fixed; NaN without flights.
    #[getter]
    fn fix_probability(&self) -> f64 {
        self.inner.fix_probability
    }

    /// Share of those fixes that were wrong; NaN without flights.
    #[getter]
    fn wrong_share(&self) -> f64 {
        self.inner.wrong_share
    }

    /// Simulated flights.
    #[getter]
    fn flights(&self) -> usize {
        self.inner.flights
    }

    fn __repr__(&self) -> String {
        let c = self.inner.covariance_m2;
        let flown = match self.inner.flights {
            0 => "no flights simulated".to_owned(),
            flights => format!("fix probability {:.2} of {flights} flights", self.inner.fix_probability),
        };
        format!("Prediction(sigma {:.1} m east, {:.1} m north, {flown})", c[0][0].sqrt(), c[1][1].sqrt())
    }
}
