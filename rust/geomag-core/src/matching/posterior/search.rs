//! The search in stages: from a coarse lattice to the places that matter.

use super::density::{NOTHING, Posterior, lattice_variance};
use super::kernel::LANES;
use super::model::{LEVELS, Level, PosteriorOptions};
use super::problem::{Likelihoods, Problem, Scope};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Tempered log-likelihood below the best at which a cell is not refined any further, going by the bound over the cell.
const PRUNE: f64 = 12.0;
/// The same for a sequence that goes on: later samples may yet change the order.
const PRUNE_STREAM: f64 = 28.0;
/// Candidates of the first stage where the step is chosen here.
const FIRST_STAGE: f64 = 2500.0;
/// Most cells that survive a stage.
const SURVIVORS: usize = 6000;
/// Risk over the first lattice from which a sequence that goes on is not searched any closer.
const HOPELESS: f64 = 0.15;
/// Modes that the last lattice has to resolve, and how far in the logarithm below the best they may lie.
const RIVALS: usize = 4;
const RIVAL: f64 = 6.0;
/// Cells that are left from which a posterior may be wider than the tolerance.
const BROAD: usize = 100;
/// Cells above which a posterior is not refined any further for a rival's sake.
const MANY: usize = 400;
/// Cells from which the reference place is sought.
const STARTS: usize = 8;
/// Greatest lattice step, in cells, at which the error level of an unknown map is judged.
const UNKNOWN_STEP: f64 = 0.1251;
/// Most halvings of the lattice step below one cell of the map: places are in single precision.
const HALVINGS: i32 = 20;
/// Logarithm of the weight below which an error level is left out, and what the first estimate of it may be wrong by.
const LEVEL_FLOOR: f64 = -9.0;
const LEVEL_SLACK: f64 = 5.0;
/// Lattice step in standard deviations of the posterior at which sums over the lattice are integrals to 1e-3.
const RESOLUTION: f64 = 1.4;

/// The best place found, to which the bounds of all cells are compared.
struct Reference {
    /// Its log-likelihood, `[channel][level]`.
    log_likelihood: Vec<[f64; LEVELS]>,
    /// Estimated logarithm of every level's weight, `[channel][level]`, the largest 0.
    weights: Vec<[f64; LEVELS]>,
    /// Logarithm of the area of every level's posterior there, in square metres, `[channel][level]`.
    areas: Vec<[f64; LEVELS]>,
    /// Smallest standard deviation of the posterior there, metres.
    spread_m: f64,
    /// Where it is, and the lattice step that resolves the mode there, map units.
    offset: [f64; 2],
    step: [f64; 2],
}

