//! A track, its maps and what is known of their errors, made ready for the kernel.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::goodness;
use super::kernel::{self, LANES, Scores, Scratch, Setup};
use super::model::{Channel, Interpolant, LEVELS, Level, Noise, PosteriorOptions, bias_prior};
use super::nuisance::{HEIGHT_NARROWED, HEIGHTS, Node, Nuisance, legs, reach_m};
use super::patch::{Patch, Place};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::map_error::Forecast;
use crate::monitor::Monitor;
use crate::stack::Storey;
use crate::track::Track;

/// What is to be expected of a track: see [`Problem::expected`].
pub(super) struct Expected {
    pub bound: [[f64; 2]; 2],
    pub covariance: [[f64; 2]; 2],
    /// Correlation of the map's error from one sample to the next.
    pub coefficient: f64,
    pub map_sigma: Vec<f64>,
    pub sensor_sigma: f64,
    /// Standard deviation of the logarithm of a track's error level.
    pub spread: f64,
}

/// What one offset looks like from near: see [`Problem::detail`].
pub(super) struct Closer {
    /// Measured minus map, value units.
    pub bias: f64,
    pub heading_deg: f64,
    pub scale: f64,
    /// p-value of the residuals: see [`Problem::goodness`].
    pub goodness: f64,
}

/// Whether somebody wants the search to stop: asked between blocks of candidates, by whichever thread has one.
#[derive(Default)]
pub(super) struct Interruption<'a> {
    monitor: Option<&'a dyn Monitor>,
    stopped: AtomicBool,
}

impl<'a> Interruption<'a> {
    pub fn by(monitor: &'a dyn Monitor) -> Self {
        Self { monitor: Some(monitor), stopped: AtomicBool::new(false) }
    }

    /// Whether to stop, here and from now on.
    fn now(&self) -> bool {
        let Some(monitor) = self.monitor else { return false };
        if self.stopped.load(Ordering::Relaxed) {
            return true;
        }
        let stop = monitor.advance(0, 0).is_err();
        if stop {
            self.stopped.store(true, Ordering::Relaxed);
        }
        stop
    }

