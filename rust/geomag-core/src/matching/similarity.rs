//! Similarity of a measured sequence and the map values along a shifted track (Huang et al. 2012 for MSD; Groves 2013,
//! section 13.2, for the family).
//!
//! Inside, less is better for every measure; [`Criterion::natural`] turns correlations round again.

// A kernel that is not inlined is not compiled for the instruction set that was chosen.
#![allow(clippy::inline_always)]

use pulp::Simd;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_positive};
use crate::lattice::{BestTwo, Comparison, MAX_SLOTS, Measure, Real};
use crate::monitor::Monitor;
use crate::track::Track;

/// Rounding steps by which equal values may come out unequal after interpolation and the removal of a level.
const ROUNDING: f64 = 4.0;

/// Which measure compares the sequences.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Criterion {
    /// Mean square difference, mean (v - m)^2; least is best.
    Msd,
    /// Mean absolute difference, mean |v - m|; least is best.
    Mad,
    /// Product correlation, mean (v - mu)(m - mu) with mu the map's mean; greatest is best.
    Prod,
    /// Normalised cross-correlation: the correlation coefficient of v and m; greatest is best.
    Ncc,
    /// Hausdorff distance of the point sets {(s / length scale, v / value scale)} and {(s / .., m / ..)}; least is best.
    Hausdorff {
        /// Along-track metres that count as much as `value_scale`.
        length_scale_m: f64,
        /// Value difference that counts as one.
        value_scale: f64,
        /// Quantile of the point-to-set distances that is taken; 1 is the distance itself, less is proof to outliers.
        fraction: f64,
    },
}

impl Criterion {
    /// The Hausdorff distance; scales that are not given are the mean sample spacing and the spread of the readings.
    pub fn hausdorff(
        track: &Track,
        geographic: bool,
        length_scale_m: Option<f64>,
        value_scale: Option<f64>,
        fraction: f64,
    ) -> Self {
        let positive = |scale: f64| if scale > 0.0 { scale } else { 1.0 };
        let mean_spacing = || {
            let length = track.distance_m(geographic).last().copied().unwrap_or(0.0);
            positive(length / (track.len() as f64 - 1.0).max(1.0))
        };
        Self::Hausdorff {
            length_scale_m: length_scale_m.unwrap_or_else(mean_spacing),
            value_scale: value_scale.unwrap_or_else(|| positive(track.spread())),
            fraction,
        }
    }

    /// The name used in Python, JSON and reports.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Msd => "msd",
            Self::Mad => "mad",
            Self::Prod => "prod",
            Self::Ncc => "ncc",
            Self::Hausdorff { .. } => "hausdorff",
        }
    }

    /// Whether the inner, less-is-better score is the measure's own turned round.
    pub fn is_negated(self) -> bool {
        matches!(self, Self::Prod | Self::Ncc)
    }

    /// A score in the measure's own sense from the inner, less-is-better one, and back.
    pub fn natural(self, score: f64) -> f64 {
        if self.is_negated() { -score } else { score }
    }
}

/// A loss that grows more slowly than the square, so that outliers do not decide.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Robust {
    /// Huber (1964): r^2 up to `threshold`, linear beyond: 2 threshold |r| - threshold^2.
    Huber {
        /// Value units.
        threshold: f64,
    },
    /// Student-t negative log-likelihood: (nu + 1) ln(1 + r^2 / (nu scale^2)).
    StudentT {
        /// Degrees of freedom, about 3 for survey errors.
        nu: f64,
        /// Value units.
        scale: f64,
    },
}

