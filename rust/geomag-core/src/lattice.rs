//! The offset lattice, and the one set of hot kernels that sample a map along a shifted track.
//!
//! Offsets that are whole multiples of the map spacing share the interpolation weights of a sample: the four bilinear
//! weights are constants and a row of offsets is a contiguous, vectorisable sum. A lattice step of spacing / q falls
//! into q x q such classes. Everything else (other steps, bicubic sampling, fields that are no grid) goes point by point.
//!
//! Arithmetic and load limit of the fast path, per (offset, sample), for the squared difference: the horizontal
//! interpolation of one node row serves the offset rows above and below it, so that 1 multiplication and 4 fused
//! multiply-adds, 3 loads and 1 store are left. On a core with two vector units and two loads a cycle that is 2.5 cycles
//! a vector: 0.63 cycles in float64 and 0.31 in float32 with AVX2, half of that with AVX-512.

// A kernel that is not inlined is not compiled for the instruction set that was chosen.
#![allow(clippy::inline_always)]

use std::ops::{Add, Mul, Range, Sub};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_not_negative, require_positive};
use crate::field::Field;
use crate::frame::displacement_m;
use crate::grid::{GridMap, GridValues, Interpolation, split_position};
use crate::monitor::Monitor;
use crate::track::Track;

/// Limit on the number of candidates where the caller sets none: 2^28, 2 GiB of scores.
pub const DEFAULT_MAX_CANDIDATES: u64 = 1 << 28;
/// Finest lattice, in steps per map cell, that the fast path serves.
const MAX_CLASSES: usize = 16;
/// Offset-samples below which waking other threads costs more than it saves.
const SERIAL: usize = 1 << 16;
/// Rows and columns of a tile: its sums and its part of the map stay in the first-level cache.
const TILE_ROWS: usize = 8;
const TILE_COLUMNS: usize = 256;

/// The regular set of candidate offsets: `2 half + 1` a side, centred on no offset.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OffsetLattice {
    half: [usize; 2],
    step: [f64; 2],
}

impl OffsetLattice {
    /// The lattice that covers `half_width` (map units, >= 0) in steps of `step` (> 0), each `[x, y]`.
    ///
    /// Half its size is ceil(half width / step) with a tolerance for rounding: 0.1 / 0.01 is 10, not 11 (\[IEMA\] step 1).
    ///
    /// # Errors
    /// [`Error::Invalid`], or [`Error::TooManyCandidates`] beyond `max_candidates`, before any memory is taken.
    pub fn new(half_width: [f64; 2], step: [f64; 2], max_candidates: u64) -> Result<Self> {
        let mut half = [0_usize; 2];
        let mut sizes = [0_u128; 2];
        for (d, axis) in ["x", "y"].iter().enumerate() {
            require_not_negative(&format!("half_width {axis}"), half_width[d])?;
            require_positive(&format!("step {axis}"), step[d])?;
            let ratio = (half_width[d] / step[d]).min(f64::MAX);
            let cells = (ratio - 1e-9 * ratio.max(1.0)).ceil().max(0.0);
            sizes[d] = (cells as u128).saturating_mul(2).saturating_add(1);
            half[d] = cells as usize;
        }
        let needed = sizes[0].saturating_mul(sizes[1]);
        if needed > u128::from(max_candidates) {
            return Err(Error::TooManyCandidates {
                what: format!("offset lattice of {} x {}", sizes[0], sizes[1]),
                needed,
                limit: max_candidates,
            });
        }
        Ok(Self { half, step })
    }

    /// Number of y offsets.
    pub fn rows(&self) -> usize {
        2 * self.half[1] + 1
    }

    /// Number of x offsets.
    pub fn columns(&self) -> usize {
        2 * self.half[0] + 1
    }

    /// Number of candidates.
    #[allow(clippy::len_without_is_empty)] // at least the zero offset
    pub fn len(&self) -> usize {
        self.rows() * self.columns()
    }

    /// Step `[x, y]`, map units.
    pub fn step(&self) -> [f64; 2] {
        self.step
    }

    /// Half size `[x, y]` in steps: the index of no offset.
    pub fn half(&self) -> [usize; 2] {
        self.half
    }

    /// Offset of a row (y) and column (x), map units `[x, y]`; the middle is exactly zero.
    pub fn offset(&self, row: usize, column: usize) -> [f64; 2] {
        [(column as f64 - self.half[0] as f64) * self.step[0], (row as f64 - self.half[1] as f64) * self.step[1]]
    }