    /// # Errors
    /// [`Error::Interrupted`] where the search was stopped: what it found is worth nothing.
    pub fn none(&self) -> Result<()> {
        if self.stopped.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// A problem made ready: everything that does not depend on the candidate.
pub(super) struct Problem<'a> {
    pub options: &'a PosteriorOptions,
    pub field: &'a dyn Field,
    /// The maps of all channels.
    pub fields: Vec<&'a dyn Field>,
    pub channels: Vec<Prepared>,
    pub samples: usize,
    pub nuisance: Nuisance,
    /// Which straight leg every sample belongs to, and its age from 1 (first) to 0 (newest).
    pub legs: Vec<usize>,
    pub age: Vec<f64>,
    /// Displacement of every sample from the newest, metres `[east, north]`.
    pub away_m: Vec<[f64; 2]>,
    /// Metres per map unit.
    pub scale_m: [f64; 2],
    pub cell: [f64; 2],
    pub tolerance_m: f64,
    pub spacing_m: f64,
    pub interruption: Interruption<'a>,
}

/// One channel, made ready.
pub(super) struct Prepared {
    pub patch: Arc<Patch>,
    /// The same at the heights of the nuisance's nodes, where the height is uncertain.
    lifted: Vec<Arc<Patch>>,
    /// Indicated positions at every node of the nuisance parameters, in cells of the patch: `places[node][sample]`.
    places: Vec<Vec<Place>>,
    /// Indicated positions, cells of the patch.
    indicated: Vec<[f64; 2]>,
    /// Where their heights lie among the levels of the map.
    storeys: Vec<Storey>,
    /// Measured values minus the patch's level, value units.
    pub values: Vec<f32>,
    pub noise: Noise,
    cell_m: [f64; 2],
    /// Unit of the kernel's residuals, value units.
    pub unit: f64,
}

/// What of one channel is looked at: error levels and nodes of the nuisance parameters.
#[derive(Debug, Clone)]
pub(super) struct Scope {
    pub levels: Range<usize>,
    /// Whether the bound under the one level stands for all.
    pub cover: bool,
    pub nodes: Vec<usize>,
}

/// Scores of all candidates by one channel.
pub(super) struct Scored {
    /// A block of [`LANES`] candidates each.
    pub blocks: Vec<Scores>,
    /// The largest log-likelihood of any candidate at every node in the scope, its share of the prior counted.
    pub best_of_node: Vec<[f64; LEVELS]>,
}

/// The scores by every channel.
pub(super) type Likelihoods = Vec<Scored>;

/// Curvature times half the square of a displacement, in standard deviations of a sample, up to which it is linear.
const LINEAR: f64 = 0.2;
/// Bounds of the displacement that is taken as linear, cells of the map.
const LINEAR_CELLS: [f64; 2] = [0.2, 10.0];
/// What a field may do between the nodes of an exact map, in units of its second difference there: half as much again as the bicubic
/// surface, which differs from the bilinear one by up to an eighth along either axis.
const COVER: f32 = 0.375;
/// Mean square over a cell of what a curve leaves a straight line by, in squares of the second difference: 1/120, more along two axes.
const BETWEEN_SHARE: f64 = 1.0 / 90.0;
/// Sum over a track of those squares, in variances of the sensor, up to which no reading tells one surface from another.
const ALIKE: f64 = 2.0;
/// Samples times candidates times levels below which one thread is faster than several.
const PARALLEL: usize = 16_000;

/// Whether no reading along these positions tells one surface through the nodes of a map from another.
fn alike(patch: &Patch, positions: &[[f64; 2]], noise: &Noise) -> bool {
    let square = |p: &[f64; 2]| {
        let [u, v] = patch.position(p[0], p[1]);
        f64::from(patch.at(u, v, Storey::GROUND).bend).powi(2)
    };
    let bent: f64 = positions.iter().map(square).sum();
    BETWEEN_SHARE * bent < ALIKE * noise.sensor_variance
}

/// The box around these places with that much room on every side: its low and its high corner.
fn around(places: &[[f64; 2]], room: [f64; 2]) -> ([f64; 2], [f64; 2]) {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in places {
        for d in 0..2 {
            low[d] = low[d].min(p[d] - room[d]);
            high[d] = high[d].max(p[d] + room[d]);
        }
    }
    (low, high)
}

impl<'a> Problem<'a> {
    /// Checks the input and lays out the maps.
    pub fn new(channels: &[Channel<'a>], track: &Track, options: &'a PosteriorOptions) -> Result<Self> {
        Self::on(channels, track, options, None)
    }

    /// The same, on a window of the first map that was laid out before and covers all candidates.
    #[allow(clippy::too_many_lines)] // every input is checked and laid out once, in the order that later ones need
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
        track.require_on(field.geographic())?;
        let n = track.len();
        let positions: Vec<[f64; 2]> = (0..n).map(|k| [field.wrap_x(track.x()[k]), track.y()[k]]).collect();
        let middle = positions.iter().map(|p| p[1]).sum::<f64>() / n as f64;
        let scale_m = field.metres_per_unit(middle);
        let cell = field.spacing();
        let newest = positions[n - 1];
        let away: Vec<[f64; 2]> = positions.iter().map(|p| field.displacement_m(newest, *p)).collect();
        let spacing_m = positions
            .windows(2)
            .map(|w| {
                let [e, north] = field.displacement_m(w[0], w[1]);
                e.hypot(north)
            })
            .sum::<f64>()
            / (n.max(2) - 1) as f64;
        let age: Vec<f64> = match track.time_s() {
            Some(t) if t[n - 1] > t[0] => t.iter().map(|t_k| (t[n - 1] - t_k) / (t[n - 1] - t[0])).collect(),
            _ => (0..n).map(|k| (n - 1 - k) as f64 / (n.max(2) - 1) as f64).collect(),
        };
        let mut nuisance = Nuisance::new(options, &away, &age);
        let lever_m = away.iter().map(|[e, n]| e.hypot(*n)).fold(0.0, f64::max);
        let reach_m = reach_m(options, lever_m);
        let reach = [0, 1].map(|d| options.half_width[d] + reach_m / scale_m[d]);
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
            // Every map may be on a turn of longitude of its own.
            let positions: Vec<[f64; 2]> = (0..n).map(|k| [channel.field.wrap_x(track.x()[k]), track.y()[k]]).collect();
            let mut noise = Noise::new(channel, options)?;
            let patch = match laid_out {
                Some(patch) if index == 0 => {
                    if noise.covered && alike(patch, &positions, &noise) {
                        noise.with_one_surface();
                    }
                    Arc::clone(patch)
                }
                _ => {
                    let (low, high) = around(&positions, reach);
                    let mut patch = Patch::new(channel.field, low, high, options.max_candidates, false)?;
                    if noise.covered && alike(&patch, &positions, &noise) {
                        noise.with_one_surface();
                    }
                    if noise.levels.iter().any(|l| l.surface != Interpolant::Bilinear) {
                        patch.add_curves();
                    }
                    Arc::new(patch)
                }
            };
            let values: Vec<f32> = channel.values.iter().map(|v| (v - patch.level) as f32).collect();
            let cell_m = [patch.step()[0] * scale_m[0], patch.step()[1] * scale_m[1]];
            let indicated: Vec<[f64; 2]> = positions.iter().map(|p| patch.position(p[0], p[1])).collect();
            let storeys = match (channel.field.as_stack(), track.height_m()) {
                (Some(stack), Some(heights)) => stack.storeys(heights)?,
                _ => vec![Storey::GROUND; n],
            };
            if let Some(correlation) = channel.field.as_stack().and_then(|stack| stack.correlation(&storeys)) {
                noise.correlation = correlation;
            }
            // The kernel's unit is the typical error, so that single precision has room on both sides of it.
            let there = indicated.iter().zip(&storeys);
            let variances = there.map(|(p, storey)| f64::from(patch.at(p[0], p[1], *storey).variance));
            let map_variance = variances.filter(|v| v.is_finite()).sum::<f64>() / n as f64;
            let largest = values.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            let unit = (noise.sensor_variance + map_variance).sqrt().max(1e-7 * f64::from(largest)).max(1e-30);
            let places = indicated.iter().zip(&storeys).map(|(p, storey)| Place::new(*p).in_storey(*storey)).collect();
            let places = vec![places];
            prepared.push(Prepared {
                patch,
                lifted: Vec::new(),
                places,
                indicated,
                storeys,
                values,
                noise,
                cell_m,
                unit,
            });
        }
        if options.height_sigma_m > 0.0 {
            for (channel, of) in prepared.iter_mut().zip(channels) {
                let Some(grid) = of.field.as_grid() else {
                    let needed = "0 for a field that is no grid: only grids are continued";
                    return Err(Error::invalid("height_sigma_m", needed, options.height_sigma_m));
                };
                let sigma = options.height_sigma_m;
                let at = |z: &f64| Arc::new(channel.patch.lifted(grid, z * sigma, HEIGHT_NARROWED * sigma));
                channel.lifted = HEIGHTS.iter().map(at).collect();
            }
        }
        if !nuisance.shapes.is_empty() || options.height_sigma_m > 0.0 {
            let linear_m = prepared.iter().map(Prepared::linear_m).fold(f64::INFINITY, f64::min);
            nuisance = nuisance.divided(linear_m, &away, &age);
            if options.height_sigma_m > 0.0 {
                nuisance = nuisance.at_heights();
            }
            for channel in &mut prepared {
                channel.move_to(&nuisance);
            }
        }
        let tolerance_m = options.tolerance_m.unwrap_or_else(|| (cell[0] * scale_m[0]).max(cell[1] * scale_m[1]));
        Ok(Self {
            options,
            field,
            fields: channels.iter().map(|c| c.field).collect(),
            channels: prepared,
            samples: n,
            nuisance,
            legs: legs(&away),
            age,
            away_m: away,
            scale_m,
            cell,
            tolerance_m,
            spacing_m,
            interruption: Interruption::default(),
        })
    }

