//! The posterior sample by sample: the calibrated form of iterative evaluation matching.
//!
//! Every sample is first put to a gate that costs next to nothing: each candidate keeps the interval of biases that
//! its samples allow, with the map's own range over the candidate's cell, and is dropped when too many samples fall outside.
//! The posterior proper is taken by the batch kernel over the candidates that are left, whenever that is cheap or due, so
//! that a streamed fix and a batch fix on the same samples agree.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::model::{Channel, Noise, PosteriorOptions};
use super::patch::Patch;
use super::search::Problem;
use super::{decide, search};
use crate::error::{Error, Result, require_finite};
use crate::field::Field;
use crate::fix::{Fix, Status};
use crate::state;
use crate::track::Track;

/// Width of the gate in standard deviations of one sample.
const GATE: f64 = 5.0;
/// Share of the samples that may fall outside the gate, beside two.
const MISSES: f64 = 0.2;
/// Candidates times samples up to which the posterior is taken at every sample.
const CHEAP: usize = 2_000;
/// Fewest samples of a fix.
const FEWEST: usize = 3;
/// Name of the saved state.
const NAME: &str = "PosteriorMatcher";

/// What one sample did.
#[derive(Debug, Clone, PartialEq)]
pub struct PosteriorStep {
    /// Whether a fix may be declared, and why not.
    pub status: Status,
    /// Candidates left.
    pub n_feasible: usize,
    /// Extent of the candidates left, map units `[x, y]`.
    pub extent: [f64; 2],
    /// Risk of the newest answer, 1 before there is one.
    pub risk: f64,
    /// The answer, where the posterior was taken at this sample.
    pub fix: Option<Fix>,
}

/// The part that is saved: everything but the map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct State {
    options: PosteriorOptions,
    sigma: Option<f64>,
    max_samples: usize,
    x: Vec<f64>,
    y: Vec<f64>,
    values: Vec<f64>,
    seen: usize,
    step: [f64; 2],
    candidates: Vec<Candidate>,
    next: usize,
    status: Status,
    risk: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Candidate {
    offset: [f64; 2],
    /// Interval of the biases that the samples so far allow.
    bias: [f64; 2],
    misses: u32,
}

/// Streaming matcher with a declared risk; see the module.
///
/// Holds at most `max_samples` samples: when there are more, the oldest is let go, so that memory and time are bounded.
#[derive(Debug, Clone)]
pub struct PosteriorMatcher {
    field: Arc<dyn Field>,
    state: State,
    patch: Option<([f64; 4], Arc<Patch>)>,
}

impl PosteriorMatcher {
    /// A matcher that has seen nothing yet.
    ///
    /// # Errors
    /// As [`PosteriorOptions::validate`]; [`Error::TooManyCandidates`]; [`Error::Invalid`] for fewer than 3 `max_samples`.
    pub fn new(
        field: Arc<dyn Field>,
        sigma: Option<f64>,
        options: PosteriorOptions,
        max_samples: usize,
    ) -> Result<Self> {
        options.validate()?;
        if max_samples < FEWEST {
            return Err(Error::invalid("max_samples", format!("at least {FEWEST}"), max_samples));
        }
        let (offsets, step) = search::lattice(field.spacing(), &options)?;
        let candidates = offsets
            .into_iter()
            .map(|offset| Candidate { offset, bias: [f64::NEG_INFINITY, f64::INFINITY], misses: 0 })
            .collect();
        let state = State {
            options,
            sigma,
            max_samples,
            x: Vec::new(),
            y: Vec::new(),
            values: Vec::new(),
            seen: 0,
            step,
            candidates,
            next: FEWEST,
            status: Status::Searching,
            risk: 1.0,
        };
        Ok(Self { field, state, patch: None })
    }

