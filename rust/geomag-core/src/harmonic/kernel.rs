//! The hot loop: potential, field and gradient of the expansion for eight points at a time.
//!
//! Eight points go through every term together, one a lane, so that results do not depend on which points share a
//! block, on the number of threads, or on the vector width that the processor has (the dispatch at run time changes
//! the rounding only where there is no fused multiply-add).

use super::basis::terms;

/// Points in a block.
pub(super) const LANES: usize = 8;

/// One number a lane.
pub(super) type Lanes = [f64; LANES];

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

/// What comes out for a block of points.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Block {
    pub(super) potential: Lanes,
    pub(super) field: [Lanes; 3],
    /// xx, xy, xz, yy, yz, zz of the gradient tensor of the field.
    pub(super) gradient: [Lanes; 6],
}

/// Cosines and sines along y of a block: scratch that callers keep between blocks.
#[derive(Debug, Default)]
pub(super) struct Tables {
    y: Vec<[Lanes; 2]>,
}

/// Evaluates blocks of points with the widest vectors of this processor.
pub(super) struct Run<'a, const GRADIENT: bool> {
    pub(super) packed: &'a Packed,
    pub(super) points: [Lanes; 3],
    pub(super) tables: &'a mut Tables,
}

impl<const GRADIENT: bool> pulp::WithSimd for Run<'_, GRADIENT> {
    type Output = Block;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Block {
        // Without the instruction a fused multiply-add is a library call.
        if S::IS_SCALAR {
            block::<GRADIENT, false>(self.packed, self.points, self.tables)
        } else {
            block::<GRADIENT, true>(self.packed, self.points, self.tables)
        }
    }
}

#[inline(always)]
fn lanes(f: impl Fn(usize) -> f64) -> Lanes {
    let mut out = [0.0; LANES];
    for (l, o) in out.iter_mut().enumerate() {
        *o = f(l);
    }
    out
}

/// `a * b + c`
#[inline(always)]
fn madd<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

#[inline(always)]
fn scale_add<const FMA: bool>(a: f64, b: &Lanes, c: &mut Lanes) {
    for l in 0..LANES {
        c[l] = madd::<FMA>(a, b[l], c[l]);
    }
}

/// Exponential, good to three roundings, for arguments up to 700; less than -700 counts as -700.
#[inline(always)]
fn exp<const FMA: bool>(x: Lanes) -> Lanes {
    // Adding this leaves the nearest integer in the low bits of the mantissa.
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
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
    let x = lanes(|l| x[l].max(-700.0));
    let shifted = lanes(|l| madd::<FMA>(x[l], std::f64::consts::LOG2_E, MAGIC));
    let rest = lanes(|l| {
        let n = shifted[l] - MAGIC;
        madd::<FMA>(n, -LN_2_LOW, madd::<FMA>(n, -LN_2_HIGH, x[l]))
    });
    let mut sum = [TAYLOR[0]; LANES];
    for c in &TAYLOR[1..] {
        sum = lanes(|l| madd::<FMA>(sum[l], rest[l], *c));
    }
    lanes(|l| sum[l] * f64::from_bits(shifted[l].to_bits().wrapping_add(1023) << 52))
}

