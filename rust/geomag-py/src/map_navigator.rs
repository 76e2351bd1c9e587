//! `InsModel`, `Navigator` and whole flights.

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::field::Field;
use geomag_core::frame::displacement_m;
use geomag_core::navigation::navigator::{
    Correction, Flight, FlightInput, Indicated, InsModel, MatcherPlan, Method, Navigator, NavigatorOptions,
    NavigatorStep, Smoothing, navigate, radii_m,
};
use geomag_core::stack::extent;
use geomag_core::{ins_model, matcher_plan};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};

use crate::arrays::{matrix, optional_vector, pair, shaped, vector};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::field;
use crate::lock::Shared;
use crate::long_call;
use crate::stack::field_over;

ins_model! { record_class {
    /// The grade of an INS: how large its errors are, and how they grow.
    ;
    ///
    /// Notes
    /// -----
    /// The defaults are those of `InsModel.navigation()`: about a nautical mile an hour unaided. Biases are first-order Gauss-Markov
    /// processes. Source: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, ch. 4 and 14.
    ///
    /// Examples
    /// --------
    /// >>> import geomag
    /// >>> geomag.InsModel.tactical().gyro_bias_deg_h
    /// 1.0
    /// >>> geomag.InsModel(gyro_bias_deg_h=0.01) == geomag.InsModel.navigation()
    /// False
    PyInsModel "InsModel" InsModel;
    {
        /// Navigation grade: about a nautical mile an hour unaided.
        #[staticmethod]
        fn navigation() -> Self {
            Self { inner: InsModel::navigation() }
        }

        /// Tactical grade: some tens of kilometres an hour unaided.
        #[staticmethod]
        fn tactical() -> Self {
            Self { inner: InsModel::tactical() }
        }
    }
} }

matcher_plan! { record_class {
    /// When and how the matcher beside a `Navigator` is asked.
    ;
    ///
    /// Notes
    /// -----
    /// A fix is a measurement only while the filter is lost, and a test while it tracks: two that contradict it, or one under alarm, reset
    /// position and sensor bias. Source: geomag's own.
    ///
    /// Examples
    /// --------
    /// >>> import geomag
    /// >>> geomag.MatcherPlan(every_s=30.0).every_s
    /// 30.0
    PyMatcherPlan "MatcherPlan" MatcherPlan;
    {}
} }

/// A covariance from a number (variance on each axis) or a (2, 2) array.
fn covariance(object: &Bound<'_, PyAny>) -> PyRes<[[f64; 2]; 2]> {
    if let Ok(variance) = object.extract::<f64>() {
        return Ok([[variance, 0.0], [0.0, variance]]);
    }
    let (v, rows, columns) = matrix("covariance_m2", object)?;
    if (rows, columns) != (2, 2) {
        return Err(Error::shape("covariance_m2", "(2, 2) east-north", format!("({rows}, {columns})")).into());
    }
    Ok([[v[0], v[1]], [v[2], v[3]]])
}

/// Options of a navigator from the keywords that both ways to one take.
fn options(given: Option<&Bound<'_, PyDict>>) -> PyRes<NavigatorOptions> {
    let mut out = NavigatorOptions::new(100.0);
    let Some(given) = given else { return Ok(out) };
    let mut start_is_given = false;
    for (key, value) in given.iter() {
        let key: String = key.extract()?;
        if value.is_none() {
            if key == "matcher" {
                out.matcher = None;
            }
            continue;
        }
        let number = || value.extract::<f64>().map_err(|_| invalid(&key, "a number", value.get_type()));
        match key.as_str() {
            "ins" => {
                let ins =
                    value.cast::<PyInsModel>().map_err(|_| invalid("ins", "a geomag.InsModel", value.get_type()))?;
                out.ins = ins.get().inner;
            }
            "start" => out.start = Some(pair("start", &value)?),
            "position_sigma_m" | "covariance_m2" => {
                if std::mem::replace(&mut start_is_given, true) {
                    return Err(invalid("start", "position_sigma_m or covariance_m2", "both"));
                }
                out.covariance_m2 = if key == "covariance_m2" {
                    covariance(&value)?
                } else {
                    let sigma = number()?;
                    if !(sigma >= 0.0) {
                        return Err(invalid("position_sigma_m", "a finite number >= 0", sigma));
                    }
                    [[sigma * sigma, 0.0], [0.0, sigma * sigma]]
                };
            }
            "reading_sigma" => out.reading_sigma = number()?,
            "bias_sigma" => out.bias_sigma = number()?,
            "bias_walk" => out.bias_walk = number()?,
            "batch_m" => out.batch_m = Some(number()?),
            "registration" => out.registration = Some(number()?),
            "nu" => out.nu = number()?,
            "linear_m" => out.linear_m = Some(number()?),
            "integrity_risk" => out.integrity_risk = number()?,
            "latitude_deg" => out.latitude_deg = number()?,
            "terms_covariance" => out.terms_covariance = matrix("terms_covariance", &value)?.0,
            "matcher" => {
                let plan = value.cast::<PyMatcherPlan>();
                let plan = plan.map_err(|_| invalid("matcher", "a geomag.MatcherPlan or None", value.get_type()))?;
                out.matcher = Some(plan.get().inner);
            }
            "method" => {
                out.method = match value.extract::<String>().as_deref() {
                    Ok("navigator") => Method::Navigator,
                    Ok("ekf") => Method::Ekf,
                    Ok("rbpf") => Method::Rbpf,
                    _ => return Err(invalid("method", "'navigator', 'ekf' or 'rbpf'", value.repr()?)),
                };
            }
            _ => {
                let text = format!("unexpected keyword argument '{key}'");
                return Err(pyo3::exceptions::PyTypeError::new_err(text).into());
            }
        }
    }
    Ok(out)
}

