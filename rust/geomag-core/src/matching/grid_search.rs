//! Grid search: every offset of a lattice (and every heading and scale asked for) scored with a similarity measure.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_positive, require_weights};
use crate::field::Field;
use crate::fix::{Fix, Status, Surface};
use crate::grid::Interpolation;
use crate::lattice::{BestTwo, Comparison, DEFAULT_MAX_CANDIDATES, OffsetLattice, Pivot, place_track};
use crate::matching::local_fit::LocalFit;
use crate::matching::similarity::{Criterion, Robust, Scoring};
use crate::monitor::Monitor;
use crate::stack::{read_heights, served};
use crate::statistics::chi_square_survival;
use crate::track::Track;

/// Options of [`match_grid`]; the defaults search offsets alone with the mean square difference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridSearch {
    /// Measure.
    pub criterion: Criterion,
    /// Half size of the search `[x, y]`, map units.
    pub half_width: [f64; 2],
    /// Lattice step `[x, y]`, map units; the map spacing where `None`.
    pub step: Option<[f64; 2]>,
    /// Heading corrections to try, degrees.
    pub heading_deg: Vec<f64>,
    /// Scale corrections to try.
    pub scale: Vec<f64>,
    /// Point about which heading and scale turn the track.
    pub pivot: Pivot,
    /// Whether a constant is taken out of the differences.
    pub remove_mean: bool,
    /// One weight a sample. A sample of weight zero is as if it had not been measured: its position alone remains.
    pub weights: Option<Vec<f64>>,
    /// Loss in place of the square.
    pub robust: Option<Robust>,
    /// How the map is read.
    pub interpolation: Interpolation,
    /// Share of the samples that a candidate must have on the map.
    pub min_overlap: f64,
    /// Standard deviation of a measured value, map included; estimated from the best fit where `None`.
    pub sigma: Option<f64>,
    /// A runner-up whose likelihood is more than this share of the best's makes the answer ambiguous.
    pub ambiguity: f64,
    /// Whether the best offset is refined below the lattice step.
    pub refine: bool,
    /// Whether the score surface is returned.
    pub surface: bool,
    /// Limit on offsets x headings x scales.
    pub max_candidates: u64,
}

impl GridSearch {
    /// A search of the given measure and half width with the defaults for the rest.
    pub fn new(criterion: Criterion, half_width: [f64; 2]) -> Self {
        Self {
            criterion,
            half_width,
            step: None,
            heading_deg: vec![0.0],
            scale: vec![1.0],
            pivot: Pivot::Newest,
            remove_mean: false,
            weights: None,
            robust: None,
            interpolation: Interpolation::Bilinear,
            min_overlap: 0.8,
            sigma: None,
            ambiguity: 0.01,
            refine: true,
            surface: false,
            max_candidates: DEFAULT_MAX_CANDIDATES,
        }
    }

    fn check(&self, track: &Track) -> Result<()> {
        for (what, list) in [("heading_deg", &self.heading_deg), ("scale", &self.scale)] {
            if list.is_empty() {
                return Err(Error::invalid(what, "at least one value to try", "none"));
            }
            require_finite(what, list)?;
        }
        for (i, &s) in self.scale.iter().enumerate() {
            require_positive(&format!("scale[{i}]"), s)?;
        }
        if self.half_width == [0.0; 2] {
            // Nothing to compare it with: a single offset is neither ambiguous nor at an edge, wherever it is.
            return Err(Error::invalid("half_width", "more than 0 along x or y", "0 along both: one candidate"));
        }
        if !(self.min_overlap > 0.0 && self.min_overlap <= 1.0) {
            return Err(Error::invalid("min_overlap", "a share in (0, 1]", self.min_overlap));
        }
        if !(self.ambiguity > 0.0 && self.ambiguity <= 1.0) {
            return Err(Error::invalid("ambiguity", "a likelihood ratio in (0, 1]", self.ambiguity));
        }
        if let Some(sigma) = self.sigma {
            require_positive("sigma", sigma)?;
        }
        let scoring = self.scoring();
        scoring.check()?;
        if let Some(weights) = &self.weights {
            require_weights(weights, track.len())?;
        }
        let (needed, got) = (scoring.least_samples(), self.counting(track.len()).count());
        if got < needed {
            return Err(Error::TooFewSamples {
                what: format!("grid search with '{}' about a free mean", self.criterion.as_str()),
                needed,
                got,
            });
        }
        Ok(())
    }

    /// The samples of `n` that have a weight.
    fn counting(&self, n: usize) -> impl Iterator<Item = usize> {
        (0..n).filter(|&k| self.weights.as_ref().is_none_or(|w| w[k] > 0.0))
    }