    pub fn setup<'b>(&'b self, channel: &'b Prepared, node: usize, step: [f64; 2]) -> Setup<'b> {
        let jitter = self.options.position_sigma_m.powi(2);
        // The lattice step is the width of a uniform law.
        let blur = |d: usize| ((step[d] * self.scale_m[d]).powi(2) / 12.0 + jitter) as f32;
        Setup {
            patch: channel.patch_at(&self.nuisance.nodes[node]),
            places: &channel.places[node],
            values: &channel.values,
            per_unit: (1.0 / channel.unit) as f32,
            cell_m: channel.cell_m.map(|m| m as f32),
            half_cells: channel.cells(step).map(|s| (0.5 * s) as f32),
            blur_m2: [blur(0), blur(1)],
            sensor_variance: channel.sensor_variance() as f32,
            lifts: !channel.lifted.is_empty(),
            cover: 0.0,
            levels: &channel.noise.levels,
            bias_sigma: bias_prior(self.options.bias_sigma, channel.unit),
            shapes: &self.nuisance.shapes,
            narrowed: &self.nuisance.narrowed,
            min_overlap: self.options.min_overlap,
        }
    }

    /// Everything there is to look at.
    pub fn whole(&self) -> Vec<Scope> {
        let nodes: Vec<usize> = (0..self.nuisance.nodes.len()).collect();
        self.channels
            .iter()
            .map(|c| Scope { levels: 0..c.noise.levels.len(), cover: false, nodes: nodes.clone() })
            .collect()
    }

