//! `closest_contour_point`, `fit_transform`, `match_contour`, `SlidingContour`.

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::field::Field;
use geomag_core::fix::Fix;
use geomag_core::grid::GridMap;
use geomag_core::matching::closest::closest_contour_point;
use geomag_core::matching::contour::{ContourOptions, match_channels_monitored};
use geomag_core::matching::refine::RefineOptions;
use geomag_core::matching::scene::{Channel, Priors};
use geomag_core::matching::sliding::{AveragedPoint, SlidingContour, SlidingState};
use geomag_core::matching::starts::{DEFAULT_MAX_CANDIDATES, Starts};
use geomag_core::matching::stream::{Sample, Stream};
use geomag_core::matching::transform::{Transform, TransformKind};
use geomag_core::stack::extent;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::arrays::{broadcast, matrix, optional_vector, shaped, vector};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::{PyGridMap, interpolation};
use crate::lock::Shared;
use crate::long_call;
use crate::stack::{level_at, level_for, same_map};
use crate::track::PyTrack;

fn grid_map(what: &str, object: &Bound<'_, PyAny>) -> PyRes<Arc<GridMap>> {
    match object.cast::<PyGridMap>() {
        Ok(grid) => Ok(grid.get().inner.clone()),
        Err(_) => Err(invalid(what, "a geomag.GridMap", object.get_type().name()?)),
    }
}

pub fn transform_kind(name: &str) -> PyRes<TransformKind> {
    TransformKind::ALL
        .into_iter()
        .find(|k| k.as_str() == name)
        .ok_or_else(|| invalid("transform", "'translation', 'rigid', 'similarity' or 'affine'", format!("'{name}'")))
}

fn points_in(what: &str, object: &Bound<'_, PyAny>) -> PyRes<Vec<[f64; 2]>> {
    let (values, rows, columns) = matrix(what, object)?;
    if columns != 2 {
        return Err(Error::shape(what, "(n, 2): x, y", format!("({rows}, {columns})")).into());
    }
    Ok(values.chunks_exact(2).map(|p| [p[0], p[1]]).collect())
}

/// Closest points on contour lines of the map.
///
/// The contour is that of marching squares: straight segments between the linear crossings of cell sides; a saddle cell
/// is split by the mean of its corners; a cell with a NaN corner has no contour.
///
/// Parameters
/// ----------
/// grid : GridMap
///     The map.
/// x, y : float or array
///     Points that ask, map units.
/// value : float or array
///     Contour value of each point; broadcast with x and y.
/// radius_m : float
///     How far to look, metres; the whole map by default.
///
/// Returns
/// -------
/// x, y, distance_m : floats or arrays
///     Closest point (map units) and its distance in metres; NaN where no contour is in reach.
///
/// Examples
/// --------
/// >>> import geomag
/// >>> slope = geomag.GridMap([[0.0, 10.0], [0.0, 10.0]], [0.0, 100.0], [0.0, 100.0])
/// >>> geomag.closest_contour_point(slope, 20.0, 30.0, 5.0)
/// (50.0, 30.0, 30.0)
#[pyfunction(name = "closest_contour_point")]
#[pyo3(signature = (grid, x, y, value, *, radius_m = f64::INFINITY))]
pub fn py_closest_contour_point<'py>(
    py: Python<'py>,
    grid: &Bound<'py, PyAny>,
    x: &Bound<'py, PyAny>,
    y: &Bound<'py, PyAny>,
    value: &Bound<'py, PyAny>,
    radius_m: f64,
) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let map = grid_map("grid", grid)?;
    let ([x, y, value], shape) = broadcast(["x", "y", "value"], [x, y, value])?;
    let found = crate::pool::detached(py, || {
        (0..x.len())
            .map(|i| {
                let nowhere = [f64::NAN; 3];
                closest_contour_point(&map, x[i], y[i], value[i], radius_m)
                    .map(|found| found.map_or(nowhere, |p| [p.x, p.y, p.distance_m]))
            })
            .collect::<Result<Vec<_>, _>>()
    })?;
    let column = |i: usize| shaped(py, found.iter().map(|p| p[i]).collect(), &shape);
    Ok((column(0)?, column(1)?, column(2)?))
}

