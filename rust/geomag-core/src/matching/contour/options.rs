//! Settings of contour matching.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_not_negative, require_positive};
use crate::matching::closest::check_radius;
use crate::matching::refine::RefineOptions;
use crate::matching::scene::Judgement;
use crate::matching::starts::Starts;
use crate::matching::transform::TransformKind;

/// Settings of contour matching. The default is ICCP to the letter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContourOptions {
    /// What the track may do as one body.
    pub transform: TransformKind,
    /// How far from a point its contour is looked for, metres; infinity is the whole map.
    pub radius_m: f64,
    /// K of the objective: weight of the distance to the indicated points against that to the contours.
    pub stiffness: f64,
    /// The points have converged when none moves by more than this, metres.
    pub tolerance_m: f64,
    /// Greatest number of iterations from one start.
    pub max_iterations: usize,
    /// Least number of points that must have a contour in reach; `None` is half of them, or what the transform needs.
    pub min_points: Option<usize>,
    /// Depth of Anderson acceleration; 0 is the plain iteration.
    pub acceleration: usize,
    /// Greatest total rotation, degrees; `None` is no bound.
    pub max_rotation_deg: Option<f64>,
    /// Where to start.
    pub starts: Starts,
    /// Whether the misfit is minimised afterwards; without it there is no covariance.
    pub refine: bool,
    /// Priors (which also hold the transforms of ICCP) and the settings of the refinement.
    pub refinement: RefineOptions,
}

impl Default for ContourOptions {
    fn default() -> Self {
        Self {
            transform: TransformKind::Rigid,
            radius_m: f64::INFINITY,
            stiffness: 0.0,
            tolerance_m: 1.0,
            max_iterations: 300,
            min_points: None,
            acceleration: 0,
            max_rotation_deg: None,
            starts: Starts::Indicated,
            refine: false,
            refinement: RefineOptions::default(),
        }
    }
}

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
        require_positive("tolerance_m", self.tolerance_m)?;
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
