//! The likelihood of candidates: Student-t, bias and nuisance parameters integrated out, for several error levels at once.
//!
//! For a candidate offset with residuals e_k = measured - map and variances s_k^2, the bias b that maximises
//! prod t(e_k - b) is found by reweighting (weights (nu + 1) / (nu s^2 + e^2), started wide so that an outlier cannot
//! capture it) and integrated out by Laplace's method with the expected information (nu + 1) / ((nu + 3) s^2).
//!
//! Beside the density at the candidate itself there is its bound over the candidate's cell: every residual may be
//! smaller by as much as the map changes within the cell, |dm/dx| h_x + |dm/dy| h_y and the bend of the map over it, and its
//! variance as small as anywhere in the cell. What the bound rules out holds no place that the density would have found.
//!
//! Between the nodes the map is a bilinear surface plus what the bicubic one (Keys, IEEE Trans. Acoust. Speech
//! Signal Process. 29 (1981) 1153) differs by: with second differences D at the nodes and q(t) = t (1 - t) / 2, that is
//! -q(u) Dx - q(v) Dy + q(u) q(v) Dxy, each interpolated; the cubic spline through the nodes is the same of its own second
//! derivatives, interpolated at (1 + t) / 3. A standard deviation of the same size is what the map cannot say.
//!
//! Values are in units of the sensor's standard deviation, so that single precision suffices for the samples; sums over
//! samples are in double precision.

mod closely;
mod integral;

use std::ops::Range;

use super::model::{Interpolant, LEVELS, Level};
use super::nuisance::Shape;
use super::patch::{
    ACROSS, BEND, Cells, DISTANCE, LIFT, Patch, Place, SPLINE_ACROSS, SPLINE_TWIST, SPLINE_UP, TWIST, UP, VALUE,
    VARIANCE,
};
pub(super) use closely::{Detail, detail};
use integral::{Tails, nuisances, one_bias, weigh};

/// Candidates handled together, so that the inner loops are vectors.
pub(super) const LANES: usize = 16;
/// Multipliers of the variance in successive reweightings.
const WIDENING: [f32; 4] = [100.0, 9.0, 1.0, 1.0];
/// Most nuisance parameters: bias, heading, scale, drift east and north, legs, walk of the bias, and one more effect that is tested.
pub(super) const MOST: usize = 16;
/// Sizes for which there is room in less.
const FEW: usize = 2;
const SOME: usize = 5;

type Lane = [f32; LANES];
pub(super) type Wide = [f64; LANES];

/// What the kernel needs to know beside the map.
#[derive(Debug, Clone)]
pub(super) struct Setup<'a> {
    pub patch: &'a Patch,
    /// Indicated positions in cells of the patch.
    pub places: &'a [Place],
    /// Measured values minus the patch's level, value units.
    pub values: &'a [f32],
    /// One over the unit of the residuals, value units.
    pub per_unit: f32,
    /// Metres per cell of the map, `[east, north]`.
    pub cell_m: [f32; 2],
    /// Half the lattice step in cells: the reach of a bound.
    pub half_cells: [f32; 2],
    /// The lattice step and the position jitter as one standard deviation per axis, metres squared.
    pub blur_m2: [f32; 2],
    /// In units squared.
    pub sensor_variance: f32,
    /// Whether any of the shapes is the map's change with height.
    pub lifts: bool,
    /// What the map may do between its nodes, in units of its bend, in the reach of a bound that stands for all levels.
    pub cover: f32,
    pub levels: &'a [Level],
    /// None: no bias at all; infinite: unknown without bound. In units.
    pub bias_sigma: Option<f64>,
    /// What every other nuisance parameter does to the samples per standard deviation.
    pub shapes: &'a [Shape],
    /// Those standard deviations over the prior's, where the prior is divided.
    pub narrowed: &'a [f64],
    pub min_overlap: f64,
}

/// Log-likelihoods and mean distance to the data of `LANES` candidates.
#[derive(Debug, Clone)]
pub(super) struct Scores {
    /// `[level][lane]`, minus infinity where too few samples lie on the map.
    pub log_likelihood: [Wide; LEVELS],
    pub distance: Lane,
    /// Mean map variance along the track, units squared.
    pub map_variance: Lane,
    /// Mean square of what the map cannot say between its nodes, units squared.
    pub between: Lane,
}

impl Scores {
    /// Of no candidate at all.
    pub fn nothing() -> Self {
        Self {
            log_likelihood: [[f64::NEG_INFINITY; LANES]; LEVELS],
            distance: [0.0; LANES],
            map_variance: [0.0; LANES],
            between: [0.0; LANES],
        }
    }

