//! The log-likelihood of a block of candidates with bias and other nuisance parameters integrated out.

use super::super::noise::ErrorLevel;
use super::super::nuisance::Shape;
use super::setup::{KernelScratch, LANES, Lane, MOST_PARAMETERS, SampleLanes, Setup, Wide};

/// Factors multiplied before a logarithm is taken; each is below 1e9, so that the product is finite.
pub(super) const PRODUCT: usize = 4;
/// Largest factor of such a product: beyond it a candidate is dead whatever the rest says.
const LARGEST: f32 = 1e9;
/// Share of a sample inside its cell's reach in the step of a bound's bias: it does not pull, but must not let go at once.
const INSIDE: f32 = 0.3;

/// Degrees of freedom with which parameters are sought, at first, under a loss whose outliers tell nothing: it must find them from afar.
const SEEKING_NU: f64 = 10.0;

/// The loss of one sample: Student-t up to a greatest one.
#[derive(Clone, Copy)]
pub(super) struct Tails {
    pub nu: f32,
    seeking_nu: f32,
    /// Greatest 1 + z^2 / nu, and the z^2 of it.
    pub most: f32,
    cut: f32,
}

impl Tails {
    pub fn of(level: &ErrorLevel) -> Self {
        let nu = level.nu as f32;
        if level.most_loss.is_infinite() {
            return Self { nu, seeking_nu: nu, most: LARGEST, cut: f32::INFINITY };
        }
        let most = (2.0 * level.most_loss / (level.nu + 1.0)).exp().min(f64::from(LARGEST));
        let cut = (level.nu * (most - 1.0)) as f32;
        Self { nu, seeking_nu: level.nu.min(SEEKING_NU) as f32, most: most as f32, cut }
    }

    /// Degrees of freedom of a turn of the reweighting, and the z^2 beyond which a sample has no weight in it.
    #[inline(always)]
    pub fn turn(self, last: bool) -> (f32, f32) {
        if last { (self.nu, self.cut) } else { (self.seeking_nu, f32::INFINITY) }
    }
}

