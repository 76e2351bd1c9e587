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

mod batch;
mod carry;
mod correct;
mod doubt;
mod filter;
mod flight;
mod ins;
mod integrity;
mod law;
mod linear;
mod measure;
mod motion;
mod options;
mod outcome;
mod particles;
mod smooth;
mod step;
#[cfg(test)]
mod tests;
mod watch;

pub use correct::Correction;
pub use flight::{Flight, FlightInput, SmoothedPlace, Smoothing, navigate};
pub use ins::{GRAVITY_M_S2, InsModel};
pub use integrity::radii_m;
pub use motion::EARTH_RATE_RAD_S;
pub use options::{Method, NavigatorOptions};
pub use outcome::{Indicated, Inputs, NavigatorStep, Outcome, Reason, Status};
pub use watch::MatcherPlan;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::field::Field;
use crate::state::Saved;
use batch::{Batch, Chosen};
use doubt::{Shift, Stuck};
use filter::{Filter, Scratch};
use integrity::{Radius, RunningNis, widening};
use law::MapLaw;
use motion::{ACCELEROMETER, GYRO, INS_STATES, POSITION, TILT, VELOCITY};
use smooth::Record;
use watch::Watch;

/// Bias of the field sensor.
const BIAS: usize = INS_STATES;
/// Displacement of the map's features, east; north is the next.
const REGISTRATION: usize = INS_STATES + 1;
/// States without the coefficients of the vehicle's own field, which are the last.
const STATES: usize = INS_STATES + 3;

/// What was indicated at the newest step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Newest {
    time_s: f64,
    x: f64,
    y: f64,
    velocity_m_s: [f64; 2],
    heading_rad: f64,
}

/// Everything that changes from step to step, and what was asked for.
#[allow(clippy::struct_excessive_bools)] // independent facts about the flight so far
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct State {
    options: NavigatorOptions,
    filter: Filter,
    batch: Batch,
    running: RunningNis,
    watch: Watch,
    stuck: Stuck,
    shift: Shift,
    newest: Option<Newest>,
    inputs: Inputs,
    status: Status,
    reason: Reason,
    /// Time of the newest reading that the map has a value for.
    heard_s: Option<f64>,
    off_map: bool,
    is_stuck: bool,
    /// Whether the newest single reading was far off.
    startled: bool,
    tracked: bool,
    last_fix_s: Option<f64>,
    resets: u32,
    steps: u64,
}

/// Corrects an INS with readings of a field, step by step.
///
/// Give it what the INS indicates and what the sensor reads, at any rate; it answers with the corrected place, the covariance to be believed
/// and a radius that the error exceeds with the probability asked for. The INS is not told (open loop): it may be corrected from the
/// answers or not.
///
/// ```
/// use std::sync::Arc;
/// use geomag_core::grid::{GridMap, GridValues, Interpolation, MapSigma};
/// use geomag_core::navigation::navigator::{Indicated, Navigator, NavigatorOptions};
/// let axis: Vec<f64> = (0..200).map(|i| f64::from(i) * 100.0).collect();
/// let values = (0..40_000)
///     .map(|k| 90.0 * (f64::from(k % 200) / 9.0).sin() + 80.0 * (f64::from(k / 200) / 7.0).cos())
///     .collect();
/// let map = GridMap::new(GridValues::F64(values), &axis, &axis, false)?.with_sigma(Some(MapSigma::Constant(0.0)))?;
/// let map = Arc::new(map);
/// let mut navigator = Navigator::new(map.clone(), NavigatorOptions::new(100.0))?;
/// let mut step = None;
/// for k in 0..200 {
///     let (x, y) = (2000.0 + 70.0 * f64::from(k), 8000.0);
///     step = Some(navigator.step(&Indicated {
///         time_s: f64::from(k),
///         x: x + 80.0,
///         y: y - 60.0,
///         velocity_m_s: Some([70.0, 0.0]),
///         heading_deg: Some(90.0),
///         height_m: None,
///         value: Some(map.sample(x, y, Interpolation::Bilinear)),
///     })?);
/// }
/// let step = step.unwrap();
/// assert!((step.x - 15_930.0).hypot(step.y - 8000.0) < step.protection_level_m);
/// assert_eq!(step.status.as_str(), "tracking");
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Navigator {
    field: Arc<dyn Field>,
    law: MapLaw,
    radius: Radius,
    widening: f64,
    scratch: Scratch,
    chosen: Chosen,
    /// Slopes of the newest measurement, by state.
    slopes: Vec<(usize, f64)>,
    /// Slopes are those of the field at the mean itself.
    exact_slopes: bool,
    /// What the filter did, where it is to be smoothed.
    record: Option<Record>,
    state: State,
}

impl Saved for State {
    const NAME: &'static str = "Navigator";

    fn check(&self) -> Result<()> {
        self.options.validate()?;
        let newest_is_sound = self.newest.is_none_or(|n| {
            [n.time_s, n.x, n.y, n.velocity_m_s[0], n.velocity_m_s[1], n.heading_rad].iter().all(|v| v.is_finite())
        });
        let terms = self.options.terms();
        let whole = self.filter.is_whole(STATES + terms)
            && self.batch.is_whole(terms)
            && self.running.is_sound()
            && self.watch.is_whole()
            && newest_is_sound;
        if whole { Ok(()) } else { Err(Error::invalid("its numbers", "some that belong together", "others")) }
    }
}

