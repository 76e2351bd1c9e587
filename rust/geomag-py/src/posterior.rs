//! Calibrated matching.

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::field::Field;
use geomag_core::matching::posterior::{self, Channel, PosteriorMatcher, PosteriorOptions, PosteriorStep, Prediction};
use geomag_core::matching::stream::feed;
use geomag_core::track::Track;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays::{pair, shaped, vector};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::{field, interpolation as named};
use crate::lock::Shared;
use crate::long_call;
use crate::stack::field_for;
use crate::track::PyTrack;

/// A further field measured along the track: its map, values and sensor sigma.
type Extra = (Arc<dyn Field>, Vec<f64>, Option<f64>);

/// Greatest number of simulated flights a track.
const MAX_FLIGHTS: usize = 1_000_000;

/// Checked options from arguments of the options' own names; those not named stand at their defaults.
macro_rules! options {
    ($half_width:ident $(, $name:ident)*) => {{
        let options = PosteriorOptions { $($name,)* ..PosteriorOptions::new($half_width) };
        options.validate()?;
        options
    }};
}

/// Half width and lattice step from a number or a pair each.
fn extent(half_width: &Bound<'_, PyAny>, step: Option<&Bound<'_, PyAny>>) -> PyRes<([f64; 2], Option<[f64; 2]>)> {
    Ok((pair("half_width", half_width)?, step.map(|s| pair("step", s)).transpose()?))
}

fn extras(more: Option<Vec<Bound<'_, PyAny>>>, track: &Track) -> PyRes<Vec<Extra>> {
    let mut out = Vec::new();
    for item in more.unwrap_or_default() {
        let (grid, values, sigma): (Bound<'_, PyAny>, Bound<'_, PyAny>, Option<f64>) = item.extract()?;
        out.push((field_for(&grid, [track])?, vector("values of a further field", &values)?, sigma));
    }
    Ok(out)
}

/// Match a whole track and declare the risk that the answer is wrong.
///
/// For fixes that somebody will act on. Where the map is flat, or the start known only to tens of kilometres, it will mostly
/// decline.
///
/// Parameters
/// ----------
/// grid : GridMap
///     The stored map. What is known of its errors goes with it: `sigma=`, or `geomag.survey.map_from_lines`.
/// track : Track
///     Indicated positions and measured values.
/// half_width : float or (float, float)
///     Bound of the INS error (x, y), map units.
/// sigma : float, optional
///     Standard deviation of the sensor, value units; by default what the map's own lines say.
/// tolerance_m : float, optional
///     A fix is wrong when its error is beyond this, metres; one map cell by default.
/// max_risk : float
///     Declared risk up to which an answer is a fix.
/// step : float or (float, float), optional
///     Lattice step, map units; chosen from the map and the tolerance by default.
/// bias_sigma : float, optional
///     Standard deviation of the unknown constant, value units; None for an unbounded one, 0 for none.
/// leg_bias_sigma : float
///     Standard deviation of the step of the bias from the first straight leg to every other, value units: the vehicle's own field, which
///     changes with its heading.
/// bias_walk : float
///     Standard deviation of what a slow drift of the bias amounts to over the track, value units.
/// height_sigma_m : float
///     Standard deviation of the height of the readings above the map, metres, at most 600: the map is continued to a few heights.
/// drift_sigma_m : float
///     Growth of the INS error over the track, one standard deviation, metres.
/// heading_sigma_deg, scale_sigma : float
///     Standard deviations of heading and scale errors of the track.
/// position_sigma_m : float
///     Standard deviation of each position about the track, metres.
/// nu : float, optional
///     Degrees of freedom of the Student-t residuals; from the map's errors by default.
/// interpolation : {'bilinear', 'bicubic'}
///     How the map is read between its nodes. What it cannot say there, the difference of the two and more, is part of the error
///     whichever is taken; name the one that made the readings, or that is nearer to the field.
/// misfit_threshold : float, optional
///     Log evidence that an effect which was not told (height, legs, drift of the bias, scale of the readings, heading, drift) must gain
///     over the model as told for the fix to be rejected, with `Fix.misfit` saying which; by default the map's own, or 6; infinity for
///     no such tests.
/// min_overlap : float
///     Share of the samples that a candidate must have on the map.
/// min_goodness : float
///     p-value of the residuals under which the answer is rejected.
/// max_candidates : int
///     A larger lattice is refused before memory is taken.
/// surface : bool
///     Return the posterior over the offsets as `Fix.surface`.
/// more : sequence of (GridMap, values, sigma), optional
///     Further fields measured along the same track, each with its own map.
///
/// Returns
/// -------
/// Fix
///     With `risk`, `covariance_m2` and `goodness`.
///
/// Raises
/// ------
/// InvalidInputError, CandidateLimitError
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 6000.0, 50.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x, sigma=0.0)
/// >>> k = np.arange(30.0)
/// >>> noise = np.random.default_rng(1).normal(0, 1, 30)
/// >>> track = geomag.Track(1000 + 90 * k, 2000 + 40 * k, grid.sample(1210 + 90 * k, 1875 + 40 * k) + noise)
/// >>> fix = geomag.match_posterior(grid, track, half_width=500, sigma=1.0, tolerance_m=100)
/// >>> fix.ok, fix.risk < 0.01
/// (True, True)
#[pyfunction]
#[pyo3(signature = (grid, track, *, half_width, sigma = None, tolerance_m = None, max_risk = 0.01, step = None,
    bias_sigma = None, leg_bias_sigma = 0.0, bias_walk = 0.0, height_sigma_m = 0.0, drift_sigma_m = 0.0, heading_sigma_deg = 0.0, scale_sigma = 0.0, position_sigma_m = 0.0, nu = None,
    interpolation = "bilinear", misfit_threshold = None, min_overlap = 0.8, min_goodness = 1e-3, max_candidates = 4_000_000, surface = false, more = None))]
