//! Length and quantum of the matching sequence for a planned track: exhaustive search, and the binary particle swarm of
//! [DM-ICCP].

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::bounds::{require_distance_m, require_quantum, require_spread, require_values};
use crate::error::{Error, Result, require_count, require_positive};
use crate::field::Field;
use crate::grid::GridMap;
use crate::matching::contour::{ContourOptions, match_contour};
use crate::matching::scene::Motion;
use crate::matching::sequence::delta_modulation;
use crate::monitor::Monitor;
use crate::track::Track;

/// Greatest number of settings (lengths by quanta) that can be searched.
pub const MAX_SETTINGS: usize = 1_000_000;
/// Greatest number of draws, and of particles and iterations of a swarm.
pub const MAX_DRAWS: usize = 1_000_000;
/// Greatest number of samples over all draws.
pub const MAX_DRAWN_SAMPLES: usize = 1 << 28;

/// How the INS error at the correction point is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct InsDraw {
    /// Length of the offset at the correction point, metres; its direction is uniform.
    pub offset_m: f64,
    /// Standard deviation of the heading error, degrees.
    pub heading_sigma_deg: f64,
    /// Standard deviation of the scale (speed) error, a ratio.
    pub scale_sigma: f64,
}

/// What the objective is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TuneOptions {
    /// Least sequence length.
    pub min_length: usize,
    /// Greatest sequence length; `None` is the number of samples that the largest quantum gives on the track.
    pub max_length: Option<usize>,
    /// Quanta of the delta modulation that are tried, value units.
    pub quanta: Vec<f64>,
    /// Weights of error and cost in the objective.
    pub weights: [f64; 2],
    /// Errors, metres, that count as 0 and as 1; `None` is one cell and two cells.
    pub error_range_m: Option<[f64; 2]>,
    /// Costs that count as 0 and as 1, in the unit of [`TuneOptions::cost_per_work`]; `None` is nothing, and the longest
    /// sequence at the iteration limit.
    pub cost_range: Option<[f64; 2]>,
    /// Cost of one point in one iteration: 1 counts work, which is the same on every machine; a measured number of
    /// seconds makes it time.
    pub cost_per_work: f64,
    /// Draws of INS error and noise that every setting is averaged over.
    pub draws: usize,
    /// Standard deviation of the sensor's noise, value units.
    pub sigma: f64,
    /// The INS.
    pub ins: InsDraw,
    /// How the sequence is matched.
    pub matching: ContourOptions,
    /// Seed of the draws (and of the swarm).
    pub seed: u64,
}

impl Default for TuneOptions {
    /// The setting of the rough region in [DM-ICCP], error and cost weighed equally.
    fn default() -> Self {
        Self {
            min_length: 3,
            max_length: None,
            quanta: (1..=15).map(f64::from).collect(),
            weights: [0.5, 0.5],
            error_range_m: None,
            cost_range: None,
            cost_per_work: 1.0,
            draws: 30,
            sigma: 0.0,
            ins: InsDraw { offset_m: 790.0, heading_sigma_deg: 0.0, scale_sigma: 0.0 },
            matching: ContourOptions::default(),
            seed: 0,
        }
    }
}

/// One choice of length and quantum, and what it gives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// Sequence length.
    pub length: usize,
    /// Quantum, value units.
    pub quantum: f64,
    /// Mean of the objective over the draws: 0 is best, the sum of the weights worst.
    pub objective: f64,
    /// Mean error over the draws that gave a position, metres; NaN where none did.
    pub error_m: f64,
    /// Mean cost over the draws that gave a position; NaN where none did.
    pub cost: f64,
    /// Share of the draws without a position: too few samples, or no contour in reach. They count as the worst.
    pub failures: f64,
}

/// The result of tuning.
#[derive(Debug, Clone, PartialEq)]
pub struct Tuned {
    /// The setting of least objective.
    pub best: Setting,
    /// Every setting that was evaluated, by length, then quantum.
    pub settings: Vec<Setting>,
    /// Greatest length that was allowed.
    pub max_length: usize,
    /// Iterations of the swarm; 1 for the exhaustive search.
    pub iterations: usize,
}

/// How the settings are searched.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub enum TuneMethod {
    /// Every one of them, in parallel.
    #[default]
    Exhaustive,
    /// Binary particle swarm.
    Bpso(BpsoOptions),
}

