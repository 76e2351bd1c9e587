//! Navigation on a field without an INS: speed, course and a field sensor [Zhao et al. 2012].
//!
//! Motion: `east += dt v sin c`, `north += dt v cos c`, with speed `v` and course `c` as indicated plus their estimated
//! errors. Measurement: the field at the position plus the sensor's estimated bias.

mod filter;
mod options;
mod outcome;

pub use options::{FieldNavigatorMethod, FieldNavigatorOptions, GATE};
pub use outcome::{FieldNavigatorOutcome, FieldNavigatorStep};

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::sensing::Sensing;
use crate::bounds::{require_place, require_values};
use crate::error::{Error, Result, require_finite, require_not_negative};
use crate::kalman::{
    Estimate, ExtendedKalmanFilter, Innovation, MAX_STATES, UnscentedKalmanFilter, chi_square_quantile,
};
use crate::state::Saved;
use crate::statistics::chi_square_survival;
use filter::{FieldFilter, Layout};

/// Innovations over which the filter is judged.
const WINDOW: usize = 20;
/// Rejections in a row that count as divergence.
const MANY_REJECTIONS: u32 = 10;
/// Probability with which an honest filter is called divergent at a step.
const DIVERGENCE: f64 = 1e-5;

/// Latitude beyond which east and north are no axes to count metres on.
const MOST_LATITUDE_DEG: f64 = 89.9;

/// Everything that changes from step to step, and what was asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct FieldNavigatorState {
    options: FieldNavigatorOptions,
    layout: Layout,
    filter: FieldFilter,
    /// Map coordinates that the state's metres are counted from: the start on geographic fields, moved with the vehicle.
    anchor: [f64; 2],
    time_s: f64,
    steps: u64,
    rejections: u32,
    window: Vec<(f64, usize)>,
    next: usize,
}

/// Navigates on a field: predict with speed and course, correct with a reading.
///
/// For a slow vehicle with a log, a compass and a magnetometer in a field steep enough for its noise; what can be reached
/// is said by [`FieldNavigator::bound`] before anything sails. Not for a start that is uncertain by more than a fraction
/// of the field's wavelength: a Kalman filter follows one hypothesis; take a matcher first.
///
/// Places are map coordinates (see [`Sensing`]); on geographic fields the state is kept in metres about the vehicle.
///
/// ```
/// use std::sync::Arc;
/// use geomag_core::grid::{GridMap, GridValues, Interpolation};
/// use geomag_core::navigation::field_navigator::{FieldNavigator, FieldNavigatorOptions};
/// use geomag_core::navigation::sensing::Sensing;
/// let axis: Vec<f64> = (0..50).map(|i| f64::from(i) * 20.0).collect();
/// let values = (0..2500).map(|k| 90.0 * (f64::from(k % 50) / 7.0).sin() + 80.0 * (f64::from(k / 50) / 6.0).cos()).collect();
/// let map = Arc::new(GridMap::new(GridValues::F64(values), &axis, &axis, false)?);
/// let truth = |k: u32| [300.0 + 5.0 * f64::from(k), 500.0];
/// let options = FieldNavigatorOptions { start: [310.0, 495.0], covariance_m2: [[100.0, 0.0], [0.0, 100.0]], ..Default::default() };
/// let mut navigator = FieldNavigator::new(Sensing::map(map.clone(), Interpolation::Bicubic), options)?;
/// for k in 1..60 {
///     let [x, y] = truth(k);
///     navigator.step(1.0, 5.0, 90.0, Some(&[map.sample(x, y, Interpolation::Bicubic)]))?;
/// }
/// let [x, y] = navigator.position();
/// assert!((x - truth(59)[0]).hypot(y - 500.0) < 1.0);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct FieldNavigator {
    sensing: Sensing,
    /// Bounds of the NIS for one, two, ... numbers.
    gates: Vec<f64>,
    state: FieldNavigatorState,
}

impl Saved for FieldNavigatorState {
    const NAME: &'static str = "FieldNavigator";

    fn check(&self) -> Result<()> {
        let numbers = match self.layout.bias {
            Some(first) => self.layout.len.saturating_sub(first),
            None => self.options.reading_sigma.len(),
        };
        if numbers > MAX_STATES {
            return Err(Error::invalid("numbers in a reading", format!("at most {MAX_STATES}"), numbers));
        }
        self.options.check(numbers)?;
        if self.layout != Layout::new(&self.options, numbers) {
            return Err(Error::invalid("states", "those of the options", format!("{:?}", self.layout)));
        }
        self.filter.check()?;
        require_place("anchor", false, self.anchor)?;
        require_not_negative("time_s", self.time_s)?;
        let odd = |w: &(f64, usize)| !(w.0 >= 0.0) || w.1 == 0 || w.1 > MAX_STATES;
        if self.window.len() > WINDOW || self.next >= WINDOW || self.window.iter().any(odd) {
            let needed = format!("at most {WINDOW} numbers >= 0");
            return Err(Error::invalid("innovations", needed, format!("{:?}", self.window)));
        }
        Ok(())
    }
}