    /// The surface through the nodes that was named, where there are several: between the places of a coarse lattice they are alike.
    pub fn named(&self) -> Vec<Scope> {
        let mut scopes = self.whole();
        for (scope, channel) in scopes.iter_mut().zip(&self.channels) {
            let levels = &channel.noise.levels;
            if channel.noise.covered {
                scope.levels = 0..levels.iter().take_while(|l| l.surface == levels[0].surface).count();
            }
        }
        scopes
    }

    /// The part of a scope over which bounds are taken: the first level alone where it stands for all, which under several surfaces it
    /// does at the `first` stage only.
    pub fn bounded(&self, scopes: &[Scope], first: bool) -> Vec<Scope> {
        let part = |(channel, scope): (&Prepared, &Scope)| {
            let noise = &channel.noise;
            let cover = first && noise.covered;
            let levels = if cover {
                0..1
            } else if noise.alike {
                scope.levels.start..scope.levels.start + 1
            } else {
                scope.levels.clone()
            };
            Scope { levels, cover, nodes: scope.nodes.clone() }
        };
        self.channels.iter().zip(scopes).map(part).collect()
    }

    /// Log-likelihoods of these offsets in the scope of every channel: densities, or bounds over cells of this step.
    pub fn likelihoods<const BOUND: bool>(
        &self,
        offsets: &[[f64; 2]],
        step: [f64; 2],
        scopes: &[Scope],
    ) -> Likelihoods {
        let score = |(channel, scope): (&Prepared, &Scope)| {
            let cells: Vec<[f64; 2]> = offsets.iter().map(|o| channel.cells(*o)).collect();
            let one = |scratch: &mut Scratch, block: &[[f64; 2]]| {
                if self.interruption.now() {
                    return (Scores::nothing(), Vec::new());
                }
                self.score_block::<BOUND>(channel, scope, step, block, scratch)
            };
            let work = offsets.len() * self.samples * scope.levels.len() * scope.nodes.len();
            let (blocks, nodes): (Vec<Scores>, Vec<Vec<[f64; LEVELS]>>) = if work < PARALLEL {
                let mut scratch = Scratch::default();
                cells.chunks(LANES).map(|block| one(&mut scratch, block)).unzip()
            } else {
                let width = 8_usize.div_ceil(scope.nodes.len());
                cells.par_chunks(LANES).with_min_len(width).map_init(Scratch::default, one).unzip()
            };
            let mut best_of_node = vec![[f64::NEG_INFINITY; LEVELS]; scope.nodes.len()];
            for block in &nodes {
                for (best, of_block) in best_of_node.iter_mut().zip(block) {
                    for (best, log) in best.iter_mut().zip(of_block) {
                        *best = best.max(*log);
                    }
                }
            }
            Scored { blocks, best_of_node }
        };
        self.channels.iter().zip(scopes).map(score).collect()
    }

