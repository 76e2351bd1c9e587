//! What one sample did.

use geomag_core::matching::posterior::PosteriorStep;
use pyo3::prelude::*;

use crate::fix::PyFix;

/// What one sample did to a `PosteriorMatcher`.
///
/// `fix` is None at most samples: the posterior is taken again only when enough has come in to change it. Use a fix where
/// ``step.fix is not None and step.fix.ok``.
#[pyclass(frozen, name = "PosteriorStep", module = "geomag")]
pub struct PyPosteriorStep {
    pub inner: PosteriorStep,
}

#[pymethods]
impl PyPosteriorStep {
    /// Whether a fix may be declared, and why not.
    #[getter]
    fn status(&self) -> &'static str {
        self.inner.status.as_str()
    }

    /// Candidates left.
    #[getter]
    fn n_feasible(&self) -> usize {
        self.inner.n_feasible
    }

    /// Extent (x, y) of the candidates left, map units.
    #[getter]
    fn extent(&self) -> (f64, f64) {
        self.inner.extent.into()
    }

    /// Risk of the newest answer; 1 before there is one.
    #[getter]
    fn risk(&self) -> f64 {
        self.inner.risk
    }

    /// The answer, where the posterior was taken at this sample.
    #[getter]
    fn fix(&self) -> Option<PyFix> {
        self.inner.fix.clone().map(PyFix::from)
    }

    fn __repr__(&self) -> String {
        format!(
            "PosteriorStep({}, {} feasible, risk {:.3e})",
            self.inner.status, self.inner.n_feasible, self.inner.risk
        )
    }
}
