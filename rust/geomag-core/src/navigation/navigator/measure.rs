//! Taking readings in: gathered, weighed, linearised, used.

use super::batch::Reading;
use super::carry::radii;
use super::motion::{POSITION, VELOCITY};
use super::outcome::{Indicated, NavigatorOutcome};
use super::owed::Owed;
use super::state::{Navigator, Newest};
use super::states::{BIAS, REGISTRATION, STATES};
use super::watch::TimedSample;
use crate::field::Field;
use crate::kalman::regression;

/// NIS of a single reading beyond which it is no word on the covariance, unless the one before was as bad.
const STARTLING: f64 = 25.0;
/// Least half width of the lattice, cells: within less the interpolation of the map has corners, not slopes.
const LEAST_LATTICE_CELLS: f64 = 0.05;

impl Navigator {
    /// What the map says at an indicated place; NaN where it says nothing.
    pub(super) fn expected(&self, indicated: &Indicated) -> f64 {
        value_at(self.field.as_ref(), self.field.wrap_x(indicated.x), indicated.y, indicated.height_m)
    }

    /// What the errors of the INS add to a reading that is taken now.
    fn owed(&self, now: &Newest) -> Owed {
        if !self.state.options.gravity {
            return Owed::default();
        }
        let latitude_rad = self.latitude_rad(now.y);
        Owed::of_gravity(latitude_rad, radii(latitude_rad), now.velocity_m_s)
    }

    /// Gathers a reading and uses the batch once it is full.
    pub(super) fn read(
        &mut self,
        now: &Newest,
        value: Option<f64>,
        height_m: Option<f64>,
        terms: &[f64],
    ) -> (NavigatorOutcome, Option<f64>) {
        let mut outcome = NavigatorOutcome::Waiting;
        if let Some(value) = value {
            let error = [self.state.filter.mean()[POSITION], self.state.filter.mean()[POSITION + 1]];
            let [x, y] = self.corrected(now.x, now.y, error);
            let expected = value_at(self.field.as_ref(), x, y, height_m);
            let place = self.law.at(self.field.as_ref(), x, y, height_m).filter(|_| !expected.is_nan());
            self.state.off_map = place.is_none();
            if let Some(place) = place {
                let sigma = place.sigma.hypot(self.state.options.reading_sigma);
                self.state.is_stuck = self.state.stuck.take(value, expected, sigma);
                if self.state.is_stuck {
                    // What was gathered of the run is as wrong as the newest.
                    self.state.batch.clear();
                } else {
                    self.state.heard_s = Some(now.time_s);
                    let owed = self.owed(now);
                    let mean = self.state.filter.mean();
                    let own = own_field(&mean[STATES..], terms) + owed.by(mean, 0.0);
                    let reading = Reading {
                        value,
                        time_s: now.time_s,
                        x: now.x,
                        y: now.y,
                        height_m,
                        sigma: place.sigma,
                        terms: terms.to_vec(),
                        owed,
                    };
                    self.state.batch.push(reading, &self.law, place);
                    if let Some(plan) = self.state.options.matcher {
                        let spacing = plan.spacing_m.unwrap_or(self.law.window_spacing_m());
                        let sample =
                            TimedSample { time_s: now.time_s, x: now.x, y: now.y, height_m, value: value - own };
                        self.state.watch.keep(sample, spacing, plan.samples);
                    }
                }
            } else {
                outcome = NavigatorOutcome::OffMap;
            }
        }
        if !self.state.batch.is_full(now.time_s) {
            return (outcome, None);
        }
        let used = self.use_batch(now);
        self.state.batch.clear();
        match used {
            Some((nis, weight)) => {
                (if weight < 1.0 { NavigatorOutcome::Downweighted } else { NavigatorOutcome::Updated }, Some(nis))
            }
            None => (NavigatorOutcome::OffMap, None),
        }
    }

