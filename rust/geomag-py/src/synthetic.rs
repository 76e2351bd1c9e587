//! Synthetic fields, paths and flights. Settings come as JSON from the dataclasses of `geomag.synthetic`.

use std::sync::Arc;

use geomag_core::field::Field;
use geomag_core::frame::displacement_m;
use geomag_core::grid::Axis;
use geomag_core::state;
use geomag_core::synthetic::{CrustSpec, InsError, InsSpread, Leg, Path, Random, SensorModel, SyntheticField};
use pyo3::prelude::*;
use serde::de::DeserializeOwned;

use crate::arrays::{broadcast, shaped, vector};
use crate::class::{Reduced, properties, reduced_to_bytes};
use crate::error::{PyRes, invalid};
use crate::grid::PyGridMap;
use crate::long_call;
use crate::track::PyTrack;

/// Points sampled between two looks at whether to stop.
const BATCH: usize = 256;

/// Settings from JSON; an unknown or ill-typed field is named.
pub fn settings<T: DeserializeOwned>(what: &str, json: &str) -> PyRes<T> {
    serde_json::from_str(json).map_err(|e| invalid(what, "settings of that kind", e))
}

/// A made-up field that is known at every point: made by `geomag.synthetic.Crust.draw`.
///
/// Unlike a map it has no interpolation error, so a map of it (`grid`) has a true one.
#[pyclass(frozen, name = "SyntheticField", module = "geomag.synthetic")]
pub struct PySyntheticField {
    /// The field.
    pub inner: SyntheticField,
}

impl PySyntheticField {
    /// About the nanoseconds that a node of a map takes.
    fn units(&self) -> u64 {
        (2 * self.inner.waves().len() + 20 * self.inner.dipoles().len()).max(1) as u64
    }
}

#[pymethods]
impl PySyntheticField {
    #[new]
    #[pyo3(signature = (spec_json, extent, geographic, seed))]
    fn new(spec_json: &str, extent: [f64; 4], geographic: bool, seed: u64) -> PyRes<Self> {
        Ok(Self { inner: settings::<CrustSpec>("crust", spec_json)?.draw(extent, geographic, seed)? })
    }

    /// (x least, y least, x greatest, y greatest), map units.
    #[getter]
    fn extent(&self) -> [f64; 4] {
        self.inner.extent()
    }

    /// Whether coordinates are degrees of longitude and latitude.
    #[getter]
    fn geographic(&self) -> bool {
        self.inner.geographic()
    }

    /// Field at points (arrays broadcast against each other), value units; NaN outside the extent.
    #[pyo3(signature = (x, y))]
    fn sample<'py>(&self, py: Python<'py>, x: &Bound<'py, PyAny>, y: &Bound<'py, PyAny>) -> PyRes<Bound<'py, PyAny>> {
        let ([x, y], shape) = broadcast(["x", "y"], [x, y])?;
        let (field, total) = (&self.inner, x.len() as u64);
        let values = long_call::run(py, total.saturating_mul(20 * self.units()), None, None, |monitor| {
            let mut values = Vec::with_capacity(x.len());
            for (x, y) in x.chunks(BATCH).zip(y.chunks(BATCH)) {
                monitor.advance(values.len() as u64, total)?;
                values.extend(x.iter().zip(y).map(|(&x, &y)| field.value(x, y)));
            }
            Ok(values)
        })?;
        shaped(py, values, &shape)
    }

    /// A `GridMap` of the field: exact at its nodes, every `step` map units over the extent or on the axes given.
    #[pyo3(signature = (step = None, *, x = None, y = None, name = None, units = None, crs = None))]
    #[allow(clippy::too_many_arguments)] // one each, keyword-only
    fn grid(
        &self,
        py: Python<'_>,
        step: Option<f64>,
        x: Option<&Bound<'_, PyAny>>,
        y: Option<&Bound<'_, PyAny>>,
        name: Option<String>,
        units: Option<String>,
        crs: Option<String>,
    ) -> PyRes<PyGridMap> {
        let field = &self.inner;
        let draw = |x: Axis, y: Axis| {
            let nodes = (x.len() as u64).saturating_mul(y.len() as u64);
            long_call::run(py, nodes.saturating_mul(self.units()), None, None, |monitor| {
                field.grid_monitored(x, y, monitor)
            })
        };
        let map = match (step, x, y) {
            (Some(step), None, None) => {
                let [x, y] = field.axes_by_step(step)?;
                draw(x, y)?
            }
            (None, Some(x), Some(y)) => {
                let x = Axis::from_coordinates("x", &vector("x", x)?, 0.0)?;
                let y = Axis::from_coordinates("y", &vector("y", y)?, 0.0)?;
                if x.1 || y.1 {
                    return Err(invalid("axes of a synthetic map", "ascending coordinates", "descending ones"));
                }
                draw(x.0, y.0)?
            }
            _ => return Err(invalid("grid", "either step, or x and y", "neither or both")),
        };
        Ok(PyGridMap::from_core(map, name, units, crs))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        reduced_to_bytes(slf, &state::save(&slf.get().inner)?)
    }

    #[staticmethod]
    fn _restore(bytes: &[u8]) -> PyRes<Self> {
        Ok(Self { inner: state::load(bytes)? })
    }

    fn __repr__(&self) -> String {
        let (f, [x0, y0, x1, y1]) = (&self.inner, self.inner.extent());
        format!(
            "SyntheticField({} waves, {} dipoles, x {x0} to {x1}, y {y0} to {y1}, {})",
            f.waves().len(),
            f.dipoles().len(),
            if f.geographic() { "degrees" } else { "metres" }
        )
    }
}