/// Least-squares transform of one point set onto another, in closed form.
///
/// Parameters
/// ----------
/// source, target : array of shape (n, 2)
///     Points and where they should go, metres (a rotation in degrees of longitude and latitude is none).
/// kind : {'translation', 'rigid', 'similarity', 'affine'}
///     What the transform may do; affine needs points that are not on a line.
/// weights : array of shape (n,), optional
///     Weight of each pair, >= 0.
///
/// Returns
/// -------
/// matrix : array of shape (2, 2)
/// shift : array of shape (2,)
///     ``target ~ source @ matrix.T + shift``.
///
/// Raises
/// ------
/// TooFewSamplesError, RankDeficientError
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> p = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 50.0]])
/// >>> matrix, shift = geomag.fit_transform(p, p @ [[0, 1], [-1, 0]] + [10, 20], kind="rigid")
/// >>> np.allclose(matrix, [[0, -1], [1, 0]]), shift.round(6).tolist()
/// (True, [10.0, 20.0])
#[pyfunction(name = "fit_transform")]
#[pyo3(signature = (source, target, *, kind = "rigid", weights = None))]
pub fn py_fit_transform<'py>(
    py: Python<'py>,
    source: &Bound<'py, PyAny>,
    target: &Bound<'py, PyAny>,
    kind: &str,
    weights: Option<&Bound<'py, PyAny>>,
) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let weights = optional_vector("weights", weights)?;
    let (from, to) = (points_in("source", source)?, points_in("target", target)?);
    let fitted = Transform::fit(transform_kind(kind)?, &from, &to, weights.as_deref())?;
    Ok((shaped(py, fitted.matrix.concat(), &[2, 2])?, shaped(py, fitted.shift.to_vec(), &[2])?))
}

/// Keyword arguments that `match_contour` and `SlidingContour` share.
pub fn contour_options(map: &GridMap, given: Option<&Bound<'_, PyDict>>) -> PyRes<ContourOptions> {
    let mut o = ContourOptions::default();
    let mut p = Priors::default();
    let mut r = RefineOptions::default();
    let mut starts: Option<Bound<'_, PyAny>> = None;
    let (mut half_width_m, mut step_m, mut keep, mut max_candidates) =
        (None::<f64>, None::<f64>, 12_usize, DEFAULT_MAX_CANDIDATES);
    if let Some(given) = given {
        for (key, value) in given.iter() {
            let key: String = key.extract()?;
            if value.is_none() {
                continue;
            }
            let number = || value.extract::<f64>().map_err(|_| invalid(&key, "a number", &value));
            let count = || value.extract::<usize>().map_err(|_| invalid(&key, "a whole number >= 0", &value));
            let flag = || value.extract::<bool>().map_err(|_| invalid(&key, "True or False", &value));
            let text = || value.extract::<String>().map_err(|_| invalid(&key, "a name", &value));
            match key.as_str() {
                "transform" => o.transform = transform_kind(&text()?)?,
                "radius_m" => o.radius_m = number()?,
                "starts" => starts = Some(value.clone()),
                "refine" => o.refine = flag()?,
                "stiffness" => o.stiffness = number()?,
                "tolerance_m" => o.tolerance_m = number()?,
                "max_iterations" => o.max_iterations = count()?,
                "min_points" => o.min_points = Some(count()?),
                "acceleration" => o.acceleration = count()?,
                "max_rotation_deg" => o.max_rotation_deg = Some(number()?),
                "offset_sigma_m" => p.offset_sigma_m = Some(number()?),
                "heading_sigma_deg" => p.heading_sigma_deg = Some(number()?),
                "scale_sigma" => p.scale_sigma = Some(number()?),
                "bias_sigma" => p.bias_sigma = Some(number()?),
                "half_width_m" => half_width_m = Some(number()?),
                "step_m" => step_m = Some(number()?),
                "keep_starts" => keep = count()?,
                "max_candidates" => max_candidates = count()? as u64,
                "interpolation" => r.interpolation = interpolation(&text()?)?,
                "map_correlation_m" => r.map_correlation_m = Some(number()?),
                "min_overlap" => r.min_overlap = number()?,
                "fix_radius_m" => r.tolerance_m = Some(number()?),
                "max_risk" => r.max_risk = number()?,
                "min_goodness" => r.min_goodness = number()?,
                other => {
                    return Err(pyo3::exceptions::PyTypeError::new_err(format!(
                        "match_contour() got an unexpected keyword argument '{other}'"
                    ))
                    .into());
                }
            }
        }
    }
    if let Some(given) = starts {
        let name = given.extract::<String>().ok();
        o.starts = match name.as_deref() {
            Some("indicated") => Starts::Indicated,
            Some("grid") => {
                let half_width_m = half_width_m
                    .or(p.offset_sigma_m.filter(|s| s.is_finite()).map(|s| 3.0 * s))
                    .or(Some(o.radius_m).filter(|r| r.is_finite()))
                    .ok_or_else(|| {
                        invalid(
                            "starts='grid'",
                            "half_width_m, offset_sigma_m or radius_m to know how far to look",
                            "none",
                        )
                    })?;
                let [east, north] = map.metres_per_unit(0.5 * (map.y().first() + map.y().last()));
                let cell = (map.x().step() * east).min(map.y().step() * north);
                let step_m = step_m.unwrap_or(cell.max(half_width_m / 40.0).min(half_width_m));
                Starts::Grid { half_width_m, step_m, keep, max_candidates }
            }
            Some(other) => {
                return Err(invalid("starts", "'indicated', 'grid' or offsets (n, 2) in metres", format!("'{other}'")));
            }
            None => Starts::Offsets(points_in("starts", &given)?),
        };
    }
    r.priors = p;
    o.refinement = r;
    o.check()?;
    Ok(o)
}

