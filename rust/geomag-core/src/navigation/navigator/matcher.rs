//! The matcher beside the filter: a start known to kilometres, a lock that was lost, and a look round now and then.
//!
//! A filter follows one hypothesis. Where the position is known less well than the field is straight, the posterior over a window of
//! the newest readings says whether there is another; its fix is a measurement only while the filter is lost, for otherwise the same
//! readings would count twice, and a test while it tracks.

use super::correct::CONTRADICTION;
use super::integrity::axes;
use super::motion::{POSITION, VELOCITY};
use super::outcome::NavigatorStatus;
use super::plan::MatcherPlan;
use super::state::{Navigator, Newest};
use super::watch::TimedSample;
use crate::error::{Error, Result};
use crate::fix::Fix;
use crate::matching::posterior::{PosteriorOptions, match_interruptible};
use crate::matching::scene::Channel;
use crate::monitor::Monitor;
use crate::track::Track;

/// Half width of the search in standard deviations of the position, axis by axis.
const HALF_WIDTH_SIGMAS: f64 = 3.5;
/// A fix's covariance counts so many times, and a share of the tolerance is added to each axis: windows overlap with what the filter
/// has used, and errors of the map are common to both.
const COVARIANCE_FACTOR: f64 = 2.5;
const TOLERANCE_SHARE: f64 = 0.15;
/// Running NIS above which the filter is in doubt.
const ALARM: f64 = 3.0;
/// Bending of the window by the velocity error, in tolerances, up to which it is left out of the match, and up to which it is put in.
const STRAIGHT: f64 = 0.1;
const MOST_BENDING: f64 = 5.0;
/// Fewest samples of a window.
const FEWEST: usize = 10;

/// What the matcher was asked for and what it said.
pub(super) struct Asked {
    pub fix: Fix,
    pub tolerance_m: f64,
}

impl Navigator {
    /// Whether the matcher may be asked at a step at this time, as the filter is now: that takes milliseconds to seconds instead of
    /// microseconds.
    pub fn is_match_due(&self, time_s: f64) -> bool {
        let due = |plan: MatcherPlan| {
            // The step itself may bring the one sample that is wanting.
            self.occasion(&plan, time_s).is_some() && self.held(&plan).len() + 1 >= FEWEST.min(plan.samples)
        };
        self.state.options.matcher.is_some_and(due)
    }

    /// Whether the filter is lost, and whether it is in doubt, where that or the time is an occasion to ask.
    fn occasion(&self, plan: &MatcherPlan, time_s: f64) -> Option<[bool; 2]> {
        let since = |t: Option<f64>| t.map_or(f64::INFINITY, |t| time_s - t);
        if since(self.state.watch.tried_s) < plan.every_s {
            return None;
        }
        let lost = axes(self.own_m2())[0] > self.law.linear_m;
        let alarm = self.state.running.value() > ALARM;
        (lost || alarm || since(self.state.watch.looked_s) >= plan.wide_every_s).then_some([lost, alarm])
    }

    /// Asks the matcher where it is time to, and draws the consequences.
    ///
    /// # Errors
    /// [`Error::Interrupted`]: it was not asked then.
    pub(super) fn watch(&mut self, now: &Newest, monitor: &dyn Monitor) -> Result<()> {
        let Some(plan) = self.state.options.matcher else { return Ok(()) };
        let Some([lost, alarm]) = self.occasion(&plan, now.time_s) else { return Ok(()) };
        let Some(track) = self.window(&plan, now) else { return Ok(()) };
        let asked = self.ask(&plan, &track, monitor)?;
        self.state.watch.tried_s = Some(now.time_s);
        self.state.watch.looked_s = Some(now.time_s);
        if let Some(asked) = asked {
            self.draw_consequences(now, &asked, lost, alarm);
        }
        Ok(())
    }

    /// The newest samples where the filter thinks they were read, as many as the velocity error allows.
    fn window(&self, plan: &MatcherPlan, now: &Newest) -> Option<Track> {
        let window = self.held(plan);
        if window.len() < FEWEST.min(plan.samples) {
            return None;
        }
        let mean = self.state.filter.mean();
        let place = |s: &TimedSample| {
            let age = now.time_s - s.time_s;
            self.corrected(s.x, s.y, [0, 1].map(|axis| mean[POSITION + axis] - mean[VELOCITY + axis] * age))
        };
        let (x, y): (Vec<f64>, Vec<f64>) = window.iter().map(place).map(|[x, y]| (x, y)).unzip();
        let values = window.iter().map(|s| s.value).collect();
        let times = window.iter().map(|s| s.time_s).collect();
        let heights: Option<Vec<f64>> = window.iter().map(|s| s.height_m).collect();
        Track::new(x, y, values, Some(times)).and_then(|t| t.with_height(heights)).ok()
    }

