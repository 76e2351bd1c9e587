//! What an inertial navigation system gets wrong: constant, linear, rotational and Schuler-oscillating errors.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

use crate::error::{Error, Result, require_finite, require_not_negative};
use crate::frame::metres_per_degree;
use crate::synthetic::{Path, Random};

/// Schuler rate, radians a second: sqrt(g / R) with g = 9.80665 m/s^2 and R = 6371 km; a period of 84.4 minutes.
pub const SCHULER_RATE_RAD_S: f64 = 1.240_670_727e-3;
/// Earth radius that goes with it, metres.
const RADIUS_M: f64 = 6_371_000.0;

/// One INS error: *indicated minus true*, so that a fix should find its negative at the newest sample.
///
/// Position error after a time t on each horizontal axis, the axes taken as independent (Groves 2013, *Principles of GNSS,
/// Inertial, and Multisensor Integrated Navigation Systems*, section 5.7; Titterton and Weston 2004, table 12.1), with w
/// the Schuler rate:
///
/// | source | with `schuler` | without |
/// |---|---|---|
/// | initial velocity error v | v sin(w t) / w | v t |
/// | accelerometer bias b | b (1 - cos w t) / w^2 | b t^2 / 2 |
/// | gyro drift e | R e (t - sin(w t) / w) | g e t^3 / 6 |
///
/// Heading error turns every travelled step clockwise, scale error stretches it, and both add up along the path however
/// it turns: an odometer's law. (An INS's heading error tilts its platform by the Earth's rate: geomag's Python package has
/// those equations as `synthetic.indicate`.) Not for: errors over many hours (the Foucault and 24-hour oscillations are left out) or the vertical.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InsError {
    /// Constant position error, map units `[x, y]`: constant in degrees on geographic maps, as matchers on a lattice assume.
    pub position: [f64; 2],
    /// Initial position error, metres `[east, north]`; added to the one in map units.
    pub position_m: [f64; 2],
    /// Initial velocity error, metres a second `[east, north]`.
    pub velocity_m_s: [f64; 2],
    /// Heading error of dead reckoning, degrees clockwise (an odometer's law).
    pub heading_deg: f64,
    /// Growth of the heading error, degrees an hour.
    pub heading_rate_deg_h: f64,
    /// Scale error: indicated over true distance, less one.
    pub scale: f64,
    /// Drift of the levelling gyros, degrees an hour, as it moves the position `[east, north]`.
    pub gyro_deg_h: [f64; 2],
    /// Bias of the accelerometers, metres a second squared `[east, north]`.
    pub accelerometer_m_s2: [f64; 2],
    /// Random walk of the position on each axis, metres per square root of a second.
    pub walk_m_sqrt_s: f64,
    /// Whether velocity, gyro and accelerometer errors oscillate with the Schuler period.
    pub schuler: bool,
}

impl Default for InsError {
    /// A perfect INS, with Schuler motion for the errors that are then set.
    fn default() -> Self {
        Self {
            position: [0.0; 2],
            position_m: [0.0; 2],
            velocity_m_s: [0.0; 2],
            heading_deg: 0.0,
            heading_rate_deg_h: 0.0,
            scale: 0.0,
            gyro_deg_h: [0.0; 2],
            accelerometer_m_s2: [0.0; 2],
            walk_m_sqrt_s: 0.0,
            schuler: true,
        }
    }
}

impl InsError {
    fn check(&self) -> Result<()> {
        require_finite("INS position", &self.position)?;
        require_finite("INS position_m", &self.position_m)?;
        require_finite("INS velocity_m_s", &self.velocity_m_s)?;
        require_finite("INS heading_deg", &[self.heading_deg])?;
        require_finite("INS heading_rate_deg_h", &[self.heading_rate_deg_h])?;
        require_finite("INS gyro_deg_h", &self.gyro_deg_h)?;
        require_finite("INS accelerometer_m_s2", &self.accelerometer_m_s2)?;
        require_not_negative("INS walk_m_sqrt_s", self.walk_m_sqrt_s)?;
        if !(self.scale.is_finite() && self.scale > -1.0) {
            return Err(Error::invalid("INS scale", "a finite number > -1 (0 for none)", self.scale));
        }
        Ok(())
    }

