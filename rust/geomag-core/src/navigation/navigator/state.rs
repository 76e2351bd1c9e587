//! What the navigator carries from step to step, how it is made and saved.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::batch::{Batch, Chosen};
use super::doubt::{LevelShift, Stuck};
use super::filter::{ErrorFilter, FilterScratch};
use super::integrity::{Radius, RunningNis, widening};
use super::law::MapLaw;
use super::motion::{ACCELEROMETER, FASTEST_M_S, GYRO, POSITION, TILT, VELOCITY};
use super::options::{NavigatorMethod, NavigatorOptions};
use super::outcome::{Inputs, NavigatorStatus, Reason};
use super::smooth::Record;
use super::states::{BIAS, STATES};
use super::watch::Watch;
use crate::bounds::require_place;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::state::Saved;

/// What was indicated at the newest step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Newest {
    pub time_s: f64,
    pub x: f64,
    pub y: f64,
    pub velocity_m_s: [f64; 2],
    pub heading_rad: f64,
}

/// Everything that changes from step to step, and what was asked for.
#[allow(clippy::struct_excessive_bools)] // independent facts about the flight so far
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct NavigatorState {
    pub options: NavigatorOptions,
    pub filter: ErrorFilter,
    pub batch: Batch,
    pub running: RunningNis,
    pub watch: Watch,
    pub stuck: Stuck,
    pub shift: LevelShift,
    pub newest: Option<Newest>,
    pub inputs: Inputs,
    pub status: NavigatorStatus,
    pub reason: Reason,
    /// Time of the newest reading that the map has a value for.
    pub heard_s: Option<f64>,
    pub off_map: bool,
    pub is_stuck: bool,
    /// Whether the newest single reading was far off.
    pub startled: bool,
    pub tracked: bool,
    pub last_fix_s: Option<f64>,
    pub resets: u32,
    pub steps: u64,
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
    pub(super) field: Arc<dyn Field>,
    pub(super) law: MapLaw,
    pub(super) radius: Radius,
    pub(super) widening: f64,
    pub(super) scratch: FilterScratch,
    pub(super) chosen: Chosen,
    /// Slopes of the newest measurement, by state.
    pub(super) slopes: Vec<(usize, f64)>,
    /// Slopes are those of the field at the mean itself.
    pub(super) exact_slopes: bool,
    /// What the filter did, where it is to be smoothed.
    pub(super) record: Option<Record>,
    pub(super) state: NavigatorState,
}

impl Saved for NavigatorState {
    const NAME: &'static str = "Navigator";

    fn check(&self) -> Result<()> {
        self.options.validate()?;
        let newest_is_sound = self.newest.is_none_or(|n| {
            // The field, and with it the kind of the coordinates, is not known here.
            require_place("place", false, [n.x, n.y]).is_ok()
                && n.velocity_m_s[0].hypot(n.velocity_m_s[1]) <= FASTEST_M_S
                && [n.time_s, n.heading_rad].iter().all(|v| v.is_finite())
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
        if options.method != NavigatorMethod::Navigator {
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
        let mut filter = ErrorFilter::new(&variances);
        filter.set(POSITION, POSITION + 1, options.covariance_m2[0][1]);
        for i in 0..terms {
            for j in 0..=i {
                filter.set(STATES + i, STATES + j, options.terms_covariance[i * terms + j]);
            }
        }
        let state = NavigatorState {
            options,
            filter,
            batch: Batch::default(),
            running: RunningNis::new(),
            watch: Watch::new(),
            stuck: Stuck::default(),
            shift: LevelShift::default(),
            newest: None,
            inputs: Inputs::Full,
            status: NavigatorStatus::Acquiring,
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

    fn from_state(field: Arc<dyn Field>, state: NavigatorState) -> Result<Self> {
        let places = [("start", state.options.start), ("newest place", state.newest.map(|n| [n.x, n.y]))];
        for (what, place) in places {
            if let Some(place) = place {
                require_place(what, field.geographic(), place)?;
            }
        }
        let law = MapLaw::new(field.as_ref(), &state.options);
        let textbook = state.options.method != NavigatorMethod::Navigator;
        let risk = state.options.integrity_risk;
        let (probability, widening) = if textbook { (1.0 - risk, 1.0) } else { (0.99, widening(risk)?) };
        Ok(Self {
            field,
            law,
            radius: Radius::new(probability),
            widening,
            scratch: FilterScratch::default(),
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
    pub fn status(&self) -> NavigatorStatus {
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
    pub(super) fn own_m2(&self) -> [[f64; 2]; 2] {
        let f = &self.state.filter;
        let cross = f.at(POSITION, POSITION + 1);
        [[f.at(POSITION, POSITION), cross], [cross, f.at(POSITION + 1, POSITION + 1)]]
    }

    /// The covariance that is reported.
    pub(super) fn reported_m2(&self) -> [[f64; 2]; 2] {
        let ours = self.state.options.method == NavigatorMethod::Navigator;
        let factor = if ours { self.state.running.factor() } else { 1.0 };
        self.own_m2().map(|row| row.map(|c| factor * c))
    }

    /// Map units per metre at a latitude.
    pub(super) fn per_metre(&self, y: f64) -> [f64; 2] {
        self.field.metres_per_unit(y).map(|m| 1.0 / m)
    }

    /// The place that a position error of the INS leaves, map units.
    pub(super) fn corrected(&self, x: f64, y: f64, error_m: [f64; 2]) -> [f64; 2] {
        let [_, north] = self.per_metre(y);
        let truer = y - error_m[1] * north;
        let [east, north] = self.per_metre(0.5 * (y + truer));
        [x - error_m[0] * east, y - error_m[1] * north]
    }
    /// Writes down a measurement that is about to be used, for smoothing.
    pub(super) fn note_measurement(&mut self, slopes: &[(usize, f64)], variance: f64, innovation: f64) {
        if let Some(record) = &mut self.record {
            record.measured(slopes, &self.scratch.cross, innovation, variance);
        }
    }

    /// Writes down that position and bias are about to be replaced.
    pub(super) fn note_reset(&mut self) {
        if let Some(record) = &mut self.record {
            record.replaced(&[POSITION, POSITION + 1, BIAS]);
        }
    }
}
