//! `closest_contour_point`, `fit_transform`, `match_contour`, `SlidingContour`; the signatures and docstrings of the last two from the core's
//! tables of options.

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
use geomag_core::matching::starts::{StartLattice, Starts};
use geomag_core::matching::stream::{Sample, Stream};
use geomag_core::matching::transform::{Transform, TransformKind};
use geomag_core::stack::extent;
use geomag_core::{common_options, contour_options, motion_prior_options, refine_options, starts_options};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{broadcast, matrix, optional_vector, shaped, vector};
use crate::class::{Reduced, reduced};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::PyGridMap;
use crate::lock::Shared;
use crate::long_call;
use crate::options::old_name;
use crate::posterior::{PyAcceptance, PyInsPrior, PySearchBox, limit, merge};
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

/// What is told of a contour match, as it is given.
struct Told {
    contour: ContourOptions,
    starts: Option<Py<PyAny>>,
    lattice: StartLattice,
    parts: Parts,
    /// Old name of the refinement's tolerance.
    fix_radius_m: Option<f64>,
}

/// The parts of a call that stand for keywords of the same names.
struct Parts {
    search: Option<Py<PySearchBox>>,
    prior: Option<Py<PyInsPrior>>,
    accept: Option<Py<PyAcceptance>>,
}

impl Told {
    /// The options for a map: parts in their places, starts laid out.
    fn options(mut self, py: Python<'_>, map: &GridMap) -> PyRes<ContourOptions> {
        if let Some(radius) = self.fix_radius_m {
            old_name(py, "fix_radius_m", "tolerance_m")?;
            self.contour.refinement.tolerance_m = Some(radius);
        }
        if self.contour.refinement.tolerance_m.is_some() && !self.contour.refine {
            let text = c"tolerance_m= is what counts as wrong, of which the iteration alone says nothing: needed refine=True. \
                         Where the iteration ends is converged_m=";
            PyErr::warn(py, &py.get_type::<pyo3::exceptions::PyUserWarning>(), text, 1)?;
        }
        self.take(map)?;
        let mut o = self.contour;
        if let Some(given) = self.starts.as_ref().map(|s| s.bind(py)) {
            let name = given.extract::<String>().ok();
            o.starts = match name.as_deref() {
                Some("indicated") => Starts::Indicated,
                Some("grid") => lattice_of_starts(map, &o, self.lattice)?,
                Some(other) => {
                    return Err(invalid(
                        "starts",
                        "'indicated', 'grid' or offsets (n, 2) in metres",
                        format!("'{other}'"),
                    ));
                }
                None => Starts::Offsets(points_in("starts", given)?),
            };
        }
        o.check()?;
        Ok(o)
    }

    /// Puts what the parts say in its place; what contours cannot do is refused.
    fn take(&mut self, map: &GridMap) -> PyRes<()> {
        let unlike = |name: &str, given: bool, why: &str| if given { Err(invalid(name, why, "one")) } else { Ok(()) };
        if let Some(part) = self.parts.search.as_ref().map(|p| p.get().inner) {
            let metres = |units: [f64; 2]| {
                let [east, north] = metres_at_middle(map);
                [units[0] * east, units[1] * north]
            };
            // The lattice of starts is a square: the one that holds the box, as fine as its finer step.
            let side = part.half_width_m.or(part.half_width.map(metres)).map(|[x, y]| x.max(y));
            let step = part.step_m.or(part.step.map(metres)).map(|[x, y]| x.min(y));
            let lattice = &mut self.lattice;
            lattice.half_width_m = merge("half_width_m", "search", lattice.half_width_m, side, None)?;
            lattice.step_m = merge("step_m", "search", lattice.step_m, step, None)?;
            lattice.max_candidates = limit(&part, lattice.max_candidates, StartLattice::DEFAULT.max_candidates)?;
        }
        let refinement = &mut self.contour.refinement;
        if let Some(part) = self.parts.prior.as_ref().map(|p| p.get().inner) {
            let why = "none with contours, which move the track as one body";
            unlike("prior drift_sigma_m", part.drift_sigma_m != 0.0, why)?;
            unlike("prior position_sigma_m", part.position_sigma_m != 0.0, why)?;
            let told = |sigma: f64| (sigma != 0.0).then_some(sigma);
            let priors = &mut refinement.priors;
            let heading = told(part.heading_sigma_deg);
            priors.heading_sigma_deg = merge("heading_sigma_deg", "prior", priors.heading_sigma_deg, heading, None)?;
            priors.scale_sigma = merge("scale_sigma", "prior", priors.scale_sigma, told(part.scale_sigma), None)?;
        }
        if let Some(part) = self.parts.accept.as_ref().map(|p| p.get().inner) {
            unlike(
                "accept misfit_threshold",
                part.misfit_threshold.is_some(),
                "none with contours, which test no effects",
            )?;
            let r = RefineOptions::default();
            refinement.tolerance_m = merge("tolerance_m", "accept", refinement.tolerance_m, part.tolerance_m, None)?;
            refinement.max_risk = merge("max_risk", "accept", refinement.max_risk, part.max_risk, r.max_risk)?;
            refinement.min_goodness =
                merge("min_goodness", "accept", refinement.min_goodness, part.min_goodness, r.min_goodness)?;
            refinement.min_overlap =
                merge("min_overlap", "accept", refinement.min_overlap, part.min_overlap, r.min_overlap)?;
        }
        Ok(())
    }
}

