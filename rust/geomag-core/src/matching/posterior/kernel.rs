//! The likelihood of candidates: Student-t, bias and nuisance parameters integrated out, for several error levels at once.
//!
//! For a candidate offset with residuals e_k = measured - map and variances s_k^2, the bias b that maximises
//! prod t(e_k - b) is found by reweighting (weights (nu + 1) / (nu s^2 + e^2), started wide so that an outlier cannot
//! capture it) and integrated out by Laplace's method with the expected information (nu + 1) / ((nu + 3) s^2).
//!
//! Beside the density at the candidate itself there is its bound over the candidate's cell: every residual may be
//! smaller by as much as the map changes within the cell, |dm/dx| h_x + |dm/dy| h_y and the bend of the map over it.
//! What the bound rules out holds no place that the density would have found.
//!
//! Values are in units of the sensor's standard deviation, so that single precision suffices for the samples; sums over
//! samples are in double precision.

use std::ops::Range;

use super::model::{LEVELS, Level};
use super::patch::{BEND, Cells, DISTANCE, Patch, Place, VALUE, VARIANCE};

/// Candidates handled together, so that the inner loops are vectors.
pub(super) const LANES: usize = 16;
/// Multipliers of the variance in successive reweightings.
const WIDENING: [f32; 4] = [100.0, 9.0, 1.0, 1.0];
/// Factors multiplied before a logarithm is taken; each is below 1e9, so that the product is finite.
const PRODUCT: usize = 4;
/// Largest factor of such a product: beyond it a candidate is dead whatever the rest says.
const LARGEST: f32 = 1e9;
/// Most nuisance parameters: bias, heading, scale, drift east and north.
const MOST: usize = 5;
/// Share of a sample inside its cell's reach in the step of a bound's bias: it does not pull, but must not let go at once.
const INSIDE: f32 = 0.3;

type Lane = [f32; LANES];
type Wide = [f64; LANES];

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
    pub levels: &'a [Level],
    /// None: no bias at all; infinite: unknown without bound. In units.
    pub bias_sigma: Option<f64>,
    /// Displacement in metres per standard deviation of every other nuisance parameter: `shapes[parameter][sample]`.
    pub shapes: &'a [Vec<[f32; 2]>],
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
}