fn two_by_two<'py>(py: Python<'py>, c: &[[f64; 2]; 2]) -> PyRes<Bound<'py, PyAny>> {
    shaped(py, c.as_flattened().to_vec(), &[2, 2])
}

/// Where a `Navigator` is after a step.
///
/// `x`, `y` is the corrected place; `covariance_m2` is to be believed, `protection_level_m` is exceeded with the probability that was asked for.
/// A step whose `status` is not `tracking` says why in `reason`.
#[pyclass(frozen, name = "NavigationStep", module = "geomag")]
pub struct PyNavigationStep {
    inner: NavigatorStep,
}

#[pymethods]
impl PyNavigationStep {
    /// East or longitude, corrected, map units.
    #[getter]
    fn x(&self) -> f64 {
        self.inner.x
    }

    /// North or latitude, corrected, map units.
    #[getter]
    fn y(&self) -> f64 {
        self.inner.y
    }

    /// Covariance of the place as reported, square metres, east-north.
    #[getter]
    fn covariance_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        two_by_two(py, &self.inner.covariance_m2)
    }

    /// The filter's own covariance, before the running NIS widens it, square metres.
    #[getter]
    fn covariance_filter_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        two_by_two(py, &self.inner.covariance_filter_m2)
    }

    /// Indicated minus true velocity as estimated, m/s (east, north).
    #[getter]
    fn velocity_error_m_s(&self) -> (f64, f64) {
        self.inner.velocity_error_m_s.into()
    }

    /// Indicated minus true heading as estimated, degrees clockwise.
    #[getter]
    fn heading_error_deg(&self) -> f64 {
        self.inner.heading_error_deg
    }

    /// Rotation of the platform about the east and the north axis as estimated, milliradians.
    #[getter]
    fn tilt_error_mrad(&self) -> (f64, f64) {
        self.inner.tilt_error_mrad.into()
    }

    /// Error of the sensor as estimated, map's unit.
    #[getter]
    fn bias(&self) -> f64 {
        self.inner.bias
    }

    /// `acquiring`, `tracking`, `coasting` or `lost`.
    #[getter]
    fn status(&self) -> &'static str {
        self.inner.status.as_str()
    }

    /// Why, in words.
    #[getter]
    fn reason(&self) -> &'static str {
        self.inner.reason.as_str()
    }

    /// `waiting` (no reading, or one that waits for its batch), `updated`, `downweighted` or `off_map`.
    #[getter]
    fn outcome(&self) -> &'static str {
        self.inner.outcome.as_str()
    }

    /// Normalised innovation squared; None where no measurement was taken.
    #[getter]
    fn nis(&self) -> Option<f64> {
        self.inner.nis
    }

    /// Running mean of these: 1 where the covariance is right.
    #[getter]
    fn running_nis(&self) -> f64 {
        self.inner.running_nis
    }

    /// Radius that the error exceeds with probability `integrity_risk`, metres.
    #[getter]
    fn protection_level_m(&self) -> f64 {
        self.inner.protection_level_m
    }

    /// Time of the newest fix used, seconds; None before any.
    #[getter]
    fn last_fix(&self) -> Option<f64> {
        self.inner.last_fix_s
    }

    /// Resets of the position so far.
    #[getter]
    fn resets(&self) -> u32 {
        self.inner.resets
    }

    fn __repr__(&self) -> String {
        let s = &self.inner;
        format!(
            "NavigationStep({} ({}), x {:.6}, y {:.6}, sigma {:.1} m east, {:.1} m north, within {:.1} m)",
            s.status.as_str(),
            s.reason.as_str(),
            s.x,
            s.y,
            s.covariance_m2[0][0].sqrt(),
            s.covariance_m2[1][1].sqrt(),
            s.protection_level_m
        )
    }
}

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
/// ins : InsModel
///     Grade of the INS; `InsModel.navigation()` if not given.
/// start : (float, float)
///     True place at the first step as far as it is known, map units; the indicated one if not given.
/// position_sigma_m, covariance_m2 : float; float or (2, 2)
///     How well it is known: standard deviation on each axis (100 m), or covariance, square metres, east-north.
/// reading_sigma, bias_sigma, bias_walk : float
///     The sensor, map's unit: white error of a reading, constant error at the start, its random walk per square root of a second.
/// batch_m : float
///     Stretch over which readings are gathered into one measurement, metres; from the map's error model if not given.
/// registration : float
///     Displacement of the map's features, in distances to the data; from the map's error model if not given.
/// nu : float
///     Degrees of freedom of the Student-t law of a measurement; inf for the normal law.
/// linear_m : float
///     Position sigma up to which the field is straight enough to track, metres; from the map if not given.
/// integrity_risk : float
///     Probability with which the error may exceed the protection level.
/// terms_covariance : (m, m)
///     Covariance of the coefficients of terms that the readings contain besides the field (the vehicle's own: Tolles-Lawson), which are then
///     states of the filter; `terms` of a step are what they are multiplied by.
/// matcher : MatcherPlan or None
///     The matcher beside the filter, for a start known to kilometres, for a lost lock and a look round now and then; None for none.
/// method : str
///     `navigator`; to compare with, the textbooks' `ekf` (extended Kalman filter) and, for whole flights only, `rbpf` (Rao-Blackwellised particles).
/// latitude_deg : float
///     Latitude of a map in projected metres.
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

