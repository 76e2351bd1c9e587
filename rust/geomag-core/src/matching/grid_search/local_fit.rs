//! Gauss-Newton at a matched track: what its covariance is, given the noise and the map's gradient.

use nalgebra::{DMatrix, DVector};

use super::options::GridSearch;
use crate::field::Field;
use crate::lattice::OffsetLattice;
use crate::matching::similarity::Criterion;
use crate::track::Track;

/// Noise and curvature at the answer.
pub(super) struct LocalFit {
    /// Samples with a weight, a map value and a gradient.
    pub samples: usize,
    /// Mean of measured minus map, where a mean was removed.
    pub bias: Option<f64>,
    /// Covariance of the newest position, square metres, east-north.
    pub covariance_m2: Option<[[f64; 2]; 2]>,
    /// Sum of squared residuals (weighted) at the minimum of the linearised fit, and what is left of the samples after
    /// its unknowns.
    pub least_squares: Option<(f64, usize)>,
    /// Whether the curvature has a direction without information.
    flat: bool,
}

impl LocalFit {
    /// Gauss-Newton at the matched points over east, north and whatever else was searched: heading, scale, constant,
    /// and for the correlation coefficient the gain.
    #[allow(clippy::too_many_lines)] // one set of normal equations, built row by row
    pub fn new(
        field: &dyn Field,
        track: &Track,
        search: &GridSearch,
        moved: &[[f64; 2]],
        placements: &[(f64, f64)],
        chosen: (f64, f64),
    ) -> Self {
        let free_mean = search.remove_mean || search.criterion == Criterion::Ncc;
        let gain = search.criterion == Criterion::Ncc;
        let turning = placements.iter().any(|p| p.0 != placements[0].0);
        let stretching = placements.iter().any(|p| p.1 != placements[0].1);
        // Whatever point the search turned the track about, the newest is the one whose covariance is asked for; told about it,
        // heading and scale span the same motions.
        let newest = moved[moved.len() - 1];
        let mut rows: Vec<(Vec<f64>, f64, f64)> = Vec::with_capacity(moved.len());
        for (k, p) in moved.iter().enumerate() {
            let weight = search.weights.as_ref().map_or(1.0, |w| w[k]);
            if weight == 0.0 {
                continue;
            }
            let (m, [east, north]) = match (field.as_grid(), track.height_m()) {
                (Some(grid), _) => grid.sample_and_gradient(p[0], p[1], search.interpolation),
                (None, Some(heights)) => field.value_and_gradient_at(p[0], p[1], heights[k]),
                (None, None) => field.value_and_gradient(p[0], p[1]),
            };
            if m.is_nan() || east.is_nan() || north.is_nan() {
                continue;
            }
            let [e, n] = field.displacement_m(newest, *p);
            let mut row = vec![east, north];
            if turning {
                row.push(east * n - north * e);
            }
            if stretching {
                row.push(east * e + north * n);
            }
            if free_mean {
                row.push(1.0);
            }
            if gain {
                row.push(m - field.mean());
            }
            rows.push((row, track.values()[k] - m, weight));
        }
        let samples = rows.len();
        let total: f64 = rows.iter().map(|r| r.2).sum();
        let mean = rows.iter().map(|r| r.1 * r.2).sum::<f64>() / total;
        let bias = (search.remove_mean && total > 0.0).then_some(mean);
        let parameters = rows.first().map_or(0, |r| r.0.len());
        let none = Self { samples, bias, covariance_m2: None, least_squares: None, flat: true };
        if samples < parameters.max(2) || total <= 0.0 {
            return none;
        }
        // Columns to unit norm: metres, radians and nanoteslas share one matrix.
        let mut normal = DMatrix::<f64>::zeros(parameters, parameters);
        let mut right = DVector::<f64>::zeros(parameters);
        for (row, r, w) in &rows {
            for i in 0..parameters {
                right[i] += w * row[i] * r;
                for j in 0..parameters {
                    normal[(i, j)] += w * row[i] * row[j];
                }
            }
        }
        let norms: Vec<f64> = (0..parameters).map(|i| normal[(i, i)].sqrt()).collect();
        if norms.iter().any(|n| !(*n > 0.0)) {
            return none;
        }
        for i in 0..parameters {
            right[i] /= norms[i];
            for j in 0..parameters {
                normal[(i, j)] /= norms[i] * norms[j];
            }
        }
        let eigen = normal.clone().symmetric_eigen();
        let (low, high) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
        if !(low > 1e-12 * high) {
            return none;
        }
        let scaled = normal.clone();
        let Some(inverse) = normal.cholesky().map(|c| c.inverse()) else { return none };
        // Residual noise after the nuisance parameters (constant, gain) have taken their share.
        let nuisance = parameters - usize::from(free_mean) - usize::from(gain)..parameters;
        let spread = |power: i32| {
            let mut sum = 0.0;
            let solution = nuisance_solution(&rows, nuisance.clone());
            for (row, r, w) in &rows {
                let fitted: f64 = nuisance.clone().zip(&solution).map(|(i, s)| row[i] * s).sum();
                sum += w * (r - fitted).abs().powi(power);
            }
            sum / total
        };
        let freedom = (samples as f64 / (samples as f64 - parameters as f64).max(1.0)).min(samples as f64);
        let noise = match (search.sigma, search.criterion) {
            (_, Criterion::Prod | Criterion::Hausdorff { .. }) => None,
            (Some(sigma), _) => Some(sigma * sigma),
            // Laplace noise of mean absolute value b: the least-absolute-deviation estimate has covariance b^2 / curvature.
            (None, Criterion::Mad) => Some((spread(1) * freedom).powi(2)),
            (None, _) => Some(spread(2) * freedom),
        };
        let scale = total / samples as f64;
        // Heading and scale stay on their lists: what they are wrong by within a step moves the position with them.
        let columns = (2..).zip(
            [
                (turning, steps(&search.heading_deg, chosen.0).to_radians()),
                (stretching, steps(&search.scale, chosen.1)),
            ]
            .into_iter()
            .filter(|q| q.0),
        );
        let stepped: Vec<(usize, f64)> = columns.map(|(i, (_, width))| (i, width * width / 12.0)).collect();
        let carried = carried(&scaled, &norms, &stepped);
        let covariance_m2 = noise.filter(|_| samples > parameters || search.sigma.is_some()).map(|noise| {
            let at = |i: usize, j: usize| noise * scale * inverse[(i, j)] / (norms[i] * norms[j]);
            let with = |i: usize, j: usize| at(i, j) + carried[i][j];
            [[with(0, 0), with(0, 1)], [with(1, 0), with(1, 1)]]
        });
        let squares: f64 = rows.iter().map(|(_, r, w)| w * r * r).sum();
        let explained = right.dot(&(&inverse * &right));
        let least_squares = (samples > parameters).then(|| ((squares - explained).max(0.0), samples - parameters));
        Self { samples, bias, covariance_m2, least_squares, flat: false }
    }