/// Another field along the track: map, measured values, sigma.
type OtherChannel<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, f64);

/// Move the indicated track, as one body, onto the contours of its measured values (ICCP).
///
/// For smooth maps and an INS error of a few cells. By default ICCP to the letter: it converges to the nearest minimum
/// and has no covariance. With ``starts='grid', refine=True`` and the INS's own accuracy as priors it is the recommended
/// pipeline: a lattice of starts, then Gauss-Newton on the misfit of map against measured value, with covariance,
/// goodness and risk. Not for a calibrated risk on real surveys: see ``match_posterior``.
///
/// Parameters
/// ----------
/// grid : GridMap
///     The map. Its ``sigma`` (error of the map) is used by the refinement.
/// track : Track
///     Indicated positions and measured values.
/// transform : {'rigid', 'translation', 'similarity', 'affine'}
///     What the track may do; with `refine` also what is estimated.
/// radius_m : float
///     How far from a point its contour is looked for, metres; the whole map by default. At least the INS error.
/// starts : {'indicated', 'grid'} or array of shape (n, 2)
///     Where to start: at the INS, at the best of a lattice (`half_width_m`, by default three `offset_sigma_m`; `step_m`;
///     `keep_starts`), or at offsets in metres (east, north). The least misfit wins.
/// refine : bool
///     Minimise the misfit afterwards, over offset, heading, scale and bias.
/// sigma : float
///     Standard deviation of a measured value, value units; estimated from the residuals where it is needed and missing.
/// offset_sigma_m, heading_sigma_deg, scale_sigma, bias_sigma : float
///     Priors: standard deviations of the INS error at the newest point (each axis), its heading and scale, and of a
///     constant in the measurement. They bound ICCP's transform too. Heading and scale are estimated where the transform
///     is free to change them or a prior is given, the bias where its prior is given; ``inf`` is a flat prior.
/// stiffness : float
///     K: weight of the distance to the indicated points against that to the contours.
/// tolerance_m : float
///     Converged when no point moves further, metres. The paper's 1 m stops short: 0.001 with `acceleration` does not.
/// max_iterations, min_points : int
///     Limit of iterations; least number of points that must have a contour in reach (half of them by default).
/// acceleration : int
///     Depth of Anderson acceleration, 0 for the plain iteration.
/// max_rotation_deg : float
///     Bound of the total rotation.
/// weights : array of shape (n,)
///     One weight a sample.
/// channels : sequence of (GridMap, values, sigma)
///     Further fields measured along the same track; `sigma` is then needed too.
/// interpolation : {'bicubic', 'bilinear'}
///     How the refinement reads the map.
/// map_correlation_m : float
///     Distance over which the map's error is correlated (exponentially); 0 is white; estimated by default.
/// fix_radius_m : float
///     Radius within which a fix is right: `risk` is then the probability to be beyond it. Without it, the probability
///     of the other minima. Either supposes that map and noise are as told; it is not calibrated.
/// max_risk, min_goodness, min_overlap : float
///     Greatest risk and least p-value of a fix; least share of the track on the map.
/// max_candidates : int
///     A larger lattice is refused; 2^32 at most.
///
/// Returns
/// -------
/// Fix
///     `score` is the mean square misfit, with `refine` twice the negative log posterior (without constants).
///
/// Raises
/// ------
/// InvalidInputError, TooFewSamplesError, RankDeficientError, CandidateLimitError
///
/// Notes
/// -----
/// Source: Kamgar-Parsi 1999; Bai and Wang, Computer Simulation 30(6), 2013; Duan, Xiao, Qi, J. Astronautics 2018(2).
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 12000.0, 100.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 900)[None, :] * np.cos(x / 1100)[:, None], x, x)
/// >>> k = np.arange(30.0)
/// >>> readings = grid.sample(3210 + 150 * k, 3875 + 90 * k, interpolation="bicubic")
/// >>> track = geomag.Track(3000 + 150 * k, 4000 + 90 * k, readings)
/// >>> fix = geomag.match_contour(grid, track, starts="grid", refine=True, sigma=0.1, offset_sigma_m=300.0,
/// ...                            heading_sigma_deg=0.5)
/// >>> fix.status, [round(v) for v in fix.offset_m]
/// ('fixed', [210, -125])
#[pyfunction(name = "match_contour")]
#[pyo3(
    signature = (grid, track, *, sigma = None, weights = None, channels = None, **options),
    text_signature = "(grid, track, *, sigma=None, weights=None, channels=None, transform='rigid', radius_m=None, \
        starts='indicated', refine=False, stiffness=0.0, tolerance_m=1.0, max_iterations=300, min_points=None, \
        acceleration=0, max_rotation_deg=None, offset_sigma_m=None, heading_sigma_deg=None, scale_sigma=None, \
        bias_sigma=None, interpolation='bicubic', map_correlation_m=None, min_overlap=0.8, fix_radius_m=None, \
        max_risk=0.01, min_goodness=0.001, half_width_m=None, step_m=None, keep_starts=12, max_candidates=1000000)"
)]
pub fn py_match_contour(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    track: &PyTrack,
    sigma: Option<f64>,
    weights: Option<&Bound<'_, PyAny>>,
    channels: Option<Vec<OtherChannel<'_>>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyRes<PyFix> {
    let track = track.on(py, grid)?;
    let map = level_for("grid", grid, &track)?;
    let options = contour_options(&map, options)?;
    let weights = optional_vector("weights", weights)?;
    let mut others = Vec::new();
    for (i, (grid, values, sigma)) in channels.unwrap_or_default().iter().enumerate() {
        let what = format!("channels[{i}]");
        others.push((level_for(&what, grid, &track)?, vector(&what, values)?, *sigma));
    }
    let units = work(&options, track.len(), 1 + others.len());
    let mut fix = long_call::run(py, units, None, None, |monitor| {
        let mut all = vec![Channel { map: &map, values: track.values(), sigma }];
        all.extend(others.iter().map(|(map, values, sigma)| Channel { map, values, sigma: Some(*sigma) }));
        match_channels_monitored(&all, &track, weights.as_deref(), &options, monitor)
    })?;
    if track.height_m().is_some() && !same_map(grid, &map) {
        fix.heights_m = track.height_m().and_then(extent);
    }
    Ok(fix.into())
}

