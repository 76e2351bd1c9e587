//! Sensors that fail: one that is stuck, one whose level jumps.

use serde::{Deserialize, Serialize};

/// Equal readings in a row after which a sensor may be stuck.
const EQUAL: u32 = 8;
/// It is, where the map changes by more than so many standard deviations of a reading over them.
const CHANGE: f64 = 4.0;
/// Innovations in a row of one sign, each beyond so many standard deviations, that tell of a jump of level.
const IN_A_ROW: u32 = 5;
const BEYOND: f64 = 2.0;
/// As many where every reading is a measurement by itself.
const SINGLE_IN_A_ROW: u32 = 10;

/// A run of equal readings.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Stuck {
    value: f64,
    count: u32,
    /// Least and greatest value of the map under them.
    least: f64,
    greatest: f64,
}

impl Stuck {
    /// Takes a reading and what the map says there; true where the sensor must be stuck. `sigma` is the standard deviation of a reading
    /// against the map.
    pub fn take(&mut self, value: f64, expected: f64, sigma: f64) -> bool {
        if self.count > 0 && value == self.value {
            self.count = self.count.saturating_add(1);
            self.least = self.least.min(expected);
            self.greatest = self.greatest.max(expected);
        } else {
            *self = Self { value, count: 1, least: expected, greatest: expected };
        }
        self.count >= EQUAL && self.greatest - self.least > CHANGE * sigma
    }
}

/// A run of innovations of one sign.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct LevelShift {
    count: u32,
    sum: f64,
}

impl LevelShift {
    /// Takes an innovation and its standard deviation; the jump, where there is one.
    pub fn take(&mut self, innovation: f64, sigma: f64, single: bool) -> Option<f64> {
        if innovation.abs() < BEYOND * sigma || innovation * self.sum < 0.0 {
            *self = Self::default();
            if innovation.abs() < BEYOND * sigma {
                return None;
            }
        }
        self.count = self.count.saturating_add(1);
        self.sum += innovation;
        if self.count < if single { SINGLE_IN_A_ROW } else { IN_A_ROW } {
            return None;
        }
        let jump = self.sum / f64::from(self.count);
        *self = Self::default();
        Some(jump)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_readings_over_a_changing_field_are_a_stuck_sensor() {
        let mut stuck = Stuck::default();
        let over = |stuck: &mut Stuck, slope: f64| {
            (0..20).map(|k| stuck.take(7.0, slope * f64::from(k), 1.0)).collect::<Vec<_>>()
        };
        let steep = over(&mut stuck, 1.0);
        assert!(!steep[6] && steep[7..].iter().all(|s| *s));
        assert!(!stuck.take(7.5, 20.0, 1.0));
        // Over a flat field equal readings are as they should be.
        assert!(over(&mut Stuck::default(), 0.1).iter().all(|s| !s));
    }

    #[test]
    fn a_row_of_one_sign_is_a_jump_and_noise_is_none() {
        let mut shift = LevelShift::default();
        let jumps: Vec<_> = (0..5).filter_map(|_| shift.take(50.0, 10.0, false)).collect();
        assert_eq!(jumps, [50.0]);
        let mut shift = LevelShift::default();
        assert!((0..50).all(|k| shift.take(if k % 2 == 0 { 50.0 } else { -50.0 }, 10.0, false).is_none()));
        assert!((0..50).all(|_| shift.take(15.0, 10.0, false).is_none()));
    }
}
