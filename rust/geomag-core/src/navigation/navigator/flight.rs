//! A whole log at once.

use std::sync::Arc;

use super::options::{NavigatorMethod, NavigatorOptions};
use super::outcome::{Indicated, Inputs, NavigatorStep};
use super::particles::Particles;
use super::smooth::Record;
use super::state::Navigator;
use crate::error::{Error, Result, require_not_negative};
use crate::field::Field;
use crate::monitor::Monitor;

/// Steps between two words to the monitor.
const REPORT: usize = 1024;

/// The log of a flight: what the INS indicated and what was read, one entry a step.
#[derive(Debug, Clone, Copy)]
pub struct FlightInput<'a> {
    /// Seconds, not running backwards.
    pub time_s: &'a [f64],
    /// East or longitude, map units.
    pub x: &'a [f64],
    /// North or latitude, map units.
    pub y: &'a [f64],
    /// Velocity east and north, metres a second.
    pub velocity_m_s: Option<&'a [[f64; 2]]>,
    /// Degrees clockwise from north.
    pub heading_deg: Option<&'a [f64]>,
    /// Metres above the map's height datum.
    pub height_m: Option<&'a [f64]>,
    /// Measured values, NaN where there is none.
    pub readings: Option<&'a [f64]>,
    /// What the coefficients of the vehicle's own field are multiplied by, row by row: as many a step as the options have a covariance for.
    pub terms: Option<&'a [f64]>,
}

impl FlightInput<'_> {
    /// Steps in the log.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there is no step.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Checks that the columns fit each other.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::TooFewSamples`].
    pub fn check(&self) -> Result<()> {
        let n = self.len();
        let lengths = [
            ("x", Some(self.x.len())),
            ("y", Some(self.y.len())),
            ("velocity_m_s", self.velocity_m_s.map(<[_]>::len)),
            ("heading_deg", self.heading_deg.map(<[_]>::len)),
            ("height_m", self.height_m.map(<[_]>::len)),
            ("readings", self.readings.map(<[_]>::len)),
        ];
        for (name, len) in lengths {
            if let Some(len) = len.filter(|len| *len != n) {
                return Err(Error::shape(name, format!("{n} steps as time_s"), format!("{len}")));
            }
        }
        if n == 0 {
            return Err(Error::TooFewSamples { what: "flight".into(), needed: 1, got: 0 });
        }
        Ok(())
    }

    /// One step of it.
    pub fn at(&self, k: usize) -> Indicated {
        Indicated {
            time_s: self.time_s[k],
            x: self.x[k],
            y: self.y[k],
            velocity_m_s: self.velocity_m_s.map(|v| v[k]),
            heading_deg: self.heading_deg.map(|h| h[k]),
            height_m: self.height_m.map(|h| h[k]),
            value: self.readings.map(|r| r[k]),
        }
    }
}

/// What became of a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct NavigatedFlight {
    /// One a step.
    pub steps: Vec<NavigatorStep>,
    /// Which INS output there was.
    pub inputs: Inputs,
    /// The estimated errors at the end: see [`Navigator::mean`].
    pub state: Vec<f64>,
    /// Every step with what came after it, where that was asked for.
    pub smoothed: Option<Vec<SmoothedPlace>>,
}

/// How much of what came after a step is used for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Smoothing {
    /// None of it.
    No,
    /// What came until so many seconds after it.
    Lag(f64),
    /// The rest of the flight.
    Flight,
}

/// A place with what came after it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothedPlace {
    /// Corrected place, map units.
    pub x: f64,
    /// Corrected place, map units.
    pub y: f64,
    /// Covariance as it is to be believed, square metres, east-north.
    pub covariance_m2: [[f64; 2]; 2],
}

/// Navigates through a whole log.
///
/// # Errors
/// As [`Navigator::new`] and [`Navigator::step`], with the step named; [`Error::Shape`] for columns of different length;
/// [`Error::Interrupted`].
pub fn navigate(
    field: Arc<dyn Field>,
    input: &FlightInput<'_>,
    options: NavigatorOptions,
    smoothing: Smoothing,
    monitor: &dyn Monitor,
) -> Result<NavigatedFlight> {
    input.check()?;
    if let Smoothing::Lag(lag) = smoothing {
        require_not_negative("lag_s", lag)?;
    }
    let mut steps = Vec::with_capacity(input.len());
    let terms = options.terms();
    let given = input.terms.unwrap_or(&[]);
    if given.len() != terms * input.len() {
        let needed = format!("({}, {terms}) as time_s and terms_covariance", input.len());
        return Err(Error::shape("terms", needed, format!("{} numbers", given.len())));
    }
    if options.method == NavigatorMethod::Rbpf {
        if smoothing != Smoothing::No {
            return Err(Error::invalid("smooth", "None with method 'rbpf'", "a lag"));
        }
        let mut particles = Particles::new(field, options)?;
        for k in 0..input.len() {
            if k % REPORT == 0 {
                monitor.advance(k as u64, input.len() as u64)?;
            }
            steps.push(particles.step(&input.at(k)).map_err(|e| at_step(e, k))?);
        }
        return Ok(NavigatedFlight { steps, inputs: particles.inputs(), state: particles.mean(), smoothed: None });
    }
    let mut navigator = Navigator::new(field, options)?;
    navigator.record = (smoothing != Smoothing::No).then(Record::default);
    for k in 0..input.len() {
        if k % REPORT == 0 {
            monitor.advance(k as u64, input.len() as u64)?;
        }
        steps.push(
            navigator
                .step_interruptible(&input.at(k), &given[k * terms..(k + 1) * terms], monitor)
                .map_err(|e| at_step(e, k))?,
        );
    }
    let smoothed = navigator.record.as_ref().map(|record| {
        let horizon = |k: usize| match smoothing {
            Smoothing::Lag(lag) => input.time_s.partition_point(|t| *t <= input.time_s[k] + lag) - 1,
            Smoothing::No | Smoothing::Flight => usize::MAX,
        };
        let places = record.smooth(horizon).into_iter().enumerate().map(|(k, s)| {
            let [x, y] = navigator.corrected(navigator.field().wrap_x(input.x[k]), input.y[k], s.mean);
            // What the innovations said of the covariance then holds of what came after, too.
            let factor = steps[k].covariance_m2[0][0] / steps[k].covariance_filter_m2[0][0].max(f64::MIN_POSITIVE);
            SmoothedPlace { x, y, covariance_m2: s.covariance.map(|row| row.map(|c| c * factor.max(1.0))) }
        });
        places.collect()
    });
    let state = navigator.mean().to_vec();
    Ok(NavigatedFlight { steps, inputs: navigator.inputs(), state, smoothed })
}

/// Names the step in an error.
fn at_step(error: Error, step: usize) -> Error {
    match error {
        Error::Invalid { what, needed, got } => Error::Invalid { what: format!("step {step}: {what}"), needed, got },
        Error::NotFinite { what, got, .. } => Error::NotFinite { what, index: step, got },
        other => other,
    }
}