    /// Takes one sample: indicated position in map units, measured value.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for a bad sample, which is not taken.
    pub fn update(&mut self, x: f64, y: f64, value: f64) -> Result<PosteriorStep> {
        require_finite("sample (x, y, value)", &[x, y, value])?;
        let s = &mut self.state;
        if s.x.len() == s.max_samples {
            s.x.remove(0);
            s.y.remove(0);
            s.values.remove(0);
        }
        s.x.push(x);
        s.y.push(y);
        s.values.push(value);
        s.seen += 1;
        self.gate(x, y, value)?;
        let s = &self.state;
        let n = s.x.len();
        if s.candidates.is_empty() {
            self.state.status = Status::Lost;
            self.state.risk = 1.0;
            return Ok(self.step(None));
        }
        let cheap = s.candidates.len() * n <= CHEAP;
        if n < FEWEST || !(cheap || s.seen >= s.next) {
            if self.state.status == Status::Fixed {
                self.state.status = Status::Searching;
            }
            return Ok(self.step(None));
        }
        self.state.next = s.seen + (n / 2).max(1);
        let (fix, kept) = self.solve(true)?;
        self.state.status = fix.status;
        self.state.risk = fix.risk.unwrap_or(1.0);
        if let Some(kept) = kept {
            self.prune(kept);
        }
        Ok(self.step(Some(fix)))
    }

    /// The answer on the samples held, whatever the schedule: that of the batch matcher over the candidates left.
    ///
    /// # Errors
    /// [`Error::TooFewSamples`] before the first sample.
    pub fn fix(&self) -> Result<Fix> {
        Ok(self.solve(false)?.0)
    }

    /// The answer, and the candidates that the first stage of its search would keep where it went that far: with
    /// `coarse`, the first lattice may settle that there is no fix yet.
    fn solve(&self, coarse: bool) -> Result<(Fix, Option<Vec<[f64; 2]>>)> {
        let s = &self.state;
        let track = self.track()?;
        if s.candidates.is_empty() {
            return Ok((Fix::none(Status::Lost, s.x.len()), None));
        }
        let channels = [Channel { field: &*self.field, values: track.values(), sigma: s.sigma }];
        let problem = Problem::on(&channels, &track, &s.options, self.patch.as_ref().map(|(_, patch)| patch))?;
        let offsets: Vec<[f64; 2]> = s.candidates.iter().map(|c| c.offset).collect();
        let (posterior, kept) = problem.solve_going_on(offsets, s.step, coarse);
        Ok((decide::answer(&problem, &track, &posterior), kept))
    }

    /// Forgets all samples.
    ///
    /// # Errors
    /// As [`PosteriorMatcher::new`].
    pub fn reset(&mut self) -> Result<()> {
        *self = Self::new(self.field.clone(), self.state.sigma, self.state.options.clone(), self.state.max_samples)?;
        Ok(())
    }

    /// Samples seen since the start, also those let go.
    pub fn n_samples(&self) -> usize {
        self.state.seen
    }

    /// Candidates left.
    pub fn n_feasible(&self) -> usize {
        self.state.candidates.len()
    }

    /// The options in force.
    pub fn options(&self) -> &PosteriorOptions {
        &self.state.options
    }

    /// The state as bytes, without the map.
    ///
    /// # Errors
    /// [`Error::State`].
    pub fn save(&self) -> Result<Vec<u8>> {
        state::save(NAME, &self.state)
    }

    /// A matcher on `field` that goes on where [`PosteriorMatcher::save`] left.
    ///
    /// # Errors
    /// [`Error::State`] for bytes that are not such a state.
    pub fn load(field: Arc<dyn Field>, bytes: &[u8]) -> Result<Self> {
        Ok(Self { field, state: state::load(NAME, bytes)?, patch: None })
    }

    fn track(&self) -> Result<Track> {
        Track::new(self.state.x.clone(), self.state.y.clone(), self.state.values.clone(), None)
    }

    fn step(&self, fix: Option<Fix>) -> PosteriorStep {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for c in &self.state.candidates {
            for d in 0..2 {
                low[d] = low[d].min(c.offset[d]);
                high[d] = high[d].max(c.offset[d]);
            }
        }
        let empty = self.state.candidates.is_empty();
        PosteriorStep {
            status: self.state.status,
            n_feasible: self.state.candidates.len(),
            extent: if empty { [f64::NAN; 2] } else { [high[0] - low[0], high[1] - low[1]] },
            risk: self.state.risk,
            fix,
        }
    }