/// Settings of the binary particle swarm (Kennedy and Eberhart 1997).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BpsoOptions {
    /// Number of particles.
    pub particles: usize,
    /// Greatest number of iterations.
    pub iterations: usize,
    /// Iterations without a better setting after which it stops.
    pub patience: usize,
    /// Inertia at the start and at the end.
    pub inertia: [f64; 2],
    /// Pulls towards a particle's own best and towards the swarm's.
    pub pulls: [f64; 2],
    /// Bound of the velocities: sigmoid(-bound) is the least probability that a bit is tried the other way.
    pub max_velocity: f64,
}

impl Default for BpsoOptions {
    fn default() -> Self {
        Self { particles: 30, iterations: 100, patience: 60, inertia: [0.9, 0.4], pulls: [2.0, 2.0], max_velocity: 2.0 }
    }
}

/// Tunes length and quantum for a planned track whose last point is the correction point.
///
/// `planned` holds true positions with the field along them (from the map, or a better field); a sequence is made by
/// delta modulation of the noisy values and taken backwards from the correction point. Every setting sees the same
/// draws.
///
/// # Errors
/// Options that are not usable ([`Error::Invalid`]), fewer samples than `min_length` even for the smallest quantum
/// ([`Error::TooFewSamples`]), [`Error::Interrupted`].
pub fn tune_sequence(
    map: &GridMap,
    planned: &Track,
    options: &TuneOptions,
    method: &TuneMethod,
    monitor: &dyn Monitor,
) -> Result<Tuned> {
    let bench = Bench::new(map, planned, options, monitor)?;
    match method {
        TuneMethod::Exhaustive => bench.exhaustive(monitor),
        TuneMethod::Bpso(swarm) => bench.bpso(swarm, monitor),
    }
}

/// One draw: what the INS indicates and what the sensor reads, and which samples each quantum chooses of it.
struct Draw {
    indicated: Vec<[f64; 2]>,
    values: Vec<f64>,
    chosen: Vec<Vec<usize>>,
}

struct Bench<'a> {
    map: &'a GridMap,
    planned: &'a Track,
    options: &'a TuneOptions,
    draws: Vec<Draw>,
    max_length: usize,
    error_range_m: [f64; 2],
    cost_range: [f64; 2],
}

impl<'a> Bench<'a> {
    fn new(map: &'a GridMap, planned: &'a Track, options: &'a TuneOptions, monitor: &dyn Monitor) -> Result<Self> {
        options.matching.check()?;
        check(options)?;
        let [east, north] = map.metres_per_unit(planned.newest()[1]);
        let cell_m = (map.x().step() * east).max(map.y().step() * north);
        let mut max_length = 0;
        let mut longest = 0;
        for &quantum in &options.quanta {
            let n = delta_modulation(planned.values(), quantum)?.keep.len();
            longest = longest.max(n);
            // The last, largest quantum stands.
            max_length = n;
        }
        let least = options.min_length.max(options.matching.transform.min_points());
        if longest < least {
            return Err(Error::TooFewSamples {
                what: "delta modulation of the planned track, at every quantum".into(),
                needed: least,
                got: longest,
            });
        }
        let max_length = options.max_length.unwrap_or(max_length).max(least);
        let settings = (max_length - least + 1).saturating_mul(options.quanta.len());
        if settings > MAX_SETTINGS {
            let needed = format!("at most {MAX_SETTINGS} settings (lengths by quanta)");
            return Err(Error::invalid("max_length and quanta", needed, settings));
        }
        let samples = options.draws.saturating_mul(planned.len()).saturating_mul(1 + options.quanta.len());
        if samples > MAX_DRAWN_SAMPLES {
            let needed = format!("at most {MAX_DRAWN_SAMPLES} samples over all draws and quanta");
            return Err(Error::invalid("draws", needed, samples));
        }
        let draws = (0..options.draws).map(|d| {
            // Nothing of the search itself is done yet.
            monitor.advance(0, 1)?;
            draw(map, planned, options, d as u64)
        });
        let draws = draws.collect::<Result<Vec<_>>>()?;
        let most = max_length as f64 * options.matching.max_iterations as f64 * options.cost_per_work;
        Ok(Self {
            map,
            planned,
            options,
            draws,
            max_length,
            error_range_m: options.error_range_m.unwrap_or([cell_m, 2.0 * cell_m]),
            cost_range: options.cost_range.unwrap_or([0.0, most]),
        })
    }