    /// Multiplies the likelihoods by a weight.
    pub fn weigh(&mut self, log_weight: f64) {
        for log in self.log_likelihood.iter_mut().flatten() {
            *log += log_weight;
        }
    }

    /// The largest log-likelihood of every level.
    pub fn best(&self) -> [f64; LEVELS] {
        self.log_likelihood.map(|lanes| lanes.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    }

    /// Adds the likelihoods of another hypothesis on the same candidates.
    pub fn add(&mut self, other: &Self) {
        for (mine, its) in self.log_likelihood.iter_mut().flatten().zip(other.log_likelihood.iter().flatten()) {
            let (high, low) = if *mine >= *its { (*mine, *its) } else { (*its, *mine) };
            if low - high > -30.0 {
                *mine = high + (low - high).exp().ln_1p();
            } else {
                *mine = high;
            }
        }
    }
}

/// Rows of one sample for a block of candidates.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct Row {
    /// From the bilinear surface, and what the bicubic one and the spline add to that.
    residual: Lane,
    curve: Lane,
    spline: Lane,
    /// Change with height, per standard deviation of it.
    lift: Lane,
    /// From the surface of the level at hand.
    error: Lane,
    /// Square of what the map cannot say between its nodes: the most of it, and the least within the cell of a bound.
    between: Lane,
    least_between: Lane,
    map_variance: Lane,
    extra_variance: Lane,
    known: Lane,
    precision: Lane,
    distance: Lane,
    /// Per metre.
    gradient: [Lane; 2],
    /// What the residual may change by within the candidate's cell.
    reach: Lane,
}

const EMPTY: Row = Row {
    residual: [0.0; LANES],
    curve: [0.0; LANES],
    spline: [0.0; LANES],
    lift: [0.0; LANES],
    error: [0.0; LANES],
    between: [0.0; LANES],
    least_between: [0.0; LANES],
    map_variance: [0.0; LANES],
    extra_variance: [1.0; LANES],
    known: [0.0; LANES],
    precision: [0.0; LANES],
    distance: [0.0; LANES],
    gradient: [[0.0; LANES]; 2],
    reach: [0.0; LANES],
};

/// Room for one block of candidates, reused from block to block.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    rows: Vec<Row>,
}

/// Scores the candidates `offsets` (at most [`LANES`]; cells of the map) under the given levels: their density, or with
/// `BOUND` a bound over the cell of each. The other levels are minus infinity.
pub(super) fn score<const BOUND: bool>(
    setup: &Setup<'_>,
    offsets: &[[f64; 2]],
    levels: Range<usize>,
    scratch: &mut Scratch,
) -> Scores {
    pulp::Arch::new().dispatch(Block::<'_, '_, BOUND> { setup, offsets, levels, scratch })
}

/// Log-likelihoods of the same candidates (at most [`LANES`]; cells of the map) under one level for several setups that differ in their
/// nuisance parameters only: the map is read once, and the parameters are sought less closely.
pub(super) fn compare(setups: &[Setup<'_>], offsets: &[[f64; 2]], level: usize, scratch: &mut Scratch) -> Vec<Wide> {
    pulp::Arch::new().dispatch(Comparison { setups, offsets, level, scratch })
}

struct Comparison<'a, 'b> {
    setups: &'a [Setup<'b>],
    offsets: &'a [[f64; 2]],
    level: usize,
    scratch: &'a mut Scratch,
}

impl pulp::WithSimd for Comparison<'_, '_> {
    type Output = Vec<Wide>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Vec<Wide> {
        let levels = self.level..self.level + 1;
        if let Some(first) = self.setups.first() {
            fill::<false>(first, self.offsets, &first.levels[levels.clone()], self.scratch);
        }
        let one = |setup: &Setup<'_>| {
            evaluate::<false>(setup, levels.clone(), &WIDENING[1..3], self.scratch).log_likelihood[self.level]
        };
        self.setups.iter().map(one).collect()
    }
}

struct Block<'a, 'b, const BOUND: bool> {
    setup: &'a Setup<'b>,
    offsets: &'a [[f64; 2]],
    levels: Range<usize>,
    scratch: &'a mut Scratch,
}

impl<const BOUND: bool> pulp::WithSimd for Block<'_, '_, BOUND> {
    type Output = Scores;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Scores {
        fill::<BOUND>(self.setup, self.offsets, &self.setup.levels[self.levels.clone()], self.scratch);
        evaluate::<BOUND>(self.setup, self.levels, &WIDENING, self.scratch)
    }
}