impl Robust {
    /// Checks the parameters.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check(self) -> Result<Self> {
        match self {
            Self::Huber { threshold } => {
                require_positive("robust threshold", threshold)?;
            }
            Self::StudentT { nu, scale } => {
                require_positive("robust nu", nu)?;
                require_positive("robust scale", scale)?;
            }
        }
        Ok(self)
    }

    /// Loss of a residual.
    pub fn loss(self, r: f64) -> f64 {
        match self {
            Self::Huber { threshold } => {
                if r.abs() <= threshold {
                    r * r
                } else {
                    (2.0 * r.abs() - threshold) * threshold
                }
            }
            Self::StudentT { nu, scale } => (nu + 1.0) * (r * r / (nu * scale * scale)).ln_1p(),
        }
    }
}

/// Everything that turns a comparison into scores.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scoring {
    /// The measure.
    pub criterion: Criterion,
    /// Whether a constant is taken out: the mean for `Msd`, the median for `Mad`. `Ncc` does so by itself.
    pub remove_mean: bool,
    /// Loss in place of the square, for `Msd` only.
    pub robust: Option<Robust>,
}

impl Scoring {
    /// Checks that the parts go together.
    ///
    /// # Errors
    /// [`Error::Invalid`] for scales that are not positive, a fraction outside (0, 1], or options that a measure has
    /// no meaning for.
    pub fn check(&self) -> Result<()> {
        if let Criterion::Hausdorff { length_scale_m, value_scale, fraction } = self.criterion {
            require_positive("length_scale_m", length_scale_m)?;
            require_positive("value_scale", value_scale)?;
            if !(fraction > 0.0 && fraction <= 1.0) {
                return Err(Error::invalid("fraction", "a number in (0, 1]", fraction));
            }
        }
        if self.remove_mean && matches!(self.criterion, Criterion::Prod | Criterion::Hausdorff { .. }) {
            return Err(Error::invalid("remove_mean", "the criterion 'msd' or 'mad'", self.criterion.as_str()));
        }
        if let Some(robust) = self.robust {
            robust.check()?;
            if self.criterion != Criterion::Msd {
                return Err(Error::invalid(
                    "robust",
                    "the criterion 'msd', whose square it replaces",
                    self.criterion.as_str(),
                ));
            }
        }
        Ok(())
    }

    /// Samples without which the score of a candidate means nothing.
    pub fn least_samples(&self) -> usize {
        if self.remove_mean || self.criterion == Criterion::Ncc { 2 } else { 1 }
    }

