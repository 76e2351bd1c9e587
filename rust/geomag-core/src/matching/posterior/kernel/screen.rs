//! What one effect more would gain on a block of candidates: to first order where it leaves the map as it is, in full for other maps.
//!
//! With the weights w of the reweighting at the parameters that the model as told found, the loss of a sample is never above the
//! parabola that touches it there (Lange, Hunter and Yang, J. Comp. Graph. Stat. 9 (2000) 1). One step on the parabolas therefore gains
//! at most what there is: with residuals e, and derivatives h by the parameters told and those of the effect,
//! g = sum w e h and A = sum w h h' + prior, it is half the part of g' A^-1 g that the effect adds, less half the logarithm of what
//! it adds to the determinant of A (Laplace's method). The map is read once for all effects, and its place among the nodes once for all maps.

use super::super::noise::ErrorLevel;
use super::super::nuisance::Shape;
use super::super::patch::{Cells, Spots};
use super::fill::fill;
use super::integral::{PRODUCT, Tails, derivative, derivatives, factorise, logarithm, nuisances, one_bias, weigh};
use super::setup::{
    FEW_PARAMETERS, KernelScratch, LANES, Lane, MOST_PARAMETERS, SOME_PARAMETERS, Setup, WIDENING, Wide,
};

/// Log-likelihoods of a block of candidates.
#[derive(Debug, Clone)]
pub(in super::super) struct Screened {
    /// Of the model as told,
    pub told: Wide,
    /// of it with each of the effects, to first order,
    pub effects: Vec<Wide>,
    /// and of it on each of the other maps.
    pub maps: Vec<Wide>,
}

/// Screens the candidates `offsets` (at most [`LANES`]; cells of the map) under one level: `effects` by what they do to the samples per
/// standard deviation, `maps` by their values at the nodes of the patch.
pub(in super::super) fn screen(
    setup: &Setup<'_>,
    effects: &[&[Shape]],
    maps: &[&[f32]],
    offsets: &[[f64; 2]],
    level: usize,
    scratch: &mut KernelScratch,
) -> Screened {
    crate::instructions::chosen().dispatch(Screen { setup, effects, maps, offsets, level, scratch })
}

struct Screen<'a, 'b> {
    setup: &'a Setup<'b>,
    effects: &'a [&'a [Shape]],
    maps: &'a [&'a [f32]],
    offsets: &'a [[f64; 2]],
    level: usize,
    scratch: &'a mut KernelScratch,
}

impl pulp::WithSimd for Screen<'_, '_> {
    type Output = Screened;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Screened {
        let Self { setup, effects, maps, offsets, level, scratch } = self;
        let level = setup.levels[level];
        fill::<false>(setup, offsets, &[level], scratch);
        let mut theta = [[0.0; LANES]; MOST_PARAMETERS];
        let told = seek(setup, scratch, level, &WIDENING, &mut theta);
        let gains = if effects.is_empty() { Vec::new() } else { gains(setup, effects, scratch, level, &theta) };
        let whole = whole(setup, scratch);
        let scaled = |log: &Wide| std::array::from_fn(|l| log[l] * whole[l]);
        let with = |gain: &Wide| std::array::from_fn(|l| (told[l] + gain[l]) * whole[l]);
        let (told, effects) = (scaled(&told), gains.iter().map(with).collect());
        // Loops, not closures, where the work is done: a closure of its own would not be compiled for the instruction set.
        let mut of_maps = Vec::with_capacity(maps.len());
        if !maps.is_empty() {
            let cells = Cells::new(offsets);
            let mut spots = Vec::with_capacity(setup.places.len());
            for place in setup.places {
                spots.push(setup.patch.locate(*place, &cells));
            }
            for map in maps {
                read_again(setup, map, &cells, &spots, scratch);
                // Sought from where they were on the map as it is.
                let mut theta = theta;
                let log = seek(setup, scratch, level, &WIDENING[1..3], &mut theta);
                let whole = self::whole(setup, scratch);
                of_maps.push(std::array::from_fn(|l| log[l] * whole[l]));
            }
        }
        Screened { told, effects, maps: of_maps }
    }
}