    /// One block, its nodes added up; and the best of each node.
    fn score_block<const BOUND: bool>(
        &self,
        channel: &Prepared,
        scope: &Scope,
        step: [f64; 2],
        cells: &[[f64; 2]],
        scratch: &mut Scratch,
    ) -> (Scores, Vec<[f64; LEVELS]>) {
        let mut sum: Option<Scores> = None;
        let mut best = Vec::new();
        for &node in &scope.nodes {
            let mut setup = self.setup(channel, node, step);
            if BOUND {
                setup.blur_m2 = [self.options.position_sigma_m.powi(2) as f32; 2];
                if scope.cover {
                    // The first level is about the surface that was named; the bends in its reach stand for the others.
                    setup.cover = COVER;
                }
            }
            let mut scores = kernel::score::<BOUND>(&setup, cells, scope.levels.clone(), scratch);
            if self.nuisance.nodes.len() > 1 {
                scores.weigh(self.nuisance.nodes[node].log_weight);
                best.push(scores.best());
            }
            match &mut sum {
                None => sum = Some(scores),
                Some(sum) => sum.add(&scores),
            }
        }
        (sum.unwrap_or_else(Scores::nothing), best)
    }

    /// The node at which this offset is the most likely, given an error level.
    pub fn best_node(&self, channel: &Prepared, offset: [f64; 2], level: usize, step: [f64; 2]) -> usize {
        let nodes = self.nuisance.nodes.len();
        if nodes == 1 {
            return 0;
        }
        let scope = Scope { levels: level..level + 1, cover: false, nodes: (0..nodes).collect() };
        let (_, best) =
            self.score_block::<false>(channel, &scope, step, &[channel.cells(offset)], &mut Scratch::default());
        (1..nodes).fold(0, |a, b| if best[b][level] > best[a][level] { b } else { a })
    }

    /// Information on the offset at one place under every level, nuisance parameters out: see [`kernel::detail`].
    pub fn information(&self, channel: &Prepared, offset: [f64; 2], step: [f64; 2]) -> Vec<[f64; 3]> {
        let mut scratch = Scratch::default();
        (channel.noise.levels.iter().enumerate())
            .map(|(v, level)| {
                let setup = self.setup(channel, self.best_node(channel, offset, v, step), step);
                kernel::detail(&setup, channel.cells(offset), *level, &mut scratch).information
            })
            .collect()
    }

    /// A close look at one offset: the parameters by the first channel, the residuals of all.
    pub fn detail(&self, offset: [f64; 2], step: [f64; 2]) -> Closer {
        let channel = &self.channels[0];
        let levels = &channel.noise.levels;
        // That of a spread of levels which is typical, or the worst that an unknown map may be.
        let index = if channel.noise.levels_are_distances { levels.len() - 1 } else { channel.noise.typical };
        let node = self.best_node(channel, offset, index, step);
        let setup = self.setup(channel, node, step);
        let detail = kernel::detail(&setup, channel.cells(offset), levels[index], &mut Scratch::default());
        let (heading_deg, scale) = self.nuisance.heading_and_scale(&self.nuisance.nodes[node], &detail.theta);
        // Of several channels the worst, times their number: the chance that any of them is as bad (Bonferroni).
        let worst = self.channels.iter().map(|c| self.goodness(c, offset, step)).fold(1.0, f64::min);
        let goodness = (worst * self.channels.len() as f64).min(1.0);
        Closer { bias: detail.bias * channel.unit, heading_deg, scale, goodness }
    }

