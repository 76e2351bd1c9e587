//! Carrying the errors on from one step to the next.

use super::motion::{
    ACCELEROMETER, COUPLED, FASTEST_M_S, GYRO, INS_STATES, Rows, TILT, VELOCITY, VehicleMotion, rates, transition,
};
use super::options::MOST_SIGMA_M;
use super::outcome::Inputs;
use super::state::{Navigator, Newest};
use super::states::{BIAS, REGISTRATION};

/// Time below which nothing is carried on, seconds: rates are divided by it.
const SHORTEST_STEP_S: f64 = 1e-9;
/// Longest time over which the errors are carried on at once, seconds.
const LONGEST_STEP_S: f64 = 5.0;
/// The most that errors can be, whatever the equations of small errors say after hours without a correction: half the way round the
/// Earth, the fastest vehicle, half a turn.
const MOST_SIGMA: [f64; COUPLED] = [
    MOST_SIGMA_M,
    MOST_SIGMA_M,
    FASTEST_M_S,
    FASTEST_M_S,
    std::f64::consts::PI,
    std::f64::consts::PI,
    std::f64::consts::PI,
];

impl Navigator {
    /// Carries the errors on from one step to the next.
    pub(super) fn carry_on(&mut self, before: &Newest, now: &Newest) {
        // The filter is taken out meanwhile: the pieces are worked out from everything else.
        let mut filter = std::mem::take(&mut self.state.filter);
        let mut scratch = std::mem::take(&mut self.scratch);
        let mut record = self.record.take();
        let heading_variance = filter.at(TILT + 2, TILT + 2);
        let states = filter.len();
        self.pieces(before, now, states, heading_variance, |phi, factors, noise| {
            filter.predict(phi, factors, noise, &mut scratch);
            let held = filter.hold(&MOST_SIGMA);
            if let Some(record) = &mut record {
                match held {
                    None => record.moved(phi, factors),
                    Some(by) => record.moved(&std::array::from_fn(|i| phi[i].map(|p| p * by[i])), factors),
                }
            }
        });
        (self.state.filter, self.scratch, self.record) = (filter, scratch, record);
        let moved = self.field.displacement_m([before.x, before.y], [now.x, now.y]);
        let way = moved[0].hypot(moved[1]);
        self.state.batch.gathered_m += way;
        self.state.watch.since_m += way;
    }

    /// The pieces of a step, each at most five seconds: coupled rows of the transition, factors of the other states, variances that come in.
    pub(super) fn pieces(
        &self,
        before: &Newest,
        now: &Newest,
        states: usize,
        heading_variance: f64,
        mut each: impl FnMut(&Rows, &[f64], &[f64]),
    ) {
        let gap = now.time_s - before.time_s;
        if gap < SHORTEST_STEP_S {
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
        let latitude_rad = self.latitude_rad(before.y);
        let radii_m = radii(latitude_rad);
        let place = [before.x, before.y];
        let distance = self.law.distance_m(self.field.as_ref(), place[0], place[1]);
        let registration = self.law.registration_m(distance).powi(2);
        let length = self.law.registration_length_m(distance);
        let ins = &self.state.options.ins;
        let (gyro, accelerometer) = (1.0 / ins.gyro_time_constant_s, 1.0 / ins.accelerometer_time_constant_s);
        let mut decay = [gyro; INS_STATES - COUPLED];
        decay[ACCELEROMETER - COUPLED..].fill(accelerometer);
        let mut noise = vec![0.0; states];
        let mut factors = vec![1.0; states - COUPLED];
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
        noise[BIAS] = self.state.options.bias_walk_sqrt_s.powi(2) * dt;
        if !turns {
            // A turn throws the heading error into the velocity, and nobody says when one is flown.
            for axis in 0..2 {
                noise[VELOCITY + axis] += heading_variance * change[1 - axis].powi(2) / pieces;
            }
        }
        for k in 0..pieces as usize {
            let share = (k as f64 + 0.5) / pieces;
            let velocity_m_s = [0, 1].map(|axis| from[axis] + share * change[axis]);
            let motion = VehicleMotion {
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
            each(&phi, &factors, &noise);
        }
    }

    /// Latitude of a place on the map.
    pub(super) fn latitude_rad(&self, y: f64) -> f64 {
        if self.field.geographic() { y } else { self.state.options.latitude_deg }.to_radians()
    }
}

/// Radii of curvature to the east and to the north at a latitude, metres.
pub(super) fn radii(latitude_rad: f64) -> [f64; 2] {
    let [east, north] = crate::frame::metres_per_degree(latitude_rad.to_degrees());
    [east.to_degrees() / libm::cos(latitude_rad), north.to_degrees()]
}
