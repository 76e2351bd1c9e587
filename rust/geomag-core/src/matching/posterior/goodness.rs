//! Are the residuals what the model expects: a p-value of the many, and one of the wild ones.

use super::kernel::Detail;
use crate::statistics::{binomial_tail, normal_tail};

/// Share of misses that any track may have: tails make them harmless, and a sensor that throws one reading in twenty is common.
const WILD_SHARE: f64 = 0.1;

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
    let wild = binomial_tail(detail.misses, detail.known, WILD_SHARE);
    (2.0 * many.min(wild)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

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
