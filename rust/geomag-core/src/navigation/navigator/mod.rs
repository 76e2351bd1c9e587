//! Map-aided inertial navigation over hours: an INS, readings of the field, and a map of it.
//!
//! An error-state Kalman filter of the INS (position, velocity, tilts, sensor biases), of the field sensor's bias and of the displacement of the
//! map's features. What makes its covariance hold on maps of real surveys, where textbook filters are sure of the wrong place:
//!
//! - readings are gathered over one and a half correlation lengths of the map's errors and used as one measurement, their mean;
//! - the field is linearised statistically over the whole ellipse of where the vehicle may be, once; what the plane leaves is noise;
//! - noise is that of the map, not of the sensor: R = r0^2 + (k sigma)^2 + 2 Omega, with Student-t weights;
//! - features of the map may stand displaced, by states of their own;
//! - the running mean of the innovations' normalised squares scales the covariance that is reported, and leaves the filter's own alone.
//!
//! Sources: Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems*, ch. 14 and 16 (error-state filter on a
//! map); Hollowell, *Heli/SITAN*, IEEE PLANS 1990 (terrain); Canciani & Raquet, *Navigation* 63 (2016) 111 (magnetic); the noise law of gridded
//! surveys is geomag's own.

// Five floors, lowest first; on each, from left to right, the later may use the earlier. tests/test_architecture.py reads them.
mod doubt;
mod ins;
mod integrity;
mod motion;
mod outcome;
mod owed;
mod states;

mod batch;
mod filter;
mod law;
mod options;
mod plan;
mod smooth;
mod watch;

mod state;

mod carry;
mod correct;
mod judge;
mod matcher;
mod measure;

mod bound;
mod flight;
mod particles;
mod step;

#[cfg(test)]
mod tests;

pub use correct::Correction;
pub use flight::{FlightInput, NavigatedFlight, SmoothedPlace, Smoothing, navigate};
pub use ins::{GRAVITY_M_S2, InsModel};
pub use integrity::radii_m;
pub use motion::EARTH_RATE_RAD_S;
pub use options::{NavigatorMethod, NavigatorOptions};
pub use outcome::{Indicated, Inputs, NavigatorOutcome, NavigatorStatus, NavigatorStep, Reason};
pub use plan::MatcherPlan;
pub use state::Navigator;
