//! Measurements of other kinds: positions and velocities from elsewhere, a new start.

use super::filter::ErrorFilter;
use super::integrity::RunningNis;
use super::motion::{FASTEST_M_S, POSITION, VELOCITY};
use super::options::check_covariance;
use super::state::Navigator;
use super::states::BIAS;
use crate::bounds::require_place;
use crate::error::{Error, Result, require_finite};
use crate::fix::Fix;

/// NIS of a position beyond which the filter and the fix contradict each other: chi-square with two degrees of freedom, 0.999.
pub(super) const CONTRADICTION: f64 = 13.8;
/// Least standard deviation of a position from elsewhere, metres: nothing is known exactly.
const LEAST_SIGMA_M: f64 = 1e-3;

/// What became of a measurement from elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// Normalised innovation squared before it was used: chi-square with two degrees of freedom.
    pub nis: f64,
    /// Whether it contradicted the filter, which then started anew from it.
    pub reset: bool,
}

impl Navigator {
    /// Takes a position from elsewhere (GNSS, terrain, a sighting) for the newest step: true minus indicated, metres east and north, with
    /// its covariance.
    ///
    /// It is believed: where the filter contradicts it (NIS beyond 13.8) the filter starts anew from it, INS errors kept.
    ///
    /// # Errors
    /// [`Error::Invalid`] before the first step or for a covariance that is none, [`Error::NotFinite`],
    /// [`Error::NotPositiveDefinite`]; nothing has changed then.
    pub fn correct_position(&mut self, offset_m: [f64; 2], covariance_m2: [[f64; 2]; 2]) -> Result<Correction> {
        require_place("offset_m", false, offset_m)?;
        check_covariance(&covariance_m2)?;
        let newest = self.newest()?;
        let error = offset_m.map(|o| -o);
        let nis = self.position_nis(error, covariance_m2);
        let reset = !(nis <= CONTRADICTION);
        if reset {
            self.start_again(error, covariance_m2);
        } else {
            self.take_pair(POSITION, error, covariance_m2);
        }
        self.state.last_fix_s = Some(newest);
        self.judge_again();
        Ok(Correction { nis, reset })
    }

    /// Takes a matcher's fix of the newest indicated position; one that may not be used, or has no covariance, is an error.
    ///
    /// # Errors
    /// As [`Navigator::correct_position`]; [`Error::Invalid`] for a fix that is not ok.
    pub fn correct(&mut self, fix: &Fix) -> Result<Correction> {
        match fix.covariance_m2 {
            Some(covariance) if fix.ok() => self.correct_position(fix.offset_m, covariance),
            Some(_) => Err(Error::invalid("fix", "one that may be used (ok)", fix.status.as_str())),
            None => Err(Error::invalid("fix", "one with a covariance", "none")),
        }
    }

    /// Takes a velocity from elsewhere (Doppler log, odometer with a heading) for the newest step: true velocity east and north, metres
    /// a second, with its standard deviation on each axis.
    ///
    /// # Errors
    /// [`Error::Invalid`] before the first step or for a sigma that is none, [`Error::NotFinite`].
    pub fn correct_velocity(&mut self, velocity_m_s: [f64; 2], sigma_m_s: f64) -> Result<Correction> {
        require_finite("velocity_m_s", &velocity_m_s)?;
        let speed = velocity_m_s[0].hypot(velocity_m_s[1]);
        if !(speed <= FASTEST_M_S) {
            return Err(Error::invalid("velocity_m_s", format!("a speed of at most {FASTEST_M_S} m/s"), speed));
        }
        crate::error::require_positive("sigma_m_s", sigma_m_s)?;
        self.newest()?;
        let indicated = self.state.newest.map_or([0.0; 2], |n| n.velocity_m_s);
        let error = [0, 1].map(|axis| indicated[axis] - velocity_m_s[axis]);
        let variance = sigma_m_s * sigma_m_s;
        let covariance = [[variance, 0.0], [0.0, variance]];
        let nis = self.pair_nis(VELOCITY, error, covariance);
        self.take_pair(VELOCITY, error, covariance);
        self.judge_again();
        Ok(Correction { nis, reset: false })
    }