    /// The part of the position error that depends on time alone, metres `[east, north]`, `t` seconds after the start.
    pub fn drift_m(&self, t: f64) -> [f64; 2] {
        let w = SCHULER_RATE_RAD_S;
        // Below a thousandth of a radian the exact forms lose digits to cancellation that the series keep.
        let (from_velocity, from_acceleration, from_gyro) = if self.schuler && w * t > 1e-3 {
            let (sin, cos) = (libm::sin(w * t), libm::cos(w * t));
            (sin / w, (1.0 - cos) / (w * w), RADIUS_M * (t - sin / w))
        } else {
            (t, 0.5 * t * t, RADIUS_M * w * w * t * t * t / 6.0)
        };
        std::array::from_fn(|axis| {
            let gyro_rad_s = self.gyro_deg_h[axis].to_radians() / 3600.0;
            self.velocity_m_s[axis] * from_velocity
                + self.accelerometer_m_s2[axis] * from_acceleration
                + gyro_rad_s * from_gyro
        })
    }

    /// Indicated positions (x and y, map units) along a true path. `random` is drawn from for the random walk.
    ///
    /// # Errors
    /// [`Error::Invalid`] or [`Error::NotFinite`] naming the parameter.
    pub fn indicate(&self, path: &Path, random: &mut Random) -> Result<(Vec<f64>, Vec<f64>)> {
        self.check()?;
        let n = path.len();
        let (mut xs, mut ys) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let mut travelled = [0.0; 2];
        let mut walk = [0.0; 2];
        let start = path.time_s()[0];
        for k in 0..n {
            let t = path.time_s()[k] - start;
            if k > 0 {
                let previous = path.time_s()[k - 1] - start;
                let heading = (self.heading_deg + self.heading_rate_deg_h * 0.5 * (t + previous) / 3600.0).to_radians();
                let (sin, cos) = (libm::sin(heading), libm::cos(heading));
                let [east, north] = path.step_m(k);
                let gain = 1.0 + self.scale;
                travelled[0] += gain * (east * cos + north * sin) - east;
                travelled[1] += gain * (north * cos - east * sin) - north;
                if self.walk_m_sqrt_s > 0.0 {
                    let step = self.walk_m_sqrt_s * (t - previous).sqrt();
                    walk = walk.map(|w| w + step * random.normal());
                }
            }
            let drift = self.drift_m(t);
            let [x, y] = path.point(k);
            let scale = if path.geographic() { metres_per_degree(y) } else { [1.0, 1.0] };
            let error = |axis: usize| {
                self.position[axis] + (self.position_m[axis] + drift[axis] + travelled[axis] + walk[axis]) / scale[axis]
            };
            xs.push(x + error(0));
            ys.push(y + error(1));
        }
        Ok((xs, ys))
    }
}

/// How the initial position error is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum PositionSpread {
    /// Uniform within half widths `[x, y]`, map units: the bound that IEMA is told.
    Uniform {
        /// Greatest error on each axis, map units.
        half_width: [f64; 2],
    },
    /// Uniform over the whole multiples of `step` within half widths, map units: the paper's own case.
    Lattice {
        /// Greatest error on each axis, map units.
        half_width: [f64; 2],
        /// Spacing of the lattice, map units.
        step: [f64; 2],
    },
    /// Normal on each axis, metres `[east, north]`.
    Normal {
        /// Standard deviation on each axis, metres.
        sigma_m: [f64; 2],
    },
    /// Of one length, in a random direction.
    Ring {
        /// Length, metres.
        radius_m: f64,
    },
}

/// What INS errors are drawn from: the initial position as told, everything else normal about zero.
///
/// ```
/// use geomag_core::synthetic::{InsSpread, PositionSpread, Random};
/// let spread = InsSpread {
///     position: PositionSpread::Ring { radius_m: 790.0 },
///     heading_sigma_deg: 0.5,
///     ..InsSpread::default()
/// };
/// let error = spread.draw(&mut Random::new(1))?;
/// assert!((error.position_m[0].hypot(error.position_m[1]) - 790.0).abs() < 1e-9);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InsSpread {
    /// Initial position.
    pub position: PositionSpread,
    /// Velocity error on each axis, metres a second.
    pub velocity_sigma_m_s: f64,
    /// Heading error, degrees.
    pub heading_sigma_deg: f64,
    /// Growth of the heading error, degrees an hour.
    pub heading_rate_sigma_deg_h: f64,
    /// Scale error.
    pub scale_sigma: f64,
    /// Gyro drift on each axis, degrees an hour.
    pub gyro_sigma_deg_h: f64,
    /// Accelerometer bias on each axis, metres a second squared.
    pub accelerometer_sigma_m_s2: f64,
    /// Random walk of every draw, metres per square root of a second.
    pub walk_m_sqrt_s: f64,
    /// Whether errors oscillate with the Schuler period.
    pub schuler: bool,
}

