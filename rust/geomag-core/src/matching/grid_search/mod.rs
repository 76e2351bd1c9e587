//! Grid search: every offset of a lattice (and every heading and scale asked for) scored with a similarity measure.

mod descent;
mod local_fit;
mod options;

pub use options::GridSearch;

use std::ops::Range;

use crate::error::Result;
use crate::field::Field;
use crate::fix::{Fix, Status, Surface};
use crate::lattice::{BestTwo, Comparison, OffsetLattice, place_track};
use crate::monitor::Monitor;
use crate::stack::{read_heights, served};
use crate::track::Track;
use descent::{Best, Descent, Refined};
use local_fit::LocalFit;

/// Levels of refinement that tell whether a runner-up may be as good as the best.
const ROUGHLY: usize = 2;
/// Share of its lattice score below which a runner-up is refined to the end.
const FALL: f64 = 0.25;

/// Residuals less likely than this under the caller's own sigma are no fit, however much worse every other place is.
const REJECT: f64 = 1e-6;

/// Finds the offset (and heading, and scale) under which the measured sequence fits the map best.
///
/// The best offset is refined to the minimum of the score beside it, as the map is read. The covariance is Gauss-Newton's: noise over
/// curvature, with the map's gradient along the matched track; measures without a noise model (product, Hausdorff) have
/// none. The status is `at_edge` where the best lies on the border of the search, `ambiguous` where a place
/// two map cells away or more fits nearly as well (see [`GridSearch::ambiguity`]), `uninformative` where the field is too flat, `rejected`
/// where sigma is given and the residuals of a mean square difference are far beyond it.
/// None of this is a calibrated risk.
///
/// A track that no candidate brings onto the map is `lost`.
///
/// # Errors
/// [`Error::Invalid`](crate::error::Error::Invalid) for options out of range, [`Error::TooManyCandidates`](crate::error::Error::TooManyCandidates), [`Error::TooFewSamples`](crate::error::Error::TooFewSamples), [`Error::Interrupted`](crate::error::Error::Interrupted).
pub fn match_grid(field: &dyn Field, track: &Track, search: &GridSearch, monitor: &dyn Monitor) -> Result<Fix> {
    search.check(field.geographic(), track)?;
    let served = served(field, track)?;
    let mut fix = search_served(served.field(), track, search, monitor)?;
    fix.heights_m = read_heights(&[served], track);
    Ok(fix)
}

