//! From the likelihoods of a lattice to a posterior over it: error levels, correlation and registration.

use std::ops::Range;

use super::kernel::{LANES, Scores};
use super::lattice::{lattice_variance, select};
use super::noise::{LEVELS, Noise};
use super::problem::{PreparedChannel, Problem, Scope};

/// Logarithm of a share that changes no sum.
pub(super) const NEGLIGIBLE_LOG: f64 = -36.0;

/// Discrete posterior over offsets.
#[derive(Debug, Clone)]
pub(super) struct Posterior {
    /// Offsets, map units.
    pub offsets: Vec<[f64; 2]>,
    /// Natural logarithms of the probabilities; they sum to one.
    pub log_p: Vec<f64>,
    /// Standard deviation per axis by which each is blurred: registration of the map and half the lattice step, metres.
    pub blur_m: Vec<f64>,
    /// Lattice step, map units.
    pub step: [f64; 2],
    /// Stages taken.
    pub stages: usize,
}

/// What a channel's errors amount to over the candidates.
pub(super) struct Tempering {
    /// Mean distance to the data, metres.
    pub distance: f64,
    /// Whether any candidate lies on the map.
    known: bool,
    /// Power to which the likelihood is taken, a level.
    pub temper: [f64; LEVELS],
    /// Share of the map in the error variance, a level.
    pub share: [f64; LEVELS],
}

impl Problem<'_> {
    /// The posterior over exactly these offsets.
    pub fn density(&self, offsets: Vec<[f64; 2]>, step: [f64; 2], scopes: &[Scope]) -> Posterior {
        let mut log_p = vec![0.0; offsets.len()];
        let mut blur2 = vec![0.0; offsets.len()];
        let likelihoods = self.likelihoods::<false>(&offsets, step, scopes);
        for ((channel, scored), scope) in self.channels.iter().zip(&likelihoods).zip(scopes) {
            self.combine(channel, &scored.blocks, scope.levels.clone(), &mut log_p, &mut blur2);
        }
        let best = log_p.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if best.is_finite() {
            let total = log_p.iter().map(|lp| (lp - best).exp()).sum::<f64>().ln() + best;
            for lp in &mut log_p {
                *lp -= total;
            }
        }
        let between = lattice_variance(step, self.scale_m);
        let blur_m = blur2.iter().map(|b| (b + between).sqrt()).collect();
        Posterior { offsets, log_p, blur_m, step, stages: 1 }
    }

    /// Tempers of a channel's levels, from the means over the candidates that lie on the map.
    pub fn tempering(&self, channel: &PreparedChannel, blocks: &[Scores], levels: Range<usize>) -> Tempering {
        let noise = &channel.noise;
        let (mut distance, mut map_variance, mut between, mut count) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        for b in blocks {
            for l in 0..LANES {
                if b.log_likelihood[levels.start][l].is_finite() {
                    distance += f64::from(b.distance[l]);
                    map_variance += f64::from(b.map_variance[l]);
                    between += f64::from(b.between[l]);
                    count += 1.0;
                }
            }
        }
        distance /= count.max(1.0);
        map_variance /= count.max(1.0);
        between /= count.max(1.0);
        let mut tempering = Tempering { distance, known: count > 0.0, temper: [1.0; LEVELS], share: [0.0; LEVELS] };
        for (v, level) in noise.levels.iter().enumerate() {
            (tempering.share[v], tempering.temper[v]) =
                channel.temper(level, distance, [map_variance, between], self.spacing_m);
        }
        tempering
    }

    /// Adds one channel's log posterior density: error levels weighed by their evidence, each tempered by the
    /// correlation of the errors that it stands for.
    fn combine(
        &self,
        channel: &PreparedChannel,
        blocks: &[Scores],
        levels: Range<usize>,
        log_p: &mut [f64],
        blur2: &mut [f64],
    ) {
        let noise = &channel.noise;
        let tempering = self.tempering(channel, blocks, levels.clone());
        if !tempering.known {
            log_p.fill(f64::NEG_INFINITY);
            return;
        }
        let mut best = [f64::NEG_INFINITY; LEVELS];
        for v in levels.clone() {
            for b in blocks {
                best[v] = b.log_likelihood[v].iter().copied().fold(best[v], f64::max);
            }
        }
        let mut known = [(f64::NAN, 0.0); LEVELS];
        let mut log_sum = |v: usize, temper: f64| {
            if known[v].0 == temper {
                return known[v].1;
            }
            let mut sum = 0.0;
            for b in blocks {
                for log in b.log_likelihood[v] {
                    let below = temper * (log - best[v]);
                    if below > NEGLIGIBLE_LOG {
                        sum += below.exp();
                    }
                }
            }
            known[v] = (temper, temper * best[v] + sum.ln());
            known[v].1
        };
        let weights = tempering.weights(noise, levels.clone(), &mut log_sum);
        let mut normalise = [0.0; LEVELS];
        for v in levels.clone() {
            normalise[v] = log_sum(v, tempering.temper[v]);
        }
        for i in 0..log_p.len() {
            let (block, l) = (&blocks[i / LANES], i % LANES);
            let mut logs = [f64::NEG_INFINITY; LEVELS];
            let mut top = f64::NEG_INFINITY;
            for v in levels.clone() {
                logs[v] = weights[v] + tempering.temper[v] * block.log_likelihood[v][l] - normalise[v];
                top = top.max(logs[v]);
            }
            if !top.is_finite() {
                log_p[i] = f64::NEG_INFINITY;
                continue;
            }
            let (mut total, mut blurred) = (0.0, 0.0);
            for v in levels.clone() {
                if logs[v] - top > NEGLIGIBLE_LOG {
                    let p = (logs[v] - top).exp();
                    let displaced = noise.displacement(f64::from(block.distance[l]), &noise.levels[v]);
                    total += p;
                    blurred += p * tempering.share[v] * displaced * displaced;
                }
            }
            log_p[i] += top + total.ln();
            blur2[i] += blurred / total;
        }
    }
}

impl Posterior {
    /// The most probable candidate; ties go to the smaller index.
    pub fn mode(&self) -> Option<usize> {
        let mut best: Option<usize> = None;
        for (i, lp) in self.log_p.iter().enumerate() {
            if lp.is_finite() && best.is_none_or(|b| *lp > self.log_p[b]) {
                best = Some(i);
            }
        }
        best
    }

    /// Offsets within `depth` of the best, the best `most` where there are more.
    pub fn survivors(&self, depth: f64, most: usize) -> Vec<[f64; 2]> {
        let Some(best) = self.mode() else { return Vec::new() };
        let below: Vec<f64> = self.log_p.iter().map(|lp| lp - self.log_p[best]).collect();
        select(&self.offsets, &below, depth, most)
    }
}

impl Tempering {
    /// Logarithms of the levels' weights, the largest 0: evidence of each level against its neighbour, both at the smaller
    /// of their tempers, so that a hypothesis is not favoured for the logarithm of its units.
    pub fn weights(
        &self,
        noise: &Noise,
        levels: Range<usize>,
        mut evidence: impl FnMut(usize, f64) -> f64,
    ) -> [f64; LEVELS] {
        let mut weights = [f64::NEG_INFINITY; LEVELS];
        weights[levels.start] = noise.levels[levels.start].log_prior;
        for v in levels.start + 1..levels.end {
            let common = self.temper[v].min(self.temper[v - 1]);
            weights[v] = weights[v - 1] + noise.levels[v].log_prior - noise.levels[v - 1].log_prior
                + evidence(v, common)
                - evidence(v - 1, common);
        }
        let top = weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        weights.map(|w| w - top)
    }
}
