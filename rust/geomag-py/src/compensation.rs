//! `compensation`: terms, and the compensator of a stream.

use geomag_core::compensation::{Compensator, SCALE_NT, TERMS, rates, terms};
use geomag_core::error::Error;
use geomag_core::state;
use pyo3::prelude::*;

use crate::arrays::{optional_vector, shaped, vector};
use crate::class::{Reduced, reduced_to_bytes};
use crate::error::PyRes;
use crate::frame::vectors;
use crate::lock::Shared;

/// Terms of Tolles and Lawson, shape (n, 18), of a field in the vehicle's axes, shape (n, 3); see `geomag.compensation`.
#[pyfunction]
#[pyo3(signature = (field_nt, time_s, max_gap_s))]
pub fn tolles_lawson_terms<'py>(
    py: Python<'py>,
    field_nt: &Bound<'py, PyAny>,
    time_s: Option<&Bound<'py, PyAny>>,
    max_gap_s: f64,
) -> PyRes<Bound<'py, PyAny>> {
    let (field, shape) = vectors("field_nt", field_nt)?;
    let &[n] = shape.as_slice() else {
        return Err(
            Error::shape("field_nt", "(n, 3): components along the vehicle's axes", format!("{shape:?} + 3")).into()
        );
    };
    let time = optional_vector("time_s", time_s)?;
    let rates = rates(&field, time.as_deref(), max_gap_s)?;
    let rows: Vec<f64> = field.iter().zip(&rates).flat_map(|(b, r)| terms(*b, *r)).collect();
    shaped(py, rows, &[n, TERMS])
}

/// Takes a vehicle's field off readings as they come; `Compensation.stream()` makes one.
///
/// Rates are differences to the sample before: half a sample late, where a log has central ones. Pickles, and goes on.
///
/// Parameters
/// ----------
/// coefficients : array of shape (18,)
///     Of the terms, nT; rates in nT a second.
/// max_gap_s : float
///     Longest step over which a rate is taken; after a longer one a sample is without eddy terms.
///
/// Examples
/// --------
/// >>> from geomag.compensation import Compensator
/// >>> compensator = Compensator([100.0] + [0.0] * 17, max_gap_s=0.25)
/// >>> compensator.update(0.0, [30_000.0, 0.0, 40_000.0], 50_060.0)
/// 50000.0
#[pyclass(frozen, name = "Compensator", module = "geomag.compensation")]
pub struct PyCompensator {
    inner: Shared<Compensator>,
}

#[pymethods]
impl PyCompensator {
    #[new]
    #[pyo3(signature = (coefficients, *, max_gap_s = 0.25))]
    fn new(coefficients: &Bound<'_, PyAny>, max_gap_s: f64) -> PyRes<Self> {
        let given = vector("coefficients", coefficients)?;
        let coefficients: [f64; TERMS] =
            given.try_into().map_err(|v: Vec<f64>| Error::shape("coefficients", "(18,)", format!("({},)", v.len())))?;
        Ok(Self { inner: Shared::new(Compensator::new(coefficients, max_gap_s)?) })
    }

    /// The reading without the vehicle's field, nT; NaN where the field or the reading is no number.
    #[pyo3(signature = (time_s, field_nt, reading_nt))]
    fn update(&self, py: Python<'_>, time_s: f64, field_nt: &Bound<'_, PyAny>, reading_nt: f64) -> PyRes<f64> {
        let given = vector("field_nt", field_nt)?;
        let field: [f64; 3] =
            given.try_into().map_err(|v: Vec<f64>| Error::shape("field_nt", "(3,)", format!("({},)", v.len())))?;
        Ok(self.inner.with(py, |c| c.update(time_s, field, reading_nt))?)
    }

    /// Coefficients of the terms, shape (18,).
    #[getter]
    fn coefficients<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.with(py, |c| c.coefficients().to_vec()), &[TERMS])
    }

    /// Longest step over which a rate is taken, seconds.
    #[getter]
    fn max_gap_s(&self, py: Python<'_>) -> f64 {
        self.inner.with(py, |c| c.max_gap_s())
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        reduced_to_bytes(slf, &slf.get().inner.with(slf.py(), |c| state::save(c))?)
    }

    #[staticmethod]
    fn _restore(bytes: &[u8]) -> PyRes<Self> {
        Ok(Self { inner: Shared::new(state::load(bytes)?) })
    }

    #[allow(clippy::unused_self)] // a method to Python
    fn __repr__(&self) -> String {
        format!("Compensator({TERMS} terms of {SCALE_NT} nT)")
    }
}
