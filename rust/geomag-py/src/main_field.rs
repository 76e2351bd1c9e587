//! `MainFieldModel`.

use std::sync::Arc;

use geomag_core::main_field::MainField;
use pyo3::prelude::*;

use crate::arrays::{broadcast, matrix, shaped, vector};
use crate::class::{Reduced, reduced};
use crate::error::PyRes;
use crate::frame::stacked;
use crate::long_call;

/// A spherical harmonic model of the main field with coefficients linear in time between epochs.
///
/// For models that `geomag.mainfield.load` does not know; it makes one of these of a file.
///
/// Parameters
/// ----------
/// epochs : array of shape (k,), k >= 2
///     Decimal years, rising.
/// g, h : arrays of shape (k, pairs)
///     Schmidt semi-normalised coefficients, nT, of the pairs (n, m) = (1, 0), (1, 1), (2, 0), ... up to `degree`.
/// degree : int
///     Highest degree.
///
/// Raises
/// ------
/// InvalidInputError, ShapeError, NotFiniteError
///
/// Examples
/// --------
/// >>> from geomag.mainfield import MainFieldModel
/// >>> dipole = MainFieldModel([2025, 2030], [[-30000, 0], [-30000, 0]], [[0, 0], [0, 0]], degree=1)
/// >>> north, east, down = dipole.field(10.0, 0.0, 0.0, 2026.5)
/// >>> round(float(north)), round(float(east)), abs(round(float(down)))
/// (29902, 0, 0)
#[pyclass(frozen, name = "MainFieldModel", module = "geomag.mainfield")]
pub struct PyMainFieldModel {
    inner: Arc<MainField>,
}

/// Rows of a matrix.
fn rows(what: &str, object: &Bound<'_, PyAny>) -> PyRes<Vec<Vec<f64>>> {
    let (values, rows, columns) = matrix(what, object)?;
    Ok((0..rows).map(|r| values[r * columns..(r + 1) * columns].to_vec()).collect())
}

#[pymethods]
impl PyMainFieldModel {
    #[new]
    #[pyo3(signature = (epochs, g, h, *, degree))]
    fn new(epochs: &Bound<'_, PyAny>, g: &Bound<'_, PyAny>, h: &Bound<'_, PyAny>, degree: usize) -> PyRes<Self> {
        let model = MainField::new(degree, vector("epochs", epochs)?, rows("g", g)?, rows("h", h)?)?;
        Ok(Self { inner: Arc::new(model) })
    }

    /// Highest degree.
    #[getter]
    fn degree(&self) -> usize {
        self.inner.degree()
    }

    /// Epochs, decimal years.
    #[getter]
    fn epochs<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.epochs().to_vec(), &[self.inner.epochs().len()])
    }

    /// Coefficients g, nT: a row an epoch.
    #[getter]
    fn g<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.g().concat(), &[self.inner.epochs().len(), self.inner.g()[0].len()])
    }

    /// Coefficients h, nT: a row an epoch.
    #[getter]
    fn h<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.h().concat(), &[self.inner.epochs().len(), self.inner.h()[0].len()])
    }

    /// North, east, down in nT, shape (..., 3), at degrees of longitude and geodetic latitude, metres above WGS84 and
    /// decimal years; arrays broadcast.
    #[pyo3(signature = (longitude, latitude, height_m, year, *, progress = None))]
    fn field<'py>(
        &self,
        py: Python<'py>,
        longitude: &Bound<'py, PyAny>,
        latitude: &Bound<'py, PyAny>,
        height_m: &Bound<'py, PyAny>,
        year: &Bound<'py, PyAny>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyRes<Bound<'py, PyAny>> {
        let names = ["longitude", "latitude", "height_m", "date"];
        let ([lon, lat, height, year], shape) = broadcast(names, [longitude, latitude, height_m, year])?;
        let units = (lon.len() * self.inner.g()[0].len() * 4) as u64;
        let model = Arc::clone(&self.inner);
        let found = long_call::run(py, units, None, progress, move |monitor| {
            model.field_many(&lat, &lon, &height, &year, monitor)
        })?;
        stacked(py, found, &shape)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.inner == other.inner
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        let py = slf.py();
        let this = slf.get();
        let arguments = (this.epochs(py)?, this.g(py)?, this.h(py)?, this.degree());
        reduced(slf, arguments)
    }

    #[staticmethod]
    fn _restore(epochs: &Bound<'_, PyAny>, g: &Bound<'_, PyAny>, h: &Bound<'_, PyAny>, degree: usize) -> PyRes<Self> {
        Self::new(epochs, g, h, degree)
    }

    fn __repr__(&self) -> String {
        let [first, last] = self.inner.span();
        format!("MainFieldModel(degree {}, {first} to {last})", self.inner.degree())
    }
}
