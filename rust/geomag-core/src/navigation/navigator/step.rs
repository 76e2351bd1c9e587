//! One step: carry the errors on, take a reading in, say where the vehicle is.

use super::batch::Reading;
use super::integrity::axes;
use super::linear;
use super::motion::{ACCELEROMETER, COUPLED, GYRO, INS_STATES, Motion, POSITION, TILT, VELOCITY, rates, transition};
use super::options::MOST_LATITUDE_DEG;
use super::outcome::{Indicated, Inputs, NavigatorStep, Outcome, Reason, Status};
use super::{BIAS, Navigator, Newest, REGISTRATION, STATES};
use crate::bounds::require_place;
use crate::error::{Error, Result, require_finite};

/// Longest step over which the errors are carried on at once, seconds.
const LONGEST_STEP_S: f64 = 5.0;
/// Longest time between two steps, seconds.
const LONGEST_GAP_S: f64 = 86_400.0;
/// Fastest vehicle, metres a second.
const FASTEST_M_S: f64 = 1e4;
/// Time without a usable reading after which the navigator coasts, seconds.
const COASTING_S: f64 = 60.0;
/// Position sigma, in ranges over which the field is straight, beyond which the navigator is lost, and below which it is found again.
const LOST: f64 = 4.0;
const FOUND: f64 = 2.0;
/// NIS of a single reading beyond which it is no word on the covariance, unless the one before was as bad.
const STARTLING: f64 = 25.0;
/// Least half width of the lattice, cells: within less the interpolation of the map has corners, not slopes.
const LEAST_LATTICE_CELLS: f64 = 0.05;

impl Navigator {
    /// Goes on to what the INS indicates now, and takes in a reading where there is one.
    ///
    /// Velocity that is not given is the difference of positions, heading that is not given is the course.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Invalid`] (time running backwards, a place beyond the poles, a speed beyond 10 km/s); nothing has
    /// changed then.
    pub fn step(&mut self, indicated: &Indicated) -> Result<NavigatorStep> {
        let now = self.check(indicated)?;
        let before = self.state.newest;
        if let Some(before) = before {
            self.carry_on(&before, &now);
        } else {
            self.begin(&now);
        }
        self.state.newest = Some(now);
        self.state.steps += 1;
        let (outcome, nis) = self.read(&now, indicated.value.filter(|v| !v.is_nan()));
        self.judge(&now, outcome);
        Ok(self.answer(outcome, nis))
    }

