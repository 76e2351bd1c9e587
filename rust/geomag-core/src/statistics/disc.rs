//! Probability that a normal point lies within a circle: what a declared risk is made of.

use super::normal_tail;
use crate::constants::LN_SQRT_2PI;

/// Standard deviations beyond which a normal variable is not looked for: 1e-12 lies there.
const REACH: f64 = 7.2;
/// Abscissae and weights of Gauss-Legendre quadrature on [-1, 1], n = 10 (Abramowitz and Stegun, table 25.4).
const LEGENDRE: [(f64, f64); 5] = [
    (0.148_874_338_981_631_22, 0.295_524_224_714_752_87),
    (0.433_395_394_129_247_2, 0.269_266_719_309_996_35),
    (0.679_409_568_299_024_4, 0.219_086_362_515_982_04),
    (0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
    (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
];
/// Error that a part of the integral may have before it is halved.
const CLOSE: f64 = 1e-10;
/// Halvings of one part.
const DEPTH: u32 = 24;

/// Probability that a normal point with this mean (from the centre of a circle) and covariance lies within `radius`, right
/// to 1e-6. A covariance of zero is a point; NaN gives NaN.
///
/// Along the larger principal axis the integral is the normal distribution function; across it `u = radius sin t` takes away
/// the root at the rim, and halving finds the rest.
pub(crate) fn normal_in_disc(mean: [f64; 2], covariance: [[f64; 2]; 2], radius: f64) -> f64 {
    let [[ee, en], [_, nn]] = covariance;
    let angle = 0.5 * (2.0 * en).atan2(ee - nn);
    let (sin, cos) = angle.sin_cos();
    let long = (cos * cos * ee + 2.0 * sin * cos * en + sin * sin * nn).max(0.0).sqrt();
    let short = (sin * sin * ee - 2.0 * sin * cos * en + cos * cos * nn).max(0.0).sqrt();
    let distance = mean[0].hypot(mean[1]);
    if long - short <= 1e-7 * long {
        return round_normal_in_disc(distance, long, radius);
    }
    if let Some(sure) = outright(distance, long, radius) {
        return sure;
    }
    let [along, across] = [cos * mean[0] + sin * mean[1], cos * mean[1] - sin * mean[0]];
    let short = short.max(1e-9 * radius);
    let integrand = |t: f64| {
        let (sin, cos) = t.sin_cos();
        let half = radius * cos;
        let z = (radius * sin - across) / short;
        let inside = normal_tail((-half - along) / long) - normal_tail((half - along) / long);
        inside * (-0.5 * z * z - LN_SQRT_2PI).exp() * half / short
    };
    let at = |u: f64| (u / radius).clamp(-1.0, 1.0).asin();
    // Where the density is, and where the rim passes the mean.
    let (low, high) = (at(across - REACH * short), at(across + REACH * short));
    let rim = (along.abs() / radius).min(1.0).acos();
    let mut parts = [low, at(across), -rim, rim, high];
    parts.sort_by(f64::total_cmp);
    let sum: f64 = (parts.windows(2).filter(|w| w[1] > low && w[0] < high && w[1] > w[0]))
        .map(|w| {
            halved(
                &integrand,
                w[0].max(low),
                w[1].min(high),
                legendre(&integrand, w[0].max(low), w[1].min(high)),
                DEPTH,
            )
        })
        .sum();
    sum.clamp(0.0, 1.0)
}

/// [`normal_in_disc`] for the same standard deviation on both axes, by the distance of the mean from the centre.
///
/// The density of the distance is Rice's, smooth on the scale of `sigma` whatever the radius.
pub(crate) fn round_normal_in_disc(distance: f64, sigma: f64, radius: f64) -> f64 {
    if let Some(sure) = outright(distance, sigma, radius) {
        return sure;
    }
    let (d, r) = (distance / sigma, radius / sigma);
    let density = |x: f64| x * (-0.5 * (x - d).powi(2)).exp() * scaled_bessel_i0(x * d);
    // The shorter of what lies inside and what lies outside.
    let (low, high) = ((d - REACH).max(0.0), d + REACH);
    if r - low < high - r {
        panels(&density, low, r).clamp(0.0, 1.0)
    } else {
        1.0 - panels(&density, r, high).clamp(0.0, 1.0)
    }
}

/// The probability where the spread cannot matter.
fn outright(distance: f64, sigma: f64, radius: f64) -> Option<f64> {
    if distance.is_nan() || sigma.is_nan() || radius.is_nan() {
        return Some(f64::NAN);
    }
    if sigma <= 1e-12 * radius.max(distance) {
        return Some(f64::from(distance <= radius));
    }
    if distance - radius > REACH * sigma {
        Some(0.0)
    } else if radius - distance > REACH * sigma {
        Some(1.0)
    } else {
        None
    }
}

fn legendre(f: &impl Fn(f64) -> f64, from: f64, to: f64) -> f64 {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    half * LEGENDRE.iter().map(|(x, w)| w * (f(middle - half * x) + f(middle + half * x))).sum::<f64>()
}

/// An integral over at most 7.2 standard deviations of a density that is smooth on the scale of one.
fn panels(f: &impl Fn(f64) -> f64, from: f64, to: f64) -> f64 {
    let count = ((to - from) / 3.6).ceil().max(1.0);
    let width = (to - from) / count;
    (0..count as usize).map(|i| legendre(f, from + width * i as f64, from + width * (i + 1) as f64)).sum()
}

fn halved(f: &impl Fn(f64) -> f64, from: f64, to: f64, whole: f64, depth: u32) -> f64 {
    let middle = 0.5 * (from + to);
    let (left, right) = (legendre(f, from, middle), legendre(f, middle, to));
    if depth == 0 || (left + right - whole).abs() < CLOSE {
        return left + right;
    }
    halved(f, from, middle, left, depth - 1) + halved(f, middle, to, right, depth - 1)
}

/// `exp(-x) I0(x)` for `x >= 0`, right to 3e-7 (Abramowitz and Stegun, 9.8.1 and 9.8.2).
fn scaled_bessel_i0(x: f64) -> f64 {
    let polynomial = |t: f64, c: &[f64]| c.iter().rev().fold(0.0, |sum, c| sum * t + c);
    if x < 3.75 {
        let t = (x / 3.75).powi(2);
        let c = [1.0, 3.515_622_9, 3.089_942_4, 1.206_749_2, 0.265_973_2, 0.036_076_8, 0.004_581_3];
        return (-x).exp() * polynomial(t, &c);
    }
    let c = [
        0.398_942_28,
        0.013_285_92,
        0.002_253_19,
        -0.001_575_65,
        0.009_162_81,
        -0.020_577_06,
        0.026_355_37,
        -0.016_476_33,
        0.003_923_77,
    ];
    polynomial(3.75 / x, &c) / x.sqrt()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unreadable_literal)] // reference values as they were computed

    use super::*;

    #[test]
    fn round_laws_agree_with_the_noncentral_chi_square() {
        // scipy.stats.ncx2.cdf((r / s)^2, 2, (d / s)^2), scipy 1.17.
        for (d, sigma, radius, wanted) in CASES {
            let found = round_normal_in_disc(d, sigma, radius);
            assert!((found - wanted).abs() < 1e-6, "{d} {sigma} {radius}: {found} {wanted}");
            let v = sigma * sigma;
            let turned = normal_in_disc([0.6 * d, 0.8 * d], [[v, 0.0], [0.0, v * (1.0 + 1e-5)]], radius);
            assert!((turned - wanted).abs() < 2e-5 * sigma.max(1.0), "{d} {sigma} {radius}: {turned} {wanted}");
        }
    }

    #[test]
    fn long_laws_agree_with_a_sum_over_strips() {
        for (mean, [a, b], turn) in [
            ([0.0, 0.0], [1.0, 0.01], 0.3),
            ([0.9, 0.0], [0.3, 0.05], 1.1),
            ([0.7, -0.7], [0.02, 0.001], -0.7),
            ([1.5, 0.4], [3.0, 0.2], 2.0),
            ([0.0, 1.0], [1e-3, 1e-5], 0.0),
            ([0.2, 0.9], [5.0, 4.0], 0.8),
        ] {
            let (s, c) = f64::sin_cos(turn);
            let (va, vb) = (a * a, b * b);
            let en = s * c * (va - vb);
            let covariance = [[c * c * va + s * s * vb, en], [en, s * s * va + c * c * vb]];
            // Strips of equal probability across the short axis; along the long one the law is exact.
            let [along, across] = [c * mean[0] + s * mean[1], c * mean[1] - s * mean[0]];
            let (strips, mut wanted) = (400_000, 0.0);
            for i in 0..strips {
                let z = 8.0 * (2.0 * (f64::from(i) + 0.5) / f64::from(strips) - 1.0);
                let u = across + b * z;
                if u.abs() < 1.0 {
                    let half = (1.0 - u * u).sqrt();
                    let inside = normal_tail((-half - along) / a) - normal_tail((half - along) / a);
                    wanted += inside * (-0.5 * z * z - LN_SQRT_2PI).exp() * 16.0 / f64::from(strips);
                }
            }
            let found = normal_in_disc(mean, covariance, 1.0);
            assert!((found - wanted).abs() < 1e-6, "{mean:?} {a} {b} {turn}: {found} {wanted}");
        }
    }

    #[test]
    fn a_point_is_inside_or_not_and_no_number_stays_none() {
        assert_eq!(normal_in_disc([0.5, 0.0], [[0.0; 2]; 2], 1.0), 1.0);
        assert_eq!(normal_in_disc([0.9, 0.9], [[0.0; 2]; 2], 1.0), 0.0);
        assert!(round_normal_in_disc(f64::NAN, 1.0, 1.0).is_nan());
        // No width at all across: the law of one variable.
        let found = normal_in_disc([0.0, 0.5], [[1.0, 0.0], [0.0, 0.0]], 1.0);
        assert!((found - (1.0 - 2.0 * normal_tail(0.75_f64.sqrt()))).abs() < 1e-6, "{found}");
    }

    const CASES: [(f64, f64, f64, f64); 16] = [
        (0.0, 0.3, 1.0, 0.996134079861),
        (0.0, 5.0, 1.0, 0.0198013266932),
        (0.2, 0.1, 0.5, 0.997779170263),
        (0.9, 0.05, 1.0, 0.975789099091),
        (0.9, 0.3, 1.0, 0.56849320363),
        (0.9, 0.001, 1.0, 1.0),
        (0.9999, 0.001, 1.0, 0.539629346092),
        (1.0, 1e-06, 1.0, 0.499999800529),
        (1.1, 0.05, 1.0, 0.0214934790546),
        (1.5, 0.2, 1.0, 0.00491895265073),
        (3.0, 1.0, 1.0, 0.0108294498215),
        (30.0, 8.0, 1.0, 7.06838863657e-06),
        (0.5, 0.17, 1.0, 0.997615881043),
        (0.001, 2.0, 1.0, 0.117503083626),
        (40.0, 3.0, 50.0, 0.999516295656),
        (0.0, 0.34, 1.0, 0.98676988377),
    ];
}