#[allow(clippy::too_many_arguments)] // one each, keyword-only
pub fn match_posterior(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    track: &Bound<'_, PyTrack>,
    half_width: &Bound<'_, PyAny>,
    sigma: Option<f64>,
    tolerance_m: Option<f64>,
    max_risk: f64,
    step: Option<&Bound<'_, PyAny>>,
    bias_sigma: Option<f64>,
    leg_bias_sigma: f64,
    bias_walk: f64,
    height_sigma_m: f64,
    drift_sigma_m: f64,
    heading_sigma_deg: f64,
    scale_sigma: f64,
    position_sigma_m: f64,
    nu: Option<f64>,
    interpolation: &str,
    misfit_threshold: Option<f64>,
    min_overlap: f64,
    min_goodness: f64,
    max_candidates: u64,
    surface: bool,
    more: Option<Vec<Bound<'_, PyAny>>>,
) -> PyRes<PyFix> {
    let track = &track.get().on(py, grid)?;
    let map = field_for(grid, [&**track])?;
    let (half_width, step) = extent(half_width, step)?;
    let interpolation = named(interpolation)?;
    let options = options! {
        half_width, step, tolerance_m, max_risk, bias_sigma, leg_bias_sigma, bias_walk, height_sigma_m, drift_sigma_m, heading_sigma_deg, scale_sigma,
        position_sigma_m, nu, interpolation, misfit_threshold, min_overlap, min_goodness, max_candidates, surface
    };
    let more = extras(more, track)?;
    let units = posterior::work(&*map, track, &options)?.saturating_mul(more.len() as u64 + 1);
    let fix = long_call::run(py, units, None, None, |monitor| {
        let mut channels = vec![Channel { field: &*map, values: track.values(), sigma }];
        channels.extend(more.iter().map(|(f, v, s)| Channel { field: &**f, values: v, sigma: *s }));
        posterior::match_interruptible(&channels, track, &options, monitor)
    })?;
    Ok(fix.into())
}

