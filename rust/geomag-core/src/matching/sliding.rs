//! Contour matching over a sliding window: a fix a sample instead of a fix a batch [ICCP-G].

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_positive};
use crate::field::Field;
use crate::fix::{Fix, Status};
use crate::grid::GridMap;
use crate::matching::contour::{ContourOptions, End, Iccp, motion_of, winner};
use crate::matching::refine::answer;
use crate::matching::scene::{Channel, Motion, Scene};
use crate::matching::starts::Starts;
use crate::matching::transform::Transform;
use crate::monitor::{Monitor, Quiet};
use crate::track::Track;

/// A sample of the window with the sum of the estimates that were made of its displacement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Entry {
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
    entries: VecDeque<Entry>,
    count: usize,
    /// The last window's transform about its newest point, and that point.
    last: Option<(Transform, [f64; 2])>,
    settled: Option<AveragedPoint>,
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
        options.check()?;
        require_positive("floor_m", floor_m)?;
        if let Some(sigma) = sigma {
            crate::error::require_not_negative("sigma", sigma)?;
        }
        let least = options.transform.min_points().max(2);
        if length < least {
            return Err(Error::TooFewSamples {
                what: format!("length of a sliding window under a {} transform", options.transform.as_str()),
                needed: least,
                got: length,
            });
        }
        if let Some(min_points) = options.min_points
            && min_points > length
        {
            let needed = format!("at most the {length} points of the window");
            return Err(Error::invalid("min_points", needed, min_points));
        }
        Ok(Self {
            length,
            floor_m,
            sigma,
            options,
            entries: VecDeque::with_capacity(length.min(4096)),
            count: 0,
            last: None,
            settled: None,
        })
    }

    /// Samples in a full window.
    pub fn length(&self) -> usize {
        self.length
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
    /// [`Error::NotFinite`] for a sample that is not finite; the window is as before.
    pub fn update(&mut self, map: &GridMap, x: f64, y: f64, value: f64) -> Result<Fix> {
        self.update_monitored(map, x, y, value, &Quiet)
    }

    /// [`SlidingState::update`] that can be watched and stopped; once stopped, the sample has been taken all the same.
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
        if self.entries.len() == self.length
            && let Some(oldest) = self.entries.pop_front()
        {
            self.settled = Some(averaged(map, &oldest));
        }
        self.entries.push_back(Entry { number: self.count, x, y, value, weight: 0.0, sum: [0.0; 2], estimates: 0 });
        self.count += 1;
        if self.entries.len() < self.length {
            return Ok(Fix::none(Status::Searching, self.entries.len()));
        }
        let column = |get: &dyn Fn(&Entry) -> f64| self.entries.iter().map(get).collect::<Vec<f64>>();
        let track = Track::new(column(&|e| e.x), column(&|e| e.y), column(&|e| e.value), None)?;
        self.match_window(map, &track, monitor)
    }

    fn match_window(&mut self, map: &GridMap, track: &Track, monitor: &dyn Monitor) -> Result<Fix> {
        let channels = [Channel { map, values: track.values(), sigma: self.sigma }];
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

fn averaged(map: &GridMap, e: &Entry) -> AveragedPoint {
    let [east, north] = map.metres_per_unit(e.y);
    let mean = |i: usize| if e.weight > 0.0 { e.sum[i] / e.weight } else { 0.0 };
    AveragedPoint {
        number: e.number,
        x: map.wrap_x(e.x + mean(0) / east),
        y: e.y + mean(1) / north,
        estimates: e.estimates,
    }
}
