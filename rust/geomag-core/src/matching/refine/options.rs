//! Settings of the refinement.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_positive};
use crate::grid::Interpolation;
use crate::matching::scene::Priors;

/// The options of the refinement, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! refine_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            refinement [
                (interpolation: interpolation = "bicubic"; "{'bicubic', 'bilinear'}";
                    "How the refinement reads the map: bicubic has a gradient without steps.")
                (map_correlation_m: maybe_number = None; "float, optional";
                    "Distance over which the map's error is correlated (exponentially), metres; 0 is white; by default estimated from the"
                    "residuals by maximum likelihood where the map has a sigma.")
                (tolerance_m: maybe_number = None; "float, optional";
                    "A refined position further than this from the truth is wrong, metres: `risk` is the probability of that. By default the"
                    "probability of the other minima. Either supposes that map and noise are as told; it is not calibrated.")
                (max_risk: number = 0.01; "float";
                    "Greatest risk at which a refined answer is a fix.")
                (min_goodness: number = 1e-3; "float";
                    "Least p-value of the residuals at which a refined answer is a fix.")
            ]
        }
    };
}

macro_rules! refine_struct {
    (extent $extent:tt $($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*) => {
        /// How the misfit is minimised, and what is asked of the answer.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub struct RefineOptions {
            /// What is known beforehand; see [`Priors`] for what is estimated at all.
            pub priors: Priors,
            /// Greatest number of steps from one start.
            pub max_iterations: usize,
            $($($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*)*
        }

        impl Default for RefineOptions {
            fn default() -> Self {
                Self { priors: Priors::default(), max_iterations: 60, $($($name: option_default!($kind $default),)*)* }
            }
        }
    };
}

common_options!(refine_options refine_struct);

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
