//! What a gravity anomaly owes to the errors of the INS that it was reduced with.
//!
//! An anomaly is the reading less normal gravity at a latitude plus the Eotvos effect of a velocity. Both are the INS's, so that its errors
//! stand in the anomaly: some 15 mGal for a metre per second to the east at the equator, 0.8 mGal for a kilometre of latitude at 45 degrees.
//! Left out they are taken for errors of the position. To first order they are terms whose coefficients are the INS's error states.

use serde::{Deserialize, Serialize};

use super::motion::{EARTH_RATE_RAD_S, POSITION, VELOCITY};

/// Metres per second squared to milligal.
const MGAL: f64 = 1e5;
/// Of the increase of normal gravity from the equator to the poles, metres per second squared (WGS 84, the first term of its series).
const POLEWARD_M_S2: f64 = 9.780_325 * 0.005_302_4;

/// What errors of the INS add to a reading.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Owed {
    /// Value units for a metre of position error to the north.
    pub north: f64,
    /// Value units for a metre per second of velocity error, east and north.
    pub velocity: [f64; 2],
}

impl Owed {
    /// Of a gravity anomaly in milligal, reduced by an INS that indicates this latitude and velocity.
    pub fn of_gravity(latitude_rad: f64, radii_m: [f64; 2], velocity_m_s: [f64; 2]) -> Self {
        let turning = 2.0 * EARTH_RATE_RAD_S * libm::cos(latitude_rad);
        // The Eotvos effect of an eastward velocity changes with latitude too: a quarter of the whole for an aircraft at 60 degrees.
        let eastward = 2.0 * EARTH_RATE_RAD_S * libm::sin(latitude_rad) * velocity_m_s[0];
        let poleward = POLEWARD_M_S2 * libm::sin(2.0 * latitude_rad);
        Self {
            north: -MGAL * (poleward + eastward) / radii_m[1],
            velocity: [
                MGAL * (turning + 2.0 * velocity_m_s[0] / radii_m[0]),
                MGAL * 2.0 * velocity_m_s[1] / radii_m[1],
            ],
        }
    }

    /// What the errors that the filter thinks there are, position carried back over `age_s` seconds, have added.
    pub fn by(&self, mean: &[f64], age_s: f64) -> f64 {
        let north = mean[POSITION + 1] - mean[VELOCITY + 1] * age_s;
        self.north * north + self.velocity[0] * mean[VELOCITY] + self.velocity[1] * mean[VELOCITY + 1]
    }

    pub fn is_sound(&self) -> bool {
        self.north.is_finite() && self.velocity.iter().all(|v| v.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Anomaly less the raw reading: Eotvos in knots as [ICCP-G] prints it, normal gravity by its usual series.
    fn correction(latitude_deg: f64, velocity_m_s: [f64; 2]) -> f64 {
        let latitude = latitude_deg.to_radians();
        let [east, north] = velocity_m_s.map(|v| v / 0.514_444);
        let (s2, s4) = (latitude.sin().powi(2), (2.0 * latitude).sin().powi(2));
        let normal = 978_032.5 * (1.0 + 0.005_302_4 * s2 - 0.000_005_8 * s4);
        7.503 * east * latitude.cos() + 0.004_154 * (east * east + north * north) - normal
    }

    #[test]
    fn it_is_what_the_reduction_changes_by() {
        for (latitude_deg, velocity) in [(15.0, [4.0, -5.0]), (-40.0, [-6.0, 2.0]), (60.0, [100.0, 60.0])] {
            let [east, north] = crate::frame::metres_per_degree(latitude_deg);
            let latitude = f64::to_radians(latitude_deg);
            let radii = [east.to_degrees() / latitude.cos(), north.to_degrees()];
            let owed = Owed::of_gravity(latitude, radii, velocity);
            let changed = |north_m: f64, dv: [f64; 2]| {
                let moved = correction(latitude_deg + north_m / north, [velocity[0] + dv[0], velocity[1] + dv[1]]);
                moved - correction(latitude_deg, velocity)
            };
            assert!((owed.north * 100.0 / changed(100.0, [0.0; 2]) - 1.0).abs() < 0.01);
            assert!((owed.velocity[0] * 0.1 / changed(0.0, [0.1, 0.0]) - 1.0).abs() < 0.01);
            assert!((owed.velocity[1] * 0.1 / changed(0.0, [0.0, 0.1]) - 1.0).abs() < 0.03);
        }
    }
}
