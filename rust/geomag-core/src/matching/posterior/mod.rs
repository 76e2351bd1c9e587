//! Calibrated matching: the posterior over the offset, and fixes with a declared risk.
//!
//! For every candidate offset o the residuals e_k = v_k - map(p_k + o) are judged by a Student-t distribution whose variance is
//! that of the sensor, of the map at that place, and of the lattice's own coarseness,
//!
//! ```text
//! s_k^2 = sigma_sensor^2 + (level sigma_map)^2 + |gradient|^2 (step^2 / 12 + sigma_position^2)
//! ```
//!
//! with a constant bias (and, on request, heading, scale and drift) integrated out. The level, the factor by which this track
//! fares worse or better than the map's own sigma, is integrated out over a few values. Errors of neighbouring samples
//! are correlated over about the distance to the data, so the likelihood is taken to the power of the effective share of
//! independent samples; features of a gridded map stand displaced by a part of that distance, so the posterior is
//! blurred by it. The mass outside the tolerance around the answer is the declared risk.
//!
//! Sources: Student-t errors by reweighting, Lange, Little and Taylor, J. Am. Stat. Assoc. 84 (1989) 881; integration by
//! Laplace's method, Tierney and Kadane, J. Am. Stat. Assoc. 81 (1986) 82; tempering by the effective number of samples of an AR(1)
//! series, Bartlett, J. Roy. Stat. Soc. 98 (1935) 536. The error model of gridded surveys is geomag's own.

// Formulas read better without code marks; lanes and small matrices are indexed as the formulas are; what is dispatched to an
// instruction set must be inlined there; lanes are masks, without branches.
#![allow(clippy::doc_markdown, clippy::needless_range_loop, clippy::inline_always, clippy::needless_bitwise_bool)]

// Five floors, lowest first; on each, from left to right, the later may use the earlier. tests/test_architecture.py reads them.
mod lattice;
mod options;
mod patch;

mod noise;
mod nuisance;

mod goodness;
mod kernel;
mod problem;

mod density;
mod reference;
mod search;

mod batch;
mod decide;
mod misfit;
mod predict;
mod streaming;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_declared;

pub use crate::matching::scene::Channel;
pub use batch::{match_channels, match_interruptible, match_many, match_posterior, stream_many, work};
pub use options::PosteriorOptions;
pub use predict::{Prediction, predict, predict_many};
pub use streaming::{PosteriorMatcher, PosteriorStep};
