//! Matchers: from an indicated track, measured values and a map to a fix.

pub mod closest;
pub mod contour;
pub mod refine;
pub mod scene;
pub mod sequence;
pub mod sliding;
pub mod starts;
pub mod transform;
pub mod tuning;