    /// Adds what a place anywhere within a lattice cell is uncertain by: for an answer that stays on the lattice.
    pub fn spread_over(&mut self, step: [f64; 2], half: [usize; 2], metres: [f64; 2]) {
        if let Some(covariance) = &mut self.covariance_m2 {
            for d in 0..2 {
                // A direction that was not searched has no cell.
                if half[d] > 0 {
                    covariance[d][d] += (step[d] * metres[d]).powi(2) / 12.0;
                }
            }
        }
    }

    /// Whether the position is no better known than the search itself.
    pub fn uninformative(&self, field: &dyn Field, lattice: &OffsetLattice, y: f64) -> bool {
        if self.flat {
            return true;
        }
        let unit = field.metres_per_unit(y);
        let [step, half] = [lattice.step(), lattice.half().map(|h| h as f64)];
        self.covariance_m2
            .is_some_and(|c| (0..2).any(|d| half[d] > 0.0 && c[d][d].sqrt() > half[d].max(1.0) * step[d] * unit[d]))
    }
}

/// Distance between the middles of the gaps about a value of a list; zero for a list of one.
fn steps(list: &[f64], chosen: f64) -> f64 {
    let below = list.iter().copied().filter(|v| *v < chosen).fold(f64::NEG_INFINITY, f64::max);
    let above = list.iter().copied().filter(|v| *v > chosen).fold(f64::INFINITY, f64::min);
    [chosen - below, above - chosen].into_iter().filter(|gap| gap.is_finite()).map(|gap| 0.5 * gap).sum()
}

/// Covariance of the position that comes from parameters held on steps of the given variances, the others free to follow.
fn carried(normal: &DMatrix<f64>, norms: &[f64], stepped: &[(usize, f64)]) -> [[f64; 2]; 2] {
    let mut out = [[0.0; 2]; 2];
    let free: Vec<usize> = (0..norms.len()).filter(|i| stepped.iter().all(|s| s.0 != *i)).collect();
    let Some(factor) = normal.select_rows(&free).select_columns(&free).cholesky() else { return out };
    for &(column, variance) in stepped {
        let follow = factor.solve(&normal.select_rows(&free).column(column).into_owned());
        // Columns were scaled to unit norm: back to metres per radian, or per ratio.
        let moved = [0, 1].map(|d| follow[d] * norms[column] / norms[d]);
        for (i, row) in out.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate() {
                *sum += moved[i] * moved[j] * variance;
            }
        }
    }
    out
}

/// Weighted least squares of the residuals on at most two nuisance columns.
fn nuisance_solution(rows: &[(Vec<f64>, f64, f64)], columns: std::ops::Range<usize>) -> Vec<f64> {
    let n = columns.len();
    if n == 0 {
        return Vec::new();
    }
    let mut normal = DMatrix::<f64>::zeros(n, n);
    let mut right = DVector::<f64>::zeros(n);
    for (row, r, w) in rows {
        for i in 0..n {
            right[i] += w * row[columns.start + i] * r;
            for j in 0..n {
                normal[(i, j)] += w * row[columns.start + i] * row[columns.start + j];
            }
        }
    }
    normal.lu().solve(&right).map_or(vec![0.0; n], |s| s.iter().copied().collect())
}