impl Problem<'_> {
    /// The offsets of the first stage.
    pub fn lattice(&self) -> Result<Lattice> {
        Lattice::new(self.cell, self.options)
    }

    /// The posterior over `offsets`, refined around the modes unless the caller set the step.
    pub fn solve(&self, offsets: Vec<[f64; 2]>, step: [f64; 2]) -> Posterior {
        self.search(offsets, step, false, false).0
    }

    /// [`Problem::solve`] for a sequence that goes on, and the offsets that later samples may yet make the best.
    ///
    /// With `coarse` the search ends where a stage says that no fix is near: its risk is several times the one at which a
    /// fix is declared.
    pub fn solve_going_on(
        &self,
        offsets: Vec<[f64; 2]>,
        step: [f64; 2],
        coarse: bool,
    ) -> (Posterior, Option<Vec<[f64; 2]>>) {
        if coarse && self.options.step.is_none() {
            let posterior = self.density(offsets.clone(), step, &self.named());
            if self.hopeless(&posterior, 1.0) {
                return (posterior, None);
            }
        }
        let (posterior, kept) = self.search(offsets, step, true, coarse);
        (posterior, Some(kept))
    }

    /// Whether a lattice whose step is `share` of the first one's says that no fix is near; the finer it is, the more it is believed.
    fn hopeless(&self, posterior: &Posterior, share: f64) -> bool {
        1.0 - self.near_mode(posterior) > (HOPELESS * share).max(3.0 * self.options.max_risk)
    }

    /// The search: `keep` for the offsets that matter later, `coarse` to end early where no fix is near.
    ///
    /// A coarse candidate stands for its cell: it is dropped when the bound over the cell is far below the likelihood of
    /// the best place found. Its own density would not do, because a variance that covers the cell favours flat places.
    fn search(
        &self,
        mut offsets: Vec<[f64; 2]>,
        mut step: [f64; 2],
        keep: bool,
        coarse: bool,
    ) -> (Posterior, Vec<[f64; 2]>) {
        if self.options.step.is_some() {
            let posterior = self.density(offsets, step, &self.whole());
            let kept = if keep { posterior.survivors(PRUNE_STREAM, SURVIVORS) } else { Vec::new() };
            return (posterior, kept);
        }
        let mut stages = 1;
        let first_step = step[0];
        let mut scopes = self.whole();
        let mut bounded = self.bounded(&scopes, true);
        let mut bounds = self.likelihoods::<true>(&offsets, step, &bounded);
        let Some(reference) = self.reference(&offsets, step, &bounds) else {
            // No candidate lies on the map.
            return (self.density(offsets, step, &scopes), Vec::new());
        };
        let mut kept_for_later = Vec::new();
        loop {
            let excess = self.excess(&reference, &bounds, &bounded, step, offsets.len());
            if keep && stages == 1 {
                kept_for_later = select(&offsets, &excess, PRUNE_STREAM, usize::MAX);
            }
            if step[0] <= reference.step[0] * 1.001 {
                break;
            }
            let mut kept = select(&offsets, &excess, PRUNE, SURVIVORS);
            if kept.is_empty() {
                // No bound may lie below what was found under it, but for rounding.
                kept.extend(offsets.iter().copied().min_by(|a, b| {
                    let apart = |o: &[f64; 2]| {
                        let d = [0, 1].map(|d| (o[d] - reference.offset[d]) * self.scale_m[d]);
                        d[0].hypot(d[1])
                    };
                    apart(a).total_cmp(&apart(b))
                }));
            }
            self.narrow(&mut scopes, &reference, &bounds, &bounded);
            // A posterior that is wider than the tolerance and that this lattice resolves needs no finer one to say so.
            let resolved = self.longest_m(step) <= RESOLUTION * reference.spread_m;
            if resolved && kept.len() > BROAD || coarse && stages > 1 {
                let mut posterior = self.density(kept.clone(), step, &scopes);
                if coarse && self.hopeless(&posterior, step[0] / first_step)
                    || resolved && self.near_mode(&posterior) < 0.5
                {
                    posterior.stages = stages + 1;
                    return (posterior, kept_for_later);
                }
            }
            offsets = children(&kept, step);
            step = step.map(|s| 0.5 * s);
            stages += 1;
            if step[0] <= reference.step[0] * 1.001 {
                break;
            }
            bounded = self.bounded(&scopes, false);
            bounds = self.likelihoods::<true>(&offsets, step, &bounded);
        }
        let mut posterior = self.density(offsets, step, &scopes);
        // Where the mode turned out narrower than the reference said.
        while let Some(coarse) = self.too_coarse(&posterior) {
            let kept = posterior.survivors(PRUNE, SURVIVORS);
            // A rival that is narrower than a broad answer is not worth a fine lattice over all of that.
            if kept.is_empty() || coarse == Coarse::Rival && kept.len() > MANY {
                break;
            }
            let finer = posterior.step.map(|s| 0.5 * s);
            posterior = self.density(children(&kept, posterior.step), finer, &scopes);
            stages += 1;
        }
        posterior.stages = stages;
        // Sums over a lattice that resolves the modes are integrals: nothing is left between its places.
        let between = lattice_variance(posterior.step, self.scale_m);
        for blur in &mut posterior.blur_m {
            *blur = (*blur * *blur - between).max(0.0).sqrt();
        }
        (posterior, kept_for_later)
    }

    /// The most likely place, sought from the cells of the highest bounds by halving; `None` where no candidate is on the map.
    fn reference(&self, offsets: &[[f64; 2]], step: [f64; 2], bounds: &Likelihoods) -> Option<Reference> {
        let rank = |likelihoods: &Likelihoods, offsets: &[[f64; 2]], most: usize| {
            let mut order: Vec<(f64, usize)> = (0..offsets.len())
                .map(|i| {
                    let sum: f64 = self
                        .channels
                        .iter()
                        .zip(likelihoods)
                        .map(|(c, scored)| {
                            let of = |v: usize| scored.blocks[i / LANES].log_likelihood[v][i % LANES];
                            // Which surface the field follows is for the samples to say.
                            let any = |levels: &[Level]| {
                                let with_prior = levels.iter().enumerate().map(|(v, l)| of(v) + l.log_prior);
                                with_prior.fold(f64::NEG_INFINITY, f64::max)
                            };
                            if c.noise.covered { any(&c.noise.levels) } else { of(c.noise.typical) }
                        })
                        .sum();
                    (sum, i)
                })
                .filter(|(sum, _)| sum.is_finite())
                .collect();
            let by_rank = |a: &(f64, usize), b: &(f64, usize)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
            if order.len() > most {
                order.select_nth_unstable_by(most - 1, by_rank);
                order.truncate(most);
            }
            order.sort_by(by_rank);
            order
        };
        let all = self.whole();
        let mut starts = STARTS;
        let mut spread_m = f64::INFINITY;
        let first = rank(bounds, offsets, starts);
        if first.is_empty() {
            return None;
        }
        let mut step = step;
        let mut places: Vec<[f64; 2]> = first.iter().map(|&(_, i)| offsets[i]).collect();
        loop {
            let some = children(&places, step);
            step = step.map(|s| 0.5 * s);
            let densities = self.likelihoods::<false>(&some, step, &all);
            starts = (starts / 2).max(2);
            let order = rank(&densities, &some, starts);
            let &(_, best) = order.first()?;
            places = order.iter().map(|&(_, i)| some[i]).collect();
            let log_likelihood: Vec<[f64; LEVELS]> = densities
                .iter()
                .map(|scored| std::array::from_fn(|v| scored.blocks[best / LANES].log_likelihood[v][best % LANES]))
                .collect();
            // The posterior's spread changes little on the way: it is not worth a look before the lattice comes near it.
            if self.resolves(step, 2.0 * spread_m) {
                let found = self.at_reference(some[best], step, &densities, log_likelihood);
                spread_m = found.spread_m;
                if self.resolves(step, spread_m) {
                    return Some(found);
                }
            }
        }
    }

    /// What the posterior around one place looks like, by Laplace's method.
    fn at_reference(
        &self,
        offset: [f64; 2],
        step: [f64; 2],
        densities: &Likelihoods,
        log_likelihood: Vec<[f64; LEVELS]>,
    ) -> Reference {
        let mut total = [0.0; 3];
        let mut blurred = 0.0_f64;
        let (mut all, mut areas) = (Vec::with_capacity(self.channels.len()), Vec::with_capacity(self.channels.len()));
        let prior = [0, 1].map(|d| 3.0 / (self.options.half_width[d] * self.scale_m[d]).powi(2));
        for (channel, (scored, log)) in self.channels.iter().zip(densities.iter().zip(&log_likelihood)) {
            let levels = &channel.noise.levels;
            let law = self.law(channel, &scored.blocks, 0..levels.len());
            let information = self.information(channel, offset, step);
            let area = |v: usize, temper: f64| {
                let [ee, en, nn] = information[v].map(|i| temper * i);
                std::f64::consts::TAU.ln()
                    - 0.5 * ((ee + prior[0]) * (nn + prior[1]) - en * en).max(f64::MIN_POSITIVE).ln()
            };
            let evidence = |v: usize, temper: f64| temper * log[v] + area(v, temper);
            let weights = law.weights(&channel.noise, 0..levels.len(), evidence);
            areas.push(std::array::from_fn(|v| if v < levels.len() { area(v, law.temper[v]) } else { 0.0 }));
            let top = (0..levels.len()).fold(0, |a, b| if weights[b] > weights[a] { b } else { a });
            for (sum, i) in total.iter_mut().zip(information[top]) {
                *sum += law.temper[top] * i;
            }
            blurred = blurred.max(channel.noise.displacement(law.distance, &levels[top]) * law.share[top].sqrt());
            all.push(weights);
        }
        let [ee, en, nn] = [total[0] + prior[0], total[1], total[2] + prior[1]];
        // The largest eigenvalue of the information is the smallest variance.
        let largest = 0.5 * (ee + nn) + (0.25 * (ee - nn).powi(2) + en * en).sqrt();
        let spread_m = largest.recip().sqrt().max(blurred);
        Reference { log_likelihood, weights: all, areas, spread_m, offset, step }
    }

    /// The longer side of a lattice cell, metres.
    fn longest_m(&self, step: [f64; 2]) -> f64 {
        (step[0] * self.scale_m[0]).max(step[1] * self.scale_m[1])
    }

    /// Mass within the tolerance and one lattice cell of the mode.
    fn near_mode(&self, posterior: &Posterior) -> f64 {
        let Some(best) = posterior.mode() else { return 0.0 };
        let centre = posterior.offsets[best];
        let radius = self.tolerance_m + self.longest_m(posterior.step);
        let near = |o: &[f64; 2]| {
            let (dx, dy) = ((o[0] - centre[0]) * self.scale_m[0], (o[1] - centre[1]) * self.scale_m[1]);
            dx * dx + dy * dy <= radius * radius
        };
        posterior
            .offsets
            .iter()
            .zip(&posterior.log_p)
            .filter(|(o, lp)| **lp > NOTHING && near(o))
            .map(|(_, lp)| lp.exp())
            .sum()
    }

    /// Whether a lattice of this step resolves a posterior of that spread.
    fn resolves(&self, step: [f64; 2], spread_m: f64) -> bool {
        let relative = (step[0] / self.cell[0]).max(step[1] / self.cell[1]);
        let step_m = self.longest_m(step);
        // Whether a map without a word on its errors is exact shows only on a lattice that an exact one would need.
        if relative > UNKNOWN_STEP && self.channels.iter().any(|c| c.noise.levels_are_distances) {
            return false;
        }
        relative <= 0.5_f64.powi(HALVINGS) * 1.001
            || (step_m <= 0.34 * self.tolerance_m && step_m <= RESOLUTION * spread_m)
    }

    /// How far the bound of every cell lies above (below where negative) the reference, tempered, at the kindest level: the
    /// logarithm of the mass that the cell may hold, where a level's posterior covers many cells as of its share.
    fn excess(
        &self,
        reference: &Reference,
        bounds: &Likelihoods,
        scopes: &[Scope],
        step: [f64; 2],
        count: usize,
    ) -> Vec<f64> {
        let mut excess = vec![0.0; count];
        let cell = (step[0] * self.scale_m[0] * step[1] * self.scale_m[1]).ln();
        for (c, (channel, scored)) in self.channels.iter().zip(bounds).enumerate() {
            let cover = scopes[c].cover;
            let levels = if cover { 0..channel.noise.levels.len() } else { scopes[c].levels.clone() };
            let law = self.law(channel, &scored.blocks, scopes[c].levels.clone());
            let best = &reference.log_likelihood[c];
            let share =
                |v: usize| (reference.weights[c][v] + LEVEL_SLACK).min(0.0) - (reference.areas[c][v] - cell).max(0.0);
            let shares: [f64; LEVELS] = std::array::from_fn(share);
            for (i, sum) in excess.iter_mut().enumerate() {
                let scores = &scored.blocks[i / LANES].log_likelihood;
                *sum += levels
                    .clone()
                    .map(|v| shares[v] + law.temper[v] * (scores[if cover { 0 } else { v }][i % LANES] - best[v]))
                    .fold(f64::NEG_INFINITY, f64::max);
            }
        }
        excess
    }

    /// Leaves out the error levels and the nodes of the nuisance parameters that no longer carry anything.
    fn narrow(&self, scopes: &mut [Scope], reference: &Reference, bounds: &Likelihoods, bounded: &[Scope]) {
        for (c, scope) in scopes.iter_mut().enumerate() {
            let weights = &reference.weights[c];
            let carries = |v: &usize| weights[*v] + LEVEL_SLACK > LEVEL_FLOOR;
            let levels = scope.levels.clone();
            if let (Some(first), Some(last)) = (levels.clone().find(carries), levels.clone().rev().find(carries)) {
                scope.levels = first..last + 1;
            }
            if scope.nodes.len() > 1 {
                let law = self.law(&self.channels[c], &bounds[c].blocks, bounded[c].levels.clone());
                let cover = bounded[c].cover;
                let within = |best: &[f64; LEVELS]| {
                    let above = |v: usize| best[if cover { 0 } else { v }] - reference.log_likelihood[c][v];
                    let below = |v: usize| law.temper[v] * above(v) + (weights[v] + LEVEL_SLACK).min(0.0);
                    levels.clone().any(|v| below(v) > -PRUNE)
                };
                let kept: Vec<bool> = bounds[c].best_of_node.iter().map(within).collect();
                if kept.contains(&true) {
                    let mut kept = kept.iter();
                    scope.nodes.retain(|_| *kept.next().unwrap_or(&true));
                }
            }
        }
    }

    /// Which of the modes that carry mass this lattice does not resolve, the answer's own before any other; `None` where a finer one
    /// would change nothing that matters.
    fn too_coarse(&self, posterior: &Posterior) -> Option<Coarse> {
        let best = posterior.mode()?;
        let tolerance2 = self.tolerance_m * self.tolerance_m;
        let mut left: Vec<usize> = (0..posterior.offsets.len())
            .filter(|&i| posterior.log_p[i] > posterior.log_p[best] - 2.0 * RIVAL)
            .collect();
        let mut top = best;
        for _ in 0..RIVALS {
            let centre = posterior.offsets[top];
            let mut sums = [0.0; 4];
            left.retain(|&i| {
                let o = posterior.offsets[i];
                let (dx, dy) = ((o[0] - centre[0]) * self.scale_m[0], (o[1] - centre[1]) * self.scale_m[1]);
                let near = dx * dx + dy * dy <= tolerance2;
                if near {
                    let p = (posterior.log_p[i] - posterior.log_p[best]).exp();
                    sums[0] += p;
                    sums[1] += p * dx * dx;
                    sums[2] += p * dy * dy;
                    sums[3] += p * dx * dy;
                }
                !near
            });
            let [dxx, dyy, dxy] = [1, 2, 3].map(|i| sums[i] / sums[0].max(f64::MIN_POSITIVE));
            // Along its narrow side, however it lies.
            let least = 0.5 * (dxx + dyy) - (0.25 * (dxx - dyy).powi(2) + dxy * dxy).sqrt();
            let spread = least.max(0.0).sqrt();
            if !self.resolves(posterior.step, spread.max(posterior.blur_m[top])) {
                return Some(if top == best { Coarse::Answer } else { Coarse::Rival });
            }
            let next = left.iter().copied().reduce(|a, b| if posterior.log_p[b] > posterior.log_p[a] { b } else { a });
            match next {
                Some(next) if posterior.log_p[next] > posterior.log_p[best] - RIVAL => top = next,
                _ => break,
            }
        }
        None
    }
}

