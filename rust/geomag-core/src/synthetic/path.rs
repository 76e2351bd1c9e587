//! Where a vehicle truly goes: straight and turning paths at constant speed, or given points.

use serde::{Deserialize, Serialize};

use crate::bounds::require_places;
use crate::error::{Error, Result, require_finite, require_positive};
use crate::frame::{displacement_m, metres_per_degree};
use crate::state::Saved;

/// Most samples that a path is made with.
const MAX_SAMPLES: usize = 10_000_000;

/// One leg of a path: so long, turning at so much.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Leg {
    /// Number of samples added.
    pub samples: usize,
    /// Rate of turn, degrees a second, clockwise from above; zero for straight on.
    pub turn_deg_s: f64,
}

/// A true path: positions in map units, times, oldest first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Path {
    x: Vec<f64>,
    y: Vec<f64>,
    time_s: Vec<f64>,
    geographic: bool,
}

impl Saved for Path {
    const NAME: &'static str = "Path";

    fn check(&self) -> Result<()> {
        let Self { x, y, time_s, geographic } = self;
        let n = x.len();
        for (name, len) in [("y", y.len()), ("time_s", time_s.len())] {
            if len != n {
                return Err(Error::shape(format!("path {name}"), format!("({n},) as x"), format!("({len},)")));
            }
        }
        if n == 0 {
            return Err(Error::TooFewSamples { what: "path".into(), needed: 1, got: 0 });
        }
        require_places("path", *geographic, x, y)?;
        require_finite("path time_s", time_s)?;
        if let Some(i) = time_s.windows(2).position(|w| w[1] < w[0]) {
            return Err(Error::invalid(
                format!("path time_s[{}]", i + 1),
                format!("a time not before {}", time_s[i]),
                time_s[i + 1],
            ));
        }
        Ok(())
    }
}

impl Path {
    /// A path through given points.
    ///
    /// # Errors
    /// [`Error::Shape`] for unequal lengths, [`Error::TooFewSamples`] without a point, [`Error::NotFinite`],
    /// [`Error::Invalid`] where time runs backwards.
    pub fn from_points(x: Vec<f64>, y: Vec<f64>, time_s: Vec<f64>, geographic: bool) -> Result<Self> {
        let path = Self { x, y, time_s, geographic };
        path.check()?;
        Ok(path)
    }

    /// A straight path of `samples` points (a rhumb line on geographic coordinates), the first at `start`.
    ///
    /// Course in degrees clockwise from north, speed in metres a second, `interval_s` seconds between samples.
    ///
    /// # Errors
    /// As [`Path::along_legs`].
    pub fn straight(
        start: [f64; 2],
        course_deg: f64,
        speed_m_s: f64,
        interval_s: f64,
        samples: usize,
        geographic: bool,
    ) -> Result<Self> {
        let leg = Leg { samples: samples.saturating_sub(1), turn_deg_s: 0.0 };
        if samples == 0 {
            return Err(Error::TooFewSamples { what: "path".into(), needed: 1, got: 0 });
        }
        Self::along_legs(start, course_deg, speed_m_s, interval_s, &[leg], geographic)
    }