#[pymethods]
impl PyNavigator {
    #[new]
    #[pyo3(signature = (grid, **options))]
    fn new(grid: &Bound<'_, PyAny>, options: Option<&Bound<'_, PyDict>>) -> PyRes<Self> {
        let options = self::options(options)?;
        if options.method == Method::Rbpf {
            return Err(invalid("method", "'navigator' or 'ekf' ('rbpf' is for whole flights: navigate)", "'rbpf'"));
        }
        let field = field(grid)?;
        let inner = Shared::new(Navigator::new(field.clone(), options)?);
        Ok(Self { field, map: grid.clone().unbind(), inner })
    }

    /// Go on to what the INS indicates now, and take in a reading where there is one.
    ///
    /// `x`, `y` in map units, `velocity_m_s` (east, north), `heading_deg` clockwise from north, `value` in the map's unit (None or NaN: no reading).
    /// A velocity of None is the difference of positions, a heading of None the course. `terms` (m,) go with `terms_covariance`. Returns a `NavigationStep`.
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
    ) -> PyRes<PyNavigationStep> {
        let velocity_m_s = velocity_m_s.map(|v| pair("velocity_m_s", v)).transpose()?;
        let indicated = Indicated { time_s, x, y, velocity_m_s, heading_deg, height_m, value };
        // A step may hold a match, which takes a while.
        let terms = optional_vector("terms", terms)?.unwrap_or_default();
        let inner = self.inner.detached(py, |n| n.step_with_terms(&indicated, &terms))?;
        Ok(PyNavigationStep { inner })
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
        let bound = py.detach(|| ahead.predict_bound(&path))?;
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

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let py = slf.py();
        let this = slf.get();
        let bytes = this.inner.with(py, |n| n.save())?;
        let arguments = (this.map.clone_ref(py), PyBytes::new(py, &bytes)).into_pyobject(py)?;
        Ok((slf.get_type().getattr("_restore")?, arguments))
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

/// Columns of a log as they were passed.
struct Log {
    time_s: Vec<f64>,
    x: Vec<f64>,
    y: Vec<f64>,
    velocity_m_s: Option<Vec<[f64; 2]>>,
    heading_deg: Option<Vec<f64>>,
    height_m: Option<Vec<f64>>,
    readings: Option<Vec<f64>>,
    terms: Option<Vec<f64>>,
}

impl Log {
    #[allow(clippy::too_many_arguments)] // one each
    fn new(
        time_s: &Bound<'_, PyAny>,
        x: &Bound<'_, PyAny>,
        y: &Bound<'_, PyAny>,
        velocity_m_s: Option<&Bound<'_, PyAny>>,
        heading_deg: Option<&Bound<'_, PyAny>>,
        height_m: Option<&Bound<'_, PyAny>>,
        readings: Option<&Bound<'_, PyAny>>,
    ) -> PyRes<Self> {
        let time_s = vector("time_s", time_s)?;
        let n = time_s.len();
        // A height of the whole flight may be one number.
        let height_m = optional_vector("height_m", height_m)?.map(|h| if h.len() == 1 { vec![h[0]; n] } else { h });
        Ok(Self {
            x: vector("x", x)?,
            y: vector("y", y)?,
            velocity_m_s: velocity_m_s.map(|v| pairs("velocity_m_s", v)).transpose()?,
            heading_deg: optional_vector("heading_deg", heading_deg)?,
            height_m,
            readings: optional_vector("readings", readings)?,
            terms: None,
            time_s,
        })
    }

    fn input(&self) -> FlightInput<'_> {
        FlightInput {
            time_s: &self.time_s,
            x: &self.x,
            y: &self.y,
            velocity_m_s: self.velocity_m_s.as_deref(),
            heading_deg: self.heading_deg.as_deref(),
            height_m: self.height_m.as_deref(),
            readings: self.readings.as_deref(),
            terms: self.terms.as_deref(),
        }
    }
}