    /// The newest samples over which the velocity error bends the track by no more than can be put in.
    fn held(&self, plan: &MatcherPlan) -> &[TimedSample] {
        let samples = &self.state.watch.samples;
        let longest_s = MOST_BENDING * self.tolerance_m(plan) / self.velocity_sigma().max(1e-9);
        let Some(newest) = samples.last() else { return &[] };
        let first = samples.iter().position(|s| newest.time_s - s.time_s <= longest_s);
        first.map_or(&[], |first| &samples[first..])
    }

    fn velocity_sigma(&self) -> f64 {
        let f = &self.state.filter;
        (0.5 * (f.at(VELOCITY, VELOCITY) + f.at(VELOCITY + 1, VELOCITY + 1))).sqrt()
    }

    fn tolerance_m(&self, plan: &MatcherPlan) -> f64 {
        plan.tolerance_m.unwrap_or(0.7 * self.law.linear_m)
    }

    fn ask(&self, plan: &MatcherPlan, track: &Track, monitor: &dyn Monitor) -> Result<Option<Asked>> {
        let tolerance_m = self.tolerance_m(plan);
        let own = self.own_m2();
        let [east, north] = self.field.metres_per_unit(track.newest()[1]);
        let factor = self.state.running.factor();
        let half = |variance: f64| {
            (HALF_WIDTH_SIGMAS * (factor * variance).sqrt())
                .clamp(2.0 * tolerance_m, plan.reach_m.max(2.0 * tolerance_m))
        };
        let half_width = [half(own[0][0]) / east, half(own[1][1]) / north];
        let Some(times) = track.time_s() else { return Ok(None) };
        let bending = self.velocity_sigma() * (times[times.len() - 1] - times[0]);
        let options = PosteriorOptions {
            tolerance_m: Some(tolerance_m),
            max_risk: plan.max_risk,
            drift_sigma_m: if bending > STRAIGHT * tolerance_m { bending } else { 0.0 },
            ..PosteriorOptions::new(half_width)
        };
        let sigma = self.state.options.reading_sigma;
        let sigma = (sigma > 0.0).then_some(sigma);
        let channel = Channel { field: self.field.as_ref(), values: track.values(), sigma };
        match match_interruptible(&[channel], track, &options, monitor) {
            Ok(fix) => Ok((fix.ok() && fix.covariance_m2.is_some()).then_some(Asked { fix, tolerance_m })),
            Err(Error::Interrupted) => Err(Error::Interrupted),
            // A window that cannot be matched is one without a fix.
            Err(_) => Ok(None),
        }
    }

    fn draw_consequences(&mut self, now: &Newest, asked: &Asked, lost: bool, alarm: bool) {
        let Some(covariance) = asked.fix.covariance_m2 else { return };
        let share = 2.0 * (TOLERANCE_SHARE * asked.tolerance_m).powi(2);
        let covariance: [[f64; 2]; 2] = std::array::from_fn(|i| {
            std::array::from_fn(|j| COVARIANCE_FACTOR * covariance[i][j] + if i == j { share } else { 0.0 })
        });
        let mean = self.state.filter.mean();
        let error = [0, 1].map(|axis| mean[POSITION + axis] - asked.fix.offset_m[axis]);
        let nis = self.position_nis(error, covariance);
        if nis > CONTRADICTION {
            self.state.watch.contradictions = self.state.watch.contradictions.saturating_add(1);
            if self.state.watch.contradictions >= 2 || alarm || self.state.status == NavigatorStatus::Lost {
                self.state.watch.contradictions = 0;
                self.state.last_fix_s = Some(now.time_s);
                self.start_again(error, covariance);
            }
            return;
        }
        self.state.watch.contradictions = 0;
        if lost {
            self.state.last_fix_s = Some(now.time_s);
            self.take_pair(POSITION, error, covariance);
        }
    }
}
