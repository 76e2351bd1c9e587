//! Settings of contour matching.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_not_negative, require_positive};
use crate::matching::closest::check_radius;
use crate::matching::refine::RefineOptions;
use crate::matching::scene::Judgement;
use crate::matching::starts::Starts;
use crate::matching::transform::TransformKind;

/// The options of ICCP, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! contour_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            iteration [
                (transform: transform = "rigid"; "{'rigid', 'translation', 'similarity', 'affine'}";
                    "What the track may do as one body; with `refine` also what is estimated.")
                (radius_m: reach = None; "float, optional";
                    "How far from a point its contour is looked for, metres; the whole map by default. At least the INS error.")
                (starts: starts = None; "{'indicated', 'grid'} or array of shape (n, 2), optional";
                    "Where to start: at the INS (the default), at the best of a lattice, or at offsets in metres (east, north). The least"
                    "misfit wins.")
                (refine: flag = false; "bool";
                    "Minimise the misfit afterwards, over offset, heading, scale and bias; without it there is no covariance.")
                (stiffness: number = 0.0; "float";
                    "K of the objective: weight of the distance to the indicated points against that to the contours.")
                (converged_m: number = 1.0; "float";
                    "Converged when no point moves further, metres. The paper's 1 m stops short: 0.001 with `acceleration` does not.")
                (max_iterations: size = 300; "int";
                    "Greatest number of iterations from one start.")
                (min_points: maybe_size = None; "int, optional";
                    "Least number of points that must have a contour in reach; half of them by default, or what the transform needs.")
                (acceleration: size = 0; "int";
                    "Depth of Anderson acceleration, up to 8; 0 is the plain iteration.")
                (max_rotation_deg: maybe_number = None; "float, optional";
                    "Greatest total rotation, degrees; no bound by default.")
            ]
        }
    };
}

macro_rules! contour_struct {
    (iteration [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*]) => {
        /// Settings of contour matching. The default is ICCP to the letter.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub struct ContourOptions {
            $($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*
            /// Priors (which also hold the transforms of ICCP) and the settings of the refinement.
            pub refinement: RefineOptions,
        }

        impl Default for ContourOptions {
            fn default() -> Self {
                Self { $($name: option_default!($kind $default),)* refinement: RefineOptions::default() }
            }
        }
    };
}

contour_options!(contour_struct);

impl ContourOptions {
    /// The settings of the refinement: what the transform is free to do is estimated, under a flat prior where there is
    /// none.
    pub fn effective_refinement(&self) -> RefineOptions {
        let mut out = self.refinement.clone();
        if self.transform != TransformKind::Translation {
            out.priors.heading_sigma_deg.get_or_insert(f64::INFINITY);
        }
        if matches!(self.transform, TransformKind::Similarity | TransformKind::Affine) {
            out.priors.scale_sigma.get_or_insert(f64::INFINITY);
        }
        out
    }

    /// How places of a track of `n` samples are judged against one another.
    pub(crate) fn judgement(&self, n: usize) -> Judgement {
        Judgement {
            unbiased: self.refinement.priors.bias_sigma.is_some(),
            min_samples: ((self.refinement.min_overlap * n as f64).ceil() as usize).max(1),
        }
    }

    /// Refuses settings that cannot be used.
    ///
    /// # Errors
    /// [`Error::Invalid`], [`Error::NotFinite`], [`Error::TooManyCandidates`].
    pub fn check(&self) -> Result<()> {
        check_radius(self.radius_m)?;
        require_not_negative("stiffness", self.stiffness)?;
        require_positive("converged_m", self.converged_m)?;
        if self.max_iterations == 0 {
            return Err(Error::invalid("max_iterations", "at least 1", 0));
        }
        if self.acceleration > 8 {
            return Err(Error::invalid("acceleration", "a depth from 0 (plain) to 8", self.acceleration));
        }
        if let Some(cap) = self.max_rotation_deg {
            require_not_negative("max_rotation_deg", cap)?;
        }
        self.starts.check()?;
        self.refinement.check()
    }
}