    fn lengths(&self) -> std::ops::RangeInclusive<usize> {
        self.options.min_length.max(self.options.matching.transform.min_points())..=self.max_length
    }

    /// Error and cost of one draw; `None` is a failure.
    fn trial(&self, draw: &Draw, length: usize, quantum: usize) -> Result<Option<(f64, f64)>> {
        let chosen = &draw.chosen[quantum];
        if chosen.len() < length {
            return Ok(None);
        }
        let picks = &chosen[chosen.len() - length..];
        let pick = |get: &dyn Fn(usize) -> f64| picks.iter().map(|&k| get(k)).collect::<Vec<f64>>();
        let track = Track::new(
            pick(&|k| draw.indicated[k][0]),
            pick(&|k| draw.indicated[k][1]),
            pick(&|k| draw.values[k]),
            None,
        )?;
        let sigma = (self.options.sigma > 0.0).then_some(self.options.sigma);
        let fix = match match_contour(self.map, &track, sigma, &self.options.matching) {
            // Neighbours chosen at one place: a sequence that cannot be matched, not a caller's mistake.
            Err(Error::RankDeficient { .. }) => return Ok(None),
            other => other?,
        };
        if fix.x.is_nan() {
            return Ok(None);
        }
        let truth = self.planned.point(picks[length - 1]);
        let [east, north] = self.map.displacement_m(truth, [fix.x, fix.y]);
        let work = (length * fix.iterations) as f64;
        Ok(Some((east.hypot(north), work * self.options.cost_per_work)))
    }

    fn setting(&self, length: usize, quantum: usize, trials: &[Option<(f64, f64)>]) -> Setting {
        let [weight_error, weight_cost] = self.options.weights;
        let unit = |v: f64, [low, high]: [f64; 2]| ((v - low) / (high - low)).clamp(0.0, 1.0);
        let (mut objective, mut error, mut cost, mut found) = (0.0, 0.0, 0.0, 0.0_f64);
        for trial in trials {
            objective += match trial {
                Some((e, c)) => {
                    error += e;
                    cost += c;
                    found += 1.0;
                    weight_error * unit(*e, self.error_range_m) + weight_cost * unit(*c, self.cost_range)
                }
                None => weight_error + weight_cost,
            };
        }
        let n = trials.len() as f64;
        let mean = |sum: f64| if found > 0.0 { sum / found } else { f64::NAN };
        Setting {
            length,
            quantum: self.options.quanta[quantum],
            objective: objective / n,
            error_m: mean(error),
            cost: mean(cost),
            failures: 1.0 - found / n,
        }
    }

    fn exhaustive(&self, monitor: &dyn Monitor) -> Result<Tuned> {
        let all: Vec<(usize, usize)> =
            self.lengths().flat_map(|l| (0..self.options.quanta.len()).map(move |q| (l, q))).collect();
        let total = all.len() as u64;
        let done = std::sync::atomic::AtomicU64::new(0);
        let settings = all
            .par_iter()
            .map(|&(length, quantum)| {
                let trials = self.draws.iter().map(|d| {
                    monitor.advance(done.load(std::sync::atomic::Ordering::Relaxed), total)?;
                    self.trial(d, length, quantum)
                });
                let trials = trials.collect::<Result<Vec<_>>>()?;
                monitor.advance(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, total)?;
                Ok(self.setting(length, quantum, &trials))
            })
            .collect::<Result<Vec<Setting>>>()?;
        self.tuned(settings, 1)
    }

    fn bpso(&self, swarm: &BpsoOptions, monitor: &dyn Monitor) -> Result<Tuned> {
        let mut seen: BTreeMap<(usize, usize), Setting> = BTreeMap::new();
        let total = swarm.iterations as u64;
        let space = SettingSpace { lengths: self.lengths(), quanta: self.options.quanta.len() };
        let found = bpso(&space, swarm, self.options.seed, &mut |iteration, length, quantum| {
            if let Some(setting) = seen.get(&(length, quantum)) {
                return Ok(setting.objective);
            }
            let trials = self.draws.par_iter().map(|d| {
                monitor.advance(iteration as u64, total)?;
                self.trial(d, length, quantum)
            });
            let trials = trials.collect::<Result<Vec<_>>>()?;
            let setting = self.setting(length, quantum, &trials);
            seen.insert((length, quantum), setting);
            monitor.advance(iteration as u64, total)?;
            Ok(setting.objective)
        })?;
        self.tuned(seen.into_values().collect(), found.iterations)
    }

