//! From likelihoods to a posterior over offsets: stages, error levels, correlation and registration.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::kernel::{self, LANES, Scores, Scratch, Setup};
use super::model::{Channel, LEVELS, Level, Noise, Nuisance, PosteriorOptions};
use super::patch::Patch;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::displacement_m;
use crate::track::Track;

/// Tempered log-likelihood below the best at which a cell is not refined any further, going by the bound over the cell.
const PRUNE: f64 = 12.0;
/// The same for a sequence that goes on: later samples may yet change the order.
const PRUNE_STREAM: f64 = 28.0;
/// Candidates of the first stage where the step is chosen here.
const FIRST_STAGE: f64 = 2500.0;
/// Most cells that survive a stage.
const SURVIVORS: usize = 6000;
/// Risk over the first lattice from which a sequence that goes on is not searched any closer.
const HOPELESS: f64 = 0.3;
/// Modes that the last lattice has to resolve, and how far in the logarithm below the best they may lie.
const RIVALS: usize = 4;
const RIVAL: f64 = 6.0;
/// Cells that are left from which a posterior may be wider than the tolerance.
const BROAD: usize = 100;
/// Cells from which the reference place is sought.
const STARTS: usize = 8;
/// Greatest lattice step, in cells, at which the error level of an unknown map is judged.
const UNKNOWN_STEP: f64 = 0.1251;
/// Most halvings of the lattice step below one cell of the map.
const HALVINGS: i32 = 6;
/// Logarithm of the weight below which an error level is left out, and what the first estimate of it may be wrong by.
const LEVEL_FLOOR: f64 = -9.0;
const LEVEL_SLACK: f64 = 5.0;
/// Lattice step in standard deviations of the posterior at which sums over the lattice are integrals to 1e-3.
const RESOLUTION: f64 = 1.4;
/// Logarithm of a share that changes no sum.
const NOTHING: f64 = -36.0;
/// Samples times candidates times levels below which one thread is faster than several.
const PARALLEL: usize = 16_000;

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

/// What is to be expected of a track: see [`Problem::expected`].
pub(super) struct Expected {
    pub bound: [[f64; 2]; 2],
    pub covariance: [[f64; 2]; 2],
    /// Correlation of the map's error from one sample to the next.
    pub coefficient: f64,
    pub map_sigma: Vec<f64>,
    pub sensor_sigma: f64,
}

/// A problem made ready: everything that does not depend on the candidate.
pub(super) struct Problem<'a> {
    pub options: &'a PosteriorOptions,
    pub field: &'a dyn Field,
    channels: Vec<Prepared>,
    positions: Vec<[f64; 2]>,
    nuisance: Nuisance,
    /// Metres per map unit.
    pub scale_m: [f64; 2],
    pub cell: [f64; 2],
    pub tolerance_m: f64,
    spacing_m: f64,
}

struct Prepared {
    patch: Arc<Patch>,
    /// Indicated positions in cells of the patch.
    places: Vec<[f64; 2]>,
    /// Measured values minus the patch's level, value units.
    values: Vec<f32>,
    noise: Noise,
    cell_m: [f64; 2],
    /// Unit of the kernel's residuals, value units.
    unit: f64,
}

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
    /// Lattice step that resolves the mode there, map units.
    step: [f64; 2],
}

/// What a channel's errors amount to over the candidates.
struct Law {
    /// Mean distance to the data, metres.
    distance: f64,
    /// Whether any candidate lies on the map.
    known: bool,
    /// Power to which the likelihood is taken, a level.
    temper: [f64; LEVELS],
    /// Share of the map in the error variance, a level.
    share: [f64; LEVELS],
}

/// Scores of all candidates by all channels, `[channel][block]`.
type Likelihoods = Vec<Vec<Scores>>;

