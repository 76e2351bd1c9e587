//! Where which state stands in the filter's mean.

use super::motion::INS_STATES;

/// Bias of the field sensor.
pub(super) const BIAS: usize = INS_STATES;
/// Displacement of the map's features, east; north is the next.
pub(super) const REGISTRATION: usize = INS_STATES + 1;
/// States without the coefficients of the vehicle's own field, which are the last.
pub(super) const STATES: usize = INS_STATES + 3;
