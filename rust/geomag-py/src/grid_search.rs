//! `match_grid`.

use geomag_core::error::require_positive;
use geomag_core::lattice::{DEFAULT_MAX_CANDIDATES, Pivot};
use geomag_core::matching::grid_search::{GridSearch, match_grid};
use geomag_core::matching::similarity::{Criterion, Robust};
use geomag_core::track::Track;
use pyo3::prelude::*;

use crate::arrays::{optional_vector, vector};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::read_by;
use crate::long_call;
use crate::options::maybe_pair;
use crate::posterior::{Extent, middle};
use crate::stack::field_for;
use crate::track::PyTrack;

fn criterion(
    name: &str,
    track: &Track,
    geographic: bool,
    length_scale_m: Option<f64>,
    value_scale: Option<f64>,
    fraction: f64,
) -> PyRes<Criterion> {
    Ok(match name {
        "msd" => Criterion::Msd,
        "mad" => Criterion::Mad,
        "prod" => Criterion::Prod,
        "ncc" => Criterion::Ncc,
        "hausdorff" => Criterion::hausdorff(track, geographic, length_scale_m, value_scale, fraction),
        other => return Err(invalid("criterion", "'msd', 'mad', 'prod', 'ncc' or 'hausdorff'", format!("'{other}'"))),
    })
}

fn robust(name: Option<&str>, scale: Option<f64>, nu: f64) -> PyRes<Option<Robust>> {
    let needed = || invalid("robust_scale", "a scale in value units with robust=", "None");
    Ok(match name {
        None => None,
        Some("huber") => Some(Robust::Huber { threshold: scale.ok_or_else(needed)? }),
        Some("student_t") => Some(Robust::StudentT { nu, scale: scale.ok_or_else(needed)? }),
        Some(other) => return Err(invalid("robust", "None, 'huber' or 'student_t'", format!("'{other}'"))),
    })
}

/// Search a lattice of offsets (and headings, and scales) with a similarity measure.
///
/// For a whole track at once, on any map. Not for a declared risk: its `ambiguous` is a likelihood ratio, not a
/// calibrated probability; see `match_posterior`.
///
/// Parameters
/// ----------
/// grid : GridMap, MapStack or HarmonicMap
///     The stored map.
/// track : Track
///     Indicated positions and measured values.
/// criterion : {'msd', 'mad', 'prod', 'ncc', 'hausdorff'}
///     Mean square difference, mean absolute difference, product correlation about the map's mean, normalised
///     cross-correlation, (partial) Hausdorff distance.
/// half_width : float or (float, float), optional
///     Half size of the search (x, y), map units; more than 0 along one of them. This or `half_width_m` is needed.
/// half_width_m : float or (float, float), optional
///     The same (east, north) in metres; on a map in degrees at the middle latitude of the track.
/// step : float or (float, float), optional
///     Lattice step, map units; the map spacing by default. Whole fractions of the spacing are fast.
/// step_m : float or (float, float), optional
///     The same in metres.
/// heading_deg, scale : sequence of float
///     Heading corrections (degrees, clockwise) and scale corrections to try.
/// pivot : {'newest', 'centroid'}
///     Point about which they turn the track; the fix is for the newest point either way.
/// remove_mean : bool
///     Take out a constant: the mean for 'msd', the median for 'mad' (and for robust losses).
/// weights : array of shape (n,), optional
///     One weight a sample. A sample of weight zero is as if it had not been measured; its position alone remains.
/// robust : {None, 'huber', 'student_t'}
///     Loss in place of the square.
/// robust_scale : float, optional
///     Where it bends, value units; needed with `robust`.
/// nu : float
///     Degrees of freedom of 'student_t'.
/// length_scale_m, value_scale, fraction : float
///     Hausdorff: metres and value units that count as one (the mean sample spacing and the spread of the values by
///     default), and the quantile of the point-to-set distances.
/// interpolation : {'bilinear', 'bicubic'}
///     How the map is read.
/// min_overlap : float
///     Share of the samples that a candidate must have on the map.
/// sigma : float, optional
///     Standard deviation of a measured value with the map's error; estimated from the best fit by default.
/// ambiguity : float
///     The answer is `ambiguous` where a place two cells away or more has more than this share of its likelihood.
/// refine : bool
///     Refine the best offset below the lattice step.
/// surface : bool
///     Return the score surface with the fix.
/// max_candidates : int
///     A larger search is refused before memory is taken; a lattice of more than 2^31 offsets always is. 8 bytes each.
/// threads : int, optional
///     Threads to use, 1 to 512, all cores by default; the answer does not depend on it.
/// progress : bool or callable, optional
///     True for a bar, or a callable (done, total).
/// method : {'bilinear', 'bicubic'}, optional
///     Old name of `interpolation`; it warns.
///
/// Returns
/// -------
/// Fix
///     Its status is `lost` where no candidate brings the track onto the map.
///
/// Raises
/// ------
/// InvalidInputError, TooFewSamplesError, CandidateLimitError
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 6000.0, 50.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x)
/// >>> k = np.arange(30.0)
/// >>> track = geomag.Track(1000 + 90 * k, 2000 + 40 * k, grid.sample(1210 + 90 * k, 1875 + 40 * k))
/// >>> fix = geomag.match_grid(grid, track, criterion="msd", half_width=500)
/// >>> fix.status, [round(v) for v in fix.offset_m]
/// ('fixed', [210, -125])
#[pyfunction(name = "match_grid")]
#[pyo3(signature = (grid, track, criterion = "msd", *, half_width = None, half_width_m = None, step = None, step_m = None, heading_deg = None, scale = None,
                    pivot = "newest", remove_mean = false, weights = None, robust = None, robust_scale = None,
                    nu = 3.0, length_scale_m = None, value_scale = None, fraction = 1.0, interpolation = "bilinear",
                    min_overlap = 0.8, sigma = None, ambiguity = 0.01, refine = true, surface = false,
                    max_candidates = DEFAULT_MAX_CANDIDATES, threads = None, progress = None, method = None))]