/// `match_posterior` for many tracks on one map, on all cores; with `streaming=True` each is fed sample by sample to a
/// `PosteriorMatcher` and answers at its first fix.
///
/// Parameters
/// ----------
/// grid : GridMap
///     The stored map. What is known of its errors goes with it: `sigma=`, or `geomag.survey.map_from_lines`.
/// tracks : sequence of Track
/// half_width : float or (float, float)
///     Bound of the INS error (x, y), map units.
/// sigma : float, optional
///     Standard deviation of the sensor, value units; by default what the map's own lines say.
/// tolerance_m : float, optional
///     A fix is wrong when its error is beyond this, metres; one map cell by default.
/// max_risk : float
///     Declared risk up to which an answer is a fix.
/// step : float or (float, float), optional
///     Lattice step, map units; chosen from the map and the tolerance by default.
/// bias_sigma : float, optional
///     Standard deviation of the unknown constant, value units; None for an unbounded one, 0 for none.
/// drift_sigma_m : float
///     Growth of the INS error over the track, one standard deviation, metres.
/// heading_sigma_deg, scale_sigma : float
///     Standard deviations of heading and scale errors of the track.
/// position_sigma_m : float
///     Standard deviation of each position about the track, metres.
/// nu : float, optional
///     Degrees of freedom of the Student-t residuals; from the map's errors by default.
///
/// Returns
/// -------
/// list of Fix
///     In the order of the tracks.
///
/// Raises
/// ------
/// InvalidInputError, TooFewSamplesError, CandidateLimitError
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 6000.0, 50.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x, sigma=0.0)
/// >>> k, noise = np.arange(30.0), np.random.default_rng(1).normal(0, 1, 30)
/// >>> readings = grid.sample(1210 + 90 * k, 1875 + 40 * k) + noise
/// >>> tracks = [geomag.Track(1210 + e + 90 * k, 1875 + 40 * k, readings) for e in (-200.0, 50.0, 150.0)]
/// >>> fixes = geomag.match_posterior_many(grid, tracks, half_width=500, sigma=1.0, tolerance_m=100)
/// >>> [round(fix.offset_m[0], -1) for fix in fixes if fix.ok]
/// [200.0, -50.0, -150.0]
#[pyfunction]
#[pyo3(signature = (grid, tracks, *, half_width, sigma = None, tolerance_m = None, max_risk = 0.01, step = None,
    bias_sigma = None, leg_bias_sigma = 0.0, bias_walk = 0.0, height_sigma_m = 0.0, drift_sigma_m = 0.0, heading_sigma_deg = 0.0, scale_sigma = 0.0, position_sigma_m = 0.0, nu = None,
    interpolation = "bilinear", misfit_threshold = None, min_overlap = 0.8, min_goodness = 1e-3, max_candidates = 4_000_000, streaming = false, progress = None))]
