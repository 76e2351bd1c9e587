//! A vehicle's own field on a scalar magnetometer: the terms of Tolles and Lawson (1950).
//!
//! With the field `b` in the vehicle's axes (from a vector magnetometer, or the main field turned by the attitude), its unit
//! vector `u` and its rate of change `r`, the scalar sensor reads too much by a sum of 18 terms: three of permanent
//! magnetisation `u_i`, six of induced magnetisation `u_i b_j / s` for i <= j, nine of eddy currents `u_i r_j / s`; `s` is
//! 50,000 nT, so that all but the last are of order one. Form and order as in Gnadt et al., *Signal Enhancement for Magnetic
//! Navigation Challenge Problem* (arXiv 2007.12158), section IV. How coefficients are fitted is not this module's business.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_positive};
use crate::state::Saved;

/// Terms of the model: 3 permanent, 6 induced, 9 of eddy currents.
pub const TERMS: usize = 18;

/// What induced and eddy terms are divided by, nT.
pub const SCALE_NT: f64 = 50_000.0;

/// The terms of one sample: field in the vehicle's axes and its rate, nT and nT a second (or a sample).
///
/// NaN in the field gives NaN throughout, NaN in the rate alone gives NaN eddy terms; a field of length zero has no direction.
pub fn terms(field: [f64; 3], rate: [f64; 3]) -> [f64; TERMS] {
    let length = (field[0] * field[0] + field[1] * field[1] + field[2] * field[2]).sqrt();
    let unit = field.map(|b| b / length);
    let mut out = [0.0; TERMS];
    out[..3].copy_from_slice(&unit);
    let mut k = 3;
    for i in 0..3 {
        for b in &field[i..] {
            out[k] = unit[i] * b / SCALE_NT;
            k += 1;
        }
    }
    for u in unit {
        for r in rate {
            out[k] = u * r / SCALE_NT;
            k += 1;
        }
    }
    out
}

/// The rate of a vector at every sample by central differences; one-sided at ends, at gaps longer than `max_gap_s` and beside
/// samples that are no numbers. Without times a sample is the unit of time. NaN where no neighbour is left.
///
/// # Errors
/// [`Error::Shape`] for unequal lengths, [`Error::Invalid`] where time does not rise or the gap is not positive.
pub fn rates(field: &[[f64; 3]], time_s: Option<&[f64]>, max_gap_s: f64) -> Result<Vec<[f64; 3]>> {
    if !(max_gap_s > 0.0) {
        return Err(Error::invalid("compensation max_gap_s", "a number > 0", max_gap_s));
    }
    if let Some(time) = time_s {
        if time.len() != field.len() {
            let needed = format!("({},) as the field", field.len());
            return Err(Error::shape("compensation time_s", needed, format!("({},)", time.len())));
        }
        crate::error::require_finite("compensation time_s", time)?;
        if let Some(k) = time.windows(2).position(|w| w[1] <= w[0]) {
            let what = format!("compensation time_s[{}]", k + 1);
            return Err(Error::invalid(what, format!("a time after {}", time[k]), time[k + 1]));
        }
    }
    let at = |k: usize| time_s.map_or(k as f64, |t| t[k]);
    let known = |k: usize| field[k].iter().all(|b| b.is_finite());
    let joined = |a: usize, b: usize| known(a) && known(b) && at(b) - at(a) <= max_gap_s;
    let rows = (0..field.len()).map(|k| {
        let before = if k > 0 && joined(k - 1, k) { k - 1 } else { k };
        let after = if k + 1 < field.len() && joined(k, k + 1) { k + 1 } else { k };
        let span = at(after) - at(before);
        if span > 0.0 { std::array::from_fn(|i| (field[after][i] - field[before][i]) / span) } else { [f64::NAN; 3] }
    });
    Ok(rows.collect())
}

/// Takes the vehicle's field off readings as they come: coefficients, and the sample before.
///
/// Rates are differences to the sample before, half a sample late, where a log has central ones. After a gap, or a sample that
/// is no number, the first sample is without eddy terms.
///
/// ```
/// use geomag_core::compensation::{Compensator, TERMS};
/// let mut coefficients = [0.0; TERMS];
/// coefficients[0] = 100.0;
/// let mut compensator = Compensator::new(coefficients, 0.25)?;
/// let quiet = compensator.update(0.0, [30_000.0, 0.0, 40_000.0], 50_060.0)?;
/// assert!((quiet - 50_000.0).abs() < 1e-9);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Compensator {
    coefficients: Vec<f64>,
    max_gap_s: f64,
    last: Option<(f64, [f64; 3])>,
}

impl Saved for Compensator {
    const NAME: &'static str = "Compensator";

    fn check(&self) -> Result<()> {
        self.validate()
    }
}