impl FieldNavigator {
    /// A navigator at its start.
    ///
    /// # Errors
    /// [`Error::Invalid`], [`Error::NotFinite`], [`Error::Shape`], [`Error::NotPositiveDefinite`] for options that make no
    /// filter.
    pub fn new(sensing: Sensing, options: FieldNavigatorOptions) -> Result<Self> {
        let numbers = sensing.len();
        options.check(numbers)?;
        require_place("start", sensing.geographic(), options.start)?;
        if sensing.geographic() && options.start[1].abs() > MOST_LATITUDE_DEG {
            let needed = format!("a latitude within {MOST_LATITUDE_DEG} degrees of the equator");
            return Err(Error::invalid("start", needed, options.start[1]));
        }
        let layout = Layout::new(&options, numbers);
        let n = layout.len;
        let mut covariance = DMatrix::zeros(n, n);
        for (i, row) in options.covariance_m2.iter().enumerate() {
            for (j, &c) in row.iter().enumerate() {
                covariance[(i, j)] = c;
            }
        }
        if let Some(i) = layout.speed {
            covariance[(i, i)] = options.speed_sigma_m_s.powi(2);
        }
        if let Some(i) = layout.heading {
            covariance[(i, i)] = options.heading_sigma_deg.to_radians().powi(2);
        }
        if let Some(first) = layout.bias {
            for i in first..first + numbers {
                covariance[(i, i)] = options.bias_sigma.powi(2);
            }
        }
        let geographic = sensing.geographic();
        let start = [sensing.wrap_x(options.start[0]), options.start[1]];
        let mut mean = vec![0.0; n];
        if !geographic {
            mean[..2].copy_from_slice(&start);
        }
        // The matrix is symmetric only if the caller's is, which the estimate checks.
        let estimate = Estimate::new(&mean, covariance.transpose().as_slice())?;
        let filter = match options.method {
            FieldNavigatorMethod::Unscented => {
                FieldFilter::Unscented(UnscentedKalmanFilter::from_estimate(estimate, options.scaling)?)
            }
            FieldNavigatorMethod::Extended => FieldFilter::Extended(ExtendedKalmanFilter::from_estimate(estimate)),
        };
        let state = FieldNavigatorState {
            layout,
            filter,
            anchor: if geographic { start } else { [0.0, 0.0] },
            time_s: 0.0,
            steps: 0,
            rejections: 0,
            window: Vec::new(),
            next: 0,
            options,
        };
        Self::from_state(sensing, state)
    }

    fn from_state(sensing: Sensing, state: FieldNavigatorState) -> Result<Self> {
        let gates = match state.options.gate {
            None => Vec::new(),
            Some(p) => (1..=sensing.len()).map(|dof| chi_square_quantile(p, dof)).collect::<Result<_>>()?,
        };
        if state.layout != Layout::new(&state.options, sensing.len())
            || state.filter.estimate().len() != state.layout.len
        {
            return Err(Error::State {
                what: "FieldNavigator".into(),
                detail: format!("it was saved with another sensor than one of {} numbers", sensing.len()),
            });
        }
        Ok(Self { sensing, gates, state })
    }

    /// Everything that the navigator carries, as bytes; the field is not in them.
    ///
    /// # Errors
    /// [`Error::State`].
    pub fn save(&self) -> Result<Vec<u8>> {
        crate::state::save(&self.state)
    }

    /// A navigator that goes on where [`FieldNavigator::save`] left off, bit for bit, on the same field.
    ///
    /// # Errors
    /// [`Error::State`].
    pub fn restore(sensing: Sensing, bytes: &[u8]) -> Result<Self> {
        Self::from_state(sensing, crate::state::load(bytes)?)
    }

    /// What is read, and of what.
    pub fn sensing(&self) -> &Sensing {
        &self.sensing
    }

    /// What was asked for.
    pub fn options(&self) -> &FieldNavigatorOptions {
        &self.state.options
    }

    /// Estimated place, map coordinates.
    pub fn position(&self) -> [f64; 2] {
        let mean = self.state.filter.estimate().mean();
        self.place(mean[0], mean[1])
    }

