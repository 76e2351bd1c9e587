//! `FieldSensor`, `FieldNavigator` and its steps.

use std::sync::Arc;

use geomag_core::error::{Error, require_finite};
use geomag_core::grid::Interpolation;
use geomag_core::kalman::Scaling;
use geomag_core::navigation::field_navigator::{
    FieldNavigator, FieldNavigatorMethod, FieldNavigatorOptions, FieldNavigatorStep, GATE,
};
use geomag_core::navigation::sensing::{Sensing, Sensor};
use geomag_core::stack::check_height;
use geomag_core::{field_navigator_options, scaling_options};
use numpy::{PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::arrays::{broadcast, matrix, pair, shaped, vector};
use crate::class::{Reduced, properties, reduced};
use crate::error::{PyRes, invalid};
use crate::grid::{field, interpolation};
use crate::harmonic::{PyHarmonicMap, PyHarmonicModel, main_vector, quantity};
use crate::lock::Shared;
use crate::options::old_name;
use crate::stack::level_at;

/// What a sensor reads of a field at a place.
///
/// Parameters
/// ----------
/// source : RectangularHarmonicModel, GridMap, MapStack or HarmonicMap
///     The field.
/// reading : {'vector', 'north', 'east', 'down', 'projection', 'anomaly', 'intensity'}, optional
///     What is measured of a harmonic model, 'vector' by default; maps give their own value and take none of these.
/// main_field : array (3,), optional
///     Main field (north, east, down in the model's frame) for the last three readings.
/// down_m, height_m : float, optional
///     Level in a harmonic model: a plane of its frame (places are then x east, y north, metres; 0 by default) or a
///     height above its Earth (places are then degrees). Of a map, `height_m` is the height of the sensor above the map's datum, to which
///     a map at another one is continued; a stack needs it. A vehicle that climbs is for `Navigator`.
/// interpolation : {'bicubic', 'bilinear'}
///     How a grid is read.
///
/// Notes
/// -----
/// Callable with a state that begins with x, y; `UnscentedKalmanFilter.update` takes it as h and reads it natively.
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 3000.0, 50.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x)
/// >>> sensor = geomag.FieldSensor(grid)
/// >>> sensor.read([600.0, 700.0], 1000.0).shape, len(sensor)
/// ((2, 1), 1)
/// >>> ukf = geomag.UnscentedKalmanFilter([600.0, 1000.0], 50.0**2)
/// >>> ukf.update(sensor.read(630.0, 1000.0), sensor, 1.0)
/// True
#[pyclass(frozen, name = "FieldSensor", module = "geomag")]
pub struct PyFieldSensor {
    /// The sensor.
    pub inner: Sensing,
    source: Py<PyAny>,
    reading: Option<String>,
    main_field: Option<[f64; 3]>,
    down_m: Option<f64>,
    height_m: Option<f64>,
    interpolation: String,
}

impl PyFieldSensor {
    fn make(
        source: &Bound<'_, PyAny>,
        reading: Option<&str>,
        main_field: Option<[f64; 3]>,
        down_m: Option<f64>,
        height_m: Option<f64>,
        interpolated: &str,
    ) -> PyRes<Self> {
        let method: Interpolation = interpolation(interpolated)?;
        let inner = if let Ok(model) = source.cast::<PyHarmonicModel>() {
            let model = Arc::clone(&model.get().inner);
            let sensor = match reading {
                None | Some("vector") => Sensor::Vector,
                Some(name) => Sensor::Scalar(quantity(name, main_field)?),
            };
            match (down_m, height_m) {
                (Some(_), Some(_)) => return Err(invalid("level", "one of down_m and height_m", "both")),
                (down, None) => Sensing::at_down(model, sensor, down.unwrap_or(0.0))?,
                (None, Some(height)) => Sensing::at_height(model, sensor, height)?,
            }
        } else {
            if let Some(reading) = reading {
                return Err(invalid("reading", "none with a map, which gives its own value", format!("'{reading}'")));
            }
            if down_m.is_some() || main_field.is_some() {
                return Err(invalid("down_m, main_field", "none of them with a map", "a level"));
            }
            let field = match height_m {
                Some(height) if source.cast::<PyHarmonicMap>().is_ok() => {
                    require_finite("height_m", &[height])?;
                    let known = field(source)?;
                    known.between(height, height)?.map_or(known, Arc::from)
                }
                Some(height) => level_at("source", source, height)?.get().inner.clone(),
                None => field(source)?,
            };
            check_height(field.as_ref(), None)?;
            Sensing::map(field, method)
        };
        Ok(Self {
            inner,
            source: source.clone().unbind(),
            reading: reading.map(str::to_owned),
            main_field,
            down_m,
            height_m,
            interpolation: interpolated.to_owned(),
        })
    }
}

