//! The likelihood of candidates: Student-t, bias and nuisance parameters integrated out, for several error levels at once.
//!
//! For a candidate offset with residuals e_k = measured - map and variances s_k^2, the bias b that maximises
//! prod t(e_k - b) is found by reweighting (weights (nu + 1) / (nu s^2 + e^2), started wide so that an outlier cannot
//! capture it) and integrated out by Laplace's method with the expected information (nu + 1) / ((nu + 3) s^2).
//! Logarithms are taken of running products, so that a sample costs multiplications only.

use super::model::Level;
use super::patch::Patch;

/// Candidates handled together, so that the inner loops are vectors.
pub(super) const LANES: usize = 16;
/// Multipliers of the variance in successive reweightings.
const WIDENING: [f64; 5] = [400.0, 25.0, 4.0, 1.0, 1.0];
/// Factors multiplied before a logarithm is taken; each lies between 1e-18 and 1e20.
const PRODUCT: usize = 8;
/// Most nuisance parameters: bias, heading, scale, drift east and north.
const MOST: usize = 5;

type Lane = [f64; LANES];

/// What the kernel needs to know beside the map.
#[derive(Debug, Clone)]
pub(super) struct Setup<'a> {
    pub patch: &'a Patch,
    /// Indicated positions, map units, on the map's own turn of longitude.
    pub positions: &'a [[f64; 2]],
    /// Measured values minus the patch's level.
    pub values: &'a [f64],
    /// Metres per cell of the map, `[east, north]`.
    pub cell_m: [f64; 2],
    /// Half the lattice step and the position jitter as one standard deviation per axis, metres squared.
    pub blur_m2: [f64; 2],
    pub sensor_variance: f64,
    pub levels: &'a [Level],
    /// None: no bias at all; infinite: unknown without bound.
    pub bias_sigma: Option<f64>,
    /// Displacement shapes and prior sigmas of the other nuisance parameters.
    pub shapes: &'a [Vec<[f64; 2]>],
    pub sigmas: &'a [f64],
    /// Whether those are solved for, or only widen the variance.
    pub solve: bool,
    pub min_overlap: f64,
}

/// Log-likelihoods and mean distance to the data of `LANES` candidates.
#[derive(Debug, Clone)]
pub(super) struct Scores {
    /// `[level][lane]`, minus infinity where too few samples lie on the map.
    pub log_likelihood: Vec<Lane>,
    pub distance: Lane,
    /// Mean map variance along the track.
    pub map_variance: Lane,
}

/// Room for one block of candidates, reused from block to block.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    residual: Vec<Lane>,
    map_variance: Vec<Lane>,
    extra_variance: Vec<Lane>,
    known: Vec<Lane>,
    precision: Vec<Lane>,
    gradient: Vec<[Lane; 2]>,
}

/// Scores the candidates `offsets` (at most [`LANES`]; map units).
pub(super) fn score(setup: &Setup<'_>, offsets: &[[f64; 2]], scratch: &mut Scratch) -> Scores {
    fill(setup, offsets, scratch);
    pulp::Arch::new().dispatch(Block { setup, scratch })
}

struct Block<'a, 'b> {
    setup: &'a Setup<'b>,
    scratch: &'a mut Scratch,
}

impl pulp::WithSimd for Block<'_, '_> {
    type Output = Scores;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Scores {
        evaluate(self.setup, self.scratch)
    }
}

