//! The search in stages: from a coarse lattice to the places that matter.

use super::density::{NEGLIGIBLE_LOG, Posterior};
use super::kernel::LANES;
use super::lattice::{Lattice, children, lattice_variance, select};
use super::noise::LEVELS;
use super::problem::{Likelihoods, Problem, Scope};
use super::reference::{RESOLUTION, Reference};
use crate::error::Result;

/// Tempered log-likelihood below the best at which a cell is not refined any further, going by the bound over the cell.
const PRUNE: f64 = 12.0;
/// The same for a sequence that goes on: later samples may yet change the order.
const PRUNE_STREAM: f64 = 28.0;
/// Most cells that survive a stage.
const SURVIVORS: usize = 6000;
/// Share of the tolerance from which so many cells cover several tolerances: what lies along a valley is then no one place.
const FINE: f64 = 1.0 / 32.0;
/// Risk over the first lattice from which a sequence that goes on is not searched any closer.
const HOPELESS: f64 = 0.15;
/// Modes that the last lattice has to resolve, and how far in the logarithm below the best they may lie.
const RIVALS: usize = 4;
const RIVAL: f64 = 6.0;
/// Cells that are left from which a posterior may be wider than the tolerance.
const BROAD: usize = 100;
/// Cells above which a posterior is not refined any further for a rival's sake.
const MOST_FOR_RIVAL: usize = 400;
/// Logarithm of the weight below which an error level is left out, and what the first estimate of it may be wrong by.
const LEVEL_FLOOR: f64 = -9.0;
const LEVEL_SLACK: f64 = 5.0;

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
            // A valley that is straight and narrower than can be resolved over its length would lose all of it but an end.
            let valley = kept.len() >= SURVIVORS && self.longest_m(step) <= FINE * self.tolerance_m;
            // More are left by equal bounds only: nothing tells them apart, and all of their quarters would be left again.
            if kept.len() > SURVIVORS {
                let mut posterior = self.density(kept, step, &scopes);
                posterior.stages = stages + 1;
                return (posterior, kept_for_later);
            }
            if (resolved || valley) && kept.len() > BROAD || coarse && stages > 1 {
                let here = if valley { select(&offsets, &excess, PRUNE, usize::MAX) } else { kept.clone() };
                let mut posterior = self.density(here, step, &scopes);
                if coarse && self.hopeless(&posterior, step[0] / first_step)
                    || (resolved || valley) && self.near_mode(&posterior) < 0.5
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
            let kept = posterior.survivors(PRUNE, SURVIVORS + 1);
            // A rival that is narrower than a broad answer is not worth a fine lattice over all of that.
            if kept.is_empty() || kept.len() > SURVIVORS || coarse == Coarse::Rival && kept.len() > MOST_FOR_RIVAL {
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
            .filter(|(o, lp)| **lp > NEGLIGIBLE_LOG && near(o))
            .map(|(_, lp)| lp.exp())
            .sum()
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
            let tempering = self.tempering(channel, &scored.blocks, scopes[c].levels.clone());
            let best = &reference.log_likelihood[c];
            let share =
                |v: usize| (reference.weights[c][v] + LEVEL_SLACK).min(0.0) - (reference.areas[c][v] - cell).max(0.0);
            let shares: [f64; LEVELS] = std::array::from_fn(share);
            for (i, sum) in excess.iter_mut().enumerate() {
                let scores = &scored.blocks[i / LANES].log_likelihood;
                *sum += levels
                    .clone()
                    .map(|v| shares[v] + tempering.temper[v] * (scores[if cover { 0 } else { v }][i % LANES] - best[v]))
                    .fold(f64::NEG_INFINITY, f64::max);
            }
        }
        excess
    }

    /// Leaves out the error levels and the components of the nuisance parameters that no longer carry anything.
    fn narrow(&self, scopes: &mut [Scope], reference: &Reference, bounds: &Likelihoods, bounded: &[Scope]) {
        for (c, scope) in scopes.iter_mut().enumerate() {
            let weights = &reference.weights[c];
            let carries = |v: &usize| weights[*v] + LEVEL_SLACK > LEVEL_FLOOR;
            let levels = scope.levels.clone();
            if let (Some(first), Some(last)) = (levels.clone().find(carries), levels.clone().rev().find(carries)) {
                scope.levels = first..last + 1;
            }
            if scope.components.len() > 1 {
                let tempering = self.tempering(&self.channels[c], &bounds[c].blocks, bounded[c].levels.clone());
                let cover = bounded[c].cover;
                let within = |best: &[f64; LEVELS]| {
                    let above = |v: usize| best[if cover { 0 } else { v }] - reference.log_likelihood[c][v];
                    let below = |v: usize| tempering.temper[v] * above(v) + (weights[v] + LEVEL_SLACK).min(0.0);
                    levels.clone().any(|v| below(v) > -PRUNE)
                };
                let kept: Vec<bool> = bounds[c].best_of_component.iter().map(within).collect();
                if kept.contains(&true) {
                    let mut kept = kept.iter();
                    scope.components.retain(|_| *kept.next().unwrap_or(&true));
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
