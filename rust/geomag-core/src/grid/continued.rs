//! The map as it would look from higher up: what a matcher compares with to find out whether its readings came from there.

// A kernel that is not inlined is not compiled for the instruction set that was chosen.
#![allow(clippy::inline_always)]

use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use super::GridMap;
use crate::field::Field;

/// Heights above the map for which its continuation is kept, metres: from where a survey's map begins to smoothen to where most of its
/// features are gone, each twice the one before.
pub(crate) const HEIGHTS_M: [f64; 5] = [75.0, 150.0, 300.0, 600.0, 1200.0];

/// Standard deviations, in units of the height, of the normal kernels whose mean is that of upward continuation.
///
/// The Poisson kernel of height h, spectrum exp(-k h), is a mixture of normal ones with standard deviation h / |z|, z standard normal (a
/// Cauchy law in the plane; Andrews and Mallows, J. Roy. Stat. Soc. B 36 (1974) 99): these are the middles of seven equal parts of that
/// law.
const KERNELS: [f64; 7] = [11.155, 3.678, 2.157, 1.483, 1.086, 0.805, 0.555];

/// The map at a height as a sum: the weight of the map itself, and of two of its continuations by their numbers.
///
/// Between the heights that are kept it is linear. Below the map, where continuation has no bound, it falls as much as it rises above:
/// the first term in the height.
pub(crate) fn at_height(height_m: f64) -> (f64, [(usize, f64); 2]) {
    let last = HEIGHTS_M.len() - 1;
    let height = height_m.abs().min(HEIGHTS_M[last]);
    let upper = HEIGHTS_M.iter().position(|h| *h >= height).unwrap_or(last);
    let low = if upper == 0 { 0.0 } else { HEIGHTS_M[upper - 1] };
    let part = (height - low) / (HEIGHTS_M[upper] - low);
    let (own, below) = if upper == 0 { (1.0 - part, 0.0) } else { (0.0, 1.0 - part) };
    let sum = [(upper.saturating_sub(1), below), (upper, part)];
    if height_m < 0.0 { (2.0 - own, sum.map(|(i, w)| (i, -w))) } else { (own, sum) }
}

/// Passes of a running mean that make a normal kernel (central limit theorem).
const PASSES: usize = 3;

/// Continued values of a map, each made when it is first asked for and shared by all copies of the map.
#[derive(Debug, Clone, Default)]
pub(super) struct Continued(Arc<[OnceLock<Vec<f32>>; HEIGHTS_M.len()]>);

/// What is derived from the values makes no map different from another.
impl PartialEq for Continued {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl GridMap {
    /// The values, less the map's mean, continued upward to one of [`HEIGHTS_M`]; NaN on holes.
    ///
    /// About a hole and the border the known part alone is continued, as if the field went on beyond at its local mean.
    pub(crate) fn continued(&self, index: usize) -> &[f32] {
        self.continued.0[index].get_or_init(|| apart(|| self.continue_by(HEIGHTS_M[index])))
    }