#[allow(clippy::too_many_arguments)] // one each, keyword-only
pub fn match_posterior_many(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    tracks: Vec<Bound<'_, PyTrack>>,
    half_width: &Bound<'_, PyAny>,
    sigma: Option<f64>,
    tolerance_m: Option<f64>,
    max_risk: f64,
    step: Option<&Bound<'_, PyAny>>,
    bias_sigma: Option<f64>,
    leg_bias_sigma: f64,
    bias_walk: f64,
    height_sigma_m: f64,
    drift_sigma_m: f64,
    heading_sigma_deg: f64,
    scale_sigma: f64,
    position_sigma_m: f64,
    nu: Option<f64>,
    interpolation: &str,
    misfit_threshold: Option<f64>,
    min_overlap: f64,
    min_goodness: f64,
    max_candidates: u64,
    streaming: bool,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyRes<Vec<PyFix>> {
    let tracks = crate::track::all_on(py, grid, &tracks)?;
    let map = field_for(grid, &tracks)?;
    let (half_width, step) = extent(half_width, step)?;
    let interpolation = named(interpolation)?;
    let options = options! {
        half_width, step, tolerance_m, max_risk, bias_sigma, leg_bias_sigma, bias_walk, height_sigma_m, drift_sigma_m, heading_sigma_deg, scale_sigma,
        position_sigma_m, nu, interpolation, misfit_threshold, min_overlap, min_goodness, max_candidates
    };
    let units = (tracks.len() as u64).saturating_mul(4_000_000);
    let fixes = long_call::run(py, units, None, progress, |monitor| -> Result<_, Error> {
        if streaming {
            posterior::stream_many(&map, &tracks, sigma, &options, monitor)
        } else {
            posterior::match_many(&*map, &tracks, sigma, &options, monitor)
        }
    })?;
    Ok(fixes.into_iter().map(PyFix::from).collect())
}

/// What one sample did to a `PosteriorMatcher`.
///
/// `fix` is None at most samples: the posterior is taken again only when enough has come in to change it. Use a fix where
/// ``step.fix is not None and step.fix.ok``.
#[pyclass(frozen, name = "PosteriorStep", module = "geomag")]
pub struct PyPosteriorStep {
    inner: PosteriorStep,
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

/// Calibrated matching sample by sample: `match_posterior` for a stream, with a fix as soon as its risk allows.
///
/// For a live track of any length; candidates that the samples exclude are dropped, and at most `max_samples` samples are
/// kept, so that time and memory are bounded. It pickles, and goes on bit for bit. Not for a whole log: `match_posterior`.
///
/// Parameters
/// ----------
/// grid : GridMap
///     The stored map. What is known of its errors goes with it: `sigma=`, or `geomag.survey.map_from_lines`.
/// half_width : float or (float, float)
///     Bound of the INS error (x, y), map units.
/// max_samples : int
///     Samples kept, at least 3; when there are more the oldest is let go.
/// sigma, tolerance_m, max_risk, step, bias_sigma, leg_bias_sigma, bias_walk, height_sigma_m, drift_sigma_m, heading_sigma_deg, scale_sigma, position_sigma_m, nu, interpolation, misfit_threshold, min_overlap, min_goodness, max_candidates
///     As in `match_posterior`.
///
/// Raises
/// ------
/// InvalidInputError, CandidateLimitError
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 6000.0, 50.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x, sigma=0.0)
/// >>> k, noise = np.arange(30.0), np.random.default_rng(1).normal(0, 1, 30)
/// >>> readings = grid.sample(1210 + 90 * k, 1875 + 40 * k) + noise
/// >>> matcher = geomag.PosteriorMatcher(grid, half_width=500, sigma=1.0, tolerance_m=100)
/// >>> for px, py, value in zip(1000 + 90 * k, 2000 + 40 * k, readings):
/// ...     step = matcher.update(px, py, value)
/// ...     if step.fix is not None and step.fix.ok:
/// ...         break
/// >>> step.status, step.risk <= 0.01, matcher.n_samples < 30
/// ('fixed', True, True)
#[pyclass(frozen, name = "PosteriorMatcher", module = "geomag")]
pub struct PyPosteriorMatcher {
    inner: Shared<PosteriorMatcher>,
    grid: Py<PyAny>,
}

#[pymethods]
impl PyPosteriorMatcher {
    #[new]
    #[pyo3(signature = (grid, *, half_width, sigma = None, tolerance_m = None, max_risk = 0.01, step = None,
        bias_sigma = None, leg_bias_sigma = 0.0, bias_walk = 0.0, height_sigma_m = 0.0, drift_sigma_m = 0.0, heading_sigma_deg = 0.0, scale_sigma = 0.0, position_sigma_m = 0.0,
        nu = None, interpolation = "bilinear", misfit_threshold = None, min_overlap = 0.8, min_goodness = 1e-3, max_candidates = 4_000_000, max_samples = 200))]
    #[allow(clippy::too_many_arguments)] // one each, keyword-only
    fn new(
        grid: &Bound<'_, PyAny>,
        half_width: &Bound<'_, PyAny>,
        sigma: Option<f64>,
        tolerance_m: Option<f64>,
        max_risk: f64,
        step: Option<&Bound<'_, PyAny>>,
        bias_sigma: Option<f64>,
        leg_bias_sigma: f64,
        bias_walk: f64,
        height_sigma_m: f64,
        drift_sigma_m: f64,
        heading_sigma_deg: f64,
        scale_sigma: f64,
        position_sigma_m: f64,
        nu: Option<f64>,
        interpolation: &str,
        misfit_threshold: Option<f64>,
        min_overlap: f64,
        min_goodness: f64,
        max_candidates: u64,
        max_samples: usize,
    ) -> PyRes<Self> {
        let map = field(grid)?;
        let (half_width, step) = extent(half_width, step)?;
        let interpolation = named(interpolation)?;
        let options = options! {
            half_width, step, tolerance_m, max_risk, bias_sigma, leg_bias_sigma, bias_walk, height_sigma_m, drift_sigma_m, heading_sigma_deg, scale_sigma,
            position_sigma_m, nu, interpolation, misfit_threshold, min_overlap, min_goodness, max_candidates
        };
        let inner = PosteriorMatcher::new(map, sigma, options, max_samples)?;
        Ok(Self { inner: Shared::new(inner), grid: grid.clone().unbind() })
    }

    /// Takes one sample: indicated position `x`, `y` (map units), measured `value`, and `height_m` where the map is a `MapStack`.
    /// Returns a `PosteriorStep`.
    ///
    /// Raises `NotFiniteError` for a sample that is not finite; it is not taken.
    #[pyo3(signature = (x, y, value, height_m = None))]
    fn update(&self, py: Python<'_>, x: f64, y: f64, value: f64, height_m: Option<f64>) -> PyRes<PyPosteriorStep> {
        Ok(PyPosteriorStep { inner: self.inner.detached(py, |m| m.update_at(x, y, value, height_m))? })
    }

    /// Takes samples until a fix is declared or the track ends; the answer then.
    fn run(&self, py: Python<'_>, track: &Bound<'_, PyTrack>) -> PyRes<PyFix> {
        let track = track.get().on(py, self.grid.bind(py))?;
        let total = track.len() as u64;
        let units = total.saturating_mul(self.inner.with(py, |m| m.n_feasible()) as u64);
        let fix = long_call::run(py, units, None, None, |monitor| {
            self.inner.alone(|matcher| feed(matcher, &track, false, monitor))
        })?;
        Ok(fix.into())
    }

    /// The `Fix` on the samples held, whatever its status; the posterior is taken now, which `update` does not do at every sample.
    ///
    /// Raises `TooFewSamplesError` before there are enough samples.
    fn fix(&self, py: Python<'_>) -> PyRes<PyFix> {
        Ok(self.inner.answer(py)?.into())
    }

    /// Forgets all samples; every candidate is back.
    fn reset(&self, py: Python<'_>) -> PyRes<()> {
        self.inner.begin_again(py)
    }

    /// Samples seen.
    #[getter]
    fn n_samples(&self, py: Python<'_>) -> usize {
        self.inner.seen(py)
    }

    /// Candidates left.
    #[getter]
    fn n_feasible(&self, py: Python<'_>) -> usize {
        self.inner.with(py, |m| m.n_feasible())
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let (py, this) = (slf.py(), slf.get());
        let state = this.inner.saved(py)?;
        let arguments = (this.grid.clone_ref(py), state).into_pyobject(py)?;
        Ok((slf.get_type().getattr("_restore")?, arguments))
    }

    #[staticmethod]
    fn _restore(grid: &Bound<'_, PyAny>, state: &[u8]) -> PyRes<Self> {
        let inner = Shared::new(PosteriorMatcher::load(field(grid)?, state)?);
        Ok(Self { inner, grid: grid.clone().unbind() })
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (samples, left) = self.inner.with(py, |m| (m.n_samples(), m.n_feasible()));
        format!("PosteriorMatcher({samples} samples, {left} feasible)")
    }
}