#[allow(clippy::too_many_lines)] // the stages of one search, in their order
fn search_served(field: &dyn Field, track: &Track, search: &GridSearch, monitor: &dyn Monitor) -> Result<Fix> {
    let spacing = field.spacing();
    let step = search.step.unwrap_or(spacing);
    let placements: Vec<(f64, f64)> =
        search.heading_deg.iter().flat_map(|&h| search.scale.iter().map(move |&s| (h, s))).collect();
    let lattice =
        OffsetLattice::new(search.half_width, step, search.max_candidates / (placements.len() as u64).max(1))?;
    let scoring = search.scoring();
    let (measured, weights) = (track.weighted(search.weights.as_deref())?, search.their_weights());
    let distance_m = measured.distance_m(field.geographic());
    let min_samples =
        ((search.min_overlap * measured.len() as f64 - 1e-9).ceil() as usize).max(scoring.least_samples());
    let compare = |placement: usize, interpolation| {
        let (heading, scale) = placements[placement];
        let points = place_track(field, track, heading, scale, search.pivot);
        let points = search.counting(points.len()).map(|k| points[k]).collect();
        let values = measured.values().to_vec();
        Comparison::new(field, lattice, points, values, weights.clone(), interpolation, min_samples)?
            .at_heights(measured.height_m())
    };

    let away: [f64; 2] = std::array::from_fn(|d| (2.0 * spacing[d] / step[d] - 1e-9).max(1.0));
    let contest = BestTwo::new(away);
    let wanted = (!search.surface).then_some(&contest);
    let (mut surface, chosen) = search_surface(&placements, &lattice, monitor, |placement, part| {
        let comparison = compare(placement, search.interpolation)?;
        scoring.scores(&comparison, field.mean(), &distance_m, 0..lattice.rows(), 0..lattice.columns(), wanted, part)
    })?;
    let columns = lattice.columns();
    let Some(best) = least(&surface, columns, [0..0, 0..0]) else {
        return Ok(no_score(field, &measured, search, &lattice));
    };
    let placed = |b: Best| {
        let placement = chosen.get(b.row * columns + b.column).map_or(0, |&p| p as usize);
        Best { placement, ..b }
    };
    let best = placed(best);
    let near = [around(best.row, away[1], lattice.rows()), around(best.column, away[0], columns)];
    let runner_up = least(&surface, columns, near);

    let edge = lattice.on_border(best.row, best.column);
    let descend = |placement: usize, from: [f64; 2], levels: usize| -> Result<Refined> {
        let comparison = compare(placement, search.interpolation)?;
        let descent =
            Descent { scoring: &scoring, comparison: &comparison, mean: field.mean(), distance_m: &distance_m };
        descent.from(from, placement, levels, monitor)
    };
    let refine = |candidate: Best, most: usize| {
        let border = lattice.on_border(candidate.row, candidate.column);
        let levels = if border { 0 } else { search.levels().min(most) };
        descend(candidate.placement, lattice.offset(candidate.row, candidate.column), levels)
    };
    // A heading chosen at an offset that is off by half a step makes up for that: offsets refined, the ones beside it are asked.
    let turn = |mut at: Refined| -> Result<Refined> {
        if edge || search.levels() < 2 {
            return Ok(at);
        }
        for _ in 0..placements.len() {
            let mut next = at;
            for placement in search.beside(at.placement) {
                let there = descend(placement, at.offset, search.levels())?;
                let inside = (0..2).all(|d| there.offset[d].abs() <= lattice.half()[d] as f64 * lattice.step()[d]);
                if inside && there.least < next.least {
                    next = Refined { on_lattice: at.on_lattice, ..there };
                }
            }
            if next.placement == at.placement {
                break;
            }
            at = next;
        }
        Ok(at)
    };
    let refined = turn(refine(best, usize::MAX)?)?;
    // The runner-up is refined as the best is: one lattice point compared with a minimum would always lose.
    // Only roughly, unless it falls by much: then it may be as good.
    let rival = match runner_up.map(placed) {
        None => None,
        Some(candidate) => {
            let roughly = refine(candidate, ROUGHLY)?;
            if placements.len() == 1 && roughly.least > FALL * roughly.on_lattice && roughly.least > 0.0 {
                Some(roughly)
            } else {
                let found = refine(candidate, usize::MAX)?;
                let turned = turn(found)?;
                let apart = (0..2).any(|d| (turned.offset[d] - refined.offset[d]).abs() > away[d] * step[d]);
                // One that turns into the best is no other place.
                Some(if apart { turned } else { found })
            }
        }
    };
    let offset = refined.offset;
    let (heading_deg, scale) = placements[refined.placement];

    let points = place_track(field, track, heading_deg, scale, search.pivot);
    let newest = points[points.len() - 1];
    let indicated = track.newest();
    let offset = [newest[0] - indicated[0] + offset[0], newest[1] - indicated[1] + offset[1]];
    let [dx, dy] = [offset[0] - (newest[0] - indicated[0]), offset[1] - (newest[1] - indicated[1])];
    let moved: Vec<[f64; 2]> = points.iter().map(|p| [field.wrap_x(p[0] + dx), p[1] + dy]).collect();
    let mut fit = LocalFit::new(field, track, search, &moved, &placements, (heading_deg, scale));
    if !search.refine {
        fit.spread_over(lattice.step(), lattice.half(), field.metres_per_unit(newest[1]));
    }
    let goodness = search.goodness(fit.least_squares);
    let status = if edge {
        Status::AtEdge
    } else if goodness.is_some_and(|p| p < REJECT) {
        Status::Rejected
    } else if fit.uninformative(field, &lattice, newest[1]) {
        Status::Uninformative
    } else if rival.is_some_and(|r| search.ambiguous(refined.least, r.least, fit.samples, measured.spread())) {
        Status::Ambiguous
    } else {
        Status::Fixed
    };
    let mut fix = Fix::at_point(field, indicated, offset, status);
    fix.heading_deg = heading_deg;
    fix.scale = scale;
    fix.bias = fit.bias;
    fix.goodness = goodness;
    // One that overflows is none.
    fix.covariance_m2 = fit.covariance_m2.filter(|c| c.as_flattened().iter().all(|v| v.is_finite()));
    fix.score = search.criterion.natural(refined.on_lattice);
    fix.runner_up = runner_up.map_or(f64::NAN, |r| search.criterion.natural(r.score));
    fix.n_samples = fit.samples;
    fix.track = moved;
    if search.surface {
        if search.criterion.is_negated() {
            for score in &mut surface {
                *score = -*score;
            }
        }
        fix.surface =
            Some(Surface { values: surface, rows: lattice.rows(), columns, first: lattice.offset(0, 0), step });
    }
    Ok(fix)
}