    fn continue_by(&self, height_m: f64) -> Vec<f32> {
        let (columns, rows) = (self.x.len(), self.y.len());
        let mean = self.mean;
        let node = |i| self.values.get(i);
        let nodes = (0..columns * rows).into_par_iter();
        let known: Vec<f32> = nodes.clone().map(|i| if node(i).is_nan() { 0.0 } else { 1.0 }).collect();
        let values: Vec<f32> = nodes.map(node).map(|v| if v.is_nan() { 0.0 } else { (v - mean) as f32 }).collect();
        let [_, north] = self.metres_per_unit(0.5 * (self.y.first() + self.y.last()));
        let of_row = |row: usize| {
            let [east, _] = self.metres_per_unit(self.y.at(row));
            east * self.x.step()
        };
        let cell_m = north * self.y.step();
        let mut by_rows = vec![[0.0; LANES]; rows.div_ceil(LANES) * columns];
        let mut continued = |plane: &[f32]| {
            // By columns of blocks, as `along_columns` leaves them.
            let mut total = vec![0.0_f32; columns.div_ceil(LANES) * rows * LANES];
            for kernel in KERNELS {
                let sigma_m = kernel * height_m;
                along_rows(plane, columns, |row| sigma_m / of_row(row), &mut by_rows);
                along_columns(&by_rows, columns, rows, sigma_m / cell_m, &mut total);
            }
            total
        };
        let (sum, weight) = (continued(&values), continued(&known));
        let mut out = vec![f32::NAN; columns * rows];
        out.par_chunks_mut(columns).zip(known.par_chunks(columns)).enumerate().for_each(|(row, (out, known))| {
            for (block, (out, known)) in out.chunks_mut(LANES).zip(known.chunks(LANES)).enumerate() {
                let at = (block * rows + row) * LANES;
                for ((out, known), (sum, weight)) in out.iter_mut().zip(known).zip(sum[at..].iter().zip(&weight[at..]))
                {
                    if *known > 0.0 {
                        *out = sum / weight.max(f32::MIN_POSITIVE);
                    }
                }
            }
        });
        out
    }
}

/// What `work` gives, computed by as many threads as there are here, none of which does anything else.
///
/// A thread that waits for its share to be done takes up other work of its pool, which may ask for what it is itself just making, and
/// would wait for ever.
fn apart<T: Send>(work: impl Fn() -> T + Sync) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(rayon::current_num_threads()).build().ok();
    let done = pool.and_then(|pool| {
        std::thread::scope(|scope| {
            let waiting = std::thread::Builder::new().spawn_scoped(scope, || pool.install(&work)).ok()?;
            Some(waiting.join())
        })
    });
    match done {
        Some(done) => done.unwrap_or_else(|panic| std::panic::resume_unwind(panic)),
        // The system grants no more threads.
        None => work(),
    }
}

/// Lines that are smoothed side by side.
const LANES: usize = 16;

/// A sample of each of the lines that are smoothed side by side.
type Lines = [f32; LANES];

/// Smooths the rows of `plane` into blocks of [`LANES`] rows; `cells` is the standard deviation in a row, which those of a block share.
fn along_rows(plane: &[f32], columns: usize, cells: impl Fn(usize) -> f64 + Sync, out: &mut [Lines]) {
    let blocks = plane.par_chunks(columns * LANES).zip(out.par_chunks_mut(columns)).enumerate();
    blocks.for_each_init(Vec::new, |sums, (block, (rows, lines))| {
        for (lane, row) in rows.chunks(columns).enumerate() {
            for (at, v) in lines.iter_mut().zip(row) {
                at[lane] = *v;
            }
        }
        let middle = block * LANES + rows.len() / columns / 2;
        smooth(lines, cells(middle), sums);
    });
}

/// Adds what [`along_rows`] gave, with its columns smoothed, to `total`, which has the columns in blocks of [`LANES`].
fn along_columns(by_rows: &[Lines], columns: usize, rows: usize, cells: f64, total: &mut [f32]) {
    let blocks = total.par_chunks_mut(rows * LANES).enumerate();
    blocks.for_each_init(Default::default, |(lines, sums): &mut (Vec<Lines>, Vec<_>), (block, total)| {
        let first = block * LANES;
        let width = LANES.min(columns - first);
        lines.resize(rows, [0.0; LANES]);
        for (lines, above) in lines.chunks_mut(LANES).zip(by_rows.chunks(columns)) {
            for (lane, column) in above[first..first + width].iter().enumerate() {
                for (line, v) in lines.iter_mut().zip(column) {
                    line[lane] = *v;
                }
            }
        }
        smooth(lines, cells, sums);
        for (total, v) in total.iter_mut().zip(lines.as_flattened()) {
            *total += v;
        }
    });
}