    /// Ties go to the shorter sequence, then to the smaller quantum.
    fn tuned(&self, settings: Vec<Setting>, iterations: usize) -> Result<Tuned> {
        let best = settings.iter().copied().min_by(|a, b| a.objective.total_cmp(&b.objective));
        let best = best.ok_or_else(|| Error::invalid("settings", "at least one", 0))?;
        Ok(Tuned { best, settings, max_length: self.max_length, iterations })
    }
}

fn check(options: &TuneOptions) -> Result<()> {
    if options.quanta.is_empty() {
        return Err(Error::invalid("quanta", "at least one", "none"));
    }
    for (i, &q) in options.quanta.iter().enumerate() {
        require_quantum(&format!("quanta[{i}]"), q)?;
    }
    if let Some(i) = options.quanta.windows(2).position(|w| w[1] <= w[0]) {
        return Err(Error::invalid(format!("quanta[{}]", i + 1), "ascending quanta", options.quanta[i + 1]));
    }
    if options.min_length == 0 {
        return Err(Error::invalid("min_length", "at least 1", 0));
    }
    if let Some(max) = options.max_length
        && max < options.min_length
    {
        return Err(Error::invalid("max_length", format!("at least min_length {}", options.min_length), max));
    }
    require_count("draws", options.draws, MAX_DRAWS)?;
    require_spread("weights[0]", options.weights[0])?;
    require_spread("weights[1]", options.weights[1])?;
    if options.weights == [0.0; 2] {
        return Err(Error::invalid("weights", "at least one weight > 0", "zeros only"));
    }
    require_quantum("cost_per_work", options.cost_per_work)?;
    require_spread("sigma", options.sigma)?;
    require_distance_m("ins offset_m", options.ins.offset_m)?;
    require_spread("ins heading_sigma_deg", options.ins.heading_sigma_deg)?;
    require_spread("ins scale_sigma", options.ins.scale_sigma)?;
    for (name, range) in [("error_range_m", options.error_range_m), ("cost_range", options.cost_range)] {
        if let Some([low, high]) = range {
            require_values(name, &[low, high])?;
            if high <= low {
                return Err(Error::invalid(name, "(low, high) with low < high", format!("({low}, {high})")));
            }
        }
    }
    Ok(())
}

fn draw(map: &GridMap, planned: &Track, options: &TuneOptions, number: u64) -> Result<Draw> {
    // One stream a draw: the draws do not depend on how many there are.
    let mut rng = Pcg64::seed_from_u64(options.seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let heading = options.ins.heading_sigma_deg.to_radians() * normal();
    let stretch = options.ins.scale_sigma * normal();
    let values: Vec<f64> = planned.values().iter().map(|v| v + options.sigma * normal()).collect();
    let direction = rng.random::<f64>() * std::f64::consts::TAU;
    let newest = planned.newest();
    // From true to indicated: the inverse of a correction that turns by `heading` and stretches by `stretch`.
    let error = Motion {
        offset_m: [-options.ins.offset_m * direction.sin(), -options.ins.offset_m * direction.cos()],
        heading_rad: -heading,
        stretch: 1.0 / (1.0 + stretch) - 1.0,
    };
    let indicated = (0..planned.len())
        .map(|k| {
            let [x, y] = planned.point(k);
            let [east, north] = error.displacement(map.displacement_m(newest, [x, y]));
            let [unit_east, unit_north] = map.metres_per_unit(y);
            [x + east / unit_east, y + north / unit_north]
        })
        .collect();
    let chosen =
        options.quanta.iter().map(|&q| delta_modulation(&values, q).map(|m| m.keep)).collect::<Result<Vec<_>>>()?;
    Ok(Draw { indicated, values, chosen })
}

/// The settings that a swarm may visit.
#[derive(Debug, Clone, PartialEq)]
pub struct SettingSpace {
    /// Sequence lengths.
    pub lengths: std::ops::RangeInclusive<usize>,
    /// Number of quanta.
    pub quanta: usize,
}

impl SettingSpace {
    /// Bits of the length, coded as itself (3 = 00011, 30 = 11110), and of the quantum, coded by its index.
    fn bits(&self) -> [u32; 2] {
        let width = |greatest: usize| (usize::BITS - greatest.leading_zeros()).max(1);
        [width(*self.lengths.end()), width(self.quanta.saturating_sub(1))]
    }

    /// Length and quantum index of a code, brought into range.
    fn repaired(&self, code: &[bool]) -> (usize, usize) {
        let number = |bits: &[bool]| bits.iter().fold(0, |n, &b| 2 * n + usize::from(b));
        let (length, quantum) = code.split_at(self.bits()[0] as usize);
        (number(length).clamp(*self.lengths.start(), *self.lengths.end()), number(quantum).min(self.quanta - 1))
    }

    fn code(&self, (length, quantum): (usize, usize)) -> Vec<bool> {
        let [a, b] = self.bits();
        let bits = |n: usize, width: u32| (0..width).rev().map(move |i| n >> i & 1 == 1);
        bits(length, a).chain(bits(quantum, b)).collect()
    }
}

/// Where a swarm ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BpsoResult {
    /// Sequence length.
    pub length: usize,
    /// Index of the quantum.
    pub quantum: usize,
    /// The objective there.
    pub objective: f64,
    /// Iterations taken.
    pub iterations: usize,
}

