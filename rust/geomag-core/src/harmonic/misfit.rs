//! How far off a model is where it was not fitted: leave-out errors, and a sigma that agrees with them.

use serde::{Deserialize, Serialize};

use super::evaluate::norm;
use super::fit::{FitOptions, Period, PreparedFit, residuals};
use super::observations::{Observations, Sensed};
use super::select::deal;
use super::{Positions, fit};
use crate::error::{Error, Result, require_not_negative};
use crate::monitor::{Monitor, Quiet};

/// Shares of the variance that are tried for the nugget.
const NUGGET_SHARES: u32 = 400;

/// What makes the standard deviation of a prediction out of that of the coefficients:
/// `sigma^2 = nugget^2 + (scale s)^2`, s from the covariance of the coefficients.
///
/// The nugget stands for what the order leaves out and for noise, the scale for a ridge that is not the ratio of variances:
/// under a physically right [`Prior`](super::Prior) s grows with the distance to the data by itself. The default is s alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FieldMisfit {
    /// Standard deviation where the coefficients are known, field unit.
    pub nugget: f64,
    /// Factor of the coefficients' standard deviation.
    pub scale: f64,
}

impl Default for FieldMisfit {
    fn default() -> Self {
        Self { nugget: 0.0, scale: 1.0 }
    }
}

impl FieldMisfit {
    pub(crate) fn validate(self) -> Result<()> {
        require_not_negative("misfit nugget", self.nugget)?;
        require_not_negative("misfit scale", self.scale)?;
        Ok(())
    }

    /// The standard deviation of a prediction.
    pub fn sigma(self, coefficients: f64) -> f64 {
        if self == Self::default() { coefficients } else { self.nugget.hypot(self.scale * coefficients) }
    }

    /// The most likely one, for normal errors, given errors and the standard deviations from the coefficients alone. Its
    /// squared errors over variances have mean one, as at any greatest likelihood over a common factor.
    ///
    /// # Errors
    /// [`Error::TooFewSamples`] for fewer than two errors, [`Error::Shape`], [`Error::NotFinite`].
    pub fn learn(errors: &[f64], coefficients: &[f64]) -> Result<Self> {
        if errors.len() != coefficients.len() {
            let got = format!("({},)", coefficients.len());
            return Err(Error::shape("sigma", format!("({},) as the errors", errors.len()), got));
        }
        crate::error::require_finite("errors", errors)?;
        crate::error::require_finite("sigma", coefficients)?;
        if errors.len() < 2 {
            return Err(Error::TooFewSamples { what: "errors to learn from".into(), needed: 2, got: errors.len() });
        }
        let mean = |f: &dyn Fn(f64, f64) -> f64| {
            errors.iter().zip(coefficients).map(|(&e, &s)| f(e, s)).sum::<f64>() / errors.len() as f64
        };
        let typical = mean(&|_, s| s * s);
        // With the share of the variance that is the nugget's the best common factor is known: one search in one variable.
        let profile = |share: f64| {
            let of = |s: f64| share + (1.0 - share) * s * s / typical;
            let level = mean(&|e, s| e * e / of(s));
            (0.5 * level.ln() + 0.5 * mean(&|_, s| of(s).ln()), level)
        };
        if !(typical > 0.0) {
            return Ok(Self { nugget: mean(&|e, _| e * e).sqrt(), scale: 0.0 });
        }
        if mean(&|e, _| e * e) == 0.0 {
            return Ok(Self { nugget: 0.0, scale: 0.0 });
        }
        // Evenly spaced in the logarithm of the odds: never quite zero, as some s may be.
        let odds = |k: u32| 1.0 / (1.0 + (-24.0 * (f64::from(k) / f64::from(NUGGET_SHARES) - 0.5)).exp());
        let (_, share, level) = (0..=NUGGET_SHARES)
            .map(odds)
            .chain([1.0])
            .map(|share| (profile(share), share))
            .map(|((loss, level), share)| (loss, share, level))
            .fold((f64::INFINITY, 1.0, 0.0), |best, next| if next.0 < best.0 { next } else { best });
        Ok(Self { nugget: (level * share).sqrt(), scale: (level * (1.0 - share) / typical).sqrt() })
    }
}

/// What leaving out parts of the observations showed, one entry a number, in the order of the observations.
#[derive(Debug, Clone, PartialEq)]
pub struct Left {
    /// Observed minus predicted, field unit.
    pub errors: Vec<f64>,
    /// Standard deviation of each prediction from the coefficients alone, field unit.
    pub sigma: Vec<f64>,
    /// What makes the two agree.
    pub misfit: FieldMisfit,
}

