//! A whole log at once.

use std::sync::Arc;

use super::Navigator;
use super::options::NavigatorOptions;
use super::outcome::{Indicated, Inputs, NavigatorStep};
use crate::error::{Error, Result};
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
    /// Measured values, NaN where there is none.
    pub readings: Option<&'a [f64]>,
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

    fn check(&self) -> Result<()> {
        let n = self.len();
        let lengths = [
            ("x", Some(self.x.len())),
            ("y", Some(self.y.len())),
            ("velocity_m_s", self.velocity_m_s.map(<[_]>::len)),
            ("heading_deg", self.heading_deg.map(<[_]>::len)),
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

    fn at(&self, k: usize) -> Indicated {
        Indicated {
            time_s: self.time_s[k],
            x: self.x[k],
            y: self.y[k],
            velocity_m_s: self.velocity_m_s.map(|v| v[k]),
            heading_deg: self.heading_deg.map(|h| h[k]),
            value: self.readings.map(|r| r[k]),
        }
    }
}

/// What became of a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    /// One a step.
    pub steps: Vec<NavigatorStep>,
    /// Which INS output there was.
    pub inputs: Inputs,
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
    monitor: &dyn Monitor,
) -> Result<Flight> {
    input.check()?;
    let mut navigator = Navigator::new(field, options)?;
    let mut steps = Vec::with_capacity(input.len());
    for k in 0..input.len() {
        if k % REPORT == 0 {
            monitor.advance(k as u64, input.len() as u64)?;
        }
        steps.push(navigator.step(&input.at(k)).map_err(|e| at_step(e, k))?);
    }
    Ok(Flight { steps, inputs: navigator.inputs() })
}

/// Names the step in an error.
fn at_step(error: Error, step: usize) -> Error {
    match error {
        Error::Invalid { what, needed, got } => Error::Invalid { what: format!("step {step}: {what}"), needed, got },
        Error::NotFinite { what, got, .. } => Error::NotFinite { what, index: step, got },
        other => other,
    }
}
