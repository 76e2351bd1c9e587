//! One step: carry the errors on, take a reading in, say where the vehicle is.

use super::motion::{FASTEST_M_S, POSITION, TILT, VELOCITY};
use super::options::MOST_LATITUDE_DEG;
use super::outcome::{Indicated, Inputs, NavigatorOutcome, NavigatorStep};
use super::state::{Navigator, Newest};
use super::states::{BIAS, REGISTRATION};
use crate::bounds::{require_place, require_values};
use crate::error::{Error, Result, require_finite};
use crate::monitor::{Monitor, Quiet};
use crate::stack::check_height;

/// Longest time between two steps, seconds.
const LONGEST_GAP_S: f64 = 86_400.0;
impl Navigator {
    /// Goes on to what the INS indicates now, and takes in a reading where there is one.
    ///
    /// Velocity that is not given is the difference of positions, heading that is not given is the course.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Invalid`] (time running backwards, a place beyond the poles, a speed beyond 10 km/s); nothing has
    /// changed then.
    pub fn step(&mut self, indicated: &Indicated) -> Result<NavigatorStep> {
        self.step_with_terms(indicated, &[])
    }

    /// [`Navigator::step`] for readings that contain terms besides the field: what their coefficients are multiplied by, as many as the
    /// options have a covariance for. A reading whose terms are not all numbers is no reading.
    ///
    /// # Errors
    /// As [`Navigator::step`], also for terms beyond [`crate::bounds::MOST_VALUE`]; [`Error::Shape`] for another number of terms with a
    /// reading.
    pub fn step_with_terms(&mut self, indicated: &Indicated, terms: &[f64]) -> Result<NavigatorStep> {
        self.step_interruptible(indicated, terms, &Quiet)
    }

    /// [`Navigator::step_with_terms`] whose match, where there is one, `monitor` may stop.
    ///
    /// # Errors
    /// As [`Navigator::step_with_terms`]; [`Error::Interrupted`]: the step is taken then, without its match.
    pub fn step_interruptible(
        &mut self,
        indicated: &Indicated,
        terms: &[f64],
        monitor: &dyn Monitor,
    ) -> Result<NavigatorStep> {
        let wanted = self.state.options.terms();
        if terms.len() != wanted && indicated.value.is_some_and(|v| !v.is_nan()) {
            return Err(Error::shape(
                "terms",
                format!("({wanted},) as terms_covariance"),
                format!("({},)", terms.len()),
            ));
        }
        let whole = terms.iter().all(|t| t.is_finite());
        if whole {
            require_values("terms", terms)?;
        }
        let value = indicated.value.filter(|v| !v.is_nan() && whole);
        let now = self.check(indicated)?;
        let before = self.state.newest;
        if let Some(before) = before {
            self.carry_on(&before, &now);
        } else {
            self.begin(&now);
        }
        self.state.newest = Some(now);
        self.state.steps = self.state.steps.saturating_add(1);
        let (outcome, nis) = self.read(&now, value, indicated.height_m, terms);
        let watched = self.watch(&now, monitor);
        self.judge(&now, outcome);
        if let Some(record) = &mut self.record {
            record.stepped(&self.state.filter);
        }
        watched?;
        Ok(self.answer(outcome, nis))
    }

    /// What is indicated, made whole.
    pub(super) fn check(&mut self, indicated: &Indicated) -> Result<Newest> {
        let Indicated { time_s, x, y, velocity_m_s, heading_deg, height_m, value } = *indicated;
        require_finite("time_s", &[time_s])?;
        require_place("position", self.field.geographic(), [x, y])?;
        if let Some(value) = value.filter(|v| !v.is_nan()) {
            require_values("value", &[value])?;
        }
        if let Some(height) = height_m {
            crate::bounds::require_heights("height_m", &[height])?;
        }
        check_height(self.field.as_ref(), height_m)?;
        let geographic = self.field.geographic();
        if geographic && y.abs() > MOST_LATITUDE_DEG {
            return Err(Error::invalid(
                "y",
                format!("a latitude within {MOST_LATITUDE_DEG} degrees of the equator"),
                y,
            ));
        }
        let x = self.field.wrap_x(x);
        let before = self.state.newest;
        let gap = before.map_or(0.0, |b| time_s - b.time_s);
        if !(0.0..=LONGEST_GAP_S).contains(&gap) {
            let needed = format!("a time from 0 to {LONGEST_GAP_S} s after the newest step");
            return Err(Error::invalid("time_s", needed, format!("{gap} s after it")));
        }
        let velocity = match (velocity_m_s, before) {
            (Some(v), _) => {
                require_finite("velocity_m_s", &v)?;
                v
            }
            (None, Some(b)) if gap > 0.0 => self.field.displacement_m([b.x, b.y], [x, y]).map(|d| d / gap),
            (None, Some(b)) => b.velocity_m_s,
            (None, None) => [0.0; 2],
        };
        let speed = velocity[0].hypot(velocity[1]);
        if !(speed <= FASTEST_M_S) {
            return Err(Error::invalid("velocity_m_s", format!("a speed of at most {FASTEST_M_S} m/s"), speed));
        }
        let heading_rad = match heading_deg {
            Some(h) => {
                require_finite("heading_deg", &[h])?;
                h.to_radians()
            }
            None if speed > 0.0 => libm::atan2(velocity[0], velocity[1]),
            None => before.map_or(0.0, |b| b.heading_rad),
        };
        self.state.inputs = match (velocity_m_s, heading_deg) {
            (Some(_), Some(_)) => Inputs::Full,
            (Some(_), None) => Inputs::Velocity,
            (None, _) => Inputs::Positions,
        };
        Ok(Newest { time_s, x, y, velocity_m_s: velocity, heading_rad })
    }

    /// The first step: what is known of the start, and of the map there.
    pub(super) fn begin(&mut self, now: &Newest) {
        if let Some([x, y]) = self.state.options.start {
            let error = self.field.displacement_m([self.field.wrap_x(x), y], [now.x, now.y]);
            self.state.filter.mean_mut()[POSITION..POSITION + 2].copy_from_slice(&error);
        }
        let distance = self.law.distance_m(self.field.as_ref(), now.x, now.y);
        for axis in 0..2 {
            self.state.filter.separate(REGISTRATION + axis, self.law.registration_m(distance).powi(2));
        }
        self.state.heard_s = Some(now.time_s);
    }

    fn answer(&self, outcome: NavigatorOutcome, nis: Option<f64>) -> NavigatorStep {
        let s = &self.state;
        let mean = s.filter.mean();
        let (x, y) = s.newest.map_or((f64::NAN, f64::NAN), |n| (n.x, n.y));
        let [x, y] = self.corrected(x, y, [mean[POSITION], mean[POSITION + 1]]);
        let covariance_m2 = self.reported_m2();
        NavigatorStep {
            x,
            y,
            covariance_m2,
            covariance_filter_m2: self.own_m2(),
            velocity_error_m_s: [mean[VELOCITY], mean[VELOCITY + 1]],
            // The computed frame is the true one turned by minus psi.
            heading_error_deg: -mean[TILT + 2].to_degrees(),
            tilt_error_mrad: [1e3 * mean[TILT], 1e3 * mean[TILT + 1]],
            bias: mean[BIAS],
            status: s.status,
            reason: s.reason,
            outcome,
            nis,
            running_nis: s.running.value(),
            protection_level_m: self.widening * self.radius.of(covariance_m2),
            last_fix_s: s.last_fix_s,
            resets: s.resets,
        }
    }
}
