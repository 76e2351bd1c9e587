//! A track, its maps and what is known of their errors, made ready for the kernel, and what is asked of them.

mod channel;
mod interruption;
mod likelihoods;
mod look;
mod ready;

pub(super) use channel::PreparedChannel;
pub(super) use interruption::Interruption;
pub(super) use likelihoods::{Likelihoods, Scope};
pub(super) use ready::Problem;