/// The samples of the track over those that lie on the map: a candidate is judged by the samples that it has, as if there were all. NaN
/// where these are too few.
#[inline(always)]
fn whole(setup: &Setup<'_>, scratch: &KernelScratch) -> Wide {
    let n = setup.places.len() as f64;
    let needed = (setup.min_overlap * n).max(1.0);
    let mut count = [0.0_f32; LANES];
    for row in &scratch.rows {
        for l in 0..LANES {
            count[l] += row.known[l];
        }
    }
    count.map(|c| if f64::from(c) >= needed { n / f64::from(c) } else { f64::NAN })
}

/// The log-likelihood with the parameters told integrated out; `theta` becomes their most likely values, sought from those given.
#[inline(always)]
fn seek(
    setup: &Setup<'_>,
    scratch: &mut KernelScratch,
    level: ErrorLevel,
    turns: &[f32],
    theta: &mut [Wide; MOST_PARAMETERS],
) -> Wide {
    let tails = Tails::of(&level);
    let mut lane = weigh::<false>(scratch, &level);
    if setup.shapes.is_empty() {
        let mut bias = theta[0].map(|b| b as f32);
        one_bias::<false>(setup, scratch, tails, turns, &mut bias, &mut lane);
        theta[0] = bias.map(f64::from);
        return lane;
    }
    let log = match setup.shapes.len() + usize::from(setup.bias_sigma.is_some()) {
        n if n <= FEW_PARAMETERS => nuisances::<false, FEW_PARAMETERS>(setup, scratch, tails, turns, theta),
        n if n <= SOME_PARAMETERS => nuisances::<false, SOME_PARAMETERS>(setup, scratch, tails, turns, theta),
        _ => nuisances::<false, MOST_PARAMETERS>(setup, scratch, tails, turns, theta),
    };
    for l in 0..LANES {
        lane[l] += log[l];
    }
    lane
}

/// The rows with the values of another map on the same nodes.
#[inline(always)]
fn read_again(setup: &Setup<'_>, map: &[f32], cells: &Cells, spots: &[Spots], scratch: &mut KernelScratch) {
    let unit = setup.per_unit;
    let [per_east, per_north] = setup.cell_m.map(|m| unit / m);
    let ([blur_x, blur_y], sensor_variance) = (setup.blur_m2, setup.sensor_variance);
    for ((row, spots), measured) in scratch.rows.iter_mut().zip(spots).zip(setup.values) {
        let mut spots = *spots;
        let corners = setup.patch.read_plane(map, cells, &mut spots);
        let value = corners.mixed(&spots);
        let [a, b, e, f] = corners.0;
        let (u, v) = (spots.u, spots.v);
        for l in 0..LANES {
            let residual = (measured - value[l]) * unit;
            let on = residual.is_finite() & (row.known[l] > 0.0);
            let (low, high) = (b[l] - a[l], f[l] - e[l]);
            let (left, right) = (e[l] - a[l], f[l] - b[l]);
            let gx = (low + v[l] * (high - low)) * per_east;
            let gy = (left + u[l] * (right - left)) * per_north;
            row.known[l] = if on { 1.0 } else { 0.0 };
            row.residual[l] = if on { residual } else { 0.0 };
            row.extra_variance[l] = if on { sensor_variance + gx * gx * blur_x + gy * gy * blur_y } else { 1.0 };
            row.map_variance[l] = if on { row.map_variance[l] } else { 0.0 };
            row.between[l] = if on { row.between[l] } else { 0.0 };
            row.gradient[0][l] = if on { gx } else { 0.0 };
            row.gradient[1][l] = if on { gy } else { 0.0 };
        }
    }
}

/// Sums over the samples for the parameters told, or for those of one effect: by every parameter the pull g, and the row of A up to
/// the diagonal, in which the parameters told come first.
struct ScreenSums {
    pulls: Vec<Lane>,
    rows: Vec<Lane>,
}

impl ScreenSums {
    fn new(before: usize, size: usize) -> Self {
        Self { pulls: vec![[0.0; LANES]; size], rows: vec![[0.0; LANES]; size * before + size * (size + 1) / 2] }
    }

    /// Adds a sample; the derivatives by the parameters of these sums are the last `h`.
    #[inline(always)]
    fn add(&mut self, before: usize, h: &[Lane], weight: &Lane, pull: &Lane) {
        let mut rows = self.rows.iter_mut();
        for (i, sum) in self.pulls.iter_mut().enumerate() {
            let own = &h[before + i];
            let mut weighed = [0.0; LANES];
            for l in 0..LANES {
                sum[l] += pull[l] * own[l];
                weighed[l] = weight[l] * own[l];
            }
            for (sum, other) in rows.by_ref().take(before + i + 1).zip(h) {
                for l in 0..LANES {
                    sum[l] += weighed[l] * other[l];
                }
            }
        }
    }
}

