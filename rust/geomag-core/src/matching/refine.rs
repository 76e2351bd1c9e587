//! Gauss-Newton on the misfit of map value against measured value, with priors: where contour matching ends.
//!
//! Minimises `sum r' R^-1 r + prior`, r = measured - map(moved point) - bias, over the offset of the newest point, the
//! heading, the scale and a constant per channel. `R` holds the sensor's noise and the map's own error, the latter
//! correlated along the track where it is said, or found, to be. The normal matrix gives the covariance; several starts give several
//! minima, and their masses (Laplace's approximation) the probability that another one is the right one.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_positive};
use crate::field::Field;
use crate::fix::{Fix, Status};
use crate::grid::Interpolation;
use crate::matching::scene::{Motion, Priors, Scene};

/// How the misfit is minimised, and what is asked of the answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RefineOptions {
    /// What is known beforehand; see [`Priors`] for what is estimated at all.
    pub priors: Priors,
    /// How the map is read: bicubic has a gradient without steps.
    pub interpolation: Interpolation,
    /// Distance over which the map's own error is correlated (exponentially), metres; 0 is white, `None` is estimated
    /// from the residuals by maximum likelihood where the map has a sigma.
    pub map_correlation_m: Option<f64>,
    /// Greatest number of steps from one start.
    pub max_iterations: usize,
    /// Least share of the samples that must lie on the map.
    pub min_overlap: f64,
    /// Radius within which a fix counts as right, metres; `None` counts only other minima as wrong.
    pub tolerance_m: Option<f64>,
    /// Greatest risk at which the answer is a fix.
    pub max_risk: f64,
    /// Least p-value of the residuals at which the answer is a fix.
    pub min_goodness: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            priors: Priors::default(),
            interpolation: Interpolation::Bicubic,
            map_correlation_m: None,
            max_iterations: 60,
            min_overlap: 0.8,
            tolerance_m: None,
            max_risk: 0.01,
            min_goodness: 1e-3,
        }
    }
}

impl RefineOptions {
    /// Refuses options that cannot be used.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check(&self) -> Result<()> {
        self.priors.check()?;
        if let Some(d) = self.map_correlation_m {
            crate::error::require_not_negative("map_correlation_m", d)?;
        }
        if let Some(t) = self.tolerance_m {
            require_positive("tolerance_m", t)?;
        }
        if self.max_iterations == 0 {
            return Err(Error::invalid("refine max_iterations", "at least 1", 0));
        }
        for (name, v) in
            [("min_overlap", self.min_overlap), ("max_risk", self.max_risk), ("min_goodness", self.min_goodness)]
        {
            if !(0.0..=1.0).contains(&v) {
                return Err(Error::invalid(name, "a number from 0 to 1", v));
            }
        }
        Ok(())
    }
}

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
struct Whitening {
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
pub(crate) struct Refiner<'a> {
    scene: &'a Scene<'a>,
    options: &'a RefineOptions,
    parameters: Parameters,
}