    /// The weights of those, where they differ from one.
    fn their_weights(&self) -> Option<Vec<f64>> {
        let kept: Vec<f64> = self.weights.as_ref()?.iter().copied().filter(|w| *w > 0.0).collect();
        kept.iter().any(|w| *w != 1.0).then_some(kept)
    }

    fn scoring(&self) -> Scoring {
        Scoring { criterion: self.criterion, remove_mean: self.remove_mean, robust: self.robust }
    }
}

/// Residuals less likely than this under the caller's own sigma are no fit, however much worse every other place is.
const REJECT: f64 = 1e-6;

/// A candidate refined below the lattice step.
#[derive(Debug, Clone, Copy)]
struct Refined {
    /// Offset, map units.
    offset: [f64; 2],
    /// Score of the candidate itself.
    on_lattice: f64,
    /// The lesser of that and the score at the refined offset.
    least: f64,
}

/// The winner among all candidates.
#[derive(Debug, Clone, Copy)]
struct Best {
    score: f64,
    row: usize,
    column: usize,
    placement: usize,
}

/// Finds the offset (and heading, and scale) under which the measured sequence fits the map best.
///
/// The best offset is refined by a quadratic through the scores around it. The covariance is Gauss-Newton's: noise over
/// curvature, with the map's gradient along the matched track; measures without a noise model (product, Hausdorff) have
/// none. The status is `at_edge` where the best lies on the border of the search, `ambiguous` where a place
/// two map cells away or more fits nearly as well (see [`GridSearch::ambiguity`]), `uninformative` where the field is too flat, `rejected`
/// where sigma is given and the residuals of a mean square difference are far beyond it.
/// None of this is a calibrated risk.
///
/// A track that no candidate brings onto the map is `lost`.
///
/// # Errors
/// [`Error::Invalid`] for options out of range, [`Error::TooManyCandidates`], [`Error::TooFewSamples`], [`Error::Interrupted`].
pub fn match_grid(field: &dyn Field, track: &Track, search: &GridSearch, monitor: &dyn Monitor) -> Result<Fix> {
    search.check(track)?;
    let served = served(field, track)?;
    let mut fix = search_served(served.field(), track, search, monitor)?;
    fix.heights_m = read_heights(&[served], track);
    Ok(fix)
}

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
    let refine = |candidate: Best| -> Result<Refined> {
        let comparison = compare(candidate.placement, search.interpolation)?;
        let around = Neighbourhood::new(&scoring, &comparison, field.mean(), &distance_m, candidate, monitor)?;
        let border = lattice.on_border(candidate.row, candidate.column);
        let shift = if search.refine && !border { around.vertex() } else { [0.0; 2] };
        let [ox, oy] = lattice.offset(candidate.row, candidate.column);
        let offset = [ox + shift[0] * step[0], oy + shift[1] * step[1]];
        let there =
            scoring.scores(&comparison.at_offset(offset)?, field.mean(), &distance_m, 0..1, 0..1, None, monitor)?[0];
        let on_lattice = around.centre();
        Ok(Refined { offset, on_lattice, least: if there < on_lattice { there } else { on_lattice } })
    };
    let refined = refine(best)?;
    // The runner-up is refined as the best is: one lattice point compared with a minimum would always lose.
    let rival = runner_up.map(|r| refine(placed(r))).transpose()?;
    let offset = refined.offset;
    let (heading_deg, scale) = placements[best.placement];

    let points = place_track(field, track, heading_deg, scale, search.pivot);
    let newest = points[points.len() - 1];
    let indicated = track.newest();
    let offset = [newest[0] - indicated[0] + offset[0], newest[1] - indicated[1] + offset[1]];
    let [dx, dy] = [offset[0] - (newest[0] - indicated[0]), offset[1] - (newest[1] - indicated[1])];
    let moved: Vec<[f64; 2]> = points.iter().map(|p| [field.wrap_x(p[0] + dx), p[1] + dy]).collect();
    let fit = LocalFit::new(field, track, search, &moved, &placements);
    let goodness = search.goodness(&fit);
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
    fix.covariance_m2 = fit.covariance_m2;
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

impl GridSearch {
    /// p-value of the residuals where the caller has said what their standard deviation is: chi-square at the minimum of
    /// the linearised fit, which the quadratic through lattice scores only comes near to.
    fn goodness(&self, fit: &LocalFit) -> Option<f64> {
        match (self.criterion, self.robust, self.sigma, fit.least_squares) {
            (Criterion::Msd, None, Some(sigma), Some((squares, freedom))) if self.their_weights().is_none() => {
                Some(chi_square_survival(squares / (sigma * sigma), freedom as f64))
            }
            _ => None,
        }
    }

