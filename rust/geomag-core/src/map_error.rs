//! How the errors of a map behave: their tails, their correlation and their displacement.
//!
//! A standard deviation per node ([`MapSigma`](crate::grid::MapSigma)) says how large the errors of a gridded map are; it
//! does not say that neighbouring errors go together, that whole features stand displaced, or that some places are
//! several times worse than expected. A [`MapErrorModel`] does, in four numbers that can be learnt from the lines of
//! the survey itself, by matching lines that were left out against a map of the others.

use serde::{Deserialize, Serialize};

use crate::bounds::{FARTHEST_M, require_distance_m, require_spread};
use crate::error::{Error, Result, require_not_negative, require_positive};

/// Share of lapses beyond which a track is too short for any statement.
const MOST_LAPSES: f64 = 0.9;

/// Distance from the nodes of a map to the data that it was made from, metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum DistanceLayer {
    /// One distance for the whole map.
    Constant(f64),
    /// One distance a node, row = y ascending, column = x ascending.
    Grid(Vec<f32>),
}

/// The statistics of a map's errors beyond their standard deviation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapErrorModel {
    /// Degrees of freedom of the Student-t law of one sample's error.
    pub nu: f64,
    /// Standard deviation of the logarithm of the factor by which one track's errors differ from the stated sigma.
    pub scale_spread: f64,
    /// Correlation length of the errors along a track, in units of the distance to the data.
    pub correlation: f64,
    /// Displacement of a map's features common to a whole track, per axis, in units of the distance to the data.
    pub registration: f64,
    /// Distance to the data: of maps made from lines, to those on either side ([`Distances`](crate::gridding::Distances)).
    pub distance_m: DistanceLayer,
    /// Log evidence that an effect which was not told must gain for a fix to be rejected; `None` where it was not learnt.
    #[serde(default)]
    pub misfit_threshold: Option<f64>,
    /// What a filter needs beyond what a matcher does; `None` where it was not learnt.
    #[serde(default)]
    pub filter: Option<FilterLaw>,
    /// How the risk that the posterior computes is to be read; `None` where that was not learnt.
    #[serde(default)]
    pub recalibration: Option<Recalibration>,
    /// How much worse than by the stated errors planned flights fare; `None` where that was not learnt.
    #[serde(default)]
    pub forecast: Option<Forecast>,
    /// How often short tracks are wrong whatever their risk says; `None` where that was not learnt.
    #[serde(default)]
    pub lapses: Option<Lapses>,
    /// Factor on the covariance that the posterior computes of a fix, to the one that is declared; `None` where that was not learnt.
    #[serde(default)]
    pub covariance_factor: Option<f64>,
}

/// How often a track shorter than those that risks were learnt on is wrong, whatever the posterior says of it.
///
/// A track of length l passes few features of the map. Where one of them stands wrong on the map, between two lines, the posterior
/// is sure of a place beside the true one, and no line in log-odds tells such answers from right ones: what is left is a share of
/// lapses, which falls as features are added, `share ((length / l)^2 - 1)`. A stream that stops at its first fix stops on the luckiest of
/// short tracks, so that it is learnt from first answers of growing windows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lapses {
    /// Share of lapses at 1 / sqrt(2) of the length.
    pub share: f64,
    /// Length of the tracks that risks were learnt on, from which on there are none beside those that the risk has in it, metres.
    pub length_m: f64,
}

impl Lapses {
    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        if require_not_negative("error model lapses share", self.share)? > 1.0 {
            return Err(Error::invalid("error model lapses share", "a share in [0, 1]", self.share));
        }
        require_positive("error model lapses length_m", self.length_m)?;
        Ok(())
    }

    /// Share of answers on tracks of this length that are wrong beside what their risk says.
    pub fn of(&self, length_m: f64) -> f64 {
        if length_m >= self.length_m {
            return 0.0;
        }
        (self.share * ((self.length_m / length_m).powi(2) - 1.0)).min(MOST_LAPSES)
    }

    /// The risk of an answer on a track of this length that has a risk of `risk` on one as long as those learnt on.
    pub fn risk(&self, risk: f64, length_m: f64) -> f64 {
        risk + (1.0 - risk) * self.of(length_m)
    }
}

/// From the computed risk of an answer to the share that proves wrong on lines left out of the map: a line in log-odds
/// (Platt, Probabilities for SV machines, 1999).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Recalibration {
    /// Factor on the log-odds; below 1 where answers are bolder than they should be.
    pub slope: f64,
    /// What is added to the log-odds.
    pub intercept: f64,
}

impl Recalibration {
    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        require_positive("error model recalibration slope", self.slope)?;
        if !self.intercept.is_finite() {
            return Err(Error::invalid("error model recalibration intercept", "a finite number", self.intercept));
        }
        Ok(())
    }

    /// The risk to declare for a computed one; 0 and 1 stay what they are.
    pub fn risk(&self, computed: f64) -> f64 {
        if computed <= 0.0 || computed >= 1.0 {
            return computed;
        }
        let odds = self.slope * (computed / (1.0 - computed)).ln() + self.intercept;
        1.0 / (1.0 + (-odds).exp())
    }
}

/// What a forecast has to know beyond the errors of the map, learnt from what was foretold of left-out lines and what came.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// Factor on the map's errors in simulated flights, which makes as many of them fixed as were.
    pub level: f64,
    /// Standard deviation of fixes over that which the local information gives.
    pub spread: f64,
    /// Standard deviation, per axis, of what no information takes away, in units of the distance to the data.
    #[serde(default)]
    pub registration: f64,
}

impl Default for Forecast {
    /// As the stated errors and the local information have it.
    fn default() -> Self {
        Self { level: 1.0, spread: 1.0, registration: 0.0 }
    }
}