/// A true path: positions (map units) and times (seconds), oldest first.
///
/// From points, or made by `Path.straight` and `Path.along_legs`.
///
/// Examples
/// --------
/// >>> from geomag.synthetic import Path
/// >>> path = Path.straight((0, 0), course_deg=90, speed_m_s=50, interval_s=2, samples=11)
/// >>> float(path.x[-1]), len(path)
/// (1000.0, 11)
#[pyclass(frozen, name = "Path", module = "geomag.synthetic")]
pub struct PyPath {
    /// The points.
    pub inner: Path,
}

properties! {
    PyPath: path {
        /// True x (east), map units.
        x(py): PyRes<Bound<'py, PyAny>> = shaped(py, path.x().to_vec(), &[path.len()]);

        /// True y (north), map units.
        y(py): PyRes<Bound<'py, PyAny>> = shaped(py, path.y().to_vec(), &[path.len()]);

        /// Times, seconds.
        time_s(py): PyRes<Bound<'py, PyAny>> = shaped(py, path.time_s().to_vec(), &[path.len()]);

        /// Whether coordinates are degrees.
        geographic: bool = path.geographic();
    }

    #[new]
    #[pyo3(signature = (x, y, time_s, *, geographic = false))]
    fn new(x: &Bound<'_, PyAny>, y: &Bound<'_, PyAny>, time_s: &Bound<'_, PyAny>, geographic: bool) -> PyRes<Self> {
        let (x, y, time_s) = (vector("path x", x)?, vector("path y", y)?, vector("path time_s", time_s)?);
        Ok(Self { inner: Path::from_points(x, y, time_s, geographic)? })
    }

    /// A straight path (a rhumb line on geographic coordinates) of `samples` points, the first at `start`.
    ///
    /// Course in degrees clockwise from north, speed in metres a second, `interval_s` seconds between samples.
    #[staticmethod]
    #[pyo3(signature = (start, *, course_deg, speed_m_s, interval_s, samples, geographic = false))]
    fn straight(
        start: [f64; 2],
        course_deg: f64,
        speed_m_s: f64,
        interval_s: f64,
        samples: usize,
        geographic: bool,
    ) -> PyRes<Self> {
        Ok(Self { inner: Path::straight(start, course_deg, speed_m_s, interval_s, samples, geographic)? })
    }

    /// A path of legs: each a pair of samples added and rate of turn in degrees a second, clockwise.
    #[staticmethod]
    #[pyo3(signature = (start, legs, *, course_deg, speed_m_s, interval_s, geographic = false))]
    fn along_legs(
        start: [f64; 2],
        legs: Vec<(usize, f64)>,
        course_deg: f64,
        speed_m_s: f64,
        interval_s: f64,
        geographic: bool,
    ) -> PyRes<Self> {
        let legs: Vec<Leg> = legs.into_iter().map(|(samples, turn_deg_s)| Leg { samples, turn_deg_s }).collect();
        Ok(Self { inner: Path::along_legs(start, course_deg, speed_m_s, interval_s, &legs, geographic)? })
    }

    /// True minus indicated position of the newest sample, metres (east, north).
    fn offset_m(&self, track: &PyTrack) -> (f64, f64) {
        displacement_m(self.inner.geographic(), track.inner.newest(), self.inner.newest()).into()
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        reduced_to_bytes(slf, &state::save(&slf.get().inner)?)
    }

    #[staticmethod]
    fn _restore(bytes: &[u8]) -> PyRes<Self> {
        Ok(Self { inner: state::load(bytes)? })
    }

    fn __repr__(&self) -> String {
        let [x, y] = self.inner.newest();
        format!("Path({} samples, newest at x {x:.6} y {y:.6})", self.inner.len())
    }
}

/// Draws one INS error from a spread; returns it as JSON.
#[pyfunction]
pub fn draw_ins_error(spread_json: &str, seed: u64) -> PyRes<String> {
    let error = settings::<InsSpread>("INS spread", spread_json)?.draw(&mut Random::new(seed))?;
    serde_json::to_string(&error).map_err(|e| invalid("INS error", "numbers that JSON can hold", e))
}

/// Flies a path through a field: the indicated track with its readings, and the true field along the path.
#[pyfunction]
pub fn fly<'py>(
    py: Python<'py>,
    field: &Bound<'py, PyAny>,
    path: &PyPath,
    ins_json: &str,
    sensor_json: &str,
    seed: u64,
) -> PyRes<(PyTrack, Bound<'py, PyAny>)> {
    let ins: InsError = settings("INS error", ins_json)?;
    let sensor: SensorModel = settings("sensor", sensor_json)?;
    let flight = if let Ok(field) = field.cast::<PySyntheticField>() {
        let field = &field.get().inner;
        crate::pool::detached(py, || geomag_core::synthetic::fly(field, &path.inner, &ins, &sensor, seed))?
    } else if let Ok(map) = field.cast::<PyGridMap>() {
        let map = Arc::clone(&map.get().inner);
        crate::pool::detached(py, || geomag_core::synthetic::fly(&*map, &path.inner, &ins, &sensor, seed))?
    } else {
        return Err(invalid("field", "a SyntheticField or a GridMap", field.get_type()));
    };
    let n = flight.truth.len();
    Ok((PyTrack::from_core(flight.track), shaped(py, flight.truth, &[n])?))
}
