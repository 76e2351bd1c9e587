//! A measured sequence against a field over the lattice: scores of blocks of offsets, on all threads.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::OffsetLattice;
use super::best_two::BestTwo;
use super::shift::{Classes, Shift, ShiftedRow};
use super::simd::{Real, dispatch};
use super::tile::{Floor, MAX_SLOTS, Measure, TILE_COLUMNS, TILE_ROWS, Tile, TileScores};
use crate::error::{Error, Result, grantable, require_weights};
use crate::field::Field;
use crate::grid::{GridMap, GridValues, Interpolation};
use crate::monitor::Monitor;
use crate::stack::Storey;

/// Offset-samples below which waking other threads costs more than it saves.
const SERIAL: usize = 1 << 16;

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
    /// Heights of the points and where they lie among the levels of a stack; empty on a field of one surface.
    heights_m: Vec<f64>,
    storeys: Vec<Storey>,
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
        if values.len() != n {
            return Err(Error::shape("values", format!("({n},) as the track"), format!("({},)", values.len())));
        }
        if let Some(w) = &weights {
            require_weights(w, n)?;
        }
        Ok(Self {
            field,
            lattice,
            points,
            values,
            weights,
            interpolation,
            min_samples: min_samples.max(1),
            heights_m: Vec::new(),
            storeys: Vec::new(),
        })
    }

    /// The same comparison with the points at these heights, where the field is known at several.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of heights than points, [`Error::Invalid`] for one outside the stack.
    pub fn at_heights(mut self, heights_m: Option<&[f64]>) -> Result<Self> {
        let Some(heights) = heights_m.filter(|_| self.field.as_grid().is_none()) else { return Ok(self) };
        if heights.len() != self.points.len() {
            let needed = format!("({},) as the track", self.points.len());
            return Err(Error::shape("height_m", needed, format!("({},)", heights.len())));
        }
        if let Some(stack) = self.field.as_stack() {
            self.storeys = stack.storeys(heights)?;
        }
        self.heights_m = heights.to_vec();
        Ok(self)
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
        self.around(offset, [0; 2], self.lattice.step)
    }

    /// The same comparison over a lattice of its own about an offset.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for an offset that is no number.
    pub fn around(&self, offset: [f64; 2], half: [usize; 2], step: [f64; 2]) -> Result<Self> {
        crate::error::require_finite("offset", &offset)?;
        let lattice = OffsetLattice { half, step };
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
            None => match (self.field.as_stack(), self.heights_m.get(k)) {
                (Some(stack), Some(&height)) => stack.sample(x + ox, y + oy, height, self.interpolation),
                (None, Some(&height)) => self.field.value_at(x + ox, y + oy, height),
                _ => self.field.value(x + ox, y + oy),
            },
        }
    }

    /// Fast path: the grid and its classes, where they apply.
    fn fast(&self) -> Option<(&GridMap, Classes)> {
        if self.interpolation != Interpolation::Bilinear {
            return None;
        }
        let grid = self.field.layout().filter(|_| self.field.as_stack().is_none() || !self.storeys.is_empty())?;
        Some((grid, Classes::of(grid, self.lattice.step)?))
    }

    /// Relative rounding of the numbers that scores are summed from.
    pub fn epsilon(&self) -> f64 {
        match self.fast().map(|(grid, _)| grid.values()) {
            Some(GridValues::F32(_)) => f64::from(f32::EPSILON),
            _ => f64::EPSILON,
        }
    }

    fn weight(&self, k: usize) -> f64 {
        self.weights.as_ref().map_or(1.0, |w| w[k])
    }

    /// Scores of all candidates of `rows` x `columns`, row-major, NaN where too few samples are known.
    ///
    /// Where only the `best` two are wanted, a candidate that is neither may be NaN as well: it is given up as soon as
    /// its partial sum says so. Same input, same bits of what is wanted, for any number of threads.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn scores<M: Measure>(
        &self,
        measure: M,
        rows: Range<usize>,
        columns: Range<usize>,
        best: Option<&BestTwo>,
        monitor: &dyn Monitor,
    ) -> Result<Vec<f64>> {
        grantable::<f64>("scores", rows.len() * columns.len())?;
        // Every place is written; zeros come from the system untouched, so that the threads share the first touch.
        let mut out = vec![0.0; rows.len() * columns.len()];
        if let Some((grid, classes)) = self.fast() {
            match grid.values() {
                GridValues::F64(v) => {
                    self.scores_fast(measure, grid, v, classes, rows, columns, best, &mut out, monitor)?;
                }
                GridValues::F32(v) => {
                    self.scores_fast(measure, grid, v, classes, rows, columns, best, &mut out, monitor)?;
                }
            }
        } else {
            let score = |m: &[f64], known: &[usize]| {
                let mut sums = [0.0_f64; MAX_SLOTS];
                let mut weight = 0.0;
                for (&m, &k) in m.iter().zip(known) {
                    let w = self.weight(k);
                    measure.add::<pulp::Scalar, f64, true>(pulp::Scalar::new(), &mut sums, m, self.values[k], w);
                    weight += w;
                }
                if weight > 0.0 { measure.finish(sums, weight, true) } else { f64::NAN }
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
        grantable::<f64>("scores", rows.len() * columns.len())?;
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
        let done = AtomicU64::new(0);
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
                    *out = if known.len() >= self.min_samples { score(values, known) } else { f64::NAN };
                }
            }
            let finished = done.fetch_add(1, Ordering::Relaxed) + 1;
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
            let level = |grid: &GridMap, out: &mut [f64]| match grid.values() {
                GridValues::F64(v) => dispatch(ShiftedRow { values: v, grid, shift, out, first: class, stride: qx }),
                GridValues::F32(v) => dispatch(ShiftedRow { values: v, grid, shift, out, first: class, stride: qx }),
            };
            let (Some(stack), Some(storey)) = (self.field.as_stack(), self.storeys.get(k)) else {
                level(grid, out);
                continue;
            };
            level(&stack.levels()[storey.level], out);
            if storey.share > 0.0 {
                let mut above = vec![0.0; out.len()];
                level(&stack.levels()[storey.level + 1], &mut above);
                for (out, above) in out.iter_mut().zip(&above).skip(class).step_by(qx) {
                    *out += storey.share * (above - *out);
                }
            }
        }
    }

    /// Where the nodes of every sample are read, on a stack of levels; empty on a map.
    fn floors<T: Real>(&self) -> Vec<Floor<'a, T>> {
        let Some(stack) = self.field.as_stack() else { return Vec::new() };
        let nodes = |level: usize| T::of(stack.levels()[level].values());
        let floor = |storey: &Storey| Floor {
            below: nodes(storey.level),
            above: (storey.share > 0.0).then(|| (nodes(storey.level + 1), T::from_f64(storey.share))),
            grids: [storey.level, storey.level + usize::from(storey.share > 0.0)].map(|level| &*stack.levels()[level]),
        };
        self.storeys.iter().map(floor).collect()
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
        best: Option<&BestTwo>,
        out: &mut [f64],
        monitor: &dyn Monitor,
    ) -> Result<()> {
        let positions: Vec<[f64; 2]> = self.points.iter().map(|p| grid.position(p[0], p[1])).collect();
        let measured: Vec<T> = self.values.iter().map(|&v| T::from_f64(v)).collect();
        let weights: Option<Vec<T>> = self.weights.as_ref().map(|w| w.iter().map(|&w| T::from_f64(w)).collect());
        let floors = self.floors::<T>();
        let total_weight: f64 = (0..self.points.len()).map(|k| self.weight(k)).sum();
        let [qx, qy] = classes.per_cell;
        let width = columns.len();
        // A band is the rows of one tile in every class: threads own bands of the output, never share a cache line.
        let band_rows = TILE_ROWS * qy;
        let bands = rows.len().div_ceil(band_rows) as u64;
        let done = AtomicU64::new(0);
        let half = self.lattice.half.map(|h| h as i64);
        let work = |(scores, shifts): &mut (TileScores<T>, Vec<Shift>), band: usize, out_band: &mut [f64]| {
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
                            grid,
                            floors: &floors,
                            shifts,
                            measured: &measured,
                            weights: weights.as_deref(),
                            total_weight,
                            min_samples: self.min_samples,
                            best,
                            first_column: start as i64,
                            rows: tile_rows,
                            columns: TILE_COLUMNS.min(class_columns - start),
                        };
                        tile.score(measure, scores);
                        for r in 0..tile_rows {
                            let at = (cy + r * qy) * width + cx + start * qx;
                            let row = scores.row(r, tile.columns);
                            if qx == 1 {
                                out_band[at..at + row.len()].copy_from_slice(row);
                            } else {
                                out_band[at..].iter_mut().step_by(qx).zip(row).for_each(|(out, score)| *out = *score);
                            }
                        }
                        if let Some(best) = best.filter(|_| M::GROWS) {
                            let (score, r, c) = scores.least(tile.columns);
                            best.finished(score, first_row + cy + r * qy, columns.start + cx + (start + c) * qx);
                        }
                    }
                }
            }
            let finished = done.fetch_add(1, Ordering::Relaxed) + 1;
            monitor.advance(finished, bands)
        };
        let scratch = || (TileScores::<T>::default(), Vec::with_capacity(positions.len()));
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
