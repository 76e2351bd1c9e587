//! Smoothing: what the readings after a step say of it.
//!
//! The modified Bryson-Frazier recursion runs backwards over what the filter did, with the linearisations and weights that it used: an
//! adjoint vector and matrix take the place of the inverse of a covariance, which the recursion of Rauch, Tung and Striebel needs;
//! both give the same.
//!
//! ```text
//! at a measurement    l <- (I - K H)' l - H' y / S        L <- (I - K H)' L (I - K H) + H' H / S
//! at a transition     l <- Phi' l                          L <- Phi' L Phi
//! smoothed            x - P l                              P - P L P
//! ```
//!
//! Source: Bierman, *Factorization Methods for Discrete Sequential Estimation*, ch. X; Gibbs, *Advanced Kalman Filtering*, ch. 6.

use super::filter::ErrorFilter;
use super::motion::{COUPLED, INS_STATES, POSITION, Rows};

/// One thing that the filter did.
#[derive(Debug, Clone)]
enum Deed {
    /// The coupled rows of a transition, and the factors of the other states.
    Moved(Box<Rows>, Vec<f64>),
    /// A number was taken in: slopes, gain, innovation, its variance.
    Measured { slopes: Vec<(usize, f64)>, gain: Vec<f64>, innovation: f64, variance: f64 },
    /// States were replaced by new ones, independent of what was.
    Replaced(Vec<usize>),
    /// The end of a step: the position's mean and its rows of the covariance.
    Stepped { mean: [f64; 2], rows: [Vec<f64>; 2] },
}

/// What a filter did, step by step.
#[derive(Debug, Clone, Default)]
pub(super) struct Record {
    deeds: Vec<Deed>,
    states: usize,
}

/// A smoothed position error: mean and covariance, metres east and north.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Smoothed {
    pub mean: [f64; 2],
    pub covariance: [[f64; 2]; 2],
}

impl Record {
    pub fn moved(&mut self, phi: &Rows, factors: &[f64]) {
        self.deeds.push(Deed::Moved(Box::new(*phi), factors.to_vec()));
    }

    pub fn measured(&mut self, slopes: &[(usize, f64)], cross: &[f64], innovation: f64, variance: f64) {
        let gain = cross.iter().map(|c| c / variance).collect();
        self.deeds.push(Deed::Measured { slopes: slopes.to_vec(), gain, innovation, variance });
    }

    pub fn replaced(&mut self, states: &[usize]) {
        self.deeds.push(Deed::Replaced(states.to_vec()));
    }

    pub fn stepped(&mut self, filter: &ErrorFilter) {
        let n = filter.len();
        self.states = n;
        let mean = [filter.mean()[POSITION], filter.mean()[POSITION + 1]];
        let rows = [POSITION, POSITION + 1].map(|i| (0..n).map(|j| filter.at(i, j)).collect());
        self.deeds.push(Deed::Stepped { mean, rows });
    }

    /// Every step smoothed with what came until its horizon (a step not before it), in the order of the steps.
    ///
    /// Passes over overlapping stretches, each for a fifth of the steps to the horizon: a step sees at least four fifths of what it may.
    pub fn smooth(&self, horizon: impl Fn(usize) -> usize) -> Vec<Smoothed> {
        let ends: Vec<usize> =
            (0..self.deeds.len()).filter(|&k| matches!(self.deeds[k], Deed::Stepped { .. })).collect();
        let steps = ends.len();
        let mut out = Vec::with_capacity(steps);
        let mut first = 0;
        while first < steps {
            let until = horizon(first).clamp(first, steps - 1);
            let last = if until + 1 == steps { steps } else { first + ((until - first) / 5).max(1) };
            let mut stretch = self.back(&ends, first, until);
            stretch.truncate(last - first);
            out.append(&mut stretch);
            first = last;
        }
        out
    }