    /// Scores (less is better) of a block of candidates. `map_mean` is the map's mean, `distance_m` the along-track
    /// distance of the samples. Where only the `best` two are wanted, candidates that are neither may have no score.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    #[allow(clippy::too_many_arguments)] // a block of a lattice, and what it is compared with
    pub fn scores(
        &self,
        comparison: &Comparison<'_>,
        map_mean: f64,
        distance_m: &[f64],
        rows: std::ops::Range<usize>,
        columns: std::ops::Range<usize>,
        best: Option<&BestTwo>,
        monitor: &dyn Monitor,
    ) -> Result<Vec<f64>> {
        let v = comparison.values();
        let w = comparison.weights();
        let weight = |k: usize| w.map_or(1.0, |w| w[k]);
        match (self.criterion, self.robust) {
            (Criterion::Msd, Some(robust)) => {
                let score = |m: &[f64], known: &[usize]| {
                    let bias = if self.remove_mean { weighted_median(m, v, known, weight) } else { 0.0 };
                    let (mut sum, mut total) = (0.0, 0.0);
                    for (&m, &k) in m.iter().zip(known) {
                        sum += weight(k) * robust.loss(v[k] - m - bias);
                        total += weight(k);
                    }
                    if total > 0.0 { sum / total } else { f64::NAN }
                };
                comparison.scores_by(score, rows, columns, monitor)
            }
            (Criterion::Msd, None) if self.remove_mean => {
                // Taken about the level at no offset, so that a large constant does not eat the digits.
                let centred = comparison.clone().with_values(about_middle(comparison));
                centred.scores(CentredMsd, rows, columns, best, monitor)
            }
            (Criterion::Msd, None) => comparison.scores(Msd, rows, columns, best, monitor),
            (Criterion::Mad, _) if self.remove_mean => {
                let score = |m: &[f64], known: &[usize]| {
                    let bias = weighted_median(m, v, known, weight);
                    let (mut sum, mut total) = (0.0, 0.0);
                    for (&m, &k) in m.iter().zip(known) {
                        sum += weight(k) * (v[k] - m - bias).abs();
                        total += weight(k);
                    }
                    if total > 0.0 { sum / total } else { f64::NAN }
                };
                comparison.scores_by(score, rows, columns, monitor)
            }
            (Criterion::Mad, _) => comparison.scores(Mad, rows, columns, best, monitor),
            (Criterion::Prod, _) => comparison.scores(Prod { level: map_mean }, rows, columns, best, monitor),
            (Criterion::Ncc, _) => {
                let shifted = about_middle(comparison);
                // The map is taken about the level that the values were taken from.
                let level = v.iter().zip(&shifted).map(|(v, s)| v - s).sum::<f64>() / v.len() as f64;
                let total: f64 = (0..v.len()).map(weight).sum();
                let mean = shifted.iter().enumerate().map(|(k, v)| weight(k) * v).sum::<f64>() / total;
                let mut values: Vec<f64> = shifted.iter().map(|v| v - mean).collect();
                let mut spread = values.iter().enumerate().map(|(k, v)| weight(k) * v * v).sum::<f64>();
                // Readings that differ by their rounding alone would correlate that with the map.
                let largest = v.iter().chain(&shifted).fold(level.abs(), |most, v| v.abs().max(most));
                let rounding = ROUNDING * f64::EPSILON * largest;
                if spread <= total * rounding * rounding {
                    values.fill(0.0);
                    spread = 0.0;
                }
                let map_level = v.iter().sum::<f64>() / v.len() as f64 - level;
                comparison.clone().with_values(values).scores(
                    Ncc { level: map_level, spread, epsilon: comparison.epsilon() },
                    rows,
                    columns,
                    best,
                    monitor,
                )
            }
            (Criterion::Hausdorff { length_scale_m, value_scale, fraction }, _) => {
                let s: Vec<f64> = distance_m.iter().map(|s| s / length_scale_m).collect();
                let score = |m: &[f64], known: &[usize]| {
                    let s: Vec<f64> = known.iter().map(|&k| s[k]).collect();
                    let measured: Vec<f64> = known.iter().map(|&k| v[k] / value_scale).collect();
                    let mapped: Vec<f64> = m.iter().map(|m| m / value_scale).collect();
                    hausdorff(&s, &measured, &mapped, fraction)
                };
                comparison.scores_by(score, rows, columns, monitor)
            }
        }
    }
}

/// Measured values less their mean difference from the map at no offset (or their own mean where that is unknown).
fn about_middle(comparison: &Comparison<'_>) -> Vec<f64> {
    let [hx, hy] = comparison.lattice().half();
    let v = comparison.values();
    let (mut sum, mut n) = (0.0, 0.0);
    for (k, v) in v.iter().enumerate() {
        let m = comparison.map_value(k, hy, hx);
        if !m.is_nan() {
            sum += v - m;
            n += 1.0;
        }
    }
    let level = if n > 0.0 { sum / n } else { 0.0 };
    v.iter().map(|v| v - level).collect()
}

/// The value that minimises the weighted sum of |v - m - b| over b; between two such, their middle.
fn weighted_median(m: &[f64], v: &[f64], known: &[usize], weight: impl Fn(usize) -> f64) -> f64 {
    let mut residuals: Vec<(f64, f64)> = m.iter().zip(known).map(|(m, &k)| (v[k] - m, weight(k))).collect();
    residuals.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * residuals.iter().map(|r| r.1).sum::<f64>();
    let mut below = 0.0;
    for (i, &(r, w)) in residuals.iter().enumerate() {
        below += w;
        if below > half {
            return r;
        }
        if below == half {
            return residuals.get(i + 1).map_or(r, |next| 0.5 * (r + next.0));
        }
    }
    f64::NAN
}