/// About the nanoseconds that a match takes at worst.
fn work(options: &ContourOptions, samples: usize, channels: usize) -> u64 {
    let (samples, iterations) = (samples as f64, options.max_iterations as f64);
    let (candidates, starts) = match &options.starts {
        Starts::Indicated => (0.0, 1.0),
        Starts::Offsets(offsets) => (0.0, offsets.len() as f64),
        Starts::Grid { half_width_m, step_m, keep, .. } => ((2.0 * half_width_m / step_m + 1.0).powi(2), *keep as f64),
    };
    let refinement = if options.refine { 1000.0 * samples * samples } else { 0.0 };
    (channels as f64 * (samples * (10.0 * candidates + 100.0 * starts * iterations) + starts * refinement)) as u64
}

/// Contour matching over a sliding window: a fix a sample.
///
/// Like a shift register: `length` samples are filled once, then each new sample replaces the oldest and the window is
/// matched at once, starting where the last one ended. Every point is estimated in up to `length` windows; the weighted
/// mean of these, weight 1 / max(mean squared contour distance, floor_m^2), is its delayed, better position.
///
/// Parameters
/// ----------
/// grid : GridMap or MapStack
///     The map; a stack needs `height_m`.
/// length : int
///     Samples in the window.
/// sigma : float, optional
///     Standard deviation of a measured value.
/// floor_m : float
///     Least contour distance that the averaging believes, metres.
/// height_m : float, optional
///     Height of the vehicle above the map's height datum: a map at another one is continued to it, a stack is read at it. Contours
///     are those of one level; samples more than a tenth of a cell from it are refused.
/// **options
///     As for `match_contour` (transform, radius_m, refine, priors, ...); `starts` is for the first window, and after a
///     loss.
///
/// Notes
/// -----
/// Source: Bai and Wang, Computer Simulation 30(6), 2013. The weights printed there are illegible; these are ours.
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 12000.0, 100.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 900)[None, :] * np.cos(x / 1100)[:, None], x, x)
/// >>> window = geomag.SlidingContour(grid, length=20, transform="translation", radius_m=600.0)
/// >>> for k in range(30):
/// ...     true = (3000.0 + 150 * k, 4000.0 + 90 * k)
/// ...     fix = window.update(true[0] - 200, true[1] + 100, grid.sample(*true))
/// >>> fix.status, [round(v / 10) * 10 for v in fix.offset_m], window.settled['number']
/// ('fixed', [200, -100], 9)
#[pyclass(frozen, name = "SlidingContour", module = "geomag")]
pub struct PySlidingContour {
    inner: Shared<SlidingContour>,
    grid: Py<PyAny>,
}

