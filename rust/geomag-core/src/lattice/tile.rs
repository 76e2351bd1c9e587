//! The hot kernel: sums of one measure over a block of offsets that share their weights.

// A kernel that is not inlined is not compiled for the instruction set that was chosen.
#![allow(clippy::inline_always)]

use pulp::{Simd, WithSimd};

use super::best_two::BestTwo;
use super::shift::Shift;
use super::simd::Real;
use crate::grid::GridMap;

/// Rows and columns of a tile: its sums, and the map under a group of samples, stay in the first-level cache.
pub(super) const TILE_ROWS: usize = 16;
pub(super) const TILE_COLUMNS: usize = 512;
/// Samples that are added before the sums of a block of offsets go back to memory.
const GROUP: usize = 32;
/// The same where candidates may be given up after each group.
const GROUP_OF_CONTEST: usize = 16;
/// Sums that a measure may keep.
pub const MAX_SLOTS: usize = 5;
/// Numbers in the longest vector there is.
const MAX_LANES: usize = 16;
/// Vectors of a row that are worked on together.
const PAIR: usize = 2;
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
    /// Whether the score is the first sum over the weights, and that sum never falls: a candidate can be given up early.
    const GROWS: bool = false;
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

/// Scores of one tile and the memory that they are worked out in.
#[derive(Debug, Default)]
pub(super) struct TileScores<T> {
    /// Sums of the measure: pair of vectors by pair of vectors, row by row, vector by vector, slot by slot.
    sums: Vec<T>,
    /// Nodes under samples that hang over the map's border.
    overhang: Vec<T>,
    scores: Vec<f64>,
    /// Pairs of vectors with no candidate left that could be wanted.
    given_up: Vec<bool>,
}

impl<T> TileScores<T> {
    /// Scores of a row of offsets; NaN where fewer samples are known than asked for.
    pub fn row(&self, r: usize, columns: usize) -> &[f64] {
        &self.scores[r * columns..(r + 1) * columns]
    }

    /// The least score and its row and column.
    pub fn least(&self, columns: usize) -> (f64, usize, usize) {
        let mut least = (f64::INFINITY, 0);
        for (i, &score) in self.scores.iter().enumerate() {
            if score < least.0 {
                least = (score, i);
            }
        }
        (least.0, least.1 / columns, least.1 % columns)
    }
}

/// Where the nodes of one sample are read on a stack of levels: those of the level below, and of the one above with its share.
#[derive(Clone, Copy)]
pub(super) struct Floor<'a, T> {
    pub below: &'a [T],
    pub above: Option<(&'a [T], T)>,
    pub grids: [&'a GridMap; 2],
}

/// A block of offsets of one class and everything that its sums need.
#[derive(Clone, Copy)]
pub(super) struct Tile<'a, T> {
    pub values: &'a [T],
    pub grid: &'a GridMap,
    /// One a sample on a stack of levels, none on a map.
    pub floors: &'a [Floor<'a, T>],
    pub shifts: &'a [Shift],
    pub measured: &'a [T],
    pub weights: Option<&'a [T]>,
    pub total_weight: f64,
    pub min_samples: usize,
    pub best: Option<&'a BestTwo>,
    pub first_column: i64,
    pub rows: usize,
    pub columns: usize,
}

impl<'a, T: Real> Tile<'a, T> {
    fn map_rows(&self) -> usize {
        self.grid.y().len()
    }

    fn map_columns(&self) -> usize {
        self.grid.x().len()
    }

    /// Whether a sample of an offset may fall on a hole; the samples are inside the map.
    fn may_meet_holes(&self) -> bool {
        let holed = |grid: &GridMap, s: &Shift| {
            let (row, column) = (s.row as usize, (s.column + self.first_column) as usize);
            grid.holes() > 0 && grid.may_have_holes(row..row + self.rows + 1, column..column + self.columns + 1)
        };
        if self.floors.is_empty() {
            return self.grid.holes() > 0 && self.shifts.iter().any(|s| holed(self.grid, s));
        }
        self.shifts.iter().zip(self.floors).any(|(s, floor)| floor.grids.iter().any(|grid| holed(grid, s)))
    }

    /// Whether every offset has this sample on the map.
    fn inside(&self, s: &Shift) -> bool {
        let [dx, dy] = s.next();
        let column = s.column + self.first_column;
        column >= 0
            && s.row >= 0
            && column + self.columns as i64 - 1 + dx < self.map_columns() as i64
            && s.row + self.rows as i64 - 1 + dy < self.map_rows() as i64
    }