impl Scores {
    /// Of no candidate at all.
    pub fn nothing() -> Self {
        Self {
            log_likelihood: [[f64::NEG_INFINITY; LANES]; LEVELS],
            distance: [0.0; LANES],
            map_variance: [0.0; LANES],
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
    residual: Lane,
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
        if self.setup.patch.even {
            fill::<BOUND, true>(self.setup, self.offsets, self.scratch);
        } else {
            fill::<BOUND, false>(self.setup, self.offsets, self.scratch);
        }
        evaluate::<BOUND>(self.setup, self.levels, self.scratch)
    }
}

/// Samples the map along the track at every candidate.
#[inline(always)]
fn fill<const BOUND: bool, const EVEN: bool>(setup: &Setup<'_>, offsets: &[[f64; 2]], scratch: &mut Scratch) {
    let n = setup.places.len();
    scratch.rows.resize(n, EMPTY);
    let unit = setup.per_unit;
    let [per_east, per_north] = setup.cell_m.map(|m| unit / m);
    let ([blur_x, blur_y], sensor_variance) = (setup.blur_m2, setup.sensor_variance);
    let [half_x, half_y] = setup.half_cells;
    let half = half_x.max(half_y);
    let cells = Cells::new(offsets);
    let [even_variance, even_distance] = setup.patch.everywhere();
    for k in 0..n {
        let row = &mut scratch.rows[k];
        let mut spots = setup.patch.locate(setup.places[k], &cells);
        let values = setup.patch.read::<VALUE>(&cells, &mut spots);
        let bend = setup.patch.read::<BEND>(&cells, &mut spots).mixed(&spots);
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
            let curved = 0.5 * bend[l] * (u[l] * (1.0 - u[l])).max(v[l] * (1.0 - v[l])) * unit;
            let extra = sensor_variance + curved * curved * (1.0 / 3.0) + gx_m * gx_m * blur_x + gy_m * gy_m * blur_y;
            let on = known[l] > 0.0;
            extra_variance[l] = extra;
            row.gradient[0][l] = if on { gx_m } else { 0.0 };
            row.gradient[1][l] = if on { gy_m } else { 0.0 };
            if BOUND {
                let reach = (half_x * gx.abs() + half_y * gy.abs() + half * bend[l]) * unit;
                row.reach[l] = if on { reach } else { 0.0 };
            }
        }
        for l in 0..LANES {
            row.extra_variance[l] = if known[l] > 0.0 { extra_variance[l] } else { 1.0 };
        }
        if EVEN {
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

#[inline(always)]
fn evaluate<const BOUND: bool>(setup: &Setup<'_>, levels: Range<usize>, scratch: &mut Scratch) -> Scores {
    let n = setup.places.len();
    let (mut count, mut distance, mut map_variance) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for row in &scratch.rows {
        for l in 0..LANES {
            count[l] += row.known[l];
            distance[l] += row.distance[l];
            map_variance[l] += row.map_variance[l];
        }
    }
    for l in 0..LANES {
        distance[l] /= count[l].max(1.0);
        map_variance[l] /= count[l].max(1.0);
    }
    let needed = (setup.min_overlap * n as f64).max(1.0);
    let mut out = [[f64::NEG_INFINITY; LANES]; LEVELS];
    let mut bias = [0.0; LANES];
    let mut theta = [[0.0; LANES]; MOST];
    let mut weighed: Option<(f64, Wide)> = None;
    for index in levels {
        let level = &setup.levels[index];
        // A level that differs from the one before in its tails only has the same variances, and nearly the same bias.
        let (mut lane, turns) = match weighed {
            Some((factor, lane)) if factor == level.factor => (lane, &WIDENING[WIDENING.len() - 1..]),
            Some(_) => (weigh(scratch, (level.factor * level.factor) as f32), &WIDENING[1..]),
            None => (weigh(scratch, (level.factor * level.factor) as f32), &WIDENING[..]),
        };
        weighed = Some((level.factor, lane));
        if setup.shapes.is_empty() {
            one_bias::<BOUND>(setup, scratch, level.nu as f32, turns, &mut bias, &mut lane);
        } else {
            let log = nuisances::<BOUND>(setup, scratch, level.nu as f32, turns, &mut theta);
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
    Scores { log_likelihood: out, distance, map_variance }
}

/// Natural logarithm of positive normal numbers to 2e-7: exponent and the series of 2 artanh((m - 1) / (m + 1)).
#[inline(always)]
fn logarithm(x: f32) -> f32 {
    let bits = x.to_bits();
    // Mantissa brought to [sqrt 1/2, sqrt 2).
    let shifted = bits.wrapping_sub(0x3f35_04f3);
    let exponent = (shifted as i32) >> 23;
    let m = f32::from_bits(bits.wrapping_sub((exponent << 23) as u32));
    let s = (m - 1.0) / (m + 1.0);
    let s2 = s * s;
    let series = s * (2.0 + s2 * (2.0 / 3.0 + s2 * (0.4 + s2 * (2.0 / 7.0 + s2 * (2.0 / 9.0)))));
    exponent as f32 * std::f32::consts::LN_2 + series
}

/// Fills the precisions 1 / s^2 and returns minus half the sum of ln s^2.
#[inline(always)]
fn weigh(scratch: &mut Scratch, level2: f32) -> Wide {
    let n = scratch.rows.len();
    let mut total = [0.0; LANES];
    let mut product = [1.0_f32; LANES];
    for (k, row) in scratch.rows.iter_mut().enumerate() {
        for l in 0..LANES {
            let variance = row.extra_variance[l] + level2 * row.map_variance[l];
            row.precision[l] = row.known[l] / variance;
            // An unknown sample has variance 1 here, so it changes nothing.
            product[l] *= variance.clamp(1.0 / LARGEST, LARGEST);
        }
        if k % PRODUCT == PRODUCT - 1 || k + 1 == n {
            for l in 0..LANES {
                total[l] -= 0.5 * f64::from(logarithm(product[l]));
                product[l] = 1.0;
            }
        }
    }
    total
}

/// What of a residual is left when it may change by `reach` either way.
#[inline(always)]
fn beyond<const BOUND: bool>(e: f32, reach: f32) -> f32 {
    if BOUND { e - e.min(reach).max(-reach) } else { e }
}

/// Adds the log of the Student-t product with the bias integrated out.
#[inline(always)]
fn one_bias<const BOUND: bool>(
    setup: &Setup<'_>,
    scratch: &Scratch,
    nu: f32,
    widening: &[f32],
    bias: &mut Lane,
    total: &mut Wide,
) {
    let n = scratch.rows.len();
    let prior = setup.bias_sigma.map(|s| if s.is_finite() { (1.0 / (s * s)) as f32 } else { 0.0 });
    if let Some(prior) = prior {
        for (turn, &wide) in widening.iter().enumerate() {
            let last = turn + 2 >= widening.len();
            let (mut weights, mut sums) = ([0.0_f32; LANES], [0.0_f32; LANES]);
            let scale = (nu + 1.0) * wide;
            for row in &scratch.rows {
                for l in 0..LANES {
                    let whole = row.residual[l] - bias[l];
                    let p = row.precision[l];
                    if BOUND {
                        // Started on the residuals themselves, each as wide as its reach, then on what is beyond it.
                        let (e, p, share) = if last {
                            let e = beyond::<true>(whole, row.reach[l]);
                            (e, p, if e == 0.0 { INSIDE } else { 1.0 })
                        } else {
                            (whole, p / (1.0 + p * row.reach[l] * row.reach[l] * (1.0 / 3.0)), 1.0)
                        };
                        let w = scale * p / (nu * wide + e * e * p);
                        weights[l] += w * share;
                        sums[l] += w * e;
                    } else {
                        let w = scale * p / (nu * wide + whole * whole * p);
                        weights[l] += w;
                        sums[l] += w * whole;
                    }
                }
            }
            for l in 0..LANES {
                bias[l] += (sums[l] - prior * bias[l]) / (weights[l] + prior).max(f32::MIN_POSITIVE);
            }
        }
    }
    let mut product = [1.0_f32; LANES];
    let mut logs = [0.0_f64; LANES];
    let mut information = [0.0_f32; LANES];
    let per_nu = 1.0 / nu;
    for (k, row) in scratch.rows.iter().enumerate() {
        for l in 0..LANES {
            let e = beyond::<BOUND>(row.residual[l] - bias[l], row.reach[l]);
            let p = row.precision[l];
            product[l] *= (1.0 + e * e * p * per_nu).min(LARGEST);
            information[l] += p;
        }
        if k % PRODUCT == PRODUCT - 1 || k + 1 == n {
            for l in 0..LANES {
                logs[l] += f64::from(logarithm(product[l]));
                product[l] = 1.0;
            }
        }
    }
    let (nu, expected) = (f64::from(nu), (nu + 1.0) / (nu + 3.0));
    for l in 0..LANES {
        total[l] -= 0.5 * (nu + 1.0) * logs[l];
        if let Some(prior) = prior {
            let curvature = (information[l] * expected + prior).max(f32::MIN_POSITIVE);
            total[l] -= 0.5 * f64::from(bias[l] * bias[l] * prior + logarithm(curvature));
            if prior > 0.0 {
                total[l] += 0.5 * f64::from(prior).ln();
            }
        }
    }
}

#[inline(always)]
fn narrow(theta: &[Wide; MOST]) -> [Lane; MOST] {
    let mut narrowed = [[0.0; LANES]; MOST];
    for i in 0..MOST {
        for l in 0..LANES {
            narrowed[i][l] = theta[i][l] as f32;
        }
    }
    narrowed
}

/// Derivatives of one sample's residual by the nuisance parameters, bias first where there is one.
#[inline(always)]
fn derivatives(setup: &Setup<'_>, row: &Row, k: usize, with_bias: usize, h: &mut [Lane; MOST]) {
    if with_bias == 1 {
        h[0] = [1.0; LANES];
    }
    for (i, shape) in setup.shapes.iter().enumerate() {
        let [east, north] = shape[k];
        for l in 0..LANES {
            h[with_bias + i][l] = row.gradient[0][l] * east + row.gradient[1][l] * north;
        }
    }
}

/// The log of the Student-t product with all nuisance parameters integrated out; `theta` becomes their most likely values
/// (bias first, where there is one; the others in standard deviations), sought from those given.
#[inline(always)]
fn nuisances<const BOUND: bool>(
    setup: &Setup<'_>,
    scratch: &Scratch,
    nu: f32,
    turns: &[f32],
    theta: &mut [Wide; MOST],
) -> Wide {
    let n = scratch.rows.len();
    let with_bias = usize::from(setup.bias_sigma.is_some());
    let size = (with_bias + setup.shapes.len()).min(MOST);
    // Standard deviations are the unit of all but the bias.
    let mut prior = [1.0_f64; MOST];
    if let Some(s) = setup.bias_sigma {
        prior[0] = if s.is_finite() { 1.0 / (s * s) } else { 0.0 };
    }
    let mut h = [[0.0_f32; LANES]; MOST];
    let mut matrix = [[[0.0_f64; LANES]; MOST]; MOST];
    let mut right = [[0.0_f64; LANES]; MOST];
    for (turn, wide) in turns.iter().copied().chain([0.0]).enumerate() {
        let expected = turn == turns.len();
        let last = turn + 2 >= turns.len();
        let at = narrow(theta);
        let mut sums = [[[0.0_f32; LANES]; MOST]; MOST];
        let mut pulls = [[0.0_f32; LANES]; MOST];
        for (k, row) in scratch.rows.iter().enumerate() {
            derivatives(setup, row, k, with_bias, &mut h);
            let (mut weight, mut pull) = ([0.0_f32; LANES], [0.0_f32; LANES]);
            for l in 0..LANES {
                let mut e = row.residual[l];
                for i in 0..size {
                    e -= h[i][l] * at[i][l];
                }
                let p = row.precision[l];
                if expected {
                    weight[l] = p * (nu + 1.0) / (nu + 3.0);
                } else if BOUND && !last {
                    let p = p / (1.0 + p * row.reach[l] * row.reach[l] * (1.0 / 3.0));
                    weight[l] = (nu + 1.0) * p * wide / (nu * wide + e * e * p);
                    pull[l] = weight[l] * e;
                } else {
                    e = beyond::<BOUND>(e, row.reach[l]);
                    let w = (nu + 1.0) * p * wide / (nu * wide + e * e * p);
                    pull[l] = w * e;
                    weight[l] = if BOUND && e == 0.0 { INSIDE * w } else { w };
                }
            }
            for i in 0..size {
                for l in 0..LANES {
                    pulls[i][l] += pull[l] * h[i][l];
                }
                for j in 0..=i {
                    for l in 0..LANES {
                        sums[i][j][l] += weight[l] * h[i][l] * h[j][l];
                    }
                }
            }
        }
        for i in 0..size {
            for l in 0..LANES {
                right[i][l] = f64::from(pulls[i][l]) - prior[i] * theta[i][l];
                for j in 0..=i {
                    matrix[i][j][l] = f64::from(sums[i][j][l]);
                }
                matrix[i][i][l] += prior[i];
            }
        }
        factorise(&mut matrix, size);
        if !expected {
            solve(&matrix, &mut right, size);
            for i in 0..size {
                for l in 0..LANES {
                    theta[i][l] += right[i][l];
                }
            }
        }
    }
    let at = narrow(theta);
    let mut product = [1.0_f32; LANES];
    let mut log = [0.0_f64; LANES];
    for (k, row) in scratch.rows.iter().enumerate() {
        derivatives(setup, row, k, with_bias, &mut h);
        for l in 0..LANES {
            let mut e = row.residual[l];
            for i in 0..size {
                e -= h[i][l] * at[i][l];
            }
            let e = beyond::<BOUND>(e, row.reach[l]);
            product[l] *= (1.0 + e * e * row.precision[l] / nu).min(LARGEST);
        }
        if k % PRODUCT == PRODUCT - 1 || k + 1 == n {
            for l in 0..LANES {
                log[l] -= 0.5 * f64::from(nu + 1.0) * f64::from(logarithm(product[l]));
                product[l] = 1.0;
            }
        }
    }
    for i in 0..size {
        for l in 0..LANES {
            log[l] -= matrix[i][i][l].ln() + 0.5 * prior[i] * theta[i][l] * theta[i][l];
            if prior[i] > 0.0 {
                log[l] += 0.5 * prior[i].ln();
            }
        }
    }
    log
}

/// Cholesky factor of a small symmetric matrix in its own lower triangle, lane by lane.
///
/// A pivot that rounding has made zero or negative, of a lane without known samples, is taken as tiny.
#[inline(always)]
fn factorise(a: &mut [[Wide; MOST]; MOST], size: usize) {
    for i in 0..size {
        for j in 0..=i {
            let mut sum = a[i][j];
            for k in 0..j {
                for l in 0..LANES {
                    sum[l] -= a[i][k][l] * a[j][k][l];
                }
            }
            for l in 0..LANES {
                a[i][j][l] = if i == j { sum[l].max(1e-30).sqrt() } else { sum[l] / a[j][j][l] };
            }
        }
    }
}

/// Solves for the right-hand side in place.
#[inline(always)]
fn solve(a: &[[Wide; MOST]; MOST], x: &mut [Wide; MOST], size: usize) {
    for i in 0..size {
        for l in 0..LANES {
            for k in 0..i {
                x[i][l] -= a[i][k][l] * x[k][l];
            }
            x[i][l] /= a[i][i][l];
        }
    }
    for i in (0..size).rev() {
        for l in 0..LANES {
            for k in i + 1..size {
                x[i][l] -= a[k][i][l] * x[k][l];
            }
            x[i][l] /= a[i][i][l];
        }
    }
}

/// What one candidate looks like under one error level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Detail {
    /// Measured minus map constant, units.
    pub bias: f64,
    /// Nuisance parameters beside the bias, in the setup's order, standard deviations about the node.
    pub theta: [f64; MOST],
    /// Mean of (nu + 1) z^2 / (nu + z^2), 1 where the model holds.
    pub misfit: f64,
    /// Samples that lie on the map.
    pub known: usize,
    /// Information on the offset, nuisance parameters out, one over square metres: `[ee, en, nn]`.
    pub information: [f64; 3],
}

/// Looks closely at one candidate (cells of the map) under one error level.
pub(super) fn detail(setup: &Setup<'_>, offset: [f64; 2], level: Level, scratch: &mut Scratch) -> Detail {
    pulp::Arch::new().dispatch(Single { setup, offset, level, scratch })
}

struct Single<'a, 'b> {
    setup: &'a Setup<'b>,
    offset: [f64; 2],
    level: Level,
    scratch: &'a mut Scratch,
}

impl pulp::WithSimd for Single<'_, '_> {
    type Output = Detail;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Detail {
        look_closely(self.setup, self.offset, self.level, self.scratch)
    }
}

#[inline(always)]
fn look_closely(setup: &Setup<'_>, offset: [f64; 2], level: Level, scratch: &mut Scratch) -> Detail {
    fill::<false, false>(setup, &[offset], scratch);
    weigh(scratch, (level.factor * level.factor) as f32);
    let with_bias = usize::from(setup.bias_sigma.is_some());
    let mut theta = [[0.0; LANES]; MOST];
    nuisances::<false>(setup, scratch, level.nu as f32, &WIDENING, &mut theta);
    let nu = level.nu;
    let (mut misfit, mut known) = (0.0, 0);
    let size = with_bias + setup.shapes.len();
    // Fisher information of (offset east, north, nuisances); the Schur complement leaves that of the offset.
    let mut full = [[0.0; MOST + 2]; MOST + 2];
    let mut derived = [[0.0; LANES]; MOST];
    for (k, row) in scratch.rows.iter().enumerate() {
        let p = f64::from(row.precision[0]);
        if p == 0.0 {
            continue;
        }
        known += 1;
        derivatives(setup, row, k, with_bias, &mut derived);
        let mut h = [0.0; MOST + 2];
        h[0] = f64::from(row.gradient[0][0]);
        h[1] = f64::from(row.gradient[1][0]);
        let mut e = f64::from(row.residual[0]);
        for i in 0..size {
            h[2 + i] = f64::from(derived[i][0]);
            e -= h[2 + i] * theta[i][0];
        }
        misfit += (nu + 1.0) * e * e * p / (nu + e * e * p);
        for i in 0..size + 2 {
            for j in 0..size + 2 {
                full[i][j] += p * h[i] * h[j];
            }
        }
    }
    if let Some(s) = setup.bias_sigma
        && s.is_finite()
    {
        full[2][2] += 1.0 / (s * s);
    }
    for i in 0..setup.shapes.len() {
        // The whole prior: what is known of the offset must not depend on how it was divided.
        full[2 + with_bias + i][2 + with_bias + i] += setup.narrowed[i] * setup.narrowed[i];
    }
    let information = schur(full, size);
    let mut rest = [0.0; MOST];
    for i in 0..setup.shapes.len() {
        rest[i] = theta[with_bias + i][0];
    }
    Detail {
        bias: if with_bias == 1 { theta[0][0] } else { 0.0 },
        theta: rest,
        misfit: misfit / f64::from(known.max(1)),
        known: known as usize,
        information,
    }
}

/// Information on the first two parameters when the `others` after them are unknown.
fn schur(mut m: [[f64; MOST + 2]; MOST + 2], others: usize) -> [f64; 3] {
    for pivot in (2..2 + others).rev() {
        let diagonal = m[pivot][pivot];
        if diagonal <= 0.0 {
            continue;
        }
        for i in 0..pivot {
            for j in 0..pivot {
                m[i][j] -= m[i][pivot] * m[pivot][j] / diagonal;
            }
        }
    }
    [m[0][0], m[0][1], m[1][1]]
}