/// Residuals and their derivatives, whitened and stacked with nothing of the priors.
struct Linearised {
    cost: f64,
    normal: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl<'a> Refiner<'a> {
    pub fn new(scene: &'a Scene<'a>, options: &'a RefineOptions) -> Self {
        let parameters = Parameters::new(&options.priors, scene.channels.len());
        Self { scene, options, parameters }
    }

    /// The error model at a start; `None` where too little of the track lies on the maps.
    fn whitening(&self, start: &Motion, noise: &[f64], correlation_m: f64) -> Option<Vec<Whitening>> {
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
                used.push(k);
                map_sigma.push(if channel.map.map_sigma().is_some() {
                    let [x, y] = self.scene.track.point(k);
                    let [east, north] = channel.map.metres_per_unit(y);
                    let s = channel.map.sigma(x + d[0] / east, y + d[1] / north);
                    if s.is_nan() { 0.0 } else { s }
                } else {
                    0.0
                });
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
        if self
            .scene
            .channels
            .iter()
            .all(|c| matches!(c.map.map_sigma(), None | Some(crate::grid::MapSigma::Constant(_))))
        {
            return Some(found);
        }
        // The map's sigma, and which samples count, belong to the place: once more with those of the place found.
        let whitening = self.whitening(&found.motion, noise, correlation_m)?;
        self.descend(&found.motion, &whitening)
    }

    pub fn flat_parameters(&self) -> usize {
        self.parameters.flat
    }
}

/// Multiples of the median sample spacing that are tried as the correlation distance of the map's error.
const CORRELATION_TRIALS: [f64; 7] = [0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

/// Share of the prior's variance above which the field has told too little to call the answer a fix.
const UNINFORMATIVE: f64 = 0.5;

/// Refines from every start and makes the common answer of what is found.
///
/// `searched_m` is the half width of the square of offsets that was searched, where there is one.
pub(crate) fn answer(
    scene: &Scene<'_>,
    options: &RefineOptions,
    starts: &[Motion],
    before: usize,
    searched_m: Option<f64>,
) -> Fix {
    let n = scene.len();
    let refiner = Refiner::new(scene, options);
    let mut noise: Vec<f64> = scene.channels.iter().map(|c| c.sigma.map_or(f64::NAN, |s| s * s)).collect();
    let known = noise.iter().all(|v| !v.is_nan());
    if !known {
        refiner.estimate_noise(&mut noise, starts);
    }
    // A sigma of zero would make the normal matrix infinite: rounding of the map's own values is the floor.
    for (variance, channel) in noise.iter_mut().zip(scene.channels) {
        let size = channel.values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        *variance = variance.max((size * f64::from(f32::EPSILON)).powi(2)).max(f64::MIN_POSITIVE.sqrt());
    }
    let minima = refiner.minima(&noise, starts);
    let Some(best) = minima.first() else {
        // Equations without a solution leave a direction open; no equations at all leave everything.
        let placed = starts.iter().any(|s| refiner.whitening(s, &noise, 0.0).is_some());
        return Fix::none(if placed { Status::Uninformative } else { Status::Lost }, n);
    };
    let masses: Vec<f64> = minima.iter().map(|m| (m.log_mass - best.log_mass).exp()).collect();
    let total: f64 = masses.iter().sum();
    let elsewhere = 1.0 - 1.0 / total;
    let risk = options.tolerance_m.map_or(elsewhere, |tolerance| {
        let outside: f64 = minima.iter().zip(&masses).map(|(m, mass)| mass * mass_outside(tolerance, best, m)).sum();
        outside / total
    });
    let freedom = (best.n_residuals as f64 - refiner.flat_parameters() as f64).max(1.0);
    let goodness = known.then(|| chi_square_survival(best.cost, freedom));
    let covariance = best.position_covariance();
    let spread = covariance[0][0] + covariance[1][1];
    // What was known before: the prior, or that it lies in what was searched, or on the map (uniform: width^2 / 12).
    let map = scene.channels[0].map;
    let [east, north] = crate::matching::closest::cell_size_m(map, scene.track.newest()[1]);
    let on_map = ((east * (map.x().len() - 1) as f64).powi(2) + (north * (map.y().len() - 1) as f64).powi(2)) / 12.0;
    let prior = options.priors.offset_sigma_m.map_or(f64::INFINITY, |s| 2.0 * s * s);
    let known_before = prior.min(searched_m.map_or(f64::INFINITY, |half| 2.0 * half * half / 3.0)).min(on_map);
    let beyond = |m: f64| best.motion.offset_m.iter().any(|o| o.abs() > m);
    let status = if !best.converged {
        Status::NotConverged
    } else if goodness.is_some_and(|p| p < options.min_goodness) {
        Status::Rejected
    } else if searched_m.is_some_and(beyond) {
        Status::AtEdge
    } else if elsewhere > options.max_risk {
        Status::Ambiguous
    } else if risk > options.max_risk || spread > UNINFORMATIVE * known_before {
        Status::Uninformative
    } else {
        Status::Fixed
    };
    let displacements: Vec<[f64; 2]> = scene.levers.iter().map(|&l| best.motion.displacement(l)).collect();
    Fix {
        heading_deg: best.motion.heading_rad.to_degrees(),
        scale: 1.0 + best.motion.stretch,
        bias: options.priors.bias_sigma.map(|_| best.biases[0]),
        covariance_m2: Some(covariance),
        risk: Some(risk),
        goodness,
        score: best.cost,
        runner_up: minima.get(1).map_or(f64::NAN, |m| m.cost),
        n_samples: best.n_residuals / scene.channels.len(),
        iterations: before + best.iterations,
        track: scene.moved(&displacements),
        ..Fix::at_point(scene.channels[0].map, scene.track.newest(), scene.newest_offset(best.motion.offset_m), status)
    }
}

impl Refiner<'_> {
    /// Distinct minima, the one of greatest mass first.
    fn minima(&self, noise: &[f64], starts: &[Motion]) -> Vec<Minimum> {
        let trials = self.correlation_trials();
        let mut best: Vec<Minimum> = Vec::new();
        for correlation in trials {
            let mut found: Vec<Minimum> = Vec::new();
            for start in starts {
                if let Some(minimum) = self.run(start, noise, correlation)
                    && !found.iter().any(|m| same_place(m, &minimum))
                {
                    found.push(minimum);
                }
            }
            found.sort_by(|a, b| b.log_mass.total_cmp(&a.log_mass));
            let better = match (found.first(), best.first()) {
                (Some(f), Some(b)) => f.log_mass > b.log_mass,
                (found, _) => found.is_some(),
            };
            if better {
                best = found;
            }
        }
        best
    }

    fn correlation_trials(&self) -> Vec<f64> {
        let has_sigma = self.scene.channels.iter().any(|c| c.map.map_sigma().is_some());
        match self.options.map_correlation_m {
            Some(d) => vec![d],
            None if !has_sigma => vec![0.0],
            None => {
                let mut gaps: Vec<f64> =
                    self.scene.levers.windows(2).map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1])).collect();
                gaps.sort_by(f64::total_cmp);
                let gap = gaps.get(gaps.len() / 2).copied().unwrap_or(0.0);
                CORRELATION_TRIALS.iter().map(|m| m * gap).collect()
            }
        }
    }

    /// Noise variances from the residuals of the best of the starts, refined twice; for channels that state none.
    fn estimate_noise(&self, noise: &mut [f64], starts: &[Motion]) {
        let unknown: Vec<bool> = noise.iter().map(|v| v.is_nan()).collect();
        let squares = |motion: &Motion, biases: &[f64], c: usize| {
            let r: Vec<f64> = (0..self.scene.len())
                .map(|k| {
                    let d = motion.displacement(self.scene.levers[k]);
                    let (value, _) = self.scene.sample(c, k, d, self.options.interpolation);
                    self.scene.channels[c].values[k] - value - biases[c]
                })
                .filter(|r| r.is_finite())
                .collect();
            let freedom = (r.len() as f64 - self.parameters.len() as f64).max(1.0);
            r.iter().map(|r| r * r).sum::<f64>() / freedom
        };
        for (c, unknown) in unknown.iter().enumerate() {
            if *unknown {
                let spread = |m: &Motion| squares(m, &vec![0.0; noise.len()], c);
                noise[c] = starts.iter().map(spread).fold(f64::INFINITY, f64::min).max(1e-12);
            }
        }
        for _ in 0..2 {
            let best =
                starts.iter().filter_map(|s| self.run(s, noise, 0.0)).max_by(|a, b| a.log_mass.total_cmp(&b.log_mass));
            if let Some(best) = best {
                for (c, unknown) in unknown.iter().enumerate() {
                    if *unknown {
                        noise[c] = squares(&best.motion, &best.biases, c).max(1e-12);
                    }
                }
            }
        }
    }
}