    /// Whether a row and column lie on the border of the search. A direction with one offset only has no border.
    pub fn on_border(&self, row: usize, column: usize) -> bool {
        (self.half[1] > 0 && (row == 0 || row == self.rows() - 1))
            || (self.half[0] > 0 && (column == 0 || column == self.columns() - 1))
    }
}

/// Where a rotation or a change of scale of the track leaves it unmoved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Pivot {
    /// The newest point: the fix is for now.
    #[default]
    Newest,
    /// The mean of the indicated points.
    Centroid,
}

/// Track points rotated by `heading_deg` (clockwise from above, as headings are) and stretched by `scale` about the pivot.
///
/// Done in metres; a rotation in longitude and latitude is no rotation. No rotation and no stretch give the points back
/// to the last bit.
pub fn place_track(field: &dyn Field, track: &Track, heading_deg: f64, scale: f64, pivot: Pivot) -> Vec<[f64; 2]> {
    let points = (0..track.len()).map(|k| track.point(k));
    if heading_deg == 0.0 && scale == 1.0 {
        return points.collect();
    }
    let geographic = field.geographic();
    let pivot = match pivot {
        Pivot::Newest => track.newest(),
        Pivot::Centroid => {
            let origin = track.point(0);
            let (mut x, mut y) = (0.0, 0.0);
            for p in points.clone() {
                let unwrapped = if geographic { crate::frame::wrap_longitude(p[0], origin[0]) } else { p[0] };
                x += unwrapped - origin[0];
                y += p[1] - origin[1];
            }
            [origin[0] + x / track.len() as f64, origin[1] + y / track.len() as f64]
        }
    };
    let (sin, cos) = heading_deg.to_radians().sin_cos();
    points
        .map(|p| {
            let [east, north] = displacement_m(geographic, pivot, p);
            let moved = [scale * (cos * east + sin * north) - east, scale * (cos * north - sin * east) - north];
            let unit = field.metres_per_unit(p[1]);
            [p[0] + moved[0] / unit[0], p[1] + moved[1] / unit[1]]
        })
        .collect()
}

/// A number that the kernels calculate with.
pub trait Real:
    Copy
    + Send
    + Sync
    + Default
    + PartialOrd
    + std::fmt::Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + 'static
{
    /// Lanes that a kernel handles at a time: four vectors of AVX2, two of AVX-512.
    const LANES: usize;
    /// Rounded to this precision.
    fn from_f64(value: f64) -> Self;
    /// In double precision.
    fn to_f64(self) -> f64;
    /// `a * b + c`, fused where `FUSED`.
    fn fma<const FUSED: bool>(a: Self, b: Self, c: Self) -> Self;
    /// Absolute value.
    #[must_use]
    fn magnitude(self) -> Self;
    /// Whether it is a number: a missing map value is NaN.
    fn known(self) -> bool;
}

macro_rules! real {
    ($t:ty, $lanes:expr) => {
        impl Real for $t {
            const LANES: usize = $lanes;
            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as $t
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn fma<const FUSED: bool>(a: Self, b: Self, c: Self) -> Self {
                if FUSED { a.mul_add(b, c) } else { a * b + c }
            }
            #[inline(always)]
            fn magnitude(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn known(self) -> bool {
                !self.is_nan()
            }
        }
    };
}
real!(f32, 32);
real!(f64, 16);

/// Runs a kernel with the best instruction set of this machine, chosen at run time.
///
/// The kernel's `call` must be inlined (`#[inline(always)]`) to be compiled for that set. `FUSED` tells it whether
/// fused multiply-add is an instruction there.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    {
        if let Some(simd) = pulp::x86::V4::try_new() {
            return simd.vectorize(Fused(kernel));
        }
        if let Some(simd) = pulp::x86::V3::try_new() {
            return simd.vectorize(Fused(kernel));
        }
    }
    if cfg!(target_arch = "aarch64") { kernel.call::<true>() } else { kernel.call::<false>() }
}

/// Name of the instruction set that [`dispatch`] chooses on this machine.
pub fn instruction_set() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if pulp::x86::V4::try_new().is_some() {
            return "x86-64-v4 (AVX-512)";
        }
        if pulp::x86::V3::try_new().is_some() {
            return "x86-64-v3 (AVX2, FMA)";
        }
    }
    std::env::consts::ARCH
}

