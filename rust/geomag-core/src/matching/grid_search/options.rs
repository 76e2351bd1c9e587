//! Settings of the grid search, and what it makes of two scores.

use serde::{Deserialize, Serialize};

use crate::bounds::require_scale;
use crate::error::{Error, Result, require_finite, require_positive, require_weights};
use crate::grid::Interpolation;
use crate::lattice::Pivot;
use crate::matching::similarity::{Criterion, Robust, Scoring};
use crate::statistics::chi_square_survival;
use crate::track::Track;

/// The options of the grid search, each written once; see `table.rs`. Those of `measure` make a [`Criterion`] and a [`Robust`].
#[doc(hidden)]
#[macro_export]
macro_rules! grid_search_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            search [
                (max_candidates: count = 268_435_456; "int";
                    "A search of more offsets, headings and scales is refused before memory is taken (8 bytes each); a lattice of more than"
                    "2^31 offsets always is.")
            ]
            turn [
                (heading_deg: headings = None; "sequence of float, optional";
                    "Heading corrections to try, degrees clockwise; the indicated heading by default.")
                (scale: scales = None; "sequence of float, optional";
                    "Scale corrections to try; 1 by default.")
                (pivot: pivot = "newest"; "{'newest', 'centroid'}";
                    "Point about which they turn the track; the fix is for the newest point either way.")
            ]
            compare [
                (remove_mean: flag = false; "bool";
                    "Take out a constant: the mean for 'msd', the median for 'mad' (and for robust losses).")
                (weights: weights = None; "array of shape (n,), optional";
                    "One weight a sample. A sample of weight zero is as if it had not been measured; its position alone remains.")
                (interpolation: interpolation = "bilinear"; "{'bilinear', 'bicubic'}";
                    "How the search reads the map.")
                (sigma: maybe_number = None; "float, optional";
                    "Standard deviation of a measured value with the map's error; estimated from the best fit by default.")
            ]
            answer [
                (ambiguity: number = 0.01; "float";
                    "The answer is `ambiguous` where a place two cells away or more has more than this share of its likelihood.")
                (refine: flag = true; "bool";
                    "Refine the best offset below the lattice step; without it the covariance holds the step.")
                (surface: flag = false; "bool";
                    "Return the score surface with the fix.")
            ]
            measure [
                (robust: maybe_name = None; "{'huber', 'student_t'}, optional";
                    "Loss in place of the square.")
                (robust_scale: maybe_number = None; "float, optional";
                    "Where it bends, value units; needed with `robust`.")
                (nu: number = 3.0; "float";
                    "Degrees of freedom of 'student_t'.")
                (length_scale_m: maybe_number = None; "float, optional";
                    "Metres that count as one in the Hausdorff distance; the mean sample spacing by default.")
                (value_scale: maybe_number = None; "float, optional";
                    "Value units that count as one there; the spread of the values by default.")
                (fraction: number = 1.0; "float";
                    "Quantile of the point-to-set distances that is the Hausdorff distance.")
            ]
        }
    };
}

