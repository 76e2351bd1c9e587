//! What a fix along a planned track will be worth, before it is flown.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::batch::{StageMonitor, TRACKS_AT_ONCE, match_interruptible};
use super::options::PosteriorOptions;
use super::problem::Problem;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::matching::scene::Channel;
use crate::monitor::{Monitor, Quiet};
use crate::stack::served;
use crate::track::Track;

/// What is to be expected of a fix at the end of a planned track.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Cramer-Rao bound of the newest position: white normal errors of the stated size, bias and the other nuisance
    /// parameters unknown; square metres, east-north.
    pub bound_m2: [[f64; 2]; 2],
    /// Expected covariance of the fix, square metres, east-north: the mean of those that the simulated flights were fixed with; where none was (or none
    /// was flown), the bound with tails, correlation and registration.
    pub covariance_m2: [[f64; 2]; 2],
    /// Number of samples after which twice the expected standard deviation is within the tolerance; `None` if never.
    pub samples_to_fix: Option<usize>,
    /// Share of simulated flights that were fixed, and of those the share that was wrong; NaN without flights.
    pub fix_probability: f64,
    /// See `fix_probability`.
    pub wrong_share: f64,
    /// Simulated flights.
    pub flights: usize,
}

/// Predicts the fix of a planned track (true positions; its values are not used).
///
/// The bound is the inverse of sum g g^T / s^2 with the nuisance parameters taken out (Van Trees, Detection, Estimation and Modulation Theory
/// I, 1968, section 2.4); `flights` simulated tracks, with starts anywhere in the search and errors of the stated size and correlation,
/// go through the matcher itself for the probability of a fix, which no local bound can tell.
///
/// # Errors
/// As [`match_posterior`](super::match_posterior); [`Error::Invalid`] where the map knows nothing along the track.
pub fn predict(
    field: &dyn Field,
    track: &Track,
    sigma: Option<f64>,
    options: &PosteriorOptions,
    flights: usize,
    seed: u64,
) -> Result<Prediction> {
    predict_interruptible(field, track, sigma, options, flights, seed, &Quiet)
}

/// Map value at the place and height of a sample.
fn at(field: &dyn Field, track: &Track, k: usize) -> f64 {
    let [x, y] = track.point(k);
    track.height_m().map_or_else(|| field.value(x, y), |h| field.value_at(x, y, h[k]))
}

fn predict_interruptible(
    field: &dyn Field,
    track: &Track,
    sigma: Option<f64>,
    options: &PosteriorOptions,
    flights: usize,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Prediction> {
    let served = served(field, track)?;
    let field = served.field();
    let values: Vec<f64> = (0..track.len()).map(|k| at(field, track, k)).collect();
    let known = values.iter().filter(|v| v.is_finite()).count();
    if known == 0 {
        return Err(Error::invalid("planned track", "a track on the map", "no sample on a known cell"));
    }
    let filled: Vec<f64> = values.iter().map(|v| if v.is_finite() { *v } else { field.mean() }).collect();
    let planned = Track::new(track.x().to_vec(), track.y().to_vec(), filled, track.time_s().map(<[f64]>::to_vec))?
        .with_height(track.height_m().map(<[f64]>::to_vec))?;
    let channel = Channel { field, values: planned.values(), sigma };
    let problem = Problem::new(&[channel], &planned, options)?;
    let expected = problem.expected();
    let mut samples_to_fix = None;
    for n in 3..=track.len() {
        let part = planned.slice(0..n)?;
        let channel = Channel { field, values: part.values(), sigma };
        let [[a, _], [_, b]] = Problem::new(&[channel], &part, options)?.expected().covariance;
        if 2.0 * (a + b).sqrt() <= problem.tolerance_m {
            samples_to_fix = Some(n);
            break;
        }
    }
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (mut fixed, mut wrong, mut sum) = (0_usize, 0_usize, [[0.0; 2]; 2]);
    for _ in 0..flights {
        monitor.advance(0, 0)?;
        let offset =
            [rng.random_range(-1.0..1.0) * options.half_width[0], rng.random_range(-1.0..1.0) * options.half_width[1]];
        // A track fares better or worse than the map's sigma as a whole.
        let level = (expected.spread * rng.sample::<f64, _>(StandardNormal)).exp();
        let mut previous: f64 = rng.sample(StandardNormal);
        let noisy: Vec<f64> = (0..planned.len())
            .map(|k| {
                let fresh: f64 = rng.sample(StandardNormal);
                previous = expected.coefficient * previous
                    + (1.0 - expected.coefficient * expected.coefficient).sqrt() * fresh;
                let sensor: f64 = rng.sample(StandardNormal);
                planned.values()[k] + level * expected.map_sigma[k] * previous + expected.sensor_sigma * sensor
            })
            .collect();
        let x = planned.x().iter().map(|x| x - offset[0]).collect();
        let y = planned.y().iter().map(|y| y - offset[1]).collect();
        let flown = Track::new(x, y, noisy, planned.time_s().map(<[f64]>::to_vec))?
            .with_height(planned.height_m().map(<[f64]>::to_vec))?;
        let channel = Channel { field, values: flown.values(), sigma };
        let fix = match_interruptible(&[channel], &flown, options, monitor)?;
        if fix.ok() {
            fixed += 1;
            let [east, north] = field.displacement_m(planned.newest(), [fix.x, fix.y]);
            wrong += usize::from(east.hypot(north) > problem.tolerance_m);
            for (total, v) in sum.iter_mut().flatten().zip(fix.covariance_m2.iter().flatten().flatten()) {
                *total += v;
            }
        }
    }
    Ok(Prediction {
        bound_m2: expected.bound,
        covariance_m2: if fixed > 0 { sum.map(|row| row.map(|v| v / fixed as f64)) } else { expected.covariance },
        samples_to_fix,
        fix_probability: if flights > 0 { fixed as f64 / flights as f64 } else { f64::NAN },
        wrong_share: if fixed > 0 { wrong as f64 / fixed as f64 } else { f64::NAN },
        flights,
    })
}

/// [`predict`] for many planned tracks, in parallel; `None` for those that the map knows nothing of.
///
/// # Errors
/// The first error other than an unknown track, or [`Error::Interrupted`].
pub fn predict_many(
    field: &dyn Field,
    tracks: &[Track],
    sigma: Option<f64>,
    options: &PosteriorOptions,
    flights: usize,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Vec<Option<Prediction>>> {
    let mut out = Vec::with_capacity(tracks.len());
    for batch in tracks.chunks(TRACKS_AT_ONCE) {
        let here = StageMonitor { monitor, done: out.len(), total: tracks.len() };
        let first = out.len() as u64;
        let some: Result<Vec<_>> = batch
            .par_iter()
            .enumerate()
            .map(|(i, track)| {
                let known = (0..track.len()).filter(|&k| at(field, track, k).is_finite()).count();
                if (known as f64) < options.min_overlap * track.len() as f64 {
                    return Ok(None);
                }
                // Every track its own seed, so that the answer does not depend on the number of threads.
                let seed = seed.wrapping_add(first + i as u64);
                predict_interruptible(field, track, sigma, options, flights, seed, &here).map(Some)
            })
            .collect();
        out.extend(some?);
    }
    Ok(out)
}