    /// What is indicated, made whole.
    fn check(&mut self, indicated: &Indicated) -> Result<Newest> {
        let Indicated { time_s, x, y, velocity_m_s, heading_deg, value } = *indicated;
        require_finite("time_s", &[time_s])?;
        require_place("position", self.field.geographic(), [x, y])?;
        if let Some(value) = value.filter(|v| v.is_infinite()) {
            return Err(Error::NotFinite { what: "value".into(), index: 0, got: value });
        }
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
    fn begin(&mut self, now: &Newest) {
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

    /// Carries the errors on from one step to the next.
    fn carry_on(&mut self, before: &Newest, now: &Newest) {
        let gap = now.time_s - before.time_s;
        if gap <= 0.0 {
            return;
        }
        let turns = self.state.inputs != Inputs::Positions;
        // The first velocity from differences is that of the step itself.
        let from = if turns || self.state.steps > 1 { before.velocity_m_s } else { now.velocity_m_s };
        let pieces = (gap / LONGEST_STEP_S).ceil().max(1.0);
        let dt = gap / pieces;
        let change = [0, 1].map(|axis| now.velocity_m_s[axis] - from[axis]);
        let turn = {
            let raw = (now.heading_rad - before.heading_rad) % std::f64::consts::TAU;
            raw - std::f64::consts::TAU * (raw / std::f64::consts::TAU).round()
        };
        let latitude_rad =
            if self.field.geographic() { before.y } else { self.state.options.latitude_deg }.to_radians();
        let radii_m = radii(latitude_rad);
        let place = [before.x, before.y];
        let distance = self.law.distance_m(self.field.as_ref(), place[0], place[1]);
        let registration = self.law.registration_m(distance).powi(2);
        let length = self.law.registration_length_m(distance);
        let ins = &self.state.options.ins;
        let (gyro, accelerometer) = (1.0 / ins.gyro_time_constant_s, 1.0 / ins.accelerometer_time_constant_s);
        let mut decay = [gyro; INS_STATES - COUPLED];
        decay[ACCELEROMETER - COUPLED..].fill(accelerometer);
        let mut noise = [0.0; STATES];
        let mut factors = [1.0; STATES - COUPLED];
        for axis in 0..2 {
            noise[VELOCITY + axis] = ins.velocity_noise() * dt;
            noise[ACCELEROMETER + axis] = -ins.accelerometer_m_s2().powi(2) * libm::expm1(-2.0 * accelerometer * dt);
            factors[ACCELEROMETER + axis - COUPLED] = libm::exp(-accelerometer * dt);
        }
        for axis in 0..3 {
            noise[TILT + axis] = ins.angle_noise() * dt;
            noise[GYRO + axis] = -ins.gyro_rad_s().powi(2) * libm::expm1(-2.0 * gyro * dt);
            factors[GYRO + axis - COUPLED] = libm::exp(-gyro * dt);
        }
        noise[BIAS] = self.state.options.bias_walk.powi(2) * dt;
        if !turns {
            // A turn throws the heading error into the velocity, and nobody says when one is flown.
            let heading = self.state.filter.at(TILT + 2, TILT + 2);
            for axis in 0..2 {
                noise[VELOCITY + axis] += heading * change[1 - axis].powi(2) / pieces;
            }
        }
        for k in 0..pieces as usize {
            let share = (k as f64 + 0.5) / pieces;
            let velocity_m_s = [0, 1].map(|axis| from[axis] + share * change[axis]);
            let motion = Motion {
                latitude_rad,
                radii_m,
                velocity_m_s,
                acceleration_m_s2: change.map(|c| c / gap),
                heading_rad: before.heading_rad + share * turn,
                turns,
            };
            let way = velocity_m_s[0].hypot(velocity_m_s[1]) * dt;
            let kept = libm::exp(-way / length);
            for axis in 0..2 {
                factors[REGISTRATION + axis - COUPLED] = kept;
                noise[REGISTRATION + axis] = registration * (1.0 - kept * kept);
            }
            let phi = transition(&rates(&motion), &decay, dt);
            self.state.filter.predict(&phi, &factors, &noise, &mut self.scratch);
        }
        let moved = self.field.displacement_m(place, [now.x, now.y]);
        self.state.batch.gathered_m += moved[0].hypot(moved[1]);
    }

    /// Map units per metre at a latitude.
    fn per_metre(&self, y: f64) -> [f64; 2] {
        self.field.metres_per_unit(y).map(|m| 1.0 / m)
    }

    /// The place that a position error of the INS leaves, map units.
    pub(super) fn corrected(&self, x: f64, y: f64, error_m: [f64; 2]) -> [f64; 2] {
        let [_, north] = self.per_metre(y);
        let truer = y - error_m[1] * north;
        let [east, north] = self.per_metre(0.5 * (y + truer));
        [x - error_m[0] * east, y - error_m[1] * north]
    }

    /// Gathers a reading and uses the batch once it is full.
    fn read(&mut self, now: &Newest, value: Option<f64>) -> (Outcome, Option<f64>) {
        let mut outcome = Outcome::Waiting;
        if let Some(value) = value {
            let error = [self.state.filter.mean()[POSITION], self.state.filter.mean()[POSITION + 1]];
            let [x, y] = self.corrected(now.x, now.y, error);
            let place = self.law.at(self.field.as_ref(), x, y).filter(|_| !self.field.value(x, y).is_nan());
            if let Some(place) = place {
                self.state.heard_s = Some(now.time_s);
                self.state.off_map = false;
                let reading = Reading { value, time_s: now.time_s, x: now.x, y: now.y, sigma: place.sigma };
                self.state.batch.push(reading, &self.law, place);
            } else {
                self.state.off_map = true;
                outcome = Outcome::OffMap;
            }
        }
        if !self.state.batch.is_full(now.time_s) {
            return (outcome, None);
        }
        let used = self.use_batch(now);
        self.state.batch.clear();
        match used {
            Some((nis, weight)) => (if weight < 1.0 { Outcome::Downweighted } else { Outcome::Updated }, Some(nis)),
            None => (Outcome::OffMap, None),
        }
    }

    /// The measurement of a batch: the mean of its readings against the mean of the map under them.
    ///
    /// Returns the normalised innovation squared and the weight it was used with; `None` where the map knows too little.
    fn use_batch(&mut self, now: &Newest) -> Option<(f64, f64)> {
        let field = self.field.as_ref();
        let filter = &self.state.filter;
        let mean = filter.mean();
        let noise = self.state.options.reading_sigma;
        let scale = self.per_metre(now.y);
        // Where a reading was taken if the position error is what the filter thinks, shifted by `d` metres: the velocity error is taken
        // along, and so is the displacement of the map.
        let at = |reading: &Reading, d: [f64; 2]| {
            let age = now.time_s - reading.time_s;
            let shift =
                |axis: usize| d[axis] - mean[POSITION + axis] + mean[VELOCITY + axis] * age + mean[REGISTRATION + axis];
            field.value(reading.x + shift(0) * scale[0], reading.y + shift(1) * scale[1])
        };
        let mut chosen = std::mem::take(&mut self.chosen);
        self.state.batch.choose(now.time_s, &self.law, noise, |r| at(r, [0.0; 2]), &mut chosen);
        let count = chosen.readings.len();
        let spacing = field.spacing();
        let covariance = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let (a, b) = (POSITION + i, POSITION + j);
                let (r, s) = (REGISTRATION + i, REGISTRATION + j);
                let least = if i == j { (LEAST_LATTICE_CELLS * spacing[i] / scale[i]).powi(2) } else { 0.0 };
                filter.at(a, b) + filter.at(r, s) - filter.at(a, s) - filter.at(r, b) + least
            })
        });
        let plane = if count == 0 {
            None
        } else {
            linear::fit(covariance, |d| chosen.readings.iter().map(|(r, weight)| weight * at(r, d)).sum())
        };
        let result = plane.map(|plane| {
            let innovation = chosen.value - plane.mean - mean[BIAS];
            let [east, north] = plane.slope;
            let slopes = [
                (POSITION, -east),
                (POSITION + 1, -north),
                (VELOCITY, east * chosen.age_s),
                (VELOCITY + 1, north * chosen.age_s),
                (BIAS, 1.0),
                (REGISTRATION, east),
                (REGISTRATION + 1, north),
            ];
            let batched = self.state.batch.length_m > 0.0;
            let variance = self.law.mean_variance(chosen.sigma, batched)
                + 2.0 * plane.left
                + noise * noise / count as f64
                + chosen.excess;
            (innovation, slopes, variance, batched)
        });
        self.chosen = chosen;
        let (innovation, slopes, variance, batched) = result?;
        let predicted = self.state.filter.project(&slopes, &mut self.scratch);
        let total = predicted.variance + variance;
        if !(total > 0.0) {
            return None;
        }
        let nis = innovation * innovation / total;
        let nu = self.state.options.nu;
        let weight = if nu.is_finite() { ((nu + 1.0) / (nu + nis)).min(1.0) } else { 1.0 };
        // S divided by the weight: what is added stands in R.
        let effective = total / weight - predicted.variance;
        self.state.filter.update(&slopes, predicted, innovation, effective, &mut self.scratch);
        let startling = !batched && nis > STARTLING;
        if !startling || self.state.startled {
            self.state.running.take(nis);
        }
        self.state.startled = startling;
        Some((nis, weight))
    }

    /// Sets the status.
    fn judge(&mut self, now: &Newest, outcome: Outcome) {
        let sigma = axes(self.reported_m2())[0];
        let range = self.law.linear_m;
        let was_lost = self.state.status == Status::Lost;
        let silent = self.state.heard_s.is_none_or(|t| now.time_s - t > COASTING_S);
        let limit = if !self.state.tracked {
            range
        } else if was_lost {
            FOUND * range
        } else {
            LOST * range
        };
        (self.state.status, self.state.reason) = if sigma > limit {
            if self.state.tracked {
                (Status::Lost, Reason::Uncertain)
            } else {
                (Status::Acquiring, Reason::StartUncertain)
            }
        } else if silent {
            (Status::Coasting, if self.state.off_map { Reason::OffMap } else { Reason::NoReading })
        } else if outcome == Outcome::OffMap {
            (Status::Coasting, Reason::OffMap)
        } else {
            self.state.tracked = true;
            (Status::Tracking, Reason::Readings)
        };
    }

    fn answer(&self, outcome: Outcome, nis: Option<f64>) -> NavigatorStep {
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
            heading_error_deg: mean[TILT + 2].to_degrees(),
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

/// Radii of curvature to the east and to the north at a latitude, metres.
fn radii(latitude_rad: f64) -> [f64; 2] {
    let [east, north] = crate::frame::metres_per_degree(latitude_rad.to_degrees());
    [east.to_degrees() / libm::cos(latitude_rad), north.to_degrees()]
}