    /// Whether a runner-up is too near. With a noise model: its likelihood, half of the samples counted as independent
    /// (their errors are not), is more than `ambiguity` of the best's. Without: its score is within a twentieth.
    ///
    /// Where the noise is estimated it is taken to be at least a millionth of the `spread` of the readings, so that the
    /// rounding of two perfect fits does not choose between them.
    fn ambiguous(&self, best: f64, runner_up: f64, samples: usize, spread: f64) -> bool {
        let n = 0.5 * samples as f64;
        let least = 1e-6 * spread;
        let ratio = |floor: f64| ((runner_up + floor) / (best + floor)).ln();
        let log_ratio = match (self.criterion, self.robust, self.sigma) {
            // The product may be of either sign: within a twentieth of its size.
            (Criterion::Prod | Criterion::Hausdorff { .. }, _, _) => return !(runner_up - best > 0.05 * best.abs()),
            (Criterion::Msd, Some(Robust::StudentT { .. }), _) => 0.5 * n * (runner_up - best),
            (Criterion::Msd, None, Some(sigma)) => 0.5 * n * (runner_up - best) / (sigma * sigma),
            (Criterion::Msd, _, _) => 0.5 * n * ratio(least * least),
            (Criterion::Mad, _, _) => n * ratio(least),
            (Criterion::Ncc, _, _) => {
                // Inner scores are negated correlations.
                let unexplained = |score: f64| 1.0 + score * score.abs() + 1e-12;
                0.5 * n * (unexplained(runner_up) / unexplained(best)).ln()
            }
        };
        // Written so that 0 / 0, two perfect fits, is ambiguous.
        !(log_ratio >= -self.ambiguity.ln())
    }
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

/// Scores of the 3 x 3 offsets around the best, in double precision.
struct Neighbourhood {
    scores: [[f64; 3]; 3],
}

impl Neighbourhood {
    fn new(
        scoring: &Scoring,
        comparison: &Comparison<'_>,
        map_mean: f64,
        distance_m: &[f64],
        best: Best,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let lattice = comparison.lattice();
        let mut scores = [[f64::NAN; 3]; 3];
        let rows = best.row.saturating_sub(1)..(best.row + 2).min(lattice.rows());
        let columns = best.column.saturating_sub(1)..(best.column + 2).min(lattice.columns());
        let block = scoring.scores(comparison, map_mean, distance_m, rows.clone(), columns.clone(), None, monitor)?;
        for (i, row) in rows.clone().enumerate() {
            for (j, column) in columns.clone().enumerate() {
                scores[row + 1 - best.row][column + 1 - best.column] = block[i * columns.len() + j];
            }
        }
        Ok(Self { scores })
    }

    fn centre(&self) -> f64 {
        self.scores[1][1]
    }

    /// Vertex of the quadratic through the neighbours, in steps `[x, y]`, at most one step away.
    ///
    /// Both directions together where the quadratic has a minimum there, else each on its own, else not at all.
    fn vertex(&self) -> [f64; 2] {
        let s = &self.scores;
        let c = s[1][1];
        let (gx, hx) = (0.5 * (s[1][2] - s[1][0]), s[1][2] - 2.0 * c + s[1][0]);
        let (gy, hy) = (0.5 * (s[2][1] - s[0][1]), s[2][1] - 2.0 * c + s[0][1]);
        let hxy = 0.25 * (s[2][2] - s[2][0] - s[0][2] + s[0][0]);
        let alone = |g: f64, h: f64| if h > 0.0 && g.is_finite() { (-g / h).clamp(-0.5, 0.5) } else { 0.0 };
        let det = hx * hy - hxy * hxy;
        if hx > 0.0 && hy > 0.0 && det > 1e-6 * hx * hy && gx.is_finite() && gy.is_finite() {
            let vertex = [(hxy * gy - hy * gx) / det, (hxy * gx - hx * gy) / det];
            if vertex.iter().all(|v| v.abs() <= 1.0) {
                return vertex;
            }
        }
        [alone(gx, hx), alone(gy, hy)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_without_a_noise_model_are_compared_by_their_size_whatever_their_sign() {
        let product = GridSearch::new(Criterion::Prod, [1.0; 2]);
        // Inner scores: the product negated.
        let ambiguous = |best: f64, runner_up: f64| product.ambiguous(-best, -runner_up, 20, 1.0);
        assert!(ambiguous(100.0, 96.0) && !ambiguous(100.0, 94.0) && !ambiguous(100.0, -100.0));
        assert!(ambiguous(-100.0, -104.0) && !ambiguous(-100.0, -106.0));
        assert!(ambiguous(-100.0, -100.0) && ambiguous(0.0, 0.0));
    }
}