/// Whose mode a lattice does not resolve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Coarse {
    Answer,
    Rival,
}

/// The offsets whose `merit` is above minus `depth`, the best `most` where there are more, in their order.
pub(super) fn select(offsets: &[[f64; 2]], merit: &[f64], depth: f64, most: usize) -> Vec<[f64; 2]> {
    let mut floor = -depth;
    let mut values: Vec<f64> = merit.iter().copied().filter(|m| *m >= floor).collect();
    if values.len() > most {
        values.select_nth_unstable_by(most - 1, |a, b| b.total_cmp(a));
        floor = values[most - 1];
    }
    offsets.iter().zip(merit).filter(|(_, m)| **m >= floor).map(|(o, _)| *o).collect()
}

/// The four quarters of every cell of this step.
fn children(cells: &[[f64; 2]], step: [f64; 2]) -> Vec<[f64; 2]> {
    let [x, y] = step.map(|s| 0.25 * s);
    cells.iter().flat_map(|o| [[-x, -y], [x, -y], [-x, y], [x, y]].map(|[u, v]| [o[0] + u, o[1] + v])).collect()
}

/// The offsets of the first stage: whole multiples of `step` up to `most` of them either way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Lattice {
    /// Map units.
    pub step: [f64; 2],
    pub most: [i64; 2],
}