impl Forecast {
    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        require_not_negative("error model forecast level", self.level)?;
        require_positive("error model forecast spread", self.spread)?;
        require_spread("error model forecast registration", self.registration)?;
        Ok(())
    }
}

/// How readings one after another fare against the map: what a filter has to know of its errors.
///
/// A matcher judges windows of some forty samples, so the stored sigma is that with which *windows* are calibrated. Single
/// samples have worse errors, and a filter adds up hundreds of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FilterLaw {
    /// Standard deviation of a single sample's error over the stored sigma.
    pub sample_factor: f64,
    /// Standard deviation of the mean error over a batch (one and a half correlation lengths) over that of a single sample.
    pub batch_factor: f64,
    /// Misfit of survey lines where they cross, value units: the least error of any mean.
    pub crossover: f64,
    /// Displacement of a map's features, per axis, in units of the distance to the data.
    pub registration_m_per_d: f64,
    /// Length along the track over which that displacement changes, in units of the distance to the data.
    pub registration_length: f64,
}

impl Default for FilterLaw {
    /// Between what was learnt of a dense survey of aeromagnetic lines and of a wide one; a least error that depends on the
    /// unit is not among it.
    fn default() -> Self {
        Self {
            sample_factor: 1.5,
            batch_factor: 1.7,
            crossover: 0.0,
            registration_m_per_d: 0.3,
            registration_length: 40.0,
        }
    }
}

impl FilterLaw {
    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        require_positive(
            "error model sample_factor",
            require_spread("error model sample_factor", self.sample_factor)?,
        )?;
        require_positive("error model batch_factor", require_spread("error model batch_factor", self.batch_factor)?)?;
        require_spread("error model crossover", self.crossover)?;
        require_spread("error model registration_m_per_d", self.registration_m_per_d)?;
        require_positive("error model registration_length", self.registration_length)?;
        Ok(())
    }
}

impl MapErrorModel {
    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first parameter out of range, [`Error::Shape`] for a layer of another size than
    /// the map's `nodes`.
    pub fn validate(&self, nodes: usize) -> Result<()> {
        require_positive("error model nu", self.nu)?;
        require_spread("error model scale_spread", self.scale_spread)?;
        require_spread("error model correlation", self.correlation)?;
        require_spread("error model registration", self.registration)?;
        if let Some(threshold) = self.misfit_threshold {
            require_positive("error model misfit_threshold", threshold)?;
        }
        if let Some(law) = &self.filter {
            law.validate()?;
        }
        if let Some(recalibration) = &self.recalibration {
            recalibration.validate()?;
        }
        if let Some(forecast) = &self.forecast {
            forecast.validate()?;
        }
        if let Some(lapses) = &self.lapses {
            lapses.validate()?;
        }
        if let Some(factor) = self.covariance_factor {
            require_positive(
                "error model covariance_factor",
                require_spread("error model covariance_factor", factor)?,
            )?;
        }
        match &self.distance_m {
            DistanceLayer::Constant(d) => {
                require_distance_m("error model distance_m", *d)?;
            }
            DistanceLayer::Grid(layer) => {
                if layer.len() != nodes {
                    return Err(Error::shape(
                        "error model distance_m",
                        format!("{nodes} values as the map"),
                        format!("{} values", layer.len()),
                    ));
                }
                if let Some(i) =
                    layer.iter().position(|d| !d.is_nan() && require_distance_m("", f64::from(*d)).is_err())
                {
                    return Err(Error::invalid(
                        format!("error model distance_m[{i}]"),
                        format!("a number >= 0, at most {} (NaN where unknown)", 2.0 * FARTHEST_M),
                        layer[i],
                    ));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lapses_fall_with_the_square_of_the_length() {
        let lapses = Lapses { share: 0.02, length_m: 8000.0 };
        assert_eq!([8000.0, 9000.0, f64::INFINITY].map(|l| lapses.of(l)), [0.0; 3]);
        assert!((lapses.of(4000.0) - 0.06).abs() < 1e-15);
        assert!((lapses.risk(0.1, 4000.0) - (1.0 - 0.9 * 0.94)).abs() < 1e-15);
        assert_eq!(lapses.risk(0.3, 8000.0), 0.3);
        assert_eq!([1.0, 0.0].map(|l| lapses.of(l)), [MOST_LAPSES; 2]);
        assert_eq!(Lapses { share: 0.0, ..lapses }.of(4000.0), 0.0);
        assert!(
            Lapses { share: -0.1, ..lapses }.validate().is_err() && Lapses { share: 1.1, ..lapses }.validate().is_err()
        );
        assert!(Lapses { length_m: 0.0, ..lapses }.validate().is_err() && lapses.validate().is_ok());
    }

    #[test]
    fn recalibration_is_a_line_in_log_odds() {
        let of = |slope, intercept| Recalibration { slope, intercept };
        let same = of(1.0, 0.0);
        for risk in [0.0, 1e-12, 0.01, 0.5, 0.9, 1.0] {
            assert!((same.risk(risk) - risk).abs() < 1e-15);
        }
        // Half the log-odds of 1 to 99 are those of 1 to 99 ^ 0.5.
        assert!((of(0.5, 0.0).risk(0.01) - 1.0 / (1.0 + 99.0_f64.sqrt())).abs() < 1e-15);
        assert!((of(1.0, 2.0_f64.ln()).risk(0.5) - 2.0 / 3.0).abs() < 1e-15);
        assert!(of(0.0, 0.0).validate().is_err() && of(1.0, f64::NAN).validate().is_err());
        assert!(of(0.8, -0.3).validate().is_ok());
    }
}
