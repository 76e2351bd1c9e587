//! Iterated closest contour point: ICCP (Kamgar-Parsi 1999; Bai and Wang 2013; Duan, Xiao and Qi 2018).
//!
//! Every true position lies on the contour of its measured value. The indicated track is moved as one body onto those
//! contours: closest points, closed-form transform, again until the points rest.

mod anderson;
mod constrained;
mod iccp;
mod options;

pub(crate) use iccp::{End, Iccp, motion_of};
pub use options::ContourOptions;

use crate::error::Result;
use crate::fix::{Fix, Status};
use crate::grid::GridMap;
use crate::matching::refine::answer;
use crate::matching::scene::{Channel, Motion, Scene};
use crate::matching::starts::Starts;
use crate::matching::transform::Transform;
use crate::monitor::{Monitor, Quiet};
use crate::track::Track;
use iccp::Converged;

/// ICCP of one map: the indicated track moved onto the contours of its measured values.
///
/// `sigma` is the standard deviation of the measured values, map units, where it is known; it weighs the priors and the
/// refinement. The answer has a covariance, a goodness and a risk only with [`ContourOptions::refine`].
///
/// # Errors
/// Bad options ([`ContourOptions::check`]), a negative sigma, a track of fewer points than the transform needs
/// ([`Error::TooFewSamples`](crate::error::Error::TooFewSamples)), a straight track under an affine transform
/// ([`Error::RankDeficient`](crate::error::Error::RankDeficient)). Finding no contour is a status of the fix.
///
/// ```
/// use geomag_core::grid::{GridMap, GridValues, Interpolation};
/// use geomag_core::matching::contour::{ContourOptions, match_contour};
/// use geomag_core::matching::transform::TransformKind;
/// use geomag_core::track::Track;
/// let axis: Vec<f64> = (0..61).map(|i| 100.0 * f64::from(i)).collect();
/// let field = |x: f64, y: f64| 50.0 * (x / 700.0).sin() + 40.0 * (y / 900.0).cos();
/// let values = axis.iter().flat_map(|&y| axis.iter().map(move |&x| field(x, y))).collect();
/// let map = GridMap::new(GridValues::F64(values), &axis, &axis, false)?;
/// let truth: Vec<[f64; 2]> = (0..20).map(|k| [1500.0 + 150.0 * f64::from(k), 2000.0 + 90.0 * f64::from(k)]).collect();
/// let track = Track::new(
///     truth.iter().map(|p| p[0] - 120.0).collect(),
///     truth.iter().map(|p| p[1] + 80.0).collect(),
///     truth.iter().map(|p| map.sample(p[0], p[1], Interpolation::Bilinear)).collect(),
///     None,
/// )?;
/// let options =
///     ContourOptions { transform: TransformKind::Translation, converged_m: 0.001, max_iterations: 3000, ..Default::default() };
/// let fix = match_contour(&map, &track, None, &options)?;
/// assert!(fix.ok() && (fix.offset_m[0] - 120.0).abs() < 5.0 && (fix.offset_m[1] + 80.0).abs() < 5.0);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
pub fn match_contour(map: &GridMap, track: &Track, sigma: Option<f64>, options: &ContourOptions) -> Result<Fix> {
    match_channels(&[Channel { field: map, values: track.values(), sigma }], track, None, options)
}

/// ICCP of several fields at once, weighted by their noise, with a weight a sample.
///
/// The positions come from `track`; its own values are not used, each channel brings its own. The closest points of a
/// sample on all its contours pull together, each with the inverse variance of a contour's place: (rms gradient along
/// the track / sigma)^2. With one channel that weight is 1.
///
/// # Errors
/// As [`match_contour`]; besides, channels and weights that do not fit the track, and several channels of which one has
/// no sigma.
pub fn match_channels(
    channels: &[Channel<'_, GridMap>],
    track: &Track,
    weights: Option<&[f64]>,
    options: &ContourOptions,
) -> Result<Fix> {
    match_channels_monitored(channels, track, weights, options, &Quiet)
}

/// [`match_channels`] that can be watched and stopped.
///
/// # Errors
/// As [`match_channels`], and [`Error::Interrupted`](crate::error::Error::Interrupted).
pub fn match_channels_monitored(
    channels: &[Channel<'_, GridMap>],
    track: &Track,
    weights: Option<&[f64]>,
    options: &ContourOptions,
    monitor: &dyn Monitor,
) -> Result<Fix> {
    options.check()?;
    let scene = Scene::new(channels, track, weights)?;
    let matcher = Iccp::new(&scene, options)?;
    let n = scene.len();
    let starts = options.starts.offsets(&scene, &options.judgement(n), monitor)?;
    if options.refine
        && let Starts::Grid { half_width_m, .. } = options.starts
    {
        // After a search of the lattice the contours have nothing to add: the misfit itself is minimised from there.
        let motions: Vec<Motion> = starts.iter().map(|&o| Motion::offset(o)).collect();
        return answer(&scene, &options.effective_refinement(), &motions, 0, Some(half_width_m), monitor);
    }
    let outcomes = starts
        .iter()
        .map(|&start| matcher.run(Transform { shift: start, ..Transform::IDENTITY }, monitor))
        .collect::<Result<Vec<Converged>>>()?;
    let Some(best) = winner(&outcomes) else {
        return Ok(Fix::none(Status::Lost, n));
    };
    if options.refine {
        let motions: Vec<Motion> =
            outcomes.iter().filter(|o| o.end != End::OutOfReach).map(|o| motion_of(&o.transform)).collect();
        return answer(&scene, &options.effective_refinement(), &motions, outcomes[best].iterations, None, monitor);
    }
    Ok(matcher.fix(&outcomes, best))
}

/// The outcome of least misfit; those out of reach only where there is no other.
pub(crate) fn winner(outcomes: &[Converged]) -> Option<usize> {
    (0..outcomes.len()).min_by(|&a, &b| {
        let key = |i: usize| (outcomes[i].end == End::OutOfReach, outcomes[i].misfit.unwrap_or(f64::INFINITY));
        let ((la, ma), (lb, mb)) = (key(a), key(b));
        la.cmp(&lb).then(ma.total_cmp(&mb)).then(a.cmp(&b))
    })
}