/// Metres of a map unit at the middle of a map.
fn metres_at_middle(map: &GridMap) -> [f64; 2] {
    map.metres_per_unit(0.5 * (map.y().first() + map.y().last()))
}

fn lattice_of_starts(map: &GridMap, o: &ContourOptions, told: StartLattice) -> PyRes<Starts> {
    let sigma = o.refinement.priors.offset_sigma_m;
    let half_width_m = told
        .half_width_m
        .or(sigma.filter(|s| s.is_finite()).map(|s| 3.0 * s))
        .or(Some(o.radius_m).filter(|r| r.is_finite()))
        .ok_or_else(|| {
            invalid("starts='grid'", "half_width_m, offset_sigma_m or radius_m to know how far to look", "none")
        })?;
    let [east, north] = metres_at_middle(map);
    let cell = (map.x().step() * east).min(map.y().step() * north);
    let step_m = told.step_m.unwrap_or(cell.max(half_width_m / 40.0).min(half_width_m));
    Ok(Starts::Grid { half_width_m, step_m, keep: told.keep_starts, max_candidates: told.max_candidates })
}

/// Another field along the track: map, measured values, sigma.
type OtherChannel<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, f64);

/// The value of an option of the iteration: where to start is laid out once the map is known.
macro_rules! contour_value {
    ($py:ident starts $name:ident) => {
        Starts::Indicated
    };
    ($py:ident $kind:ident $name:ident) => {
        py_value!($py $kind $name)
    };
}

/// Where to start, as it is given: the first option of that kind.
macro_rules! starts_given {
    ([starts $name:ident] $($rest:tt)*) => { $name };
    ([$kind:ident $name:ident] $($rest:tt)*) => { starts_given!($($rest)*) };
}

