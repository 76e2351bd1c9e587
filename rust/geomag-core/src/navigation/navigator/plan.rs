//! When and how the matcher beside the filter is asked.

use serde::{Deserialize, Serialize};

use crate::error::{Result, require_count, require_not_negative, require_positive};

/// Most samples of a window.
pub(super) const MOST: usize = 256;

/// When and how the matcher is asked.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MatcherPlan {
    /// Time between two tries while the position is uncertain or in doubt, seconds.
    pub every_s: f64,
    /// Time between two looks round while the filter tracks, seconds; infinite for none.
    pub wide_every_s: f64,
    /// Samples of a window.
    pub samples: usize,
    /// Distance between them, metres; `None` asks the map.
    pub spacing_m: Option<f64>,
    /// Tolerance of a fix, metres; `None` asks the map.
    pub tolerance_m: Option<f64>,
    /// Greatest declared risk of a fix that is used.
    pub max_risk: f64,
    /// Greatest half width of a search, metres.
    pub reach_m: f64,
}

impl Default for MatcherPlan {
    fn default() -> Self {
        Self {
            every_s: 60.0,
            wide_every_s: 600.0,
            samples: 40,
            spacing_m: None,
            tolerance_m: None,
            max_risk: 0.01,
            reach_m: 40_000.0,
        }
    }
}

impl MatcherPlan {
    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::error::Error::Invalid) naming the first out of range.
    pub fn validate(&self) -> Result<()> {
        require_positive("matcher every_s", self.every_s)?;
        if self.wide_every_s != f64::INFINITY {
            require_positive("matcher wide_every_s", self.wide_every_s)?;
        }
        require_count("matcher samples", self.samples, MOST)?;
        for (name, value) in [("matcher spacing_m", self.spacing_m), ("matcher tolerance_m", self.tolerance_m)] {
            if let Some(value) = value {
                require_positive(name, value)?;
            }
        }
        require_not_negative("matcher max_risk", self.max_risk)?;
        require_positive("matcher reach_m", self.reach_m)?;
        Ok(())
    }
}