    /// A path of legs, each straight or a part of a circle; the first sample is at `start`.
    ///
    /// ```
    /// use geomag_core::synthetic::{Leg, Path};
    /// let half_circle = [Leg { samples: 180, turn_deg_s: 1.0 }];
    /// let path = Path::along_legs([0.0, 0.0], 0.0, 100.0, 1.0, &half_circle, false)?;
    /// let diameter_m = 2.0 * 100.0 / 1_f64.to_radians();
    /// assert!((path.newest()[0] - diameter_m).abs() < 1e-6);
    /// # Ok::<(), geomag_core::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Invalid`] or [`Error::NotFinite`] naming the argument; [`Error::Invalid`] where the path comes within a
    /// degree of a pole or has over 10^7 samples.
    pub fn along_legs(
        start: [f64; 2],
        course_deg: f64,
        speed_m_s: f64,
        interval_s: f64,
        legs: &[Leg],
        geographic: bool,
    ) -> Result<Self> {
        require_finite("path start", &start)?;
        require_finite("path course_deg", &[course_deg])?;
        require_positive("path speed_m_s", speed_m_s)?;
        require_positive("path interval_s", interval_s)?;
        let samples = legs.iter().fold(1_usize, |sum, leg| sum.saturating_add(leg.samples));
        if samples > MAX_SAMPLES {
            return Err(Error::invalid("path", format!("at most {MAX_SAMPLES} samples"), samples));
        }
        let (mut x, mut y, mut time_s) = (vec![start[0]], vec![start[1]], vec![0.0]);
        let mut course = course_deg.to_radians();
        for (i, leg) in legs.iter().enumerate() {
            require_finite(&format!("path legs[{i}].turn_deg_s"), &[leg.turn_deg_s])?;
            let turn = leg.turn_deg_s.to_radians() * interval_s;
            // The chord of an arc: v dt sin(turn / 2) / (turn / 2), along the course at the arc's middle.
            let half = 0.5 * turn;
            let chord = speed_m_s * interval_s * if half == 0.0 { 1.0 } else { libm::sin(half) / half };
            for _ in 0..leg.samples {
                let (east, north) = (chord * libm::sin(course + half), chord * libm::cos(course + half));
                let k = x.len() - 1;
                let scale = |latitude: f64| if geographic { metres_per_degree(latitude) } else { [1.0, 1.0] };
                // Scale at the middle of the step, found from a first guess.
                let middle = y[k] + 0.5 * north / scale(y[k])[1];
                let [east_scale, north_scale] = scale(middle);
                x.push(x[k] + east / east_scale);
                y.push(y[k] + north / north_scale);
                time_s.push((k + 1) as f64 * interval_s);
                if geographic && !(-89.0..=89.0).contains(&y[k + 1]) {
                    return Err(Error::invalid(
                        format!("path sample {}", k + 1),
                        "a latitude within [-89, 89] degrees",
                        y[k + 1],
                    ));
                }
                course += turn;
            }
        }
        Self::from_points(x, y, time_s, geographic)
    }

    /// Number of samples, at least one.
    #[allow(clippy::len_without_is_empty)] // never empty by construction
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// True x (east).
    pub fn x(&self) -> &[f64] {
        &self.x
    }

    /// True y (north).
    pub fn y(&self) -> &[f64] {
        &self.y
    }

    /// Times, seconds.
    pub fn time_s(&self) -> &[f64] {
        &self.time_s
    }

    /// Whether coordinates are degrees of longitude and latitude.
    pub fn geographic(&self) -> bool {
        self.geographic
    }

    /// True position of sample `k`.
    pub fn point(&self, k: usize) -> [f64; 2] {
        [self.x[k], self.y[k]]
    }

    /// True position of the newest sample.
    pub fn newest(&self) -> [f64; 2] {
        self.point(self.len() - 1)
    }

    /// Displacement from sample `k - 1` to sample `k`, metres `[east, north]`; zero for the first.
    pub fn step_m(&self, k: usize) -> [f64; 2] {
        if k == 0 { [0.0, 0.0] } else { displacement_m(self.geographic, self.point(k - 1), self.point(k)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn straight_paths_keep_course_and_speed() {
        for (start, geographic) in [([1e5, 2e5], false), ([179.9, 60.0], true)] {
            let path = Path::straight(start, 50.0, 30.0, 20.0, 50, geographic).unwrap();
            assert_eq!(path.len(), 50);
            for k in 1..path.len() {
                let [east, north] = path.step_m(k);
                assert_relative_eq!(east.hypot(north), 600.0, max_relative = 1e-7);
                assert_relative_eq!(east.atan2(north).to_degrees(), 50.0, max_relative = 1e-6);
            }
            assert_relative_eq!(path.time_s()[49], 980.0);
        }
    }

    #[test]
    fn a_whole_circle_closes() {
        let path =
            Path::along_legs([0.0, 0.0], 123.0, 50.0, 2.0, &[Leg { samples: 60, turn_deg_s: -3.0 }], false).unwrap();
        assert!(path.newest()[0].abs() < 1e-9 && path.newest()[1].abs() < 1e-9);
    }

    #[test]
    fn bad_paths_are_refused() {
        assert!(Path::straight([0.0, 0.0], 0.0, 1.0, 1.0, 0, false).is_err());
        assert!(Path::straight([0.0, 0.0], 0.0, 0.0, 1.0, 5, false).is_err());
        assert!(Path::straight([0.0, 0.0], f64::NAN, 1.0, 1.0, 5, false).is_err());
        assert!(Path::straight([0.0, 88.0], 0.0, 1e4, 100.0, 5, true).is_err());
        assert!(Path::straight([0.0, 0.0], 0.0, 1.0, 1.0, usize::MAX, false).is_err());
        assert!(Path::from_points(vec![0.0], vec![0.0, 1.0], vec![0.0], false).is_err());
        assert!(Path::from_points(vec![0.0; 2], vec![0.0; 2], vec![1.0, 0.0], false).is_err());
        assert!(Path::from_points(vec![], vec![], vec![], false).is_err());
    }
}