#[pymethods]
impl PyFieldSensor {
    #[new]
    #[pyo3(signature = (source, *, reading = None, main_field = None, down_m = None, height_m = None,
                        interpolation = "bicubic"))]
    fn new(
        source: &Bound<'_, PyAny>,
        reading: Option<&str>,
        main_field: Option<&Bound<'_, PyAny>>,
        down_m: Option<f64>,
        height_m: Option<f64>,
        interpolation: &str,
    ) -> PyRes<Self> {
        Self::make(source, reading, main_vector(main_field)?, down_m, height_m, interpolation)
    }

    fn __call__<'py>(&self, py: Python<'py>, state: &Bound<'py, PyAny>) -> PyRes<Bound<'py, PyAny>> {
        let state = vector("state", state)?;
        let &[x, y, ..] = state.as_slice() else {
            return Err(Error::shape("state", "x, y, ...", format!("({},)", state.len())).into());
        };
        let mut out = vec![0.0; self.inner.len()];
        self.inner.read(&[[x, y]], &mut out);
        let shape = [out.len()];
        shaped(py, out, &shape)
    }

    /// What the sensor would read at map coordinates `x`, `y` (any shape that broadcasts): that shape with the numbers of a reading
    /// last; NaN where the field does not answer.
    fn read<'py>(&self, py: Python<'py>, x: &Bound<'py, PyAny>, y: &Bound<'py, PyAny>) -> PyRes<Bound<'py, PyAny>> {
        let ([x, y], mut shape) = broadcast(["x", "y"], [x, y])?;
        let width = self.inner.len();
        let out = crate::pool::detached(py, || {
            let places: Vec<[f64; 2]> = x.iter().zip(&y).map(|(&x, &y)| [x, y]).collect();
            let mut out = vec![0.0; width * places.len()];
            self.inner.read(&places, &mut out);
            out
        });
        shape.push(width);
        shaped(py, out, &shape)
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        let t = slf.get();
        let py = slf.py();
        let arguments = (
            t.source.clone_ref(py),
            t.reading.as_deref(),
            t.main_field,
            t.down_m,
            t.height_m,
            t.interpolation.as_str(),
        );
        reduced(slf, arguments)
    }

    #[staticmethod]
    #[pyo3(signature = (source, reading, main_field, down_m, height_m, interpolation))]
    fn _restore(
        source: &Bound<'_, PyAny>,
        reading: Option<&str>,
        main_field: Option<[f64; 3]>,
        down_m: Option<f64>,
        height_m: Option<f64>,
        interpolation: &str,
    ) -> PyRes<Self> {
        Self::make(source, reading, main_field, down_m, height_m, interpolation)
    }

    fn __repr__(&self, py: Python<'_>) -> PyRes<String> {
        let source = self.source.bind(py).get_type().name()?.to_string();
        Ok(format!("FieldSensor({source}, {} numbers)", self.inner.len()))
    }
}

/// Where a `FieldNavigator` is after a step: position, its covariance, and what became of the reading.
///
/// A step whose `outcome` is not `updated` is dead reckoning; after `diverged` the position is not to be believed, and a
/// matcher is needed for a new start.
#[pyclass(frozen, name = "FieldNavigatorStep", module = "geomag")]
pub struct PyFieldNavigatorStep {
    inner: FieldNavigatorStep,
}

properties! {
    PyFieldNavigatorStep: step {
        /// East or longitude, map units.
        x: f64 = step.x;

        /// North or latitude, map units.
        y: f64 = step.y;

        /// Covariance of the position, square metres, east-north.
        covariance_m2(py): PyRes<Bound<'py, PyAny>> = shaped(py, step.covariance_m2.as_flattened().to_vec(), &[2, 2]);

        /// `updated`, `predicted` (no reading), `rejected` (by the gate) or `off_field`.
        outcome: &'static str = step.outcome.as_str();

        /// Normalised innovation squared; none where there was no reading to compare.
        nis: Option<f64> = step.nis;

        /// Numbers in that reading.
        dof: usize = step.dof;

        /// Whether the innovations say that the filter has lost its way.
        diverged: bool = step.diverged;
    }

    fn __repr__(&self) -> String {
        let s = &self.inner;
        format!(
            "FieldNavigatorStep({}, x {:.6}, y {:.6}, sigma {:.2} m east, {:.2} m north, NIS {}{})",
            s.outcome.as_str(),
            s.x,
            s.y,
            s.covariance_m2[0][0].sqrt(),
            s.covariance_m2[1][1].sqrt(),
            s.nis.map_or_else(|| "none".to_owned(), |n| format!("{n:.2}")),
            if s.diverged { ", diverged" } else { "" }
        )
    }
}