/// Whether two minima are one: their newest points lie within a tenth of their uncertainty, or a metre.
fn same_place(a: &Minimum, b: &Minimum) -> bool {
    let apart = (a.motion.offset_m[0] - b.motion.offset_m[0]).hypot(a.motion.offset_m[1] - b.motion.offset_m[1]);
    let spread = (a.covariance[(0, 0)] + a.covariance[(1, 1)]).sqrt();
    apart < (0.2 * spread).max(1.0)
}

/// Probability that the position of a minimum lies further than `tolerance` metres from that of the best one: the mass
/// of its normal density outside a disc, integrated along its principal axis by Simpson's rule.
fn mass_outside(tolerance: f64, best: &Minimum, minimum: &Minimum) -> f64 {
    const INTERVALS: u32 = 128;
    let [[ee, en], [_, nn]] = minimum.position_covariance();
    let angle = 0.5 * (2.0 * en).atan2(ee - nn);
    let (sin, cos) = angle.sin_cos();
    let apart =
        [minimum.motion.offset_m[0] - best.motion.offset_m[0], minimum.motion.offset_m[1] - best.motion.offset_m[1]];
    let mean = [cos * apart[0] + sin * apart[1], cos * apart[1] - sin * apart[0]];
    let sigma_u = (cos * cos * ee + 2.0 * sin * cos * en + sin * sin * nn).max(0.0).sqrt();
    let sigma_v = (sin * sin * ee - 2.0 * sin * cos * en + cos * cos * nn).max(0.0).sqrt();
    let tiny = 1e-9 * tolerance;
    let (sigma_u, sigma_v) = (sigma_u.max(tiny), sigma_v.max(tiny));
    let (low, high) = ((mean[0] - 9.0 * sigma_u).max(-tolerance), (mean[0] + 9.0 * sigma_u).min(tolerance));
    if low >= high {
        return 1.0;
    }
    let below = |z: f64| {
        let tail = 0.5 * chi_square_survival(z * z, 1.0);
        if z > 0.0 { 1.0 - tail } else { tail }
    };
    let integrand = |u: f64| {
        let half = (tolerance * tolerance - u * u).max(0.0).sqrt();
        let inside = below((half - mean[1]) / sigma_v) - below((-half - mean[1]) / sigma_v);
        let z = (u - mean[0]) / sigma_u;
        inside * (-0.5 * z * z - crate::constants::LN_SQRT_2PI).exp() / sigma_u
    };
    let step = (high - low) / f64::from(INTERVALS);
    let sum: f64 = (0..=INTERVALS)
        .map(|i| {
            let weight = if i == 0 || i == INTERVALS { 1.0 } else { f64::from(2 + 2 * (i % 2)) };
            weight * integrand(low + step * f64::from(i))
        })
        .sum();
    (1.0 - sum * step / 3.0).clamp(0.0, 1.0)
}

