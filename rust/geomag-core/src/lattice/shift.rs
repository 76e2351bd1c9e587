//! One sample seen from the lattice: where its offsets lie on the grid, and their shared weights.

// A kernel that is not inlined is not compiled for the instruction set that was chosen.
#![allow(clippy::inline_always)]

use super::simd::{Kernel, Real};
use crate::grid::{GridMap, split_position};

/// Finest lattice, in steps per map cell, that the fast path serves.
const MAX_CLASSES: usize = 16;

/// One sample seen from one class of offsets: where its first offset lies and the constant weights.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shift {
    /// Node column and row below offset (0, 0) of the class; may lie outside the map.
    pub column: i64,
    pub row: i64,
    /// Fractions towards the next node.
    pub tx: f64,
    pub ty: f64,
}

impl Shift {
    /// From the position in cells of the class's first offset.
    pub(crate) fn new(position: [f64; 2]) -> Self {
        let (column, tx) = split_position(position[0]);
        let (row, ty) = split_position(position[1]);
        Self { column, row, tx, ty }
    }

    /// Steps to the next node; none where its weight is zero, so that it is never read.
    pub(crate) fn next(&self) -> [i64; 2] {
        [i64::from(self.tx > 0.0), i64::from(self.ty > 0.0)]
    }
}

/// How a lattice falls on a grid: classes of offsets that share their weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Classes {
    /// Classes a cell `[x, y]`.
    pub per_cell: [usize; 2],
}

impl Classes {
    /// The classes, where the spacing is a whole number of steps.
    pub(crate) fn of(grid: &GridMap, step: [f64; 2]) -> Option<Self> {
        let mut per_cell = [0; 2];
        for (d, spacing) in [grid.x().step(), grid.y().step()].into_iter().enumerate() {
            let ratio = spacing / step[d];
            let whole = ratio.round();
            // The drift over the whole lattice must stay far below a cell, hence the tight tolerance.
            if !(1.0..=MAX_CLASSES as f64).contains(&whole) || (ratio - whole).abs() > 1e-9 * whole {
                return None;
            }
            per_cell[d] = whole as usize;
        }
        Some(Self { per_cell })
    }

    /// Position in cells of offset 0 of class `[x, y]` for a point at `position` (cells), offsets counted from `first`
    /// (in steps, negative of the half size).
    pub(crate) fn shift(&self, position: [f64; 2], first: [i64; 2], class: [usize; 2]) -> Shift {
        let at = |d: usize| {
            let steps = first[d] + class[d] as i64;
            let q = self.per_cell[d] as i64;
            // Whole cells are added as integers, so that no class drifts by rounding.
            position[d] + steps.div_euclid(q) as f64 + steps.rem_euclid(q) as f64 / q as f64
        };
        Shift::new([at(0), at(1)])
    }
}

/// Map values of one sample under one row of one class of offsets, into every `stride`-th place of `out`.
pub(super) struct ShiftedRow<'a, T> {
    pub values: &'a [T],
    pub grid: &'a GridMap,
    pub shift: Shift,
    pub out: &'a mut [f64],
    pub first: usize,
    pub stride: usize,
}

impl<T: Real> Kernel for ShiftedRow<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call<const FUSED: bool>(self) {
        let Self { values, grid, shift, out, first, stride } = self;
        let columns = (out.len() - first).div_ceil(stride);
        let [dx, dy] = shift.next();
        let (map_rows, map_columns) = (grid.y().len() as i64, grid.x().len() as i64);
        let on_map = shift.row >= 0 && shift.row + dy < map_rows;
        let begin = (-shift.column).clamp(0, columns as i64);
        let end = if on_map { (map_columns - dx - shift.column).clamp(begin, columns as i64) } else { begin };
        let (begin, end) = (begin as usize, end as usize);
        for j in (0..begin).chain(end..columns) {
            out[first + j * stride] = f64::NAN;
        }
        if begin == end {
            return;
        }
        let lower = (shift.row * map_columns + shift.column + begin as i64) as usize;
        let upper = lower + (dy * map_columns) as usize;
        let n = end - begin;
        let at = |start: usize| &values[start..start + n];
        let (a, b) = (at(lower), at(lower + dx as usize));
        let (c, d) = (at(upper), at(upper + dx as usize));
        let (tx, ty) = (shift.tx, shift.ty);
        let mix = |p: f64, q: f64, t: f64| if FUSED { q.mul_add(t, p * (1.0 - t)) } else { q * t + p * (1.0 - t) };
        let out = &mut out[first + begin * stride..];
        if stride == 1 {
            for j in 0..n {
                out[j] = mix(mix(a[j].to_f64(), b[j].to_f64(), tx), mix(c[j].to_f64(), d[j].to_f64(), tx), ty);
            }
        } else {
            for j in 0..n {
                out[j * stride] = mix(mix(a[j].to_f64(), b[j].to_f64(), tx), mix(c[j].to_f64(), d[j].to_f64(), tx), ty);
            }
        }
    }
}

/// Bilinear value of row `r`, column `c` of a shifted class; NaN off the map and on holes.
pub(crate) fn value_at(grid: &GridMap, shift: &Shift, r: usize, c: usize) -> f64 {
    let (row, column) = (shift.row + r as i64, shift.column + c as i64);
    let [dx, dy] = shift.next();
    let (rows, columns) = (grid.y().len() as i64, grid.x().len() as i64);
    if row < 0 || column < 0 || row + dy >= rows || column + dx >= columns {
        return f64::NAN;
    }
    let at = |dr: i64, dc: i64| grid.node((row + dr) as usize, (column + dc) as usize);
    let mix = |a: f64, b: f64, t: f64| (1.0 - t) * a + t * b;
    let lower = mix(at(0, 0), at(0, dx), shift.tx);
    if dy == 0 { lower } else { mix(lower, mix(at(1, 0), at(1, dx), shift.tx), shift.ty) }
}