/// Samples the map along the track at every candidate.
fn fill(setup: &Setup<'_>, offsets: &[[f64; 2]], scratch: &mut Scratch) {
    let n = setup.positions.len();
    for rows in [
        &mut scratch.residual,
        &mut scratch.map_variance,
        &mut scratch.extra_variance,
        &mut scratch.known,
        &mut scratch.precision,
    ] {
        rows.resize(n, [0.0; LANES]);
    }
    scratch.gradient.resize(n, [[0.0; LANES]; 2]);
    let [cell_east, cell_north] = setup.cell_m;
    for k in 0..n {
        let [x, y] = setup.positions[k];
        for lane in 0..LANES {
            let Some(offset) = offsets.get(lane) else {
                scratch.known[k][lane] = 0.0;
                scratch.extra_variance[k][lane] = 1.0;
                continue;
            };
            let [px, py] = setup.patch.position(x + offset[0], y + offset[1]);
            let sample = setup.patch.at(px, py);
            let residual = setup.values[k] - f64::from(sample.value);
            let (gx, gy) = (f64::from(sample.gradient[0]) / cell_east, f64::from(sample.gradient[1]) / cell_north);
            let curved = f64::from(sample.curvature);
            let mut extra =
                setup.sensor_variance + curved * curved / 3.0 + gx * gx * setup.blur_m2[0] + gy * gy * setup.blur_m2[1];
            if !setup.solve {
                for (shape, sigma) in setup.shapes.iter().zip(setup.sigmas) {
                    let [east, north] = shape[k];
                    extra += ((gx * east + gy * north) * sigma).powi(2);
                }
            }
            let known = residual.is_finite();
            scratch.residual[k][lane] = if known { residual } else { 0.0 };
            scratch.map_variance[k][lane] = if known { f64::from(sample.variance) } else { 0.0 };
            scratch.extra_variance[k][lane] = if known { extra } else { 1.0 };
            scratch.known[k][lane] = if known { 1.0 } else { 0.0 };
            scratch.gradient[k][0][lane] = if known { gx } else { 0.0 };
            scratch.gradient[k][1][lane] = if known { gy } else { 0.0 };
            scratch.precision[k][lane] = if known { f64::from(sample.distance) } else { 0.0 };
        }
    }
}

#[inline(always)]
fn evaluate(setup: &Setup<'_>, scratch: &mut Scratch) -> Scores {
    let n = setup.positions.len();
    let (mut count, mut distance, mut map_variance) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for k in 0..n {
        for l in 0..LANES {
            count[l] += scratch.known[k][l];
            distance[l] += scratch.precision[k][l];
            map_variance[l] += scratch.map_variance[k][l];
        }
    }
    for l in 0..LANES {
        distance[l] /= count[l].max(1.0);
        map_variance[l] /= count[l].max(1.0);
    }
    let needed = (setup.min_overlap * n as f64).max(1.0);
    let mut out = Vec::with_capacity(setup.levels.len());
    let mut bias = [0.0; LANES];
    let solve = setup.solve && !setup.shapes.is_empty();
    for (index, level) in setup.levels.iter().enumerate() {
        let mut lane = weigh(scratch, level.factor * level.factor);
        let starts = if index == 0 { &WIDENING[..] } else { &WIDENING[2..] };
        if solve {
            solve_all(setup, scratch, level.nu, &mut lane);
        } else {
            one_bias(setup, scratch, level.nu, starts, &mut bias, &mut lane);
        }
        for l in 0..LANES {
            // A candidate that misses a few samples is judged by those that it has, as if there were all.
            lane[l] = if count[l] >= needed { lane[l] * (n as f64 / count[l].max(1.0)) } else { f64::NEG_INFINITY };
        }
        out.push(lane);
    }
    Scores { log_likelihood: out, distance, map_variance }
}

/// Fills the precisions 1 / s^2 and returns minus half the sum of ln s^2.
#[inline(always)]
fn weigh(scratch: &mut Scratch, level2: f64) -> Lane {
    let n = scratch.residual.len();
    let mut total = [0.0; LANES];
    let mut product = [1.0; LANES];
    for k in 0..n {
        for l in 0..LANES {
            let known = scratch.known[k][l];
            let variance = scratch.extra_variance[k][l] + level2 * scratch.map_variance[k][l];
            scratch.precision[k][l] = known / variance;
            // An unknown sample has variance 1 here, so it changes nothing.
            product[l] *= variance;
        }
        if k % PRODUCT == PRODUCT - 1 || k + 1 == n {
            for l in 0..LANES {
                total[l] -= 0.5 * product[l].ln();
                product[l] = 1.0;
            }
        }
    }
    total
}

