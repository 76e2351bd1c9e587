//! From one start to one minimum: error model, linearisation, Levenberg-Marquardt.

use nalgebra::{DMatrix, DVector};

use super::options::RefineOptions;
use crate::field::Field;
use crate::grid::MapSigma;
use crate::matching::scene::{Motion, Priors, Scene};
use crate::monitor::Monitor;

/// One minimum of the misfit.
#[derive(Debug, Clone)]
pub struct Minimum {
    /// The motion of the track.
    pub motion: Motion,
    /// Constant of each channel, measured minus map; zero where it is not estimated.
    pub biases: Vec<f64>,
    /// Twice the negative log posterior, up to a constant.
    pub cost: f64,
    /// Covariance of the estimated parameters: east, north (m), then heading (rad), scale, biases as far as they are
    /// estimated.
    pub covariance: DMatrix<f64>,
    /// Residuals that the cost rests on.
    pub n_residuals: usize,
    /// Steps taken.
    pub iterations: usize,
    /// Whether it settled.
    pub converged: bool,
    /// Logarithm of the probability mass of this minimum, up to the constant that all minima share.
    pub log_mass: f64,
}

impl Minimum {
    /// Covariance of the newest position, square metres, east-north.
    pub fn position_covariance(&self) -> [[f64; 2]; 2] {
        let c = &self.covariance;
        let cross = 0.5 * (c[(0, 1)] + c[(1, 0)]);
        [[c[(0, 0)], cross], [cross, c[(1, 1)]]]
    }
}

/// Which parameters are looked for, and how tightly each is held: the order is that of [`Minimum::covariance`].
#[derive(Debug)]
struct Parameters {
    heading: Option<usize>,
    stretch: Option<usize>,
    bias: Option<usize>,
    information: Vec<f64>,
    flat: usize,
}

impl Parameters {
    fn new(priors: &Priors, channels: usize) -> Self {
        let inverse_square = |s: f64| 1.0 / (s * s);
        let offset = priors.offset_sigma_m.map_or(0.0, inverse_square);
        let mut information = vec![offset, offset];
        let mut add = |s: Option<f64>, count: usize| {
            s.map(|s| {
                information.extend(std::iter::repeat_n(inverse_square(s), count));
                information.len() - count
            })
        };
        let heading = add(priors.heading_sigma_deg.map(f64::to_radians), 1);
        let stretch = add(priors.scale_sigma, 1);
        let bias = add(priors.bias_sigma, channels);
        let flat = information.iter().filter(|&&i| i == 0.0).count();
        Self { heading, stretch, bias, information, flat }
    }

    fn len(&self) -> usize {
        self.information.len()
    }

    fn motion(&self, q: &DVector<f64>) -> Motion {
        Motion {
            offset_m: [q[0], q[1]],
            heading_rad: self.heading.map_or(0.0, |i| q[i]),
            stretch: self.stretch.map_or(0.0, |i| q[i]),
        }
    }
}

/// The error model of one channel: which samples count, and what makes their errors white and of unit size.
#[derive(Debug)]
pub(super) struct Whitening {
    used: Vec<usize>,
    kind: Whitener,
    log_det: f64,
}

#[derive(Debug)]
enum Whitener {
    Diagonal(Vec<f64>),
    /// Lower Cholesky factor of the covariance.
    Correlated(DMatrix<f64>),
}

impl Whitening {
    fn apply(&self, columns: &mut DMatrix<f64>) {
        match &self.kind {
            Whitener::Diagonal(inverse_sigma) => {
                for (mut row, s) in columns.row_iter_mut().zip(inverse_sigma) {
                    row *= *s;
                }
            }
            Whitener::Correlated(lower) => {
                lower.solve_lower_triangular_mut(columns);
            }
        }
    }
}

/// The minimiser: one scene, one set of options, any number of starts.
pub(super) struct Refiner<'a> {
    pub scene: &'a Scene<'a>,
    pub options: &'a RefineOptions,
    pub monitor: &'a dyn Monitor,
    parameters: Parameters,
}

