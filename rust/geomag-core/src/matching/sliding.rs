//! Contour matching over a sliding window: a fix a sample instead of a fix a batch [ICCP-G].

use std::collections::VecDeque;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::bounds::{require_place, require_values};
use crate::error::{Error, Result, require_finite, require_positive};
use crate::field::Field;
use crate::fix::{Fix, Status};
use crate::grid::GridMap;
use crate::matching::contour::{ContourOptions, End, Iccp, motion_of, winner};
use crate::matching::refine::answer;
use crate::matching::scene::{Channel, Motion, Scene};
use crate::matching::starts::Starts;
use crate::matching::stream::{Sample, Step, Stream};
use crate::matching::transform::Transform;
use crate::monitor::{Monitor, Quiet};
use crate::stack::require_level;
use crate::state::Saved;
use crate::track::Track;

/// A sample of the window with the sum of the estimates that were made of its displacement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct WindowEntry {
    number: usize,
    x: f64,
    y: f64,
    value: f64,
    weight: f64,
    /// Weighted sum of displacements, metres east and north.
    sum: [f64; 2],
    estimates: usize,
}

/// A position estimated from every window that it was in.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AveragedPoint {
    /// Number of the sample since the start, from 0.
    pub number: usize,
    /// Weighted mean of its estimates, map units.
    pub x: f64,
    /// Weighted mean of its estimates, map units.
    pub y: f64,
    /// How many windows estimated it; with none the position is the indicated one.
    pub estimates: usize,
}

/// What a sliding window remembers: all of it can be saved, and goes on bit for bit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SlidingState {
    length: usize,
    floor_m: f64,
    sigma: Option<f64>,
    options: ContourOptions,
    entries: VecDeque<WindowEntry>,
    count: usize,
    /// The last window's transform about its newest point, and that point.
    last: Option<(Transform, [f64; 2])>,
    settled: Option<AveragedPoint>,
}

impl Saved for SlidingState {
    const NAME: &'static str = "SlidingContour";

    fn check(&self) -> Result<()> {
        let Self { length, floor_m, sigma, options, .. } = self;
        options.check()?;
        require_positive("floor_m", *floor_m)?;
        if let Some(sigma) = sigma {
            crate::error::require_not_negative("sigma", *sigma)?;
        }
        let least = options.transform.min_points().max(2);
        if *length < least {
            return Err(Error::TooFewSamples {
                what: format!("length of a sliding window under a {} transform", options.transform.as_str()),
                needed: least,
                got: *length,
            });
        }
        if let Some(min_points) = options.min_points
            && min_points > *length
        {
            let needed = format!("at most the {length} points of the window");
            return Err(Error::invalid("min_points", needed, min_points));
        }
        if self.entries.len() > *length || self.entries.len() > self.count {
            let needed = format!("at most the {length} of the window and the {} taken", self.count);
            return Err(Error::invalid("samples", needed, self.entries.len()));
        }
        for (k, e) in self.entries.iter().enumerate() {
            require_place(&format!("samples[{k}]"), false, [e.x, e.y])?;
            require_finite(&format!("samples[{k}]"), &[e.value, e.weight, e.sum[0], e.sum[1]])?;
        }
        if let Some((transform, newest)) = &self.last {
            require_finite("last transform", transform.matrix.as_flattened())?;
            require_finite("last transform", &transform.shift)?;
            require_place("last newest point", false, *newest)?;
        }
        Ok(())
    }
}

impl SlidingState {
    /// An empty window of `length` samples.
    ///
    /// `floor_m` is the least contour distance that the averaging believes: the weight of a window's estimates is
    /// `1 / max(mean squared contour distance, floor_m^2)`. (The weights printed in the source are illegible.)
    ///
    /// # Errors
    /// Options that [`ContourOptions::check`] refuses, a length shorter than the transform or `min_points` needs, a floor
    /// that is not positive.
    pub fn new(length: usize, sigma: Option<f64>, floor_m: f64, options: ContourOptions) -> Result<Self> {
        let state = Self {
            length,
            floor_m,
            sigma,
            options,
            entries: VecDeque::with_capacity(length.min(4096)),
            count: 0,
            last: None,
            settled: None,
        };
        state.check()?;
        Ok(state)
    }

    /// Samples in a full window.
    pub fn length(&self) -> usize {
        self.length
    }

    /// About how long a sample takes at most, nanoseconds: some hundreds a point and iteration.
    pub fn most_work(&self) -> u64 {
        let passes = (self.length as u64).saturating_mul(self.options.max_iterations as u64);
        passes.saturating_mul(1000)
    }

    /// Samples taken so far.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The sample that left the window last, with the weighted mean of all its estimates: the delayed answer.
    pub fn settled(&self) -> Option<AveragedPoint> {
        self.settled
    }

