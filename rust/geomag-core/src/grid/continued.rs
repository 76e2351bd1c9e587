//! The map as it would look from higher up: what a matcher compares with to find out whether its readings came from there.

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
        self.continued.0[index].get_or_init(|| self.continue_by(HEIGHTS_M[index]))
    }

    fn continue_by(&self, height_m: f64) -> Vec<f32> {
        let (columns, rows) = (self.x.len(), self.y.len());
        let mean = self.mean;
        let known: Vec<f32> =
            (0..columns * rows).map(|i| if self.values.get(i).is_nan() { 0.0 } else { 1.0 }).collect();
        let values: Vec<f32> = (0..columns * rows)
            .map(|i| self.values.get(i))
            .map(|v| if v.is_nan() { 0.0 } else { (v - mean) as f32 })
            .collect();
        let [_, north] = self.metres_per_unit(0.5 * (self.y.first() + self.y.last()));
        let (mut sum, mut weight) = (vec![0.0_f32; values.len()], vec![0.0_f32; values.len()]);
        for kernel in KERNELS {
            let sigma_m = kernel * height_m;
            for (plane, total) in [(&values, &mut sum), (&known, &mut weight)] {
                let mut plane = plane.clone();
                let of_row = |row: usize| {
                    let [east, _] = self.metres_per_unit(self.y.at(row));
                    sigma_m / (east * self.x.step())
                };
                plane.par_chunks_mut(columns).enumerate().for_each(|(row, line)| smooth(line, of_row(row)));
                let mut turned = transposed(&plane, columns);
                let cells = sigma_m / (north * self.y.step());
                turned.par_chunks_mut(rows).for_each(|line| smooth(line, cells));
                for (total, v) in total.iter_mut().zip(transposed(&turned, rows)) {
                    *total += v;
                }
            }
        }
        (sum.iter().zip(&weight).zip(&known))
            .map(|((sum, weight), known)| if *known > 0.0 { sum / weight.max(f32::MIN_POSITIVE) } else { f32::NAN })
            .collect()
    }
}

fn transposed(plane: &[f32], columns: usize) -> Vec<f32> {
    let rows = plane.len() / columns;
    let mut out = vec![0.0; plane.len()];
    out.par_chunks_mut(rows).enumerate().for_each(|(column, line)| {
        for (row, v) in line.iter_mut().enumerate() {
            *v = plane[row * columns + column];
        }
    });
    out
}

/// Smooths a line by about a normal kernel of that standard deviation in cells; nothing lies beyond its ends.
fn smooth(line: &mut [f32], sigma: f64) {
    // A running mean over 2 r + 1 cells, with a part f of the two next ones, has the variance of its offsets.
    let wanted = sigma * sigma / PASSES as f64;
    let variance = |r: f64, f: f64| {
        let sum = r * (r + 1.0) * (2.0 * r + 1.0) / 3.0 + 2.0 * f * (r + 1.0).powi(2);
        sum / (2.0 * r + 1.0 + 2.0 * f)
    };
    let mut radius = ((3.0 * wanted + 0.25).sqrt() - 0.5).floor().max(0.0);
    radius = radius.min(line.len() as f64);
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if variance(radius, middle) < wanted { low = middle } else { high = middle }
    }
    let (part, whole) = (low, 2.0 * radius + 1.0 + 2.0 * low);
    let radius = radius as usize;
    let n = line.len();
    let mut sums = vec![0.0_f64; n + 1];
    for _ in 0..PASSES {
        for i in 0..n {
            sums[i + 1] = sums[i] + f64::from(line[i]);
        }
        let total = |from: i64, to: i64| {
            let at = |i: i64| sums[i.clamp(0, n as i64) as usize];
            at(to) - at(from)
        };
        for (i, v) in line.iter_mut().enumerate() {
            let (from, to) = (i as i64 - radius as i64, i as i64 + radius as i64 + 1);
            let inner = total(from, to);
            let outer = total(from - 1, to + 1) - inner;
            *v = ((inner + part * outer) / whole) as f32;
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