/// Adds the log of the Student-t product with the bias integrated out.
#[inline(always)]
fn one_bias(setup: &Setup<'_>, scratch: &Scratch, nu: f64, widening: &[f64], bias: &mut Lane, total: &mut Lane) {
    let n = scratch.residual.len();
    let prior = setup.bias_sigma.map(|s| if s.is_finite() { 1.0 / (s * s) } else { 0.0 });
    if let Some(prior) = prior {
        for &wide in widening {
            let (mut weights, mut sums) = ([0.0; LANES], [0.0; LANES]);
            for k in 0..n {
                for l in 0..LANES {
                    let e = scratch.residual[k][l] - bias[l];
                    let p = scratch.precision[k][l];
                    let w = (nu + 1.0) * p / (nu * wide + e * e * p) * wide;
                    weights[l] += w;
                    sums[l] += w * e;
                }
            }
            for l in 0..LANES {
                let step = (sums[l] - prior * bias[l]) / (weights[l] + prior).max(f64::MIN_POSITIVE);
                bias[l] += step;
            }
        }
    }
    let mut product = [1.0; LANES];
    let mut logs = [0.0; LANES];
    let mut information = [0.0; LANES];
    for k in 0..n {
        for l in 0..LANES {
            let e = scratch.residual[k][l] - bias[l];
            let p = scratch.precision[k][l];
            product[l] *= 1.0 + e * e * p / nu;
            information[l] += p;
        }
        if k % PRODUCT == PRODUCT - 1 || k + 1 == n {
            for l in 0..LANES {
                logs[l] += product[l].ln();
                product[l] = 1.0;
            }
        }
    }
    for l in 0..LANES {
        total[l] -= 0.5 * (nu + 1.0) * logs[l];
        if let Some(prior) = prior {
            let curvature = information[l] * (nu + 1.0) / (nu + 3.0) + prior;
            total[l] -= 0.5 * (bias[l] * bias[l] * prior + curvature.max(f64::MIN_POSITIVE).ln());
            if prior > 0.0 {
                total[l] += 0.5 * prior.ln();
            }
        }
    }
}

/// Adds the log of the Student-t product with the bias and all other nuisance parameters integrated out.
fn solve_all(setup: &Setup<'_>, scratch: &Scratch, nu: f64, total: &mut Lane) {
    for (l, total) in total.iter_mut().enumerate() {
        let (_, log) = nuisances(setup, scratch, nu, l);
        *total += log;
    }
}

/// The most likely nuisance parameters of one candidate (bias first, where there is one) and the log of the integral.
fn nuisances(setup: &Setup<'_>, scratch: &Scratch, nu: f64, lane: usize) -> ([f64; MOST], f64) {
    let n = scratch.residual.len();
    let with_bias = usize::from(setup.bias_sigma.is_some());
    let size = with_bias + setup.shapes.len();
    let mut prior = [0.0; MOST];
    if let Some(s) = setup.bias_sigma {
        prior[0] = if s.is_finite() { 1.0 / (s * s) } else { 0.0 };
    }
    for (i, sigma) in setup.sigmas.iter().enumerate() {
        prior[with_bias + i] = 1.0 / (sigma * sigma);
    }
    let row = |k: usize| {
        let mut h = [0.0; MOST];
        h[0] = 1.0;
        for (i, shape) in setup.shapes.iter().enumerate() {
            let [east, north] = shape[k];
            h[with_bias + i] = scratch.gradient[k][0][lane] * east + scratch.gradient[k][1][lane] * north;
        }
        h
    };
    let mut theta = [0.0; MOST];
    let normal = |theta: &[f64; MOST], weight: &dyn Fn(f64, f64) -> f64| {
        let mut matrix = [[0.0; MOST]; MOST];
        let mut right = [0.0; MOST];
        for k in 0..n {
            let p = scratch.precision[k][lane];
            let h = row(k);
            let e = scratch.residual[k][lane] - (0..size).map(|i| h[i] * theta[i]).sum::<f64>();
            let w = weight(e, p);
            for i in 0..size {
                right[i] += w * e * h[i];
                for j in 0..=i {
                    matrix[i][j] += w * h[i] * h[j];
                }
            }
        }
        for i in 0..size {
            matrix[i][i] += prior[i];
            right[i] -= prior[i] * theta[i];
        }
        (matrix, right)
    };
    for wide in WIDENING {
        let (matrix, right) = normal(&theta, &|e, p| (nu + 1.0) * p * wide / (nu * wide + e * e * p));
        if let Some((step, _)) = cholesky_solve(matrix, right, size) {
            for i in 0..size {
                theta[i] += step[i];
            }
        }
    }
    let mut log = 0.0;
    for k in 0..n {
        let h = row(k);
        let e = scratch.residual[k][lane] - (0..size).map(|i| h[i] * theta[i]).sum::<f64>();
        log -= 0.5 * (nu + 1.0) * (e * e * scratch.precision[k][lane] / nu).ln_1p();
    }
    let (matrix, right) = normal(&theta, &|_, p| p * (nu + 1.0) / (nu + 3.0));
    if let Some((_, log_determinant)) = cholesky_solve(matrix, right, size) {
        log -= 0.5 * log_determinant;
    }
    for i in 0..size {
        log -= 0.5 * prior[i] * theta[i] * theta[i];
        if prior[i] > 0.0 {
            log += 0.5 * prior[i].ln();
        }
    }
    (theta, log)
}