/// Samples the map along the track at every candidate.
#[inline(always)]
#[allow(clippy::too_many_lines)] // one pass over samples and lanes
fn fill<const BOUND: bool>(setup: &Setup<'_>, offsets: &[[f64; 2]], levels: &[Level], scratch: &mut Scratch) {
    // Under a bound that stands for all levels the bends in its reach stand for the curves.
    let cubic = setup.cover == 0.0 && levels.iter().any(|l| l.surface != Interpolant::Bilinear);
    let bent = BOUND || levels.iter().any(|l| l.between > 0.0);
    let n = setup.places.len();
    scratch.rows.resize(n, EMPTY);
    let unit = setup.per_unit;
    let [per_east, per_north] = setup.cell_m.map(|m| unit / m);
    let ([blur_x, blur_y], sensor_variance) = (setup.blur_m2, setup.sensor_variance);
    let [half_x, half_y] = setup.half_cells;
    let half = half_x.max(half_y);
    // A surface that bends twice as much as the bilinear one does at its nodes.
    let bends = if cubic { 1.5 } else { 1.0 };
    let cells = Cells::new(offsets);
    for k in 0..n {
        let row = &mut scratch.rows[k];
        let mut spots = setup.patch.locate(setup.places[k], &cells);
        let values = setup.patch.read::<VALUE>(&cells, &mut spots);
        let bend = if bent { setup.patch.read::<BEND>(&cells, &mut spots).mixed(&spots) } else { [0.0; LANES] };
        let value = values.mixed(&spots);
        let [a, b, e, f] = values.0;
        let (u, v) = (spots.u, spots.v);
        let measured = setup.values[k];
        let mut known = [0.0; LANES];
        for l in 0..LANES {
            let residual = (measured - value[l]) * unit;
            let on = residual.is_finite() & (spots.known[l] > 0.0) & (cells.used[l] > 0.0);
            known[l] = if on { 1.0 } else { 0.0 };
            row.residual[l] = if on { residual } else { 0.0 };
        }
        row.known = known;
        let mut extra_variance = [0.0; LANES];
        for l in 0..LANES {
            let (low, high) = (b[l] - a[l], f[l] - e[l]);
            let (left, right) = (e[l] - a[l], f[l] - b[l]);
            let (gx, gy) = (low + v[l] * (high - low), left + u[l] * (right - left));
            let (gx_m, gy_m) = (gx * per_east, gy * per_north);
            let extra = sensor_variance + gx_m * gx_m * blur_x + gy_m * gy_m * blur_y;
            let on = known[l] > 0.0;
            extra_variance[l] = extra;
            let bent = if on { 0.5 * bend[l] * unit } else { 0.0 };
            if BOUND {
                let (least_u, most_u) = off_node_within(u[l], half_x);
                let (least_v, most_v) = off_node_within(v[l], half_y);
                let (least, most) = (bent * least_u.max(least_v), bent * most_u.max(most_v));
                (row.between[l], row.least_between[l]) = (most * most, least * least);
            } else {
                let curved = bent * off_node(u[l]).max(off_node(v[l]));
                row.between[l] = curved * curved;
            }
            row.gradient[0][l] = if on { gx_m } else { 0.0 };
            row.gradient[1][l] = if on { gy_m } else { 0.0 };
            if BOUND {
                let reach = (half_x * gx.abs() + half_y * gy.abs() + (half * bends + setup.cover) * bend[l]) * unit;
                row.reach[l] = if on { reach } else { 0.0 };
            }
        }
        for l in 0..LANES {
            row.extra_variance[l] = if known[l] > 0.0 { extra_variance[l] } else { 1.0 };
        }
        if cubic {
            let across = setup.patch.read::<ACROSS>(&cells, &mut spots).mixed(&spots);
            let up = setup.patch.read::<UP>(&cells, &mut spots).mixed(&spots);
            let twist = setup.patch.read::<TWIST>(&cells, &mut spots).mixed(&spots);
            for l in 0..LANES {
                let (qu, qv) = (0.5 * off_node(u[l]), 0.5 * off_node(v[l]));
                let curve = (qu * qv * twist[l] - qu * across[l] - qv * up[l]) * unit;
                row.curve[l] = if known[l] > 0.0 { curve } else { 0.0 };
            }
            let third = |t: &Lane| t.map(|t| (1.0 + t) * (1.0 / 3.0));
            let (u_third, v_third) = (third(&u), third(&v));
            let across = setup.patch.read::<SPLINE_ACROSS>(&cells, &mut spots).mixed_at(&u_third, &v);
            let up = setup.patch.read::<SPLINE_UP>(&cells, &mut spots).mixed_at(&u, &v_third);
            let twist = setup.patch.read::<SPLINE_TWIST>(&cells, &mut spots).mixed_at(&u_third, &v_third);
            for l in 0..LANES {
                let (qu, qv) = (0.5 * off_node(u[l]), 0.5 * off_node(v[l]));
                let spline = (qu * qv * twist[l] - qu * across[l] - qv * up[l]) * unit;
                row.spline[l] = if known[l] > 0.0 { spline } else { 0.0 };
            }
        } else {
            (row.curve, row.spline) = ([0.0; LANES], [0.0; LANES]);
        }
        if setup.lifts {
            let lift = setup.patch.read::<LIFT>(&cells, &mut spots).mixed(&spots);
            for l in 0..LANES {
                row.lift[l] = if known[l] > 0.0 { lift[l] * unit } else { 0.0 };
            }
        }
        if setup.patch.even {
            let [even_variance, even_distance] = setup.patch.everywhere(setup.places[k]);
            for l in 0..LANES {
                row.map_variance[l] = known[l] * even_variance * unit * unit;
                row.distance[l] = known[l] * even_distance;
            }
        } else {
            let variance = setup.patch.read::<VARIANCE>(&cells, &mut spots).mixed(&spots);
            let distance = setup.patch.read::<DISTANCE>(&cells, &mut spots).mixed(&spots);
            for l in 0..LANES {
                let on = known[l] > 0.0;
                row.map_variance[l] = if on { variance[l] * unit * unit } else { 0.0 };
                row.distance[l] = if on { distance[l] } else { 0.0 };
            }
        }
    }
}

