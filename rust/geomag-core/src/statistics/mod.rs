//! Tails of the laws that residuals and innovations are judged by. The special functions are those of `libm` and `statrs`.

mod disc;

use statrs::function::{beta::beta_reg, gamma};

use crate::error::{Error, Result};
pub(crate) use disc::{normal_in_disc, round_normal_in_disc};

/// Probability that a chi-square variable with `dof` degrees of freedom is at most `x`; NaN without a degree of freedom.
///
/// ```
/// let p = geomag_core::kalman::chi_square_cdf(5.991_464_547, 2);
/// assert!((p - 0.95).abs() < 1e-9);
/// ```
pub fn chi_square_cdf(x: f64, dof: usize) -> f64 {
    chi_square(x, dof as f64, 0.0, gamma::gamma_lr)
}

/// Probability that a chi-square variable with `dof` degrees of freedom, whole or not, exceeds `x`.
pub(crate) fn chi_square_survival(x: f64, dof: f64) -> f64 {
    chi_square(x, dof, 1.0, gamma::gamma_ur)
}

fn chi_square(x: f64, dof: f64, at_zero: f64, regularised: fn(f64, f64) -> f64) -> f64 {
    if x.is_nan() || !(dof > 0.0) {
        f64::NAN
    } else if x <= 0.0 {
        at_zero
    } else if x == f64::INFINITY {
        1.0 - at_zero
    } else {
        regularised(0.5 * dof, 0.5 * x).clamp(0.0, 1.0)
    }
}

/// The value that a chi-square variable with `dof` degrees of freedom stays below with probability `p`.
///
/// ```
/// let bound = geomag_core::kalman::chi_square_quantile(0.99, 3)?;
/// assert!((bound - 11.344_866_730).abs() < 1e-8);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
///
/// # Errors
/// [`Error::Invalid`] for a probability outside (0, 1) or no degree of freedom.
pub fn chi_square_quantile(p: f64, dof: usize) -> Result<f64> {
    if !(p > 0.0 && p < 1.0) {
        return Err(Error::invalid("probability", "a number in (0, 1)", p));
    }
    if dof == 0 {
        return Err(Error::invalid("degrees of freedom", "at least 1", 0));
    }
    // By halves: the library's own stops far from the last digit.
    let (mut low, mut high) = (0.0, dof as f64);
    while chi_square_cdf(high, dof) < p && high < 1e6 {
        high *= 2.0;
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if chi_square_cdf(middle, dof) < p {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok(0.5 * (low + high))
}

/// Probability that a standard normal variable exceeds `z`.
pub(crate) fn normal_tail(z: f64) -> f64 {
    0.5 * libm::erfc(z * std::f64::consts::FRAC_1_SQRT_2)
}

/// Probability of at least `least` successes in `n` trials that succeed with probability `p`, in (0, 1).
pub(crate) fn binomial_tail(least: usize, n: usize, p: f64) -> f64 {
    match least {
        0 => 1.0,
        _ if least > n => 0.0,
        _ => beta_reg(least as f64, (n - least + 1) as f64, p),
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn quantiles_agree_with_tables() {
        // Abramowitz & Stegun, table 26.8, and scipy.stats.chi2.ppf 1.17 for the rest.
        for (p, dof, expected) in [
            (0.95, 1, 3.841_458_820_694_124),
            (0.999, 1, 10.827_566_170_662_733),
            (0.5, 2, 1.386_294_361_119_890_6),
            (0.99, 10, 23.209_251_158_954_356),
            (0.025, 200, 162.727_982_501_848_78),
        ] {
            let found = chi_square_quantile(p, dof).unwrap();
            assert!((found - expected).abs() < 1e-9 * expected, "{p} {dof}: {found}");
        }
        assert!(chi_square_quantile(1.0, 2).is_err() && chi_square_quantile(0.5, 0).is_err());
    }

    #[test]
    fn tails_keep_their_digits_far_out() {
        // With two degrees of freedom the tail is exp(-x / 2); the normal one is half of that of its square.
        for x in [0.1, 3.0, 40.0, 600.0] {
            assert_relative_eq!(chi_square_survival(x, 2.0), (-0.5 * x).exp(), max_relative = 1e-10);
            assert_relative_eq!(2.0 * normal_tail(x.sqrt()), chi_square_survival(x, 1.0), max_relative = 1e-9);
        }
        assert_relative_eq!(normal_tail(-1.0), 0.841_344_746_068_543, max_relative = 1e-12);
        assert_eq!((chi_square_survival(0.0, 3.0), chi_square_survival(f64::INFINITY, 3.0)), (1.0, 0.0));
        assert_eq!((chi_square_cdf(-1.0, 3), chi_square_cdf(f64::INFINITY, 3)), (0.0, 1.0));
        assert!(chi_square_cdf(f64::NAN, 3).is_nan() && chi_square_cdf(1.0, 0).is_nan());
    }

    #[test]
    fn binomial_tails_are_sums() {
        // By enumeration: 3 trials at one half; C(40, k) 0.1^k 0.9^(40 - k) from k = 12 on.
        for (least, wanted) in [(0, 1.0), (1, 0.875), (2, 0.5), (3, 0.125), (4, 0.0)] {
            assert_relative_eq!(binomial_tail(least, 3, 0.5), wanted, epsilon = 1e-12);
        }
        assert_relative_eq!(binomial_tail(12, 40, 0.1), 3.808_342_667_363_43e-4, max_relative = 1e-9);
    }
}