/// Hausdorff distance of {(s, a)} and {(s, b)}, s ascending; `fraction` < 1 takes that quantile of the point-to-set
/// distances of either set (Huttenlocher, Klanderman and Rucklidge 1993), 1 the greatest.
pub fn hausdorff(s: &[f64], a: &[f64], b: &[f64], fraction: f64) -> f64 {
    let n = s.len();
    if n == 0 {
        return f64::NAN;
    }
    let rank = ((fraction * n as f64 - 1e-9).ceil() as usize).clamp(1, n) - 1;
    let directed = |from: &[f64], to: &[f64]| {
        let mut distances: Vec<f64> = (0..n)
            .map(|i| {
                let mut least = (from[i] - to[i]).powi(2);
                // Distance along the track alone bounds the search on either side.
                for j in (0..i).rev() {
                    let along = (s[i] - s[j]).powi(2);
                    if along >= least {
                        break;
                    }
                    least = least.min(along + (from[i] - to[j]).powi(2));
                }
                for j in i + 1..n {
                    let along = (s[j] - s[i]).powi(2);
                    if along >= least {
                        break;
                    }
                    least = least.min(along + (from[i] - to[j]).powi(2));
                }
                least
            })
            .collect();
        *distances.select_nth_unstable_by(rank, f64::total_cmp).1
    };
    directed(a, b).max(directed(b, a)).sqrt()
}

/// Mean square difference: sum r^2.
#[derive(Debug, Clone, Copy)]
pub struct Msd;

impl Measure for Msd {
    const GROWS: bool = true;
    const SLOTS: usize = 1;
    const SLOTS_WEIGHTED: usize = 1;

    #[inline(always)]
    fn add<S: Simd, T: Real, const WEIGHTED: bool>(
        &self,
        simd: S,
        sums: &mut [T::Vector<S>],
        m: T::Vector<S>,
        v: T::Vector<S>,
        w: T::Vector<S>,
    ) {
        let r = T::sub(simd, m, v);
        let q = if WEIGHTED { T::mul(simd, r, w) } else { r };
        sums[0] = T::fma(simd, q, r, sums[0]);
    }

    #[inline(always)]
    fn finish(&self, sums: [f64; MAX_SLOTS], weight: f64, _weighted: bool) -> f64 {
        sums[0] / weight
    }
}

/// Mean square difference about the mean difference: sum r, sum r^2.
#[derive(Debug, Clone, Copy)]
pub struct CentredMsd;

impl Measure for CentredMsd {
    const SLOTS: usize = 2;
    const SLOTS_WEIGHTED: usize = 2;

    #[inline(always)]
    fn add<S: Simd, T: Real, const WEIGHTED: bool>(
        &self,
        simd: S,
        sums: &mut [T::Vector<S>],
        m: T::Vector<S>,
        v: T::Vector<S>,
        w: T::Vector<S>,
    ) {
        let r = T::sub(simd, m, v);
        let q = if WEIGHTED { T::mul(simd, r, w) } else { r };
        sums[0] = T::add(simd, sums[0], q);
        sums[1] = T::fma(simd, q, r, sums[1]);
    }

    #[inline(always)]
    fn finish(&self, sums: [f64; MAX_SLOTS], weight: f64, _weighted: bool) -> f64 {
        let mean = sums[0] / weight;
        (sums[1] / weight - mean * mean).max(0.0)
    }
}

/// Mean absolute difference: sum |r|.
#[derive(Debug, Clone, Copy)]
pub struct Mad;

impl Measure for Mad {
    const GROWS: bool = true;
    const SLOTS: usize = 1;
    const SLOTS_WEIGHTED: usize = 1;

