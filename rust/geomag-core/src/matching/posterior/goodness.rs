//! Are the residuals what the model expects: a p-value of the many, and one of the wild ones.

use super::decide::error_function;
use super::kernel::Detail;

/// Standard deviations beyond which a sample is a miss. A Student-t law with nu = 10 has 5 in 10,000 there, one with nu = 3 15 in 1,000.
pub(super) const MISS: f64 = 5.0;
/// Share of misses that any track may have: tails make them harmless, and a sensor that throws one reading in twenty is common.
const MISSES: f64 = 0.1;

/// p-value of residuals under one error level with tails `nu`, of which a share `temper` counts as independent (misses all do: a wild
/// reading is the sensor's own, and for a bad stretch of the map there are the other levels).
///
/// The smaller of two, times two (Bonferroni): the chance that of the samples without the misses the mean of
/// (nu + 1) z^2 / (nu + z^2) is as large (1 under the level, with a variance of 2 nu / (nu + 3) a sample), and that of as many
/// misses where one in ten is expected.
pub(super) fn p_value(detail: &Detail, nu: f64, temper: f64) -> f64 {
    let kept = (detail.known - detail.misses) as f64 * temper;
    let deviation = (2.0 * nu / ((nu + 3.0) * kept.max(1.0))).sqrt();
    let many = normal_tail((detail.misfit - 1.0) / deviation);
    let wild = binomial_tail(detail.misses, detail.known, MISSES);
    (2.0 * many.min(wild)).min(1.0)
}

/// Upper tail of the standard normal law.
fn normal_tail(z: f64) -> f64 {
    let half = 0.5 * (1.0 - error_function(z.abs() / std::f64::consts::SQRT_2));
    if z >= 0.0 { half } else { 1.0 - half }
}

/// Chance of at least `least` successes in `n` trials with probability `p`, in (0, 1).
fn binomial_tail(least: usize, n: usize, p: f64) -> f64 {
    let odds = (p / (1.0 - p)).ln();
    // Logarithm of the chance of k successes, from k = 0 on.
    let mut log = n as f64 * (1.0 - p).ln();
    let mut sum = 0.0;
    for k in 0..=n {
        if k >= least {
            sum += log.exp();
        }
        log += odds + ((n - k) as f64 / (k + 1) as f64).ln();
    }
    sum.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_are_those_of_their_laws() {
        // By exact enumeration: of 3 trials at one half, 1, 7/8, 1/2, 1/8; C(40, k) 0.1^k 0.9^(40 - k) summed from k = 12.
        for (least, wanted) in [(0, 1.0), (1, 0.875), (2, 0.5), (3, 0.125)] {
            approx::assert_relative_eq!(binomial_tail(least, 3, 0.5), wanted, epsilon = 1e-12);
        }
        approx::assert_relative_eq!(binomial_tail(12, 40, 0.1), 3.808_342_667e-4, max_relative = 1e-6);
        assert_eq!(binomial_tail(4, 3, 0.5), 0.0);
        approx::assert_relative_eq!(normal_tail(1.959_963_985), 0.025, epsilon = 1e-6);
        approx::assert_relative_eq!(normal_tail(-1.0), 0.841_344_746, epsilon = 1e-6);
    }

    #[test]
    fn a_few_wild_samples_are_forgiven_and_many_are_not() {
        let of = |misses| Detail { misfit: 1.0, misses, known: 40, ..Detail::default() };
        assert!(p_value(&of(2), 10.0, 1.0) > 0.5);
        assert!(p_value(&of(8), 10.0, 1.0) > 0.01);
        assert!(p_value(&of(16), 10.0, 1.0) < 1e-5);
        // What fits badly on the whole is found beside the wild ones; half as many independent samples say less of it.
        let bad = Detail { misfit: 2.0, ..of(2) };
        assert!(p_value(&bad, 10.0, 1.0) < 1e-3 && p_value(&bad, 10.0, 0.25) > 1e-3);
    }
}
