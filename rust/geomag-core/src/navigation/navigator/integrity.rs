//! How far the filter is to be believed: running innovations, the covariance that is reported, the protection level.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Weight of the newest measurement in the running NIS.
const GAIN: f64 = 0.1;
/// What the running NIS may exceed one by before the covariance is widened.
const ALLOWED: f64 = 0.2;
/// A single measurement says no more than this of the covariance.
const MOST_NIS: f64 = 100.0;
/// Error over the Gaussian 99 % radius of the reported covariance below which 99 and 99.9 % of the errors lay, on left-out lines of two
/// surveys and on flights kept apart.
const WIDENED_99: f64 = 1.4;
const WIDENED_999: f64 = 2.5;
/// Least risk: nothing is known of the tails beyond, nor are there numbers for them.
const LEAST_RISK: f64 = 1e-15;
/// Points of the table of radii, and directions of the integral behind each.
const TABLE: usize = 65;
const DIRECTIONS: usize = 96;

/// The mean of the innovations' normalised squares, the newest weighing most.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct RunningNis(f64);

impl RunningNis {
    pub fn new() -> Self {
        Self(1.0)
    }

    pub fn take(&mut self, nis: f64) {
        self.0 += GAIN * (nis.min(MOST_NIS) - self.0);
    }

    pub fn value(self) -> f64 {
        self.0
    }

    pub fn is_sound(self) -> bool {
        self.0.is_finite() && self.0 >= 0.0
    }

    /// By how much the covariance is widened before it is reported.
    pub fn factor(self) -> f64 {
        (self.0 - ALLOWED).max(1.0)
    }
}

/// Radius of the circle about the estimate that holds a two-dimensional normal error with a given probability, tabulated by the ratio
/// of the axes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Radius {
    /// Over the greater standard deviation, ratio from 0 to 1.
    table: [f64; TABLE],
}

impl Radius {
    pub fn new(probability: f64) -> Self {
        /// What every navigator but the textbooks asks for: saving one and restoring it should not cost an integral a table entry.
        static NINETY_NINE: LazyLock<Radius> = LazyLock::new(|| Radius::tabulated(0.99));
        if probability == 0.99 { NINETY_NINE.clone() } else { Self::tabulated(probability) }
    }

    fn tabulated(probability: f64) -> Self {
        let mut table = [0.0; TABLE];
        for (k, entry) in table.iter_mut().enumerate() {
            *entry = radius(probability, k as f64 / (TABLE - 1) as f64);
        }
        Self { table }
    }

    /// Metres, for a covariance in square metres.
    pub fn of(&self, covariance: [[f64; 2]; 2]) -> f64 {
        let [major, minor] = axes(covariance);
        if major == 0.0 {
            return 0.0;
        }
        let at = (minor / major).clamp(0.0, 1.0) * (TABLE - 1) as f64;
        let k = (at as usize).min(TABLE - 2);
        let t = at - k as f64;
        major * ((1.0 - t) * self.table[k] + t * self.table[k + 1])
    }
}

/// Radii of the circles about estimates that hold errors with these covariances (square metres) with a probability, metres.
///
/// ```
/// use geomag_core::navigation::navigator::radii_m;
/// let [radius] = radii_m(&[[[100.0, 0.0], [0.0, 100.0]]], 0.99)?[..] else { unreachable!() };
/// assert!((radius - 30.35).abs() < 0.01);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
///
/// # Errors
/// [`Error::Invalid`] for a probability outside (0, 1).
pub fn radii_m(covariances_m2: &[[[f64; 2]; 2]], probability: f64) -> Result<Vec<f64>> {
    if !(probability > 0.0 && probability < 1.0) {
        return Err(Error::invalid("probability", "a number in (0, 1)", probability));
    }
    let radius = Radius::new(probability);
    Ok(covariances_m2.iter().map(|c| radius.of(*c)).collect())
}

/// Standard deviations along the axes of the ellipse, greater first.
pub(super) fn axes(c: [[f64; 2]; 2]) -> [f64; 2] {
    let mean = 0.5 * (c[0][0] + c[1][1]);
    let half = (0.5 * (c[0][0] - c[1][1])).hypot(0.5 * (c[0][1] + c[1][0]));
    [(mean + half).max(0.0).sqrt(), (mean - half).max(0.0).sqrt()]
}