    /// Starts anew at a place, map units, known with this covariance: what is known of the INS's other errors is kept.
    ///
    /// # Errors
    /// As [`Navigator::correct_position`].
    pub fn reset(&mut self, place: [f64; 2], covariance_m2: [[f64; 2]; 2]) -> Result<()> {
        require_place("place", self.field.geographic(), place)?;
        check_covariance(&covariance_m2)?;
        self.newest()?;
        let Some(newest) = self.state.newest else { return Ok(()) };
        let place = [self.field.wrap_x(place[0]), place[1]];
        let error = self.field.displacement_m(place, [newest.x, newest.y]);
        self.start_again(error, covariance_m2);
        self.judge_again();
        Ok(())
    }

    fn newest(&self) -> Result<f64> {
        self.state
            .newest
            .map(|n| n.time_s)
            .ok_or_else(|| Error::invalid("navigator", "a step before a correction", "none"))
    }

    /// NIS of a position error, metres east and north, measured with a covariance.
    pub(super) fn position_nis(&self, error: [f64; 2], covariance: [[f64; 2]; 2]) -> f64 {
        self.pair_nis(POSITION, error, covariance)
    }

    fn pair_nis(&self, first: usize, error: [f64; 2], covariance: [[f64; 2]; 2]) -> f64 {
        let f: &ErrorFilter = &self.state.filter;
        let d = [0, 1].map(|axis| error[axis] - f.mean()[first + axis]);
        let s = |i: usize, j: usize| f.at(first + i, first + j) + covariance[i][j];
        let (a, b, c) = (s(0, 0), s(0, 1), s(1, 1));
        let determinant = a * c - b * b;
        (c * d[0] * d[0] - 2.0 * b * d[0] * d[1] + a * d[1] * d[1]) / determinant.max(f64::MIN_POSITIVE)
    }

    /// Two numbers with a covariance, one after the other once they are made independent.
    pub(super) fn take_pair(&mut self, first: usize, error: [f64; 2], covariance: [[f64; 2]; 2]) {
        let least = LEAST_SIGMA_M * LEAST_SIGMA_M;
        let l00 = (covariance[0][0] + least).sqrt();
        let l10 = covariance[1][0] / l00;
        let l11 = (covariance[1][1] + least - l10 * l10).max(least).sqrt();
        let whitened = [
            ([(first, 1.0 / l00), (first + 1, 0.0)], error[0] / l00),
            ([(first, -l10 / (l00 * l11)), (first + 1, 1.0 / l11)], (error[1] - l10 / l00 * error[0]) / l11),
        ];
        for (slopes, z) in whitened {
            let predicted = self.state.filter.project(&slopes, &mut self.scratch);
            let mean = self.state.filter.mean();
            let innovation = z - slopes.iter().map(|(k, h)| h * mean[*k]).sum::<f64>();
            self.note_measurement(&slopes, predicted.variance + 1.0, innovation);
            self.state.filter.update(&slopes, predicted, innovation, 1.0, &mut self.scratch);
        }
    }

    /// A new position and an open sensor bias, independent of all that was known.
    pub(super) fn start_again(&mut self, error: [f64; 2], covariance: [[f64; 2]; 2]) {
        self.note_reset();
        let filter = &mut self.state.filter;
        for (axis, row) in covariance.iter().enumerate() {
            filter.separate(POSITION + axis, row[axis] + LEAST_SIGMA_M * LEAST_SIGMA_M);
        }
        filter.set(POSITION, POSITION + 1, covariance[0][1]);
        filter.separate(BIAS, self.state.options.bias_sigma.powi(2));
        filter.mean_mut()[POSITION..POSITION + 2].copy_from_slice(&error);
        self.state.batch.clear();
        self.state.running = RunningNis::new();
        self.state.resets = self.state.resets.saturating_add(1);
    }
}
