//! How the errors of a map behave: their tails, their correlation and their displacement.
//!
//! A standard deviation per node ([`MapSigma`](crate::grid::MapSigma)) says how large the errors of a gridded map are; it
//! does not say that neighbouring errors go together, that whole features stand displaced, or that some places are
//! several times worse than expected. A [`MapErrorModel`] does, in four numbers that can be learnt from the lines of
//! the survey itself, by matching lines that were left out against a map of the others.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_not_negative, require_positive};

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
    /// Distance to the data.
    pub distance_m: DistanceLayer,
    /// Log evidence that an effect which was not told must gain for a fix to be rejected; `None` where it was not learnt.
    #[serde(default)]
    pub misfit_threshold: Option<f64>,
}

impl MapErrorModel {
    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first parameter out of range, [`Error::Shape`] for a layer of another size than
    /// the map's `nodes`.
    pub fn validate(&self, nodes: usize) -> Result<()> {
        require_positive("error model nu", self.nu)?;
        require_not_negative("error model scale_spread", self.scale_spread)?;
        require_not_negative("error model correlation", self.correlation)?;
        require_not_negative("error model registration", self.registration)?;
        if let Some(threshold) = self.misfit_threshold {
            require_positive("error model misfit_threshold", threshold)?;
        }
        match &self.distance_m {
            DistanceLayer::Constant(d) => {
                require_not_negative("error model distance_m", *d)?;
            }
            DistanceLayer::Grid(layer) => {
                if layer.len() != nodes {
                    return Err(Error::shape(
                        "error model distance_m",
                        format!("{nodes} values as the map"),
                        format!("{} values", layer.len()),
                    ));
                }
                if let Some(i) = layer.iter().position(|d| d.is_infinite() || *d < 0.0) {
                    return Err(Error::invalid(
                        format!("error model distance_m[{i}]"),
                        "a number >= 0 (NaN where unknown)",
                        layer[i],
                    ));
                }
            }
        }
        Ok(())
    }
}