struct Particle {
    code: Vec<bool>,
    velocity: Vec<f64>,
    best: Vec<bool>,
    best_objective: f64,
}

/// Binary particle swarm over lengths and quanta: least `objective(iteration, length, quantum index)`.
///
/// A code outside the range is repaired to the nearest setting inside. The sigmoid of a velocity is the probability
/// that its bit is 1. The same seed gives the same search.
///
/// # Errors
/// [`Error::Invalid`] for a swarm without particles or iterations or an empty space; what `objective` returns.
pub fn bpso(
    space: &SettingSpace,
    options: &BpsoOptions,
    seed: u64,
    objective: &mut dyn FnMut(usize, usize, usize) -> Result<f64>,
) -> Result<BpsoResult> {
    require_count("particles", options.particles, MAX_DRAWS)?;
    require_count("iterations", options.iterations, MAX_DRAWS)?;
    require_positive("max_velocity", options.max_velocity)?;
    if space.quanta == 0 || space.lengths.is_empty() {
        return Err(Error::invalid("setting space", "at least one length and one quantum", "none"));
    }
    let mut rng = Pcg64::seed_from_u64(seed);
    let width = space.bits().iter().sum::<u32>() as usize;
    let mut particles = Vec::with_capacity(options.particles);
    let mut leader = (f64::INFINITY, Vec::new());
    for _ in 0..options.particles {
        let random: Vec<bool> = (0..width).map(|_| rng.random::<bool>()).collect();
        let setting = space.repaired(&random);
        let code = space.code(setting);
        let velocity = (0..width).map(|_| options.max_velocity * (2.0 * rng.random::<f64>() - 1.0)).collect();
        let value = objective(0, setting.0, setting.1)?;
        if leader.1.is_empty() || value < leader.0 {
            leader = (value, code.clone());
        }
        particles.push(Particle { best: code.clone(), best_objective: value, code, velocity });
    }
    let mut unchanged = 0;
    let mut iterations = 0;
    while iterations < options.iterations && unchanged < options.patience.max(1) {
        iterations += 1;
        let along = iterations as f64 / options.iterations as f64;
        let inertia = options.inertia[0] + (options.inertia[1] - options.inertia[0]) * along;
        let before = leader.0;
        for p in &mut particles {
            for i in 0..width {
                let bit = |b: bool| f64::from(u8::from(b));
                let own = options.pulls[0] * rng.random::<f64>() * (bit(p.best[i]) - bit(p.code[i]));
                let common = options.pulls[1] * rng.random::<f64>() * (bit(leader.1[i]) - bit(p.code[i]));
                p.velocity[i] =
                    (inertia * p.velocity[i] + own + common).clamp(-options.max_velocity, options.max_velocity);
                p.code[i] = rng.random::<f64>() < 1.0 / (1.0 + (-p.velocity[i]).exp());
            }
            let setting = space.repaired(&p.code);
            p.code = space.code(setting);
            let value = objective(iterations, setting.0, setting.1)?;
            if value < p.best_objective {
                p.best_objective = value;
                p.best.clone_from(&p.code);
            }
            if value < leader.0 {
                leader = (value, p.code.clone());
            }
        }
        unchanged = if leader.0 < before { 0 } else { unchanged + 1 };
    }
    let (length, quantum) = space.repaired(&leader.1);
    Ok(BpsoResult { length, quantum, objective: leader.0, iterations })
}
