//! The field on a regular grid at one level: the double sum separates into two small products.

// Only what is inlined into the dispatched function is compiled for its instruction set.
#![allow(clippy::inline_always)]

use rayon::prelude::*;

use super::RectangularHarmonicModel;
use super::basis::harmonics;
use super::kernel::Packed;
use crate::error::{Error, Result, require_finite};

/// Numbers side by side in a tile of the second product.
const TILE: usize = 16;
/// Rows that go through a tile together.
const ROWS: usize = 4;
/// Greatest number of nodes: 6 GB of results.
pub(super) const MAX_NODES: usize = 1 << 28;

impl RectangularHarmonicModel {
    /// Field (north, east, down) at the nodes of a grid at one level: `out[(i * east.len() + j)]` is the field at
    /// `north_m[i]`, `east_m[j]`, `down_m`. NaN outside the region unless `extrapolate`.
    ///
    /// Sums over the harmonics along east once a column, then over those along north once a node: `O(N)` a node where
    /// scattered points take `O(N^2)`.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; [`Error::Invalid`] for more than 2^28 nodes.
    pub fn field_grid(&self, north_m: &[f64], east_m: &[f64], down_m: f64, extrapolate: bool) -> Result<Vec<[f64; 3]>> {
        require_finite("north_m", north_m)?;
        require_finite("east_m", east_m)?;
        require_finite("down_m", &[down_m])?;
        let (rows, columns) = (north_m.len(), east_m.len());
        match rows.checked_mul(columns) {
            Some(nodes) if nodes <= MAX_NODES => {}
            _ => {
                return Err(Error::invalid(
                    "grid",
                    format!("at most {MAX_NODES} nodes"),
                    format!("{rows} x {columns}"),
                ));
            }
        }
        let [v, w] = self.packed.wave;
        if rows == 0 || columns == 0 || down_m * v.hypot(w) * self.order() as f64 > 700.0 {
            return Ok(vec![[f64::NAN; 3]; rows * columns]);
        }
        // Zeroed memory comes untouched from the system: each thread is the first to write its own rows.
        let mut out = vec![[0.0; 3]; rows * columns];
        let inner = 2 * (self.order() + 1);
        let tiles = along_east(&self.packed, east_m, down_m);
        let x = along_north(&self.packed, north_m);
        let width = columns * 3;
        out.as_flattened_mut().par_chunks_mut(width * ROWS * 8).zip(x.par_chunks(inner * ROWS * 8)).for_each(
            |(out, x)| crate::instructions::chosen().dispatch(Product { x, tiles: &tiles, inner, width, out }),
        );
        if !extrapolate {
            self.blank_outside(north_m, east_m, down_m, &mut out);
        }
        Ok(out)
    }

    fn blank_outside(&self, north_m: &[f64], east_m: &[f64], down_m: f64, out: &mut [[f64; 3]]) {
        // The region is a box: a row and a column decide alone.
        let [n, e] = [self.region.north_m[0], self.region.east_m[0]];
        let columns: Vec<bool> = east_m.iter().map(|&y| self.contains([n, y, down_m])).collect();
        let all = columns.iter().all(|&c| c);
        for (row, &x) in out.chunks_exact_mut(east_m.len()).zip(north_m) {
            let inside = self.contains([x, e, down_m]);
            if inside && all {
                continue;
            }
            for (node, column) in row.iter_mut().zip(&columns) {
                if !(inside && *column) {
                    *node = [f64::NAN; 3];
                }
            }
        }
    }
}

/// For every t the factors of cos(tvx) and sin(tvx), of three components at every column; laid out by tiles of [`TILE`]
/// numbers, `[tile][2 t + (cosine, sine)][number]`, number = 3 column + component.
fn along_east(packed: &Packed, east_m: &[f64], down_m: f64) -> Vec<f64> {
    let order = packed.order;
    let inner = 2 * (order + 1);
    let tile_count = (east_m.len() * 3).div_ceil(TILE);
    let mut tiles = vec![0.0; tile_count * inner * TILE];
    let mut levelled = Vec::with_capacity((order + 1) * (order + 2) / 2);
    for t in 0..=order {
        for r in 0..=order - t {
            let [u, d, e, f, g] = packed.pair(t, r);
            let level = (u * down_m).exp();
            levelled.push([u, r as f64 * packed.wave[1], d * level, e * level, f * level, g * level]);
        }
    }
    // As many columns as a tile has numbers fill three tiles.
    tiles.par_chunks_mut(3 * inner * TILE).zip(east_m.par_chunks(TILE)).for_each(|(tiles, east_m)| {
        crate::instructions::chosen().dispatch(Columns { packed, levelled: &levelled, east_m, tiles });
    });
    tiles
}

/// The factors of up to [`TILE`] columns, side by side.
struct Columns<'a> {
    packed: &'a Packed,
    /// Wave numbers u and along y, and the four coefficients at the level, in the order of the loop.
    levelled: &'a [[f64; 6]],
    east_m: &'a [f64],
    tiles: &'a mut [f64],
}