    /// p-value of one channel's residuals at an offset, over what the error level of a track may be (Box, J. Roy. Stat. Soc. A 143
    /// (1980) 383: the prior predictive check).
    fn goodness(&self, channel: &Prepared, offset: [f64; 2], step: [f64; 2]) -> f64 {
        let (map_sigma, distance) = self.along(channel);
        let variances = [channel.mean_variance(&map_sigma), channel.between(self.samples)];
        let setup = self.setup(channel, self.best_node(channel, offset, channel.noise.typical, step), step);
        let mut scratch = Scratch::default();
        let tail = |level: Level| {
            let detail = kernel::detail(&setup, channel.cells(offset), level, &mut scratch);
            let (_, temper) = channel.temper(&level, distance, variances, self.spacing_m);
            level.log_prior.exp() * goodness::p_value(&detail, level.nu, temper)
        };
        channel.noise.checked().into_iter().map(tail).sum()
    }

    /// What is to be expected at the track's own positions: offset zero, no noise in the values.
    pub fn expected(&self) -> Expected {
        let channel = &self.channels[0];
        let noise = &channel.noise;
        let levels = &noise.levels;
        // The level expected of this map: the middle one, or the most probable of an unknown map.
        let level = levels.iter().copied().fold(levels[0], |a, b| if b.log_prior > a.log_prior { b } else { a });
        // The first node is the likeliest: nothing moved.
        let setup = self.setup(channel, 0, [0.0, 0.0]);
        let mut scratch = Scratch::default();
        let detail = kernel::detail(&setup, [0.0, 0.0], level, &mut scratch);
        // Of the stated errors: what the map cannot say between its nodes is no part of the bound.
        let exact_between = Level { between: 0.0, ..level };
        let stated = kernel::detail(&setup, [0.0, 0.0], exact_between, &mut scratch);
        let (map_sigma, distance) = self.along(channel);
        let variances = [channel.mean_variance(&map_sigma), channel.between(self.samples)];
        let (share, temper) = channel.temper(&level, distance, variances, self.spacing_m);
        let length = channel.correlation_m(&level, distance);
        let coefficient = if length > 0.0 && share > 0.0 { (-self.spacing_m / length).exp() } else { 0.0 };
        let half = self.options.half_width;
        let prior = [0, 1].map(|d| 3.0 / (half[d] * self.scale_m[d]).powi(2));
        let invert = |information: [f64; 3], factor: f64| {
            let [ee, en, nn] = information.map(|i| factor * i);
            let (ee, nn) = (ee + prior[0], nn + prior[1]);
            let determinant = ee * nn - en * en;
            [[nn / determinant, -en / determinant], [-en / determinant, ee / determinant]]
        };
        let registration = share * (noise.registration * distance).powi(2);
        let forecast = noise.forecast.unwrap_or(Forecast { level: 1.0, spread: 1.0 });
        // What the Student-t estimate loses against the normal one where errors are normal: with nu = 3 some 10 %, with 10 some 2 %.
        let loss = 1.0 + 1.0 / (level.nu * level.nu);
        let mut covariance = invert(detail.information, temper);
        for (d, row) in covariance.iter_mut().enumerate() {
            for v in row.iter_mut() {
                *v *= loss;
            }
            row[d] += registration;
            for v in row.iter_mut() {
                *v *= forecast.spread * forecast.spread;
            }
        }
        Expected {
            bound: invert(stated.information, 1.0),
            covariance,
            coefficient,
            map_sigma: map_sigma.iter().map(|s| forecast.level * level.factor * s).collect(),
            sensor_sigma: noise.sensor_variance.sqrt(),
            spread: noise.spread,
        }
    }

    /// The risk to declare for a computed one: as the most careful of the channels' maps has it.
    pub fn declared(&self, computed: f64) -> f64 {
        self.channels
            .iter()
            .filter_map(|c| c.noise.recalibration)
            .map(|r| r.risk(computed))
            .reduce(f64::max)
            .unwrap_or(computed)
    }

    /// Map sigma at every indicated position, and the mean distance to the data.
    fn along(&self, channel: &Prepared) -> (Vec<f64>, f64) {
        let (mut sigma, mut distance, mut known) = (Vec::with_capacity(self.samples), 0.0, 0.0);
        for ([px, py], storey) in channel.indicated.iter().zip(&channel.storeys) {
            let sample = channel.patch.at(*px, *py, *storey);
            let here = sample.value.is_finite();
            sigma.push(if here { f64::from(sample.variance).sqrt() } else { 0.0 });
            if here {
                distance += f64::from(sample.distance);
                known += 1.0;
            }
        }
        (sigma, if known > 0.0 { distance / known } else { 0.0 })
    }
}

