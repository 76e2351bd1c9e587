//! Calibrated matching.

mod calls;
mod matching;
mod prediction;
mod streaming;

pub use calls::Extent;
pub use calls::{
    PyAcceptance, PyInsPrior, PyPosteriorMatcher, PySearchBox, match_posterior, match_posterior_many, predict_many,
};
pub use matching::{boxed, limit, merge, middle};
pub use prediction::PyPrediction;
pub use streaming::PyPosteriorStep;