impl Navigator {
    /// A navigator that has not been told anything yet.
    ///
    /// # Errors
    /// As [`NavigatorOptions::validate`].
    pub fn new(field: Arc<dyn Field>, mut options: NavigatorOptions) -> Result<Self> {
        options.validate()?;
        if options.method != Method::Navigator {
            (options.nu, options.matcher) = (f64::INFINITY, None);
        }
        let terms = options.terms();
        let mut variances = vec![0.0; STATES + terms];
        for axis in 0..2 {
            variances[POSITION + axis] = options.covariance_m2[axis][axis];
            variances[VELOCITY + axis] = options.ins.velocity_sigma_m_s.powi(2);
            variances[TILT + axis] = (1e-3 * options.ins.tilt_sigma_mrad).powi(2);
            variances[ACCELEROMETER + axis] = options.ins.accelerometer_m_s2().powi(2);
        }
        variances[TILT + 2] = (1e-3 * options.ins.heading_sigma_mrad).powi(2);
        for axis in 0..3 {
            variances[GYRO + axis] = options.ins.gyro_rad_s().powi(2);
        }
        variances[BIAS] = options.bias_sigma.powi(2);
        let mut filter = Filter::new(&variances);
        filter.set(POSITION, POSITION + 1, options.covariance_m2[0][1]);
        for i in 0..terms {
            for j in 0..=i {
                filter.set(STATES + i, STATES + j, options.terms_covariance[i * terms + j]);
            }
        }
        let state = State {
            options,
            filter,
            batch: Batch::default(),
            running: RunningNis::new(),
            watch: Watch::new(),
            stuck: Stuck::default(),
            shift: Shift::default(),
            newest: None,
            inputs: Inputs::Full,
            status: Status::Acquiring,
            reason: Reason::StartUncertain,
            heard_s: None,
            off_map: false,
            is_stuck: false,
            startled: false,
            tracked: false,
            last_fix_s: None,
            resets: 0,
            steps: 0,
        };
        Self::from_state(field, state)
    }

    fn from_state(field: Arc<dyn Field>, state: State) -> Result<Self> {
        let law = MapLaw::new(field.as_ref(), &state.options);
        let textbook = state.options.method != Method::Navigator;
        let risk = state.options.integrity_risk;
        let (probability, widening) = if textbook { (1.0 - risk, 1.0) } else { (0.99, widening(risk)?) };
        Ok(Self {
            field,
            law,
            radius: Radius::new(probability),
            widening,
            scratch: Scratch::default(),
            chosen: Chosen::default(),
            slopes: Vec::new(),
            exact_slopes: textbook,
            record: None,
            state,
        })
    }

    /// Everything that the navigator carries, as bytes; the field is not in them.
    ///
    /// # Errors
    /// [`Error::State`].
    pub fn save(&self) -> Result<Vec<u8>> {
        crate::state::save(&self.state)
    }

    /// A navigator that goes on where [`Navigator::save`] left off, bit for bit, on the same field.
    ///
    /// # Errors
    /// [`Error::State`] for bytes that are no navigator's.
    pub fn restore(field: Arc<dyn Field>, bytes: &[u8]) -> Result<Self> {
        Self::from_state(field, crate::state::load(bytes)?)
    }

    /// The field that is navigated on.
    pub fn field(&self) -> &Arc<dyn Field> {
        &self.field
    }

    /// What was asked for.
    pub fn options(&self) -> &NavigatorOptions {
        &self.state.options
    }

    /// Which INS output there was at the newest step.
    pub fn inputs(&self) -> Inputs {
        self.state.inputs
    }

    /// How it stands to the map.
    pub fn status(&self) -> Status {
        self.state.status
    }

    /// Steps taken.
    pub fn steps(&self) -> u64 {
        self.state.steps
    }

    /// Indicated minus true, as estimated: position (m) and velocity (m/s) east and north, tilts about north, east and down (rad), gyro
    /// biases forward, right and down (rad/s), accelerometer biases forward and right (m/s2), sensor bias (value units), displacement of the
    /// map's features east and north (m), then the coefficients of the vehicle's own field.
    pub fn mean(&self) -> &[f64] {
        self.state.filter.mean()
    }

    /// Covariance of two of these states.
    pub fn covariance(&self, i: usize, j: usize) -> f64 {
        let n = self.state.filter.len();
        if i < n && j < n { self.state.filter.at(i, j) } else { f64::NAN }
    }

    /// The filter's own covariance of the position, square metres.
    fn own_m2(&self) -> [[f64; 2]; 2] {
        let f = &self.state.filter;
        let cross = f.at(POSITION, POSITION + 1);
        [[f.at(POSITION, POSITION), cross], [cross, f.at(POSITION + 1, POSITION + 1)]]
    }

    /// The covariance that is reported.
    fn reported_m2(&self) -> [[f64; 2]; 2] {
        let ours = self.state.options.method == Method::Navigator;
        let factor = if ours { self.state.running.factor() } else { 1.0 };
        self.own_m2().map(|row| row.map(|c| factor * c))
    }
}