impl pulp::WithSimd for Columns<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        let order = self.packed.order;
        let [v, w] = self.packed.wave;
        let inner = 2 * (order + 1);
        let (mut cosines, mut sines) = (vec![[0.0; TILE]; order + 1], vec![[0.0; TILE]; order + 1]);
        let (mut s1, mut c1) = ([0.0; TILE], [1.0; TILE]);
        for (l, &y) in self.east_m.iter().enumerate() {
            (s1[l], c1[l]) = (w * y).sin_cos();
        }
        let (mut c, mut s) = ([1.0; TILE], [0.0; TILE]);
        for (cosine, sine) in cosines.iter_mut().zip(&mut sines) {
            (*cosine, *sine) = (c, s);
            for l in 0..TILE {
                (c[l], s[l]) = (c[l] * c1[l] - s[l] * s1[l], s[l] * c1[l] + c[l] * s1[l]);
            }
        }
        let mut rest = self.levelled;
        for t in 0..=order {
            let (row, after) = rest.split_at(order - t + 1);
            rest = after;
            // Sums of P, u P and dP/dy over r: factors of the cosine and of the sine along x.
            let [mut p, mut q, mut up, mut uq, mut py, mut qy] = [[0.0; TILE]; 6];
            for ([u, rw, d, e, f, g], (c, s)) in row.iter().zip(cosines.iter().zip(&sines)) {
                for l in 0..TILE {
                    let (a, b) = (d * c[l] + e * s[l], f * c[l] + g * s[l]);
                    p[l] += a;
                    q[l] += b;
                    up[l] += u * a;
                    uq[l] += u * b;
                    py[l] += rw * (e * c[l] - d * s[l]);
                    qy[l] += rw * (g * c[l] - f * s[l]);
                }
            }
            let tv = t as f64 * v;
            let constant = if t == 0 { self.packed.linear } else { [0.0; 3] };
            for l in 0..self.east_m.len() {
                let even = [-tv * q[l] - constant[0], -py[l] - constant[1], -up[l] - constant[2]];
                let odd = [tv * p[l], -qy[l], -uq[l]];
                for (k, factors) in [even, odd].iter().enumerate() {
                    for (component, factor) in factors.iter().enumerate() {
                        let number = 3 * l + component;
                        self.tiles[((number / TILE) * inner + 2 * t + k) * TILE + number % TILE] = *factor;
                    }
                }
            }
        }
    }
}

/// Cosines and sines along north, `[row][2 t + (cosine, sine)]`.
fn along_north(packed: &Packed, north_m: &[f64]) -> Vec<f64> {
    let (mut cosines, mut sines) = (Vec::new(), Vec::new());
    let mut out = Vec::with_capacity(north_m.len() * 2 * (packed.order + 1));
    for &x in north_m {
        harmonics(packed.wave[0] * x, packed.order, &mut cosines, &mut sines);
        out.extend(cosines.iter().zip(&sines).flat_map(|(c, s)| [*c, *s]));
    }
    out
}

/// `out = x * tiles` for some rows.
struct Product<'a> {
    x: &'a [f64],
    tiles: &'a [f64],
    inner: usize,
    width: usize,
    out: &'a mut [f64],
}

impl pulp::WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        if S::IS_SCALAR { self.run::<false>() } else { self.run::<true>() }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let rows = self.x.len() / self.inner;
        for (t, tile) in self.tiles.chunks_exact(self.inner * TILE).enumerate() {
            let first = t * TILE;
            let count = TILE.min(self.width - first);
            let mut put = |row: usize, sums: &[[f64; TILE]]| {
                for (k, sum) in sums.iter().enumerate() {
                    let start = (row + k) * self.width + first;
                    self.out[start..start + count].copy_from_slice(&sum[..count]);
                }
            };
            let x = |row: usize| &self.x[row * self.inner..(row + 1) * self.inner];
            let whole = rows - rows % ROWS;
            for row in (0..whole).step_by(ROWS) {
                put(row, &multiply::<FMA, ROWS>([x(row), x(row + 1), x(row + 2), x(row + 3)], tile));
            }
            for row in whole..rows {
                put(row, &multiply::<FMA, 1>([x(row)], tile));
            }
        }
    }
}

#[inline(always)]
fn multiply<const FMA: bool, const R: usize>(x: [&[f64]; R], tile: &[f64]) -> [[f64; TILE]; R] {
    let mut sums = [[0.0_f64; TILE]; R];
    for (i, numbers) in tile.as_chunks::<TILE>().0.iter().enumerate() {
        for k in 0..R {
            let factor = x[k][i];
            for l in 0..TILE {
                sums[k][l] =
                    if FMA { factor.mul_add(numbers[l], sums[k][l]) } else { factor * numbers[l] + sums[k][l] };
            }
        }
    }
    sums
}