    /// One pass back from the end of step `horizon` to that of step `first`; answers for all steps between, earliest first.
    fn back(&self, ends: &[usize], first: usize, horizon: usize) -> Vec<Smoothed> {
        let n = self.states;
        let mut adjoint = vec![0.0; n];
        let mut matrix = vec![0.0; n * n];
        let mut buffer = vec![0.0; n * n];
        let mut out = Vec::with_capacity(horizon - first + 1);
        for k in (ends[first]..=ends[horizon]).rev() {
            match &self.deeds[k] {
                Deed::Stepped { mean, rows } => out.push(smoothed(*mean, rows, &adjoint, &matrix)),
                Deed::Moved(phi, factors) => moved_back(phi, factors, &mut adjoint, &mut matrix, &mut buffer),
                Deed::Measured { slopes, gain, innovation, variance } => {
                    measured_back(slopes, gain, *innovation, *variance, &mut adjoint, &mut matrix);
                }
                Deed::Replaced(states) => {
                    for &s in states {
                        adjoint[s] = 0.0;
                        for j in 0..n {
                            matrix[s * n + j] = 0.0;
                            matrix[j * n + s] = 0.0;
                        }
                    }
                }
            }
        }
        out.reverse();
        out
    }
}

fn smoothed(mean: [f64; 2], rows: &[Vec<f64>; 2], adjoint: &[f64], matrix: &[f64]) -> Smoothed {
    let n = adjoint.len();
    let mut out = Smoothed { mean, covariance: [[0.0; 2]; 2] };
    for a in 0..2 {
        out.mean[a] -= rows[a].iter().zip(adjoint).map(|(p, l)| p * l).sum::<f64>();
        let turned: Vec<f64> =
            (0..n).map(|j| rows[a].iter().enumerate().map(|(i, p)| p * matrix[i * n + j]).sum()).collect();
        for b in 0..2 {
            out.covariance[a][b] = rows[a][POSITION + b] - turned.iter().zip(&rows[b]).map(|(t, p)| t * p).sum::<f64>();
        }
    }
    let cross = 0.5 * (out.covariance[0][1] + out.covariance[1][0]);
    for a in 0..2 {
        out.covariance[a][a] = out.covariance[a][a].max(0.0);
    }
    // Where the readings after a step say nearly all, the difference is rounding: it is still to be a covariance.
    let most = (out.covariance[0][0] * out.covariance[1][1]).sqrt();
    let cross = cross.clamp(-most, most);
    (out.covariance[0][1], out.covariance[1][0]) = (cross, cross);
    out
}

/// Phi' l and Phi' L Phi.
fn moved_back(phi: &Rows, factors: &[f64], adjoint: &mut [f64], matrix: &mut [f64], buffer: &mut [f64]) {
    let n = adjoint.len();
    // Phi' from the left, on the columns of a matrix (or on a vector, a matrix of one column).
    let left = |from: &[f64], to: &mut [f64], columns: usize| {
        to.fill(0.0);
        for i in 0..COUPLED {
            for k in 0..INS_STATES {
                let a = phi[i][k];
                if a != 0.0 {
                    for c in 0..columns {
                        to[k * columns + c] += a * from[i * columns + c];
                    }
                }
            }
        }
        for i in COUPLED..n {
            for c in 0..columns {
                to[i * columns + c] += factors[i - COUPLED] * from[i * columns + c];
            }
        }
    };
    let before = adjoint.to_vec();
    left(&before, adjoint, 1);
    left(matrix, buffer, n);
    // Symmetric: the other side is the same on the transpose.
    for i in 0..n {
        for j in 0..n {
            matrix[i * n + j] = buffer[j * n + i];
        }
    }
    left(matrix, buffer, n);
    matrix.copy_from_slice(buffer);
}

/// (I - K H)' l - H' y / S and (I - K H)' L (I - K H) + H' H / S.
fn measured_back(
    slopes: &[(usize, f64)],
    gain: &[f64],
    innovation: f64,
    variance: f64,
    adjoint: &mut [f64],
    matrix: &mut [f64],
) {
    let n = adjoint.len();
    let along: f64 = gain[..n].iter().zip(adjoint.iter()).map(|(k, l)| k * l).sum();
    let turned: Vec<f64> =
        (0..n).map(|j| gain[..n].iter().enumerate().map(|(i, k)| k * matrix[i * n + j]).sum()).collect();
    let both: f64 = gain[..n].iter().zip(&turned).map(|(k, t)| k * t).sum();
    for &(s, h) in slopes {
        adjoint[s] -= h * (along + innovation / variance);
        for j in 0..n {
            matrix[s * n + j] -= h * turned[j];
            matrix[j * n + s] -= h * turned[j];
        }
    }
    for &(s, h) in slopes {
        for &(t, g) in slopes {
            matrix[s * n + t] += h * g * (both + 1.0 / variance);
        }
    }
}