/// How far a place is from the nodes on either side of it: 0 at a node, 1/4 half way.
#[inline(always)]
fn off_node(t: f32) -> f32 {
    t * (1.0 - t)
}

/// The least and the most of that within `half` of a place.
#[inline(always)]
fn off_node_within(t: f32, half: f32) -> (f32, f32) {
    let (below, above) = (off_node(t - half), off_node(t + half));
    let most = if (t - 0.5).abs() <= half { 0.25 } else { below.max(above) };
    (below.min(above).max(0.0), most)
}

#[inline(always)]
fn evaluate<const BOUND: bool>(
    setup: &Setup<'_>,
    levels: Range<usize>,
    widening: &[f32],
    scratch: &mut Scratch,
) -> Scores {
    let n = setup.places.len();
    let (mut count, mut distance, mut map_variance) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let mut between = [0.0; LANES];
    for row in &scratch.rows {
        for l in 0..LANES {
            count[l] += row.known[l];
            distance[l] += row.distance[l];
            map_variance[l] += row.map_variance[l];
            between[l] += row.between[l];
        }
    }
    for l in 0..LANES {
        distance[l] /= count[l].max(1.0);
        map_variance[l] /= count[l].max(1.0);
        between[l] /= count[l].max(1.0);
    }
    let needed = (setup.min_overlap * n as f64).max(1.0);
    let mut out = [[f64::NEG_INFINITY; LANES]; LEVELS];
    let mut bias = [0.0; LANES];
    let mut theta = [[0.0; LANES]; MOST];
    let mut weighed: Option<(Level, Wide)> = None;
    for index in levels {
        let level = &setup.levels[index];
        // A level that differs from the one before in its tails only has the same variances; the bias is nearly the same anyhow.
        let (mut lane, turns) = match weighed {
            Some((before, lane)) if before.same_surface(level) => (lane, &widening[widening.len() - 1..]),
            Some(_) => (weigh::<BOUND>(scratch, level), &widening[1..]),
            None => (weigh::<BOUND>(scratch, level), widening),
        };
        weighed = Some((*level, lane));
        if setup.shapes.is_empty() {
            one_bias::<BOUND>(setup, scratch, Tails::of(level), turns, &mut bias, &mut lane);
        } else {
            let tails = Tails::of(level);
            let log = match setup.shapes.len() + usize::from(setup.bias_sigma.is_some()) {
                n if n <= FEW => nuisances::<BOUND, FEW>(setup, scratch, tails, turns, &mut theta),
                n if n <= SOME => nuisances::<BOUND, SOME>(setup, scratch, tails, turns, &mut theta),
                _ => nuisances::<BOUND, MOST>(setup, scratch, tails, turns, &mut theta),
            };
            for l in 0..LANES {
                lane[l] += log[l];
            }
        }
        for l in 0..LANES {
            // A candidate that misses a few samples is judged by those that it has, as if there were all.
            let count = f64::from(count[l]);
            out[index][l] = if count >= needed { lane[l] * (n as f64 / count.max(1.0)) } else { f64::NEG_INFINITY };
        }
    }
    Scores { log_likelihood: out, distance, map_variance, between }
}
