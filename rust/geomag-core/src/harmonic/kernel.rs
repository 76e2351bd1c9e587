//! The hot loop: potential, field and gradient of the expansion, a vector of points at a time.
//!
//! One point a lane goes through every term, so that results do not depend on which points share a vector or on the
//! number of threads. Vectors are as wide as the processor's, found at run time; the width does not change a lane's
//! arithmetic, only the lack of a fused multiply-add does.

// Only what is inlined into the dispatched function is compiled for its instruction set.
#![allow(clippy::inline_always)]

use std::f64::consts::{FRAC_2_PI, LOG2_E};

use pulp::Simd;

use super::basis::terms;

/// Points that a block of many has.
pub(super) const BLOCK: usize = 256;
/// Adding this to a double leaves the nearest integer in the low bits of its mantissa.
const MAGIC: f64 = 6_755_399_441_055_744.0;
/// Angles beyond this go through the standard library.
const LARGE_ANGLE: f64 = 1e5;

/// The four coefficients of a pair (t, r), side by side for the loop; zero where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(align(64))]
struct Pair {
    u: f64,
    d: f64,
    e: f64,
    f: f64,
    g: f64,
}

/// Coefficients in the order of the loop: t outside, r inside, from (0, 0).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Packed {
    pub(super) order: usize,
    pub(super) wave: [f64; 2],
    pub(super) linear: [f64; 3],
    pairs: Vec<Pair>,
}

impl Packed {
    /// From coefficients in stored order; the caller has checked their number.
    pub(super) fn new(order: usize, wave: [f64; 2], coefficients: &[f64]) -> Self {
        let mut pairs = Vec::with_capacity((order + 1) * (order + 2) / 2);
        for t in 0..=order {
            for r in 0..=order - t {
                pairs.push(Pair { u: (t as f64 * wave[0]).hypot(r as f64 * wave[1]), ..Pair::default() });
            }
        }
        let mut packed = Self { order, wave, linear: [coefficients[0], coefficients[1], coefficients[2]], pairs };
        for (term, &c) in terms(order).zip(&coefficients[3..]) {
            let pair = &mut packed.pairs[pair_index(order, term.t, term.r)];
            match (term.sine_x, term.sine_y) {
                (false, false) => pair.d = c,
                (false, true) => pair.e = c,
                (true, false) => pair.f = c,
                (true, true) => pair.g = c,
            }
        }
        packed
    }

    /// The same field seen from a level: evaluated at zero it gives what this gives there.
    pub(super) fn seen_from(&self, down_m: f64) -> Self {
        let mut out = self.clone();
        for p in &mut out.pairs {
            let level = (p.u * down_m).exp();
            *p = Pair { u: p.u, d: p.d * level, e: p.e * level, f: p.f * level, g: p.g * level };
        }
        out
    }

    /// Wave number and coefficients `[u, D, E, F, G]` of a pair.
    pub(super) fn pair(&self, t: usize, r: usize) -> [f64; 5] {
        let p = &self.pairs[pair_index(self.order, t, r)];
        [p.u, p.d, p.e, p.f, p.g]
    }
}

/// Pairs before row `t` are `(N + 1) + N + ...`.
fn pair_index(order: usize, t: usize, r: usize) -> usize {
    t * (2 * order + 3 - t) / 2 + r
}

/// What comes out for a block of points: potential; field; xx, xy, xz, yy, yz, zz of the gradient tensor of the field.
pub(super) type Output<const B: usize> = [[f64; B]; 10];

/// Evaluates up to `B` points with the widest vectors of this processor. Without `GRADIENT` the last six rows of
/// the output are left as they are.
pub(super) struct Run<'a, const GRADIENT: bool, const B: usize> {
    pub(super) packed: &'a Packed,
    pub(super) points: [&'a [f64]; 3],
    pub(super) out: &'a mut Output<B>,
    /// Room for `2 (N + 1)` vectors.
    pub(super) scratch: &'a mut Vec<f64>,
}