impl Compensator {
    /// From fitted coefficients (rates in nT a second) and the longest step over which a rate is taken.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Invalid`].
    pub fn new(coefficients: [f64; TERMS], max_gap_s: f64) -> Result<Self> {
        crate::error::require_finite("compensation coefficients", &coefficients)?;
        require_positive("compensation max_gap_s", max_gap_s)?;
        Ok(Self { coefficients: coefficients.to_vec(), max_gap_s, last: None })
    }

    /// Whether a state that was read back can be gone on with.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Invalid`].
    pub fn validate(&self) -> Result<()> {
        let Ok(coefficients) = <[f64; TERMS]>::try_from(self.coefficients.as_slice()) else {
            let got = format!("({},)", self.coefficients.len());
            return Err(Error::shape("compensation coefficients", format!("({TERMS},)"), got));
        };
        Self::new(coefficients, self.max_gap_s).map(drop)
    }

    /// The coefficients.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    /// The longest step over which a rate is taken, seconds.
    pub fn max_gap_s(&self) -> f64 {
        self.max_gap_s
    }

    /// The reading without the vehicle's field; NaN where field or reading are no numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] where time does not rise.
    pub fn update(&mut self, time_s: f64, field: [f64; 3], reading: f64) -> Result<f64> {
        if !time_s.is_finite() {
            return Err(Error::invalid("compensation time_s", "a finite number", time_s));
        }
        let mut rate = [0.0; 3];
        if let Some((before, last)) = self.last {
            if time_s <= before {
                return Err(Error::invalid("compensation time_s", format!("a time after {before}"), time_s));
            }
            if time_s - before <= self.max_gap_s {
                rate = std::array::from_fn(|i| (field[i] - last[i]) / (time_s - before));
            }
        }
        if !field.iter().all(|b| b.is_finite()) {
            return Ok(f64::NAN);
        }
        self.last = Some((time_s, field));
        let own: f64 = terms(field, rate).iter().zip(&self.coefficients).map(|(a, c)| a * c).sum();
        Ok(reading - own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_stand_in_their_order() {
        let t = terms([30_000.0, 0.0, 40_000.0], [500.0, -1000.0, 0.0]);
        let same = |got: &[f64], right: &[f64]| {
            assert_eq!(got.len(), right.len());
            assert!(got.iter().zip(right).all(|(a, b)| (a - b).abs() < 1e-15), "{got:?} {right:?}");
        };
        same(&t[..3], &[0.6, 0.0, 0.8]);
        same(&t[3..9], &[0.6 * 0.6, 0.0, 0.6 * 0.8, 0.0, 0.0, 0.8 * 0.8]);
        same(&t[9..12], &[0.6 * 0.01, -0.6 * 0.02, 0.0]);
        same(&t[15..], &[0.8 * 0.01, -0.8 * 0.02, 0.0]);
    }

    #[test]
    fn rates_do_not_bridge_gaps_or_bad_samples() {
        let line: Vec<[f64; 3]> = (0..6).map(|k| [f64::from(k) * 2.0, 0.0, 1.0]).collect();
        let time = [0.0, 0.1, 0.2, 5.0, 5.1, 5.2];
        let mut field = line.clone();
        field[4][1] = f64::NAN;
        let found = rates(&field, Some(&time), 0.25).unwrap();
        assert!((found[1][0] - 20.0).abs() < 1e-9 && (found[2][0] - 20.0).abs() < 1e-9);
        assert!(found[3][0].is_nan() && found[4][0].is_nan() && found[5][0].is_nan());
        assert_eq!(rates(&line, None, 1.0).unwrap()[3], [2.0, 0.0, 0.0]);
        assert!(rates(&line, Some(&[0.0; 6]), 1.0).is_err());
    }

    #[test]
    fn a_stream_is_the_log_half_a_sample_late() {
        let mut coefficients = [0.0; TERMS];
        for (k, c) in coefficients.iter_mut().enumerate() {
            *c = 10.0 * (k as f64 + 0.5).sin();
        }
        let field = |t: f64| [20_000.0 + 900.0 * (t * 0.8).sin(), 3000.0 * (t * 0.5).cos(), 45_000.0];
        let mut stream = Compensator::new(coefficients, 0.5).unwrap();
        for k in 0..50 {
            let t = 0.1 * f64::from(k);
            let quiet = stream.update(t, field(t), 50_000.0).unwrap();
            let late = if k == 0 { [0.0; 3] } else { std::array::from_fn(|i| (field(t)[i] - field(t - 0.1)[i]) / 0.1) };
            let own: f64 = terms(field(t), late).iter().zip(&coefficients).map(|(a, c)| a * c).sum();
            assert!((quiet - (50_000.0 - own)).abs() < 1e-6);
        }
        assert!(stream.update(6.0, [f64::NAN; 3], 50_000.0).unwrap().is_nan());
        assert!(stream.update(6.0, field(6.0), 50_000.0).is_ok());
        assert!(stream.update(5.9, field(6.0), 50_000.0).is_err());
    }
}
