//! Fitting a model to observations: weighted, robust, linear or Gauss-Newton.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::basis::{Basis, Prior, coefficient_count};
use super::evaluate::norm;
use super::normal::{LinearRow, Progress, solve_refined};
use super::observations::{Observations, Sensed};
use super::{Covariance, Positions, RectangularHarmonicModel, Region};
use crate::error::{Error, Result};
use crate::frame::LocalFrame;
use crate::monitor::Monitor;

pub use super::normal::Regularisation;

/// Highest order that a fit accepts: 7,323 coefficients, half a gigabyte for their Gram matrix.
pub const MAX_FIT_ORDER: usize = 60;
/// Share of the residuals (or of the data, to rounding) below which a change of the prediction ends the iteration.
const SETTLED: f64 = 1e-4;
/// Makes the median absolute deviation a standard deviation for normal errors.
const MAD_TO_SIGMA: f64 = 1.482_602_218_505_602;

/// Periods of the basis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Period {
    /// Multiples of the extent of the observations along north and east; 1.2 to 1.6 for real fields, 1 is the paper's.
    Ratio(f64),
    /// Metres along north and east.
    Metres([f64; 2]),
}

/// How to fit.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// Order N; `3 + 2 N (N + 1)` coefficients.
    pub order: usize,
    /// Periods.
    pub period: Period,
    /// Ridge or truncated singular values.
    pub regularisation: Regularisation,
    /// How the ridge is shared among the coefficients.
    pub prior: Prior,
    /// Huber's bound in standard deviations of the residuals (1.345 is usual): larger residuals count linearly.
    pub huber: Option<f64>,
    /// Most iterations of the robust and of the Gauss-Newton steps.
    pub max_iterations: usize,
    /// Whether to keep the covariance of the coefficients, without which there is no sigma.
    pub covariance: bool,
    /// Frame that positions and vectors are in, where it is on the Earth.
    pub frame: Option<LocalFrame>,
    /// Unit of the field.
    pub unit: String,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            order: 12,
            period: Period::Ratio(1.5),
            regularisation: Regularisation::Ridge(1e-9),
            prior: Prior::default(),
            huber: None,
            max_iterations: 20,
            covariance: true,
            frame: None,
            unit: "nT".into(),
        }
    }
}

/// What a fit says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitSummary {
    /// Numbers that were fitted.
    pub n_observations: usize,
    /// Root mean square of the residuals, field unit, unweighted.
    pub residual_rms: f64,
    /// Standard deviation of an observation of unit weight, from the residuals: the covariance is scaled with it.
    pub unit_sigma: f64,
    /// Directions among the coefficients that the observations decide and not the ridge.
    pub effective_parameters: f64,
    /// Solutions of the normal equations that it took.
    pub iterations: usize,
    /// Whether the iteration settled.
    pub converged: bool,
    /// Directions (north, east, down; unit vectors) of the uniform field that no observation senses: left out, nil in the model.
    #[serde(default)]
    pub undetermined: Vec<[f64; 3]>,
    /// Whether total-field anomalies were fitted, as projections on the main field: they are read as such again.
    #[serde(default)]
    pub projected: bool,
}

