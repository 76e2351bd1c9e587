//! The Kalman filter itself: a mean and a covariance of any number of states, of which all but the first few only decay.

// Matrices are indexed as the formulas are.
#![allow(clippy::needless_range_loop)]

use serde::{Deserialize, Serialize};

use super::motion::{COUPLED, INS_STATES, Rows};

/// Greatest size of a state and of its standard deviation, in whatever unit, in a filter that is read back: squares of it, and what a
/// step makes of them, are numbers.
const MOST: f64 = 1e60;
/// How far below zero an eigenvalue of the correlations may lie for rounding's sake.
const ROUNDING: f64 = 1e-6;
/// Share of the variances in a measurement below which its own is lost to rounding.
const RESOLVED: f64 = 1e-10;

/// Room for a row: a multiple of the widest vector.
fn padded(states: usize) -> usize {
    states.div_ceil(8) * 8
}

/// Mean and covariance of the errors; the covariance is symmetric, updated in Joseph's form.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct ErrorFilter {
    states: usize,
    /// Padded with zeros, as the rows of the covariance are.
    mean: Vec<f64>,
    /// Row-major, rows padded.
    covariance: Vec<f64>,
}

/// What is predicted of one number that is measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct Predicted {
    /// Variance of the prediction alone, H P H'.
    pub variance: f64,
}

/// Buffers that a step needs, kept so that no step allocates.
#[derive(Debug, Clone, Default)]
pub(super) struct FilterScratch {
    product: Vec<f64>,
    turned: Vec<f64>,
    gain: Vec<f64>,
    /// P H' of the newest measurement.
    pub cross: Vec<f64>,
}

/// y += a x.
#[inline]
fn add_scaled(y: &mut [f64], a: f64, x: &[f64]) {
    for (y, x) in y.chunks_exact_mut(8).zip(x.chunks_exact(8)) {
        for k in 0..8 {
            y[k] += a * x[k];
        }
    }
}

impl ErrorFilter {
    /// Zero mean and these variances.
    pub fn new(variances: &[f64]) -> Self {
        let states = variances.len();
        let stride = padded(states);
        let mut covariance = vec![0.0; states * stride];
        for (i, v) in variances.iter().enumerate() {
            covariance[i * stride + i] = *v;
        }
        Self { states, mean: vec![0.0; stride], covariance }
    }

    /// Whether saved numbers make a filter of so many states.
    pub fn is_whole(&self, states: usize) -> bool {
        let stride = padded(states);
        self.states == states
            && self.mean.len() == stride
            && self.covariance.len() == states * stride
            && self.mean.iter().all(|v| v.abs() <= MOST)
            && (0..states).all(|i| (0.0..=MOST * MOST).contains(&self.at(i, i)))
            && self.is_covariance()
    }

    /// Whether the covariance could be one, but for rounding: its correlations have a Cholesky factor.
    fn is_covariance(&self) -> bool {
        let n = self.states;
        let sigma: Vec<f64> = (0..n).map(|i| self.at(i, i).sqrt()).collect();
        let known = |i: usize| sigma[i] > 0.0;
        let alike = (0..n).all(|i| (0..i).all(|j| self.at(i, j) == self.at(j, i)));
        // A variance that is zero may have been too small for a number, and a covariance beside it is then no larger than that allows.
        let least = f64::MIN_POSITIVE.sqrt();
        let certain = (0..n).all(|i| known(i) || (0..n).all(|j| self.at(i, j).abs() <= least * sigma[j]));
        let correlations = nalgebra::DMatrix::from_fn(n, n, |i, j| {
            let own = if i == j { 1.0 + ROUNDING } else { 0.0 };
            if i == j || !known(i) || !known(j) { own } else { self.at(i, j) / sigma[i] / sigma[j] }
        });
        alike && certain && correlations.cholesky().is_some()
    }

    pub fn len(&self) -> usize {
        self.states
    }

    pub fn mean(&self) -> &[f64] {
        &self.mean[..self.states]
    }

    pub fn mean_mut(&mut self) -> &mut [f64] {
        &mut self.mean[..self.states]
    }

    /// Covariance of two states.
    pub fn at(&self, i: usize, j: usize) -> f64 {
        self.covariance[i * padded(self.states) + j]
    }

    /// Sets a covariance, both ways.
    pub fn set(&mut self, i: usize, j: usize, value: f64) {
        let stride = padded(self.states);
        self.covariance[i * stride + j] = value;
        self.covariance[j * stride + i] = value;
    }

    /// Adds to a variance.
    pub fn widen(&mut self, i: usize, variance: f64) {
        let stride = padded(self.states);
        self.covariance[i * stride + i] += variance;
    }

    /// Makes a state independent of all others, with a variance of its own.
    pub fn separate(&mut self, i: usize, variance: f64) {
        for j in 0..self.states {
            self.set(i, j, 0.0);
        }
        self.set(i, i, variance);
    }

