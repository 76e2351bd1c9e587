//! `HarmonicMap`.

use std::sync::Arc;

use geomag_core::field::Field;
use geomag_core::grid::{Axis, GridMap};
use geomag_core::harmonic::HarmonicMap;
use pyo3::prelude::*;

use super::{PyHarmonicModel, quantity_name};
use crate::arrays::{broadcast, shaped, vector};
use crate::class::{Reduced, reduced};
use crate::error::{PyRes, invalid};
use crate::grid::PyGridMap;

/// One scalar of a harmonic model on a level surface: stands wherever a matcher takes a map.
///
/// Made by `RectangularHarmonicModel.to_map`. With `height_m` coordinates are degrees (x longitude, y latitude), with
/// `down_m` metres (x east, y north of the frame's origin). Matchers read a grid faster: see `to_grid`.
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> north, east = (a.ravel() for a in np.meshgrid(np.linspace(-5e3, 5e3, 15), np.linspace(-5e3, 5e3, 15)))
/// >>> down = 30 * np.cos(north / 1e3)
/// >>> field = np.stack([-30 * np.sin(north / 1e3), 0 * down, down], axis=-1)
/// >>> model = geomag.RectangularHarmonicModel.fit(north, east, 0.0, field, order=12)
/// >>> high = model.to_map("down", down_m=-1000.0)       # 1 km up: smaller by e
/// >>> bool(abs(high.sample(0.0, 0.0) - 30 / np.e) < 0.05), high.geographic
/// (True, False)
#[pyclass(frozen, name = "HarmonicMap", module = "geomag")]
pub struct PyHarmonicMap {
    /// The map.
    pub inner: Arc<HarmonicMap>,
    pub down_m: Option<f64>,
    pub height_m: Option<f64>,
}

#[pymethods]
impl PyHarmonicMap {
    /// Value at map coordinates `x`, `y` (any shape that broadcasts); NaN where the model does not answer.
    fn sample<'py>(&self, py: Python<'py>, x: &Bound<'py, PyAny>, y: &Bound<'py, PyAny>) -> PyRes<Bound<'py, PyAny>> {
        let ([x, y], shape) = broadcast(["x", "y"], [x, y])?;
        let values = crate::pool::detached(py, || x.iter().zip(&y).map(|(&x, &y)| self.inner.value(x, y)).collect());
        shaped(py, values, &shape)
    }

    /// Gradient (east, north) per metre at map coordinates, two arrays of the points' shape.
    fn gradient<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        y: &Bound<'py, PyAny>,
    ) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let ([x, y], shape) = broadcast(["x", "y"], [x, y])?;
        let (east, north) = crate::pool::detached(py, || {
            x.iter()
                .zip(&y)
                .map(|(&x, &y)| self.inner.value_and_gradient(x, y).1)
                .map(|[e, n]| (e, n))
                .unzip::<f64, f64, Vec<_>, Vec<_>>()
        });
        Ok((shaped(py, east, &shape)?, shaped(py, north, &shape)?))
    }

    /// A `GridMap` of the values at the nodes of two ascending axes.
    pub fn to_grid<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        y: &Bound<'py, PyAny>,
    ) -> PyRes<Bound<'py, PyAny>> {
        let axis = |name: &str, object: &Bound<'py, PyAny>| -> PyRes<Axis> {
            let (axis, reversed) = Axis::from_coordinates(name, &vector(name, object)?, 0.0)?;
            if reversed { Err(invalid(name, "ascending coordinates", "descending ones")) } else { Ok(axis) }
        };
        let (x, y) = (axis("x", x)?, axis("y", y)?);
        let grid: GridMap = crate::pool::detached(py, || self.inner.to_grid(x, y))?;
        let unit = self.inner.model().unit().to_owned();
        Ok(PyGridMap::from_core(grid, None, Some(unit), None).into_pyobject(py)?.into_any())
    }

    /// Whether coordinates are degrees.
    #[getter]
    fn geographic(&self) -> bool {
        self.inner.geographic()
    }

    /// Spacing (x, y) that matchers take as their step, map units.
    #[getter]
    fn spacing(&self) -> (f64, f64) {
        self.inner.spacing().into()
    }

    /// Mean of the field over its region.
    #[getter]
    fn mean(&self) -> f64 {
        self.inner.mean()
    }

    /// The model.
    #[getter]
    fn model(&self) -> PyHarmonicModel {
        PyHarmonicModel { inner: Arc::clone(self.inner.model()) }
    }

    /// Which quantity is read from it.
    #[getter]
    fn quantity(&self) -> &'static str {
        quantity_name(self.inner.quantity()).0
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        let this = slf.get();
        let (name, main) = quantity_name(this.inner.quantity());
        let arguments = (this.model(), name, main, this.down_m, this.height_m);
        reduced(slf, arguments)
    }

    #[staticmethod]
    #[pyo3(signature = (model, quantity, main_field, down_m, height_m))]
    fn _restore(
        model: &PyHarmonicModel,
        quantity: &str,
        main_field: Option<[f64; 3]>,
        down_m: Option<f64>,
        height_m: Option<f64>,
    ) -> PyRes<Self> {
        let inner = Arc::new(model.level(super::quantity(quantity, main_field)?, down_m, height_m)?);
        Ok(Self { inner, down_m, height_m })
    }

    fn __repr__(&self) -> String {
        let level = match (self.height_m, self.down_m) {
            (Some(h), _) => format!("height {h} m"),
            (None, d) => format!("down {} m", d.unwrap_or(0.0)),
        };
        format!("HarmonicMap({} at {level}, order {})", self.quantity(), self.inner.model().order())
    }
}
