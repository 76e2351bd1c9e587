//! The posterior sample by sample: the calibrated form of iterative evaluation matching.
//!
//! Every sample is first put to a gate that costs next to nothing: each candidate keeps the interval of biases that
//! its samples allow, with the map's own range over the candidate's cell, and is dropped when too many samples fall outside.
//! The posterior proper is taken by the batch kernel over the candidates that are left, whenever that is cheap or due, so
//! that a streamed fix and a batch fix on the same samples agree.

mod candidate;
mod held;
mod matcher;
#[cfg(test)]
mod tests;

pub use matcher::{PosteriorMatcher, PosteriorStep};