/// Natural logarithm of positive normal numbers to 2e-7: exponent and the series of 2 artanh((m - 1) / (m + 1)).
#[inline(always)]
pub(super) fn logarithm(x: f32) -> f32 {
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

/// Fills the errors and precisions 1 / s^2 of a level and returns minus half the sum of ln s^2; for a bound, of the least s^2
/// within the candidate's cell.
#[inline(always)]
pub(super) fn weigh<const BOUND: bool>(scratch: &mut KernelScratch, level: &ErrorLevel) -> Wide {
    let n = scratch.rows.len();
    let (level2, between2) = ((level.factor * level.factor) as f32, (level.between * level.between) as f32);
    let (bicubic, spline) = level.surface.parts();
    let mut total = [0.0; LANES];
    let mut product = [1.0_f32; LANES];
    for (k, row) in scratch.rows.iter_mut().enumerate() {
        for l in 0..LANES {
            let variance = row.extra_variance[l] + level2 * row.map_variance[l] + between2 * row.between[l];
            row.precision[l] = row.known[l] / variance;
            row.error[l] = row.residual[l] - bicubic * row.curve[l] - spline * row.spline[l];
            let least = if BOUND { variance - between2 * (row.between[l] - row.least_between[l]) } else { variance };
            // An unknown sample has variance 1 here, so it changes nothing.
            product[l] *= least.clamp(1.0 / LARGEST, LARGEST);
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
pub(super) fn one_bias<const BOUND: bool>(
    setup: &Setup<'_>,
    scratch: &KernelScratch,
    tails: Tails,
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
            let (nu, cut) = tails.turn(last);
            let scale = (nu + 1.0) * wide;
            for row in &scratch.rows {
                for l in 0..LANES {
                    let whole = row.error[l] - bias[l];
                    let p = row.precision[l];
                    if BOUND {
                        // Started on the residuals themselves, each as wide as its reach, then on what is beyond it.
                        let (e, p, share) = if last {
                            let e = beyond::<true>(whole, row.reach[l]);
                            (e, p, if e == 0.0 { INSIDE } else { 1.0 })
                        } else {
                            (whole, p / (1.0 + p * row.reach[l] * row.reach[l] * (1.0 / 3.0)), 1.0)
                        };
                        let w = if e * e * p > cut { 0.0 } else { scale * p / (nu * wide + e * e * p) };
                        weights[l] += w * share;
                        sums[l] += w * e;
                    } else {
                        let z2 = whole * whole * p;
                        let w = if z2 > cut { 0.0 } else { scale * p / (nu * wide + z2) };
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
    let Tails { nu, most, .. } = tails;
    let per_nu = 1.0 / nu;
    for (k, row) in scratch.rows.iter().enumerate() {
        for l in 0..LANES {
            let e = beyond::<BOUND>(row.error[l] - bias[l], row.reach[l]);
            let p = row.precision[l];
            product[l] *= (1.0 + e * e * p * per_nu).min(most);
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
fn narrow<const M: usize>(theta: &[Wide; MOST_PARAMETERS]) -> [Lane; M] {
    let mut narrowed = [[0.0; LANES]; M];
    for i in 0..M {
        for l in 0..LANES {
            narrowed[i][l] = theta[i][l] as f32;
        }
    }
    narrowed
}

/// Derivatives of one sample's residual by the nuisance parameters, bias first where there is one.
#[inline(always)]
pub(super) fn derivatives<const M: usize>(
    setup: &Setup<'_>,
    row: &SampleLanes,
    k: usize,
    with_bias: usize,
    h: &mut [Lane; M],
) {
    if with_bias == 1 {
        h[0] = [1.0; LANES];
    }
    for (h, shape) in h.iter_mut().skip(with_bias).zip(setup.shapes) {
        derivative(setup.per_unit, shape, row, k, h);
    }
}

/// Derivative of one sample's residual by one parameter.
#[inline(always)]
pub(super) fn derivative(per_unit: f32, shape: &Shape, row: &SampleLanes, k: usize, h: &mut Lane) {
    match shape {
        Shape::Moved(by) => {
            let [east, north] = by[k];
            for l in 0..LANES {
                h[l] = row.gradient[0][l] * east + row.gradient[1][l] * north;
            }
        }
        Shape::Added(by) => *h = [by[k] * per_unit; LANES],
        Shape::Lifted => *h = row.lift,
    }
}

/// The log of the Student-t product with all nuisance parameters integrated out; `theta` becomes their most likely values
/// (bias first, where there is one; the others in standard deviations), sought from those given.
#[inline(always)]
pub(super) fn nuisances<const BOUND: bool, const M: usize>(
    setup: &Setup<'_>,
    scratch: &KernelScratch,
    tails: Tails,
    turns: &[f32],
    theta: &mut [Wide; MOST_PARAMETERS],
) -> Wide {
    let n = scratch.rows.len();
    let with_bias = usize::from(setup.bias_sigma.is_some());
    let size = (with_bias + setup.shapes.len()).min(M);
    // Standard deviations are the unit of all but the bias.
    let mut prior = [1.0_f64; M];
    if let Some(s) = setup.bias_sigma {
        prior[0] = if s.is_finite() { 1.0 / (s * s) } else { 0.0 };
    }
    let mut h = [[0.0_f32; LANES]; M];
    let mut matrix = [[[0.0_f64; LANES]; M]; M];
    let mut right = [[0.0_f64; LANES]; M];
    for (turn, wide) in turns.iter().copied().chain([0.0]).enumerate() {
        let expected = turn == turns.len();
        let last = turn + 2 >= turns.len();
        let (nu, cut) = tails.turn(last);
        let at: [Lane; M] = narrow(theta);
        let mut sums = [[[0.0_f32; LANES]; M]; M];
        let mut pulls = [[0.0_f32; LANES]; M];
        for (k, row) in scratch.rows.iter().enumerate() {
            derivatives(setup, row, k, with_bias, &mut h);
            let (mut weight, mut pull) = ([0.0_f32; LANES], [0.0_f32; LANES]);
            for l in 0..LANES {
                let mut e = row.error[l];
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
                    let z2 = e * e * p;
                    let w = if z2 > cut { 0.0 } else { (nu + 1.0) * p * wide / (nu * wide + z2) };
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
    let Tails { nu, most, .. } = tails;
    let at: [Lane; M] = narrow(theta);
    let mut product = [1.0_f32; LANES];
    let mut log = [0.0_f64; LANES];
    for (k, row) in scratch.rows.iter().enumerate() {
        derivatives(setup, row, k, with_bias, &mut h);
        for l in 0..LANES {
            let mut e = row.error[l];
            for i in 0..size {
                e -= h[i][l] * at[i][l];
            }
            let e = beyond::<BOUND>(e, row.reach[l]);
            product[l] *= (1.0 + e * e * row.precision[l] / nu).min(most);
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
pub(super) fn factorise<const M: usize>(a: &mut [[Wide; M]; M], size: usize) {
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
fn solve<const M: usize>(a: &[[Wide; M]; M], x: &mut [Wide; M], size: usize) {
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