/// Fits a model by (weighted, regularised, optionally robust) least squares.
///
/// Linear observations take one solution. Intensities are linearised about the field found so far [Gauss-Newton on
/// `|main + B|`], Huber's weights are taken from the residuals; both repeat until the prediction settles. The covariance
/// is `unit_sigma^2 (A'WA + ridge)^-1`: what the observations leave open, the ridge read as prior knowledge.
///
/// The monitor is told how far each solution is.
///
/// ```
/// use geomag_core::harmonic::{FitOptions, Observations, Period, Positions, fit};
/// use geomag_core::monitor::Quiet;
/// let (mut north, mut east) = (Vec::new(), Vec::new());
/// for i in 0..100 {
///     north.push(f64::from(i % 10) * 1e3);
///     east.push(f64::from(i / 10) * 1e3);
/// }
/// let down = vec![0.0; 100];
/// let positions = Positions::new(&north, &east, &down)?;
/// let field: Vec<[f64; 3]> = north.iter().map(|x| [0.0, 0.0, 10.0 * (x / 3e3).cos()]).collect();
/// let mut observations = Observations::new();
/// observations.vector(&positions, &field, &[])?;
/// let model = fit(&observations, &FitOptions { order: 4, ..FitOptions::default() }, &Quiet)?;
/// assert_eq!(model.coefficients().len(), 43);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
///
/// # Errors
/// [`Error::TooFewSamples`] for fewer numbers than coefficients (unless there is a [`Prior`]), [`Error::Invalid`] for options out of range or
/// observations without extent, [`Error::RankDeficient`] where the observations do not decide the coefficients and no
/// ridge does, [`Error::Interrupted`].
pub fn fit(
    observations: &Observations,
    options: &FitOptions,
    monitor: &dyn Monitor,
) -> Result<RectangularHarmonicModel> {
    let prepared = PreparedFit::new(observations, options)?;
    let (coefficients, solver, summary) = prepared.iterate(observations, options, Progress::whole(monitor))?;
    let mut model =
        RectangularHarmonicModel::new(options.order, prepared.periods_m, coefficients.data.into(), prepared.region)?
            .with_frame(options.frame)
            .with_unit(options.unit.clone());
    if options.covariance {
        let covariance = solver.covariance() * (summary.unit_sigma * summary.unit_sigma);
        let n = covariance.nrows();
        let lower = (0..n).flat_map(|i| (0..=i).map(move |j| (i, j))).map(|ij| covariance[ij]).collect();
        model.covariance = Some(Covariance::new(lower, n)?);
    }
    model.summary = Some(summary);
    Ok(model)
}

/// What can be said before the first solution.
pub(super) struct PreparedFit {
    pub(super) basis: Basis,
    pub(super) periods_m: [f64; 2],
    /// Share of the ridge of each coefficient.
    pub(super) damping: Vec<f64>,
    region: Region,
}

impl PreparedFit {
    pub(super) fn new(observations: &Observations, options: &FitOptions) -> Result<Self> {
        if options.order > MAX_FIT_ORDER {
            return Err(Error::invalid("order", format!("at most {MAX_FIT_ORDER} in a fit"), options.order));
        }
        options.regularisation.validate()?;
        options.prior.validate()?;
        if let Some(bound) = options.huber {
            crate::error::require_positive("huber", bound)?;
        }
        if options.max_iterations == 0 {
            return Err(Error::invalid("max_iterations", "at least 1", 0));
        }
        let needed = coefficient_count(options.order);
        // A prior that says which waves to expect decides what the observations do not.
        let told = options.prior.power > 0.0 || options.prior.damping_m > 0.0;
        if observations.len() < if told { 1 } else { needed } {
            return Err(Error::TooFewSamples {
                what: format!("harmonic fit of order {}", options.order),
                needed,
                got: observations.len(),
            });
        }
        let [north_m, east_m, down_m] = observations.extent();
        let periods_m = match options.period {
            Period::Metres(periods) => periods,
            Period::Ratio(ratio) if ratio.is_finite() && ratio >= 1.0 => {
                for (name, [low, high]) in [("north_m", north_m), ("east_m", east_m)] {
                    if high <= low {
                        return Err(Error::invalid(
                            name,
                            "observations with an extent along north and east (or periods in metres)",
                            format!("all at {low}"),
                        ));
                    }
                }
                [ratio * (north_m[1] - north_m[0]), ratio * (east_m[1] - east_m[0])]
            }
            Period::Ratio(ratio) => return Err(Error::invalid("period_ratio", "a finite number >= 1", ratio)),
        };
        let region = Region { north_m, east_m, down_m };
        // Refuses periods and levels that no model can have before any work is done.
        RectangularHarmonicModel::new(options.order, periods_m, vec![0.0; needed], region)?;
        let basis = Basis::new(options.order, periods_m);
        Ok(Self { damping: basis.damping(options.prior), basis, periods_m, region })
    }

