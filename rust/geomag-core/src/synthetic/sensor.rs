//! What a magnetometer or gravimeter gets wrong.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

use crate::error::{Error, Result, require_finite, require_not_negative, require_positive};
use crate::synthetic::Random;

/// Errors of a field sensor, and of a field that changes with time: measured = true + what this describes.
///
/// `noise_k = correlation noise_(k-1) + sqrt(1 - correlation^2) sigma N(0, 1)`: of standard deviation `sigma` at every
/// sample, however correlated. The daily variation is a sinusoid `diurnal cos(2 pi t / diurnal_period_s + phase)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorModel {
    /// Standard deviation of the noise, value units.
    pub sigma: f64,
    /// Correlation of the noise from one sample to the next, in [0, 1).
    pub correlation: f64,
    /// Share of the samples that are spoilt, in [0, 1].
    pub outlier_rate: f64,
    /// Standard deviation of what is added to a spoilt sample, value units.
    pub outlier_sigma: f64,
    /// Constant error (vehicle field, base level), value units.
    pub bias: f64,
    /// Standard deviation of a further constant drawn anew for each run, value units.
    pub bias_sigma: f64,
    /// Linear drift, value units an hour.
    pub drift_per_h: f64,
    /// Amplitude of the daily variation, value units.
    pub diurnal: f64,
    /// Period of the daily variation, seconds.
    pub diurnal_period_s: f64,
    /// Phase of the daily variation at time zero, degrees.
    pub diurnal_phase_deg: f64,
    /// Least count that readings are rounded to, value units; zero for none.
    pub resolution: f64,
}

impl Default for SensorModel {
    /// A perfect sensor in a steady field.
    fn default() -> Self {
        Self {
            sigma: 0.0,
            correlation: 0.0,
            outlier_rate: 0.0,
            outlier_sigma: 0.0,
            bias: 0.0,
            bias_sigma: 0.0,
            drift_per_h: 0.0,
            diurnal: 0.0,
            diurnal_period_s: 86_400.0,
            diurnal_phase_deg: 0.0,
            resolution: 0.0,
        }
    }
}

impl SensorModel {
    /// White noise and nothing else.
    pub fn white(sigma: f64) -> Self {
        Self { sigma, ..Self::default() }
    }

    fn check(&self) -> Result<()> {
        require_not_negative("sensor sigma", self.sigma)?;
        if !(0.0..1.0).contains(&self.correlation) {
            return Err(Error::invalid("sensor correlation", "in [0, 1)", self.correlation));
        }
        if !(0.0..=1.0).contains(&self.outlier_rate) {
            return Err(Error::invalid("sensor outlier_rate", "in [0, 1]", self.outlier_rate));
        }
        require_not_negative("sensor outlier_sigma", self.outlier_sigma)?;
        require_finite("sensor bias", &[self.bias])?;
        require_not_negative("sensor bias_sigma", self.bias_sigma)?;
        require_finite("sensor drift_per_h", &[self.drift_per_h])?;
        require_finite("sensor diurnal", &[self.diurnal])?;
        require_positive("sensor diurnal_period_s", self.diurnal_period_s)?;
        require_finite("sensor diurnal_phase_deg", &[self.diurnal_phase_deg])?;
        require_not_negative("sensor resolution", self.resolution)?;
        Ok(())
    }

    /// Readings of a true field at given times (seconds).
    ///
    /// # Errors
    /// [`Error::Invalid`] or [`Error::NotFinite`] naming the parameter, [`Error::Shape`] for unequal lengths.
    pub fn read(&self, truth: &[f64], time_s: &[f64], random: &mut Random) -> Result<Vec<f64>> {
        self.check()?;
        require_finite("field along the path", truth)?;
        if time_s.len() != truth.len() {
            let (needed, got) = (format!("({},)", truth.len()), format!("({},)", time_s.len()));
            return Err(Error::shape("time_s", needed, got));
        }
        let constant = self.bias + self.bias_sigma * random.normal();
        let innovation = (1.0 - self.correlation * self.correlation).sqrt();
        let mut noise = 0.0;
        let readings = truth.iter().zip(time_s).enumerate().map(|(k, (&field, &t))| {
            let fresh = self.sigma * random.normal();
            noise = if k == 0 { fresh } else { self.correlation * noise + innovation * fresh };
            let spoilt = random.unit() < self.outlier_rate;
            let outlier = self.outlier_sigma * random.normal();
            let phase = TAU * t / self.diurnal_period_s + self.diurnal_phase_deg.to_radians();
            let daily = if self.diurnal == 0.0 { 0.0 } else { self.diurnal * libm::cos(phase) };
            let reading =
                field + constant + self.drift_per_h * t / 3600.0 + daily + noise + if spoilt { outlier } else { 0.0 };
            if self.resolution > 0.0 { (reading / self.resolution).round() * self.resolution } else { reading }
        });
        Ok(readings.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn read(model: SensorModel, n: usize) -> Vec<f64> {
        let time: Vec<f64> = (0..n).map(|k| k as f64).collect();
        model.read(&vec![0.0; n], &time, &mut Random::new(8)).unwrap()
    }

    #[test]
    fn noise_has_its_size_and_correlation() {
        let n = 200_000;
        let v = read(SensorModel { sigma: 3.0, correlation: 0.8, ..SensorModel::default() }, n);
        let variance = v.iter().map(|v| v * v).sum::<f64>() / n as f64;
        let lagged = v.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n as f64;
        assert_relative_eq!(variance.sqrt(), 3.0, max_relative = 0.02);
        assert_relative_eq!(lagged / variance, 0.8, max_relative = 0.02);
    }

    #[test]
    fn outliers_come_at_their_rate_and_systematic_parts_are_exact() {
        let v = read(SensorModel { outlier_rate: 0.1, outlier_sigma: 100.0, ..SensorModel::default() }, 20_000);
        let spoilt = v.iter().filter(|v| **v != 0.0).count() as f64;
        assert!((spoilt - 2000.0).abs() < 4.0 * (20_000.0 * 0.1 * 0.9_f64).sqrt());
        let steady = SensorModel { bias: 5.0, drift_per_h: 3600.0, ..SensorModel::default() };
        assert_eq!(read(steady, 3), [5.0, 6.0, 7.0]);
        let daily = SensorModel { diurnal: 2.0, diurnal_period_s: 4.0, resolution: 0.5, ..SensorModel::default() };
        assert_eq!(read(daily, 4), [2.0, 0.0, -2.0, 0.0]);
    }

    #[test]
    fn bad_sensors_are_refused() {
        for bad in [
            SensorModel::white(-1.0),
            SensorModel::white(f64::NAN),
            SensorModel { correlation: 1.0, ..SensorModel::default() },
            SensorModel { outlier_rate: 1.5, ..SensorModel::default() },
            SensorModel { diurnal_period_s: 0.0, ..SensorModel::default() },
        ] {
            assert!(bad.read(&[1.0], &[0.0], &mut Random::new(0)).is_err());
        }
        assert!(SensorModel::default().read(&[1.0], &[], &mut Random::new(0)).is_err());
    }
}