fn planar(what: &str, object: &Bound<'_, PyAny>) -> PyRes<[[f64; 2]; 2]> {
    if let Ok((v, 2, 2)) = matrix(what, object) {
        return Ok([[v[0], v[1]], [v[2], v[3]]]);
    }
    let [east, north] = pair(what, object)?;
    Ok([[east, 0.0], [0.0, north]])
}

macro_rules! field_navigator_class {
    (
        scaling [$(($of:ident: $of_kind:ident = $of_default:tt; $of_python:literal; $($of_line:literal)+))*]
        options [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*]
    ) => {
        /// Navigates on a field without an INS: speed, course and a field sensor.
        ///
        /// Parameters
        /// ----------
        /// model : RectangularHarmonicModel, GridMap, MapStack, HarmonicMap or FieldSensor
        ///     The field, or what is read of it.
        /// start : (float, float)
        ///     Start (x, y): metres east and north, or degrees on geographic fields.
        /// covariance_m2 : float, array of shape (2,) or (2, 2)
        ///     Covariance of the start, square metres, east-north.
        /// reading_sigma : float or array of shape (3,)
        ///     Standard deviation of a reading, field unit.
        /// gate : float, optional
        ///     Probability within which a reading must lie to be used; None uses all.
        $(#[doc = row_doc!($name; $python; $($line)+)])*
        $(#[doc = row_doc!($of; $of_python; $($of_line)+)])*
        /// speed_walk, heading_walk_deg, bias_walk : float, optional
        ///     Old names of the walks, which go on working.
        /// reading : reading of FieldSensor, optional
        ///     What is measured, as in `FieldSensor`; so are the next four.
        /// main_field : array of shape (3,), optional
        ///     Main field.
        /// down_m, height_m : float, optional
        ///     Level.
        /// interpolation : {'bilinear', 'bicubic'}
        ///     How a grid is read.
        ///
        /// Notes
        /// -----
        /// For a slow vehicle in a field steep enough for its sensor; `bound` says beforehand what can be reached. Not for a start
        /// that is uncertain by more than a fraction of the field's wavelength: take a matcher first.
        ///
        /// Source: Zhao, Huang, Wang, Liu 2012, doi 10.3969/j.issn.1006-1576.2012.12.010.
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> x = np.arange(0.0, 1000.0, 20.0)
        /// >>> grid = geomag.GridMap(90 * np.sin(x / 140)[None, :] + 80 * np.cos(x / 120)[:, None], x, x)
        /// >>> nav = geomag.FieldNavigator(grid, start=(310.0, 495.0), covariance_m2=100.0, reading_sigma=1.0)
        /// >>> for k in range(1, 60):
        /// ...     step = nav.step(1.0, 5.0, 90.0, grid.sample(300.0 + 5 * k, 500.0, interpolation="bicubic"))
        /// >>> bool(np.hypot(step.x - 595.0, step.y - 500.0) < 1.0)
        /// True
        #[pyclass(frozen, name = "FieldNavigator", module = "geomag")]
        pub struct PyFieldNavigator {
            inner: Shared<FieldNavigator>,
            sensor: Py<PyFieldSensor>,
        }

        #[pymethods]
        impl PyFieldNavigator {
            #[new]
            #[pyo3(signature = (model, *, start, covariance_m2, reading_sigma, gate = Some(GATE), $($name = $default,)* $($of = $of_default,)*
                                reading = None, main_field = None, down_m = None, height_m = None, interpolation = "bicubic",
                                speed_walk = None, heading_walk_deg = None, bias_walk = None))]
            #[allow(clippy::too_many_arguments)] // one each, keyword-only
            fn new(
                py: Python<'_>,
                model: &Bound<'_, PyAny>,
                start: &Bound<'_, PyAny>,
                covariance_m2: &Bound<'_, PyAny>,
                reading_sigma: &Bound<'_, PyAny>,
                gate: Option<f64>,
                $($name: py_type!($kind),)*
                $($of: py_type!($of_kind),)*
                reading: Option<&str>,
                main_field: Option<&Bound<'_, PyAny>>,
                down_m: Option<f64>,
                height_m: Option<f64>,
                interpolation: &str,
                speed_walk: Option<f64>,
                heading_walk_deg: Option<f64>,
                bias_walk: Option<f64>,
            ) -> PyRes<Self> {
                let sensor = if let Ok(sensor) = model.cast::<PyFieldSensor>() {
                    if reading.is_some() || main_field.is_some() || down_m.is_some() || height_m.is_some() {
                        let what = "reading, main_field, down_m, height_m";
                        return Err(invalid(what, "none of them with a FieldSensor, which has its own", "one"));
                    }
                    sensor.clone().unbind()
                } else {
                    let main_field = main_vector(main_field)?;
                    Py::new(py, PyFieldSensor::make(model, reading, main_field, down_m, height_m, interpolation)?)?
                };
                let mut options = FieldNavigatorOptions {
                    start: pair("start", start)?,
                    covariance_m2: planar("covariance_m2", covariance_m2)?,
                    reading_sigma: vector("reading_sigma", reading_sigma)?,
                    gate,
                    $($name: py_value!(py $kind $name),)*
                    scaling: Scaling { $($of: py_value!(py $of_kind $of),)* },
                };
                for (old, given, new, value) in [
                    ("speed_walk", speed_walk, "speed_walk_m_s_sqrt_s", &mut options.speed_walk_m_s_sqrt_s),
                    ("heading_walk_deg", heading_walk_deg, "heading_walk_deg_sqrt_s", &mut options.heading_walk_deg_sqrt_s),
                    ("bias_walk", bias_walk, "bias_walk_sqrt_s", &mut options.bias_walk_sqrt_s),
                ] {
                    if let Some(given) = given {
                        old_name(py, old, new)?;
                        *value = given;
                    }
                }
                let inner = FieldNavigator::new(sensor.get().inner.clone(), options)?;
                Ok(Self { inner: Shared::new(inner), sensor })
            }

            /// Moves on by `dt_s` seconds with the indicated speed (m/s) and course (degrees, clockwise from north) and takes in a
            /// reading, where there is one. Numbers of it that are NaN are left out.
            ///
            /// Raises `NotFiniteError`, `InvalidInputError` (time running backwards), `ShapeError` (another number of components than the
            /// sensor has), `NotPositiveDefiniteError`. After an error nothing has moved.
            #[pyo3(signature = (dt_s, speed_m_s, course_deg, reading = None))]
            fn step(
                &self,
                py: Python<'_>,
                dt_s: f64,
                speed_m_s: f64,
                course_deg: f64,
                reading: Option<&Bound<'_, PyAny>>,
            ) -> PyRes<PyFieldNavigatorStep> {
                let reading = reading.map(numbers).transpose()?;
                let inner = self.inner.with(py, |n| n.step(dt_s, speed_m_s, course_deg, reading.as_deref()))?;
                Ok(PyFieldNavigatorStep { inner })
            }

            /// Cramer-Rao bound of the position along a true `path`, (n, 2) map coordinates, one a step: (n, 2, 2), square metres,
            /// east-north: what no unbiased filter with these noises can beat.
            ///
            /// Starts from the present covariance; where the field is unknown there is no reading. Source: Tichavsky, Muravchik and Nehorai
            /// 1998, doi 10.1109/78.668800. Raises as `step`.
            #[pyo3(signature = (path, dt_s, speed_m_s, course_deg))]
            fn bound<'py>(
                &self,
                py: Python<'py>,
                path: &Bound<'py, PyAny>,
                dt_s: f64,
                speed_m_s: f64,
                course_deg: f64,
            ) -> PyRes<Bound<'py, PyAny>> {
                let (values, rows, columns) = matrix("path", path)?;
                if columns != 2 {
                    return Err(Error::shape("path", "(n, 2): x, y", format!("({rows}, {columns})")).into());
                }
                let navigator = self.inner.with(py, |n| n.clone());
                let bounds =
                    crate::pool::detached(py, || navigator.bound(values.as_chunks::<2>().0, dt_s, speed_m_s, course_deg))?;
                shaped(py, bounds.as_flattened().as_flattened().to_vec(), &[rows, 2, 2])
            }

            /// Estimated place (x, y), map coordinates.
            #[getter]
            fn position(&self, py: Python<'_>) -> (f64, f64) {
                self.inner.with(py, |n| n.position()).into()
            }

            /// Covariance of the position, square metres, east-north, (2, 2).
            #[getter]
            fn covariance_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                shaped(py, self.inner.with(py, |n| n.covariance_m2()).as_flattened().to_vec(), &[2, 2])
            }

            /// State, (n,): metres east and north of the start first.
            #[getter]
            fn x<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                let mean = self.inner.with(py, |n| n.estimate().mean().to_vec());
                let shape = [mean.len()];
                shaped(py, mean, &shape)
            }

            /// Covariance of the state, (n, n).
            #[getter(P)]
            fn state_covariance<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                let p = self.inner.with(py, |n| n.estimate().covariance());
                shaped(py, p.as_slice().to_vec(), &[p.nrows(), p.ncols()])
            }

            /// (value, standard deviation) of the speed's error, m/s; None where it is not estimated.
            #[getter]
            fn speed_error_m_s(&self, py: Python<'_>) -> Option<(f64, f64)> {
                self.inner.with(py, |n| n.speed_error_m_s())
            }

            /// (value, standard deviation) of the course's error, degrees; None where it is not estimated.
            #[getter]
            fn heading_error_deg(&self, py: Python<'_>) -> Option<(f64, f64)> {
                self.inner.with(py, |n| n.heading_error_deg())
            }

            /// [(value, standard deviation), ...] of the sensor's constant error; empty where it is not estimated.
            #[getter]
            fn bias(&self, py: Python<'_>) -> Vec<(f64, f64)> {
                self.inner.with(py, |n| n.bias())
            }

            /// Whether the innovations say that the filter has lost its way.
            #[getter]
            fn diverged(&self, py: Python<'_>) -> bool {
                self.inner.with(py, |n| n.diverged())
            }

            /// Normalised innovation squared of the last reading; none before one.
            #[getter]
            fn nis(&self, py: Python<'_>) -> Option<f64> {
                self.inner.with(py, |n| n.innovation().map(|i| i.nis))
            }

            /// Time since the start, seconds.
            #[getter]
            fn time_s(&self, py: Python<'_>) -> f64 {
                self.inner.with(py, |n| n.time_s())
            }

            /// Steps taken.
            #[getter]
            fn n_steps(&self, py: Python<'_>) -> u64 {
                self.inner.with(py, |n| n.steps())
            }

            /// How often a pivot had to be raised to keep the covariance positive definite.
            #[getter]
            fn regularisations(&self, py: Python<'_>) -> u64 {
                self.inner.with(py, |n| n.estimate().regularisations())
            }

            /// What reads the field.
            #[getter]
            fn sensor(&self, py: Python<'_>) -> Py<PyFieldSensor> {
                self.sensor.clone_ref(py)
            }

            fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
                let py = slf.py();
                let bytes = PyBytes::new(py, &slf.get().inner.with(py, |n| n.save())?);
                reduced(slf, (slf.get().sensor.clone_ref(py), bytes))
            }

            #[staticmethod]
            fn _restore(sensor: Py<PyFieldSensor>, bytes: &[u8]) -> PyRes<Self> {
                let inner = FieldNavigator::restore(sensor.get().inner.clone(), bytes)?;
                Ok(Self { inner: Shared::new(inner), sensor })
            }

            fn __repr__(&self, py: Python<'_>) -> String {
                self.inner.with(py, |n| {
                    let ([x, y], [[east, _], [_, north]]) = (n.position(), n.covariance_m2());
                    format!(
                        "FieldNavigator({} steps, x {x:.6}, y {y:.6}, sigma {:.2} m east, {:.2} m north{})",
                        n.steps(),
                        east.sqrt(),
                        north.sqrt(),
                        if n.diverged() { ", diverged" } else { "" }
                    )
                })
            }
        }
    };
}

scaling_options!(field_navigator_options field_navigator_class);

/// A filter by its name.
pub fn filter(name: &str) -> PyRes<FieldNavigatorMethod> {
    match name {
        "unscented" => Ok(FieldNavigatorMethod::Unscented),
        "extended" => Ok(FieldNavigatorMethod::Extended),
        other => Err(invalid("method", "'unscented' or 'extended'", format!("'{other}'"))),
    }
}

/// A reading: an array, a number or a sequence, by the shortest way; asking an array for its number raises first.
fn numbers(object: &Bound<'_, PyAny>) -> PyRes<Vec<f64>> {
    if let Ok(array) = object.cast_exact::<PyArrayDyn<f64>>()
        && let Ok(read) = array.try_readonly()
        && let Ok(values) = read.as_slice()
    {
        return Ok(values.to_vec());
    }
    if let Ok(number) = object.extract::<f64>() {
        return Ok(vec![number]);
    }
    vector("reading", object)
}
