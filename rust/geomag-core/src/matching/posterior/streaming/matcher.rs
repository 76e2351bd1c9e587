//! The streaming matcher: every sample to the gate, the posterior where it is cheap or due.

use std::sync::Arc;

use super::super::decide;
use super::super::lattice::Lattice;
use super::super::noise::wants_curves;
use super::super::options::PosteriorOptions;
use super::super::patch::Patch;
use super::super::problem::{Interruption, Problem};
use super::candidate::GateCandidate;
use super::held::{FEWEST, Held};
use crate::bounds::{require_place, require_values};
use crate::error::{Error, Result, require_finite};
use crate::field::Field;
use crate::fix::{Fix, Status};
use crate::matching::scene::Channel;
use crate::matching::stream::{Sample, Step, Stream};
use crate::monitor::{Monitor, Quiet};
use crate::stack::{check_heights, extent};
use crate::state::{self, Saved};
use crate::track::Track;

/// Candidates times samples up to which the posterior is taken at every sample.
const CHEAP: usize = 800;
/// Part of the window after which the gate is laid out anew, so that it forgets what the window has let go.
const RENEWED: usize = 4;
/// Movement in lattice steps that is left to the margins of a search.
const SETTLED: f64 = 0.1;
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

/// Streaming matcher with a declared risk; see the module.
///
/// Holds at most `max_samples` samples: when there are more, the oldest is let go, so that memory and time are bounded.
#[derive(Debug, Clone)]
pub struct PosteriorMatcher {
    field: Arc<dyn Field>,
    pub(super) state: Held,
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
        let candidates = lattice.offsets().into_iter().map(GateCandidate::new).collect();
        let state = Held {
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
        self.update_interruptible(&Sample { place: [x, y], value, height_m }, &Quiet)
    }

    /// [`PosteriorMatcher::update_at`] that `monitor` may stop.
    ///
    /// # Errors
    /// As [`PosteriorMatcher::update_at`]; [`Error::Interrupted`]: the sample is not taken then either.
    pub fn update_interruptible(&mut self, sample: &Sample, monitor: &dyn Monitor) -> Result<PosteriorStep> {
        let Sample { place: [x, y], value, height_m } = *sample;
        require_finite("sample (x, y, value)", &[x, y, value])?;
        require_values("sample value", &[value])?;
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
        let step = next.take_sample(x, y, value, height_m, monitor)?;
        *self = next;
        Ok(step)
    }

    fn take_sample(
        &mut self,
        x: f64,
        y: f64,
        value: f64,
        height_m: Option<f64>,
        monitor: &dyn Monitor,
    ) -> Result<PosteriorStep> {
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
        s.seen = s.seen.saturating_add(1);
        s.note_movement(&*self.field);
        s.spread(&*self.field, 0.5);
        let s = &mut self.state;
        s.let_go = s.let_go.saturating_add(usize::from(full));
        if s.let_go * RENEWED >= s.max_samples {
            self.renew_gate()?;
        } else {
            self.gate([x, y, value], height_m)?;
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
        self.state.spread(&*self.field, SETTLED);
        let (fix, kept) = self.solve(true, monitor)?;
        self.state.status = fix.status;
        self.state.risk = fix.risk.unwrap_or(1.0);
        if let Some(kept) = kept {
            self.state.prune(kept);
        }
        Ok(self.step(Some(fix)))
    }

    /// The answer on the samples held, whatever the schedule: that of the batch matcher over the candidates left.
    ///
    /// # Errors
    /// [`Error::TooFewSamples`] before the first sample.
    pub fn fix(&self) -> Result<Fix> {
        Ok(self.solve(false, &Quiet)?.0)
    }

    /// The answer, and the candidates that the first stage of its search would keep where it went that far: with
    /// `coarse`, the first lattice may settle that there is no fix yet.
    fn solve(&self, coarse: bool, monitor: &dyn Monitor) -> Result<(Fix, Option<Vec<[f64; 2]>>)> {
        let s = &self.state;
        let track = self.track()?;
        if s.candidates.is_empty() {
            return Ok((Fix::none(Status::Lost, s.x.len()), None));
        }
        let channels = [Channel { field: &*self.field, values: track.values(), sigma: s.sigma }];
        let mut problem = Problem::on(&channels, &track, &s.options, self.patch.as_ref())?;
        problem.interruption = Interruption::by(monitor);
        let offsets: Vec<[f64; 2]> = s.candidates.iter().map(|c| c.offset).collect();
        let (posterior, kept) = problem.solve_going_on(offsets, s.lattice.step, coarse);
        problem.interruption.none()?;
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
        let saved: Held = state::load(bytes)?;
        let refuse = |detail: &str| Err(Error::State { what: Held::NAME.into(), detail: detail.into() });
        let lattice = Lattice::new(field.spacing(), &saved.options)?;
        if saved.lattice != lattice {
            return refuse("its lattice is not that of this map");
        }
        let on_lattice = |c: &GateCandidate| {
            let index = lattice.index(c.offset);
            (0..2).all(|d| index[d].unsigned_abs() <= lattice.most[d] as u64) && lattice.offset(index) == c.offset
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
    /// Puts the samples held to the gate anew, so that it forgets those that were let go: where a bias drifts, the interval that
    /// an old sample allows is not that of today.
    fn renew_gate(&mut self) -> Result<()> {
        self.state.let_go = 0;
        for c in &mut self.state.candidates {
            *c = GateCandidate::new(c.offset);
        }
        for k in 0..self.state.x.len() {
            let s = &self.state;
            let (sample, height_m) = ([s.x[k], s.y[k], s.values[k]], s.heights_m.get(k).copied());
            self.gate(sample, height_m)?;
        }
        Ok(())
    }

    fn gate(&mut self, sample: [f64; 3], height_m: Option<f64>) -> Result<()> {
        if let Some(window) = self.state.leaves_window(&*self.field) {
            self.state.window = Some(window);
            self.lay_out(self.state.options.max_candidates)?;
        }
        match &self.patch {
            Some(patch) => self.state.gate(&*self.field, patch, sample, height_m),
            None => Ok(()),
        }
    }
}

impl Stream for PosteriorMatcher {
    fn take(&mut self, sample: &Sample, monitor: &dyn Monitor) -> Result<Step> {
        let step = self.update_interruptible(sample, monitor)?;
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