    /// Fills in the scores.
    pub fn score<M: Measure>(&self, measure: M, scores: &mut TileScores<T>) {
        let arch = crate::instructions::chosen();
        if self.weights.is_some() || !self.shifts.iter().all(|s| self.inside(s)) || self.may_meet_holes() {
            arch.dispatch(ScoreTile::<T, M, true> { tile: *self, scores, measure });
        } else {
            arch.dispatch(ScoreTile::<T, M, false> { tile: *self, scores, measure });
        }
    }

    /// Where the nodes of a sample stand in the map, where all that is read of them does: `width` columns of `height`
    /// rows. The node beyond the last column is read even where it has no weight, and must be one of the same row.
    fn on_map(&self, s: &Shift, height: usize, width: usize) -> Option<usize> {
        let column = s.column + self.first_column;
        let inside = self.inside(s) && column + (self.columns as i64) < self.map_columns() as i64;
        let start = inside.then(|| s.row as usize * self.map_columns() + column as usize)?;
        (start + (height - 1) * self.map_columns() + width <= self.values.len()).then_some(start)
    }

    /// The nodes that sample `k` is read from: those of its level, or of the map.
    fn nodes(&self, k: usize) -> &'a [T] {
        self.floors.get(k).map_or(self.values, |floor| floor.below)
    }

    /// Whether sample `k` lies between two levels, so that its nodes have to be mixed.
    fn mixed(&self, k: usize) -> bool {
        self.floors.get(k).is_some_and(|floor| floor.above.is_some())
    }

    /// Copies the nodes of sample `k` to the end of `out`, `outside` where the map has none; mixed between two levels.
    fn copy_nodes(&self, k: usize, height: usize, width: usize, outside: T, out: &mut Vec<T>) {
        let s = &self.shifts[k];
        let start = out.len();
        self.copy_level(self.nodes(k), s, height, width, outside, out);
        let Some((above, share)) = self.floors.get(k).and_then(|floor| floor.above) else { return };
        let middle = out.len();
        self.copy_level(above, s, height, width, outside, out);
        let (below, above) = out[start..].split_at_mut(middle - start);
        for (below, above) in below.iter_mut().zip(above) {
            *below = T::mix(*below, *above, share);
        }
        out.truncate(middle);
    }

    fn copy_level(&self, values: &[T], s: &Shift, height: usize, width: usize, outside: T, out: &mut Vec<T>) {
        let column = s.column + self.first_column;
        let first = column.clamp(0, self.map_columns() as i64);
        let last = (column + width as i64).clamp(first, self.map_columns() as i64);
        for row in s.row..s.row + height as i64 {
            let at = out.len();
            out.resize(at + width, outside);
            if (0..self.map_rows() as i64).contains(&row) && first < last {
                let start = row as usize * self.map_columns();
                let source = &values[start + first as usize..start + last as usize];
                out[at + (first - column) as usize..at + (last - column) as usize].copy_from_slice(source);
            }
        }
    }
}

/// Makes room for `len` numbers that begin on a cache line, and says where.
fn aligned<T: Real>(buffer: &mut Vec<T>, len: usize) -> usize {
    let spare = LINE / size_of::<T>();
    buffer.resize(len + spare, T::default());
    buffer.as_ptr().align_offset(LINE).min(spare)
}

struct ScoreTile<'a, 'b, T, M, const FULL: bool> {
    tile: Tile<'a, T>,
    scores: &'b mut TileScores<T>,
    measure: M,
}