#[allow(clippy::too_many_arguments)] // one each, keyword-only
pub fn py_match_grid(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    track: &PyTrack,
    criterion: &str,
    half_width: Option<Py<PyAny>>,
    half_width_m: Option<Py<PyAny>>,
    step: Option<Py<PyAny>>,
    step_m: Option<Py<PyAny>>,
    heading_deg: Option<&Bound<'_, PyAny>>,
    scale: Option<&Bound<'_, PyAny>>,
    pivot: &str,
    remove_mean: bool,
    weights: Option<&Bound<'_, PyAny>>,
    robust: Option<&str>,
    robust_scale: Option<f64>,
    nu: f64,
    length_scale_m: Option<f64>,
    value_scale: Option<f64>,
    fraction: f64,
    interpolation: &str,
    min_overlap: f64,
    sigma: Option<f64>,
    ambiguity: f64,
    refine: bool,
    surface: bool,
    max_candidates: u64,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    method: Option<&str>,
) -> PyRes<PyFix> {
    check_unused(length_scale_m, value_scale, fraction, robust_scale, nu)?;
    let samples = &*track.on(py, grid)?;
    let field = field_for(grid, [samples])?;
    let weights = optional_vector("weights", weights)?;
    let measured = samples.weighted(weights.as_deref())?;
    let extent = Extent {
        half_width: maybe_pair(py, "half_width", half_width.as_ref())?,
        half_width_m: maybe_pair(py, "half_width_m", half_width_m.as_ref())?,
        step_m: maybe_pair(py, "step_m", step_m.as_ref())?,
    };
    let step = maybe_pair(py, "step", step.as_ref())?;
    let (half_width, step) = extent.check(step)?.in_units(&*field, middle([samples]), step);
    let search = GridSearch {
        criterion: self::criterion(criterion, &measured, field.geographic(), length_scale_m, value_scale, fraction)?,
        half_width,
        step,
        heading_deg: heading_deg.map_or(Ok(vec![0.0]), |h| vector("heading_deg", h))?,
        scale: scale.map_or(Ok(vec![1.0]), |s| vector("scale", s))?,
        pivot: self::pivot(pivot)?,
        remove_mean,
        weights,
        robust: self::robust(robust, robust_scale, nu)?,
        interpolation: read_by(py, interpolation, method)?,
        min_overlap,
        sigma,
        ambiguity,
        refine,
        surface,
        max_candidates,
    };
    let spacing = field.spacing();
    let cells: f64 = (0..2).map(|d| 2.0 * search.half_width[d] / search.step.unwrap_or(spacing)[d] + 1.0).product();
    let units = cells * samples.len() as f64 * (search.heading_deg.len() * search.scale.len()) as f64;
    let fix =
        long_call::run(py, units as u64, threads, progress, |monitor| match_grid(&*field, samples, &search, monitor))?;
    Ok(fix.into())
}

/// Refuses nonsense in options of other criteria as well: whoever gave it expects it to act.
fn check_unused(
    length_scale_m: Option<f64>,
    value_scale: Option<f64>,
    fraction: f64,
    robust_scale: Option<f64>,
    nu: f64,
) -> PyRes<()> {
    let given = [("length_scale_m", length_scale_m), ("value_scale", value_scale), ("robust_scale", robust_scale)];
    for (what, number) in given.into_iter().chain([("nu", Some(nu))]) {
        number.map(|number| require_positive(what, number)).transpose()?;
    }
    if !(fraction > 0.0 && fraction <= 1.0) {
        return Err(invalid("fraction", "a number in (0, 1]", fraction));
    }
    Ok(())
}

/// Reads the name of a pivot.
pub fn pivot(name: &str) -> PyRes<Pivot> {
    match name {
        "newest" => Ok(Pivot::Newest),
        "centroid" => Ok(Pivot::Centroid),
        other => Err(invalid("pivot", "'newest' or 'centroid'", format!("'{other}'"))),
    }
}
