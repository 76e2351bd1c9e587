//! Settings of the refinement.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_positive};
use crate::grid::Interpolation;
use crate::matching::scene::Priors;

/// How the misfit is minimised, and what is asked of the answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RefineOptions {
    /// What is known beforehand; see [`Priors`] for what is estimated at all.
    pub priors: Priors,
    /// How the map is read: bicubic has a gradient without steps.
    pub interpolation: Interpolation,
    /// Distance over which the map's own error is correlated (exponentially), metres; 0 is white, `None` is estimated
    /// from the residuals by maximum likelihood where the map has a sigma.
    pub map_correlation_m: Option<f64>,
    /// Greatest number of steps from one start.
    pub max_iterations: usize,
    /// Least share of the samples that must lie on the map.
    pub min_overlap: f64,
    /// Radius within which a fix counts as right, metres; `None` counts only other minima as wrong.
    pub tolerance_m: Option<f64>,
    /// Greatest risk at which the answer is a fix.
    pub max_risk: f64,
    /// Least p-value of the residuals at which the answer is a fix.
    pub min_goodness: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            priors: Priors::default(),
            interpolation: Interpolation::Bicubic,
            map_correlation_m: None,
            max_iterations: 60,
            min_overlap: 0.8,
            tolerance_m: None,
            max_risk: 0.01,
            min_goodness: 1e-3,
        }
    }
}

impl RefineOptions {
    /// Refuses options that cannot be used.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check(&self) -> Result<()> {
        self.priors.check()?;
        if let Some(d) = self.map_correlation_m {
            crate::error::require_not_negative("map_correlation_m", d)?;
        }
        if let Some(t) = self.tolerance_m {
            require_positive("tolerance_m", t)?;
        }
        if self.max_iterations == 0 {
            return Err(Error::invalid("refine max_iterations", "at least 1", 0));
        }
        for (name, v) in
            [("min_overlap", self.min_overlap), ("max_risk", self.max_risk), ("min_goodness", self.min_goodness)]
        {
            if !(0.0..=1.0).contains(&v) {
                return Err(Error::invalid(name, "a number from 0 to 1", v));
            }
        }
        Ok(())
    }
}
