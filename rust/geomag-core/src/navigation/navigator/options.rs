//! What is asked of a navigator.

use serde::{Deserialize, Serialize};

use super::ins::InsModel;
use super::integrity::widening;
use super::plan::MatcherPlan;
use crate::bounds::{require_distance_m, require_place, require_spread, require_values};
use crate::error::{Error, Result, require_finite, require_positive};

/// Which filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum NavigatorMethod {
    /// That of this module.
    #[default]
    Navigator,
    /// The extended Kalman filter of the textbooks, for comparison: every reading by itself, gradient at the mean, noise of the sensor
    /// alone, covariance reported as it is.
    Ekf,
    /// The Rao-Blackwellised particle filter of the textbooks, for comparison, in whole flights only: positions as 1,000 particles, the other
    /// states in Kalman filters with one covariance, noise of the sensor alone.
    Rbpf,
}

impl NavigatorMethod {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Navigator => "navigator",
            Self::Ekf => "ekf",
            Self::Rbpf => "rbpf",
        }
    }
}

/// The options of a navigator, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! navigator_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            extent [
                (position_sigma_m: maybe_number = None; "float, optional";
                    "Standard deviation of the place at the start on each axis, metres; 100 where neither this nor `covariance_m2` is given.")
            ]
            options [
                (ins: ins = None; "InsModel, optional";
                    "The INS whose output is corrected; `InsModel.navigation()` by default.")
                (start: maybe_pair = None; "float or (float, float), optional";
                    "True place at the first step as far as it is known, map units; the first that is indicated by default.")
                (covariance_m2: covariance = None; "float or array of shape (2, 2), optional";
                    "Covariance of that place, square metres, east-north; a number is the variance on each axis.")
                (reading_sigma: number = 1.0; "float";
                    "Standard deviation of the white error of one reading, value units.")
                (bias_sigma: number = 30.0; "float";
                    "Standard deviation of the sensor's constant error at the start, value units.")
                (bias_walk_sqrt_s: number = 0.03; "float";
                    "Random walk of that error, value units per square root of a second. The level is information: a bias that is let walk"
                    "fast throws it away.")
                (batch_m: maybe_number = None; "float, optional";
                    "Stretch over which readings are gathered into one measurement, metres; by default what the map's errors ask for; 0 takes"
                    "every reading by itself.")
                (registration: maybe_number = None; "float, optional";
                    "Displacement of the map's features, in distances to the data; by default what the map knows.")
                (nu: number = 3.0; "float";
                    "Degrees of freedom of the Student-t law of a measurement; infinite for the normal law.")
                (linear_m: maybe_number = None; "float, optional";
                    "Position sigma up to which the field is straight enough to track, metres; from the map by default.")
                (integrity_risk: number = 1e-3; "float";
                    "Probability with which the error may exceed the protection level.")
                (terms_covariance: matrix = None; "array of shape (m, m), optional";
                    "Covariance of the coefficients of terms that the readings contain besides the field (the vehicle's own: Tolles-Lawson),"
                    "which are then states of the filter; `terms` of a step are what they are multiplied by.")
                (gravity: flag = false; "bool";
                    "The readings are gravity anomalies in mGal, reduced with the INS's latitude (normal gravity) and velocity (Eotvos effect):"
                    "what its errors put into them is then part of the measurement. Not with method 'rbpf'.")
                (matcher: matcher = "default"; "MatcherPlan, 'default' or None";
                    "The matcher beside the filter, for a start known to kilometres, for a lost lock and a look round now and then; None for"
                    "none.")
                (method: method = "navigator"; "{'navigator', 'ekf', 'rbpf'}";
                    "Which filter: geomag's own, or to compare with it the textbooks' extended Kalman filter and, for whole flights only, the"
                    "Rao-Blackwellised particle filter.")
                (latitude_deg: number = 45.0; "float";
                    "Latitude of a map in projected metres, degrees: the Earth turns under it.")
            ]
        }
    };
}