/// Sums over the samples with the weights of a reweighting at the parameters `at`, wider than the error model by a factor of the variance: for the
/// parameters told, and for every effect.
#[inline(always)]
fn accumulate(
    setup: &Setup<'_>,
    effects: &[&[Shape]],
    scratch: &KernelScratch,
    tails: Tails,
    at: &[Lane; MOST_PARAMETERS],
    wide: f32,
) -> (ScreenSums, Vec<ScreenSums>) {
    let with_bias = usize::from(setup.bias_sigma.is_some());
    let known = (with_bias + setup.shapes.len()).min(MOST_PARAMETERS);
    let (nu, cut) = tails.turn(wide == 1.0);
    let mut of_told = ScreenSums::new(0, known);
    let mut of_effects: Vec<ScreenSums> = effects.iter().map(|e| ScreenSums::new(known, e.len())).collect();
    let mut h = [[0.0_f32; LANES]; MOST_PARAMETERS];
    for (k, row) in scratch.rows.iter().enumerate() {
        derivatives(setup, row, k, with_bias, &mut h);
        let (mut weight, mut pull) = ([0.0_f32; LANES], [0.0_f32; LANES]);
        for l in 0..LANES {
            let mut e = row.error[l];
            for i in 0..known {
                e -= h[i][l] * at[i][l];
            }
            let p = row.precision[l];
            let z2 = e * e * p;
            weight[l] = if z2 > cut { 0.0 } else { (nu + 1.0) * wide * p / (nu * wide + z2) };
            pull[l] = weight[l] * e;
        }
        of_told.add(0, &h, &weight, &pull);
        for (sums, effect) in of_effects.iter_mut().zip(effects) {
            for (h, shape) in h[known..].iter_mut().zip(*effect) {
                derivative(setup.per_unit, shape, row, k, h);
            }
            sums.add(known, &h, &weight, &pull);
        }
    }
    (of_told, of_effects)
}

/// What every effect gains at least: by the parabolas at the parameters told, or where a step under a much wider loss leads, which is
/// not stopped by the samples that the effect has made outliers.
#[inline(always)]
fn gains(
    setup: &Setup<'_>,
    effects: &[&[Shape]],
    scratch: &KernelScratch,
    level: ErrorLevel,
    theta: &[Wide; MOST_PARAMETERS],
) -> Vec<Wide> {
    let tails = Tails::of(&level);
    let mut at = [[0.0_f32; LANES]; MOST_PARAMETERS];
    for (at, theta) in at.iter_mut().zip(theta) {
        *at = theta.map(|t| t as f32);
    }
    let mut prior = [1.0; MOST_PARAMETERS];
    if let Some(s) = setup.bias_sigma {
        prior[0] = if s.is_finite() { 1.0 / (s * s) } else { 0.0 };
    }
    let (told, near) = accumulate(setup, effects, scratch, tails, &at, 1.0);
    let (told_far, far) = accumulate(setup, effects, scratch, tails, &at, WIDENING[0]);
    let known = told.pulls.len();
    let before = loss(setup, &[], scratch, tails, &at, known, &prior);
    let mut out = Vec::with_capacity(effects.len());
    for (effect, (near, far)) in effects.iter().zip(near.iter().zip(&far)) {
        let (near, _) = step(&told, near, &prior, theta);
        let (_, Solved { change, determinant }) = step(&told_far, far, &prior, theta);
        let mut there = at;
        for (there, change) in there.iter_mut().zip(&change) {
            for l in 0..LANES {
                there[l] += change[l];
            }
        }
        let after = loss(setup, effect, scratch, tails, &there, known, &prior);
        out.push(std::array::from_fn(|l| near[l].max(before[l] - after[l] - determinant[l])));
    }
    out
}

