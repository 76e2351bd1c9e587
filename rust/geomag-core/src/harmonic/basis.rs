//! The basis of the rectangular harmonic expansion: which coefficients there are, in what order, and their fields.

use crate::error::{Result, require_not_negative, require_positive};

/// Order in `t` and `r`, and which of cosine and sine each factor is, of one coefficient.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Term {
    /// Harmonic along x (north).
    pub t: usize,
    /// Harmonic along y (east).
    pub r: usize,
    /// Whether the factor along x is a sine.
    pub sine_x: bool,
    /// Whether the factor along y is a sine.
    pub sine_y: bool,
}

/// What is expected of the field before it is observed: how the variances of the coefficients fall with wave number.
///
/// A coefficient of wave number u (and unit root mean square field over the observations) is given the prior variance
/// `(u / u0)^-power exp(-2 u damping_m)` over the ridge, u0 being the lowest wave number. Sources whose magnetisation is
/// self-similar have power spectra that are such a power of the wave number, times the continuation from the level of
/// their tops (Maus and Dimri 1994, doi 10.1029/94GL00771; Naidu 1968 for the exponential). The default treats all alike,
/// which suits observations that are dense in both directions; lines further apart than half the shortest wavelength need
/// a prior: alike, short waves that happen to vanish between the lines are as good as long ones that do not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Level of the sources below the observations, metres.
    pub damping_m: f64,
    /// Power of the wave number by which the variances fall; 3 to 4 for crustal anomalies.
    pub power: f64,
    /// Ratio by which wave numbers along north count more and those along east count less: above 1 for features that are
    /// longer to the north, as under a north-south strike.
    pub anisotropy: f64,
}

impl Default for Prior {
    fn default() -> Self {
        Self { damping_m: 0.0, power: 0.0, anisotropy: 1.0 }
    }
}

impl Prior {
    pub(crate) fn validate(self) -> Result<()> {
        require_not_negative("damping_m", self.damping_m)?;
        require_not_negative("spectrum power", self.power)?;
        require_positive("anisotropy", self.anisotropy)?;
        Ok(())
    }
}

/// Number of coefficients of an expansion of order `order`: `3 + 2 N (N + 1)`.
pub const fn coefficient_count(order: usize) -> usize {
    3 + 2 * order * (order + 1)
}

/// The harmonic coefficients in stored order, after A, B, C: by `q = t + r`, then by `t`, then D, E, F, G; those of an
/// identically zero sine are left out.
///
/// An expansion of lower order is a leading part of one of higher order.
pub fn terms(order: usize) -> impl Iterator<Item = Term> {
    (1..=order).flat_map(|q| (0..=q).map(move |t| (t, q - t))).flat_map(|(t, r)| {
        [(false, false), (false, true), (true, false), (true, true)]
            .into_iter()
            .filter(move |&(sine_x, sine_y)| (t > 0 || !sine_x) && (r > 0 || !sine_y))
            .map(move |(sine_x, sine_y)| Term { t, r, sine_x, sine_y })
    })
}

/// Cosines and sines of 0, 1, ... `order` times an angle, by recurrence from one pair.
pub(crate) fn harmonics(angle: f64, order: usize, cosines: &mut Vec<f64>, sines: &mut Vec<f64>) {
    let (s1, c1) = angle.sin_cos();
    cosines.clear();
    sines.clear();
    let (mut c, mut s) = (1.0, 0.0);
    for _ in 0..=order {
        cosines.push(c);
        sines.push(s);
        (c, s) = (c * c1 - s * s1, s * c1 + c * s1);
    }
}

/// Scratch space for [`Basis::project`].
#[derive(Debug, Default, Clone)]
pub(crate) struct BasisScratch {
    cos_x: Vec<f64>,
    sin_x: Vec<f64>,
    cos_y: Vec<f64>,
    sin_y: Vec<f64>,
}

/// The basis for an order and a pair of wave numbers.
#[derive(Debug, Clone)]
pub(crate) struct Basis {
    order: usize,
    wave: [f64; 2],
}

impl Basis {
    pub(crate) fn new(order: usize, periods_m: [f64; 2]) -> Self {
        Self { order, wave: periods_m.map(|p| std::f64::consts::TAU / p) }
    }

    pub(crate) fn order(&self) -> usize {
        self.order
    }

    pub(crate) fn len(&self) -> usize {
        coefficient_count(self.order)
    }