macro_rules! contour_calls {
    (
        extent $extent:tt overlap [$($overlap:tt)*] iteration $iteration:tt lattice $lattice:tt prior $prior:tt refinement [$($refinement:tt)*]
    ) => {
        contour_calls! { $iteration $lattice $prior [$($refinement)* $($overlap)*] }
    };
    (
        [$(($step:ident: $step_kind:ident = $step_default:tt; $step_python:literal; $($step_line:literal)+))*]
        [$(($start:ident: $start_kind:ident = $start_default:tt; $start_python:literal; $($start_line:literal)+))*]
        [$(($known:ident: $known_kind:ident = $known_default:tt; $known_python:literal; $($known_line:literal)+))*]
        [$(($refined:ident: $refined_kind:ident = $refined_default:tt; $refined_python:literal; $($refined_line:literal)+))*]
    ) => {
        /// What the keywords of a call say.
        #[allow(clippy::too_many_arguments)] // one each
        fn told(
            $($step: py_type!($step_kind),)*
            $($start: py_type!($start_kind),)*
            $($known: py_type!($known_kind),)*
            $($refined: py_type!($refined_kind),)*
            search: Option<Py<PySearchBox>>,
            prior: Option<Py<PyInsPrior>>,
            accept: Option<Py<PyAcceptance>>,
            fix_radius_m: Option<f64>,
        ) -> PyRes<Told> {
            Ok(Told {
                starts: starts_given!($([$step_kind $step])*),
                lattice: StartLattice { $($start: py_value!(py $start_kind $start),)* },
                contour: ContourOptions {
                    $($step: contour_value!(py $step_kind $step),)*
                    refinement: RefineOptions {
                        priors: Priors { $($known: py_value!(py $known_kind $known),)* },
                        $($refined: py_value!(py $refined_kind $refined),)*
                        ..RefineOptions::default()
                    },
                },
                parts: Parts { search, prior, accept },
                fix_radius_m,
            })
        }

        /// Move the indicated track, as one body, onto the contours of its measured values (ICCP).
        ///
        /// For smooth maps and an INS error of a few cells. By default ICCP to the letter: it converges to the nearest minimum
        /// and has no covariance. With ``starts='grid', refine=True`` and the INS's own accuracy as priors it is the recommended
        /// pipeline: a lattice of starts, then Gauss-Newton on the misfit of map against measured value, with covariance,
        /// goodness and risk. Not for a calibrated risk on real surveys: see ``match_posterior``.
        ///
        /// Parameters
        /// ----------
        /// grid : GridMap or MapStack
        ///     The map.
        #[doc = shared_doc!(track)]
        /// sigma : float, optional
        ///     Standard deviation of a measured value, value units; estimated from the residuals where it is needed and missing. The
        ///     ``sigma`` of the map is used by the refinement beside it.
        /// weights : array of shape (n,), optional
        ///     One weight a sample of the track.
        #[doc = shared_doc!(channels)]
        $(#[doc = row_doc!($step; $step_python; $($step_line)+)])*
        $(#[doc = row_doc!($start; $start_python; $($start_line)+)])*
        $(#[doc = row_doc!($known; $known_python; $($known_line)+)])*
        $(#[doc = row_doc!($refined; $refined_python; $($refined_line)+)])*
        #[doc = shared_doc!(parts)]
        /// fix_radius_m : float, optional
        ///     Old name of `tolerance_m`; it warns.
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
        /// Priors bound ICCP's transform too. With further channels `sigma` is needed. Of a `search` the square that holds it is the lattice of
        /// starts.
        ///
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
        #[pyo3(signature = (grid, track, *, sigma = None, weights = None, channels = None,
            $($step = $step_default,)* $($start = $start_default,)* $($known = $known_default,)*
            $($refined = $refined_default,)* search = None, prior = None, accept = None, fix_radius_m = None))]
        #[allow(clippy::too_many_arguments)] // one each, keyword-only
        pub fn py_match_contour(
            py: Python<'_>,
            grid: &Bound<'_, PyAny>,
            track: &PyTrack,
            sigma: Option<f64>,
            weights: Option<&Bound<'_, PyAny>>,
            channels: Option<Vec<OtherChannel<'_>>>,
            $($step: py_type!($step_kind),)*
            $($start: py_type!($start_kind),)*
            $($known: py_type!($known_kind),)*
            $($refined: py_type!($refined_kind),)*
            search: Option<Py<PySearchBox>>,
            prior: Option<Py<PyInsPrior>>,
            accept: Option<Py<PyAcceptance>>,
            fix_radius_m: Option<f64>,
        ) -> PyRes<PyFix> {
            let told = told($($step,)* $($start,)* $($known,)* $($refined,)* search, prior, accept, fix_radius_m)?;
            matched(py, grid, track, sigma, weights, channels, |map| told.options(py, map))
        }

        /// The options of `match_contour` for a map, made once: what a campaign hands on.
        #[pyfunction(name = "_contour_settings")]
        #[pyo3(signature = (grid, *, $($step = $step_default,)* $($start = $start_default,)* $($known = $known_default,)*
            $($refined = $refined_default,)* search = None, prior = None, accept = None, fix_radius_m = None))]
        #[allow(clippy::too_many_arguments)] // one each, keyword-only
        pub fn contour_settings(
            py: Python<'_>,
            grid: &Bound<'_, PyAny>,
            $($step: py_type!($step_kind),)*
            $($start: py_type!($start_kind),)*
            $($known: py_type!($known_kind),)*
            $($refined: py_type!($refined_kind),)*
            search: Option<Py<PySearchBox>>,
            prior: Option<Py<PyInsPrior>>,
            accept: Option<Py<PyAcceptance>>,
            fix_radius_m: Option<f64>,
        ) -> PyRes<PyContourSettings> {
            let told = told($($step,)* $($start,)* $($known,)* $($refined,)* search, prior, accept, fix_radius_m)?;
            let map = grid_map("grid", grid)?;
            Ok(PyContourSettings { inner: told.options(py, &map)? })
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
        $(#[doc = row_doc!($step; $step_python; $($step_line)+)])*
        $(#[doc = row_doc!($start; $start_python; $($start_line)+)])*
        $(#[doc = row_doc!($known; $known_python; $($known_line)+)])*
        $(#[doc = row_doc!($refined; $refined_python; $($refined_line)+)])*
        #[doc = shared_doc!(parts)]
        /// fix_radius_m : float, optional
        ///     Old name of `tolerance_m`; it warns.
        ///
        /// Notes
        /// -----
        /// `starts` is for the first window, and after a loss.
        ///
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

        #[pymethods]
        impl PySlidingContour {
            #[new]
            #[pyo3(signature = (grid, *, length, sigma = None, floor_m = 10.0, height_m = None,
            $($step = $step_default,)* $($start = $start_default,)* $($known = $known_default,)*
            $($refined = $refined_default,)* search = None, prior = None, accept = None, fix_radius_m = None))]
            #[allow(clippy::too_many_arguments)] // one each, keyword-only
            fn new(
            py: Python<'_>,
            grid: &Bound<'_, PyAny>,
            length: usize,
            sigma: Option<f64>,
            floor_m: f64,
            height_m: Option<f64>,
            $($step: py_type!($step_kind),)*
            $($start: py_type!($start_kind),)*
            $($known: py_type!($known_kind),)*
            $($refined: py_type!($refined_kind),)*
            search: Option<Py<PySearchBox>>,
            prior: Option<Py<PyInsPrior>>,
            accept: Option<Py<PyAcceptance>>,
            fix_radius_m: Option<f64>,
            ) -> PyRes<Self> {
            let told = told($($step,)* $($start,)* $($known,)* $($refined,)* search, prior, accept, fix_radius_m)?;
                let level = height_m.map(|h| level_at("grid", grid, h)).transpose()?.map(Bound::into_any);
                let grid = level.as_ref().unwrap_or(grid);
                let map = grid_map("grid", grid)?;
                let state = SlidingState::new(length, sigma, floor_m, told.options(py, &map)?)?;
                Ok(Self { inner: Shared::new(SlidingContour::new(map, state)), grid: grid.clone().unbind() })
            }

            /// Take one sample: indicated position (map units), measured value, and height where it is known, which must be that of the map.
            /// Returns a `Fix`; `searching` until full.
            #[pyo3(signature = (x, y, value, height_m = None))]
            fn update(&self, py: Python<'_>, x: f64, y: f64, value: f64, height_m: Option<f64>) -> PyRes<PyFix> {
                let units = self.inner.with(py, |s| s.state().most_work());
                let step = self.inner.take(py, units, &Sample { place: [x, y], value, height_m })?;
                Ok(step.fix.unwrap_or_else(|| Fix::none(step.status, 0)).into())
            }

            /// Take the samples of a track one by one. Returns a list of `Fix`.
            fn run(&self, py: Python<'_>, track: &PyTrack) -> PyRes<Vec<PyFix>> {
                let track = track.on(py, self.grid.bind(py))?;
                let units = self.inner.with(py, |s| s.state().most_work()).saturating_mul(track.len() as u64);
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

            fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
                let (py, this) = (slf.py(), slf.get());
                reduced(slf, (this.grid.clone_ref(py), this.inner.saved(py)?))
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
    };
}

common_options!(contour_options starts_options motion_prior_options refine_options contour_calls);

/// Options of `match_contour` for a map.
#[pyclass(frozen, name = "_ContourSettings", module = "geomag")]
pub struct PyContourSettings {
    pub inner: ContourOptions,
}

fn matched(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    track: &PyTrack,
    sigma: Option<f64>,
    weights: Option<&Bound<'_, PyAny>>,
    channels: Option<Vec<OtherChannel<'_>>>,
    options: impl FnOnce(&GridMap) -> PyRes<ContourOptions>,
) -> PyRes<PyFix> {
    let track = track.on(py, grid)?;
    let map = level_for("grid", grid, &track)?;
    let options = options(&map)?;
    let weights = optional_vector("weights", weights)?;
    let mut others = Vec::new();
    for (i, (grid, values, sigma)) in channels.unwrap_or_default().iter().enumerate() {
        let what = format!("channels[{i}]");
        others.push((level_for(&what, grid, &track)?, vector(&what, values)?, *sigma));
    }
    let units = work(&options, track.len(), 1 + others.len());
    let mut fix = long_call::run(py, units, None, None, |monitor| {
        let mut all = vec![Channel { field: &*map, values: track.values(), sigma }];
        all.extend(others.iter().map(|(map, values, sigma)| Channel { field: &**map, values, sigma: Some(*sigma) }));
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

fn point_dict<'py>(py: Python<'py>, p: &AveragedPoint) -> PyRes<Bound<'py, PyDict>> {
    let d = PyDict::new(py);
    d.set_item("number", p.number)?;
    d.set_item("x", p.x)?;
    d.set_item("y", p.y)?;
    d.set_item("estimates", p.estimates)?;
    Ok(d)
}
