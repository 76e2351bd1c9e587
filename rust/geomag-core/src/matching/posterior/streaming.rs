//! The posterior sample by sample: the calibrated form of iterative evaluation matching.
//!
//! Every sample is first put to a gate that costs next to nothing: each candidate keeps the interval of biases that
//! its samples allow, with the map's own range over the candidate's cell, and is dropped when too many samples fall outside.
//! The posterior proper is taken by the batch kernel over the candidates that are left, whenever that is cheap or due, so
//! that a streamed fix and a batch fix on the same samples agree.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::decide;
use super::model::{Channel, Noise, PosteriorOptions, wants_curves};
use super::nuisance::reach_m;
use super::patch::Patch;
use super::problem::Problem;
use super::search::Lattice;
use crate::bounds::{require_place, require_places};
use crate::error::{Error, Result, require_finite, require_not_negative};
use crate::field::Field;
use crate::fix::{Fix, Status};
use crate::matching::stream::{Sample, Step, Stream};
use crate::monitor::Monitor;
use crate::stack::{Storey, check_heights, extent};
use crate::state::{self, Saved};
use crate::track::Track;

/// Width of the gate in standard deviations of one sample.
const GATE: f64 = 5.0;
/// Samples that may fall outside the gate, and the share of all that may beside them: with one outlier in twenty, one track
/// in a hundred thousand has more.
const FIRST_MISSES: u32 = 3;
const MISSES: f64 = 0.2;
/// Candidates times samples up to which the posterior is taken at every sample.
const CHEAP: usize = 800;
/// Fewest samples of a fix.
const FEWEST: usize = 3;
/// Standard deviations of heading, scale and drift by which the offset may have moved between samples.
const MOVED: f64 = 4.0;
/// What the field may do between the nodes of the map, in units of its second difference there.
const BETWEEN: f64 = 0.375;
/// Part of the window after which the gate is laid out anew, so that it forgets what the window has let go.
const RENEWED: usize = 4;
/// Movement in lattice steps that is left to the margins of a search.
const SETTLED: f64 = 0.1;
/// Name of the saved state.
const NAME: &str = "PosteriorMatcher";
/// Nodes of the field that are laid out for a saved state, which may ask for anything.
const MOST_LAID_OUT: u64 = 1 << 24;

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
    /// One a sample, or none.
    heights_m: Vec<f64>,
    seen: usize,
    /// Samples let go since the gate was last laid out.
    let_go: usize,
    lattice: Lattice,
    candidates: Vec<Candidate>,
    /// By how much the offset may have moved since the candidates were last spread, metres.
    moved_m: f64,
    next: usize,
    status: Status,
    risk: f64,
    /// The box of the map that is laid out, x from and to, y from and to: what is linear depends on it.
    window: Option<[f64; 4]>,
}

impl Saved for State {
    const NAME: &'static str = NAME;