macro_rules! grid_search_struct {
    (
        extent $extent:tt
        overlap [$($overlap:tt)*] pitch [$($pitch:tt)*]
        search [$($search:tt)*] turn [$($turn:tt)*] compare [$($compare:tt)*] answer [$($answer:tt)*] measure $measure:tt
    ) => {
        grid_search_struct! { $($pitch)* $($search)* $($turn)* $($compare)* $($overlap)* $($answer)* }
    };
    ($(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*) => {
        /// Options of [`match_grid`](super::match_grid); the defaults search offsets alone with the mean square difference.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub struct GridSearch {
            /// Measure.
            pub criterion: Criterion,
            /// Half size of the search `[x, y]`, map units.
            pub half_width: [f64; 2],
            /// Loss in place of the square.
            pub robust: Option<Robust>,
            $($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*
        }

        impl GridSearch {
            /// A search of the given measure and half width with the defaults for the rest.
            pub fn new(criterion: Criterion, half_width: [f64; 2]) -> Self {
                Self { criterion, half_width, robust: None, $($name: option_default!($kind $default),)* }
            }
        }
    };
}

common_options!(step_options grid_search_options grid_search_struct);

impl GridSearch {
    pub(super) fn check(&self, geographic: bool, track: &Track) -> Result<()> {
        track.require_on(geographic)?;
        for (what, list) in [("heading_deg", &self.heading_deg), ("scale", &self.scale)] {
            if list.is_empty() {
                return Err(Error::invalid(what, "at least one value to try", "none"));
            }
            require_finite(what, list)?;
        }
        for (i, &s) in self.scale.iter().enumerate() {
            require_scale(&format!("scale[{i}]"), s)?;
        }
        if self.half_width == [0.0; 2] {
            // Nothing to compare it with: a single offset is neither ambiguous nor at an edge, wherever it is.
            return Err(Error::invalid("half_width", "more than 0 along x or y", "0 along both: one candidate"));
        }
        if !(self.min_overlap > 0.0 && self.min_overlap <= 1.0) {
            return Err(Error::invalid("min_overlap", "a share in (0, 1]", self.min_overlap));
        }
        if !(self.ambiguity > 0.0 && self.ambiguity <= 1.0) {
            return Err(Error::invalid("ambiguity", "a likelihood ratio in (0, 1]", self.ambiguity));
        }
        if let Some(sigma) = self.sigma {
            require_positive("sigma", sigma)?;
        }
        let scoring = self.scoring();
        scoring.check()?;
        if let Some(weights) = &self.weights {
            require_weights(weights, track.len())?;
        }
        let (needed, got) = (scoring.least_samples(), self.counting(track.len()).count());
        if got < needed {
            return Err(Error::TooFewSamples {
                what: format!("grid search with '{}' about a free mean", self.criterion.as_str()),
                needed,
                got,
            });
        }
        Ok(())
    }

    /// The samples of `n` that have a weight.
    pub(super) fn counting(&self, n: usize) -> impl Iterator<Item = usize> {
        (0..n).filter(|&k| self.weights.as_ref().is_none_or(|w| w[k] > 0.0))
    }

    /// The weights of those, where they differ from one.
    pub(super) fn their_weights(&self) -> Option<Vec<f64>> {
        let kept: Vec<f64> = self.weights.as_ref()?.iter().copied().filter(|w| *w > 0.0).collect();
        kept.iter().any(|w| *w != 1.0).then_some(kept)
    }

    pub(super) fn scoring(&self) -> Scoring {
        Scoring { criterion: self.criterion, remove_mean: self.remove_mean, robust: self.robust }
    }
}

/// Times that the step of a refinement is made an eighth: to a four-thousandth of the lattice's.
const LEVELS: usize = 4;

impl GridSearch {
    /// How far a candidate is refined. A measure without a noise model has no covariance that would need the minimum itself, and its
    /// scores are compared by their size: they are refined once.
    pub(super) fn levels(&self) -> usize {
        match self.criterion {
            _ if !self.refine => 0,
            Criterion::Prod | Criterion::Hausdorff { .. } => 1,
            _ => LEVELS,
        }
    }

    /// Placements next to one: the headings above and below it, the scales above and below it.
    pub(super) fn beside(&self, placement: usize) -> Vec<usize> {
        let scales = self.scale.len();
        let (heading, scale) = (placement / scales, placement % scales);
        let next = |list: &[f64], at: usize, sign: f64| {
            let beyond = (0..list.len()).filter(|&i| sign * (list[i] - list[at]) > 0.0);
            beyond.min_by(|&a, &b| (sign * list[a]).total_cmp(&(sign * list[b])))
        };
        let headings = [-1.0, 1.0].into_iter().filter_map(|sign| next(&self.heading_deg, heading, sign));
        let along_scale = [-1.0, 1.0].into_iter().filter_map(|sign| next(&self.scale, scale, sign));
        headings.map(|h| h * scales + scale).chain(along_scale.map(|s| heading * scales + s)).collect()
    }

    /// p-value of the residuals where the caller has said what their standard deviation is: chi-square at the minimum of
    /// the linearised fit, which the quadratic through lattice scores only comes near to.
    pub(super) fn goodness(&self, least_squares: Option<(f64, usize)>) -> Option<f64> {
        match (self.criterion, self.robust, self.sigma, least_squares) {
            (Criterion::Msd, None, Some(sigma), Some((squares, freedom))) if self.their_weights().is_none() => {
                Some(chi_square_survival(squares / (sigma * sigma), freedom as f64))
            }
            _ => None,
        }
    }

    /// Whether a runner-up is too near. With a noise model: its likelihood, half of the samples counted as independent
    /// (their errors are not), is more than `ambiguity` of the best's. Without: its score is within a twentieth.
    ///
    /// Where the noise is estimated it is taken to be at least a millionth of the `spread` of the readings, so that the
    /// rounding of two perfect fits does not choose between them.
    pub(super) fn ambiguous(&self, best: f64, runner_up: f64, samples: usize, spread: f64) -> bool {
        let n = 0.5 * samples as f64;
        let least = 1e-6 * spread;
        let ratio = |floor: f64| ((runner_up + floor) / (best + floor)).ln();
        let log_ratio = match (self.criterion, self.robust, self.sigma) {
            // The product may be of either sign: within a twentieth of its size.
            (Criterion::Prod | Criterion::Hausdorff { .. }, _, _) => return !(runner_up - best > 0.05 * best.abs()),
            (Criterion::Msd, Some(Robust::StudentT { .. }), _) => 0.5 * n * (runner_up - best),
            (Criterion::Msd, None, Some(sigma)) => 0.5 * n * (runner_up - best) / (sigma * sigma),
            (Criterion::Msd, _, _) => 0.5 * n * ratio(least * least),
            (Criterion::Mad, _, _) => n * ratio(least),
            (Criterion::Ncc, _, _) => {
                // Inner scores are negated correlations.
                let unexplained = |score: f64| 1.0 + score * score.abs() + 1e-12;
                0.5 * n * (unexplained(runner_up) / unexplained(best)).ln()
            }
        };
        // Written so that 0 / 0, two perfect fits, is ambiguous.
        !(log_ratio >= -self.ambiguity.ln())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_without_a_noise_model_are_compared_by_their_size_whatever_their_sign() {
        let product = GridSearch::new(Criterion::Prod, [1.0; 2]);
        // Inner scores: the product negated.
        let ambiguous = |best: f64, runner_up: f64| product.ambiguous(-best, -runner_up, 20, 1.0);
        assert!(ambiguous(100.0, 96.0) && !ambiguous(100.0, 94.0) && !ambiguous(100.0, -100.0));
        assert!(ambiguous(-100.0, -104.0) && !ambiguous(-100.0, -106.0));
        assert!(ambiguous(-100.0, -100.0) && ambiguous(0.0, 0.0));
    }
}