/// A computation that is compiled once for each instruction set.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// The computation.
    fn call<const FUSED: bool>(self) -> Self::Output;
}

#[cfg(target_arch = "x86_64")]
struct Fused<K>(K);

#[cfg(target_arch = "x86_64")]
impl<K: Kernel> pulp::NullaryFnOnce for Fused<K> {
    type Output = K::Output;
    #[inline(always)]
    fn call(self) -> K::Output {
        self.0.call::<true>()
    }
}

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

/// Sums that a measure may keep.
pub const MAX_SLOTS: usize = 5;

/// How samples are summed into scores on the fast path.
///
/// A measure sees the map values of one sample over a block of offsets and adds to its sums; `finish` makes a score of
/// them. Smaller scores are better for every measure here; correlations are negated.
pub trait Measure: Copy + Send + Sync {
    /// Sums kept where every offset has every sample with the same weight.
    const SLOTS: usize;
    /// Sums kept where samples are weighted or missing for some offsets; those up to `SLOTS` mean the same.
    const SLOTS_WEIGHTED: usize;
    /// Adds a block of map values `m` for the measured value `v`, with weights `w` (one a lane) where `WEIGHTED`.
    fn add<T: Real, const N: usize, const FUSED: bool, const WEIGHTED: bool>(
        &self,
        sums: &mut [[T; N]; MAX_SLOTS],
        m: &[T; N],
        v: T,
        w: &[T; N],
    );
    /// The score from the sums and the sum of weights.
    fn finish(&self, sums: [f64; MAX_SLOTS], weight: f64, weighted: bool) -> f64;
}

/// What is compared: a field, the lattice, the placed points and their values.
#[derive(Debug, Clone)]
pub struct Comparison<'a> {
    field: &'a dyn Field,
    lattice: OffsetLattice,
    points: Vec<[f64; 2]>,
    values: Vec<f64>,
    weights: Option<Vec<f64>>,
    interpolation: Interpolation,
    min_samples: usize,
}

impl<'a> Comparison<'a> {
    /// A comparison of `values` measured at `points` (map units) with `field` over `lattice`.
    ///
    /// A candidate with fewer than `min_samples` known map values has no score (NaN).
    ///
    /// # Errors
    /// [`Error::Shape`] for unequal lengths, [`Error::Invalid`] for weights that are negative or all zero.
    pub fn new(
        field: &'a dyn Field,
        lattice: OffsetLattice,
        points: Vec<[f64; 2]>,
        values: Vec<f64>,
        weights: Option<Vec<f64>>,
        interpolation: Interpolation,
        min_samples: usize,
    ) -> Result<Self> {
        let n = points.len();
        for (what, len) in [("values", values.len()), ("weights", weights.as_ref().map_or(n, Vec::len))] {
            if len != n {
                return Err(Error::shape(what, format!("({n},) as the track"), format!("({len},)")));
            }
        }
        if let Some(w) = &weights {
            if let Some(k) = w.iter().position(|w| !(w.is_finite() && *w >= 0.0)) {
                return Err(Error::invalid(format!("weights[{k}]"), "a finite number >= 0", w[k]));
            }
            if w.iter().all(|w| *w == 0.0) {
                return Err(Error::invalid("weights", "at least one weight > 0", "zeros only"));
            }
        }
        Ok(Self { field, lattice, points, values, weights, interpolation, min_samples: min_samples.max(1) })
    }

    /// The lattice.
    pub fn lattice(&self) -> &OffsetLattice {
        &self.lattice
    }

    /// The measured values.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The weights of the samples, where they differ.
    pub fn weights(&self) -> Option<&[f64]> {
        self.weights.as_deref()
    }

    /// The same comparison with other measured values.
    #[must_use]
    pub fn with_values(mut self, values: Vec<f64>) -> Self {
        self.values = values;
        self
    }

    /// The same comparison at one offset alone, map units, on the lattice or off it.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for an offset that is no number.
    pub fn at_offset(&self, offset: [f64; 2]) -> Result<Self> {
        crate::error::require_finite("offset", &offset)?;
        let lattice = OffsetLattice { half: [0; 2], step: self.lattice.step };
        let points = self.points.iter().map(|p| [p[0] + offset[0], p[1] + offset[1]]).collect();
        Ok(Self { lattice, points, ..self.clone() })
    }