/// Smooths lines by about a normal kernel of that standard deviation in cells; nothing lies beyond their ends.
fn smooth(lines: &mut [Lines], sigma: f64, sums: &mut Vec<[f64; LANES]>) {
    // A running mean over 2 r + 1 cells, with a part f of the two next ones, has the variance of its offsets.
    let wanted = sigma * sigma / PASSES as f64;
    let variance = |r: f64, f: f64| {
        let sum = r * (r + 1.0) * (2.0 * r + 1.0) / 3.0 + 2.0 * f * (r + 1.0).powi(2);
        sum / (2.0 * r + 1.0 + 2.0 * f)
    };
    let mut radius = ((3.0 * wanted + 0.25).sqrt() - 0.5).floor().max(0.0);
    radius = radius.min(lines.len() as f64);
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if variance(radius, middle) < wanted { low = middle } else { high = middle }
    }
    crate::instructions::chosen().dispatch(RunningMean { lines, sums, radius: radius as usize, part: low });
}

/// [`PASSES`] of a running mean over 2 `radius` + 1 cells and a part of the two next ones.
struct RunningMean<'a> {
    lines: &'a mut [Lines],
    sums: &'a mut Vec<[f64; LANES]>,
    radius: usize,
    part: f64,
}

impl pulp::WithSimd for RunningMean<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        let Self { lines, sums, radius, part } = self;
        let n = lines.len();
        let whole = 1.0 / (2.0 * radius as f64 + 1.0 + 2.0 * part);
        sums.resize(n + 1, [0.0; LANES]);
        for _ in 0..PASSES {
            let mut sum = [0.0_f64; LANES];
            for (after, line) in sums[1..].iter_mut().zip(lines.iter()) {
                for l in 0..LANES {
                    sum[l] += f64::from(line[l]);
                }
                *after = sum;
            }
            for (i, line) in lines.iter_mut().enumerate() {
                let (to, from) = (&sums[(i + radius + 1).min(n)], &sums[i.saturating_sub(radius)]);
                let (beyond, before) = (&sums[(i + radius + 2).min(n)], &sums[i.saturating_sub(radius + 1)]);
                for l in 0..LANES {
                    let inner = to[l] - from[l];
                    let outer = beyond[l] - before[l] - inner;
                    line[l] = ((inner + part * outer) * whole) as f32;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::GridValues;

    #[test]
    fn a_wave_is_damped_by_its_wave_number_times_the_height() {
        let axis: Vec<f64> = (0..161).map(|i| 100.0 * f64::from(i)).collect();
        for wavelength in [1200.0_f64, 2500.0, 5000.0] {
            let k = std::f64::consts::TAU / wavelength;
            let values = axis.iter().flat_map(|_| axis.iter().map(move |x| 10.0 * (k * (x - 8000.0)).cos())).collect();
            let map = GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap();
            for (index, height) in HEIGHTS_M.iter().enumerate().filter(|(_, h)| **h <= 600.0) {
                let found = f64::from(map.continued(index)[80 * 161 + 80]) + map.mean();
                let expected = 10.0 * (-k * height).exp();
                assert!((found - expected).abs() < 0.6, "{wavelength} m at {height} m: {found} {expected}");
            }
        }
    }

    #[test]
    fn many_threads_that_ask_at_once_get_an_answer() {
        let axis: Vec<f64> = (0..120).map(|i| 100.0 * f64::from(i)).collect();
        let values: Vec<f64> = (0..120 * 120).map(|i| f64::from(i % 37)).collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().unwrap();
        for _ in 0..40 {
            let map = GridMap::new(GridValues::F64(values.clone()), &axis, &axis, false).unwrap();
            pool.scope(|scope| {
                for i in 0..400 {
                    let map = &map;
                    scope.spawn(move |_| assert!(map.continued(i % HEIGHTS_M.len())[i].is_finite()));
                }
            });
        }
    }

    #[test]
    fn a_constant_stays_and_a_hole_stays_one() {
        let axis: Vec<f64> = (0..30).map(|i| 100.0 * f64::from(i)).collect();
        let mut values = vec![7.0; 900];
        values[310] = f64::NAN;
        let map = GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap();
        let up = map.continued(2);
        assert!(up[310].is_nan());
        assert!(up.iter().enumerate().all(|(i, v)| i == 310 || v.abs() < 1e-5));
    }
}