impl Default for InsSpread {
    /// Nothing but a position error, normal with 1 km on each axis.
    fn default() -> Self {
        Self {
            position: PositionSpread::Normal { sigma_m: [1000.0; 2] },
            velocity_sigma_m_s: 0.0,
            heading_sigma_deg: 0.0,
            heading_rate_sigma_deg_h: 0.0,
            scale_sigma: 0.0,
            gyro_sigma_deg_h: 0.0,
            accelerometer_sigma_m_s2: 0.0,
            walk_m_sqrt_s: 0.0,
            schuler: true,
        }
    }
}

impl InsSpread {
    fn check(&self) -> Result<()> {
        match self.position {
            PositionSpread::Uniform { half_width } => {
                for h in half_width {
                    require_not_negative("INS spread half_width", h)?;
                }
            }
            PositionSpread::Lattice { half_width, step } => {
                for (h, s) in half_width.into_iter().zip(step) {
                    require_not_negative("INS spread half_width", h)?;
                    crate::error::require_positive("INS spread step", s)?;
                }
            }
            PositionSpread::Normal { sigma_m } => {
                for s in sigma_m {
                    require_not_negative("INS spread sigma_m", s)?;
                }
            }
            PositionSpread::Ring { radius_m } => {
                require_not_negative("INS spread radius_m", radius_m)?;
            }
        }
        for (name, value) in [
            ("velocity_sigma_m_s", self.velocity_sigma_m_s),
            ("heading_sigma_deg", self.heading_sigma_deg),
            ("heading_rate_sigma_deg_h", self.heading_rate_sigma_deg_h),
            ("scale_sigma", self.scale_sigma),
            ("gyro_sigma_deg_h", self.gyro_sigma_deg_h),
            ("accelerometer_sigma_m_s2", self.accelerometer_sigma_m_s2),
            ("walk_m_sqrt_s", self.walk_m_sqrt_s),
        ] {
            require_not_negative(&format!("INS spread {name}"), value)?;
        }
        Ok(())
    }

