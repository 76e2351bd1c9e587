//! The chi-square distribution: what normalised errors and innovations follow when a filter is honest.

use crate::error::{Error, Result};

/// Probability that a chi-square variable with `dof` degrees of freedom is at most `x`.
///
/// The regularised incomplete gamma function by its power series or its continued fraction (Abramowitz & Stegun 6.5.29,
/// 6.5.31).
///
/// ```
/// let p = geomag_core::kalman::chi_square_cdf(5.991_464_547, 2);
/// assert!((p - 0.95).abs() < 1e-9);
/// ```
pub fn chi_square_cdf(x: f64, dof: usize) -> f64 {
    if x.is_nan() || dof == 0 {
        return f64::NAN;
    }
    if x <= 0.0 {
        return 0.0;
    }
    let (a, x) = (0.5 * dof as f64, 0.5 * x);
    let front = (a * x.ln() - x - ln_gamma_half(dof)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut k) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-17 {
            k += 1.0;
            term *= x / k;
            sum += term;
        }
        (front * sum).min(1.0)
    } else {
        // Lentz's evaluation of the continued fraction.
        let tiny = 1e-300;
        let mut b = x + 1.0 - a;
        let mut c = 1.0 / tiny;
        let mut d = 1.0 / b;
        let mut h = d;
        for i in 1..500 {
            let i = f64::from(i);
            let an = -i * (i - a);
            b += 2.0;
            d = 1.0 / (an * d + b);
            c = b + an / c;
            let factor = d * c;
            h *= factor;
            if (factor - 1.0).abs() < 1e-16 {
                break;
            }
        }
        (1.0 - front * h).max(0.0)
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

/// Logarithm of gamma(dof / 2), by recurrence from gamma(1/2) and gamma(1).
fn ln_gamma_half(dof: usize) -> f64 {
    let (mut value, mut k) = if dof.is_multiple_of(2) { (0.0, 2) } else { (0.5 * std::f64::consts::PI.ln(), 1) };
    while k < dof {
        value += (0.5 * k as f64).ln();
        k += 2;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_tables() {
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
}
