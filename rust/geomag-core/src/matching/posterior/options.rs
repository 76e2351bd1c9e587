//! What a caller asks for: the options of the posterior matchers, and the channels that they are given.

use serde::{Deserialize, Serialize};

use crate::bounds::{MOST_VALUE, require_distance_m, require_resolved, require_spread};
use crate::error::{Error, Result, require_not_negative, require_positive};
use crate::grid::Interpolation;

/// Largest limit of a lattice.
const MOST_CANDIDATES: u64 = 100_000_000;

/// Largest standard deviation of a drift: half the way round the Earth.
const MOST_DRIFT_M: f64 = 2e7;

/// Largest standard deviation of a height: twice that is the highest continuation that is kept.
const MOST_HEIGHT_SIGMA_M: f64 = 600.0;

/// The options of the posterior matchers, each written once: name, kind, default, type as Python documents it, explanation. Grouped by
/// the part of a call that they belong to; before them come those of `common_options`. Whatever needs a list of them is a macro that is handed this one.
#[doc(hidden)]
#[macro_export]
macro_rules! posterior_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            search [
                (step: maybe_pair = None; "float or (float, float), optional";
                    "Lattice step, map units; by default chosen from the map and the tolerance, and refined around the modes that matter.")
                (max_candidates: count = 4_000_000; "int";
                    "Largest lattice, at most 10^8; a larger one is refused before memory is taken. A candidate takes some 200 bytes.")
            ]
            accept [
                (tolerance_m: maybe_number = None; "float, optional";
                    "A fix further than this from the truth is wrong, metres; one map cell by default.")
                (max_risk: number = 0.01; "float";
                    "Greatest declared risk at which an answer is a fix.")
                (min_goodness: number = 1e-3; "float";
                    "Least p-value of the residuals with which a fix is declared.")
                (misfit_threshold: maybe_number = None; "float, optional";
                    "Log evidence that an effect which was not told (height, legs, drift of the bias, scale of the readings, heading, drift)"
                    "must gain over the model as told for a fix to be rejected, with `Fix.misfit` saying which; by default the map's own, or 6;"
                    "infinite for no such tests.")
            ]
            prior [
                (drift_sigma_m: number = 0.0; "float";
                    "Standard deviation per axis of the drift of the offset from the first sample to the newest, metres.")
                (heading_sigma_deg: number = 0.0; "float";
                    "Standard deviation of the heading error of the track, degrees.")
                (scale_sigma: number = 0.0; "float";
                    "Standard deviation of the scale error of the track.")
                (position_sigma_m: number = 0.0; "float";
                    "Standard deviation of the position jitter of one sample, metres.")
            ]
            reading [
                (bias_sigma: maybe_number = None; "float, optional";
                    "Standard deviation of the constant bias of the readings, value units; None is unknown without bound, 0 is no bias.")
                (leg_bias_sigma: number = 0.0; "float";
                    "Standard deviation of the step of the bias from the first straight leg to every other, value units: what a field of the"
                    "vehicle that changes with its heading does.")
                (bias_drift_sigma: number = 0.0; "float";
                    "Standard deviation of what a slow random walk of the bias amounts to over the track, value units.")
                (height_sigma_m: number = 0.0; "float";
                    "Standard deviation of the height of the readings above the map, metres, at most 600: the map is continued to a few"
                    "heights.")
                (nu: maybe_number = None; "float, optional";
                    "Degrees of freedom of the errors; by default the map's own, or 3; where the sensor's error is all, 10 and the normal law,"
                    "weighed, and no sample costing more than 8. From 1000 on it is the normal law.")
                (interpolation: interpolation = "bilinear"; "{'bilinear', 'bicubic'}";
                    "How the map is read between its nodes. What it cannot say there, the difference of the two and more, is part of the error"
                    "whichever is taken; name the one that made the readings, or that is nearer to the field.")
            ]
        }
    };
}

macro_rules! options_struct {
    (
        extent $extent:tt
        $($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*
    ) => {
        /// Options of the posterior matchers. [`PosteriorOptions::new`] gives defaults that need no tuning.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub struct PosteriorOptions {
            /// Bound of the indicated position's error, `[x, y]` map units.
            pub half_width: [f64; 2],
            $($($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*)*
            /// Whether the posterior over the first lattice is returned with the fix.
            pub surface: bool,
        }

        impl PosteriorOptions {
            /// Defaults for a start known to within `half_width` map units.
            pub fn new(half_width: [f64; 2]) -> Self {
                Self { half_width, $($($name: option_default!($kind $default),)*)* surface: false }
            }
        }
    };
}

common_options!(posterior_options options_struct);

impl PosteriorOptions {
    /// Checks the ranges of all options.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first option out of range.
    pub fn validate(&self) -> Result<()> {
        require_resolved("half_width x", require_positive("half_width x", self.half_width[0])?)?;
        require_resolved("half_width y", require_positive("half_width y", self.half_width[1])?)?;
        if let Some([x, y]) = self.step {
            require_resolved("step x", require_positive("step x", x)?)?;
            require_resolved("step y", require_positive("step y", y)?)?;
        }
        if let Some(tolerance) = self.tolerance_m {
            require_distance_m("tolerance_m", require_positive("tolerance_m", tolerance)?)?;
        }
        if !(self.max_risk > 0.0 && self.max_risk < 1.0) {
            return Err(Error::invalid("max_risk", "a probability between 0 and 1", self.max_risk));
        }
        if let Some(sigma) = self.bias_sigma {
            require_spread("bias_sigma", sigma)?;
        }
        for (name, value, most) in [
            ("drift_sigma_m", self.drift_sigma_m, MOST_DRIFT_M),
            ("heading_sigma_deg", self.heading_sigma_deg, 180.0),
            ("scale_sigma", self.scale_sigma, 1.0),
            ("position_sigma_m", self.position_sigma_m, MOST_DRIFT_M),
            ("leg_bias_sigma", self.leg_bias_sigma, MOST_VALUE),
            ("bias_drift_sigma", self.bias_drift_sigma, MOST_VALUE),
        ] {
            if require_not_negative(name, value)? > most {
                return Err(Error::invalid(name, format!("at most {most}"), value));
            }
        }
        if require_not_negative("height_sigma_m", self.height_sigma_m)? > MOST_HEIGHT_SIGMA_M {
            return Err(Error::invalid(
                "height_sigma_m",
                format!("at most {MOST_HEIGHT_SIGMA_M}"),
                self.height_sigma_m,
            ));
        }
        if self.misfit_threshold.is_some_and(f64::is_nan) {
            return Err(Error::invalid("misfit_threshold", "a number, infinite for no tests", f64::NAN));
        }
        if let Some(nu) = self.nu {
            require_positive("nu", nu)?;
        }
        if !(self.min_overlap > 0.0 && self.min_overlap <= 1.0) {
            return Err(Error::invalid("min_overlap", "a share in (0, 1]", self.min_overlap));
        }
        if self.max_candidates > MOST_CANDIDATES {
            return Err(Error::invalid("max_candidates", format!("at most {MOST_CANDIDATES}"), self.max_candidates));
        }
        if !(0.0..1.0).contains(&self.min_goodness) {
            return Err(Error::invalid("min_goodness", "a p-value in [0, 1)", self.min_goodness));
        }
        Ok(())
    }
}
