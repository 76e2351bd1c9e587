//! What a step answers.

use serde::{Deserialize, Serialize};

/// How the navigator stands to the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum NavigatorStatus {
    /// The start is not known well enough to track yet.
    Acquiring,
    /// Readings keep the position.
    Tracking,
    /// No readings; the INS carries the position on.
    Coasting,
    /// The position is too uncertain for the readings to be of use.
    Lost,
}

impl NavigatorStatus {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Acquiring => "acquiring",
            Self::Tracking => "tracking",
            Self::Coasting => "coasting",
            Self::Lost => "lost",
        }
    }
}

/// Why the status is what it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reason {
    /// The start is known less well than the field is straight.
    StartUncertain,
    /// Readings are used.
    Readings,
    /// There is no reading.
    NoReading,
    /// The place is off the map, or on a hole.
    OffMap,
    /// The sensor says the same number again and again where the map does not.
    StuckSensor,
    /// The position's sigma has outgrown the range over which the field is straight.
    Uncertain,
    /// Fixes contradict the filter.
    Contradicted,
}

impl Reason {
    /// In words.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::StartUncertain => "start uncertain",
            Self::Readings => "readings",
            Self::NoReading => "no reading",
            Self::OffMap => "off the map",
            Self::StuckSensor => "stuck sensor",
            Self::Uncertain => "position uncertain",
            Self::Contradicted => "fixes contradict",
        }
    }
}

/// What became of the readings at a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum NavigatorOutcome {
    /// No reading, or one that waits for the rest of its batch.
    Waiting,
    /// A measurement was used.
    Updated,
    /// A measurement was used with less weight, since it fits badly.
    Downweighted,
    /// The map knows nothing at the place of the reading.
    OffMap,
}

impl NavigatorOutcome {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Updated => "updated",
            Self::Downweighted => "downweighted",
            Self::OffMap => "off_map",
        }
    }
}

/// Which INS output there was: what is missing is worked out from what is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Inputs {
    /// Position, velocity and heading.
    Full,
    /// Position and velocity; the heading is the course.
    Velocity,
    /// Positions alone: velocity from their differences, turns not seen through the attitude but allowed for.
    Positions,
}

impl Inputs {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Velocity => "velocity",
            Self::Positions => "positions",
        }
    }
}

/// What an INS indicates at a time, and what was read there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Indicated {
    /// Seconds, from any zero; must not run backwards.
    pub time_s: f64,
    /// East or longitude, map units.
    pub x: f64,
    /// North or latitude, map units.
    pub y: f64,
    /// Velocity to the east and to the north, metres a second.
    pub velocity_m_s: Option<[f64; 2]>,
    /// Heading, degrees clockwise from north.
    pub heading_deg: Option<f64>,
    /// Metres above the map's height datum; `None` where it does not matter.
    pub height_m: Option<f64>,
    /// Measured value, map's unit; `None` or NaN where there is none.
    pub value: Option<f64>,
}

impl Indicated {
    /// A position alone.
    pub fn at(time_s: f64, x: f64, y: f64) -> Self {
        Self { time_s, x, y, velocity_m_s: None, heading_deg: None, height_m: None, value: None }
    }
}

/// Where a navigator is after a step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NavigatorStep {
    /// Corrected place, map units.
    pub x: f64,
    /// Corrected place, map units.
    pub y: f64,
    /// Covariance of the place as it is to be believed, square metres, east-north.
    pub covariance_m2: [[f64; 2]; 2],
    /// The filter's own covariance, before it is widened by the running NIS.
    pub covariance_filter_m2: [[f64; 2]; 2],
    /// Indicated minus true velocity as estimated, metres a second, east-north.
    pub velocity_error_m_s: [f64; 2],
    /// Indicated minus true heading as estimated, degrees clockwise.
    pub heading_error_deg: f64,
    /// Rotation of the platform about the east and the north axis as estimated, milliradians.
    pub tilt_error_mrad: [f64; 2],
    /// Error of the sensor as estimated, value units.
    pub bias: f64,
    /// How the navigator stands to the map.
    pub status: NavigatorStatus,
    /// Why.
    pub reason: Reason,
    /// What became of the readings.
    pub outcome: NavigatorOutcome,
    /// Normalised innovation squared of a measurement taken at this step.
    pub nis: Option<f64>,
    /// Running mean of these: 1 where the covariance is right.
    pub running_nis: f64,
    /// Radius that the error exceeds with the probability asked for, metres.
    pub protection_level_m: f64,
    /// Time of the newest fix used, seconds.
    pub last_fix_s: Option<f64>,
    /// Resets of the position so far.
    pub resets: u32,
}
