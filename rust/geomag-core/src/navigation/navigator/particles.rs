//! The Rao-Blackwellised particle filter of the textbooks, to compare with.
//!
//! The field is nonlinear in the position alone: positions are particles, and given a position's history the other states are linear,
//! each particle with a mean of its own and all with one covariance, for neither F nor the slope of the bias depends on the particle. Every
//! reading by itself, noise of the sensor alone.
//!
//! Source: Schoen, Gustafsson & Nordlund, IEEE Trans. Signal Processing 53 (2005) 2279.

use std::sync::Arc;

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::measure::value_at;
use super::motion::{COUPLED, INS_STATES, POSITION, Rows, TILT, VELOCITY};
use super::options::NavigatorOptions;
use super::outcome::{Indicated, Inputs, NavigatorOutcome, NavigatorStatus, NavigatorStep, Reason};
use super::state::Navigator;
use super::states::{BIAS, STATES};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::random::Random;

/// Particles.
const COUNT: usize = 1000;
/// Roughening of the positions, metres per square root of a second.
const ROUGHENING: f64 = 0.5;
/// States that are linear once the position is known: all of the INS but the position, and the sensor's bias.
const LINEAR: usize = INS_STATES - 2 + 1;
/// Seed: the same flight gives the same answer.
const SEED: u64 = 0x5eed;

type Linear = SVector<f64, LINEAR>;
type LinearSquare = SMatrix<f64, LINEAR, LINEAR>;

/// Positions as particles, the rest in Kalman filters.
pub(super) struct Particles {
    /// For what it knows of input, motion and places; its own filter is not used.
    frame: Navigator,
    positions: Vec<Vector2<f64>>,
    linear: Vec<Linear>,
    weights: Vec<f64>,
    covariance: LinearSquare,
    random: Random,
}

