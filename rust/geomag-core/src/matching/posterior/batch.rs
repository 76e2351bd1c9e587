//! Whole tracks at once: one, many, and many streamed.

use std::sync::Arc;

use rayon::prelude::*;

use super::decide;
use super::lattice::Lattice;
use super::options::PosteriorOptions;
use super::problem::{Interruption, Problem};
use super::streaming::PosteriorMatcher;
use crate::error::Result;
use crate::field::Field;
use crate::fix::Fix;
use crate::matching::scene::Channel;
use crate::matching::stream::feed;
use crate::monitor::{Monitor, Quiet};
use crate::stack::{Served, read_heights, served};
use crate::track::Track;

/// Tracks that are matched at once.
pub(super) const TRACKS_AT_ONCE: usize = 64;

/// A monitor told the same from every place of a computation that cannot say more.
pub(super) struct StageMonitor<'a> {
    pub monitor: &'a dyn Monitor,
    pub done: usize,
    pub total: usize,
}

impl Monitor for StageMonitor<'_> {
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
    for batch in tracks.chunks(TRACKS_AT_ONCE) {
        let here = StageMonitor { monitor, done: fixes.len(), total: tracks.len() };
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
    for batch in tracks.chunks(TRACKS_AT_ONCE) {
        let here = StageMonitor { monitor, done: fixes.len(), total: tracks.len() };
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
