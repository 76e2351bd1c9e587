//! From likelihoods to a posterior over offsets: stages, error levels, correlation and registration.

use std::sync::Arc;

use rayon::prelude::*;

use super::kernel::{self, LANES, Scores, Scratch, Setup};
use super::model::{Channel, Level, Noise, Nuisance, PosteriorOptions};
use super::patch::Patch;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::displacement_m;
use crate::track::Track;

/// Tempered log posterior below the best at which a candidate is not refined any further.
const PRUNE: f64 = 14.0;
/// Candidates of the first stage where the step is chosen here.
const FIRST_STAGE: f64 = 2500.0;
/// Most candidates that survive a stage.
const SURVIVORS: usize = 1500;
/// Most halvings of the lattice step below one cell of the map.
const HALVINGS: i32 = 6;
/// Samples times candidates below which one thread is faster than several.
const PARALLEL: usize = 20_000;

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
    values: Vec<f64>,
    noise: Noise,
    cell_m: [f64; 2],
}

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
            let values = channel.values.iter().map(|v| v - patch.level).collect();
            let noise = Noise::new(channel, options)?;
            let cell_m = [patch.step()[0] * scale_m[0], patch.step()[1] * scale_m[1]];
            prepared.push(Prepared { patch, values, noise, cell_m });
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
        self.refine(self.first_stage(offsets, step))
    }

    /// The posterior over `offsets` as they are, nuisance parameters as variance.
    pub fn first_stage(&self, offsets: Vec<[f64; 2]>, step: [f64; 2]) -> Posterior {
        self.evaluate(offsets, step, self.nuisance.shapes.is_empty())
    }

    /// Refines a first stage.
    pub fn refine(&self, mut posterior: Posterior) -> Posterior {
        let joint = !self.nuisance.shapes.is_empty();
        let step = posterior.step;
        let mut stages = 1;
        let fixed_step = self.options.step.is_some();
        if fixed_step && joint {
            let kept = posterior.survivors(2.0 * PRUNE);
            posterior = self.evaluate(kept, step, true);
            stages += 1;
        }
        if fixed_step {
            posterior.stages = stages;
            return posterior;
        }
        loop {
            let step = posterior.step;
            let settled = !joint || stages > 1;
            if settled && self.fine_enough(&posterior) {
                break;
            }
            let kept = posterior.survivors(if stages == 1 { 2.0 * PRUNE } else { PRUNE });
            if kept.is_empty() {
                break;
            }
            let half = [0.5 * step[0], 0.5 * step[1]];
            let children: Vec<[f64; 2]> = kept
                .iter()
                .flat_map(|o| {
                    [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]]
                        .map(|[u, v]| [o[0] + u * half[0], o[1] + v * half[1]])
                })
                .collect();
            posterior = self.evaluate(children, half, true);
            stages += 1;
        }
        posterior.stages = stages;
        posterior
    }

    /// Whether a finer lattice would change nothing that matters.
    fn fine_enough(&self, posterior: &Posterior) -> bool {
        let relative = (posterior.step[0] / self.cell[0]).max(posterior.step[1] / self.cell[1]);
        if relative <= 0.5_f64.powi(HALVINGS) * 1.001 {
            return true;
        }
        let step_m = [posterior.step[0] * self.scale_m[0], posterior.step[1] * self.scale_m[1]];
        if step_m[0].max(step_m[1]) > 0.34 * self.tolerance_m {
            return false;
        }
        // Spread of the main mode; the lattice is fine once it resolves that.
        let Some(best) = posterior.mode() else { return true };
        let centre = posterior.offsets[best];
        let mut sums = [0.0; 3];
        for (o, lp) in posterior.offsets.iter().zip(&posterior.log_p) {
            let (dx, dy) = ((o[0] - centre[0]) * self.scale_m[0], (o[1] - centre[1]) * self.scale_m[1]);
            if dx.hypot(dy) <= self.tolerance_m {
                let p = lp.exp();
                sums[0] += p;
                sums[1] += p * dx * dx;
                sums[2] += p * dy * dy;
            }
        }
        let spread = (sums[1].min(sums[2]) / sums[0].max(f64::MIN_POSITIVE)).sqrt().max(posterior.blur_m[best]);
        step_m[0].max(step_m[1]) <= spread
    }

    fn setup<'b>(&'b self, channel: &'b Prepared, levels: &'b [Level], step: [f64; 2], solve: bool) -> Setup<'b> {
        let jitter = self.options.position_sigma_m.powi(2);
        // A stage that will be refined must keep the cell that holds the truth, wherever in the cell that is: its variance
        // is that of the cell's border. A last stage has that of a uniform law.
        let coarse = self.options.step.is_none() && step[0] > 0.4 * self.cell[0];
        let share = if coarse { 0.25 } else { 1.0 / 12.0 };
        let blur = |d: usize| share * (step[d] * self.scale_m[d]).powi(2) + jitter;
        Setup {
            patch: &channel.patch,
            positions: &self.positions,
            values: &channel.values,
            cell_m: channel.cell_m,
            blur_m2: [blur(0), blur(1)],
            sensor_variance: channel.noise.sensor_variance,
            levels,
            bias_sigma: match self.options.bias_sigma {
                None => Some(f64::INFINITY),
                Some(0.0) => None,
                Some(s) => Some(s),
            },
            shapes: &self.nuisance.shapes,
            sigmas: &self.nuisance.sigmas,
            solve,
            min_overlap: self.options.min_overlap,
        }
    }

    /// The posterior over exactly these offsets.
    fn evaluate(&self, offsets: Vec<[f64; 2]>, step: [f64; 2], solve: bool) -> Posterior {
        let mut log_p = vec![0.0; offsets.len()];
        let mut blur2 = vec![0.0; offsets.len()];
        for channel in &self.channels {
            let setup = self.setup(channel, &channel.noise.levels, step, solve);
            let blocks: Vec<Scores> = if offsets.len() * self.positions.len() < PARALLEL {
                let mut scratch = Scratch::default();
                offsets.chunks(LANES).map(|block| kernel::score(&setup, block, &mut scratch)).collect()
            } else {
                offsets
                    .par_chunks(LANES * 8)
                    .map_init(Scratch::default, |scratch, chunk| {
                        chunk.chunks(LANES).map(|block| kernel::score(&setup, block, scratch)).collect::<Vec<_>>()
                    })
                    .flatten_iter()
                    .collect()
            };
            self.combine(channel, &blocks, &mut log_p, &mut blur2);
        }
        let best = log_p.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if best.is_finite() {
            let total = log_p.iter().map(|lp| (lp - best).exp()).sum::<f64>().ln() + best;
            for lp in &mut log_p {
                *lp -= total;
            }
        }
        let lattice2 = (0..2).map(|d| (step[d] * self.scale_m[d]).powi(2)).sum::<f64>() / 24.0;
        let blur_m = blur2.iter().map(|b| (b + lattice2).sqrt()).collect();
        Posterior { offsets, log_p, blur_m, step, stages: 1 }
    }

    /// Adds one channel's log posterior density: error levels weighed by their evidence, each tempered by the
    /// correlation of the errors that it stands for.
    fn combine(&self, channel: &Prepared, blocks: &[Scores], log_p: &mut [f64], blur2: &mut [f64]) {
        let noise = &channel.noise;
        let lanes = |i: usize| (i / LANES, i % LANES);
        let valid = |i: usize| blocks[lanes(i).0].log_likelihood[0][lanes(i).1].is_finite();
        let (mut distance, mut map_variance, mut count) = (0.0, 0.0, 0.0);
        for i in (0..log_p.len()).filter(|&i| valid(i)) {
            let (b, l) = lanes(i);
            distance += blocks[b].distance[l];
            map_variance += blocks[b].map_variance[l];
            count += 1.0;
        }
        if count == 0.0 {
            log_p.fill(f64::NEG_INFINITY);
            return;
        }
        distance /= count;
        map_variance /= count;
        // Effective share of independent samples in errors that decorrelate over a length l: those of an AR(1) series
        // with coefficient exp(-spacing / l) count as (1 - rho) / (1 + rho) = tanh(spacing / 2 l).
        let length = |level: &Level| {
            noise.correlation * distance * if noise.levels_are_distances { level.factor.min(1.0) } else { 1.0 }
        };
        let independent = |level: &Level| {
            let length = length(level);
            if length > 0.0 { (0.5 * self.spacing_m / length).tanh().max(1e-3) } else { 1.0 }
        };
        let share = |level: &Level| {
            let v = level.factor * level.factor * map_variance;
            v / (v + noise.sensor_variance)
        };
        let temper: Vec<f64> = noise
            .levels
            .iter()
            .map(|level| {
                let f = share(level);
                1.0 / ((1.0 - f) + f / independent(level))
            })
            .collect();
        let log_sum = |level: usize, temper: f64| {
            let mut best = f64::NEG_INFINITY;
            for b in blocks {
                best = b.log_likelihood[level].iter().copied().fold(best, f64::max);
            }
            let mut sum = 0.0;
            for i in 0..log_p.len() {
                let (b, l) = lanes(i);
                sum += (temper * (blocks[b].log_likelihood[level][l] - best)).exp();
            }
            temper * best + sum.ln()
        };
        // Evidence of each level against its neighbour, both at the smaller of their tempers, so that a hypothesis is
        // not favoured for the logarithm of its units.
        let mut weights = vec![noise.levels[0].log_prior; noise.levels.len()];
        for v in 1..noise.levels.len() {
            let common = temper[v].min(temper[v - 1]);
            weights[v] = weights[v - 1] + noise.levels[v].log_prior - noise.levels[v - 1].log_prior
                + log_sum(v, common)
                - log_sum(v - 1, common);
        }
        let top = weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for weight in &mut weights {
            *weight -= top;
        }
        let normalise: Vec<f64> = (0..noise.levels.len()).map(|v| log_sum(v, temper[v])).collect();
        for i in 0..log_p.len() {
            let (b, l) = lanes(i);
            if !valid(i) {
                log_p[i] = f64::NEG_INFINITY;
                continue;
            }
            let (mut total, mut blurred) = (0.0, 0.0);
            let rho = noise.registration * blocks[b].distance[l];
            for v in 0..noise.levels.len() {
                let p = (weights[v] + temper[v] * blocks[b].log_likelihood[v][l] - normalise[v]).exp();
                total += p;
                let level = &noise.levels[v];
                let displaced = if noise.levels_are_distances { level.factor.min(1.0) * rho } else { rho };
                blurred += p * share(level) * displaced * displaced;
            }
            log_p[i] += total.ln();
            if total > 0.0 {
                blur2[i] += blurred / total;
            }
        }
    }

    /// A close look at one offset: see [`kernel::detail`]. The level is the one that explains the residuals best.
    pub fn detail(&self, offset: [f64; 2], step: [f64; 2]) -> (kernel::Detail, f64) {
        let channel = &self.channels[0];
        let mut scratch = Scratch::default();
        let levels = &channel.noise.levels;
        let setup = self.setup(channel, levels, step, true);
        // The middle of a spread of levels, or the worst that an unknown map may be.
        let level = levels[if channel.noise.levels_are_distances { levels.len() - 1 } else { levels.len() / 2 }];
        let detail = kernel::detail(&setup, offset, level, &mut scratch);
        (detail, level.nu)
    }

    /// What is to be expected at the track's own positions: offset zero, no noise in the values.
    pub fn expected(&self) -> Expected {
        let channel = &self.channels[0];
        let noise = &channel.noise;
        let levels = &noise.levels;
        // The level expected of this map: the middle one, or the most probable of an unknown map.
        let level = levels.iter().copied().fold(levels[0], |a, b| if b.log_prior > a.log_prior { b } else { a });
        let setup = self.setup(channel, levels, [0.0, 0.0], true);
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

    /// Offsets worth keeping after a first stage.
    pub fn kept(&self) -> Vec<[f64; 2]> {
        self.survivors(2.0 * PRUNE)
    }

    /// Offsets within `depth` of the best, the best [`SURVIVORS`] where there are more.
    pub fn survivors(&self, depth: f64) -> Vec<[f64; 2]> {
        let Some(best) = self.mode() else { return Vec::new() };
        let mut floor = self.log_p[best] - depth;
        let mut kept: Vec<usize> = (0..self.offsets.len()).filter(|&i| self.log_p[i] >= floor).collect();
        if kept.len() > SURVIVORS {
            let mut values: Vec<f64> = kept.iter().map(|&i| self.log_p[i]).collect();
            values.sort_by(|a, b| b.total_cmp(a));
            floor = values[SURVIVORS - 1];
            kept.retain(|&i| self.log_p[i] >= floor);
        }
        kept.into_iter().map(|i| self.offsets[i]).collect()
    }
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
