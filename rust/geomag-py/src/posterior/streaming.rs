//! What one sample did.

use geomag_core::matching::posterior::PosteriorStep;
use pyo3::prelude::*;

use crate::class::properties;
use crate::fix::PyFix;

/// What one sample did to a `PosteriorMatcher`.
///
/// `fix` is None at most samples: the posterior is taken again only when enough has come in to change it. Use a fix where
/// ``step.fix is not None and step.fix.ok``.
#[pyclass(frozen, name = "PosteriorStep", module = "geomag")]
pub struct PyPosteriorStep {
    pub inner: PosteriorStep,
}

properties! {
    PyPosteriorStep: step {
        /// Whether a fix may be declared, and why not.
        status: &'static str = step.status.as_str();

        /// Candidates left.
        n_feasible: usize = step.n_feasible;

        /// Extent (x, y) of the candidates left, map units.
        extent: (f64, f64) = step.extent.into();

        /// Risk of the newest answer; 1 before there is one.
        risk: f64 = step.risk;

        /// The answer, where the posterior was taken at this sample.
        fix: Option<PyFix> = step.fix.clone().map(PyFix::from);
    }

    fn __repr__(&self) -> String {
        format!(
            "PosteriorStep({}, {} feasible, risk {:.3e})",
            self.inner.status, self.inner.n_feasible, self.inner.risk
        )
    }
}