impl<const GRADIENT: bool, const B: usize> pulp::WithSimd for Run<'_, GRADIENT, B> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let width = S::F64_LANES;
        self.scratch.resize(2 * (self.packed.order + 1) * width, 0.0);
        let count = self.points[0].len();
        for first in (0..count).step_by(width) {
            let end = (first + width).min(count);
            let points = self.points.map(|axis| simd.partial_load_f64s(&axis[first..end]));
            let angles = [
                largest(&self.points[0][first..end]) * self.packed.wave[0],
                largest(&self.points[1][first..end]) * self.packed.wave[1],
            ];
            // On the level of the frame itself every exponential is one.
            let values = if self.points[2][first..end].iter().all(|&z| z == 0.0) {
                vector::<S, GRADIENT, true>(simd, self.packed, points, angles, self.scratch)
            } else {
                vector::<S, GRADIENT, false>(simd, self.packed, points, angles, self.scratch)
            };
            let rows = if GRADIENT { 10 } else { 4 };
            for (row, value) in self.out.iter_mut().zip(values).take(rows) {
                simd.partial_store_f64s(&mut row[first..end], value);
            }
        }
    }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// One vector of points. `scratch` holds the cosines and sines along y.
#[inline(always)]
fn vector<S: Simd, const GRADIENT: bool, const FLAT: bool>(
    simd: S,
    packed: &Packed,
    points: [S::f64s; 3],
    largest_angles: [f64; 2],
    scratch: &mut [f64],
) -> [S::f64s; 10] {
    let order = packed.order;
    let [v, w] = packed.wave;
    let zero = simd.splat_f64s(0.0);
    let mul = |a, b| simd.mul_f64s(a, b);
    let madd = |a, b, c| simd.mul_add_e_f64s(a, b, c);
    let (sin_x1, cos_x1) = sin_cos(simd, mul(simd.splat_f64s(v), points[0]), largest_angles[0]);
    let (sin_y1, cos_y1) = sin_cos(simd, mul(simd.splat_f64s(w), points[1]), largest_angles[1]);
    let (tables, _) = S::as_mut_simd_f64s(scratch);
    let (mut cos_y, mut sin_y) = (simd.splat_f64s(1.0), zero);
    for entry in tables.chunks_exact_mut(2) {
        entry[0] = cos_y;
        entry[1] = sin_y;
        let next = madd(cos_y, cos_y1, simd.neg_f64s(mul(sin_y, sin_y1)));
        sin_y = madd(sin_y, cos_y1, mul(cos_y, sin_y1));
        cos_y = next;
    }
    let mut out = [zero; 10];
    let mut pairs = packed.pairs.as_slice();
    let (mut cos_x, mut sin_x) = (simd.splat_f64s(1.0), zero);
    for t in 0..=order {
        // Sums over r of the factors of cos(tvx) and sin(tvx): of P, u P, dP/dy, u^2 P, u dP/dy.
        let (mut a, mut b) = (zero, zero);
        let (mut a_u, mut b_u) = (zero, zero);
        let (mut a_y, mut b_y) = (zero, zero);
        let (mut a_uu, mut b_uu) = (zero, zero);
        let (mut a_uy, mut b_uy) = (zero, zero);
        let (row, rest) = pairs.split_at(order - t + 1);
        pairs = rest;
        let mut rw = 0.0;
        for (pair, table) in row.iter().zip(tables.chunks_exact(2)) {
            let [u, d, e, f, g] = [pair.u, pair.d, pair.e, pair.f, pair.g].map(|c| simd.splat_f64s(c));
            let [mut c, mut s] = [table[0], table[1]];
            if !FLAT {
                let level = exp(simd, mul(u, points[2]));
                (c, s) = (mul(c, level), mul(s, level));
            }
            // The factors of the cosine and of the sine along x.
            let p = madd(e, s, mul(d, c));
            let q = madd(g, s, mul(f, c));
            let along = simd.splat_f64s(rw);
            let p_y = mul(along, simd.mul_add_e_f64s(e, c, simd.neg_f64s(mul(d, s))));
            let q_y = mul(along, simd.mul_add_e_f64s(g, c, simd.neg_f64s(mul(f, s))));
            a = simd.add_f64s(a, p);
            b = simd.add_f64s(b, q);
            if GRADIENT {
                let (p_u, q_u) = (mul(u, p), mul(u, q));
                a_u = simd.add_f64s(a_u, p_u);
                b_u = simd.add_f64s(b_u, q_u);
                a_uu = madd(u, p_u, a_uu);
                b_uu = madd(u, q_u, b_uu);
                a_uy = madd(u, p_y, a_uy);
                b_uy = madd(u, q_y, b_uy);
            } else {
                a_u = madd(u, p, a_u);
                b_u = madd(u, q, b_u);
            }
            a_y = simd.add_f64s(a_y, p_y);
            b_y = simd.add_f64s(b_y, q_y);
            rw += w;
        }
        let tv = simd.splat_f64s(t as f64 * v);
        let even = |a, b| madd(b, sin_x, mul(a, cos_x));
        let odd = |a, b| mul(tv, simd.sub_f64s(mul(a, sin_x), mul(b, cos_x)));
        let potential = even(a, b);
        out[0] = simd.add_f64s(out[0], potential);
        out[1] = simd.add_f64s(out[1], odd(a, b));
        out[2] = simd.sub_f64s(out[2], even(a_y, b_y));
        out[3] = simd.sub_f64s(out[3], even(a_u, b_u));
        if GRADIENT {
            let along_x = mul(mul(tv, tv), potential);
            let along_z = even(a_uu, b_uu);
            out[4] = simd.add_f64s(out[4], along_x);
            out[5] = simd.add_f64s(out[5], odd(a_y, b_y));
            out[6] = simd.add_f64s(out[6], odd(a_u, b_u));
            // Laplace's equation: the trace is zero.
            out[7] = simd.add_f64s(out[7], simd.sub_f64s(along_z, along_x));
            out[8] = simd.sub_f64s(out[8], even(a_uy, b_uy));
            out[9] = simd.sub_f64s(out[9], along_z);
        }
        let next = madd(cos_x, cos_x1, simd.neg_f64s(mul(sin_x, sin_x1)));
        sin_x = madd(sin_x, cos_x1, mul(cos_x, sin_x1));
        cos_x = next;
    }
    for (i, (&linear, point)) in packed.linear.iter().zip(points).enumerate() {
        let linear = simd.splat_f64s(linear);
        out[0] = madd(linear, point, out[0]);
        out[i + 1] = simd.sub_f64s(out[i + 1], linear);
    }
    out
}