#[inline(always)]
fn block<const GRADIENT: bool, const FMA: bool>(packed: &Packed, points: [Lanes; 3], tables: &mut Tables) -> Block {
    let order = packed.order;
    let [v, w] = packed.wave;
    let (mut sin_x1, mut cos_x1, mut sin_y1, mut cos_y1) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for l in 0..LANES {
        (sin_x1[l], cos_x1[l]) = (v * points[0][l]).sin_cos();
        (sin_y1[l], cos_y1[l]) = (w * points[1][l]).sin_cos();
    }
    tables.y.clear();
    let (mut cos_y, mut sin_y) = ([1.0; LANES], [0.0; LANES]);
    for _ in 0..=order {
        tables.y.push([cos_y, sin_y]);
        let next = lanes(|l| madd::<FMA>(cos_y[l], cos_y1[l], -(sin_y[l] * sin_y1[l])));
        sin_y = lanes(|l| madd::<FMA>(sin_y[l], cos_y1[l], cos_y[l] * sin_y1[l]));
        cos_y = next;
    }
    let mut out = Block::default();
    let mut pairs = packed.pairs.as_slice();
    let (mut cos_x, mut sin_x) = ([1.0; LANES], [0.0; LANES]);
    for t in 0..=order {
        let tv = t as f64 * v;
        // Sums over r of the factors of cos(tvx) and sin(tvx): of P, u P, u^2 P, dP/dy, u dP/dy.
        let (mut a, mut b) = ([0.0; LANES], [0.0; LANES]);
        let (mut a_u, mut b_u) = ([0.0; LANES], [0.0; LANES]);
        let (mut a_y, mut b_y) = ([0.0; LANES], [0.0; LANES]);
        let (mut a_uu, mut b_uu) = ([0.0; LANES], [0.0; LANES]);
        let (mut a_uy, mut b_uy) = ([0.0; LANES], [0.0; LANES]);
        let (row, rest) = pairs.split_at(order - t + 1);
        pairs = rest;
        let mut rw = 0.0;
        for (pair, [cy, sy]) in row.iter().zip(&tables.y) {
            let e = exp::<FMA>(lanes(|l| pair.u * points[2][l]));
            let c = lanes(|l| cy[l] * e[l]);
            let s = lanes(|l| sy[l] * e[l]);
            scale_add::<FMA>(pair.d, &c, &mut a);
            scale_add::<FMA>(pair.e, &s, &mut a);
            scale_add::<FMA>(pair.f, &c, &mut b);
            scale_add::<FMA>(pair.g, &s, &mut b);
            let uc = lanes(|l| pair.u * c[l]);
            let us = lanes(|l| pair.u * s[l]);
            scale_add::<FMA>(pair.d, &uc, &mut a_u);
            scale_add::<FMA>(pair.e, &us, &mut a_u);
            scale_add::<FMA>(pair.f, &uc, &mut b_u);
            scale_add::<FMA>(pair.g, &us, &mut b_u);
            let yc = lanes(|l| rw * c[l]);
            let ys = lanes(|l| -rw * s[l]);
            scale_add::<FMA>(pair.d, &ys, &mut a_y);
            scale_add::<FMA>(pair.e, &yc, &mut a_y);
            scale_add::<FMA>(pair.f, &ys, &mut b_y);
            scale_add::<FMA>(pair.g, &yc, &mut b_y);
            if GRADIENT {
                let (uuc, uus) = (lanes(|l| pair.u * uc[l]), lanes(|l| pair.u * us[l]));
                scale_add::<FMA>(pair.d, &uuc, &mut a_uu);
                scale_add::<FMA>(pair.e, &uus, &mut a_uu);
                scale_add::<FMA>(pair.f, &uuc, &mut b_uu);
                scale_add::<FMA>(pair.g, &uus, &mut b_uu);
                let (uyc, uys) = (lanes(|l| pair.u * yc[l]), lanes(|l| pair.u * ys[l]));
                scale_add::<FMA>(pair.d, &uys, &mut a_uy);
                scale_add::<FMA>(pair.e, &uyc, &mut a_uy);
                scale_add::<FMA>(pair.f, &uys, &mut b_uy);
                scale_add::<FMA>(pair.g, &uyc, &mut b_uy);
            }
            rw += w;
        }
        for l in 0..LANES {
            let (c, s) = (cos_x[l], sin_x[l]);
            out.potential[l] += a[l] * c + b[l] * s;
            out.field[0][l] += tv * (a[l] * s - b[l] * c);
            out.field[1][l] -= a_y[l] * c + b_y[l] * s;
            out.field[2][l] -= a_u[l] * c + b_u[l] * s;
            if GRADIENT {
                let along_x = tv * tv * (a[l] * c + b[l] * s);
                let along_z = a_uu[l] * c + b_uu[l] * s;
                out.gradient[0][l] += along_x;
                out.gradient[1][l] += tv * (a_y[l] * s - b_y[l] * c);
                out.gradient[2][l] += tv * (a_u[l] * s - b_u[l] * c);
                // Laplace's equation: the trace is zero.
                out.gradient[3][l] += along_z - along_x;
                out.gradient[4][l] -= a_uy[l] * c + b_uy[l] * s;
                out.gradient[5][l] -= along_z;
            }
        }
        let next = lanes(|l| madd::<FMA>(cos_x[l], cos_x1[l], -(sin_x[l] * sin_x1[l])));
        sin_x = lanes(|l| madd::<FMA>(sin_x[l], cos_x1[l], cos_x[l] * sin_x1[l]));
        cos_x = next;
    }
    for l in 0..LANES {
        for i in 0..3 {
            out.potential[l] += packed.linear[i] * points[i][l];
            out.field[i][l] -= packed.linear[i];
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_is_good_to_the_last_digits() {
        for k in -4000..=4000 {
            let x = f64::from(k) * 0.173;
            for value in [exp::<true>([x; LANES])[0], exp::<false>([x; LANES])[5]] {
                let expected = x.exp();
                assert!((value - expected).abs() <= 6e-16 * expected, "{x}: {value} {expected}");
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