    /// The samples of the window, oldest first, each with the weighted mean of its estimates so far.
    pub fn averaged(&self, map: &GridMap) -> Vec<AveragedPoint> {
        self.entries.iter().map(|e| averaged(map, e)).collect()
    }

    /// Takes a sample in, the oldest one leaving a full window, and matches the window, starting where the last window
    /// ended (the first one, and one after a loss or at the edge of a search, where the options say).
    ///
    /// Until the window is full the status is `searching`, and while its points leave the transform undetermined (a
    /// vehicle at rest under any but a translation) `uninformative`; there is no position then.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Invalid`] for a sample that is not finite or no place; the window is as before.
    pub fn update(&mut self, map: &GridMap, x: f64, y: f64, value: f64) -> Result<Fix> {
        self.update_monitored(map, x, y, value, &Quiet)
    }

    /// [`SlidingState::update`] that can be watched and stopped; once stopped, the sample has not been taken.
    ///
    /// # Errors
    /// As [`SlidingState::update`], and [`Error::Interrupted`].
    pub fn update_monitored(
        &mut self,
        map: &GridMap,
        x: f64,
        y: f64,
        value: f64,
        monitor: &dyn Monitor,
    ) -> Result<Fix> {
        require_finite("sample [x, y, value]", &[x, y, value])?;
        require_values("sample value", &[value])?;
        require_place("sample", map.geographic(), [x, y])?;
        // All or nothing: what is refused on the way leaves the window as it was.
        let mut next = self.clone();
        let fix = next.take(map, [x, y], value, monitor)?;
        *self = next;
        Ok(fix)
    }

    fn take(&mut self, map: &GridMap, [x, y]: [f64; 2], value: f64, monitor: &dyn Monitor) -> Result<Fix> {
        if self.entries.len() == self.length
            && let Some(oldest) = self.entries.pop_front()
        {
            self.settled = Some(averaged(map, &oldest));
        }
        self.entries.push_back(WindowEntry {
            number: self.count,
            x,
            y,
            value,
            weight: 0.0,
            sum: [0.0; 2],
            estimates: 0,
        });
        self.count = self.count.saturating_add(1);
        if self.entries.len() < self.length {
            return Ok(Fix::none(Status::Searching, self.entries.len()));
        }
        let column = |get: &dyn Fn(&WindowEntry) -> f64| self.entries.iter().map(get).collect::<Vec<f64>>();
        let track = Track::new(column(&|e| e.x), column(&|e| e.y), column(&|e| e.value), None)?;
        self.match_window(map, &track, monitor)
    }

    fn match_window(&mut self, map: &GridMap, track: &Track, monitor: &dyn Monitor) -> Result<Fix> {
        let channels = [Channel { field: map, values: track.values(), sigma: self.sigma }];
        let scene = Scene::new(&channels, track, None)?;
        let matcher = match Iccp::new(&scene, &self.options) {
            // A vehicle at rest, or straight ahead under an affine transform: the next samples may mend it.
            Err(Error::RankDeficient { .. }) => return Ok(Fix::none(Status::Uninformative, track.len())),
            other => other?,
        };
        let starts = self.starts(map, track, &scene, monitor)?;
        // A place that is already a minimum of the misfit, or the best of a lattice, has nothing to gain from contours.
        let known = self.last.is_some() || matches!(self.options.starts, Starts::Grid { .. });
        let outcomes: Vec<_> = if self.options.refine && known {
            Vec::new()
        } else {
            starts.iter().map(|&start| matcher.run(start, monitor)).collect::<Result<_>>()?
        };
        let in_reach = winner(&outcomes).filter(|&best| outcomes[best].end != End::OutOfReach);
        let (fix, transform, distance_squared) = if self.options.refine {
            let motions: Vec<Motion> = starts
                .iter()
                .chain(outcomes.iter().filter(|o| o.end != End::OutOfReach).map(|o| &o.transform))
                .map(motion_of)
                .collect();
            let iterations = in_reach.map_or(0, |best| outcomes[best].iterations);
            let searched_m = match self.options.starts {
                Starts::Grid { half_width_m, .. } if self.last.is_none() => Some(half_width_m),
                _ => None,
            };
            let options = self.options.effective_refinement();
            let fix = answer(&scene, &options, &motions, iterations, searched_m, monitor)?;
            // From the edge of a search the next window would go on as if it had been found inside.
            if fix.x.is_nan() || fix.status == Status::AtEdge {
                self.last = None;
                return Ok(fix);
            }
            let offset_m = map.displacement_m(track.newest(), [fix.x, fix.y]);
            let refined = Transform::similarity(-fix.heading_deg.to_radians(), fix.scale, offset_m);
            // Where contours are out of reach the refinement's own spread stands for the distance.
            let spread = fix.covariance_m2.map_or(f64::INFINITY, |c| c[0][0] + c[1][1]);
            let distance_squared = matcher.distance_squared(&refined).unwrap_or(spread);
            (fix, refined, distance_squared)
        } else if let Some(best) = in_reach {
            let fix = matcher.fix(&outcomes, best);
            if fix.x.is_nan() {
                self.last = None;
                return Ok(fix);
            }
            (fix, outcomes[best].transform, outcomes[best].distance_squared)
        } else {
            // Nothing to go on from: the next window starts anew.
            self.last = None;
            return Ok(Fix::none(Status::Lost, track.len()));
        };
        let weight = 1.0 / distance_squared.max(self.floor_m * self.floor_m);
        for (entry, lever) in self.entries.iter_mut().zip(&scene.levers) {
            let moved = transform.apply(*lever);
            entry.weight += weight;
            entry.sum[0] += weight * (moved[0] - lever[0]);
            entry.sum[1] += weight * (moved[1] - lever[1]);
            entry.estimates += 1;
        }
        self.last = Some((transform, track.newest()));
        Ok(fix)
    }
}