    /// The window of the map that the samples held can touch, laid out anew only when the track has left it.
    fn window(&mut self) {
        let half = self.state.options.half_width;
        let mut needed = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        for (x, y) in self.state.x.iter().zip(&self.state.y) {
            let x = self.field.wrap_x(*x);
            needed[0] = needed[0].min(x - half[0]);
            needed[1] = needed[1].max(x + half[0]);
            needed[2] = needed[2].min(y - half[1]);
            needed[3] = needed[3].max(y + half[1]);
        }
        let inside = self
            .patch
            .as_ref()
            .is_some_and(|(b, _)| needed[0] >= b[0] && needed[1] <= b[1] && needed[2] >= b[2] && needed[3] <= b[3]);
        if !inside {
            // Room to go on for as long as the search is wide, and half the track again.
            let room = [half[0] + 0.25 * (needed[1] - needed[0]), half[1] + 0.25 * (needed[3] - needed[2])];
            let b = [needed[0] - room[0], needed[1] + room[0], needed[2] - room[1], needed[3] + room[1]];
            self.patch = Some((b, Arc::new(Patch::new(&*self.field, [b[0], b[2]], [b[1], b[3]]))));
        }
    }

    fn gate(&mut self, x: f64, y: f64, value: f64) -> Result<()> {
        let x = self.field.wrap_x(x);
        self.window();
        let channel = Channel { field: &*self.field, values: &self.state.values, sigma: self.state.sigma };
        let noise = Noise::new(&channel, &self.state.options)?;
        let Some((_, patch)) = &self.patch else { return Ok(()) };
        let worst = noise.levels.iter().map(|l| l.factor).fold(0.0, f64::max).powi(2);
        let value = value - patch.level;
        let step = self.state.step;
        let cell = patch.step();
        let (half_x, half_y) = (0.5 * step[0] / cell[0], 0.5 * step[1] / cell[1]);
        let scale_m = self.field.metres_per_unit(y);
        // What heading, scale and drift may have moved the oldest sample by, over the track so far.
        let away = crate::frame::displacement_m(self.field.geographic(), [self.state.x[0], self.state.y[0]], [x, y]);
        let o = &self.state.options;
        let lever = away[0].hypot(away[1]) * o.heading_sigma_deg.to_radians().hypot(o.scale_sigma);
        let moved = lever.hypot(o.drift_sigma_m).hypot(o.position_sigma_m);
        let (moved_x, moved_y) = (moved / (cell[0] * scale_m[0]), moved / (cell[1] * scale_m[1]));
        let bias_reach = match o.bias_sigma {
            None => f64::INFINITY,
            Some(s) => 4.0 * s,
        };
        let allowed = 2 + (MISSES * self.state.seen as f64) as u32;
        self.state.candidates.retain_mut(|c| {
            let [px, py] = patch.position(x + c.offset[0], y + c.offset[1]);
            let sample = patch.at(px, py);
            if !sample.value.is_finite() {
                // A hole is no evidence.
                return true;
            }
            let [gx, gy] = sample.gradient.map(f64::from);
            let own = noise.sensor_variance
                + worst * f64::from(sample.variance)
                + f64::from(sample.curvature).powi(2)
                + (gx * moved_x).powi(2)
                + (gy * moved_y).powi(2);
            let reach = GATE * own.sqrt() + half_x * gx.abs() + half_y * gy.abs();
            let residual = value - f64::from(sample.value);
            let low = c.bias[0].max(residual - reach);
            let high = c.bias[1].min(residual + reach);
            let fits = low <= high && low <= bias_reach && high >= -bias_reach;
            if fits {
                c.bias = [low, high];
            } else {
                c.misses += 1;
                // The interval may have been set by an outlier: what the newest sample allows is taken in its stead.
                if c.misses % 2 == 0 {
                    c.bias = [residual - reach, residual + reach];
                }
            }
            c.misses <= allowed
        });
        Ok(())
    }

    /// Drops the candidates that the posterior has ruled out; `kept` is in the order of the candidates.
    fn prune(&mut self, kept: Vec<[f64; 2]>) {
        let mut kept = kept.into_iter();
        let mut wanted = kept.next();
        self.state.candidates.retain(|c| {
            let found = wanted == Some(c.offset);
            if found {
                wanted = kept.next();
            }
            found
        });
    }
}
