//! Readings gathered into one measurement: the mean of what is read minus what the map says.
//!
//! The map of a survey is right at long wavelengths and wrong at those of its line spacing. A mean over one and a half correlation lengths
//! keeps the first and loses the second, and the means of neighbouring batches are nearly independent, so that no state for the
//! map's error is needed.

use crate::bounds::{require_place, require_spread, require_values};

use serde::{Deserialize, Serialize};

use super::law::{MapLaw, MapPlace};
use super::owed::Owed;

/// Most readings that are kept of a batch.
const MOST: usize = 64;
/// Longest time that a batch is gathered over, seconds.
pub(super) const LONGEST_S: f64 = 600.0;
/// A reading further from the median than this many of the greater of their median deviation and 0.6 sigma is a spike.
const SPIKE: f64 = 4.0;
const SPIKE_SIGMA: f64 = 0.6;
/// Median absolute deviation to standard deviation of a normal law.
const MAD_TO_SIGMA: f64 = 1.4826;

/// One reading where it was indicated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Reading {
    pub value: f64,
    pub time_s: f64,
    /// Indicated place, map units.
    pub x: f64,
    pub y: f64,
    /// Metres above the map's height datum, where it matters.
    pub height_m: Option<f64>,
    /// Standard deviation of the map's error there.
    pub sigma: f64,
    /// What the coefficients of the vehicle's own field are multiplied by; empty without any.
    pub terms: Vec<f64>,
    /// What the errors of the INS add to it.
    pub owed: Owed,
}

/// Readings waiting to be used.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Batch {
    pub readings: Vec<Reading>,
    /// Indicated way since the first of them, metres.
    pub gathered_m: f64,
    /// Way over which to gather, metres.
    pub length_m: f64,
    /// One reading in so many is kept.
    every: u32,
    seen: u32,
}

/// The readings of a batch that are used, by their place in it, with their weights.
#[derive(Debug, Clone, Default)]
pub(super) struct Chosen {
    pub readings: Vec<(usize, f64)>,
    residuals: Vec<f64>,
    absolute: Vec<f64>,
    sorted: Vec<f64>,
    /// Root mean square of the map's sigma under them.
    pub sigma: f64,
    /// Mean of the values.
    pub value: f64,
    /// Mean age, seconds.
    pub age_s: f64,
    /// Variance of the mean by which the readings scatter more than they should.
    pub excess: f64,
}

impl Batch {
    pub fn clear(&mut self) {
        *self = Self { readings: std::mem::take(&mut self.readings), ..Self::default() };
        self.readings.clear();
    }

    /// Whether saved numbers make a batch of readings with so many terms.
    pub fn is_whole(&self, terms: usize) -> bool {
        self.readings.len() <= MOST
            && self.gathered_m.is_finite()
            && self.length_m.is_finite()
            && (self.readings.is_empty() || self.every > 0)
            && self.readings.iter().all(|r| {
                r.time_s.is_finite()
                    && require_place("reading", false, [r.x, r.y]).is_ok()
                    && require_values("reading", &[r.value]).is_ok()
                    && require_spread("sigma", r.sigma).is_ok()
                    && r.height_m.is_none_or(f64::is_finite)
                    && r.owed.is_sound()
                    && r.terms.len() == terms
                    && require_values("terms", &r.terms).is_ok()
            })
    }

    /// Takes a reading. A batch of more than 64 keeps every second one, and from then on half of those that come.
    pub fn push(&mut self, reading: Reading, law: &MapLaw, place: MapPlace) {
        if self.readings.is_empty() {
            (self.gathered_m, self.every, self.seen) = (0.0, 1, 0);
            self.length_m = 0.0;
        }
        self.length_m = self.length_m.max(law.batch_m(place.distance_m));
        if self.seen.is_multiple_of(self.every) {
            if self.readings.len() == MOST {
                let mut keep = false;
                self.readings.retain(|_| {
                    keep = !keep;
                    keep
                });
                self.every = self.every.saturating_mul(2);
            }
            self.readings.push(reading);
        }
        self.seen = self.seen.wrapping_add(1);
    }

    /// Whether it has all that it should.
    pub fn is_full(&self, now_s: f64) -> bool {
        self.readings.first().is_some_and(|r| self.gathered_m >= self.length_m || now_s - r.time_s >= LONGEST_S)
    }

    /// Weighs the readings and leaves spikes out. `expected` is what the map says of each where the filter thinks it was read, NaN
    /// where it says nothing; `noise` the standard deviation of a reading.
    pub fn choose(&self, now_s: f64, law: &MapLaw, noise: f64, expected: impl Fn(&Reading) -> f64, out: &mut Chosen) {
        out.readings.clear();
        out.residuals.clear();
        for (place, reading) in self.readings.iter().enumerate() {
            let residual = reading.value - expected(reading);
            if !residual.is_nan() {
                out.readings.push((place, 0.0));
                out.residuals.push(residual);
            }
        }
        let centre = median(&out.residuals, &mut out.sorted);
        for r in &mut out.residuals {
            *r -= centre;
        }
        out.absolute.clear();
        out.absolute.extend(out.residuals.iter().map(|r| r.abs()));
        let deviation = median(&out.absolute, &mut out.sorted);
        let mut k = 0;
        let residuals = &out.residuals;
        out.readings.retain(|(place, _)| {
            let usual = SPIKE_SIGMA * self.readings[*place].sigma.hypot(noise);
            let kept = residuals[k].abs() <= SPIKE * deviation.max(usual);
            k += 1;
            kept
        });
        let least = law.crossover().powi(2) + noise * noise;
        let weigh = |r: &Reading| 1.0 / (r.sigma * r.sigma + least).max(f64::MIN_POSITIVE);
        let total: f64 = out.readings.iter().map(|(place, _)| weigh(&self.readings[*place])).sum();
        (out.value, out.age_s) = (0.0, 0.0);
        let mut square = 0.0;
        for (place, weight) in &mut out.readings {
            let reading = &self.readings[*place];
            *weight = weigh(reading) / total;
            out.value += *weight * reading.value;
            out.age_s += *weight * (now_s - reading.time_s);
            square += *weight * reading.sigma * reading.sigma;
        }
        out.sigma = square.sqrt();
        let scatter = (MAD_TO_SIGMA * deviation).powi(2) - square - noise * noise;
        out.excess = scatter.max(0.0) / out.readings.len().max(1) as f64;
    }
}

fn median(values: &[f64], sorted: &mut Vec<f64>) -> f64 {
    sorted.clear();
    sorted.extend_from_slice(values);
    sorted.sort_unstable_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[n / 2],
        n => 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]),
    }
}