impl Particles {
    pub fn new(field: Arc<dyn Field>, options: NavigatorOptions) -> Result<Self> {
        if options.terms() > 0 {
            return Err(Error::invalid("terms_covariance", "none with method 'rbpf'", options.terms()));
        }
        if options.gravity {
            return Err(Error::invalid("gravity", "False with method 'rbpf'", "True"));
        }
        let frame = Navigator::new(field, options)?;
        let mut random = Random::new(SEED);
        let c = frame.options().covariance_m2;
        let root = lower(Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]));
        let positions = (0..COUNT).map(|_| root * Vector2::new(random.normal(), random.normal())).collect();
        let covariance = LinearSquare::from_fn(|i, j| if i == j { frame.covariance(i + 2, j + 2) } else { 0.0 });
        Ok(Self {
            frame,
            positions,
            linear: vec![Linear::zeros(); COUNT],
            weights: vec![1.0 / COUNT as f64; COUNT],
            covariance,
            random,
        })
    }

    pub fn inputs(&self) -> Inputs {
        self.frame.inputs()
    }

    /// Mean of all states: position, then the linear ones.
    pub fn mean(&self) -> Vec<f64> {
        let (place, _) = self.place();
        let linear = self.linear_mean();
        place.iter().chain(linear.iter()).copied().collect()
    }

    pub fn step(&mut self, indicated: &Indicated) -> Result<NavigatorStep> {
        let now = self.frame.check(indicated)?;
        if let Some(before) = self.frame.state.newest {
            let mut pieces: Vec<(Rows, Vec<f64>, Vec<f64>)> = Vec::new();
            let heading = self.covariance[(TILT, TILT)];
            self.frame.pieces(&before, &now, STATES, heading, |phi, factors, noise| {
                pieces.push((*phi, factors.to_vec(), noise.to_vec()));
            });
            let gap = now.time_s - before.time_s;
            let count = pieces.len().max(1) as f64;
            for (phi, factors, noise) in &pieces {
                self.carry_on(phi, factors, noise, ROUGHENING * ROUGHENING * gap / count);
            }
        } else {
            self.frame.begin(&now);
            let start = Vector2::new(self.frame.mean()[POSITION], self.frame.mean()[POSITION + 1]);
            self.positions.iter_mut().for_each(|p| *p += start);
        }
        self.frame.state.newest = Some(now);
        self.frame.state.steps += 1;
        let outcome = match indicated.value.filter(|v| !v.is_nan()) {
            Some(value) => self.read(now.x, now.y, indicated.height_m, value),
            None => NavigatorOutcome::Waiting,
        };
        Ok(self.answer(now.x, now.y, outcome))
    }

    /// Weighs the particles by a reading, corrects the linear states, and draws anew where few particles have all the weight.
    fn read(&mut self, x: f64, y: f64, height_m: Option<f64>, value: f64) -> NavigatorOutcome {
        let bias = LINEAR - 1;
        let noise = self.frame.options().reading_sigma.powi(2);
        let variance = self.covariance[(bias, bias)] + noise;
        if !(variance > 0.0) {
            return NavigatorOutcome::Waiting;
        }
        let gain: Linear = self.covariance.column(bias) / variance;
        let innovations: Vec<f64> = self
            .positions
            .iter()
            .zip(&self.linear)
            .map(|(p, linear)| {
                let [px, py] = self.frame.corrected(x, y, [p[0], p[1]]);
                value - value_at(self.frame.field.as_ref(), px, py, height_m) - linear[bias]
            })
            .collect();
        let least = innovations.iter().filter(|i| !i.is_nan()).map(|i| i * i).fold(f64::INFINITY, f64::min);
        if least == f64::INFINITY {
            return NavigatorOutcome::OffMap;
        }
        let mut total = 0.0;
        for ((weight, linear), innovation) in self.weights.iter_mut().zip(&mut self.linear).zip(&innovations) {
            if innovation.is_nan() {
                *weight = 0.0;
            } else {
                *weight *= libm::exp(-0.5 * (innovation * innovation - least) / variance);
                *linear += gain * *innovation;
            }
            total += *weight;
        }
        if !(total > 0.0) {
            // Those near the reading had no weight before: it is all alike again.
            self.weights.fill(1.0 / COUNT as f64);
            return NavigatorOutcome::Downweighted;
        }
        self.weights.iter_mut().for_each(|w| *w /= total);
        self.covariance -= gain * gain.transpose() * variance;
        let effective = 1.0 / self.weights.iter().map(|w| w * w).sum::<f64>();
        if effective < 0.5 * COUNT as f64 {
            self.draw_anew();
        }
        NavigatorOutcome::Updated
    }

    /// Systematic resampling.
    fn draw_anew(&mut self) {
        let start = self.random.unit();
        let (mut positions, mut linear) = (Vec::with_capacity(COUNT), Vec::with_capacity(COUNT));
        let (mut sum, mut k) = (self.weights[0], 0);
        for i in 0..COUNT {
            let mark = (i as f64 + start) / COUNT as f64;
            while sum < mark && k + 1 < COUNT {
                k += 1;
                sum += self.weights[k];
            }
            positions.push(self.positions[k]);
            linear.push(self.linear[k]);
        }
        (self.positions, self.linear) = (positions, linear);
        self.weights.fill(1.0 / COUNT as f64);
    }

    /// Draws every particle's next position, and learns from it what its linear states are.
    fn carry_on(&mut self, phi: &Rows, factors: &[f64], noise: &[f64], roughening: f64) {
        let own = Matrix2::from_fn(|i, j| phi[i][j]);
        let mut along = SMatrix::<f64, 2, LINEAR>::zeros();
        let mut turn = LinearSquare::zeros();
        let mut back = SMatrix::<f64, LINEAR, 2>::zeros();
        for j in 0..INS_STATES - 2 {
            for i in 0..2 {
                along[(i, j)] = phi[i][j + 2];
            }
            for i in 0..COUPLED - 2 {
                turn[(i, j)] = phi[i + 2][j + 2];
            }
        }
        for i in 0..COUPLED - 2 {
            for j in 0..2 {
                back[(i, j)] = phi[i + 2][j];
            }
        }
        for i in COUPLED..=BIAS {
            turn[(i - 2, i - 2)] = factors[i - COUPLED];
        }
        let q = LinearSquare::from_fn(|i, j| if i == j { noise[i + 2] } else { 0.0 });
        let spread = along * self.covariance * along.transpose() + Matrix2::identity() * roughening;
        let Some(inverse) = spread.try_inverse() else { return };
        let root = lower(spread);
        let gain = turn * self.covariance * along.transpose() * inverse;
        for (p, linear) in self.positions.iter_mut().zip(&mut self.linear) {
            let step = root * Vector2::new(self.random.normal(), self.random.normal());
            let next = own * *p + along * *linear + step;
            *linear = turn * *linear + back * *p + gain * step;
            *p = next;
        }
        let covariance = turn * self.covariance * turn.transpose() + q - gain * spread * gain.transpose();
        self.covariance = 0.5 * (covariance + covariance.transpose());
    }

    fn linear_mean(&self) -> Linear {
        self.linear.iter().zip(&self.weights).fold(Linear::zeros(), |sum, (l, w)| sum + l * *w)
    }

    /// Mean and covariance of the position.
    fn place(&self) -> (Vector2<f64>, Matrix2<f64>) {
        let mean = self.positions.iter().zip(&self.weights).fold(Vector2::zeros(), |sum, (p, w)| sum + p * *w);
        let covariance = self.positions.iter().zip(&self.weights).fold(Matrix2::zeros(), |sum, (p, w)| {
            let d = p - mean;
            sum + d * d.transpose() * *w
        });
        (mean, covariance)
    }

    fn answer(&self, x: f64, y: f64, outcome: NavigatorOutcome) -> NavigatorStep {
        let (mean, c) = self.place();
        let linear = self.linear_mean();
        let [x, y] = self.frame.corrected(x, y, [mean[0], mean[1]]);
        let covariance_m2 = [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]];
        NavigatorStep {
            x,
            y,
            covariance_m2,
            covariance_filter_m2: covariance_m2,
            velocity_error_m_s: [linear[VELOCITY - 2], linear[VELOCITY - 1]],
            // The linear states are all but the position: tilts about east and north, then heading.
            heading_error_deg: -linear[TILT].to_degrees(),
            tilt_error_mrad: [1e3 * linear[TILT - 2], 1e3 * linear[TILT - 1]],
            bias: linear[LINEAR - 1],
            status: if outcome == NavigatorOutcome::OffMap {
                NavigatorStatus::Coasting
            } else {
                NavigatorStatus::Tracking
            },
            reason: if outcome == NavigatorOutcome::OffMap { Reason::OffMap } else { Reason::Readings },
            outcome,
            nis: None,
            running_nis: 1.0,
            protection_level_m: self.frame.radius.of(covariance_m2),
            last_fix_s: None,
            resets: 0,
        }
    }
}

/// Lower triangular root of a covariance, of what is positive in it.
fn lower(c: Matrix2<f64>) -> Matrix2<f64> {
    let l00 = c[(0, 0)].max(0.0).sqrt();
    let l10 = if l00 > 0.0 { c[(1, 0)] / l00 } else { 0.0 };
    Matrix2::new(l00, 0.0, l10, (c[(1, 1)] - l10 * l10).max(0.0).sqrt())
}
