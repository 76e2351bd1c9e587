//! The newest readings, kept for the matcher beside the filter, and when it was asked.

use serde::{Deserialize, Serialize};

use super::plan::MOST;

/// One sample of the window.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct TimedSample {
    pub time_s: f64,
    pub x: f64,
    pub y: f64,
    pub height_m: Option<f64>,
    pub value: f64,
}

/// The newest readings, and when the matcher was asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Watch {
    pub samples: Vec<TimedSample>,
    /// Way since the newest of them, metres.
    pub since_m: f64,
    pub tried_s: Option<f64>,
    pub looked_s: Option<f64>,
    pub contradictions: u32,
}

impl Watch {
    pub fn new() -> Self {
        Self { samples: Vec::new(), since_m: f64::INFINITY, tried_s: None, looked_s: None, contradictions: 0 }
    }

    pub fn is_whole(&self) -> bool {
        self.samples.len() <= MOST
            && !self.since_m.is_nan()
            && self.samples.iter().all(|s| {
                [s.time_s, s.x, s.y, s.value].iter().all(|v| v.is_finite()) && s.height_m.is_none_or(f64::is_finite)
            })
            && self.samples.windows(2).all(|w| w[0].time_s <= w[1].time_s)
    }

    /// Keeps a reading if it is far enough from the one before.
    pub fn keep(&mut self, sample: TimedSample, spacing_m: f64, most: usize) {
        if self.since_m < spacing_m {
            return;
        }
        if self.samples.len() >= most {
            self.samples.remove(0);
        }
        self.samples.push(sample);
        self.since_m = 0.0;
    }
}