    /// The measurement of a batch: the mean of its readings against the mean of the map under them.
    ///
    /// Returns the normalised innovation squared and the weight it was used with; `None` where the map knows too little.
    fn use_batch(&mut self, now: &Newest) -> Option<(f64, f64)> {
        let field = self.field.as_ref();
        let filter = &self.state.filter;
        let mean = filter.mean();
        let noise = self.state.options.reading_sigma;
        let scale = self.per_metre(now.y);
        // Where a reading was taken if the position error is what the filter thinks, shifted by `d` metres: the velocity error is taken
        // along, and so is the displacement of the map.
        let at = |reading: &Reading, d: [f64; 2]| {
            let age = now.time_s - reading.time_s;
            let shift =
                |axis: usize| d[axis] - mean[POSITION + axis] + mean[VELOCITY + axis] * age + mean[REGISTRATION + axis];
            let (x, y) = (reading.x + shift(0) * scale[0], reading.y + shift(1) * scale[1]);
            value_at(field, x, y, reading.height_m)
        };
        let mut chosen = std::mem::take(&mut self.chosen);
        let mut slopes = std::mem::take(&mut self.slopes);
        let coefficients = &mean[STATES..];
        let owed_by = |r: &Reading| r.owed.by(mean, now.time_s - r.time_s);
        let expected = |r: &Reading| at(r, [0.0; 2]) + own_field(coefficients, &r.terms) + owed_by(r);
        self.state.batch.choose(now.time_s, &self.law, noise, expected, &mut chosen);
        let readings = &self.state.batch.readings;
        let count = chosen.readings.len();
        let spacing = field.spacing();
        let exact = self.exact_slopes;
        let covariance = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let (a, b) = (POSITION + i, POSITION + j);
                let (r, s) = (REGISTRATION + i, REGISTRATION + j);
                let least = if i == j { (LEAST_LATTICE_CELLS * spacing[i] / scale[i]).powi(2) } else { 0.0 };
                let wide = filter.at(a, b) + filter.at(r, s) - filter.at(a, s) - filter.at(r, b);
                if exact { least } else { wide + least }
            })
        });
        let plane = if count == 0 {
            None
        } else {
            regression::fit(covariance, |d| {
                chosen.readings.iter().map(|(k, weight)| weight * at(&readings[*k], d)).sum()
            })
        };
        let result = plane.map(|plane| {
            let [east, north] = plane.slope;
            let weighed = |of: &dyn Fn(&Reading) -> f64| -> f64 {
                chosen.readings.iter().map(|(k, weight)| weight * of(&readings[*k])).sum()
            };
            let age = |r: &Reading| now.time_s - r.time_s;
            slopes.clear();
            slopes.extend([
                (POSITION, -east),
                (POSITION + 1, weighed(&|r| r.owed.north) - north),
                (VELOCITY, east * chosen.age_s + weighed(&|r| r.owed.velocity[0])),
                (VELOCITY + 1, north * chosen.age_s + weighed(&|r| r.owed.velocity[1] - r.owed.north * age(r))),
                (BIAS, 1.0),
                (REGISTRATION, east),
                (REGISTRATION + 1, north),
            ]);
            let mut own = weighed(&owed_by);
            for (term, coefficient) in coefficients.iter().enumerate() {
                let slope = weighed(&|r| r.terms[term]);
                slopes.push((STATES + term, slope));
                own += coefficient * slope;
            }
            let innovation = chosen.value - plane.mean - mean[BIAS] - own;
            let batched = self.state.batch.length_m > 0.0;
            let variance = self.law.mean_variance(chosen.sigma, batched)
                + 2.0 * plane.left
                + noise * noise / count as f64
                + chosen.excess;
            (innovation, variance, batched)
        });
        self.chosen = chosen;
        let used = result.and_then(|(innovation, variance, batched)| self.take(&slopes, innovation, variance, batched));
        self.slopes = slopes;
        used
    }

    /// Takes a number in with a Student-t weight; returns as [`Navigator::use_batch`].
    fn take(&mut self, slopes: &[(usize, f64)], innovation: f64, variance: f64, batched: bool) -> Option<(f64, f64)> {
        let predicted = self.state.filter.project(slopes, &mut self.scratch);
        let variance = variance.max(self.state.filter.rounding(slopes));
        let total = predicted.variance + variance;
        if !(total > 0.0) {
            return None;
        }
        let nis = innovation * innovation / total;
        let nu = self.state.options.nu;
        let weight = if nu.is_finite() { ((nu + 1.0) / (nu + nis)).min(1.0) } else { 1.0 };
        // S divided by the weight: what is added stands in R.
        let effective = total / weight - predicted.variance;
        self.note_measurement(slopes, total / weight, innovation);
        self.state.filter.update(slopes, predicted, innovation, effective, &mut self.scratch);
        if let Some(jump) = self.state.shift.take(innovation, total.sqrt(), !batched) {
            // A jump of the sensor's level: its bias is open again.
            self.state.filter.widen(BIAS, jump * jump);
        }
        let startling = !batched && nis > STARTLING;
        if !startling || self.state.startled {
            self.state.running.take(nis);
        }
        self.state.startled = startling;
        Some((nis, weight))
    }
}

/// What the terms besides the field add to a reading.
fn own_field(coefficients: &[f64], terms: &[f64]) -> f64 {
    coefficients.iter().zip(terms).map(|(c, t)| c * t).sum()
}

/// The field at a place, at a height where one is given.
pub(super) fn value_at(field: &dyn Field, x: f64, y: f64, height_m: Option<f64>) -> f64 {
    height_m.map_or_else(|| field.value(x, y), |height| field.value_at(x, y, height))
}
