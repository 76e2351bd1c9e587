//! The hot kernel: sums of one measure over a block of offsets that share their weights.

// A kernel that is not inlined is not compiled for the instruction set that was chosen.
#![allow(clippy::inline_always)]

use pulp::{Simd, WithSimd};

use super::shift::Shift;
use super::simd::Real;

/// Rows and columns of a tile: its sums and its part of the map stay in the first-level cache.
pub(super) const TILE_ROWS: usize = 8;
pub(super) const TILE_COLUMNS: usize = 256;
/// Sums that a measure may keep.
pub const MAX_SLOTS: usize = 5;
/// Bytes of a cache line: a vector that straddles two costs two accesses.
const LINE: usize = 64;
/// Count and weight, kept before a measure's own sums where samples differ between offsets.
const OWN: usize = 2;

/// How samples are summed into scores on the fast path.
///
/// A measure sees the map values of one sample over a vector of offsets and adds to its sums; `finish` makes a score of
/// them. Smaller scores are better for every measure here; correlations are negated.
pub trait Measure: Copy + Send + Sync {
    /// Sums kept where every offset has every sample with the same weight.
    const SLOTS: usize;
    /// Sums kept where samples are weighted or missing for some offsets; those up to `SLOTS` mean the same.
    const SLOTS_WEIGHTED: usize;
    /// Adds map values `m` for the measured value `v`, with weights `w` where `WEIGHTED`, to the sums.
    fn add<S: Simd, T: Real, const WEIGHTED: bool>(
        &self,
        simd: S,
        sums: &mut [T::Vector<S>],
        m: T::Vector<S>,
        v: T::Vector<S>,
        w: T::Vector<S>,
    );
    /// The score from the sums and the sum of weights.
    fn finish(&self, sums: [f64; MAX_SLOTS], weight: f64, weighted: bool) -> f64;
}

/// Sums of one tile: row by row, vector by vector, slot by slot.
#[derive(Debug, Default)]
pub(super) struct TileSums<T> {
    sums: Vec<T>,
    /// Where the sums begin, on a cache line.
    start: usize,
    /// Horizontal interpolation of the node row below the current offsets.
    below: Vec<T>,
    /// A node row that hangs over the map's border, NaN outside.
    overhang: Vec<T>,
    lanes: usize,
    vectors: usize,
    slots: usize,
    own: usize,
}

impl<T: Real> TileSums<T> {
    fn at(&self, r: usize, c: usize, slot: usize) -> f64 {
        let (vector, lane) = (c / self.lanes, c % self.lanes);
        self.sums[self.start + ((r * self.vectors + vector) * self.slots + slot) * self.lanes + lane].to_f64()
    }

    /// Samples that the offset has a map value for; kept only where [`Tile::sum`] says so.
    pub fn count(&self, r: usize, c: usize) -> f64 {
        self.at(r, c, 0)
    }

    /// Sum of their weights.
    pub fn weight(&self, r: usize, c: usize) -> f64 {
        self.at(r, c, 1)
    }

    /// The measure's own sums.
    pub fn sums(&self, r: usize, c: usize) -> [f64; MAX_SLOTS] {
        std::array::from_fn(|s| if self.own + s < self.slots { self.at(r, c, self.own + s) } else { 0.0 })
    }
}

/// A block of offsets of one class and everything that its sums need.
#[derive(Clone, Copy)]
pub(super) struct Tile<'a, T> {
    pub values: &'a [T],
    pub map_rows: usize,
    pub map_columns: usize,
    pub holes: bool,
    pub shifts: &'a [Shift],
    pub measured: &'a [T],
    pub weights: Option<&'a [T]>,
    pub first_column: i64,
    pub rows: usize,
    pub columns: usize,
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
    pub fn sum<M: Measure>(&self, measure: M, sums: &mut TileSums<T>) -> bool {
        let full = self.weights.is_some() || !self.covered();
        let arch = pulp::Arch::new();
        if full {
            arch.dispatch(SumTile::<T, M, true> { tile: *self, sums, measure });
        } else {
            arch.dispatch(SumTile::<T, M, false> { tile: *self, sums, measure });
        }
        full
    }

    /// Nodes of a map row from a column on, `len` of them; `overhang` holds them where some lie outside.
    #[inline(always)]
    fn nodes<'s>(&'s self, row: i64, column: i64, len: usize, overhang: &'s mut Vec<T>) -> &'s [T] {
        let inside = row >= 0 && row < self.map_rows as i64;
        if inside && column >= 0 && column + len as i64 <= self.map_columns as i64 {
            let start = row as usize * self.map_columns + column as usize;
            return &self.values[start..start + len];
        }
        overhang.clear();
        overhang.resize(len, T::from_f64(f64::NAN));
        let first = column.clamp(0, self.map_columns as i64);
        let last = (column + len as i64).clamp(first, self.map_columns as i64);
        if inside && first < last {
            let start = row as usize * self.map_columns;
            let source = &self.values[start + first as usize..start + last as usize];
            overhang[(first - column) as usize..(last - column) as usize].copy_from_slice(source);
        }
        overhang
    }
}

/// Makes room for `len` numbers that begin on a cache line, and says where.
fn aligned<T: Real>(buffer: &mut Vec<T>, len: usize) -> usize {
    let spare = LINE / size_of::<T>();
    buffer.resize(len + spare, T::default());
    buffer.as_ptr().align_offset(LINE).min(spare)
}

struct SumTile<'a, 'b, T, M, const FULL: bool> {
    tile: Tile<'a, T>,
    sums: &'b mut TileSums<T>,
    measure: M,
}