    /// Covariance of the place, square metres, east-north.
    pub fn covariance_m2(&self) -> [[f64; 2]; 2] {
        // The first two rows of the factor are all that it takes.
        let l = self.state.filter.estimate().factor();
        let cross = l[(1, 0)] * l[(0, 0)];
        [[l[(0, 0)].powi(2), cross], [cross, l[(1, 0)].powi(2) + l[(1, 1)].powi(2)]]
    }

    /// Mean and covariance of the whole state: east, north (metres; from the vehicle on geographic fields), then speed
    /// error (m/s), heading error (radians) and bias (field unit), those that are estimated.
    pub fn estimate(&self) -> &Estimate {
        self.state.filter.estimate()
    }

    /// True minus indicated speed, metres a second, and its standard deviation; `None` where it is not estimated.
    pub fn speed_error_m_s(&self) -> Option<(f64, f64)> {
        self.state.layout.speed.map(|i| self.element(i))
    }

    /// True minus indicated course, degrees, and its standard deviation; `None` where it is not estimated.
    pub fn heading_error_deg(&self) -> Option<(f64, f64)> {
        self.state.layout.heading.map(|i| {
            let (value, sigma) = self.element(i);
            (value.to_degrees(), sigma.to_degrees())
        })
    }

    /// Constant error of each number of the reading with its standard deviation; empty where it is not estimated.
    pub fn bias(&self) -> Vec<(f64, f64)> {
        let first = self.state.layout.bias;
        first.map_or_else(Vec::new, |first| (first..first + self.sensing.len()).map(|i| self.element(i)).collect())
    }

    fn element(&self, i: usize) -> (f64, f64) {
        let estimate = self.state.filter.estimate();
        (estimate.mean()[i], estimate.factor().row(i).norm())
    }

    /// Seconds since the start.
    pub fn time_s(&self) -> f64 {
        self.state.time_s
    }

    /// Steps taken.
    pub fn steps(&self) -> u64 {
        self.state.steps
    }

    /// The newest innovation.
    pub fn innovation(&self) -> Option<&Innovation> {
        self.state.filter.innovation()
    }

    /// Whether the innovations say that the filter has lost its way: ten readings in a row refused, or a mean NIS over
    /// the last twenty that an honest filter exceeds once in 100,000 steps.
    pub fn diverged(&self) -> bool {
        if self.state.rejections >= MANY_REJECTIONS {
            return true;
        }
        if self.state.window.len() < WINDOW {
            return false;
        }
        let (sum, dof) = self.state.window.iter().fold((0.0, 0), |(s, d), &(nis, dof)| (s + nis, d + dof));
        chi_square_survival(sum, dof as f64) < DIVERGENCE
    }

    /// Moves on by `dt_s` seconds with the indicated speed (metres a second) and course (degrees, clockwise from north)
    /// and takes in a reading, where there is one. Numbers of it that are NaN are left out.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Invalid`] (time running backwards), [`Error::Shape`] (another number of components
    /// than the sensor has), [`Error::NotPositiveDefinite`]; [`Error::Invalid`] where the way leads off the Earth or within a tenth
    /// of a degree of a pole. After an error nothing has moved.
    pub fn step(
        &mut self,
        dt_s: f64,
        speed_m_s: f64,
        course_deg: f64,
        reading: Option<&[f64]>,
    ) -> Result<FieldNavigatorStep> {
        require_not_negative("dt_s", dt_s)?;
        require_finite("speed_m_s, course_deg", &[speed_m_s, course_deg])?;
        let numbers = self.sensing.len();
        if let Some(reading) = reading {
            if reading.len() != numbers {
                return Err(Error::shape("reading", format!("({numbers},)"), format!("({},)", reading.len())));
            }
            // NaN is no reading.
            let readings: Vec<f64> = reading.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
            require_values("reading", &readings)?;
        }
        // All or nothing: after an error nothing has moved.
        let before = self.state.clone();
        let step = self.take(dt_s, [speed_m_s, course_deg], reading);
        if step.is_err() {
            self.state = before;
        }
        step
    }