    /// x <- Phi x, P <- Phi P Phi' + Q, with the coupled rows of Phi, a factor for every other state, and a diagonal Q.
    pub fn predict(&mut self, phi: &Rows, factors: &[f64], noise: &[f64], scratch: &mut FilterScratch) {
        let (n, stride) = (self.states, padded(self.states));
        let product = &mut scratch.product;
        product.clear();
        product.resize(n * stride, 0.0);
        let mut moved = [0.0; COUPLED];
        for i in 0..COUPLED {
            let row = &mut product[i * stride..(i + 1) * stride];
            for k in 0..INS_STATES {
                let a = phi[i][k];
                if a != 0.0 {
                    moved[i] += a * self.mean[k];
                    add_scaled(row, a, &self.covariance[k * stride..(k + 1) * stride]);
                }
            }
        }
        self.mean[..COUPLED].copy_from_slice(&moved);
        for i in COUPLED..n {
            let factor = factors[i - COUPLED];
            self.mean[i] *= factor;
            add_scaled(
                &mut product[i * stride..(i + 1) * stride],
                factor,
                &self.covariance[i * stride..(i + 1) * stride],
            );
        }
        // Phi (Phi P)': row by row, from the rows of P Phi'.
        let turned = &mut scratch.turned;
        turned.clear();
        turned.resize(n * stride, 0.0);
        for i in 0..n {
            for j in 0..n {
                turned[j * stride + i] = product[i * stride + j];
            }
        }
        for i in 0..COUPLED {
            let row = &mut self.covariance[i * stride..(i + 1) * stride];
            row.fill(0.0);
            for k in 0..INS_STATES {
                let a = phi[i][k];
                if a != 0.0 {
                    add_scaled(row, a, &turned[k * stride..(k + 1) * stride]);
                }
            }
        }
        for i in COUPLED..n {
            let row = &mut self.covariance[i * stride..(i + 1) * stride];
            row.fill(0.0);
            add_scaled(row, factors[i - COUPLED], &turned[i * stride..(i + 1) * stride]);
        }
        self.make_symmetric();
        for (i, q) in noise.iter().enumerate() {
            self.covariance[i * stride + i] += q;
        }
    }

    /// Shrinks coupled states that are less certain than can be, correlations kept: by how much each, or none where nothing was to do.
    pub fn hold(&mut self, most: &[f64; COUPLED]) -> Option<[f64; COUPLED]> {
        let stride = padded(self.states);
        let mut by = [1.0; COUPLED];
        for i in 0..COUPLED {
            let variance = self.covariance[i * stride + i];
            if variance > most[i] * most[i] {
                by[i] = most[i] / variance.sqrt();
            }
            self.mean[i] = self.mean[i].clamp(-most[i], most[i]);
        }
        if by.iter().all(|b| *b == 1.0) {
            return None;
        }
        for i in 0..COUPLED {
            for j in i..self.states {
                let both = by[i] * if j < COUPLED { by[j] } else { 1.0 };
                let held = self.covariance[i * stride + j] * both;
                self.covariance[i * stride + j] = held;
                self.covariance[j * stride + i] = held;
            }
        }
        Some(by)
    }

    /// What rounding left between the two halves is shared.
    fn make_symmetric(&mut self) {
        let (n, stride) = (self.states, padded(self.states));
        for i in 0..n {
            for j in 0..i {
                let mean = 0.5 * (self.covariance[i * stride + j] + self.covariance[j * stride + i]);
                self.covariance[i * stride + j] = mean;
                self.covariance[j * stride + i] = mean;
            }
        }
    }

    /// H P H' and P H' (kept in `scratch`) of a measurement with few nonzero slopes, `(state, slope)`.
    pub fn project(&self, slopes: &[(usize, f64)], scratch: &mut FilterScratch) -> Predicted {
        let stride = padded(self.states);
        let cross = &mut scratch.cross;
        cross.clear();
        cross.resize(stride, 0.0);
        for &(k, h) in slopes {
            add_scaled(cross, h, &self.covariance[k * stride..(k + 1) * stride]);
        }
        Predicted { variance: slopes.iter().map(|&(k, h)| h * cross[k]).sum::<f64>().max(0.0) }
    }

    /// Least variance of a measurement with these slopes that leaves a covariance: a number measured without error twice, or by states
    /// whose parts in it cancel, is divided by what rounding left.
    pub fn rounding(&self, slopes: &[(usize, f64)]) -> f64 {
        RESOLVED * slopes.iter().map(|&(k, h)| h * h * self.at(k, k)).sum::<f64>()
    }

    /// Takes a number in after [`ErrorFilter::project`] with the same slopes: P <- (I - K H) P (I - K H)' + K R K', which stays positive.
    pub fn update(
        &mut self,
        slopes: &[(usize, f64)],
        predicted: Predicted,
        innovation: f64,
        noise: f64,
        scratch: &mut FilterScratch,
    ) {
        let (n, stride) = (self.states, padded(self.states));
        let total = predicted.variance + noise;
        if !(total > 0.0) {
            return;
        }
        let FilterScratch { gain, cross, .. } = scratch;
        gain.clear();
        gain.extend(cross.iter().map(|c| c / total));
        add_scaled(&mut self.mean, innovation, gain);
        // A = (I - K H) P, in place.
        for i in 0..n {
            add_scaled(&mut self.covariance[i * stride..(i + 1) * stride], -gain[i], cross);
        }
        // A H', then A (I - K H)' + K R K'.
        for i in 0..n {
            let row = &mut self.covariance[i * stride..(i + 1) * stride];
            let left: f64 = slopes.iter().map(|&(k, h)| h * row[k]).sum();
            add_scaled(row, noise * gain[i] - left, gain);
        }
        self.make_symmetric();
    }
}