/// Residuals and their derivatives, whitened and stacked with nothing of the priors.
struct Linearised {
    cost: f64,
    normal: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl<'a> Refiner<'a> {
    pub fn new(scene: &'a Scene<'a>, options: &'a RefineOptions, monitor: &'a dyn Monitor) -> Self {
        let parameters = Parameters::new(&options.priors, scene.channels.len());
        Self { scene, options, monitor, parameters }
    }

    /// The error model at a start; `None` where too little of the track lies on the maps.
    pub fn whitening(&self, start: &Motion, noise: &[f64], correlation_m: f64) -> Option<Vec<Whitening>> {
        let n = self.scene.len();
        let mut out = Vec::with_capacity(self.scene.channels.len());
        for (c, channel) in self.scene.channels.iter().enumerate() {
            let mut used = Vec::with_capacity(n);
            let mut map_sigma = Vec::with_capacity(n);
            for k in 0..n {
                let d = start.displacement(self.scene.levers[k]);
                let (value, _) = self.scene.sample(c, k, d, self.options.interpolation);
                if value.is_nan() || self.scene.weight(k) == 0.0 {
                    continue;
                }
                let [x, y] = self.scene.track.point(k);
                let [east, north] = channel.field.metres_per_unit(y);
                let Some(sigma) = channel.field.known_sigma(x + d[0] / east, y + d[1] / north) else { continue };
                used.push(k);
                map_sigma.push(sigma);
            }
            if (used.len() as f64) < self.options.min_overlap * n as f64 || used.is_empty() {
                return None;
            }
            // A sample of weight w counts as w samples: its noise variance is divided by it.
            let sensor = |i: usize| noise[c] / self.scene.weight(used[i]);
            let (kind, log_det) = if correlation_m > 0.0 && map_sigma.iter().any(|&s| s > 0.0) {
                let m = used.len();
                let covariance = DMatrix::from_fn(m, m, |i, j| {
                    let (p, q) = (self.scene.levers[used[i]], self.scene.levers[used[j]]);
                    let apart = (p[0] - q[0]).hypot(p[1] - q[1]);
                    let map = map_sigma[i] * map_sigma[j] * (-apart / correlation_m).exp();
                    if i == j { map + sensor(i) } else { map }
                });
                let lower = covariance.cholesky()?.unpack();
                let log_det = lower.diagonal().iter().map(|v| 2.0 * v.ln()).sum();
                (Whitener::Correlated(lower), log_det)
            } else {
                let variances: Vec<f64> = (0..used.len()).map(|i| sensor(i) + map_sigma[i].powi(2)).collect();
                let log_det = variances.iter().map(|v| v.ln()).sum();
                (Whitener::Diagonal(variances.iter().map(|v| 1.0 / v.sqrt()).collect()), log_det)
            };
            out.push(Whitening { used, kind, log_det });
        }
        Some(out)
    }

    fn linearise(&self, q: &DVector<f64>, whitening: &[Whitening]) -> Option<Linearised> {
        let p = &self.parameters;
        let k = p.len();
        let motion = p.motion(q);
        let (sin, cos) = motion.heading_rad.sin_cos();
        let scale = 1.0 + motion.stretch;
        let mut cost = 0.0;
        let mut normal = DMatrix::zeros(k, k);
        let mut gradient = DVector::zeros(k);
        for (c, white) in whitening.iter().enumerate() {
            // Last column: the residual.
            let mut rows = DMatrix::zeros(white.used.len(), k + 1);
            let bias = p.bias.map_or(0.0, |i| q[i + c]);
            for (i, &s) in white.used.iter().enumerate() {
                let lever = self.scene.levers[s];
                let (value, [ge, gn]) = self.scene.sample(c, s, motion.displacement(lever), self.options.interpolation);
                if value.is_nan() {
                    return None;
                }
                let turned = [cos * lever[0] + sin * lever[1], cos * lever[1] - sin * lever[0]];
                rows[(i, 0)] = -ge;
                rows[(i, 1)] = -gn;
                if let Some(j) = p.heading {
                    // Clockwise: d/dheading of the turned lever (e, n) is (n, -e).
                    rows[(i, j)] = -scale * (ge * turned[1] - gn * turned[0]);
                }
                if let Some(j) = p.stretch {
                    rows[(i, j)] = -(ge * turned[0] + gn * turned[1]);
                }
                if let Some(j) = p.bias {
                    rows[(i, j + c)] = -1.0;
                }
                rows[(i, k)] = self.scene.channels[c].values[s] - value - bias;
            }
            white.apply(&mut rows);
            let jacobian = rows.columns(0, k);
            let residual = rows.column(k);
            cost += residual.norm_squared();
            normal += jacobian.tr_mul(&jacobian);
            gradient += jacobian.tr_mul(&residual);
        }
        for i in 0..k {
            cost += p.information[i] * q[i] * q[i];
            normal[(i, i)] += p.information[i];
            gradient[i] += p.information[i] * q[i];
        }
        cost.is_finite().then_some(Linearised { cost, normal, gradient })
    }

    /// Levenberg-Marquardt from one start under a given error model.
    fn descend(&self, start: &Motion, whitening: &[Whitening]) -> Option<Minimum> {
        let p = &self.parameters;
        let k = p.len();
        let mut q = DVector::zeros(k);
        q[0] = start.offset_m[0];
        q[1] = start.offset_m[1];
        if let Some(i) = p.heading {
            q[i] = start.heading_rad;
        }
        if let Some(i) = p.stretch {
            q[i] = start.stretch;
        }
        if let Some(i) = p.bias {
            self.start_biases(&mut q, i, whitening);
        }
        let mut now = self.linearise(&q, whitening)?;
        let mut damping = 1e-3;
        let (mut iterations, mut converged) = (0, false);
        while iterations < self.options.max_iterations {
            iterations += 1;
            let mut damped = now.normal.clone();
            for i in 0..k {
                damped[(i, i)] += damping * now.normal[(i, i)].max(f64::MIN_POSITIVE);
            }
            let Some(factor) = damped.cholesky() else {
                damping *= 10.0;
                if damping > 1e12 {
                    break;
                }
                continue;
            };
            let step = -factor.solve(&now.gradient);
            let trial_q = &q + &step;
            // Settled: the step is a small part of what the parameters are uncertain by.
            let small = (step.transpose() * &now.normal * &step)[(0, 0)] < 1e-6;
            match self.linearise(&trial_q, whitening) {
                Some(trial) if trial.cost <= now.cost => {
                    let settled = small && damping <= 1e-2;
                    q = trial_q;
                    now = trial;
                    damping = (damping * 0.2).max(1e-9);
                    if settled {
                        converged = true;
                        break;
                    }
                }
                _ => {
                    if small {
                        converged = true;
                        break;
                    }
                    damping = (damping * 8.0).max(1e-6);
                    if damping > 1e12 {
                        break;
                    }
                }
            }
        }
        let covariance = now.normal.clone().cholesky()?.inverse();
        let log_det_normal = now.normal.cholesky()?.determinant().ln();
        let log_det_error: f64 = whitening.iter().map(|w| w.log_det).sum();
        Some(Minimum {
            motion: p.motion(&q),
            biases: p.bias.map_or_else(|| vec![0.0; self.scene.channels.len()], |i| q.as_slice()[i..].to_vec()),
            cost: now.cost,
            covariance,
            n_residuals: whitening.iter().map(|w| w.used.len()).sum(),
            iterations,
            converged,
            log_mass: -0.5 * (now.cost + log_det_error + log_det_normal),
        })
    }

    /// The biases that fit best at the start, one Gauss-Newton step in them alone.
    fn start_biases(&self, q: &mut DVector<f64>, first: usize, whitening: &[Whitening]) {
        if let Some(at) = self.linearise(q, whitening) {
            for i in first..self.parameters.len() {
                if at.normal[(i, i)] > 0.0 {
                    q[i] -= at.gradient[i] / at.normal[(i, i)];
                }
            }
        }
    }

    /// The minimum that a start leads to; `None` where too little of the track lies on the maps.
    pub fn run(&self, start: &Motion, noise: &[f64], correlation_m: f64) -> Option<Minimum> {
        let whitening = self.whitening(start, noise, correlation_m)?;
        let found = self.descend(start, &whitening)?;
        if self.scene.channels.iter().all(|c| matches!(c.field.map_sigma(), None | Some(MapSigma::Constant(_)))) {
            return Some(found);
        }
        // The map's sigma, and which samples count, belong to the place: once more with those of the place found.
        let whitening = self.whitening(&found.motion, noise, correlation_m)?;
        self.descend(&found.motion, &whitening)
    }

    /// Number of parameters.
    pub fn parameter_count(&self) -> usize {
        self.parameters.len()
    }

    /// Number of those of which nothing is known beforehand.
    pub fn flat_parameters(&self) -> usize {
        self.parameters.flat
    }
}
