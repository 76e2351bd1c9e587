//! What a step of the navigator says.

use serde::{Deserialize, Serialize};

/// What a step did with its reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FieldNavigatorOutcome {
    /// The reading corrected the state.
    Updated,
    /// There was no reading: dead reckoning.
    Predicted,
    /// The gate refused the reading.
    Rejected,
    /// The field is not known where the vehicle is: dead reckoning.
    OffField,
}

impl FieldNavigatorOutcome {
    /// The name used in Python and reports.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Updated => "updated",
            Self::Predicted => "predicted",
            Self::Rejected => "rejected",
            Self::OffField => "off_field",
        }
    }
}

/// Where the navigator is after a step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FieldNavigatorStep {
    /// Map coordinate.
    pub x: f64,
    /// Map coordinate.
    pub y: f64,
    /// Covariance of the position, square metres, east-north.
    pub covariance_m2: [[f64; 2]; 2],
    /// What became of the reading.
    pub outcome: FieldNavigatorOutcome,
    /// Normalised innovation squared, where there was a reading that could be compared.
    pub nis: Option<f64>,
    /// Numbers in that reading.
    pub dof: usize,
    /// Whether the innovations say that the filter has lost its way.
    pub diverged: bool,
}