    /// The share of the ridge that each coefficient gets under a prior: 1 for the uniform field; bounded, as beyond it a
    /// coefficient is nil anyhow.
    pub(crate) fn damping(&self, prior: Prior) -> Vec<f64> {
        const LARGEST: f64 = 60.0;
        let lowest = self.wave[0].min(self.wave[1]);
        let harmonic = terms(self.order).map(|term| {
            let along = term.t as f64 * self.wave[0] * prior.anisotropy;
            let across = term.r as f64 * self.wave[1] / prior.anisotropy;
            let u = along.hypot(across);
            (prior.power * (u / lowest).ln() + 2.0 * u * prior.damping_m).min(LARGEST).exp()
        });
        [1.0; 3].into_iter().chain(harmonic).collect()
    }

    /// Writes, for every coefficient, the component along `direction` of its field at a point, times `factor`.
    ///
    /// The rows of the design matrix: `B = -grad V` [Zhao et al. 2012, eq. 3 to 5, with sin(tvx) mended].
    pub(crate) fn project(
        &self,
        point: [f64; 3],
        direction: [f64; 3],
        factor: f64,
        s: &mut BasisScratch,
        out: &mut [f64],
    ) {
        let [v, w] = self.wave;
        harmonics(v * point[0], self.order, &mut s.cos_x, &mut s.sin_x);
        harmonics(w * point[1], self.order, &mut s.cos_y, &mut s.sin_y);
        let d = direction.map(|c| -c * factor);
        out[..3].copy_from_slice(&d);
        let mut k = 3;
        for q in 1..=self.order {
            for t in 0..=q {
                let r = q - t;
                let (tv, rw) = (t as f64 * v, r as f64 * w);
                let u = tv.hypot(rw);
                let e = (u * point[2]).exp();
                let (cx, sx, cy, sy) = (s.cos_x[t] * e, s.sin_x[t] * e, s.cos_y[r], s.sin_y[r]);
                let (dx, dy, dz) = (d[0] * tv, d[1] * rw, d[2] * u);
                out[k] = -dx * sx * cy - dy * cx * sy + dz * cx * cy;
                k += 1;
                if r > 0 {
                    out[k] = -dx * sx * sy + dy * cx * cy + dz * cx * sy;
                    k += 1;
                }
                if t > 0 {
                    out[k] = dx * cx * cy - dy * sx * sy + dz * sx * cy;
                    k += 1;
                }
                if t > 0 && r > 0 {
                    out[k] = dx * cx * sy + dy * sx * cy + dz * sx * sy;
                    k += 1;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_nests() {
        for order in 0..12 {
            assert_eq!(terms(order).count() + 3, coefficient_count(order));
        }
        assert!(terms(5).zip(terms(9)).all(|(a, b)| a == b));
        assert!(terms(6).all(|t| (t.t > 0 || !t.sine_x) && (t.r > 0 || !t.sine_y) && t.t + t.r <= 6));
    }

    #[test]
    fn priors_are_their_closed_form() {
        let basis = Basis::new(3, [6e3, 4e3]);
        let prior = Prior { damping_m: 150.0, power: 3.0, anisotropy: 1.25 };
        let (v, w) = (std::f64::consts::TAU / 6e3, std::f64::consts::TAU / 4e3);
        let weights = basis.damping(prior);
        assert_eq!(weights[..3], [1.0; 3]);
        for (term, weight) in terms(3).zip(&weights[3..]) {
            let u = (term.t as f64 * v * 1.25).hypot(term.r as f64 * w / 1.25);
            let expected = (u / v).powi(3) * (2.0 * u * 150.0).exp();
            assert!((weight - expected).abs() < 1e-12 * expected, "{term:?}");
        }
        assert!(basis.damping(Prior::default()).iter().all(|&w| w == 1.0));
        assert!(basis.damping(Prior { damping_m: 1e9, ..prior })[5].is_finite());
    }

    #[test]
    fn recurrence_keeps_its_digits() {
        let (mut c, mut s) = (Vec::new(), Vec::new());
        for angle in [0.0, 1e-3, 2.7, -41.0] {
            harmonics(angle, 60, &mut c, &mut s);
            for k in 0..=60 {
                let (sin, cos) = (angle * k as f64).sin_cos();
                assert!((c[k] - cos).abs() < 2e-14 && (s[k] - sin).abs() < 2e-14, "{angle} {k}");
            }
        }
    }
}