fn point_dict<'py>(py: Python<'py>, p: &AveragedPoint) -> PyRes<Bound<'py, PyDict>> {
    let d = PyDict::new(py);
    d.set_item("number", p.number)?;
    d.set_item("x", p.x)?;
    d.set_item("y", p.y)?;
    d.set_item("estimates", p.estimates)?;
    Ok(d)
}

#[pymethods]
impl PySlidingContour {
    #[new]
    #[pyo3(
        signature = (grid, *, length, sigma = None, floor_m = 10.0, height_m = None, **options),
        text_signature = "(grid, *, length, sigma=None, floor_m=10.0, height_m=None, transform='rigid', radius_m=None, \
            starts='indicated', refine=False, stiffness=0.0, tolerance_m=1.0, max_iterations=300, min_points=None, acceleration=0, \
            max_rotation_deg=None, offset_sigma_m=None, heading_sigma_deg=None, scale_sigma=None, bias_sigma=None, \
            interpolation='bicubic', map_correlation_m=None, min_overlap=0.8, fix_radius_m=None, max_risk=0.01, \
            min_goodness=0.001, half_width_m=None, step_m=None, keep_starts=12, max_candidates=1000000)"
    )]
    fn new(
        grid: &Bound<'_, PyAny>,
        length: usize,
        sigma: Option<f64>,
        floor_m: f64,
        height_m: Option<f64>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyRes<Self> {
        let level = height_m.map(|h| level_at("grid", grid, h)).transpose()?.map(Bound::into_any);
        let grid = level.as_ref().unwrap_or(grid);
        let map = grid_map("grid", grid)?;
        let options = contour_options(&map, options)?;
        let state = SlidingState::new(length, sigma, floor_m, options)?;
        Ok(Self { inner: Shared::new(SlidingContour::new(map, state)), grid: grid.clone().unbind() })
    }

    /// Take one sample: indicated position (map units), measured value, and height where it is known, which must be that of the map.
    /// Returns a `Fix`; `searching` until full.
    #[pyo3(signature = (x, y, value, height_m = None))]
    fn update(&self, py: Python<'_>, x: f64, y: f64, value: f64, height_m: Option<f64>) -> PyRes<PyFix> {
        let step = self.inner.take(py, &Sample { place: [x, y], value, height_m })?;
        Ok(step.fix.unwrap_or_else(|| Fix::none(step.status, 0)).into())
    }

    /// Take the samples of a track one by one. Returns a list of `Fix`.
    fn run(&self, py: Python<'_>, track: &PyTrack) -> PyRes<Vec<PyFix>> {
        let track = track.on(py, self.grid.bind(py))?;
        // Some hundred iterations of a few microseconds a sample.
        let units = track.len() as u64 * 500_000;
        let fixes = long_call::run(py, units, None, None, |monitor| {
            let one = |window: &mut SlidingContour, k: usize| {
                monitor.advance(k as u64, track.len() as u64)?;
                window.take(&Sample::of(&track, k), monitor)
            };
            let all =
                |window: &mut SlidingContour| (0..track.len()).map(|k| one(window, k)).collect::<Result<Vec<_>, _>>();
            self.inner.alone(all)
        })?;
        Ok(fixes.into_iter().filter_map(|step| step.fix).map(PyFix::from).collect())
    }

    /// Begin again: an empty window.
    fn reset(&self, py: Python<'_>) -> PyRes<()> {
        self.inner.begin_again(py)
    }

    /// The sample that left the window last: dict of number, x, y (weighted mean) and estimates; None before.
    #[getter]
    fn settled<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyDict>>> {
        self.inner.with(py, |s| s.state().settled()).map(|p| point_dict(py, &p)).transpose()
    }

    /// Samples in the window, oldest first, each a dict as `settled`.
    #[getter]
    fn averaged<'py>(&self, py: Python<'py>) -> PyRes<Vec<Bound<'py, PyDict>>> {
        self.inner.with(py, |s| s.averaged()).iter().map(|p| point_dict(py, p)).collect()
    }

    /// Samples in a full window.
    #[getter]
    fn length(&self, py: Python<'_>) -> usize {
        self.inner.with(py, |s| s.state().length())
    }

    /// Samples taken so far.
    #[getter]
    fn count(&self, py: Python<'_>) -> usize {
        self.inner.seen(py)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let py = slf.py();
        let bytes = slf.get().inner.saved(py)?;
        Ok((slf.get_type().getattr("_restore")?, (slf.get().grid.clone_ref(py), bytes).into_pyobject(py)?))
    }

    #[staticmethod]
    fn _restore(grid: &Bound<'_, PyAny>, bytes: &[u8]) -> PyRes<Self> {
        let inner = Shared::new(SlidingContour::restore(grid_map("grid", grid)?, bytes)?);
        Ok(Self { inner, grid: grid.clone().unbind() })
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        self.inner.with(py, |s| format!("SlidingContour(length {}, {} samples taken)", s.state().length(), s.seen()))
    }
}