    fn check(&self) -> Result<()> {
        self.options.validate()?;
        let n = self.x.len();
        if [self.y.len(), self.values.len()] != [n, n] {
            let got = format!("{} and {}", self.y.len(), self.values.len());
            return Err(Error::shape("samples: y and values", format!("({n},) as x"), got));
        }
        require_places("samples", false, &self.x, &self.y)?;
        require_finite("values", &self.values)?;
        if self.max_samples < FEWEST || n > self.max_samples || n > self.seen {
            let got = format!("{n} held, {} seen, {} at most", self.seen, self.max_samples);
            return Err(Error::invalid("samples", "no more held than seen and than may be held", got));
        }
        require_not_negative("movement", self.moved_m)?;
        if self.let_go > self.max_samples {
            return Err(Error::invalid("samples let go", format!("at most {}", self.max_samples), self.let_go));
        }
        if !(0.0..=1.0).contains(&self.risk) {
            return Err(Error::invalid("risk", "a probability", self.risk));
        }
        if let Some([west, east, south, north]) = self.window {
            require_finite("window", &[west, east, south, north])?;
            if !(west <= east && south <= north) {
                return Err(Error::invalid("window", "from less to more", format!("{:?}", self.window)));
            }
        }
        Ok(())
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Candidate {
    offset: [f64; 2],
    /// Interval of the biases that most of the samples so far allow, and how many these are.
    bias: [f64; 2],
    support: u32,
    /// The same of some of the others: it takes the place of the first when it has more, so that an outlier does not
    /// decide which samples fit.
    rival: [f64; 2],
    rival_support: u32,
    /// Samples outside the first interval.
    misses: u32,
}

impl Candidate {
    fn new(offset: [f64; 2]) -> Self {
        let all = [f64::NEG_INFINITY, f64::INFINITY];
        Self { offset, bias: all, support: 0, rival: all, rival_support: 0, misses: 0 }
    }

    /// Takes one more sample, which allows the biases in `own`; none beyond `most` either way is possible.
    fn take(&mut self, own: [f64; 2], most: f64) {
        let both = |a: [f64; 2]| {
            let [low, high] = [a[0].max(own[0]), a[1].min(own[1])];
            (low <= high && low <= most && high >= -most).then_some([low, high])
        };
        if let Some(bias) = both(self.bias) {
            self.bias = bias;
            self.support += 1;
            return;
        }
        self.misses += 1;
        if let Some(rival) = both(self.rival) {
            self.rival = rival;
            self.rival_support += 1;
        } else {
            self.rival = own;
            self.rival_support = u32::from(own[0] <= most && own[1] >= -most);
        }
        if self.rival_support > self.support {
            self.misses = self.misses + self.support - self.rival_support;
            std::mem::swap(&mut self.bias, &mut self.rival);
            std::mem::swap(&mut self.support, &mut self.rival_support);
        }
    }

    /// Takes in what another candidate allows, from which the truth may have come.
    fn join(&mut self, other: &Self) {
        let bias = [self.bias[0].min(other.bias[0]), self.bias[1].max(other.bias[1])];
        if other.misses < self.misses {
            *self = Self { offset: self.offset, ..*other };
        }
        self.bias = bias;
    }
}

/// Streaming matcher with a declared risk; see the module.
///
/// Holds at most `max_samples` samples: when there are more, the oldest is let go, so that memory and time are bounded.
#[derive(Debug, Clone)]
pub struct PosteriorMatcher {
    field: Arc<dyn Field>,
    state: State,
    /// The map over the state's window.
    patch: Option<Arc<Patch>>,
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
        let lattice = Lattice::new(field.spacing(), &options)?;
        let candidates = lattice.offsets().into_iter().map(Candidate::new).collect();
        let state = State {
            options,
            sigma,
            max_samples,
            x: Vec::new(),
            y: Vec::new(),
            values: Vec::new(),
            heights_m: Vec::new(),
            seen: 0,
            let_go: 0,
            lattice,
            candidates,
            moved_m: 0.0,
            next: FEWEST,
            status: Status::Searching,
            risk: 1.0,
            window: None,
        };
        Ok(Self { field, state, patch: None })
    }

    /// Takes one sample: indicated position in map units, measured value.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Invalid`] for a bad sample, [`Error::TooManyCandidates`] for one that would need too large a
    /// window of the field. It is then not taken: the matcher is as before.
    pub fn update(&mut self, x: f64, y: f64, value: f64) -> Result<PosteriorStep> {
        self.update_at(x, y, value, None)
    }

    /// [`PosteriorMatcher::update`] with the height of the sample, metres above the map's height datum: needed on a stack of
    /// levels, and by none or all of the samples.
    ///
    /// # Errors
    /// [`Error::NotFinite`], or [`Error::Invalid`] for a height that the map does not serve, for a bad sample, which is not taken.
    pub fn update_at(&mut self, x: f64, y: f64, value: f64, height_m: Option<f64>) -> Result<PosteriorStep> {
        require_finite("sample (x, y, value)", &[x, y, value])?;
        require_place("sample", self.field.geographic(), [x, y])?;
        let sample = Track::new(vec![x], vec![y], vec![value], None)?.with_height(height_m.map(|h| vec![h]))?;
        check_heights(&*self.field, &sample)?;
        if let Some(height) = height_m
            && self.field.between(height, height)?.is_some()
        {
            let needed = "a stack of levels, for what is laid out of this field is at its own level";
            return Err(Error::invalid("map", needed, format!("a sample at {height} m")));
        }
        // All or nothing: a sample that is refused on the way leaves the matcher as it was.
        let mut next = self.clone();
        let step = next.take_sample(x, y, value, height_m)?;
        *self = next;
        Ok(step)
    }

    fn take_sample(&mut self, x: f64, y: f64, value: f64, height_m: Option<f64>) -> Result<PosteriorStep> {
        let s = &mut self.state;
        if !s.x.is_empty() && s.heights_m.is_empty() == height_m.is_some() {
            let needed =
                if height_m.is_some() { "none, as the samples before" } else { "a height, as the samples before" };
            return Err(Error::invalid("height_m of a sample", needed, format!("{height_m:?}")));
        }
        let full = s.x.len() == s.max_samples;
        if full {
            s.x.remove(0);
            s.y.remove(0);
            s.values.remove(0);
            if !s.heights_m.is_empty() {
                s.heights_m.remove(0);
            }
        }
        s.x.push(x);
        s.y.push(y);
        s.values.push(value);
        s.heights_m.extend(height_m);
        s.seen += 1;
        self.moved();
        self.spread(0.5);
        let s = &mut self.state;
        s.let_go += usize::from(full);
        if s.let_go * RENEWED >= s.max_samples {
            self.renew_gate()?;
        } else {
            self.gate(x, y, value, height_m)?;
        }
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
        self.state.next = s.seen + (n / 4).max(1);
        self.spread(SETTLED);
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
        let problem = Problem::on(&channels, &track, &s.options, self.patch.as_ref())?;
        let offsets: Vec<[f64; 2]> = s.candidates.iter().map(|c| c.offset).collect();
        let (posterior, kept) = problem.solve_going_on(offsets, s.lattice.step, coarse);
        let mut fix = decide::answer(&problem, &track, &posterior, &s.lattice);
        fix.heights_m = self.field.as_stack().and(track.height_m()).and_then(extent);
        Ok((fix, kept))
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
        state::save(&self.state)
    }

    /// A matcher on `field` that goes on where [`PosteriorMatcher::save`] left.
    ///
    /// # Errors
    /// [`Error::State`] for bytes that are not such a state, or one that this map and these options cannot have; those of
    /// [`PosteriorMatcher::new`].
    pub fn load(field: Arc<dyn Field>, bytes: &[u8]) -> Result<Self> {
        let saved: State = state::load(bytes)?;
        let refuse = |detail: &str| Err(Error::State { what: NAME.into(), detail: detail.into() });
        let lattice = Lattice::new(field.spacing(), &saved.options)?;
        if saved.lattice != lattice {
            return refuse("its lattice is not that of this map");
        }
        let on_lattice = |c: &Candidate| {
            let node = lattice.node(c.offset);
            (0..2).all(|d| node[d].abs() <= lattice.most[d]) && lattice.offset(node) == c.offset
        };
        if !saved.candidates.iter().all(on_lattice) {
            return refuse("a candidate lies outside the lattice of this map");
        }
        let mut matcher = Self { field, state: saved, patch: None };
        let (n, heights) = (matcher.state.x.len(), &matcher.state.heights_m);
        let served = matcher
            .field
            .as_stack()
            .map_or(heights.is_empty() || matcher.field.as_grid().is_none_or(|g| g.height().is_some()), |s| {
                heights.len() == n && s.storeys(heights).is_ok()
            });
        if !(served && (heights.is_empty() || heights.len() == n) && require_finite("heights", heights).is_ok()) {
            return refuse("its heights are not those of this map");
        }
        matcher.lay_out(matcher.state.options.max_candidates.min(MOST_LAID_OUT))?;
        Ok(matcher)
    }

    /// Lays out the map over the state's window.
    fn lay_out(&mut self, most: u64) -> Result<()> {
        let Some(b) = self.state.window else { return Ok(()) };
        let o = &self.state.options;
        let curved = wants_curves(&*self.field, o);
        let patch = Patch::new(&*self.field, [b[0], b[2]], [b[1], b[3]], most, curved)?;
        self.patch = Some(Arc::new(patch));
        Ok(())
    }

    fn track(&self) -> Result<Track> {
        let s = &self.state;
        let heights = (!s.heights_m.is_empty()).then(|| s.heights_m.clone());
        Track::new(s.x.clone(), s.y.clone(), s.values.clone(), None)?.with_height(heights)
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
    fn window(&mut self) -> Result<()> {
        let s = &self.state;
        let half = s.options.half_width;
        let (Some(&newest_x), Some(&newest_y)) = (s.x.last(), s.y.last()) else { return Ok(()) };
        let newest = [newest_x, newest_y];
        let from_newest = |(x, y): (&f64, &f64)| {
            let [east, north] = self.field.displacement_m(newest, [*x, *y]);
            east.hypot(north)
        };
        let lever_m = s.x.iter().zip(&s.y).map(from_newest).fold(0.0, f64::max);
        let reach_m = reach_m(&s.options, lever_m);
        let scale_m = self.field.metres_per_unit(newest_y);
        let reach = [half[0] + reach_m / scale_m[0], half[1] + reach_m / scale_m[1]];
        let mut needed = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        for (x, y) in s.x.iter().zip(&s.y) {
            let x = self.field.wrap_x(*x);
            needed[0] = needed[0].min(x - reach[0]);
            needed[1] = needed[1].max(x + reach[0]);
            needed[2] = needed[2].min(y - reach[1]);
            needed[3] = needed[3].max(y + reach[1]);
        }
        let inside =
            s.window.is_some_and(|b| needed[0] >= b[0] && needed[1] <= b[1] && needed[2] >= b[2] && needed[3] <= b[3]);
        if !inside {
            // Room to go on for as long as the search is wide, and half the track again.
            let room = [half[0] + 0.25 * (needed[1] - needed[0]), half[1] + 0.25 * (needed[3] - needed[2])];
            self.state.window =
                Some([needed[0] - room[0], needed[1] + room[0], needed[2] - room[1], needed[3] + room[1]]);
            self.lay_out(self.state.options.max_candidates)?;
        }
        Ok(())
    }

    /// Puts the samples held to the gate anew, so that it forgets those that were let go: where a bias drifts, the interval that
    /// an old sample allows is not that of today.
    fn renew_gate(&mut self) -> Result<()> {
        self.state.let_go = 0;
        for c in &mut self.state.candidates {
            *c = Candidate::new(c.offset);
        }
        for k in 0..self.state.x.len() {
            let s = &self.state;
            let (x, y, value, height_m) = (s.x[k], s.y[k], s.values[k], s.heights_m.get(k).copied());
            self.gate(x, y, value, height_m)?;
        }
        Ok(())
    }

    fn gate(&mut self, x: f64, y: f64, value: f64, height_m: Option<f64>) -> Result<()> {
        let storey =
            self.field.as_stack().zip(height_m).and_then(|(stack, h)| stack.storey(h)).unwrap_or(Storey::GROUND);
        let x = self.field.wrap_x(x);
        self.window()?;
        let channel = Channel { field: &*self.field, values: &self.state.values, sigma: self.state.sigma };
        let noise = Noise::new(&channel, &self.state.options)?;
        let Some(patch) = &self.patch else { return Ok(()) };
        let worst = noise.levels.iter().map(|l| l.factor).fold(0.0, f64::max).powi(2);
        let value = value - patch.level;
        let step = self.state.lattice.step;
        let cell = patch.step();
        let (half_x, half_y) = (0.5 * step[0] / cell[0], 0.5 * step[1] / cell[1]);
        let scale_m = self.field.metres_per_unit(y);
        let o = &self.state.options;
        let jitter = o.position_sigma_m.powi(2);
        let (per_x, per_y) = (1.0 / (cell[0] * scale_m[0]), 1.0 / (cell[1] * scale_m[1]));
        let (half_x, half_y) = (half_x + self.state.moved_m * per_x, half_y + self.state.moved_m * per_y);
        let between = if noise.levels.iter().any(|l| l.between > 0.0) { BETWEEN } else { 0.0 };
        // What a bias may step and walk by, and what a height may change: over it the map changes about as much as along it.
        let untold = GATE * o.leg_bias_sigma.hypot(o.bias_walk);
        let lift_cells = 3.0 * o.height_sigma_m * per_x.max(per_y);
        let bias_reach = match o.bias_sigma {
            None => f64::INFINITY,
            Some(s) => 4.0 * s,
        };
        let allowed = FIRST_MISSES + (MISSES * (self.state.x.len() + self.state.let_go) as f64) as u32;
        self.state.candidates.retain_mut(|c| {
            let [px, py] = patch.position(x + c.offset[0], y + c.offset[1]);
            let sample = patch.at(px, py, storey);
            if !sample.value.is_finite() {
                // A hole is no evidence.
                return true;
            }
            let [gx, gy] = sample.gradient.map(f64::from);
            let own = noise.sensor_variance
                + worst * f64::from(sample.variance)
                + jitter * ((gx * per_x).powi(2) + (gy * per_y).powi(2));
            let reach = GATE * own.sqrt()
                + half_x * gx.abs()
                + half_y * gy.abs()
                + (between + half_x.max(half_y).min(1.0)) * f64::from(sample.bend)
                + untold
                + lift_cells * (gx.hypot(gy) + f64::from(sample.bend));
            let residual = value - f64::from(sample.value);
            c.take([residual - reach, residual + reach], bias_reach);
            c.misses <= allowed
        });
        Ok(())
    }

    /// Counts by how much heading, scale and drift may have moved the offset since the sample before.
    fn moved(&mut self) {
        let s = &mut self.state;
        let n = s.x.len();
        if n < 2 {
            return;
        }
        let o = &s.options;
        let [east, north] = self.field.displacement_m([s.x[n - 2], s.y[n - 2]], [s.x[n - 1], s.y[n - 1]]);
        let turned = east.hypot(north) * o.heading_sigma_deg.to_radians().hypot(o.scale_sigma);
        // The drift is that over the samples held, however many these are.
        s.moved_m += MOVED * turned.hypot(o.drift_sigma_m / (n - 1) as f64);
    }

    /// Spreads the candidates to those that the offset may have moved to, once that is more than `share` of a lattice step.
    fn spread(&mut self, share: f64) {
        let s = &mut self.state;
        let (Some(&y), Some(first)) = (s.y.last(), s.candidates.first()) else { return };
        let scale_m = self.field.metres_per_unit(y);
        let steps = [0, 1].map(|d| s.moved_m / (s.lattice.step[d] * scale_m[d]));
        if steps[0].max(steps[1]) <= share {
            return;
        }
        s.moved_m = 0.0;
        let most = s.lattice.most;
        let node = |c: &Candidate| s.lattice.node(c.offset);
        let (mut low, mut high) = (node(first), node(first));
        for at in s.candidates.iter().map(node) {
            for d in 0..2 {
                low[d] = low[d].min(at[d]);
                high[d] = high[d].max(at[d]);
            }
        }
        let rings = [0, 1].map(|d| (steps[d].ceil() as i64).min(2 * most[d]));
        for d in 0..2 {
            low[d] = (low[d] - rings[d]).max(-most[d]);
            high[d] = (high[d] + rings[d]).min(most[d]);
        }
        let columns = (high[0] - low[0] + 1) as usize;
        let rows = (high[1] - low[1] + 1) as usize;
        // A box is a row of columns: one axis after the other costs the sum of its sides, not their product.
        for d in 0..2 {
            let mut wider: Vec<Option<Candidate>> = vec![None; columns * rows];
            for c in &s.candidates {
                let at = s.lattice.node(c.offset);
                for k in (at[d] - rings[d]).max(low[d])..=(at[d] + rings[d]).min(high[d]) {
                    let to = if d == 0 { [k, at[1]] } else { [at[0], k] };
                    let place = &mut wider[(to[1] - low[1]) as usize * columns + (to[0] - low[0]) as usize];
                    place.get_or_insert(Candidate { offset: s.lattice.offset(to), ..*c }).join(c);
                }
            }
            s.candidates = wider.into_iter().flatten().collect();
        }
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

impl Stream for PosteriorMatcher {
    fn take(&mut self, sample: &Sample, _: &dyn Monitor) -> Result<Step> {
        let Sample { place: [x, y], value, height_m } = *sample;
        let step = self.update_at(x, y, value, height_m)?;
        Ok(Step { status: step.status, fix: step.fix })
    }

    fn answer(&self) -> Result<Fix> {
        self.fix()
    }

    fn begin_again(&mut self) -> Result<()> {
        self.reset()
    }

    fn seen(&self) -> usize {
        self.n_samples()
    }

    fn holds(&self) -> Option<usize> {
        Some(self.state.max_samples)
    }

    fn saved(&self) -> Result<Vec<u8>> {
        self.save()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{GridMap, GridValues, MapSigma};

    #[test]
    fn an_outlier_costs_one_miss_wherever_it_comes() {
        for outlier in 0..6 {
            let mut c = Candidate::new([0.0; 2]);
            for k in 0..12 {
                let middle = if k == outlier { 90.0 } else { 10.0 + 0.1 * f64::from(k) };
                c.take([middle - 2.0, middle + 2.0], f64::INFINITY);
            }
            assert_eq!((c.misses, c.support), (1, 11), "outlier at {outlier}");
            assert!(c.bias[0] > 8.0 && c.bias[1] < 12.2, "{:?}", c.bias);
        }
    }

    #[test]
    fn a_bias_beyond_its_bound_is_a_miss() {
        let mut c = Candidate::new([0.0; 2]);
        for _ in 0..5 {
            c.take([30.0, 34.0], 20.0);
        }
        assert_eq!((c.misses, c.support), (5, 0));
    }

    #[test]
    fn candidates_spread_as_far_as_the_offset_may_have_moved() {
        let axis: Vec<f64> = (0..60).map(|i| 100.0 * f64::from(i)).collect();
        let values = (0..3600).map(f64::from).collect();
        let map = GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap();
        let map = map.with_sigma(Some(MapSigma::Constant(0.0))).unwrap();
        let mut options = PosteriorOptions::new([1000.0; 2]);
        options.heading_sigma_deg = 1.0;
        let mut matcher = PosteriorMatcher::new(Arc::new(map), Some(1.0), options, 10).unwrap();
        matcher.state.y.push(3000.0);
        matcher.state.candidates = vec![
            Candidate { misses: 2, bias: [0.0, 4.0], ..Candidate::new([200.0, 300.0]) },
            Candidate { misses: 1, bias: [3.0, 5.0], ..Candidate::new([900.0, 300.0]) },
        ];
        matcher.state.moved_m = 150.0;
        matcher.spread(2.0);
        assert_eq!(matcher.state.candidates.len(), 2, "not far enough to spread");
        matcher.spread(0.5);
        let places: Vec<[f64; 2]> = matcher.state.candidates.iter().map(|c| c.offset).collect();
        // Five columns about the first, three and the edge about the second, and five rows.
        assert_eq!(places.len(), 5 * 5 + 4 * 5);
        assert!(places.iter().all(|o| o[0].abs() <= 1000.0 && (o[1] - 300.0).abs() <= 200.0));
        assert!(places.windows(2).all(|w| (w[0][1], w[0][0]) < (w[1][1], w[1][0])), "row by row");
        assert_eq!(matcher.state.moved_m, 0.0);
        let mut near = Candidate { misses: 2, bias: [0.0, 4.0], ..Candidate::new([0.0; 2]) };
        near.join(&Candidate { misses: 1, support: 7, bias: [3.0, 5.0], ..Candidate::new([100.0, 0.0]) });
        assert_eq!((near.offset, near.misses, near.support, near.bias), ([0.0; 2], 1, 7, [0.0, 5.0]));
    }
}