/// The radius, over the greater standard deviation, that (a, ratio b) with a, b standard normal stays within with a probability.
///
/// Over directions of the plane where the law is round: the mean of exp(-r^2 / 2 s^2), s the factor by which a direction is shortened, is the
/// probability of a length beyond r. The midpoint rule gains digits with every point, for the integrand is smooth and periodic.
fn radius(probability: f64, ratio: f64) -> f64 {
    if ratio < 1e-3 {
        return search(|r| 1.0 - libm::erfc(r * std::f64::consts::FRAC_1_SQRT_2), probability);
    }
    let shortened: [f64; DIRECTIONS] = std::array::from_fn(|k| {
        let angle = (k as f64 + 0.5) * std::f64::consts::FRAC_PI_2 / DIRECTIONS as f64;
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        -0.5 / (cos * cos + ratio * ratio * sin * sin)
    });
    // Its logarithm falls in r^2 and is convex: Newton's steps from 0 never pass the root.
    let (beyond, mut squared) = ((1.0 - probability).ln(), 0.0);
    for _ in 0..60 {
        let (mut sum, mut slope) = (0.0, 0.0);
        for s in shortened {
            let share = libm::exp(squared * s);
            sum += share;
            slope += share * s;
        }
        let step = (beyond - (sum / DIRECTIONS as f64).ln()) * sum / slope;
        if !(step > 1e-15 * squared) {
            break;
        }
        squared += step;
    }
    squared.sqrt()
}

/// Where a rising function reaches a value, from 0 to 40.
fn search(function: impl Fn(f64) -> f64, value: f64) -> f64 {
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if function(middle) < value {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Radius that holds the error with probability 1 - `risk`, over the Gaussian 99 % radius of the reported covariance.
///
/// Errors on real maps have longer tails than the normal law: their quantiles at 1e-2 and 1e-3 were measured, beyond these they are
/// continued as a power of the risk.
///
/// # Errors
/// [`Error::Invalid`] for a risk outside (0, 1).
pub(super) fn widening(risk: f64) -> Result<f64> {
    if !(LEAST_RISK..1.0).contains(&risk) {
        return Err(Error::invalid("integrity_risk", format!("a probability between {LEAST_RISK} and 1"), risk));
    }
    let gaussian = (risk.ln() / 0.01_f64.ln()).sqrt();
    let power = (WIDENED_999 / WIDENED_99).log10();
    Ok(if risk >= 0.01 { WIDENED_99 * gaussian } else { WIDENED_99 * (0.01 / risk).powf(power) })
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn radii_are_those_of_the_two_laws_at_the_ends() {
        let radius = Radius::new(0.99);
        // Round: sqrt(-2 ln 0.01); on a line: the two-sided normal quantile.
        assert_relative_eq!(radius.of([[4.0, 0.0], [0.0, 4.0]]), 2.0 * 3.034_854_258_770_293, max_relative = 1e-6);
        assert_relative_eq!(radius.of([[9.0, 0.0], [0.0, 0.0]]), 3.0 * 2.575_829_303_548_901, max_relative = 1e-6);
        // Turned by 45 degrees.
        assert_relative_eq!(radius.of([[4.5, 4.5], [4.5, 4.5]]), 3.0 * 2.575_829_303_548_901, max_relative = 1e-6);
    }

    #[test]
    fn the_circle_holds_the_share_of_draws() {
        use crate::synthetic::Random;
        let radius = Radius::new(0.99);
        let r = radius.of([[100.0, 0.0], [0.0, 36.0]]);
        let mut random = Random::new(5);
        let n = 40_000;
        let inside = (0..n).filter(|_| (10.0 * random.normal()).hypot(6.0 * random.normal()) < r).count();
        assert_relative_eq!(inside as f64 / f64::from(n), 0.99, epsilon = 0.0015);
    }

    #[test]
    fn the_multiple_is_as_measured_and_never_falls() {
        assert_relative_eq!(widening(1e-2).unwrap(), 1.4, max_relative = 1e-12);
        assert_relative_eq!(widening(1e-3).unwrap(), 2.5, max_relative = 1e-12);
        let mut before = 0.0;
        for risk in [0.9, 0.5, 0.1, 0.02, 0.0099, 1e-3, 1e-5, 1e-9] {
            let now = widening(risk).unwrap();
            assert!(now > before);
            before = now;
        }
        assert!(widening(0.0).is_err() && widening(1.0).is_err() && widening(f64::NAN).is_err());
    }
}