/// Leaves out one part at a time, fits to the others and predicts it.
///
/// Points of one label in `groups` (a flight line, say) are left out together. The basis is that of all observations.
///
/// ```
/// use geomag_core::harmonic::{FitOptions, Observations, Positions, leave_out};
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
/// let left = leave_out(&observations, &FitOptions { order: 4, ..FitOptions::default() }, 5, None, 0, &Quiet)?;
/// assert_eq!(left.errors.len(), 300);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
///
/// # Errors
/// As [`fit`](super::fit) and [`select`](super::select).
pub fn leave_out(
    observations: &Observations,
    options: &FitOptions,
    folds: usize,
    groups: Option<&[u64]>,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Left> {
    let fold = deal(observations.point_count(), folds, groups, seed)?;
    let periods_m = PreparedFit::new(observations, options)?.periods_m;
    let options = FitOptions { period: Period::Metres(periods_m), covariance: true, ..options.clone() };
    let mut errors = vec![f64::NAN; observations.len()];
    let mut sigma = vec![f64::NAN; observations.len()];
    for part in 0..folds {
        monitor.advance(part as u64, folds as u64)?;
        let keep = |inside: bool| {
            let rows = observations.rows.iter().filter(|r| (fold[r.point as usize] == part) == inside);
            Observations {
                points: observations.points.clone(),
                rows: rows.copied().collect(),
                anomalies: observations.anomalies,
            }
        };
        let (training, hidden) = (keep(false), keep(true));
        let model = fit(&training, &options, &Quiet)?;
        let axis = |i: usize| hidden.rows.iter().map(|r| hidden.points[r.point as usize][i]).collect::<Vec<_>>();
        let (north, east, down) = (axis(0), axis(1), axis(2));
        let positions = Positions::new(&north, &east, &down)?;
        let field = model.field(&positions, true);
        let directions: Vec<[f64; 3]> = hidden
            .rows
            .iter()
            .zip(&field)
            .map(|(row, b)| match row.sensed {
                Sensed::Along(direction) => direction,
                Sensed::Intensity(main) => {
                    let total = [main[0] + b[0], main[1] + b[1], main[2] + b[2]];
                    total.map(|c| c / norm(total))
                }
            })
            .collect();
        let spread = model.sigma_along(&positions, &directions, true)?;
        // Residuals ask for the field at the points, of which each row here has its own.
        let rows = hidden
            .rows
            .iter()
            .enumerate()
            .map(|(k, row)| super::observations::ObservationRow { point: k as u32, ..*row });
        let alone = Observations { points: Vec::new(), rows: rows.collect(), anomalies: observations.anomalies };
        let found = residuals(&alone, &field);
        let mine = (0..observations.len()).filter(|&k| fold[observations.rows[k].point as usize] == part);
        for (k, (error, s)) in mine.zip(found.into_iter().zip(spread)) {
            (errors[k], sigma[k]) = (error, s);
        }
    }
    monitor.advance(folds as u64, folds as u64)?;
    let misfit = FieldMisfit::learn(&errors, &sigma)?;
    Ok(Left { errors, sigma, misfit })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn a_known_misfit_is_learnt() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(3);
        let sigma: Vec<f64> = (0..20_000).map(|k| 0.1 + f64::from(k % 100) * 0.05).collect();
        let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
        let errors: Vec<f64> = sigma.iter().map(|s| 1.5 * draw() + 0.7 * s * draw()).collect();
        let found = FieldMisfit::learn(&errors, &sigma).unwrap();
        assert!((found.nugget - 1.5).abs() < 0.06 && (found.scale - 0.7).abs() < 0.03, "{found:?}");
        let nees = errors.iter().zip(&sigma).map(|(e, &s)| (e / found.sigma(s)).powi(2)).sum::<f64>() / 2e4;
        assert!((nees - 1.0).abs() < 1e-9, "{nees}");
    }

    #[test]
    fn one_of_the_two_alone() {
        let errors = [1.0, -1.0, 1.0, -1.0];
        let constant = FieldMisfit::learn(&errors, &[0.0; 4]).unwrap();
        assert_eq!(constant, FieldMisfit { nugget: 1.0, scale: 0.0 });
        let grown: Vec<f64> = (1..400).map(|k| f64::from(k) * if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let sizes: Vec<f64> = grown.iter().map(|e| 0.5 * e.abs()).collect();
        let found = FieldMisfit::learn(&grown, &sizes).unwrap();
        assert!((found.scale - 2.0).abs() < 0.01 && found.nugget < 1.0, "{found:?}");
        assert!(FieldMisfit::learn(&[1.0], &[1.0]).is_err() && FieldMisfit::learn(&[1.0, 2.0], &[1.0]).is_err());
        assert!((FieldMisfit::default().sigma(0.3) - 0.3).abs() < f64::EPSILON);
        assert_eq!(FieldMisfit::learn(&[0.0; 3], &[1.0; 3]).unwrap(), FieldMisfit { nugget: 0.0, scale: 0.0 });
    }
}