impl<T: Real, M: Measure, const FULL: bool> WithSimd for SumTile<'_, '_, T, M, FULL> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tile, sums, measure } = self;
        let slots = if FULL { OWN + M::SLOTS_WEIGHTED } else { M::SLOTS };
        let lanes = T::lanes::<S>();
        let vectors = tile.columns.div_ceil(lanes);
        sums.lanes = lanes;
        sums.vectors = vectors;
        sums.slots = slots;
        sums.own = if FULL { OWN } else { 0 };
        sums.sums.clear();
        sums.start = aligned(&mut sums.sums, tile.rows * vectors * slots * lanes);
        let below_start = aligned(&mut sums.below, TILE_COLUMNS.max(vectors * lanes));
        for (k, shift) in tile.shifts.iter().enumerate() {
            let [dx, dy] = shift.next();
            let sample = Sample::<S, T> {
                simd,
                v: T::splat(simd, tile.measured[k]),
                weight: T::splat(simd, tile.weights.map_or(T::from_f64(1.0), |w| w[k])),
                x: [T::splat(simd, T::from_f64(1.0 - shift.tx)), T::splat(simd, T::from_f64(shift.tx))],
                y: [T::splat(simd, T::from_f64(1.0 - shift.ty)), T::splat(simd, T::from_f64(shift.ty))],
            };
            let column = shift.column + tile.first_column;
            let len = tile.columns + dx as usize;
            let below = T::vectors_mut::<S>(&mut sums.below[below_start..]);
            if dy != 0 {
                let nodes = tile.nodes(shift.row, column, len, &mut sums.overhang);
                sample.along(&nodes[..tile.columns], &nodes[dx as usize..], below);
            }
            let width = vectors * slots * lanes;
            for r in 0..tile.rows {
                let nodes = tile.nodes(shift.row + r as i64 + dy, column, len, &mut sums.overhang);
                let row = T::vectors_mut::<S>(&mut sums.sums[sums.start + r * width..sums.start + (r + 1) * width]);
                let (a, b) = (&nodes[..tile.columns], &nodes[dx as usize..]);
                if dy == 0 {
                    sample.row::<M, FULL, false>(measure, a, b, below, row);
                } else {
                    sample.row::<M, FULL, true>(measure, a, b, below, row);
                }
            }
        }
    }
}

/// What is constant for one sample over a tile.
struct Sample<S: Simd, T: Real> {
    simd: S,
    v: T::Vector<S>,
    weight: T::Vector<S>,
    x: [T::Vector<S>; 2],
    y: [T::Vector<S>; 2],
}

impl<S: Simd, T: Real> Sample<S, T> {
    #[inline(always)]
    fn mix(&self, a: T::Vector<S>, b: T::Vector<S>, w: [T::Vector<S>; 2]) -> T::Vector<S> {
        T::fma(self.simd, b, w[1], T::mul(self.simd, a, w[0]))
    }

    /// Interpolates a node row along x.
    #[inline(always)]
    fn along(&self, a: &[T], b: &[T], out: &mut [T::Vector<S>]) {
        let (av, a_rest) = T::vectors::<S>(a);
        let (bv, b_rest) = T::vectors::<S>(b);
        for ((a, b), out) in av.iter().zip(bv).zip(out.iter_mut()) {
            *out = self.mix(*a, *b, self.x);
        }
        if !a_rest.is_empty() {
            out[av.len()] = self.mix(T::load(self.simd, a_rest), T::load(self.simd, b_rest), self.x);
        }
    }

    /// Adds one row of offsets; `below` holds the interpolated node row below and takes the one above.
    #[inline(always)]
    fn row<M: Measure, const FULL: bool, const BETWEEN: bool>(
        &self,
        measure: M,
        a: &[T],
        b: &[T],
        below: &mut [T::Vector<S>],
        sums: &mut [T::Vector<S>],
    ) {
        let slots = if FULL { OWN + M::SLOTS_WEIGHTED } else { M::SLOTS };
        let (av, a_rest) = T::vectors::<S>(a);
        let (bv, b_rest) = T::vectors::<S>(b);
        for (((a, b), below), sums) in av.iter().zip(bv).zip(below.iter_mut()).zip(sums.chunks_exact_mut(slots)) {
            self.add::<M, FULL, BETWEEN>(measure, *a, *b, below, sums);
        }
        if !a_rest.is_empty() {
            let n = av.len();
            let (a, b) = (T::load(self.simd, a_rest), T::load(self.simd, b_rest));
            self.add::<M, FULL, BETWEEN>(measure, a, b, &mut below[n], &mut sums[n * slots..(n + 1) * slots]);
        }
    }

    #[inline(always)]
    fn add<M: Measure, const FULL: bool, const BETWEEN: bool>(
        &self,
        measure: M,
        a: T::Vector<S>,
        b: T::Vector<S>,
        below: &mut T::Vector<S>,
        sums: &mut [T::Vector<S>],
    ) {
        let simd = self.simd;
        let above = self.mix(a, b, self.x);
        let mut m = above;
        if BETWEEN {
            m = self.mix(*below, above, self.y);
            *below = above;
        }
        if FULL {
            let zero = T::splat(simd, T::default());
            let one = T::splat(simd, T::from_f64(1.0));
            let weight = T::if_known(simd, m, self.weight, zero);
            sums[0] = T::add(simd, sums[0], T::if_known(simd, m, one, zero));
            sums[1] = T::add(simd, sums[1], weight);
            m = T::if_known(simd, m, m, self.v);
            measure.add::<S, T, true>(simd, &mut sums[OWN..], m, self.v, weight);
        } else {
            measure.add::<S, T, false>(simd, sums, m, self.v, self.weight);
        }
    }
}