    #[inline(always)]
    fn add<S: Simd, T: Real, const WEIGHTED: bool>(
        &self,
        simd: S,
        sums: &mut [T::Vector<S>],
        m: T::Vector<S>,
        v: T::Vector<S>,
        w: T::Vector<S>,
    ) {
        let r = T::abs(simd, T::sub(simd, m, v));
        sums[0] = if WEIGHTED { T::fma(simd, w, r, sums[0]) } else { T::add(simd, sums[0], r) };
    }

    #[inline(always)]
    fn finish(&self, sums: [f64; MAX_SLOTS], weight: f64, _weighted: bool) -> f64 {
        sums[0] / weight
    }
}

/// Product correlation about a level, negated: sum (v - level)(m - level).
#[derive(Debug, Clone, Copy)]
pub struct Prod {
    /// The map's mean.
    pub level: f64,
}

impl Measure for Prod {
    const SLOTS: usize = 1;
    const SLOTS_WEIGHTED: usize = 1;

    #[inline(always)]
    fn add<S: Simd, T: Real, const WEIGHTED: bool>(
        &self,
        simd: S,
        sums: &mut [T::Vector<S>],
        m: T::Vector<S>,
        v: T::Vector<S>,
        w: T::Vector<S>,
    ) {
        let level = T::splat(simd, T::from_f64(self.level));
        let v = T::sub(simd, v, level);
        let q = if WEIGHTED { T::mul(simd, v, w) } else { v };
        sums[0] = T::fma(simd, q, T::sub(simd, m, level), sums[0]);
    }

    #[inline(always)]
    fn finish(&self, sums: [f64; MAX_SLOTS], weight: f64, _weighted: bool) -> f64 {
        -sums[0] / weight
    }
}

/// Normalised cross-correlation, negated, of values whose weighted mean is zero: sums of m, m^2, m v (and v, v^2 where
/// samples differ between offsets), m about a level.
#[derive(Debug, Clone, Copy)]
pub struct Ncc {
    /// Level about which map values are summed, so that digits are kept; the score does not depend on it.
    pub level: f64,
    /// Weighted sum of the squared values.
    pub spread: f64,
    /// Relative rounding of the numbers that are summed.
    pub epsilon: f64,
}

impl Measure for Ncc {
    const SLOTS: usize = 3;
    const SLOTS_WEIGHTED: usize = 5;

    #[inline(always)]
    fn add<S: Simd, T: Real, const WEIGHTED: bool>(
        &self,
        simd: S,
        sums: &mut [T::Vector<S>],
        m: T::Vector<S>,
        v: T::Vector<S>,
        w: T::Vector<S>,
    ) {
        let m = T::sub(simd, m, T::splat(simd, T::from_f64(self.level)));
        let q = if WEIGHTED { T::mul(simd, m, w) } else { m };
        sums[0] = T::add(simd, sums[0], q);
        sums[1] = T::fma(simd, q, m, sums[1]);
        sums[2] = T::fma(simd, q, v, sums[2]);
        if WEIGHTED {
            let u = T::mul(simd, v, w);
            sums[3] = T::add(simd, sums[3], u);
            sums[4] = T::fma(simd, u, v, sums[4]);
        }
    }

    #[inline(always)]
    fn finish(&self, sums: [f64; MAX_SLOTS], weight: f64, weighted: bool) -> f64 {
        let [m, mm, mv, v, vv] = sums;
        let (v, vv) = if weighted { (v, vv) } else { (0.0, self.spread) };
        let spread_m = mm - m * m / weight;
        let spread_v = vv - v * v / weight;
        // Below rounding, of its own sums or of the map values themselves, a sequence is constant, and a constant
        // correlates with nothing.
        let of_sums = (16.0 * self.epsilon).max(1e-12);
        let of_map = ROUNDING * self.epsilon * self.level;
        let constant = spread_m <= of_sums * mm + weight * of_map * of_map || spread_v <= of_sums * vv;
        let score = -((mv - m * v / weight) / (spread_m * spread_v).sqrt()).clamp(-1.0, 1.0);
        if constant { f64::NAN } else { score }
    }
}