    /// Map value of sample `k` under the offset of a row and column, sampled on its own.
    pub fn map_value(&self, k: usize, row: usize, column: usize) -> f64 {
        let [ox, oy] = self.lattice.offset(row, column);
        let [x, y] = self.points[k];
        match self.field.as_grid() {
            Some(grid) => {
                let [px, py] = grid.position(x, y);
                let (cx, cy) = (ox / grid.x().step(), oy / grid.y().step());
                grid.at_position(px + cx, py + cy, self.interpolation).0
            }
            None => self.field.value(x + ox, y + oy),
        }
    }

    /// Fast path: the grid and its classes, where they apply.
    fn fast(&self) -> Option<(&GridMap, Classes)> {
        if self.interpolation != Interpolation::Bilinear {
            return None;
        }
        let grid = self.field.as_grid()?;
        Some((grid, Classes::of(grid, self.lattice.step)?))
    }

    fn weight(&self, k: usize) -> f64 {
        self.weights.as_ref().map_or(1.0, |w| w[k])
    }

    /// Scores of all candidates of `rows` x `columns`, row-major, NaN where too few samples are known.
    ///
    /// Same input, same bits, for any number of threads.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn scores<M: Measure>(
        &self,
        measure: M,
        rows: Range<usize>,
        columns: Range<usize>,
        monitor: &dyn Monitor,
    ) -> Result<Vec<f64>> {
        let mut out = vec![f64::NAN; rows.len() * columns.len()];
        if let Some((grid, classes)) = self.fast() {
            match grid.values() {
                GridValues::F64(v) => self.scores_fast(measure, grid, v, classes, rows, columns, &mut out, monitor)?,
                GridValues::F32(v) => self.scores_fast(measure, grid, v, classes, rows, columns, &mut out, monitor)?,
            }
        } else {
            let score = |m: &[f64], known: &[usize]| {
                let mut sums = [[0.0_f64; 1]; MAX_SLOTS];
                let mut weight = 0.0;
                for (&m, &k) in m.iter().zip(known) {
                    let w = self.weight(k);
                    measure.add::<f64, 1, false, true>(&mut sums, &[m], self.values[k], &[w]);
                    weight += w;
                }
                if weight > 0.0 { measure.finish(sums.map(|s| s[0]), weight, true) } else { f64::NAN }
            };
            self.collect_scores(score, rows, columns, &mut out, monitor)?;
        }
        Ok(out)
    }

    /// Scores by a function of all the known map values of a candidate and the indices of their samples.
    ///
    /// For measures that are no sum over samples: medians, Hausdorff distances, robust locations.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn scores_by<F>(
        &self,
        score: F,
        rows: Range<usize>,
        columns: Range<usize>,
        monitor: &dyn Monitor,
    ) -> Result<Vec<f64>>
    where
        F: Fn(&[f64], &[usize]) -> f64 + Sync,
    {
        let mut out = vec![f64::NAN; rows.len() * columns.len()];
        self.collect_scores(score, rows, columns, &mut out, monitor)?;
        Ok(out)
    }

    fn collect_scores<F>(
        &self,
        score: F,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        monitor: &dyn Monitor,
    ) -> Result<()>
    where
        F: Fn(&[f64], &[usize]) -> f64 + Sync,
    {
        let n = self.points.len();
        let width = columns.len();
        let total = rows.len() as u64;
        let done = std::sync::atomic::AtomicU64::new(0);
        let work = |(block, known, values): &mut (Vec<f64>, Vec<usize>, Vec<f64>), i: usize, out_row: &mut [f64]| {
            let row = rows.start + i;
            for tile in (0..width).step_by(TILE_COLUMNS) {
                let tile = tile..(tile + TILE_COLUMNS).min(width);
                let w = tile.len();
                for k in 0..n {
                    self.map_row(k, row, columns.start + tile.start, &mut block[k * w..(k + 1) * w]);
                }
                for (c, out) in out_row[tile].iter_mut().enumerate() {
                    known.clear();
                    values.clear();
                    for k in 0..n {
                        let m = block[k * w + c];
                        if !m.is_nan() {
                            known.push(k);
                            values.push(m);
                        }
                    }
                    if known.len() >= self.min_samples {
                        *out = score(values, known);
                    }
                }
            }
            let finished = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            monitor.advance(finished, total)
        };
        let scratch = || (vec![0.0; n * width.min(TILE_COLUMNS)], Vec::with_capacity(n), Vec::with_capacity(n));
        for_each_chunk(out, width.max(1), n, scratch, work)
    }

    /// Map values of sample `k` for one row of offsets, columns from `first`; NaN where unknown.
    pub fn map_row(&self, k: usize, row: usize, first: usize, out: &mut [f64]) {
        let Some((grid, classes)) = self.fast() else {
            for (c, out) in out.iter_mut().enumerate() {
                *out = self.map_value(k, row, first + c);
            }
            return;
        };
        let position = grid.position(self.points[k][0], self.points[k][1]);
        let half = self.lattice.half;
        let qx = classes.per_cell[0];
        for class in 0..qx.min(out.len()) {
            let start = [first as i64 - half[0] as i64, row as i64 - half[1] as i64];
            let shift = classes.shift(position, start, [class, 0]);
            match grid.values() {
                GridValues::F64(v) => dispatch(Row { values: v, grid, shift, out, first: class, stride: qx }),
                GridValues::F32(v) => dispatch(Row { values: v, grid, shift, out, first: class, stride: qx }),
            }
        }
    }

    #[allow(clippy::too_many_arguments)] // internal, one call
    fn scores_fast<T: Real, M: Measure>(
        &self,
        measure: M,
        grid: &GridMap,
        values: &[T],
        classes: Classes,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        monitor: &dyn Monitor,
    ) -> Result<()> {
        let positions: Vec<[f64; 2]> = self.points.iter().map(|p| grid.position(p[0], p[1])).collect();
        let measured: Vec<T> = self.values.iter().map(|&v| T::from_f64(v)).collect();
        let weights: Option<Vec<T>> = self.weights.as_ref().map(|w| w.iter().map(|&w| T::from_f64(w)).collect());
        let total_weight: f64 = (0..self.points.len()).map(|k| self.weight(k)).sum();
        let [qx, qy] = classes.per_cell;
        let width = columns.len();
        // A band is the rows of one tile in every class: threads own bands of the output, never share a cache line.
        let band_rows = TILE_ROWS * qy;
        let bands = rows.len().div_ceil(band_rows) as u64;
        let done = std::sync::atomic::AtomicU64::new(0);
        let half = self.lattice.half.map(|h| h as i64);
        let work = |(sums, shifts): &mut (TileSums<T>, Vec<Shift>), band: usize, out_band: &mut [f64]| {
            let first_row = rows.start + band * band_rows;
            let band_height = out_band.len() / width;
            for cy in 0..qy.min(band_height) {
                let tile_rows = (band_height - cy).div_ceil(qy);
                for cx in 0..qx.min(width) {
                    let class_columns = (width - cx).div_ceil(qx);
                    let first = [columns.start as i64 - half[0], first_row as i64 - half[1]];
                    shifts.clear();
                    shifts.extend(positions.iter().map(|&p| classes.shift(p, first, [cx, cy])));
                    for start in (0..class_columns).step_by(TILE_COLUMNS) {
                        let tile = Tile {
                            values,
                            map_rows: grid.y().len(),
                            map_columns: grid.x().len(),
                            holes: grid.holes() > 0,
                            shifts,
                            measured: &measured,
                            weights: weights.as_deref(),
                            first_column: start as i64,
                            rows: tile_rows,
                            columns: TILE_COLUMNS.min(class_columns - start),
                        };
                        let full = tile.sum(measure, sums);
                        for r in 0..tile_rows {
                            for c in 0..tile.columns {
                                let (count, weight) = if full {
                                    (sums.count(r, c), sums.weight(r, c))
                                } else {
                                    (self.points.len() as f64, total_weight)
                                };
                                if count >= self.min_samples as f64 && weight > 0.0 {
                                    let at = (cy + r * qy) * width + cx + (start + c) * qx;
                                    out_band[at] = measure.finish(sums.sums::<M>(r, c, full), weight, full);
                                }
                            }
                        }
                    }
                }
            }
            let finished = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            monitor.advance(finished, bands)
        };
        let scratch = || (TileSums::<T>::default(), Vec::with_capacity(positions.len()));
        for_each_chunk(out, band_rows * width.max(1), positions.len(), scratch, work)
    }
}