/// What is to be expected of a fix along a planned track; made by `predict_many`.
///
/// `bound_m2` and `covariance_m2` suppose that the right place is found; `fix_probability` and `wrong_share` say how often,
/// counted over `flights` simulated flights.
#[pyclass(frozen, name = "Prediction", module = "geomag")]
pub struct PyPrediction {
    inner: Prediction,
}

#[pymethods]
impl PyPrediction {
    /// Cramer-Rao bound of the newest position for white normal errors of the stated size, square metres, east-north, (2, 2).
    #[getter]
    fn bound_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.bound_m2.concat(), &[2, 2])
    }

    /// Expected covariance of the fix: the bound with tails, correlation and registration, square metres, east-north, (2, 2).
    #[getter]
    fn covariance_m2<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.covariance_m2.concat(), &[2, 2])
    }

    /// Samples after which twice the expected standard deviation is within the tolerance; none if never.
    #[getter]
    fn samples_to_fix(&self) -> Option<usize> {
        self.inner.samples_to_fix
    }

    /// Share of the simulated flights that were fixed; NaN without flights.
    #[getter]
    fn fix_probability(&self) -> f64 {
        self.inner.fix_probability
    }

    /// Share of those fixes that were wrong; NaN without flights.
    #[getter]
    fn wrong_share(&self) -> f64 {
        self.inner.wrong_share
    }

    /// Simulated flights.
    #[getter]
    fn flights(&self) -> usize {
        self.inner.flights
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

/// Predict, before flight, how planned tracks would be fixed: Cramer-Rao bound, expected covariance, share of simulated
/// flights that are fixed and how soon.
///
/// Parameters
/// ----------
/// grid : GridMap
///     The stored map. What is known of its errors goes with it: `sigma=`, or `geomag.survey.map_from_lines`.
/// tracks : sequence of Track
///     Planned positions; the values are not used.
/// half_width : float or (float, float)
///     Bound of the INS error (x, y), map units.
/// sigma : float, optional
///     Standard deviation of the sensor, value units; by default what the map's own lines say.
/// tolerance_m : float, optional
///     A fix is wrong when its error is beyond this, metres; one map cell by default.
/// max_risk : float
///     Declared risk up to which an answer is a fix.
/// bias_sigma : float, optional
///     Standard deviation of the unknown constant, value units; None for an unbounded one, 0 for none.
/// drift_sigma_m : float
///     Growth of the INS error over the track, one standard deviation, metres.
/// heading_sigma_deg, scale_sigma : float
///     Standard deviations of heading and scale errors of the track.
/// nu : float, optional
///     Degrees of freedom of the Student-t residuals; from the map's errors by default.
/// interpolation : {'bilinear', 'bicubic'}
///     How the map is read between its nodes.
/// flights : int
///     Simulated flights a track, at most 1,000,000.
/// seed : int
///     Of the simulated flights.
///
/// Returns
/// -------
/// list of Prediction or None
///     None where the map is unknown along the track.
///
/// Raises
/// ------
/// InvalidInputError, CandidateLimitError
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 6000.0, 50.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x, sigma=0.0)
/// >>> k = np.arange(30.0)
/// >>> plan = geomag.Track(1210 + 90 * k, 1875 + 40 * k, 0 * k)
/// >>> ahead, = geomag.predict_many(grid, [plan], half_width=500, sigma=1.0, tolerance_m=100, flights=10)
/// >>> ahead.fix_probability > 0.5, bool(np.sqrt(np.trace(ahead.covariance_m2)) < 100)
/// (True, True)
#[pyfunction]
#[pyo3(signature = (grid, tracks, *, half_width, sigma = None, tolerance_m = None, max_risk = 0.01, bias_sigma = None,
    drift_sigma_m = 0.0, heading_sigma_deg = 0.0, scale_sigma = 0.0, nu = None, interpolation = "bilinear", flights = 20, seed = 0, progress = None))]