impl<T: Real, M: Measure, const FULL: bool> WithSimd for ScoreTile<'_, '_, T, M, FULL> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tile, scores, measure } = self;
        let slots = Self::SLOTS;
        let lanes = T::lanes::<S>();
        let pairs = tile.columns.div_ceil(PAIR * lanes);
        let (rows, columns) = (tile.rows, tile.columns);
        let pair = rows * PAIR * slots;
        scores.sums.clear();
        let start = aligned(&mut scores.sums, pairs * pair * lanes);
        let sums = &mut scores.sums[start..start + pairs * pair * lanes];
        // Whole vectors are read, also beyond the last column; those lanes are never looked at.
        let (height, width) = (rows + 1, pairs * PAIR * lanes + 1);
        let outside = if FULL { f64::NAN } else { 0.0 };
        let contest = tile.best.filter(|_| M::GROWS);
        let group = if contest.is_some() { GROUP_OF_CONTEST } else { GROUP };
        scores.given_up.clear();
        scores.given_up.resize(pairs, false);
        for first in (0..tile.shifts.len()).step_by(group) {
            let group = group.min(tile.shifts.len() - first);
            let on_map: [Option<usize>; GROUP] = std::array::from_fn(|i| {
                let shift = tile.shifts[first..first + group].get(i)?;
                if tile.mixed(first + i) {
                    return None;
                }
                tile.on_map(shift, height - usize::from(shift.ty == 0.0), width)
            });
            scores.overhang.clear();
            for (i, on_map) in on_map.iter().enumerate().take(group) {
                if on_map.is_none() {
                    tile.copy_nodes(first + i, height, width, T::from_f64(outside), &mut scores.overhang);
                }
            }
            let mut copied = scores.overhang.chunks_exact(height * width);
            let samples: [TileSample<'_, T>; GROUP] = std::array::from_fn(|i| {
                let k = (first + i).min(tile.shifts.len() - 1);
                let (nodes, stride) = match on_map[i] {
                    Some(at) => (&tile.nodes(k)[at..], tile.map_columns()),
                    None => (copied.next().unwrap_or(&[]), width),
                };
                let weight = tile.weights.map_or(T::from_f64(1.0), |w| w[k]);
                TileSample::new(&tile.shifts[k], nodes, stride, tile.measured[k], weight)
            });
            // The limit falls as other tiles are finished; what rounding leaves undecided is worked out.
            // A score is divided by its own sum of weights, in T: up to half a rounding a sample beyond that in double.
            let slack = 1e-12 + (tile.shifts.len() + 8) as f64 * T::epsilon();
            let limit = contest.filter(|_| first > 0).map(|best| best.limit() * tile.total_weight * (1.0 + slack));
            for (i, sums) in sums.chunks_exact_mut(pair * lanes).enumerate() {
                if scores.given_up[i] {
                    continue;
                }
                scores.given_up[i] = limit.is_some_and(|limit| Self::least_sum(sums, lanes) > limit);
                if scores.given_up[i] {
                    continue;
                }
                let sums = T::vectors_mut::<S>(sums);
                let block = TileBlock { simd, measure, samples: &samples[..group], column: i * PAIR * lanes };
                // Rows whose sums fit into registers, with room for what is worked on.
                let mut row = 0;
                while row < rows {
                    let sums = &mut sums[row * PAIR * slots..];
                    row += match (S::REGISTER_COUNT * 5 / 8 / (PAIR * slots)).min(rows - row) {
                        8.. => block.add::<FULL, 8>(row, sums),
                        4..8 => block.add::<FULL, 4>(row, sums),
                        2..4 => block.add::<FULL, 2>(row, sums),
                        _ => block.add::<FULL, 1>(row, sums),
                    };
                }
            }
        }
        scores.scores.clear();
        scores.scores.resize(rows * columns, f64::NAN);
        for (i, sums) in sums.chunks_exact(pair * lanes).enumerate().filter(|(i, _)| !scores.given_up[*i]) {
            for (at, sums) in sums.chunks_exact(slots * lanes).enumerate() {
                let (row, column) = (at / PAIR, (i * PAIR + at % PAIR) * lanes);
                let columns = row * columns + column.min(columns)..row * columns + (column + lanes).min(columns);
                Self::finish(&tile, measure, sums, lanes, &mut scores.scores[columns]);
            }
        }
    }
}

impl<T: Real, M: Measure, const FULL: bool> ScoreTile<'_, '_, T, M, FULL> {
    const SLOTS: usize = if FULL { OWN + M::SLOTS_WEIGHTED } else { M::SLOTS };

    /// Least of the measure's first sums.
    #[inline(always)]
    fn least_sum(sums: &[T], lanes: usize) -> f64 {
        let own = if FULL { OWN * lanes } else { 0 };
        let mut least = [T::from_f64(f64::INFINITY); MAX_LANES];
        for vector in sums.chunks_exact(Self::SLOTS * lanes) {
            for (least, &sum) in least.iter_mut().zip(&vector[own..own + lanes]) {
                *least = if sum < *least { sum } else { *least };
            }
        }
        least[..lanes].iter().fold(f64::INFINITY, |a, b| a.min(b.to_f64()))
    }

