//! When and how the matcher beside the filter is asked.

use crate::error::{Result, require_count, require_not_negative, require_positive};

/// Most samples of a window.
pub(super) const MOST: usize = 256;

/// When and how the matcher beside the filter is asked, a setting a row; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! matcher_plan {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            plan [
                (every_s: number = 60.0; "float";
                    "Time between two tries while the position is uncertain or in doubt, seconds.")
                (wide_every_s: number = 600.0; "float";
                    "Time between two looks round while the filter tracks, seconds; infinite for none.")
                (samples: size = 40; "int";
                    "Samples of a window, at most 256.")
                (spacing_m: maybe_number = None; "float, optional";
                    "Distance between the samples of a window, metres; from the map by default.")
                (tolerance_m: maybe_number = None; "float, optional";
                    "Tolerance of the matcher's fix, metres; from the map by default.")
                (max_risk: number = 0.01; "float";
                    "Greatest declared risk of a fix that is used.")
                (reach_m: number = 40000.0; "float";
                    "Greatest half width of a search, metres.")
            ]
        }
    };
}

matcher_plan! { record {
    /// When and how the matcher is asked.
    MatcherPlan
} }

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