/// (n, 2) numbers.
fn pairs(what: &str, object: &Bound<'_, PyAny>) -> PyRes<Vec<[f64; 2]>> {
    let (values, rows, columns) = matrix(what, object)?;
    if columns != 2 {
        return Err(Error::shape(what, "(n, 2) east, north", format!("({rows}, {columns})")).into());
    }
    Ok(values.chunks_exact(2).map(|c| [c[0], c[1]]).collect())
}

/// Columns of a flight by name.
fn columns<'py>(py: Python<'py>, flight: &Flight) -> PyRes<Bound<'py, PyDict>> {
    let n = flight.steps.len();
    let out = PyDict::new(py);
    let number = |f: &dyn Fn(&NavigatorStep) -> f64| shaped(py, flight.steps.iter().map(f).collect(), &[n]);
    let two = |f: &dyn Fn(&NavigatorStep) -> [f64; 2]| shaped(py, flight.steps.iter().flat_map(f).collect(), &[n, 2]);
    let four = |f: &dyn Fn(&NavigatorStep) -> [[f64; 2]; 2]| {
        shaped(py, flight.steps.iter().flat_map(|s| f(s).concat()).collect(), &[n, 2, 2])
    };
    out.set_item("x", number(&|s| s.x)?)?;
    out.set_item("y", number(&|s| s.y)?)?;
    out.set_item("covariance_m2", four(&|s| s.covariance_m2)?)?;
    out.set_item("covariance_filter_m2", four(&|s| s.covariance_filter_m2)?)?;
    out.set_item("velocity_error_m_s", two(&|s| s.velocity_error_m_s)?)?;
    out.set_item("heading_error_deg", number(&|s| s.heading_error_deg)?)?;
    out.set_item("tilt_error_mrad", two(&|s| s.tilt_error_mrad)?)?;
    out.set_item("bias", number(&|s| s.bias)?)?;
    out.set_item("nis", number(&|s| s.nis.unwrap_or(f64::NAN))?)?;
    out.set_item("running_nis", number(&|s| s.running_nis)?)?;
    out.set_item("protection_level_m", number(&|s| s.protection_level_m)?)?;
    out.set_item("last_fix", number(&|s| s.last_fix_s.unwrap_or(f64::NAN))?)?;
    out.set_item("resets", number(&|s| f64::from(s.resets))?)?;
    let words = |f: &dyn Fn(&NavigatorStep) -> &'static str| flight.steps.iter().map(f).collect::<Vec<_>>();
    out.set_item("status", words(&|s| s.status.as_str()))?;
    out.set_item("reason", words(&|s| s.reason.as_str()))?;
    out.set_item("outcome", words(&|s| s.outcome.as_str()))?;
    out.set_item("inputs", flight.inputs.as_str())?;
    out.set_item("state", shaped(py, flight.state.clone(), &[flight.state.len()])?)?;
    if let Some(smoothed) = &flight.smoothed {
        out.set_item("smooth_x", shaped(py, smoothed.iter().map(|s| s.x).collect(), &[n])?)?;
        out.set_item("smooth_y", shaped(py, smoothed.iter().map(|s| s.y).collect(), &[n])?)?;
        let covariance = smoothed.iter().flat_map(|s| s.covariance_m2.concat()).collect();
        out.set_item("smooth_covariance_m2", shaped(py, covariance, &[n, 2, 2])?)?;
    }
    Ok(out)
}

