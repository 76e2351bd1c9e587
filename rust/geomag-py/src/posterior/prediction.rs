//! What is to be expected of a planned track.

use geomag_core::matching::posterior::Prediction;
use pyo3::prelude::*;

use crate::arrays::shaped;
use crate::class::properties;
use crate::error::PyRes;

/// What is to be expected of a fix along a planned track; made by `predict_many`.
///
/// `bound_m2` and `covariance_m2` suppose that the right place is found; `fix_probability` and `wrong_share` say how often,
/// counted over `flights` simulated flights.
#[pyclass(frozen, name = "Prediction", module = "geomag")]
pub struct PyPrediction {
    pub inner: Prediction,
}

properties! {
    PyPrediction: prediction {
        /// Cramer-Rao bound of the newest position for white normal errors of the stated size, square metres, east-north, (2, 2).
        bound_m2(py): PyRes<Bound<'py, PyAny>> = shaped(py, prediction.bound_m2.concat(), &[2, 2]);

        /// Expected covariance of the fix: the bound with tails, correlation and registration, square metres, east-north, (2, 2).
        covariance_m2(py): PyRes<Bound<'py, PyAny>> = shaped(py, prediction.covariance_m2.concat(), &[2, 2]);

        /// Samples after which twice the expected standard deviation is within the tolerance; none if never.
        samples_to_fix: Option<usize> = prediction.samples_to_fix;

        /// Share of the simulated flights that were fixed; NaN without flights.
        fix_probability: f64 = prediction.fix_probability;

        /// Share of those fixes that were wrong; NaN without flights.
        wrong_share: f64 = prediction.wrong_share;

        /// Simulated flights.
        flights: usize = prediction.flights;
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