impl Lattice {
    /// That of a search on a map of the given cell.
    pub fn new(cell: [f64; 2], options: &PosteriorOptions) -> Result<Self> {
        let half = options.half_width;
        let step = options.step.unwrap_or_else(|| {
            // One cell, or coarser for a wide start: later stages refine, and the variance knows the step.
            let cells = (2.0 * half[0] / cell[0] + 1.0) * (2.0 * half[1] / cell[1] + 1.0);
            let factor = (cells / FIRST_STAGE).sqrt().max(1.0);
            // Beyond a few cells a coarse sample says nothing about the features between.
            let factor = factor.min(4.0);
            [cell[0] * factor, cell[1] * factor]
        });
        let most = [0, 1].map(|d| (half[d] / step[d] - 1e-9).ceil().max(0.0) as i64);
        let [columns, rows] = most.map(|m| 2 * m as u128 + 1);
        let needed = columns.saturating_mul(rows);
        if needed > u128::from(options.max_candidates) {
            let limit = options.max_candidates;
            return Err(Error::TooManyCandidates { what: "offset lattice".into(), needed, limit });
        }
        Ok(Self { step, most })
    }

    /// How many there are.
    pub fn len(&self) -> u64 {
        self.most.map(|m| 2 * m as u64 + 1).iter().product()
    }

    /// All of them, row by row.
    pub fn offsets(&self) -> Vec<[f64; 2]> {
        let [columns, rows] = self.most;
        (-rows..=rows).flat_map(|j| (-columns..=columns).map(move |i| self.offset([i, j]))).collect()
    }

    pub fn offset(&self, node: [i64; 2]) -> [f64; 2] {
        [0, 1].map(|d| node[d] as f64 * self.step[d])
    }

    pub fn node(&self, offset: [f64; 2]) -> [i64; 2] {
        [0, 1].map(|d| (offset[d] / self.step[d]).round() as i64)
    }

    /// Where the cells of the outermost offsets end, map units.
    pub fn edge(&self) -> [f64; 2] {
        [0, 1].map(|d| (self.most[d] as f64 + 0.5) * self.step[d])
    }
}