/// Fills `out` chunk by chunk, on all threads where there is enough to do; every chunk is computed alike on any thread.
fn for_each_chunk<S>(
    out: &mut [f64],
    chunk: usize,
    samples: usize,
    scratch: impl Fn() -> S + Send + Sync,
    work: impl Fn(&mut S, usize, &mut [f64]) -> Result<()> + Send + Sync,
) -> Result<()> {
    if out.len().saturating_mul(samples) < SERIAL {
        let mut scratch = scratch();
        return out.chunks_mut(chunk).enumerate().try_for_each(|(i, part)| work(&mut scratch, i, part));
    }
    out.par_chunks_mut(chunk).enumerate().try_for_each_init(scratch, |scratch, (i, part)| work(scratch, i, part))
}

/// Map values of one sample under one row of one class of offsets, into every `stride`-th place of `out`.
struct Row<'a, T> {
    values: &'a [T],
    grid: &'a GridMap,
    shift: Shift,
    out: &'a mut [f64],
    first: usize,
    stride: usize,
}

impl<T: Real> Kernel for Row<'_, T> {
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
        let mix = |p: f64, q: f64, t: f64| f64::fma::<FUSED>(q, t, p * (1.0 - t));
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

/// Sums of one tile, slot by slot: 0 counts, 1 weights, 2.. the measure's own.
#[derive(Debug, Default)]
struct TileSums<T> {
    slots: [Vec<T>; 2 + MAX_SLOTS],
}