macro_rules! navigator_struct {
    (
        extent $extent:tt
        $($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*
    ) => {
        /// Options of a [`Navigator`](super::Navigator). What the map's error model knows is taken from there.
        ///
        /// ```
        /// use geomag_core::navigation::navigator::{InsModel, NavigatorOptions};
        /// let options = NavigatorOptions { ins: InsModel::tactical(), ..NavigatorOptions::new(300.0) };
        /// assert!(options.validate().is_ok());
        /// ```
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub struct NavigatorOptions {
            $($($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*)*
        }

        impl NavigatorOptions {
            /// Defaults for a start whose standard deviation on each axis is `position_sigma_m`.
            pub fn new(position_sigma_m: f64) -> Self {
                let variance = position_sigma_m * position_sigma_m;
                let defaults = Self { $($($name: option_default!($kind $default),)*)* };
                Self { covariance_m2: [[variance, 0.0], [0.0, variance]], ..defaults }
            }
        }
    };
}

navigator_options!(navigator_struct);

impl NavigatorOptions {
    /// Checks the ranges of all options.
    ///
    /// # Errors
    /// [`Error::Invalid`], [`Error::NotFinite`] or [`Error::NotPositiveDefinite`] naming the first out of range.
    pub fn validate(&self) -> Result<()> {
        self.ins.validate()?;
        if let Some(start) = &self.start {
            require_place("start", false, *start)?;
        }
        check_covariance(&self.covariance_m2)?;
        for (name, value) in [
            ("reading_sigma", self.reading_sigma),
            ("bias_sigma", self.bias_sigma),
            ("bias_walk_sqrt_s", self.bias_walk_sqrt_s),
        ] {
            require_spread(name, value)?;
        }
        if let Some(length) = self.batch_m {
            require_distance_m("batch_m", length)?;
        }
        if let Some(share) = self.registration {
            require_spread("registration", share)?;
        }
        if let Some(range) = self.linear_m {
            require_positive("linear_m", require_distance_m("linear_m", range)?)?;
        }
        if !(self.nu > 0.0) {
            return Err(Error::invalid("nu", "a number > 0", self.nu));
        }
        widening(self.integrity_risk)?;
        if let Some(plan) = &self.matcher {
            plan.validate()?;
        }
        let terms = self.terms();
        if terms * terms != self.terms_covariance.len() || terms > MOST_TERMS {
            let needed = format!("a square matrix of at most {MOST_TERMS} terms");
            return Err(Error::invalid("terms_covariance", needed, format!("{} numbers", self.terms_covariance.len())));
        }
        require_values("terms_covariance", &self.terms_covariance)?;
        if terms > 0 {
            let matrix = nalgebra::DMatrix::from_row_slice(terms, terms, &self.terms_covariance);
            let symmetric = (&matrix - matrix.transpose()).amax() <= 1e-9 * matrix.amax();
            if !symmetric || matrix.cholesky().is_none() {
                return Err(Error::NotPositiveDefinite {
                    what: "terms_covariance".into(),
                    detail: "a covariance of independent coefficients has no zero and no negative variance".into(),
                });
            }
        }
        if !(self.latitude_deg.abs() <= MOST_LATITUDE_DEG) {
            let needed = format!("a latitude within {MOST_LATITUDE_DEG} degrees of the equator");
            return Err(Error::invalid("latitude_deg", needed, self.latitude_deg));
        }
        Ok(())
    }

    /// Terms that the readings contain besides the field.
    pub fn terms(&self) -> usize {
        self.terms_covariance.len().isqrt()
    }
}

/// Most terms besides the field: Tolles-Lawson has 18.
const MOST_TERMS: usize = 64;
/// Greatest latitude at which east and north still mean something to an INS of this kind.
pub(super) const MOST_LATITUDE_DEG: f64 = 89.0;
/// Greatest standard deviation of a position, metres: half the way round the Earth.
pub(super) const MOST_SIGMA_M: f64 = 2e7;

/// Refuses what is no covariance of a position in square metres.
///
/// # Errors
/// [`Error::NotFinite`], [`Error::Invalid`], [`Error::NotPositiveDefinite`].
pub(super) fn check_covariance(c: &[[f64; 2]; 2]) -> Result<()> {
    require_finite("covariance_m2", c.as_flattened())?;
    let scale = c[0][0].abs().max(c[1][1].abs());
    if scale > MOST_SIGMA_M * MOST_SIGMA_M {
        return Err(Error::invalid(
            "covariance_m2",
            format!("standard deviations of at most {MOST_SIGMA_M} m"),
            scale.sqrt(),
        ));
    }
    if (c[0][1] - c[1][0]).abs() > 1e-9 * scale {
        return Err(Error::invalid("covariance_m2", "a symmetric matrix", format!("{} and {}", c[0][1], c[1][0])));
    }
    // By the correlation: beside a large variance a small one may be wrong by all of itself.
    let most = c[0][0].max(0.0).sqrt() * c[1][1].max(0.0).sqrt() * (1.0 + 1e-9);
    if c[0][0] < 0.0 || c[1][1] < 0.0 || c[0][1].abs().max(c[1][0].abs()) > most {
        return Err(Error::NotPositiveDefinite { what: "covariance_m2".into(), detail: format!("{c:?}") });
    }
    Ok(())
}
