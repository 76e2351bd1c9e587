//! One trait for matchers that are fed sample by sample, and one function that feeds them.

use crate::error::Result;
use crate::fix::{Fix, Status};
use crate::monitor::Monitor;
use crate::track::Track;

/// What one sample did to a stream.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Whether a fix may be declared, and why not.
    pub status: Status,
    /// The answer, where it was looked for at this sample.
    pub fix: Option<Fix>,
}

impl Step {
    /// Whether the search is over: it has its fix, or none of its candidates is left.
    pub fn over(&self) -> bool {
        matches!(self.status, Status::Fixed | Status::Lost)
    }
}

/// One sample of a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Indicated position, map units.
    pub place: [f64; 2],
    /// Measured value.
    pub value: f64,
    /// Height above the map's height datum, metres, where it is known.
    pub height_m: Option<f64>,
}

impl Sample {
    /// Sample `k` of a track.
    pub fn of(track: &Track, k: usize) -> Self {
        Self { place: track.point(k), value: track.values()[k], height_m: track.height_m().map(|h| h[k]) }
    }
}

/// A matcher that takes samples one by one in bounded memory.
///
/// An update is all or nothing: one that is refused leaves the stream as it was. What its saved state holds goes on, bit for bit,
/// where it left off.
pub trait Stream: Clone + Send {
    /// Takes one sample. `monitor` may stop it; the sample is then not taken.
    ///
    /// # Errors
    /// Those of the sample, or [`Error::Interrupted`](crate::error::Error::Interrupted).
    fn take(&mut self, sample: &Sample, monitor: &dyn Monitor) -> Result<Step>;

    /// The answer on the samples held, whatever its status.
    ///
    /// # Errors
    /// [`Error::TooFewSamples`](crate::error::Error::TooFewSamples) before the first sample.
    fn answer(&self) -> Result<Fix>;

    /// Begins again: no sample seen.
    ///
    /// # Errors
    /// As its constructor.
    fn begin_again(&mut self) -> Result<()>;

    /// Samples seen since the start, also those let go.
    fn seen(&self) -> usize;

    /// Samples that it holds at most; `None` where it holds none of them.
    fn holds(&self) -> Option<usize>;

    /// The state as bytes, without the map.
    ///
    /// # Errors
    /// [`Error::State`](crate::error::Error::State).
    fn saved(&self) -> Result<Vec<u8>>;
}

/// Feeds a track to a stream until its first fix, or its end; with `until_lost` also until it is lost. The answer then.
///
/// # Errors
/// As [`Stream::take`]. Once stopped, the samples taken so far are kept.
pub fn feed<S: Stream>(stream: &mut S, track: &Track, until_lost: bool, monitor: &dyn Monitor) -> Result<Fix> {
    for k in 0..track.len() {
        monitor.advance(k as u64, track.len() as u64)?;
        let step = stream.take(&Sample::of(track, k), monitor)?;
        if step.status == Status::Fixed || (until_lost && step.over()) {
            return step.fix.map_or_else(|| stream.answer(), Ok);
        }
    }
    stream.answer()
}