    /// Scores of one vector of offsets, as many as `out` has room for.
    #[inline(always)]
    fn finish(tile: &Tile<'_, T>, measure: M, sums: &[T], lanes: usize, out: &mut [f64]) {
        let (samples, min_samples) = (tile.shifts.len() as f64, tile.min_samples as f64);
        let mut all = [f64::NAN; MAX_LANES];
        for (lane, all) in all[..lanes].iter_mut().enumerate() {
            let mut at = [0.0; OWN + MAX_SLOTS];
            for slot in 0..Self::SLOTS {
                at[slot] = sums[slot * lanes + lane].to_f64();
            }
            let [a, b, c, d, e, f, g] = at;
            let (count, weight, own) =
                if FULL { (a, b, [c, d, e, f, g]) } else { (samples, tile.total_weight, [a, b, c, d, e]) };
            let score = measure.finish(own, weight, FULL);
            *all = if count >= min_samples && weight > 0.0 { score } else { f64::NAN };
        }
        out.copy_from_slice(&all[..out.len()]);
    }
}

/// What is constant for one sample over a tile. With t the fraction towards the next node, (1 - t) a + t b is
/// (1 - t)(a + ratio b): one operation, and 1 - t goes into the weights of the rows. It is never zero, and however small
/// it is the relative rounding is the same.
#[derive(Clone, Copy)]
struct TileSample<'a, T> {
    nodes: &'a [T],
    stride: usize,
    ratio: T,
    /// Whether offsets lie between node rows.
    between: bool,
    /// Weights of the node rows below and above.
    below: T,
    above: T,
    v: T,
    weight: T,
}

impl<'a, T: Real> TileSample<'a, T> {
    fn new(shift: &Shift, nodes: &'a [T], stride: usize, v: T, weight: T) -> Self {
        let (tx, rest) = (shift.tx, 1.0 - shift.tx);
        let between = shift.ty > 0.0;
        let ty = if between { shift.ty } else { 1.0 };
        Self {
            nodes,
            stride,
            ratio: T::from_f64(tx / rest),
            between,
            below: T::from_f64((1.0 - ty) * rest),
            above: T::from_f64(ty * rest),
            v,
            weight,
        }
    }
}

impl<T: Real> TileSample<'_, T> {
    /// A pair of vectors of a node row, interpolated along x, up to the factor that is in the weights of the rows.
    #[inline(always)]
    fn along<S: Simd, const FULL: bool>(&self, simd: S, ratio: T::Vector<S>, nodes: &[T]) -> [T::Vector<S>; PAIR] {
        let lanes = T::lanes::<S>();
        let nodes = &nodes[..=PAIR * lanes];
        let near = [T::vectors::<S>(&nodes[..lanes]).0[0], T::vectors::<S>(&nodes[lanes..2 * lanes]).0[0]];
        let mut far = if lanes * size_of::<T>() == LINE {
            // Every load that is not aligned straddles two lines: turning what is there costs less than another.
            let after = T::splat(simd, nodes[2 * lanes]);
            [T::one_later(simd, near[0], near[1]), T::one_later(simd, near[1], after)]
        } else {
            [T::vectors::<S>(&nodes[1..=lanes]).0[0], T::vectors::<S>(&nodes[lanes + 1..]).0[0]]
        };
        if FULL {
            // A neighbour without a weight may be unknown.
            let own = T::splat(simd, if self.ratio.to_f64() > 0.0 { T::default() } else { T::from_f64(f64::NAN) });
            far = [T::if_known(simd, own, far[0], near[0]), T::if_known(simd, own, far[1], near[1])];
        }
        [T::fma(simd, ratio, far[0], near[0]), T::fma(simd, ratio, far[1], near[1])]
    }
}

/// A pair of vectors of offsets and the samples that are added to their sums.
struct TileBlock<'a, S, T, M> {
    simd: S,
    measure: M,
    samples: &'a [TileSample<'a, T>],
    column: usize,
}

/// The same for every row of a block: a loop that the compiler leaves as one keeps its sums in memory.
macro_rules! for_each_row {
    ($r:ident, $body:block) => {
        for_each_row!($r, $body, 0 1 2 3 4 5 6 7)
    };
    ($r:ident, $body:block, $($i:literal)*) => {
        $({
            let $r: usize = $i;
            $body
        })*
    };
}