#[allow(clippy::too_many_arguments)] // one each, keyword-only
pub fn predict_many(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    tracks: Vec<Bound<'_, PyTrack>>,
    half_width: &Bound<'_, PyAny>,
    sigma: Option<f64>,
    tolerance_m: Option<f64>,
    max_risk: f64,
    bias_sigma: Option<f64>,
    drift_sigma_m: f64,
    heading_sigma_deg: f64,
    scale_sigma: f64,
    nu: Option<f64>,
    interpolation: &str,
    flights: usize,
    seed: u64,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyRes<Vec<Option<PyPrediction>>> {
    let tracks = crate::track::all_on(py, grid, &tracks)?;
    let map = field_for(grid, &tracks)?;
    let half_width = pair("half_width", half_width)?;
    let interpolation = named(interpolation)?;
    let options = options! {
        half_width, tolerance_m, max_risk, bias_sigma, drift_sigma_m, heading_sigma_deg, scale_sigma, nu, interpolation
    };
    if flights > MAX_FLIGHTS {
        return Err(invalid("flights", &format!("at most {MAX_FLIGHTS}"), flights));
    }
    let units = (tracks.len() as u64).saturating_mul(flights.max(1) as u64).saturating_mul(4_000_000);
    let found = long_call::run(py, units, None, progress, |monitor| {
        posterior::predict_many(&*map, &tracks, sigma, &options, flights, seed, monitor)
    })?;
    Ok(found.into_iter().map(|p| p.map(|inner| PyPrediction { inner })).collect())
}