/// Solution and log determinant of a small symmetric system given by its lower triangle.
fn cholesky_solve(mut a: [[f64; MOST]; MOST], b: [f64; MOST], size: usize) -> Option<([f64; MOST], f64)> {
    let mut log_determinant = 0.0;
    for i in 0..size {
        for j in 0..=i {
            let mut sum = a[i][j];
            for k in 0..j {
                sum -= a[i][k] * a[j][k];
            }
            if i == j {
                if sum <= 0.0 || !sum.is_finite() {
                    return None;
                }
                a[i][i] = sum.sqrt();
                log_determinant += sum.ln();
            } else {
                a[i][j] = sum / a[j][j];
            }
        }
    }
    let mut x = b;
    for i in 0..size {
        for k in 0..i {
            x[i] -= a[i][k] * x[k];
        }
        x[i] /= a[i][i];
    }
    for i in (0..size).rev() {
        for k in i + 1..size {
            x[i] -= a[k][i] * x[k];
        }
        x[i] /= a[i][i];
    }
    Some((x, log_determinant))
}

/// What one candidate looks like under one error level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Detail {
    /// Measured minus map constant.
    pub bias: f64,
    /// Nuisance parameters beside the bias, in the setup's order.
    pub theta: [f64; MOST],
    /// Mean of (nu + 1) z^2 / (nu + z^2), 1 where the model holds.
    pub misfit: f64,
    /// Samples that lie on the map.
    pub known: usize,
    /// Information on the offset, nuisance parameters out, one over square metres: `[ee, en, nn]`.
    pub information: [f64; 3],
}

/// Looks closely at one candidate under one error level.
pub(super) fn detail(setup: &Setup<'_>, offset: [f64; 2], level: Level, scratch: &mut Scratch) -> Detail {
    fill(setup, &[offset], scratch);
    weigh(scratch, level.factor * level.factor);
    let (theta, _) = nuisances(setup, scratch, level.nu, 0);
    let with_bias = usize::from(setup.bias_sigma.is_some());
    let n = setup.positions.len();
    let nu = level.nu;
    let (mut misfit, mut known) = (0.0, 0);
    let size = with_bias + setup.shapes.len();
    // Fisher information of (offset east, north, nuisances); the Schur complement leaves that of the offset.
    let mut full = [[0.0; MOST + 2]; MOST + 2];
    for k in 0..n {
        let p = scratch.precision[k][0];
        if p == 0.0 {
            continue;
        }
        known += 1;
        let (gx, gy) = (scratch.gradient[k][0][0], scratch.gradient[k][1][0]);
        let mut h = [0.0; MOST + 2];
        h[0] = gx;
        h[1] = gy;
        if with_bias == 1 {
            h[2] = 1.0;
        }
        let mut e = scratch.residual[k][0] - if with_bias == 1 { theta[0] } else { 0.0 };
        for (i, shape) in setup.shapes.iter().enumerate() {
            let [east, north] = shape[k];
            h[2 + with_bias + i] = gx * east + gy * north;
            e -= h[2 + with_bias + i] * theta[with_bias + i];
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
    for (i, sigma) in setup.sigmas.iter().enumerate() {
        full[2 + with_bias + i][2 + with_bias + i] += 1.0 / (sigma * sigma);
    }
    let information = schur(full, size);
    let mut rest = [0.0; MOST];
    rest[..setup.shapes.len()].copy_from_slice(&theta[with_bias..with_bias + setup.shapes.len()]);
    Detail {
        bias: if with_bias == 1 { theta[0] } else { 0.0 },
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