impl<S: Simd, T: Real, M: Measure> TileBlock<'_, S, T, M> {
    const fn slots<const FULL: bool>() -> usize {
        if FULL { OWN + M::SLOTS_WEIGHTED } else { M::SLOTS }
    }

    #[inline(always)]
    fn load<const FULL: bool>(&self, sums: &[T::Vector<S>]) -> [T::Vector<S>; OWN + MAX_SLOTS] {
        let zero = T::splat(self.simd, T::default());
        let mut own = [zero, zero, zero, zero, zero, zero, zero];
        own[..Self::slots::<FULL>()].copy_from_slice(&sums[..Self::slots::<FULL>()]);
        own
    }

    /// Adds the samples to the sums of `R` rows, at most eight, which stay in registers meanwhile; returns `R`.
    #[inline(always)]
    #[allow(unused_assignments)] // by the last row
    fn add<const FULL: bool, const R: usize>(&self, row: usize, sums: &mut [T::Vector<S>]) -> usize {
        let simd = self.simd;
        let slots = Self::slots::<FULL>();
        let sums = &mut sums[..R * PAIR * slots];
        let zero = T::splat(simd, T::default());
        let none = [zero, zero, zero, zero, zero, zero, zero];
        let pair = [none, none];
        let mut own = [pair, pair, pair, pair, pair, pair, pair, pair];
        for_each_row!(r, {
            if r < R {
                own[r][0] = self.load::<FULL>(&sums[r * PAIR * slots..]);
                own[r][1] = self.load::<FULL>(&sums[(r * PAIR + 1) * slots..]);
            }
        });
        for sample in self.samples {
            let row_weights = [T::splat(simd, sample.below), T::splat(simd, sample.above)];
            let ratio = T::splat(simd, sample.ratio);
            let v = T::splat(simd, sample.v);
            let weight = T::splat(simd, sample.weight);
            let mut nodes = &sample.nodes[row * sample.stride + self.column..];
            let mut below = [zero, zero];
            if sample.between {
                below = sample.along::<S, FULL>(simd, ratio, nodes);
                nodes = &nodes[sample.stride..];
            }
            for_each_row!(r, {
                if r < R {
                    if r > 0 {
                        nodes = &nodes[sample.stride..];
                    }
                    let above = sample.along::<S, FULL>(simd, ratio, nodes);
                    let m = [
                        T::fma(simd, row_weights[1], above[0], T::mul(simd, row_weights[0], below[0])),
                        T::fma(simd, row_weights[1], above[1], T::mul(simd, row_weights[0], below[1])),
                    ];
                    below = above;
                    if FULL {
                        // The row below an offset on a node row has no weight and may be unknown.
                        let keep = T::splat(simd, if sample.between { T::default() } else { T::from_f64(f64::NAN) });
                        below = [T::if_known(simd, keep, above[0], zero), T::if_known(simd, keep, above[1], zero)];
                    }
                    self.add_one::<FULL>(&mut own[r][0], m[0], v, weight);
                    self.add_one::<FULL>(&mut own[r][1], m[1], v, weight);
                }
            });
        }
        for_each_row!(r, {
            if r < R {
                sums[r * PAIR * slots..][..slots].copy_from_slice(&own[r][0][..slots]);
                sums[(r * PAIR + 1) * slots..][..slots].copy_from_slice(&own[r][1][..slots]);
            }
        });
        R
    }

    #[inline(always)]
    fn add_one<const FULL: bool>(
        &self,
        own: &mut [T::Vector<S>; OWN + MAX_SLOTS],
        m: T::Vector<S>,
        v: T::Vector<S>,
        weight: T::Vector<S>,
    ) {
        let simd = self.simd;
        if FULL {
            let zero = T::splat(simd, T::default());
            let weight = T::if_known(simd, m, weight, zero);
            own[0] = T::add(simd, own[0], T::if_known(simd, m, T::splat(simd, T::from_f64(1.0)), zero));
            own[1] = T::add(simd, own[1], weight);
            let m = T::if_known(simd, m, m, v);
            self.measure.add::<S, T, true>(simd, &mut own[OWN..], m, v, weight);
        } else {
            self.measure.add::<S, T, false>(simd, own, m, v, weight);
        }
    }
}