    /// One INS error. Every draw takes the same number of random numbers of each kind, whatever the sizes.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the parameter.
    pub fn draw(&self, random: &mut Random) -> Result<InsError> {
        self.check()?;
        let mut error = InsError { walk_m_sqrt_s: self.walk_m_sqrt_s, schuler: self.schuler, ..InsError::default() };
        match self.position {
            PositionSpread::Uniform { half_width } => error.position = half_width.map(|h| random.uniform(-h, h)),
            PositionSpread::Lattice { half_width, step } => {
                for axis in 0..2 {
                    let cells = (half_width[axis] / step[axis] + 1e-9).floor();
                    let node = random.below(2 * cells as u64 + 1) as f64 - cells;
                    error.position[axis] = node * step[axis];
                }
            }
            PositionSpread::Normal { sigma_m } => error.position_m = sigma_m.map(|s| s * random.normal()),
            PositionSpread::Ring { radius_m } => {
                let angle = random.uniform(0.0, TAU);
                error.position_m = [radius_m * libm::sin(angle), radius_m * libm::cos(angle)];
            }
        }
        let mut pair = |sigma: f64| [sigma * random.normal(), sigma * random.normal()];
        error.velocity_m_s = pair(self.velocity_sigma_m_s);
        [error.heading_deg, error.scale] = pair(1.0);
        error.heading_deg *= self.heading_sigma_deg;
        // Beyond minus one the vehicle would run backwards; six sigma of any real log is far from it.
        error.scale = (error.scale * self.scale_sigma).max(-0.5);
        error.gyro_deg_h = pair(self.gyro_sigma_deg_h);
        error.accelerometer_m_s2 = pair(self.accelerometer_sigma_m_s2);
        error.heading_rate_deg_h = self.heading_rate_sigma_deg_h * random.normal();
        Ok(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn path() -> Path {
        Path::straight([0.0, 0.0], 90.0, 100.0, 60.0, 61, false).unwrap()
    }

    fn end(error: InsError) -> [f64; 2] {
        let path = path();
        let (x, y) = error.indicate(&path, &mut Random::new(0)).unwrap();
        [x[60] - path.x()[60], y[60] - path.y()[60]]
    }

    #[test]
    fn schuler_rate_is_that_of_the_earth() {
        assert_relative_eq!(SCHULER_RATE_RAD_S, (9.80665_f64 / RADIUS_M).sqrt(), max_relative = 1e-9);
    }

    #[test]
    fn each_source_has_its_closed_form() {
        let t: f64 = 3600.0;
        let w = SCHULER_RATE_RAD_S;
        let got = end(InsError { position_m: [5.0, -7.0], position: [1.0, 2.0], ..InsError::default() });
        assert_relative_eq!(got[0], 6.0, epsilon = 1e-9);
        assert_relative_eq!(got[1], -5.0, epsilon = 1e-9);
        let linear = InsError { velocity_m_s: [0.5, 0.0], schuler: false, ..InsError::default() };
        assert_relative_eq!(end(linear)[0], 1800.0, epsilon = 1e-6);
        let schuler = InsError { schuler: true, ..linear };
        assert_relative_eq!(end(schuler)[0], 0.5 * (w * t).sin() / w, epsilon = 1e-6);
        // One hundredth of a degree an hour is about one kilometre after an hour.
        let gyro = InsError { gyro_deg_h: [0.0, 0.01], ..InsError::default() };
        let rate = 0.01_f64.to_radians() / 3600.0;
        assert_relative_eq!(end(gyro)[1], RADIUS_M * rate * (t - (w * t).sin() / w), epsilon = 1e-6);
        assert!((1000.0..2200.0).contains(&end(gyro)[1]));
        let bias = InsError { accelerometer_m_s2: [1e-4, 0.0], ..InsError::default() };
        assert_relative_eq!(end(bias)[0], 1e-4 * (1.0 - (w * t).cos()) / (w * w), epsilon = 1e-6);
        // Heading error turns the track clockwise: an eastward track indicates to the south.
        let heading = end(InsError { heading_deg: 1.0, ..InsError::default() });
        assert_relative_eq!(heading[1], -360_000.0 * 1_f64.to_radians().sin(), epsilon = 1e-6);
        assert_relative_eq!(end(InsError { scale: 0.01, ..InsError::default() })[0], 3600.0, epsilon = 1e-6);
    }

    #[test]
    fn series_and_exact_forms_meet() {
        let error = InsError {
            velocity_m_s: [1.0; 2],
            gyro_deg_h: [0.01; 2],
            accelerometer_m_s2: [1e-4; 2],
            ..InsError::default()
        };
        let t = 1e-3 / SCHULER_RATE_RAD_S;
        assert_relative_eq!(error.drift_m(t * 0.999_999)[0], error.drift_m(t * 1.000_001)[0], max_relative = 1e-5);
    }

    #[test]
    fn the_walk_grows_with_the_root_of_time() {
        let error = InsError { walk_m_sqrt_s: 2.0, ..InsError::default() };
        let path = path();
        let n = 4000;
        let square: f64 =
            (0..n).map(|seed| error.indicate(&path, &mut Random::new(seed)).unwrap().1[60].powi(2)).sum::<f64>()
                / n as f64;
        assert_relative_eq!(square.sqrt(), 2.0 * 3600_f64.sqrt(), max_relative = 0.05);
    }

    #[test]
    fn draws_follow_their_spread() {
        let mut random = Random::new(3);
        let lattice = PositionSpread::Lattice { half_width: [0.1, 0.05], step: [0.01, 0.01] };
        let spread = InsSpread { position: lattice, ..InsSpread::default() };
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for _ in 0..2000 {
            let [x, y] = spread.draw(&mut random).unwrap().position;
            assert!((x / 0.01 - (x / 0.01).round()).abs() < 1e-9 && y.abs() < 0.051);
            least = least.min(x);
            greatest = greatest.max(x);
        }
        assert_relative_eq!(least, -0.1, epsilon = 1e-12);
        assert_relative_eq!(greatest, 0.1, epsilon = 1e-12);
        assert!(InsSpread { scale_sigma: -1.0, ..spread }.draw(&mut random).is_err());
        assert!(
            InsSpread { position: PositionSpread::Ring { radius_m: f64::NAN }, ..spread }.draw(&mut random).is_err()
        );
    }

    #[test]
    fn bad_errors_are_refused() {
        for bad in [
            InsError { scale: -1.0, ..InsError::default() },
            InsError { heading_deg: f64::NAN, ..InsError::default() },
            InsError { walk_m_sqrt_s: -1.0, ..InsError::default() },
        ] {
            assert!(bad.indicate(&path(), &mut Random::new(0)).is_err());
        }
    }
}