    fn iterate(
        &self,
        observations: &Observations,
        options: &FitOptions,
        progress: Progress<'_>,
    ) -> Result<(DVector<f64>, super::normal::Solver, FitSummary)> {
        let curved = observations.rows.iter().any(|r| matches!(r.sensed, Sensed::Intensity(_)));
        let mut field = vec![[0.0; 3]; observations.point_count()];
        let mut robust = vec![1.0; observations.len()];
        let mut residuals: Vec<f64> = Vec::new();
        let mut iterations = 0;
        loop {
            let rows = linear_rows(observations, &field, &robust);
            let (coefficients, solver) =
                solve_refined(&self.basis, &rows, options.regularisation, &self.damping, progress)?;
            iterations += 1;
            field = self.field_at_points(observations, coefficients.as_slice())?;
            let found = self::residuals(observations, &field);
            if let Some(bound) = options.huber {
                robust = huber_weights(observations, &found, bound);
            }
            let repeated = curved || options.huber.is_some();
            let settled = !repeated || (iterations > 1 && settled(observations, &residuals, &found));
            if settled || iterations == options.max_iterations {
                let parameters = solver.effective_parameters();
                let weighted: f64 = observations
                    .rows
                    .iter()
                    .zip(&found)
                    .zip(&robust)
                    .map(|((row, r), robust)| (r * row.weight).powi(2) * robust)
                    .sum();
                let count: f64 = robust.iter().sum();
                let summary = FitSummary {
                    n_observations: observations.len(),
                    residual_rms: rms(&found),
                    unit_sigma: (weighted / (count - parameters).max(1.0)).sqrt(),
                    effective_parameters: parameters,
                    iterations,
                    converged: settled,
                    undetermined: solver.undetermined().to_vec(),
                    projected: observations.has_anomalies(),
                };
                crate::error::require_finite("residuals of the fit", &[summary.residual_rms, summary.unit_sigma])?;
                return Ok((coefficients, solver, summary));
            }
            residuals = found;
        }
    }

    fn field_at_points(&self, observations: &Observations, coefficients: &[f64]) -> Result<Vec<[f64; 3]>> {
        let model =
            RectangularHarmonicModel::new(self.basis.order(), self.periods_m, coefficients.to_vec(), self.region)?;
        let axis = |i: usize| observations.points.iter().map(|p| p[i]).collect::<Vec<_>>();
        let (north, east, down) = (axis(0), axis(1), axis(2));
        Ok(model.field(&Positions::new(&north, &east, &down)?, true))
    }
}

/// The equations, linear about the field that was found so far at every point.
pub(super) fn linear_rows(observations: &Observations, field: &[[f64; 3]], robust: &[f64]) -> Vec<LinearRow> {
    observations
        .rows
        .iter()
        .zip(robust)
        .map(|(row, robust)| {
            let point = row.point as usize;
            let weight = row.weight * robust.sqrt();
            let (direction, target) = match row.sensed {
                Sensed::Along(direction) => (direction, row.value),
                Sensed::Intensity(main) => {
                    let b = field[point];
                    let total = [main[0] + b[0], main[1] + b[1], main[2] + b[2]];
                    let length = norm(total);
                    let direction = total.map(|c| c / length);
                    (direction, row.value - length + dot(direction, b))
                }
            };
            LinearRow { point: observations.points[point], direction, weight, target: target * weight }
        })
        .collect()
}

/// Observed minus modelled, unweighted.
pub(super) fn residuals(observations: &Observations, field: &[[f64; 3]]) -> Vec<f64> {
    observations
        .rows
        .iter()
        .map(|row| {
            let b = field[row.point as usize];
            match row.sensed {
                Sensed::Along(direction) => row.value - dot(direction, b),
                Sensed::Intensity(main) => row.value - norm([main[0] + b[0], main[1] + b[1], main[2] + b[2]]),
            }
        })
        .collect()
}

/// Huber's weights about a scale from the median absolute residual, which outliers hardly move.
pub(super) fn huber_weights(observations: &Observations, residuals: &[f64], bound: f64) -> Vec<f64> {
    let standard: Vec<f64> = observations.rows.iter().zip(residuals).map(|(row, r)| (r * row.weight).abs()).collect();
    let mut sorted = standard.clone();
    let middle = sorted.len() / 2;
    let scale = MAD_TO_SIGMA * *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
    let limit = bound * scale;
    standard.iter().map(|&r| if r <= limit { 1.0 } else { limit / r }).collect()
}

/// Whether the residuals moved by no more than a small part of themselves, or of the data to rounding.
fn settled(observations: &Observations, before: &[f64], after: &[f64]) -> bool {
    let moved: Vec<f64> = before.iter().zip(after).map(|(a, b)| a - b).collect();
    let data: Vec<f64> = observations.rows.iter().map(|r| r.value).collect();
    rms(&moved) <= SETTLED * rms(after) || rms(&moved) <= 1e-13 * rms(&data)
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