impl<T: Real> TileSums<T> {
    fn clear(&mut self, used: usize, counted: bool) {
        for (s, slot) in self.slots.iter_mut().enumerate() {
            if (s >= 2 && s < 2 + used) || (s < 2 && counted) {
                slot.clear();
                slot.resize(TILE_ROWS * TILE_COLUMNS, T::default());
            }
        }
    }

    fn count(&self, r: usize, c: usize) -> f64 {
        self.slots[0][r * TILE_COLUMNS + c].to_f64()
    }

    fn weight(&self, r: usize, c: usize) -> f64 {
        self.slots[1][r * TILE_COLUMNS + c].to_f64()
    }

    fn sums<M: Measure>(&self, r: usize, c: usize, full: bool) -> [f64; MAX_SLOTS] {
        let used = if full { M::SLOTS_WEIGHTED } else { M::SLOTS };
        std::array::from_fn(|s| if s < used { self.slots[2 + s][r * TILE_COLUMNS + c].to_f64() } else { 0.0 })
    }
}

/// A block of offsets of one class and everything that its sums need.
#[derive(Clone, Copy)]
struct Tile<'a, T> {
    values: &'a [T],
    map_rows: usize,
    map_columns: usize,
    holes: bool,
    shifts: &'a [Shift],
    measured: &'a [T],
    weights: Option<&'a [T]>,
    first_column: i64,
    rows: usize,
    columns: usize,
}

impl<T: Real> Tile<'_, T> {
    /// Whether every sample of every offset lies on the map and no hole can be met.
    fn covered(&self) -> bool {
        !self.holes
            && self.shifts.iter().all(|s| {
                let [dx, dy] = s.next();
                s.column + self.first_column >= 0
                    && s.row >= 0
                    && s.column + self.first_column + self.columns as i64 - 1 + dx < self.map_columns as i64
                    && s.row + self.rows as i64 - 1 + dy < self.map_rows as i64
            })
    }

    /// Fills the sums; true where counts and weights were kept because samples differ between offsets.
    fn sum<M: Measure>(&self, measure: M, sums: &mut TileSums<T>) -> bool {
        let full = self.weights.is_some() || !self.covered();
        sums.clear(if full { M::SLOTS_WEIGHTED } else { M::SLOTS }, full);
        if full {
            dispatch(SumTile::<T, M, true> { tile: *self, sums, measure });
        } else {
            dispatch(SumTile::<T, M, false> { tile: *self, sums, measure });
        }
        full
    }
}

struct SumTile<'a, 'b, T, M, const FULL: bool> {
    tile: Tile<'a, T>,
    sums: &'b mut TileSums<T>,
    measure: M,
}

impl<T: Real, M: Measure, const FULL: bool> Kernel for SumTile<'_, '_, T, M, FULL> {
    type Output = ();

    #[inline(always)]
    fn call<const FUSED: bool>(self) {
        let tile = self.tile;
        for k in 0..tile.shifts.len() {
            if T::LANES == 32 {
                sample_into::<T, M, 32, FULL, FUSED>(&tile, k, self.measure, self.sums);
            } else {
                sample_into::<T, M, 16, FULL, FUSED>(&tile, k, self.measure, self.sums);
            }
        }
    }
}

