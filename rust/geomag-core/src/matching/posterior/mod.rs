//! Calibrated matching: the posterior over the offset, and fixes with a declared risk.
//!
//! For every candidate offset o the residuals e_k = v_k - map(p_k + o) are judged by a Student-t law whose variance is
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

mod decide;
mod density;
mod goodness;
mod kernel;
mod misfit;
mod model;
mod nuisance;
mod patch;
mod predict;
mod problem;
mod search;
mod streaming;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_declared;

pub use model::{Channel, PosteriorOptions};
pub use predict::{Prediction, predict, predict_many};
pub use streaming::{PosteriorMatcher, PosteriorStep};

use std::sync::Arc;

use crate::error::Result;
use crate::field::Field;
use crate::fix::Fix;
use crate::matching::stream::feed;
use crate::monitor::{Monitor, Quiet};
use crate::stack::{Served, read_heights, served};
use crate::track::Track;
use problem::{Interruption, Problem};
use rayon::prelude::*;
use search::Lattice;

/// Tracks that are matched at once.
const MANY: usize = 64;

/// A monitor told the same from every place of a computation that cannot say more.
struct At<'a> {
    monitor: &'a dyn Monitor,
    done: usize,
    total: usize,
}

impl Monitor for At<'_> {
    fn advance(&self, _: u64, _: u64) -> Result<()> {
        self.monitor.advance(self.done as u64, self.total as u64)
    }
}

/// Calibrated position fix of a track on one map.
///
/// `sigma` is the standard deviation of the sensor in value units, `None` where unknown. The answer carries the
/// posterior's centre, covariance, risk (the probability that it is further than the tolerance from the truth) and the
/// p-value of its residuals. Whether it is declared is its status.
///
/// # Errors
/// [`Error::Invalid`](crate::error::Error::Invalid) for options out of range,
/// [`Error::TooManyCandidates`](crate::error::Error::TooManyCandidates) for a lattice over `max_candidates`.
pub fn match_posterior(
    field: &dyn Field,
    track: &Track,
    sigma: Option<f64>,
    options: &PosteriorOptions,
) -> Result<Fix> {
    match_channels(&[Channel { field, values: track.values(), sigma }], track, options)
}

/// Calibrated position fix from several fields measured along the same track, each with its own map and errors.
///
/// The positions (and times) of `track` are used; the values are those of the channels. Bias, heading, scale and drift are
/// integrated out for each channel by itself, which gives away a little and assumes nothing about what they share.
///
/// # Errors
/// As [`match_posterior`]; [`Error::Shape`](crate::error::Error::Shape) where a channel has another number of values.
pub fn match_channels(channels: &[Channel<'_>], track: &Track, options: &PosteriorOptions) -> Result<Fix> {
    match_interruptible(channels, track, options, &Quiet)
}

/// [`match_channels`] that `monitor` may stop; it is told nothing of how far the search is.
///
/// # Errors
/// As [`match_channels`]; [`Error::Interrupted`](crate::error::Error::Interrupted).
pub fn match_interruptible(
    channels: &[Channel<'_>],
    track: &Track,
    options: &PosteriorOptions,
    monitor: &dyn Monitor,
) -> Result<Fix> {
    let served: Vec<Served<'_>> = channels.iter().map(|c| served(c.field, track)).collect::<Result<_>>()?;
    let channels: Vec<Channel<'_>> =
        channels.iter().zip(&served).map(|(c, served)| Channel { field: served.field(), ..*c }).collect();
    // One entry into the pool of threads, not one a stage.
    let mut fix = rayon::scope(|_| solve(&channels, track, options, monitor))?;
    fix.heights_m = read_heights(&served, track);
    Ok(fix)
}

/// About how long a match takes with these options, nanoseconds of one thread.
///
/// # Errors
/// As [`match_posterior`] for the options and the size of the lattice.
pub fn work(field: &dyn Field, track: &Track, options: &PosteriorOptions) -> Result<u64> {
    options.validate()?;
    let lattice = Lattice::new(field.spacing(), options)?;
    Ok(lattice.len().saturating_mul(track.len() as u64))
}

fn solve(channels: &[Channel<'_>], track: &Track, options: &PosteriorOptions, monitor: &dyn Monitor) -> Result<Fix> {
    let mut problem = Problem::new(channels, track, options)?;
    problem.interruption = Interruption::by(monitor);
    let lattice = problem.lattice()?;
    let posterior = problem.solve(lattice.offsets(), lattice.step);
    problem.interruption.none()?;
    let mut fix = decide::answer(&problem, track, &posterior, &lattice);
    if options.surface {
        let step = lattice.step;
        let fixed = PosteriorOptions { step: Some(step), ..options.clone() };
        let mut problem = Problem::new(channels, track, &fixed)?;
        problem.interruption = Interruption::by(monitor);
        let offsets = lattice.offsets();
        let posterior = problem.solve(offsets.clone(), step);
        problem.interruption.none()?;
        let mut log_p = vec![f64::NEG_INFINITY; offsets.len()];
        if posterior.log_p.len() == log_p.len() {
            log_p.copy_from_slice(&posterior.log_p);
        }
        fix.surface = decide::surface(&offsets, &log_p, step);
    }
    Ok(fix)
}

/// [`match_posterior`] for many tracks on one map, in parallel; the answers are in the order of the tracks.
///
/// # Errors
/// The first error of any track, or [`Error::Interrupted`](crate::error::Error::Interrupted).
pub fn match_many(
    field: &dyn Field,
    tracks: &[Track],
    sigma: Option<f64>,
    options: &PosteriorOptions,
    monitor: &dyn Monitor,
) -> Result<Vec<Fix>> {
    let mut fixes = Vec::with_capacity(tracks.len());
    for batch in tracks.chunks(MANY) {
        let here = At { monitor, done: fixes.len(), total: tracks.len() };
        let one = |track: &Track| {
            match_interruptible(&[Channel { field, values: track.values(), sigma }], track, options, &here)
        };
        let some: Result<Vec<Fix>> = batch.par_iter().map(one).collect();
        fixes.extend(some?);
    }
    Ok(fixes)
}

/// Streams many tracks, each until its first fix or its end, in parallel; the answers are in the order of the tracks.
///
/// `n_samples` of an answer says how many samples the fix took.
///
/// # Errors
/// The first error of any track, or [`Error::Interrupted`](crate::error::Error::Interrupted).
pub fn stream_many(
    field: &Arc<dyn Field>,
    tracks: &[Track],
    sigma: Option<f64>,
    options: &PosteriorOptions,
    monitor: &dyn Monitor,
) -> Result<Vec<Fix>> {
    let mut fixes = Vec::with_capacity(tracks.len());
    for batch in tracks.chunks(MANY) {
        let here = At { monitor, done: fixes.len(), total: tracks.len() };
        let some: Result<Vec<Fix>> = batch
            .par_iter()
            .map(|track| {
                let mut matcher = PosteriorMatcher::new(field.clone(), sigma, options.clone(), track.len().max(3))?;
                feed(&mut matcher, track, false, &here)
            })
            .collect();
        fixes.extend(some?);
    }
    Ok(fixes)
}