/// Minus the log-likelihood at these parameters, without what does not depend on them.
#[inline(always)]
fn loss(
    setup: &Setup<'_>,
    effect: &[Shape],
    scratch: &KernelScratch,
    tails: Tails,
    at: &[Lane; MOST_PARAMETERS],
    known: usize,
    prior: &[f64; MOST_PARAMETERS],
) -> Wide {
    let with_bias = usize::from(setup.bias_sigma.is_some());
    let size = (known + effect.len()).min(MOST_PARAMETERS);
    let n = scratch.rows.len();
    let Tails { nu, most, .. } = tails;
    let mut h = [[0.0_f32; LANES]; MOST_PARAMETERS];
    let mut product = [1.0_f32; LANES];
    let mut total = [0.0_f64; LANES];
    for (k, row) in scratch.rows.iter().enumerate() {
        derivatives(setup, row, k, with_bias, &mut h);
        for (h, shape) in h[known..].iter_mut().zip(effect) {
            derivative(setup.per_unit, shape, row, k, h);
        }
        for l in 0..LANES {
            let mut e = row.error[l];
            for i in 0..size {
                e -= h[i][l] * at[i][l];
            }
            product[l] *= (1.0 + e * e * row.precision[l] / nu).min(most);
        }
        if k % PRODUCT == PRODUCT - 1 || k + 1 == n {
            for l in 0..LANES {
                total[l] += 0.5 * f64::from(nu + 1.0) * f64::from(logarithm(product[l]));
                product[l] = 1.0;
            }
        }
    }
    for i in 0..size {
        for l in 0..LANES {
            total[l] += 0.5 * prior[i] * f64::from(at[i][l] * at[i][l]);
        }
    }
    total
}

/// A step on the parabolas of some weights.
struct Solved {
    /// Of every parameter,
    change: [Lane; MOST_PARAMETERS],
    /// and half the logarithm of what the effect adds to the determinant.
    determinant: Wide,
}

/// The step with one effect, by the sums for the parameters told and for its own; and what the effect gains by it.
#[inline(always)]
fn step(
    told: &ScreenSums,
    effect: &ScreenSums,
    prior: &[f64; MOST_PARAMETERS],
    theta: &[Wide; MOST_PARAMETERS],
) -> (Wide, Solved) {
    match told.pulls.len() + effect.pulls.len() {
        n if n <= FEW_PARAMETERS => step_of::<FEW_PARAMETERS>(told, effect, prior, theta),
        n if n <= SOME_PARAMETERS => step_of::<SOME_PARAMETERS>(told, effect, prior, theta),
        _ => step_of::<MOST_PARAMETERS>(told, effect, prior, theta),
    }
}

#[inline(always)]
fn step_of<const M: usize>(
    told: &ScreenSums,
    effect: &ScreenSums,
    prior: &[f64; MOST_PARAMETERS],
    theta: &[Wide; MOST_PARAMETERS],
) -> (Wide, Solved) {
    let known = told.pulls.len();
    let size = (known + effect.pulls.len()).min(M);
    let mut matrix = [[[0.0_f64; LANES]; M]; M];
    let mut right = [[0.0_f64; LANES]; M];
    let mut sums = told.rows.iter().chain(&effect.rows);
    for i in 0..size {
        for (entry, sum) in matrix[i].iter_mut().zip(sums.by_ref().take(i + 1)) {
            *entry = sum.map(f64::from);
        }
        let pull = if i < known { &told.pulls[i] } else { &effect.pulls[i - known] };
        for l in 0..LANES {
            matrix[i][i][l] += prior[i];
            right[i][l] = f64::from(pull[l]) - if i < known { prior[i] * theta[i][l] } else { 0.0 };
        }
    }
    factorise(&mut matrix, size);
    let (mut gained, mut determinant) = ([0.0; LANES], [0.0; LANES]);
    for i in 0..size {
        for l in 0..LANES {
            for k in 0..i {
                right[i][l] -= matrix[i][k][l] * right[k][l];
            }
            right[i][l] /= matrix[i][i][l];
            if i >= known {
                determinant[l] += f64::from(logarithm(matrix[i][i][l] as f32));
                gained[l] += 0.5 * right[i][l] * right[i][l];
            }
        }
    }
    let mut change = [[0.0; LANES]; MOST_PARAMETERS];
    for i in (0..size).rev() {
        for l in 0..LANES {
            for k in i + 1..size {
                right[i][l] -= matrix[k][i][l] * right[k][l];
            }
            right[i][l] /= matrix[i][i][l];
            change[i][l] = right[i][l] as f32;
        }
    }
    for l in 0..LANES {
        gained[l] -= determinant[l];
    }
    (gained, Solved { change, determinant })
}