/// Adds sample `k` to every offset of the tile.
#[inline(always)]
fn sample_into<T: Real, M: Measure, const N: usize, const FULL: bool, const FUSED: bool>(
    tile: &Tile<'_, T>,
    k: usize,
    measure: M,
    sums: &mut TileSums<T>,
) {
    let whole = tile.columns / N * N;
    let mut c = 0;
    while c < whole {
        block_into::<T, M, N, FULL, FUSED>(tile, k, c, measure, sums);
        c += N;
    }
    while c < tile.columns {
        block_into::<T, M, 1, FULL, FUSED>(tile, k, c, measure, sums);
        c += 1;
    }
}

/// One node row of the map under N offsets, interpolated along x.
#[inline(always)]
fn along_x<T: Real, const N: usize, const FULL: bool, const FUSED: bool>(
    tile: &Tile<'_, T>,
    row: i64,
    column: i64,
    dx: i64,
    wa: T,
    wb: T,
) -> [T; N] {
    let mut h = [T::default(); N];
    if FULL {
        let nan = T::from_f64(f64::NAN);
        if row < 0 || row >= tile.map_rows as i64 {
            return [nan; N];
        }
        let base = row as usize * tile.map_columns;
        let last = tile.map_columns as i64 - dx;
        if column < 0 || column + N as i64 > last {
            for (l, h) in h.iter_mut().enumerate() {
                let at = column + l as i64;
                *h = if at < 0 || at >= last {
                    nan
                } else {
                    let a = tile.values[base + at as usize];
                    let b = tile.values[base + (at + dx) as usize];
                    T::fma::<FUSED>(b, wb, a * wa)
                };
            }
            return h;
        }
    }
    let start = row as usize * tile.map_columns + column as usize;
    let a = &tile.values[start..start + N];
    let b = &tile.values[start + dx as usize..start + dx as usize + N];
    for l in 0..N {
        h[l] = T::fma::<FUSED>(b[l], wb, a[l] * wa);
    }
    h
}

#[inline(always)]
fn block_into<T: Real, M: Measure, const N: usize, const FULL: bool, const FUSED: bool>(
    tile: &Tile<'_, T>,
    k: usize,
    c: usize,
    measure: M,
    sums: &mut TileSums<T>,
) {
    let shift = tile.shifts[k];
    let v = tile.measured[k];
    let [dx, dy] = shift.next();
    let (wa, wb) = (T::from_f64(1.0 - shift.tx), T::from_f64(shift.tx));
    let (ya, yb) = (T::from_f64(1.0 - shift.ty), T::from_f64(shift.ty));
    let column = shift.column + tile.first_column + c as i64;
    let weight = if FULL { tile.weights.map_or(T::from_f64(1.0), |w| w[k]) } else { T::from_f64(1.0) };
    let mut lower =
        if dy == 0 { [T::default(); N] } else { along_x::<T, N, FULL, FUSED>(tile, shift.row, column, dx, wa, wb) };
    for r in 0..tile.rows {
        let upper = along_x::<T, N, FULL, FUSED>(tile, shift.row + r as i64 + dy, column, dx, wa, wb);
        let mut m = upper;
        if dy != 0 {
            for l in 0..N {
                m[l] = T::fma::<FUSED>(upper[l], yb, lower[l] * ya);
            }
            lower = upper;
        }
        let at = r * TILE_COLUMNS + c;
        let mut w = [weight; N];
        if FULL {
            let one = T::from_f64(1.0);
            let counts = &mut sums.slots[0][at..at + N];
            for l in 0..N {
                let known = m[l].known();
                counts[l] = counts[l] + (if known { one } else { T::default() });
                w[l] = if known { weight } else { T::default() };
                m[l] = if known { m[l] } else { v };
            }
            let weights = &mut sums.slots[1][at..at + N];
            for l in 0..N {
                weights[l] = weights[l] + w[l];
            }
        }
        let used = if FULL { M::SLOTS_WEIGHTED } else { M::SLOTS };
        let mut own = [[T::default(); N]; MAX_SLOTS];
        for (s, own) in own.iter_mut().enumerate().take(used) {
            own.copy_from_slice(&sums.slots[2 + s][at..at + N]);
        }
        measure.add::<T, N, FUSED, FULL>(&mut own, &m, v, &w);
        for (s, own) in own.iter().enumerate().take(used) {
            sums.slots[2 + s][at..at + N].copy_from_slice(own);
        }
    }
}
