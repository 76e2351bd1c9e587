//! The best place of a search and what the posterior looks like around it, to which the bounds of all cells are compared.

use super::kernel::LANES;
use super::lattice::children;
use super::noise::{ErrorLevel, LEVELS};
use super::problem::{Likelihoods, Problem};

/// Cells from which the reference place is sought.
const STARTS: usize = 8;
/// Greatest lattice step, in cells, at which the error level of an unknown map is judged.
const UNKNOWN_STEP: f64 = 0.1251;
/// Most halvings of the lattice step below one cell of the map: places are in single precision.
const HALVINGS: i32 = 20;
/// Lattice step in standard deviations of the posterior at which sums over the lattice are integrals to 1e-3.
pub(super) const RESOLUTION: f64 = 1.4;

/// The best place found, to which the bounds of all cells are compared.
pub(super) struct Reference {
    /// Its log-likelihood, `[channel][level]`.
    pub log_likelihood: Vec<[f64; LEVELS]>,
    /// Estimated logarithm of every level's weight, `[channel][level]`, the largest 0.
    pub weights: Vec<[f64; LEVELS]>,
    /// Logarithm of the area of every level's posterior there, in square metres, `[channel][level]`.
    pub areas: Vec<[f64; LEVELS]>,
    /// Smallest standard deviation of the posterior there, metres.
    pub spread_m: f64,
    /// Where it is, and the lattice step that resolves the mode there, map units.
    pub offset: [f64; 2],
    pub step: [f64; 2],
}

impl Problem<'_> {
    /// The most likely place, sought from the cells of the highest bounds by halving; `None` where no candidate is on the map.
    pub fn reference(&self, offsets: &[[f64; 2]], step: [f64; 2], bounds: &Likelihoods) -> Option<Reference> {
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
                            let any = |levels: &[ErrorLevel]| {
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
        let prior = self.prior_information();
        for (channel, (scored, log)) in self.channels.iter().zip(densities.iter().zip(&log_likelihood)) {
            let levels = &channel.noise.levels;
            let tempering = self.tempering(channel, &scored.blocks, 0..levels.len());
            let information = self.information(channel, offset, step);
            let area = |v: usize, temper: f64| {
                let [ee, en, nn] = information[v].map(|i| temper * i);
                std::f64::consts::TAU.ln()
                    - 0.5 * ((ee + prior[0]) * (nn + prior[1]) - en * en).max(f64::MIN_POSITIVE).ln()
            };
            let evidence = |v: usize, temper: f64| temper * log[v] + area(v, temper);
            let weights = tempering.weights(&channel.noise, 0..levels.len(), evidence);
            areas.push(std::array::from_fn(|v| if v < levels.len() { area(v, tempering.temper[v]) } else { 0.0 }));
            let top = (0..levels.len()).fold(0, |a, b| if weights[b] > weights[a] { b } else { a });
            for (sum, i) in total.iter_mut().zip(information[top]) {
                *sum += tempering.temper[top] * i;
            }
            blurred =
                blurred.max(channel.noise.displacement(tempering.distance, &levels[top]) * tempering.share[top].sqrt());
            all.push(weights);
        }
        let [ee, en, nn] = [total[0] + prior[0], total[1], total[2] + prior[1]];
        // The largest eigenvalue of the information is the smallest variance.
        let largest = 0.5 * (ee + nn) + (0.25 * (ee - nn).powi(2) + en * en).sqrt();
        let spread_m = largest.recip().sqrt().max(blurred);
        Reference { log_likelihood, weights: all, areas, spread_m, offset, step }
    }

    /// What the search itself says of the offset along each axis, the inverse of a variance in square metres: one narrower than a cell of
    /// the map goes over that cell.
    pub fn prior_information(&self) -> [f64; 2] {
        [0, 1].map(|d| 3.0 / (self.options.half_width[d].max(0.5 * self.cell[d]) * self.scale_m[d]).powi(2))
    }

    /// The longer side of a lattice cell, metres.
    pub fn longest_m(&self, step: [f64; 2]) -> f64 {
        (step[0] * self.scale_m[0]).max(step[1] * self.scale_m[1])
    }
    /// Whether a lattice of this step resolves a posterior of that spread.
    pub fn resolves(&self, step: [f64; 2], spread_m: f64) -> bool {
        let relative = (step[0] / self.cell[0]).max(step[1] / self.cell[1]);
        let step_m = self.longest_m(step);
        // Whether a map without a word on its errors is exact shows only on a lattice that an exact one would need.
        if relative > UNKNOWN_STEP && self.channels.iter().any(|c| c.noise.levels_are_distances) {
            return false;
        }
        relative <= 0.5_f64.powi(HALVINGS) * 1.001
            || (step_m <= 0.34 * self.tolerance_m && step_m <= RESOLUTION * spread_m)
    }
}