/// Exponential, good to three roundings, for arguments up to 700; less than -700 counts as -700.
#[inline(always)]
fn exp<S: Simd>(simd: S, x: S::f64s) -> S::f64s {
    const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    /// One over the factorials of 12 to 0.
    const TAYLOR: [f64; 13] = [
        1.0 / 479_001_600.0,
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ];
    let splat = |c: f64| simd.splat_f64s(c);
    let madd = |a, b, c| simd.mul_add_e_f64s(a, b, c);
    let x = simd.max_f64s(x, splat(-700.0));
    let shifted = madd(x, splat(LOG2_E), splat(MAGIC));
    let n = simd.sub_f64s(shifted, splat(MAGIC));
    let rest = madd(n, splat(-LN_2_LOW), madd(n, splat(-LN_2_HIGH), x));
    let mut sum = splat(TAYLOR[0]);
    for &c in &TAYLOR[1..] {
        sum = madd(sum, rest, splat(c));
    }
    let mut power = [simd.transmute_u64s_f64s(shifted)];
    let bits: &mut [u64] = pulp::bytemuck::cast_slice_mut(&mut power);
    for b in bits {
        *b = b.wrapping_add(1023) << 52;
    }
    simd.mul_f64s(sum, simd.transmute_f64s_u64s(power[0]))
}