/// Columns of a whole flight; see `geomag.navigate`.
#[pyfunction]
#[pyo3(name = "_navigate", signature = (grid, time_s, x, y, *, velocity_m_s = None, heading_deg = None, readings = None,
                                        height_m = None, terms = None, lag_s = None, progress = None,
                                        **options))]
#[allow(clippy::too_many_arguments)] // one each
pub fn py_navigate<'py>(
    py: Python<'py>,
    grid: &Bound<'py, PyAny>,
    time_s: &Bound<'py, PyAny>,
    x: &Bound<'py, PyAny>,
    y: &Bound<'py, PyAny>,
    velocity_m_s: Option<&Bound<'py, PyAny>>,
    heading_deg: Option<&Bound<'py, PyAny>>,
    readings: Option<&Bound<'py, PyAny>>,
    height_m: Option<&Bound<'py, PyAny>>,
    terms: Option<&Bound<'py, PyAny>>,
    lag_s: Option<f64>,
    progress: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyRes<Bound<'py, PyDict>> {
    let options = self::options(options)?;
    let mut log = Log::new(time_s, x, y, velocity_m_s, heading_deg, height_m, readings)?;
    let field = field_over(grid, [log.height_m.as_deref().and_then(extent)])?;
    let geographic = field.geographic();
    log.terms = terms.map(|t| matrix("terms", t).map(|t| t.0)).transpose()?;
    let smoothing = match lag_s {
        None => Smoothing::No,
        Some(f64::INFINITY) => Smoothing::Flight,
        Some(lag) => Smoothing::Lag(lag),
    };
    // A step takes a few microseconds, a match now and then some milliseconds.
    let units = log.time_s.len() as u64 * 20_000;
    let flight = long_call::run(py, units, None, progress, |monitor| {
        navigate(field, &log.input(), options, smoothing, monitor)
    })?;
    let out = columns(py, &flight)?;
    out.set_item("geographic", geographic)?;
    Ok(out)
}

/// Displacements from places to places, metres (n, 2) east, north.
#[pyfunction]
#[pyo3(name = "_displacements_m")]
pub fn py_displacements_m<'py>(
    py: Python<'py>,
    geographic: bool,
    x: &Bound<'py, PyAny>,
    y: &Bound<'py, PyAny>,
    to_x: &Bound<'py, PyAny>,
    to_y: &Bound<'py, PyAny>,
) -> PyRes<Bound<'py, PyAny>> {
    let (x, y, to_x, to_y) = (vector("x", x)?, vector("y", y)?, vector("to_x", to_x)?, vector("to_y", to_y)?);
    let n = x.len();
    if [y.len(), to_x.len(), to_y.len()] != [n; 3] {
        return Err(Error::shape("places", format!("({n},) each"), "other lengths").into());
    }
    let out = (0..n).flat_map(|k| displacement_m(geographic, [x[k], y[k]], [to_x[k], to_y[k]])).collect();
    shaped(py, out, &[n, 2])
}

/// Radii that hold errors of covariances (n, 2, 2) with a probability, metres (n,).
#[pyfunction]
#[pyo3(name = "_radii_m")]
pub fn py_radii_m<'py>(
    py: Python<'py>,
    covariances_m2: &Bound<'py, PyAny>,
    probability: f64,
) -> PyRes<Bound<'py, PyAny>> {
    let array = crate::arrays::array("covariances_m2", covariances_m2)?;
    let shape = array.as_array().shape().to_vec();
    if shape.len() != 3 || shape[1..] != [2, 2] {
        return Err(Error::shape("covariances_m2", "(n, 2, 2)", format!("{shape:?}")).into());
    }
    let flat: Vec<f64> = array.as_array().iter().copied().collect();
    let matrices: Vec<[[f64; 2]; 2]> = flat.chunks_exact(4).map(|c| [[c[0], c[1]], [c[2], c[3]]]).collect();
    let radii = radii_m(&matrices, probability)?;
    shaped(py, radii, &[shape[0]])
}