/// Probability that a chi-square variable of `freedom` degrees exceeds `value`: the upper incomplete gamma function by
/// its series and its continued fraction (Press et al., *Numerical Recipes*, section 6.2).
pub(crate) fn chi_square_survival(value: f64, freedom: f64) -> f64 {
    let (a, x) = (0.5 * freedom, 0.5 * value);
    if x <= 0.0 {
        return 1.0;
    }
    let front = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        for _ in 0..10_000 {
            n += 1.0;
            term *= x / n;
            sum += term;
            if term < sum * 1e-16 {
                break;
            }
        }
        (1.0 - front * sum).clamp(0.0, 1.0)
    } else {
        // Lentz's method.
        let mut b = x + 1.0 - a;
        let mut c = 1e300;
        let mut d = 1.0 / b;
        let mut h = d;
        for i in 1..10_000 {
            let i = f64::from(i);
            let an = -i * (i - a);
            b += 2.0;
            d = an * d + b;
            d = 1.0 / if d.abs() < 1e-300 { 1e-300 } else { d };
            c = b + an / c;
            c = if c.abs() < 1e-300 { 1e-300 } else { c };
            let delta = d * c;
            h *= delta;
            if (delta - 1.0).abs() < 1e-15 {
                break;
            }
        }
        (front * h).clamp(0.0, 1.0)
    }
}

/// Logarithm of the gamma function for positive arguments (Lanczos, g = 7, n = 9).
fn ln_gamma(x: f64) -> f64 {
    const C: [f64; 9] = [
        0.999_999_999_999_809_9,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    let x = x - 1.0;
    let t = x + 7.5;
    let sum = C.iter().enumerate().skip(1).fold(C[0], |s, (i, c)| s + c / (x + i as f64));
    0.5 * (2.0 * std::f64::consts::PI).ln() + (x + 0.5) * t.ln() - t + sum.ln()
}