impl Prepared {
    /// The map at the height of a node.
    pub fn patch_at(&self, node: &Node) -> &Arc<Patch> {
        self.lifted.get(node.height).unwrap_or(&self.patch)
    }

    /// Mean square of standard deviations in value units, kernel units squared.
    fn mean_variance(&self, sigma: &[f64]) -> f64 {
        sigma.iter().map(|s| (s / self.unit).powi(2)).sum::<f64>() / sigma.len().max(1) as f64
    }

    /// Mean square of what the map cannot say between its nodes along the indicated track, kernel units squared.
    fn between(&self, samples: usize) -> f64 {
        let square = |(p, storey): (&[f64; 2], &Storey)| {
            (f64::from(self.patch.at(p[0], p[1], *storey).curvature) / self.unit).powi(2)
        };
        self.indicated.iter().zip(&self.storeys).map(square).filter(|s| s.is_finite()).sum::<f64>()
            / samples.max(1) as f64
    }

    /// Length over which the map's errors decorrelate under a level, for a mean distance to the data, metres.
    fn correlation_m(&self, level: &Level, distance: f64) -> f64 {
        self.noise.correlation * distance * if self.noise.levels_are_distances { level.factor.min(1.0) } else { 1.0 }
    }

    /// Share of the map in the error variance under a level, and the power to which the likelihood is taken, for a mean
    /// distance to the data in metres and mean variances of the map (at factor 1) and between its nodes (kernel units squared).
    ///
    /// Errors that decorrelate over a length l are those of an AR(1) series with coefficient exp(-spacing / l), of whose samples
    /// a share (1 - rho) / (1 + rho) = tanh(spacing / 2 l) is independent. What a map cannot say between its nodes is the same over
    /// about a cell of it.
    pub fn temper(
        &self,
        level: &Level,
        distance: f64,
        [map_variance, between]: [f64; 2],
        spacing_m: f64,
    ) -> (f64, f64) {
        let independent = |length: f64| if length > 0.0 { (0.5 * spacing_m / length).tanh().max(1e-3) } else { 1.0 };
        let map = level.factor * level.factor * map_variance;
        // A learnt sigma holds what lies between the nodes, and its correlation is the learnt one.
        let between = if self.noise.learnt { 0.0 } else { level.between * level.between * between };
        let whole = map + between + self.sensor_variance();
        let cell_m = (self.cell_m[0] * self.cell_m[1]).sqrt();
        let slowed = self.sensor_variance() / whole
            + map / whole / independent(self.correlation_m(level, distance))
            + between / whole / independent(cell_m);
        (map / whole, slowed.recip())
    }

    /// Displacement up to which the map is linear for what this channel can tell, metres.
    fn linear_m(&self) -> f64 {
        let cells = (2.0 * LINEAR * self.unit / self.patch.typical_bend().max(f64::MIN_POSITIVE)).sqrt();
        cells.clamp(LINEAR_CELLS[0], LINEAR_CELLS[1]) * (self.cell_m[0] * self.cell_m[1]).sqrt()
    }

    /// Lays the track out at every node.
    fn move_to(&mut self, nuisance: &Nuisance) {
        let [east, north] = self.cell_m;
        let laid_out = |node: &Node| {
            let place = |(k, p): (usize, &[f64; 2])| {
                let moved = node.moved_m.get(k).unwrap_or(&[0.0; 2]);
                Place::new([p[0] + moved[0] / east, p[1] + moved[1] / north]).in_storey(self.storeys[k])
            };
            self.indicated.iter().enumerate().map(place).collect()
        };
        self.places = nuisance.nodes.iter().map(laid_out).collect();
    }

    /// Map units to cells of this channel's map.
    pub fn cells(&self, offset: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.patch.step();
        [offset[0] / x, offset[1] / y]
    }

    /// In units of the kernel.
    pub fn sensor_variance(&self) -> f64 {
        (self.noise.sensor_variance / (self.unit * self.unit)).max(1e-12)
    }
}