    fn take(
        &mut self,
        dt_s: f64,
        [speed_m_s, course_deg]: [f64; 2],
        reading: Option<&[f64]>,
    ) -> Result<FieldNavigatorStep> {
        let numbers = self.sensing.len();
        self.predict(dt_s, speed_m_s, course_deg)?;
        self.require_room()?;
        self.state.time_s += dt_s;
        self.state.steps = self.state.steps.saturating_add(1);
        let kept: Vec<usize> = reading.map_or_else(Vec::new, |r| (0..numbers).filter(|&k| !r[k].is_nan()).collect());
        let (outcome, nis) = match reading {
            Some(reading) if !kept.is_empty() => self.update(reading, &kept)?,
            _ => (FieldNavigatorOutcome::Predicted, None),
        };
        if let Some(nis) = nis {
            let entry = (nis, kept.len());
            if self.state.window.len() < WINDOW {
                self.state.window.push(entry);
            } else {
                let next = self.state.next;
                self.state.window[next] = entry;
            }
            self.state.next = (self.state.next + 1) % WINDOW;
        }
        match outcome {
            FieldNavigatorOutcome::Updated => self.state.rejections = 0,
            FieldNavigatorOutcome::Rejected => self.state.rejections = self.state.rejections.saturating_add(1),
            FieldNavigatorOutcome::Predicted | FieldNavigatorOutcome::OffField => {}
        }
        self.require_room()?;
        self.follow();
        let [x, y] = self.position();
        Ok(FieldNavigatorStep {
            x,
            y,
            covariance_m2: self.covariance_m2(),
            outcome,
            nis,
            dof: kept.len(),
            diverged: self.diverged(),
        })
    }

    /// The Cramer-Rao bound of the position along a true path (map coordinates, one a step): the covariance that no
    /// unbiased filter with these noises can beat, square metres, east-north.
    ///
    /// The recursion of the posterior bound (Tichavsky, Muravchik & Nehorai 1998) for this motion: the extended filter's
    /// covariance with gradients at the truth. Starts from the present covariance; NaN in the field or its sigma counts as no reading.
    ///
    /// # Errors
    /// As [`FieldNavigator::step`].
    pub fn bound(&self, path: &[[f64; 2]], dt_s: f64, speed_m_s: f64, course_deg: f64) -> Result<Vec<[[f64; 2]; 2]>> {
        require_not_negative("dt_s", dt_s)?;
        require_finite("speed_m_s, course_deg", &[speed_m_s, course_deg])?;
        let n = self.state.layout.len;
        let mut filter = ExtendedKalmanFilter::from_estimate(self.state.filter.estimate().clone());
        let jacobian = self.motion_jacobian(filter.estimate().mean(), dt_s, speed_m_s, course_deg);
        let q = self.process_noise(dt_s);
        let numbers: Vec<usize> = (0..self.sensing.len()).collect();
        let mut out = Vec::with_capacity(path.len());
        for &[x, y] in path {
            let mean = filter.estimate().mean().to_vec();
            filter.predict(&mean, &jacobian, (&q * q.transpose()).as_slice())?;
            let expected = self.sensing.read_with_gradient(x, y);
            if expected.iter().all(|e| e.0.is_finite())
                && let Some(noise) = self.reading_noise([x, y], &numbers)
            {
                let h = self.measurement_jacobian(&expected, &numbers);
                let zero = vec![0.0; numbers.len()];
                filter.update(&zero, &zero, &h, (&noise * noise.transpose()).as_slice(), None)?;
            }
            let p = filter.estimate().covariance();
            debug_assert_eq!(p.nrows(), n);
            out.push([[p[(0, 0)], p[(0, 1)]], [p[(1, 0)], p[(1, 1)]]]);
        }
        Ok(out)
    }

    /// Refuses a place where there is no Earth, or none that its metres can be counted on.
    fn require_room(&self) -> Result<()> {
        let mean = self.state.filter.estimate().mean();
        let [ax, ay] = self.state.anchor;
        let scale = self.sensing.metres_per_unit(ay);
        let place = [ax + mean[0] / scale[0], ay + mean[1] / scale[1]];
        require_place("position", self.sensing.geographic(), place)?;
        if self.sensing.geographic() && place[1].abs() > MOST_LATITUDE_DEG {
            let needed = format!("a latitude within {MOST_LATITUDE_DEG} degrees of the equator");
            return Err(Error::invalid("position y", needed, place[1]));
        }
        Ok(())
    }

    /// Map coordinates of a state's east and north.
    fn place(&self, east: f64, north: f64) -> [f64; 2] {
        let [ax, ay] = self.state.anchor;
        let scale = self.sensing.metres_per_unit(ay);
        [self.sensing.wrap_x(ax + east / scale[0]), ay + north / scale[1]]
    }

    /// On geographic fields, moves the anchor to the vehicle, so that the metres are always counted where they are right.
    fn follow(&mut self) {
        if self.sensing.geographic() {
            let mean = self.state.filter.estimate().mean();
            let (east, north) = (mean[0], mean[1]);
            self.state.anchor = self.place(east, north);
            self.state.filter.estimate_mut().shift(&[-east, -north]);
        }
    }
}

#[cfg(test)]
mod tests;