/// The best score over headings and scales at every offset, and which of them it came from (empty where there is one).
fn search_surface(
    placements: &[(f64, f64)],
    lattice: &OffsetLattice,
    monitor: &dyn Monitor,
    score: impl Fn(usize, &dyn Monitor) -> Result<Vec<f64>>,
) -> Result<(Vec<f64>, Vec<u32>)> {
    let part = |placement: usize| PartOf { inner: monitor, index: placement as u64, of: placements.len() as u64 };
    let mut surface = score(0, &part(0))?;
    if placements.len() == 1 {
        return Ok((surface, Vec::new()));
    }
    let mut chosen = vec![0_u32; lattice.len()];
    for placement in 1..placements.len() {
        let scores = score(placement, &part(placement))?;
        for ((best, chosen), score) in surface.iter_mut().zip(&mut chosen).zip(scores) {
            if score < *best || best.is_nan() && !score.is_nan() {
                *best = score;
                *chosen = placement as u32;
            }
        }
    }
    Ok((surface, chosen))
}

/// Progress of one placement as part of the whole.
struct PartOf<'a> {
    inner: &'a dyn Monitor,
    index: u64,
    of: u64,
}

impl Monitor for PartOf<'_> {
    fn advance(&self, done: u64, total: u64) -> Result<()> {
        self.inner.advance(self.index * total + done, self.of * total)
    }
}

/// Indices less than `len` that are not more than `away` from one.
fn around(at: usize, away: f64, len: usize) -> Range<usize> {
    let reach = away.min(len as f64).floor() as usize;
    at.saturating_sub(reach)..(at + reach + 1).min(len)
}

/// Least score among the candidates outside a block `[rows, columns]`; ties go to the smaller index.
fn least(surface: &[f64], columns: usize, without: [Range<usize>; 2]) -> Option<Best> {
    let [without_rows, without_columns] = without;
    let mut best: Option<Best> = None;
    for (row, scores) in surface.chunks_exact(columns).enumerate() {
        let parts = if without_rows.contains(&row) {
            [0..without_columns.start, without_columns.end..columns]
        } else {
            [0..columns, columns..columns]
        };
        for part in parts {
            let score = least_of(&scores[part.clone()]);
            if score < best.map_or(f64::INFINITY, |b| b.score) {
                let column = scores[part.clone()].iter().position(|s| *s == score).unwrap_or(0) + part.start;
                best = Some(Best { score, row, column, placement: 0 });
            }
        }
    }
    best
}

/// Least number of a slice, infinite where there is none; several at a time.
fn least_of(slice: &[f64]) -> f64 {
    const WIDTH: usize = 16;
    let lower = |least: &mut f64, &x: &f64| *least = if x < *least { x } else { *least };
    let mut least = [f64::INFINITY; WIDTH];
    let chunks = slice.chunks_exact(WIDTH);
    chunks.remainder().iter().zip(&mut least).for_each(|(x, least)| lower(least, x));
    for chunk in chunks {
        for (least, x) in least.iter_mut().zip(chunk) {
            lower(least, x);
        }
    }
    least.into_iter().fold(f64::INFINITY, f64::min)
}

/// The answer where no candidate has a score.
fn no_score(field: &dyn Field, track: &Track, search: &GridSearch, lattice: &OffsetLattice) -> Fix {
    let in_reach = field.layout().is_none_or(|grid| {
        let reach = |k: usize, d: usize| {
            let [x, y] = [grid.wrap_x(track.x()[k]), track.y()[k]];
            let axis = if d == 0 { grid.x() } else { grid.y() };
            let p = if d == 0 { x } else { y };
            p >= axis.first() - search.half_width[d] && p <= axis.last() + search.half_width[d]
        };
        (0..track.len()).any(|k| reach(k, 0) && reach(k, 1))
    });
    let status = if in_reach { Status::Uninformative } else { Status::Lost };
    let mut fix = Fix::none(status, track.len());
    if search.surface {
        fix.surface = Some(Surface {
            values: vec![f64::NAN; lattice.len()],
            rows: lattice.rows(),
            columns: lattice.columns(),
            first: lattice.offset(0, 0),
            step: lattice.step(),
        });
    }
    fix
}
