//! What a caller asks for: the options of the posterior matchers, and the channels that they are given.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_not_negative, require_positive};
use crate::field::Field;
use crate::grid::Interpolation;

/// Largest limit of a lattice.
const MOST_CANDIDATES: u64 = 100_000_000;

/// Largest standard deviation of a drift: half the way round the Earth.
const MOST_DRIFT_M: f64 = 2e7;

/// Largest standard deviation of a height: twice that is the highest continuation that is kept.
const MOST_HEIGHT_M: f64 = 600.0;

/// Options of the posterior matchers. [`PosteriorOptions::new`] gives defaults that need no tuning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PosteriorOptions {
    /// Bound of the indicated position's error, `[x, y]` map units.
    pub half_width: [f64; 2],
    /// Lattice step, map units; `None` chooses one and refines it around the modes that matter.
    pub step: Option<[f64; 2]>,
    /// A fix further than this from the truth is wrong, metres; `None` is one cell of the map.
    pub tolerance_m: Option<f64>,
    /// Greatest declared risk at which a fix is declared.
    pub max_risk: f64,
    /// Standard deviation of the constant bias of the measurement, value units; `None` is unknown without bound, 0 is no bias.
    pub bias_sigma: Option<f64>,
    /// Standard deviation of the step of the bias from the first straight leg to every other, value units: what a heading-dependent
    /// field of the vehicle does.
    pub leg_bias_sigma: f64,
    /// Standard deviation of what a slow random walk of the bias amounts to over the track, value units.
    pub bias_walk: f64,
    /// Standard deviation of the height of the readings above the map, metres.
    pub height_sigma_m: f64,
    /// Log evidence that an effect which was not told must gain over the model as told for a fix to be rejected; infinite for no
    /// such tests, `None` for the map's own threshold, or 6.
    pub misfit_threshold: Option<f64>,
    /// Standard deviation per axis of the drift of the offset from the first sample to the newest, metres.
    pub drift_sigma_m: f64,
    /// Standard deviation of the heading error, degrees.
    pub heading_sigma_deg: f64,
    /// Standard deviation of the scale error.
    pub scale_sigma: f64,
    /// Standard deviation of the position jitter of one sample, metres.
    pub position_sigma_m: f64,
    /// Degrees of freedom of the errors; `None` takes the map's own, or 3; where the sensor's error is all, 10 and the normal law, weighed,
    /// and no sample costing more than 8. From 1000 on it is the normal law.
    pub nu: Option<f64>,
    /// How the map is read between its nodes. What it cannot say there is part of the error whichever is taken.
    pub interpolation: Interpolation,
    /// Least share of the samples that a candidate must have on the map.
    pub min_overlap: f64,
    /// Least p-value of the residuals with which a fix is declared.
    pub min_goodness: f64,
    /// Largest lattice that may be built, at most 10^8: a candidate takes some 200 bytes.
    pub max_candidates: u64,
    /// Whether the posterior over the first lattice is returned with the fix.
    pub surface: bool,
}

impl PosteriorOptions {
    /// Defaults for a start known to within `half_width` map units.
    pub fn new(half_width: [f64; 2]) -> Self {
        Self {
            half_width,
            step: None,
            tolerance_m: None,
            max_risk: 0.01,
            bias_sigma: None,
            leg_bias_sigma: 0.0,
            bias_walk: 0.0,
            height_sigma_m: 0.0,
            misfit_threshold: None,
            drift_sigma_m: 0.0,
            heading_sigma_deg: 0.0,
            scale_sigma: 0.0,
            position_sigma_m: 0.0,
            nu: None,
            interpolation: Interpolation::Bilinear,
            min_overlap: 0.8,
            min_goodness: 1e-3,
            max_candidates: 4_000_000,
            surface: false,
        }
    }

    /// Checks the ranges of all options.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first option out of range.
    pub fn validate(&self) -> Result<()> {
        require_positive("half_width x", self.half_width[0])?;
        require_positive("half_width y", self.half_width[1])?;
        if let Some([x, y]) = self.step {
            require_positive("step x", x)?;
            require_positive("step y", y)?;
        }
        if let Some(tolerance) = self.tolerance_m {
            require_positive("tolerance_m", tolerance)?;
        }
        if !(self.max_risk > 0.0 && self.max_risk < 1.0) {
            return Err(Error::invalid("max_risk", "a probability between 0 and 1", self.max_risk));
        }
        if let Some(sigma) = self.bias_sigma {
            require_not_negative("bias_sigma", sigma)?;
        }
        for (name, value, most) in [
            ("drift_sigma_m", self.drift_sigma_m, MOST_DRIFT_M),
            ("heading_sigma_deg", self.heading_sigma_deg, 180.0),
            ("scale_sigma", self.scale_sigma, 1.0),
        ] {
            if require_not_negative(name, value)? > most {
                return Err(Error::invalid(name, format!("at most {most}"), value));
            }
        }
        require_not_negative("position_sigma_m", self.position_sigma_m)?;
        require_not_negative("leg_bias_sigma", self.leg_bias_sigma)?;
        require_not_negative("bias_walk", self.bias_walk)?;
        if require_not_negative("height_sigma_m", self.height_sigma_m)? > MOST_HEIGHT_M {
            return Err(Error::invalid("height_sigma_m", format!("at most {MOST_HEIGHT_M}"), self.height_sigma_m));
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

/// One field that was measured along the track, with its map.
#[derive(Debug, Clone, Copy)]
pub struct Channel<'a> {
    /// The map.
    pub field: &'a dyn Field,
    /// Measured values, one a sample of the track, value units.
    pub values: &'a [f64],
    /// Standard deviation of the sensor, value units; `None` where unknown.
    pub sigma: Option<f64>,
}
