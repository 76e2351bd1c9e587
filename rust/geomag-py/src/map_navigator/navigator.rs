//! `Navigator`.

use std::sync::Arc;

use geomag_core::field::Field;
use geomag_core::monitor::Monitor;
use geomag_core::navigation::navigator::{Correction, Indicated, Navigator, NavigatorMethod};
use geomag_core::navigator_options;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use super::keywords::{covariance, options};
use super::log::Log;
use super::step::PyNavigatorStep;
use crate::arrays::{optional_vector, pair, shaped};
use crate::class::{Reduced, reduced};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::field;
use crate::lock::Shared;
use crate::long_call;

macro_rules! navigator_class {
    ($($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*) => {
        /// Corrects an INS with readings of a field, step by step, for hours.
        ///
        /// For an INS that drifts by kilometres and a map of the field below. Give it what the INS indicates and what the sensor reads, at any rate; it answers
        /// with the corrected place, a covariance that is to be believed, and a protection level. For a whole log at once see `navigate`; for a
        /// vehicle with a log and a compass only, `FieldNavigator`; for fixes alone, `InsFeedback`.
        ///
        /// Parameters
        /// ----------
        /// grid : GridMap or HarmonicMap
        ///     The map. Its sigma and error model (see `geomag.survey`) are what the covariance rests on; with ``sigma=0`` it is taken to be exact.
        $($(#[doc = row_doc!($name; $python; $($line)+)])*)*
        ///
        /// Raises
        /// ------
        /// InvalidInputError, NotFiniteError, ShapeError, NotPositiveDefiniteError
        ///
        /// Notes
        /// -----
        /// An error-state Kalman filter of position, velocity, tilts, gyro and accelerometer biases, sensor bias and the displacement of the
        /// map's features; readings enter as means over one and a half correlation lengths of the map's errors, linearised
        /// statistically over the position ellipse, with Student-t weights; the running NIS widens the covariance that is reported. Source: Groves,
        /// Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, ch. 14 and 16; the noise law is geomag's own. See the theory page.
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> x = y = np.arange(0.0, 20e3, 100.0)
        /// >>> grid = geomag.GridMap(90 * np.sin(x / 900)[None, :] + 80 * np.cos(y / 700)[:, None], x, y, sigma=0.0)
        /// >>> navigator = geomag.Navigator(grid, position_sigma_m=100.0)
        /// >>> for k in range(200):
        /// ...     true = 2000.0 + 70.0 * k, 8000.0
        /// ...     step = navigator.step(k, true[0] + 80, true[1] - 60, (70.0, 0.0), 90.0, float(grid.sample(*true)))
        /// >>> step.status, bool(np.hypot(step.x - true[0], step.y - true[1]) < step.protection_level_m)
        /// ('tracking', True)
        #[pyclass(frozen, name = "Navigator", module = "geomag")]
        pub struct PyNavigator {
            field: Arc<dyn Field>,
            /// What was passed as the map, for pickling.
            map: Py<PyAny>,
            inner: Shared<Navigator>,
        }
    };
}

navigator_options!(navigator_class);

#[pymethods]
impl PyNavigator {
    #[new]
    #[pyo3(signature = (grid, **options))]
    fn new(grid: &Bound<'_, PyAny>, options: Option<&Bound<'_, PyDict>>) -> PyRes<Self> {
        let options = self::options(options)?;
        if options.method == NavigatorMethod::Rbpf {
            return Err(invalid("method", "'navigator' or 'ekf' ('rbpf' is for whole flights: navigate)", "'rbpf'"));
        }
        let field = field(grid)?;
        let inner = Shared::new(Navigator::new(field.clone(), options)?);
        Ok(Self { field, map: grid.clone().unbind(), inner })
    }

    /// Go on to what the INS indicates now, and take in a reading where there is one.
    ///
    /// `x`, `y` in map units, `velocity_m_s` (east, north), `heading_deg` clockwise from north, `value` in the map's unit (None or NaN: no reading).
    /// A velocity of None is the difference of positions, a heading of None the course. `terms` (m,) go with `terms_covariance`. Returns a `NavigatorStep`.
    #[pyo3(signature = (time_s, x, y, velocity_m_s = None, heading_deg = None, value = None, *, height_m = None, terms = None))]
    #[allow(clippy::too_many_arguments)] // one each
    fn step(
        &self,
        py: Python<'_>,
        time_s: f64,
        x: f64,
        y: f64,
        velocity_m_s: Option<&Bound<'_, PyAny>>,
        heading_deg: Option<f64>,
        value: Option<f64>,
        height_m: Option<f64>,
        terms: Option<&Bound<'_, PyAny>>,
    ) -> PyRes<PyNavigatorStep> {
        let velocity_m_s = velocity_m_s.map(|v| pair("velocity_m_s", v)).transpose()?;
        let indicated = Indicated { time_s, x, y, velocity_m_s, heading_deg, height_m, value };
        let terms = optional_vector("terms", terms)?.unwrap_or_default();
        let step = |monitor: &dyn Monitor| self.inner.alone(|n| n.step_interruptible(&indicated, &terms, monitor));
        let units = if self.inner.with(py, |n| n.is_match_due(time_s)) { long_call::SHORT } else { 0 };
        let inner = long_call::run(py, units, None, None, step)?;
        Ok(PyNavigatorStep { inner })
    }

    /// Take a matcher's fix of the newest indicated position.
    ///
    /// It must be ok and have a covariance. Returns its normalised innovation squared and whether it contradicted the filter, which then
    /// started anew from it.
    fn correct(&self, py: Python<'_>, fix: &PyFix) -> PyRes<(f64, bool)> {
        let fix = fix.inner.clone();
        Ok(answer(self.inner.with(py, |n| n.correct(&fix))?))
    }

    /// Take a position from elsewhere (GNSS, terrain, a sighting) for the newest step.
    ///
    /// `offset_m` is true minus indicated, metres (east, north), `covariance_m2` its covariance. Returns as `correct`.
    fn correct_position(
        &self,
        py: Python<'_>,
        offset_m: &Bound<'_, PyAny>,
        covariance_m2: &Bound<'_, PyAny>,
    ) -> PyRes<(f64, bool)> {
        let (offset, covariance) = (pair("offset_m", offset_m)?, covariance(covariance_m2)?);
        Ok(answer(self.inner.with(py, |n| n.correct_position(offset, covariance))?))
    }

    /// Take a velocity from elsewhere (Doppler log, odometer with a heading) for the newest step: true, m/s (east, north).
    ///
    /// Returns as `correct`.
    fn correct_velocity(&self, py: Python<'_>, velocity_m_s: &Bound<'_, PyAny>, sigma_m_s: f64) -> PyRes<(f64, bool)> {
        let velocity = pair("velocity_m_s", velocity_m_s)?;
        Ok(answer(self.inner.with(py, |n| n.correct_velocity(velocity, sigma_m_s))?))
    }

    /// Start anew at a place, map units, known with this covariance; what is known of the INS's other errors is kept.
    fn reset(&self, py: Python<'_>, x: f64, y: f64, covariance_m2: &Bound<'_, PyAny>) -> PyRes<()> {
        let covariance = covariance(covariance_m2)?;
        Ok(self.inner.with(py, |n| n.reset([x, y], covariance))?)
    }

    /// Covariance of the position along a planned path, (n, 2, 2) square metres, if a reading comes at every step.
    ///
    /// The Cramer-Rao bound of the filter's own model with slopes at the truth, from what is known now. `x`, `y` in map units, velocities and headings from the
    /// path where they are not given. The navigator stays as it is.
    #[pyo3(signature = (time_s, x, y, *, velocity_m_s = None, heading_deg = None, height_m = None))]
    #[allow(clippy::too_many_arguments)] // one each
    fn predict_bound<'py>(
        &self,
        py: Python<'py>,
        time_s: &Bound<'py, PyAny>,
        x: &Bound<'py, PyAny>,
        y: &Bound<'py, PyAny>,
        velocity_m_s: Option<&Bound<'py, PyAny>>,
        heading_deg: Option<&Bound<'py, PyAny>>,
        height_m: Option<&Bound<'py, PyAny>>,
    ) -> PyRes<Bound<'py, PyAny>> {
        let log = Log::new(time_s, x, y, velocity_m_s, heading_deg, height_m, None)?;
        log.input().check()?;
        let path: Vec<Indicated> =
            (0..log.time_s.len()).map(|k| Indicated { value: Some(0.0), ..log.input().at(k) }).collect();
        let ahead = self.inner.with(py, |n| n.clone());
        let bound = crate::pool::detached(py, || ahead.predict_bound(&path))?;
        shaped(py, bound.iter().flat_map(|c| c.concat()).collect(), &[bound.len(), 2, 2])
    }

    /// `acquiring`, `tracking`, `coasting` or `lost`.
    #[getter]
    fn status(&self, py: Python<'_>) -> &'static str {
        self.inner.with(py, |n| n.status().as_str())
    }

    /// Which INS output there was: `full`, `velocity` (no heading: the course) or `positions` (a reduced model).
    #[getter]
    fn inputs(&self, py: Python<'_>) -> &'static str {
        self.inner.with(py, |n| n.inputs().as_str())
    }

    /// Steps taken.
    #[getter]
    fn steps(&self, py: Python<'_>) -> u64 {
        self.inner.with(py, |n| n.steps())
    }

    /// Estimated errors, indicated minus true.
    ///
    /// Position (m) and velocity (m/s) east and north, tilts about north, east and down (rad), gyro biases forward, right and down (rad/s),
    /// accelerometer biases forward and right (m/s2), sensor bias (map's unit), displacement of the map's features east and north (m).
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        let mean = self.inner.with(py, |n| n.mean().to_vec());
        let n = mean.len();
        shaped(py, mean, &[n])
    }

    /// Covariance of these errors, the filter's own.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        let (n, values) = self.inner.with(py, |navigator| {
            let n = navigator.mean().len();
            (n, (0..n * n).map(|k| navigator.covariance(k / n, k % n)).collect())
        });
        shaped(py, values, &[n, n])
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        let py = slf.py();
        let this = slf.get();
        let bytes = this.inner.with(py, |n| n.save())?;
        let arguments = (this.map.clone_ref(py), PyBytes::new(py, &bytes));
        reduced(slf, arguments)
    }

    #[staticmethod]
    fn _restore(grid: &Bound<'_, PyAny>, bytes: &[u8]) -> PyRes<Self> {
        let field = field(grid)?;
        let inner = Shared::new(Navigator::restore(field.clone(), bytes)?);
        Ok(Self { field, map: grid.clone().unbind(), inner })
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (status, steps) = self.inner.with(py, |n| (n.status().as_str(), n.steps()));
        let unit = if self.field.geographic() { "degrees" } else { "metres" };
        format!("Navigator({status}, {steps} steps, map in {unit})")
    }
}

fn answer(correction: Correction) -> (f64, bool) {
    (correction.nis, correction.reset)
}