/// Sine and cosine, good to two roundings of one.
///
/// Reduced by multiples of a right angle in three parts (Cody and Waite 1980), which is exact for angles below
/// [`LARGE_ANGLE`]; Taylor's series on half a right angle.
#[inline(always)]
fn sin_cos<S: Simd>(simd: S, x: S::f64s, largest: f64) -> (S::f64s, S::f64s) {
    const PARTS: [f64; 3] = [1.570_796_251_296_997, 7.549_789_415_861_596e-8, 5.390_302_858_158_119e-15];
    const SINE: [f64; 8] = [
        -1.0 / 1_307_674_368_000.0,
        1.0 / 6_227_020_800.0,
        -1.0 / 39_916_800.0,
        1.0 / 362_880.0,
        -1.0 / 5_040.0,
        1.0 / 120.0,
        -1.0 / 6.0,
        1.0,
    ];
    const COSINE: [f64; 9] = [
        1.0 / 20_922_789_888_000.0,
        -1.0 / 87_178_291_200.0,
        1.0 / 479_001_600.0,
        -1.0 / 3_628_800.0,
        1.0 / 40_320.0,
        -1.0 / 720.0,
        1.0 / 24.0,
        -0.5,
        1.0,
    ];
    if !(largest < LARGE_ANGLE) {
        let (mut sin, mut cos) = ([x], [x]);
        let sines: &mut [f64] = pulp::bytemuck::cast_slice_mut(&mut sin);
        let cosines: &mut [f64] = pulp::bytemuck::cast_slice_mut(&mut cos);
        for (s, c) in sines.iter_mut().zip(cosines) {
            (*s, *c) = s.sin_cos();
        }
        return (sin[0], cos[0]);
    }
    let splat = |c: f64| simd.splat_f64s(c);
    let madd = |a, b, c| simd.mul_add_e_f64s(a, b, c);
    let magic = splat(MAGIC);
    let quarter = simd.sub_f64s(madd(x, splat(FRAC_2_PI), magic), magic);
    let mut rest = x;
    for part in PARTS {
        rest = madd(quarter, splat(-part), rest);
    }
    let square = simd.mul_f64s(rest, rest);
    let mut sine = splat(SINE[0]);
    for &c in &SINE[1..] {
        sine = madd(sine, square, splat(c));
    }
    sine = simd.mul_f64s(sine, rest);
    let mut cosine = splat(COSINE[0]);
    for &c in &COSINE[1..] {
        cosine = madd(cosine, square, splat(c));
    }
    // Quarter modulo four, in -2 ... 2; adding and taking away 1.5 2^54 rounds to a multiple of four.
    let four = splat(4.0 * MAGIC);
    let quadrant = simd.sub_f64s(quarter, simd.sub_f64s(simd.add_f64s(quarter, four), four));
    let size = simd.abs_f64s(quadrant);
    let one = splat(1.0);
    let turned = simd.equal_f64s(size, one);
    let (mut s, mut c) = (simd.select_f64s(turned, cosine, sine), simd.select_f64s(turned, sine, cosine));
    // Quadrants: 1 (c, -s), -1 (-c, s), +-2 (-s, -c).
    let half = simd.equal_f64s(size, splat(2.0));
    let back = simd.equal_f64s(quadrant, splat(-1.0));
    let forth = simd.equal_f64s(quadrant, one);
    s = simd.select_f64s(simd.or_m64s(half, back), simd.neg_f64s(s), s);
    c = simd.select_f64s(simd.or_m64s(half, forth), simd.neg_f64s(c), c);
    (s, c)
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Apply<'a>(&'a [f64], &'a mut Vec<[f64; 3]>);

    impl pulp::WithSimd for Apply<'_> {
        type Output = ();

        fn with_simd<S: Simd>(self, simd: S) {
            for &x in self.0 {
                let at = simd.splat_f64s(x);
                let (s, c) = sin_cos(simd, at, x.abs());
                self.1.push([exp(simd, at), s, c].map(|v| simd.reduce_max_f64s(v)));
            }
        }
    }

    #[test]
    fn functions_are_good_to_the_last_digits() {
        let arguments: Vec<f64> = (-40_000..=40_000).map(|k| f64::from(k) * 0.0173).collect();
        for scalar in [false, true] {
            let mut out = Vec::new();
            if scalar {
                pulp::WithSimd::with_simd(Apply(&arguments, &mut out), pulp::Scalar);
            } else {
                crate::instructions::chosen().dispatch(Apply(&arguments, &mut out));
            }
            for (&x, [e, s, c]) in arguments.iter().zip(out) {
                let (sin, cos) = x.sin_cos();
                assert!((e - x.exp()).abs() <= 8e-16 * x.exp(), "exp {x}: {e} {}", x.exp());
                // Without a fused multiply-add the reduction of large angles rounds.
                let slack = if scalar { 1e-15 + 2e-16 * x.abs() } else { 4e-16 };
                assert!((s - sin).abs() <= slack && (c - cos).abs() <= slack, "{x}: {s} {sin} {c} {cos}");
            }
        }
    }

    #[test]
    fn pairs_are_found_where_the_loop_goes() {
        let mut k = 0;
        for t in 0..=7 {
            for r in 0..=7 - t {
                assert_eq!(pair_index(7, t, r), k);
                k += 1;
            }
        }
    }
}