impl<'a> Problem<'a> {
    /// Checks the input and lays out the maps.
    pub fn new(channels: &[Channel<'a>], track: &Track, options: &'a PosteriorOptions) -> Result<Self> {
        Self::on(channels, track, options, None)
    }

    /// The same, on a window of the first map that was laid out before and covers all candidates.
    pub fn on(
        channels: &[Channel<'a>],
        track: &Track,
        options: &'a PosteriorOptions,
        laid_out: Option<&Arc<Patch>>,
    ) -> Result<Self> {
        options.validate()?;
        let Some(first) = channels.first() else {
            return Err(Error::invalid("channels", "at least one map with its values", "none"));
        };
        let field = first.field;
        let n = track.len();
        let positions: Vec<[f64; 2]> = (0..n).map(|k| [field.wrap_x(track.x()[k]), track.y()[k]]).collect();
        let middle = positions.iter().map(|p| p[1]).sum::<f64>() / n as f64;
        let scale_m = field.metres_per_unit(middle);
        let cell = field.spacing();
        let newest = positions[n - 1];
        let away: Vec<[f64; 2]> = positions.iter().map(|p| displacement_m(field.geographic(), newest, *p)).collect();
        let spacing_m = positions
            .windows(2)
            .map(|w| {
                let [e, north] = displacement_m(field.geographic(), w[0], w[1]);
                e.hypot(north)
            })
            .sum::<f64>()
            / (n.max(2) - 1) as f64;
        let age: Vec<f64> = match track.time_s() {
            Some(t) if t[n - 1] > t[0] => t.iter().map(|t_k| (t[n - 1] - t_k) / (t[n - 1] - t[0])).collect(),
            _ => (0..n).map(|k| (n - 1 - k) as f64 / (n.max(2) - 1) as f64).collect(),
        };
        let nuisance = Nuisance::new(options, &away, &age);
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for p in &positions {
            for d in 0..2 {
                low[d] = low[d].min(p[d] - options.half_width[d]);
                high[d] = high[d].max(p[d] + options.half_width[d]);
            }
        }
        let mut prepared = Vec::with_capacity(channels.len());
        for (index, channel) in channels.iter().enumerate() {
            if channel.values.len() != n {
                return Err(Error::shape(
                    format!("values of channel {index}"),
                    format!("({n},) as the track"),
                    format!("({},)", channel.values.len()),
                ));
            }
            crate::error::require_finite("values", channel.values)?;
            if channel.field.geographic() != field.geographic() {
                return Err(Error::invalid(
                    format!("map of channel {index}"),
                    "the same kind of coordinates as the first map",
                    if channel.field.geographic() { "degrees" } else { "metres" },
                ));
            }
            let patch = match laid_out {
                Some(patch) if index == 0 => Arc::clone(patch),
                _ => Arc::new(Patch::new(channel.field, low, high)),
            };
            let values: Vec<f32> = channel.values.iter().map(|v| (v - patch.level) as f32).collect();
            let noise = Noise::new(channel, options)?;
            let cell_m = [patch.step()[0] * scale_m[0], patch.step()[1] * scale_m[1]];
            let places: Vec<[f64; 2]> = positions.iter().map(|p| patch.position(p[0], p[1])).collect();
            // The kernel's unit is the typical error, so that single precision has room on both sides of it.
            let variances = places.iter().map(|p| f64::from(patch.at(p[0], p[1]).variance));
            let map_variance = variances.filter(|v| v.is_finite()).sum::<f64>() / n as f64;
            let largest = values.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            let unit = (noise.sensor_variance + map_variance).sqrt().max(1e-7 * f64::from(largest)).max(1e-30);
            prepared.push(Prepared { patch, places, values, noise, cell_m, unit });
        }
        let tolerance_m = options.tolerance_m.unwrap_or_else(|| (cell[0] * scale_m[0]).max(cell[1] * scale_m[1]));
        Ok(Self { options, field, channels: prepared, positions, nuisance, scale_m, cell, tolerance_m, spacing_m })
    }

    /// The offsets of the first stage and their step.
    pub fn lattice(&self) -> Result<(Vec<[f64; 2]>, [f64; 2])> {
        lattice(self.cell, self.options)
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
            let posterior = self.density(offsets.clone(), step, &self.all_levels());
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
            let posterior = self.density(offsets, step, &self.all_levels());
            let kept = if keep { posterior.survivors(PRUNE_STREAM) } else { Vec::new() };
            return (posterior, kept);
        }
        let mut stages = 1;
        let first_step = step[0];
        let mut levels = self.all_levels();
        let mut bounds = self.likelihoods::<true>(&offsets, step, &levels);
        let Some(reference) = self.reference(&offsets, step, &bounds) else {
            // No candidate lies on the map.
            return (self.density(offsets, step, &levels), Vec::new());
        };
        let mut kept_for_later = Vec::new();
        loop {
            let excess = self.excess(&reference, &bounds, &levels, step, offsets.len());
            if keep && stages == 1 {
                kept_for_later = select(&offsets, &excess, PRUNE_STREAM, usize::MAX);
            }
            if step[0] <= reference.step[0] * 1.001 {
                break;
            }
            let kept = select(&offsets, &excess, PRUNE, SURVIVORS);
            for (range, weights) in levels.iter_mut().zip(&reference.weights) {
                let carries = |v: &usize| weights[*v] + LEVEL_SLACK > LEVEL_FLOOR;
                let (first, last) = (range.clone().find(carries), range.clone().rev().find(carries));
                if let (Some(first), Some(last)) = (first, last) {
                    *range = first..last + 1;
                }
            }
            // A posterior that is wider than the tolerance and that this lattice resolves needs no finer one to say so.
            let resolved = self.longest_m(step) <= RESOLUTION * reference.spread_m;
            if resolved && kept.len() > BROAD || coarse && stages > 1 {
                let mut posterior = self.density(kept.clone(), step, &levels);
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
            bounds = self.likelihoods::<true>(&offsets, step, &levels);
        }
        let mut posterior = self.density(offsets, step, &levels);
        // Where the mode turned out narrower than the reference said.
        while !self.fine_enough(&posterior) {
            let kept = posterior.survivors(PRUNE);
            if kept.is_empty() {
                break;
            }
            let finer = posterior.step.map(|s| 0.5 * s);
            posterior = self.density(children(&kept, posterior.step), finer, &levels);
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

    fn all_levels(&self) -> Vec<Range<usize>> {
        self.channels.iter().map(|c| 0..c.noise.levels.len()).collect()
    }

    /// The most likely place, sought from the cells of the highest bounds by halving; `None` where no candidate is on the map.
    fn reference(&self, offsets: &[[f64; 2]], step: [f64; 2], bounds: &Likelihoods) -> Option<Reference> {
        let rank = |likelihoods: &Likelihoods, offsets: &[[f64; 2]]| {
            let mut order: Vec<(f64, usize)> = (0..offsets.len())
                .map(|i| {
                    let sum: f64 = self
                        .channels
                        .iter()
                        .zip(likelihoods)
                        .map(|(c, blocks)| blocks[i / LANES].log_likelihood[c.noise.middle()][i % LANES])
                        .sum();
                    (sum, i)
                })
                .filter(|(sum, _)| sum.is_finite())
                .collect();
            let by_rank = |a: &(f64, usize), b: &(f64, usize)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
            if order.len() > STARTS {
                order.select_nth_unstable_by(STARTS - 1, by_rank);
                order.truncate(STARTS);
            }
            order.sort_by(by_rank);
            order
        };
        let all = self.all_levels();
        let first = rank(bounds, offsets);
        if first.is_empty() {
            return None;
        }
        let mut step = step;
        let mut places: Vec<[f64; 2]> = first.iter().map(|&(_, i)| offsets[i]).collect();
        loop {
            let some = children(&places, step);
            step = step.map(|s| 0.5 * s);
            let densities = self.likelihoods::<false>(&some, step, &all);
            let order = rank(&densities, &some);
            let &(_, best) = order.first()?;
            places = order.iter().map(|&(_, i)| some[i]).collect();
            let log_likelihood: Vec<[f64; LEVELS]> = densities
                .iter()
                .map(|blocks| std::array::from_fn(|v| blocks[best / LANES].log_likelihood[v][best % LANES]))
                .collect();
            let found = self.at_reference(some[best], step, &densities, log_likelihood);
            if self.resolves(step, found.spread_m) {
                return Some(found);
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
        let mut scratch = Scratch::default();
        let mut total = [0.0; 3];
        let mut blurred = 0.0_f64;
        let (mut all, mut areas) = (Vec::with_capacity(self.channels.len()), Vec::with_capacity(self.channels.len()));
        let prior = [0, 1].map(|d| 3.0 / (self.options.half_width[d] * self.scale_m[d]).powi(2));
        for (channel, (blocks, log)) in self.channels.iter().zip(densities.iter().zip(&log_likelihood)) {
            let levels = &channel.noise.levels;
            let setup = self.setup(channel, levels, step);
            let law = self.law(channel, blocks, 0..levels.len());
            let cells = channel.cells(offset);
            let information: Vec<[f64; 3]> =
                levels.iter().map(|level| kernel::detail(&setup, cells, *level, &mut scratch).information).collect();
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
        Reference { log_likelihood, weights: all, areas, spread_m, step }
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
        levels: &[Range<usize>],
        step: [f64; 2],
        count: usize,
    ) -> Vec<f64> {
        let mut excess = vec![0.0; count];
        let cell = (step[0] * self.scale_m[0] * step[1] * self.scale_m[1]).ln();
        for (c, (channel, blocks)) in self.channels.iter().zip(bounds).enumerate() {
            let law = self.law(channel, blocks, levels[c].clone());
            let best = &reference.log_likelihood[c];
            let share =
                |v: usize| (reference.weights[c][v] + LEVEL_SLACK).min(0.0) - (reference.areas[c][v] - cell).max(0.0);
            let shares: [f64; LEVELS] = std::array::from_fn(share);
            for (i, sum) in excess.iter_mut().enumerate() {
                let scores = &blocks[i / LANES].log_likelihood;
                *sum += levels[c]
                    .clone()
                    .map(|v| shares[v] + law.temper[v] * (scores[v][i % LANES] - best[v]))
                    .fold(f64::NEG_INFINITY, f64::max);
            }
        }
        excess
    }

    /// Whether a finer lattice would change nothing that matters: whether this one resolves every mode that carries mass.
    fn fine_enough(&self, posterior: &Posterior) -> bool {
        let Some(best) = posterior.mode() else { return true };
        let tolerance2 = self.tolerance_m * self.tolerance_m;
        let mut left: Vec<usize> = (0..posterior.offsets.len())
            .filter(|&i| posterior.log_p[i] > posterior.log_p[best] - 2.0 * RIVAL)
            .collect();
        let mut top = best;
        for _ in 0..RIVALS {
            let centre = posterior.offsets[top];
            let mut sums = [0.0; 3];
            left.retain(|&i| {
                let o = posterior.offsets[i];
                let (dx, dy) = ((o[0] - centre[0]) * self.scale_m[0], (o[1] - centre[1]) * self.scale_m[1]);
                let near = dx * dx + dy * dy <= tolerance2;
                if near {
                    let p = (posterior.log_p[i] - posterior.log_p[best]).exp();
                    sums[0] += p;
                    sums[1] += p * dx * dx;
                    sums[2] += p * dy * dy;
                }
                !near
            });
            let spread = (sums[1].min(sums[2]) / sums[0].max(f64::MIN_POSITIVE)).sqrt();
            if !self.resolves(posterior.step, spread.max(posterior.blur_m[top])) {
                return false;
            }
            let next = left.iter().copied().reduce(|a, b| if posterior.log_p[b] > posterior.log_p[a] { b } else { a });
            match next {
                Some(next) if posterior.log_p[next] > posterior.log_p[best] - RIVAL => top = next,
                _ => break,
            }
        }
        true
    }

    fn setup<'b>(&'b self, channel: &'b Prepared, levels: &'b [Level], step: [f64; 2]) -> Setup<'b> {
        let jitter = self.options.position_sigma_m.powi(2);
        // The lattice step is the width of a uniform law.
        let blur = |d: usize| ((step[d] * self.scale_m[d]).powi(2) / 12.0 + jitter) as f32;
        Setup {
            patch: &channel.patch,
            places: &channel.places,
            values: &channel.values,
            per_unit: (1.0 / channel.unit) as f32,
            cell_m: channel.cell_m.map(|m| m as f32),
            half_cells: channel.cells(step).map(|s| (0.5 * s) as f32),
            blur_m2: [blur(0), blur(1)],
            sensor_variance: channel.sensor_variance() as f32,
            levels,
            bias_sigma: match self.options.bias_sigma {
                None => Some(f64::INFINITY),
                Some(0.0) => None,
                Some(s) => Some(s / channel.unit),
            },
            shapes: &self.nuisance.shapes,
            min_overlap: self.options.min_overlap,
        }
    }

    /// Log-likelihoods of these offsets under the given levels of every channel: densities, or bounds over cells of this step.
    fn likelihoods<const BOUND: bool>(
        &self,
        offsets: &[[f64; 2]],
        step: [f64; 2],
        levels: &[Range<usize>],
    ) -> Likelihoods {
        let mut all = Vec::with_capacity(self.channels.len());
        for (channel, range) in self.channels.iter().zip(levels) {
            let mut setup = self.setup(channel, &channel.noise.levels, step);
            if BOUND {
                setup.blur_m2 = [self.options.position_sigma_m.powi(2) as f32; 2];
            }
            let cells: Vec<[f64; 2]> = offsets.iter().map(|o| channel.cells(*o)).collect();
            let range = range.clone();
            let blocks: Vec<Scores> = if offsets.len() * channel.places.len() * range.len() < PARALLEL {
                let mut scratch = Scratch::default();
                cells
                    .chunks(LANES)
                    .map(|block| kernel::score::<BOUND>(&setup, block, range.clone(), &mut scratch))
                    .collect()
            } else {
                cells
                    .par_chunks(LANES)
                    .with_min_len(8)
                    .map_init(Scratch::default, |scratch, block| {
                        kernel::score::<BOUND>(&setup, block, range.clone(), scratch)
                    })
                    .collect()
            };
            all.push(blocks);
        }
        all
    }

    /// The posterior over exactly these offsets.
    fn density(&self, offsets: Vec<[f64; 2]>, step: [f64; 2], levels: &[Range<usize>]) -> Posterior {
        let mut log_p = vec![0.0; offsets.len()];
        let mut blur2 = vec![0.0; offsets.len()];
        let likelihoods = self.likelihoods::<false>(&offsets, step, levels);
        for ((channel, blocks), range) in self.channels.iter().zip(&likelihoods).zip(levels) {
            self.combine(channel, blocks, range.clone(), &mut log_p, &mut blur2);
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
    fn law(&self, channel: &Prepared, blocks: &[Scores], levels: Range<usize>) -> Law {
        let noise = &channel.noise;
        let (mut distance, mut map_variance, mut count) = (0.0_f64, 0.0_f64, 0.0_f64);
        for b in blocks {
            for l in 0..LANES {
                if b.log_likelihood[levels.start][l].is_finite() {
                    distance += f64::from(b.distance[l]);
                    map_variance += f64::from(b.map_variance[l]);
                    count += 1.0;
                }
            }
        }
        distance /= count.max(1.0);
        map_variance /= count.max(1.0);
        let mut law = Law { distance, known: count > 0.0, temper: [1.0; LEVELS], share: [0.0; LEVELS] };
        for (v, level) in noise.levels.iter().enumerate() {
            // Effective share of independent samples in errors that decorrelate over a length l: those of an AR(1) series
            // with coefficient exp(-spacing / l) count as (1 - rho) / (1 + rho) = tanh(spacing / 2 l).
            let length =
                noise.correlation * distance * if noise.levels_are_distances { level.factor.min(1.0) } else { 1.0 };
            let independent = if length > 0.0 { (0.5 * self.spacing_m / length).tanh().max(1e-3) } else { 1.0 };
            let variance = level.factor * level.factor * map_variance;
            let share = variance / (variance + channel.sensor_variance());
            law.share[v] = share;
            law.temper[v] = 1.0 / ((1.0 - share) + share / independent);
        }
        law
    }

    /// Adds one channel's log posterior density: error levels weighed by their evidence, each tempered by the
    /// correlation of the errors that it stands for.
    fn combine(
        &self,
        channel: &Prepared,
        blocks: &[Scores],
        levels: Range<usize>,
        log_p: &mut [f64],
        blur2: &mut [f64],
    ) {
        let noise = &channel.noise;
        let law = self.law(channel, blocks, levels.clone());
        if !law.known {
            log_p.fill(f64::NEG_INFINITY);
            return;
        }
        let mut best = [f64::NEG_INFINITY; LEVELS];
        for v in levels.clone() {
            for b in blocks {
                best[v] = b.log_likelihood[v].iter().copied().fold(best[v], f64::max);
            }
        }
        let log_sum = |v: usize, temper: f64| {
            let mut sum = 0.0;
            for b in blocks {
                for log in b.log_likelihood[v] {
                    let below = temper * (log - best[v]);
                    if below > NOTHING {
                        sum += below.exp();
                    }
                }
            }
            temper * best[v] + sum.ln()
        };
        let weights = law.weights(noise, levels.clone(), log_sum);
        let mut normalise = [0.0; LEVELS];
        for v in levels.clone() {
            normalise[v] = log_sum(v, law.temper[v]);
        }
        for i in 0..log_p.len() {
            let (block, l) = (&blocks[i / LANES], i % LANES);
            let mut logs = [f64::NEG_INFINITY; LEVELS];
            let mut top = f64::NEG_INFINITY;
            for v in levels.clone() {
                logs[v] = weights[v] + law.temper[v] * block.log_likelihood[v][l] - normalise[v];
                top = top.max(logs[v]);
            }
            if !top.is_finite() {
                log_p[i] = f64::NEG_INFINITY;
                continue;
            }
            let (mut total, mut blurred) = (0.0, 0.0);
            for v in levels.clone() {
                if logs[v] - top > NOTHING {
                    let p = (logs[v] - top).exp();
                    let displaced = noise.displacement(f64::from(block.distance[l]), &noise.levels[v]);
                    total += p;
                    blurred += p * law.share[v] * displaced * displaced;
                }
            }
            log_p[i] += top + total.ln();
            blur2[i] += blurred / total;
        }
    }

    /// A close look at one offset: see [`kernel::detail`]. The level is the one that explains the residuals best.
    pub fn detail(&self, offset: [f64; 2], step: [f64; 2]) -> (kernel::Detail, f64) {
        let channel = &self.channels[0];
        let mut scratch = Scratch::default();
        let levels = &channel.noise.levels;
        let setup = self.setup(channel, levels, step);
        // The middle of a spread of levels, or the worst that an unknown map may be.
        let level = levels[if channel.noise.levels_are_distances { levels.len() - 1 } else { levels.len() / 2 }];
        let mut detail = kernel::detail(&setup, channel.cells(offset), level, &mut scratch);
        detail.bias *= channel.unit;
        for (theta, sigma) in detail.theta.iter_mut().zip(&self.nuisance.sigmas) {
            *theta *= sigma;
        }
        (detail, level.nu)
    }

    /// What is to be expected at the track's own positions: offset zero, no noise in the values.
    pub fn expected(&self) -> Expected {
        let channel = &self.channels[0];
        let noise = &channel.noise;
        let levels = &noise.levels;
        // The level expected of this map: the middle one, or the most probable of an unknown map.
        let level = levels.iter().copied().fold(levels[0], |a, b| if b.log_prior > a.log_prior { b } else { a });
        let setup = self.setup(channel, levels, [0.0, 0.0]);
        let mut scratch = Scratch::default();
        let detail = kernel::detail(&setup, [0.0, 0.0], level, &mut scratch);
        let (map_sigma, distance) = self.along(channel);
        let scaled: Vec<f64> = map_sigma.iter().map(|s| level.factor * s).collect();
        let variance = scaled.iter().map(|s| s * s).sum::<f64>() / scaled.len().max(1) as f64;
        let share = variance / (variance + noise.sensor_variance);
        let length = noise.correlation * distance;
        let coefficient = if length > 0.0 && share > 0.0 { (-self.spacing_m / length).exp() } else { 0.0 };
        let independent = (1.0 - coefficient) / (1.0 + coefficient);
        let temper = 1.0 / ((1.0 - share) + share / independent.max(1e-3));
        let half = self.options.half_width;
        let prior = [0, 1].map(|d| 3.0 / (half[d] * self.scale_m[d]).powi(2));
        let invert = |factor: f64| {
            let [ee, en, nn] = detail.information.map(|i| factor * i);
            let (ee, nn) = (ee + prior[0], nn + prior[1]);
            let determinant = ee * nn - en * en;
            [[nn / determinant, -en / determinant], [-en / determinant, ee / determinant]]
        };
        let registration = share * (noise.registration * distance).powi(2);
        // What the Student-t estimate loses against the normal one where errors are normal: with nu = 3 some 10 %, with 10 some 2 %.
        let loss = 1.0 + 1.0 / (level.nu * level.nu);
        let mut covariance = invert(temper);
        for (d, row) in covariance.iter_mut().enumerate() {
            for v in row.iter_mut() {
                *v *= loss;
            }
            row[d] += registration;
        }
        Expected {
            bound: invert(1.0),
            covariance,
            coefficient,
            map_sigma: scaled,
            sensor_sigma: noise.sensor_variance.sqrt(),
        }
    }

    /// Map sigma at every indicated position, and the mean distance to the data.
    fn along(&self, channel: &Prepared) -> (Vec<f64>, f64) {
        let (mut sigma, mut distance, mut known) = (Vec::with_capacity(self.positions.len()), 0.0, 0.0);
        for p in &self.positions {
            let [px, py] = channel.patch.position(p[0], p[1]);
            let sample = channel.patch.at(px, py);
            let here = sample.value.is_finite();
            sigma.push(if here { f64::from(sample.variance).sqrt() } else { 0.0 });
            if here {
                distance += f64::from(sample.distance);
                known += 1.0;
            }
        }
        (sigma, if known > 0.0 { distance / known } else { 0.0 })
    }

    /// Factor by which correlation widens the law of the mean misfit.
    pub fn misfit_inflation(&self) -> f64 {
        let channel = &self.channels[0];
        let spread = channel.noise.levels.iter().map(|l| l.factor).fold(0.0, f64::max).max(1.0);
        spread * 3.0
    }

    /// Parameters beside the bias as (heading in degrees, scale) from a solution.
    pub fn heading_and_scale(&self, theta: &[f64]) -> (f64, f64) {
        let mut i = 0;
        let mut next = |present: bool| {
            if present {
                i += 1;
                theta.get(i - 1).copied().unwrap_or(0.0)
            } else {
                0.0
            }
        };
        let heading = next(self.options.heading_sigma_deg > 0.0);
        let scale = next(self.options.scale_sigma > 0.0);
        (heading.to_degrees(), 1.0 + scale)
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

    /// Offsets within `depth` of the best, the best [`SURVIVORS`] where there are more.
    fn survivors(&self, depth: f64) -> Vec<[f64; 2]> {
        let Some(best) = self.mode() else { return Vec::new() };
        let below: Vec<f64> = self.log_p.iter().map(|lp| lp - self.log_p[best]).collect();
        select(&self.offsets, &below, depth, SURVIVORS)
    }
}

impl Prepared {
    /// Map units to cells of this channel's map.
    fn cells(&self, offset: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.patch.step();
        [offset[0] / x, offset[1] / y]
    }

    /// In units of the kernel.
    fn sensor_variance(&self) -> f64 {
        (self.noise.sensor_variance / (self.unit * self.unit)).max(1e-12)
    }
}

impl Law {
    /// Logarithms of the levels' weights, the largest 0: evidence of each level against its neighbour, both at the smaller
    /// of their tempers, so that a hypothesis is not favoured for the logarithm of its units.
    fn weights(&self, noise: &Noise, levels: Range<usize>, evidence: impl Fn(usize, f64) -> f64) -> [f64; LEVELS] {
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

/// The offsets whose `merit` is above minus `depth`, the best `most` where there are more, in their order.
fn select(offsets: &[[f64; 2]], merit: &[f64], depth: f64, most: usize) -> Vec<[f64; 2]> {
    let mut floor = -depth;
    let mut values: Vec<f64> = merit.iter().copied().filter(|m| *m >= floor).collect();
    if values.len() > most {
        values.select_nth_unstable_by(most - 1, |a, b| b.total_cmp(a));
        floor = values[most - 1];
    }
    offsets.iter().zip(merit).filter(|(_, m)| **m >= floor).map(|(o, _)| *o).collect()
}

/// Variance per axis of a place anywhere in a lattice cell, square metres.
fn lattice_variance(step: [f64; 2], scale_m: [f64; 2]) -> f64 {
    (0..2).map(|d| (step[d] * scale_m[d]).powi(2)).sum::<f64>() / 24.0
}

/// The four quarters of every cell of this step.
fn children(cells: &[[f64; 2]], step: [f64; 2]) -> Vec<[f64; 2]> {
    let [x, y] = step.map(|s| 0.25 * s);
    cells.iter().flat_map(|o| [[-x, -y], [x, -y], [-x, y], [x, y]].map(|[u, v]| [o[0] + u, o[1] + v])).collect()
}

/// The offsets of the first stage and their step, for a map of the given cell.
pub(super) fn lattice(cell: [f64; 2], options: &PosteriorOptions) -> Result<(Vec<[f64; 2]>, [f64; 2])> {
    let half = options.half_width;
    let step = options.step.unwrap_or_else(|| {
        // One cell, or coarser for a wide start: later stages refine, and the variance knows the step.
        let cells = (2.0 * half[0] / cell[0] + 1.0) * (2.0 * half[1] / cell[1] + 1.0);
        let factor = (cells / FIRST_STAGE).sqrt().max(1.0);
        // Beyond a few cells a coarse sample says nothing about the features between.
        let factor = factor.min(4.0);
        [cell[0] * factor, cell[1] * factor]
    });
    let count = |d: usize| 2 * ((half[d] / step[d] - 1e-9).ceil().max(0.0) as u128) + 1;
    let (columns, rows) = (count(0), count(1));
    let needed = columns.saturating_mul(rows);
    if needed > u128::from(options.max_candidates) {
        return Err(Error::TooManyCandidates { what: "offset lattice".into(), needed, limit: options.max_candidates });
    }
    let (cx, cy) = ((columns / 2) as f64, (rows / 2) as f64);
    let mut offsets = Vec::with_capacity(needed as usize);
    for j in 0..rows as usize {
        for i in 0..columns as usize {
            offsets.push([(i as f64 - cx) * step[0], (j as f64 - cy) * step[1]]);
        }
    }
    Ok((offsets, step))
}
