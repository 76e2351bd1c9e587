//! Matchers: each a composition of the lattice kernels, a rule and the common answer.

pub mod closest;
pub mod contour;
pub mod grid_search;
pub mod iema;
pub mod posterior;
pub mod refine;
pub mod scene;
pub mod sequence;
pub mod similarity;
pub mod sliding;
pub mod starts;
pub mod stream;
pub mod transform;
pub mod tuning;