impl SlidingState {
    /// Where the window starts: where the last one ended, or, without one, where the options say.
    fn starts(&self, map: &GridMap, track: &Track, scene: &Scene<'_>, monitor: &dyn Monitor) -> Result<Vec<Transform>> {
        let Some((t, newest)) = self.last else {
            let offsets = self.options.starts.offsets(scene, &self.options.judgement(track.len()), monitor)?;
            return Ok(offsets.into_iter().map(|shift| Transform { shift, ..Transform::IDENTITY }).collect());
        };
        // The same motion, told about the point that is now the newest.
        let lever = map.displacement_m(newest, track.newest());
        let moved = t.apply(lever);
        Ok(vec![Transform { matrix: t.matrix, shift: [moved[0] - lever[0], moved[1] - lever[1]] }])
    }
}

fn averaged(map: &GridMap, e: &WindowEntry) -> AveragedPoint {
    let [east, north] = map.metres_per_unit(e.y);
    let mean = |i: usize| if e.weight > 0.0 { e.sum[i] / e.weight } else { 0.0 };
    AveragedPoint {
        number: e.number,
        x: map.wrap_x(e.x + mean(0) / east),
        y: e.y + mean(1) / north,
        estimates: e.estimates,
    }
}

/// A sliding window with its map: what is fed sample by sample.
#[derive(Debug, Clone)]
pub struct SlidingContour {
    map: Arc<GridMap>,
    state: SlidingState,
    newest: Option<Fix>,
}

impl SlidingContour {
    /// A window on a map.
    pub fn new(map: Arc<GridMap>, state: SlidingState) -> Self {
        Self { map, state, newest: None }
    }

    /// A window that goes on where [`Stream::saved`] left off.
    ///
    /// # Errors
    /// [`Error::State`].
    pub fn restore(map: Arc<GridMap>, bytes: &[u8]) -> Result<Self> {
        Ok(Self::new(map, crate::state::load(bytes)?))
    }

    /// What it remembers.
    pub fn state(&self) -> &SlidingState {
        &self.state
    }

    /// The samples of the window: see [`SlidingState::averaged`].
    pub fn averaged(&self) -> Vec<AveragedPoint> {
        self.state.averaged(&self.map)
    }
}

impl Stream for SlidingContour {
    fn take(&mut self, sample: &Sample, monitor: &dyn Monitor) -> Result<Step> {
        let Sample { place: [x, y], value, height_m } = *sample;
        if let Some(height) = height_m {
            crate::bounds::require_heights("height_m", &[height])?;
            require_level(&self.map, height)?;
        }
        let fix = self.state.update_monitored(&self.map, x, y, value, monitor)?;
        self.newest = Some(fix.clone());
        Ok(Step { status: fix.status, fix: Some(fix) })
    }

    fn answer(&self) -> Result<Fix> {
        let none = || Error::TooFewSamples { what: "sliding window".into(), needed: 1, got: 0 };
        self.newest.clone().ok_or_else(none)
    }

    fn begin_again(&mut self) -> Result<()> {
        let s = &self.state;
        self.state = SlidingState::new(s.length, s.sigma, s.floor_m, s.options.clone())?;
        self.newest = None;
        Ok(())
    }

    fn seen(&self) -> usize {
        self.state.count
    }

    fn holds(&self) -> Option<usize> {
        Some(self.state.length)
    }

    fn saved(&self) -> Result<Vec<u8>> {
        crate::state::save(&self.state)
    }
}
