//! Fixes fed back to an inertial navigation system: a linear, horizontal filter of its error.

use nalgebra::{DMatrix, DVector, dmatrix};
use serde::{Deserialize, Serialize};

use crate::bounds::require_place;
use crate::error::{Error, Result, require_finite, require_not_negative, require_positive};
use crate::fix::Fix;
use crate::frame::{displacement_m, metres_per_degree};
use crate::kalman::error_state::ErrorStateFilter;
use crate::state::Saved;

/// The options of INS feedback, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! ins_feedback_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            model [
                (position_sigma_m: number = 500.0; "float";
                    "Position error at the start, each axis, metres.")
                (velocity_sigma_m_s: number = 0.5; "float";
                    "Velocity error at the start, each axis, metres per second.")
                (heading_sigma_deg: number = 0.1; "float";
                    "Heading error at the start, degrees.")
                (position_walk_m_sqrt_s: number = 0.1; "float";
                    "Root power density of the position's random walk, m / sqrt(s).")
                (velocity_walk_m_s_sqrt_s: number = 0.001; "float";
                    "Root power density of the velocity's random walk, (m/s) / sqrt(s).")
                (heading_walk_deg_sqrt_s: number = 0.0005; "float";
                    "Root power density of the heading's random walk, degrees / sqrt(s).")
                (velocity_time_constant_s: reach = None; "float, optional";
                    "Time after which a velocity error has forgotten itself (first-order Gauss-Markov), seconds; never by default: a pure"
                    "random walk.")
            ]
            stream [
                (geographic: flag = false; "bool";
                    "Positions are longitude and latitude.")
                (gate_probability: number = 0.999; "float";
                    "Share of good fixes that the gate lets through.")
            ]
        }
    };
}

macro_rules! ins_error_model {
    (model $model:tt stream $stream:tt) => {
        record! { {
            /// What is known of an INS: how wrong it is at the start, and how fast it gets worse. The default is one of about one nautical mile an hour.
            InsErrorModel
        } model $model }
    };
}

ins_feedback_options!(ins_error_model);

impl InsErrorModel {
    fn check(&self) -> Result<()> {
        require_not_negative("position_sigma_m", self.position_sigma_m)?;
        require_not_negative("velocity_sigma_m_s", self.velocity_sigma_m_s)?;
        require_not_negative("heading_sigma_deg", self.heading_sigma_deg)?;
        require_not_negative("position_walk_m_sqrt_s", self.position_walk_m_sqrt_s)?;
        require_not_negative("velocity_walk_m_s_sqrt_s", self.velocity_walk_m_s_sqrt_s)?;
        require_not_negative("heading_walk_deg_sqrt_s", self.heading_walk_deg_sqrt_s)?;
        if self.velocity_time_constant_s.is_nan() || self.velocity_time_constant_s <= 0.0 {
            let got = self.velocity_time_constant_s;
            return Err(Error::invalid("velocity_time_constant_s", "a number > 0 (infinity allowed)", got));
        }
        Ok(())
    }
}

/// A corrected position with its covariance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CorrectedPosition {
    /// East, map units.
    pub x: f64,
    /// North, map units.
    pub y: f64,
    /// True minus indicated, metres `[east, north]`.
    pub offset_m: [f64; 2],
    /// Covariance, square metres, east-north.
    pub covariance_m2: [[f64; 2]; 2],
}

/// One step of the feedback.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FeedbackStep {
    /// As predicted, before any fix of this step.
    pub before: CorrectedPosition,
    /// After the fix of this step; as before where there was none or it was refused.
    pub after: CorrectedPosition,
    /// Normalised innovation squared of the fix (chi-square, two degrees of freedom); `None` without a fix.
    pub nis: Option<f64>,
    /// Whether a fix was used.
    pub accepted: bool,
}

/// The horizontal error of an INS, followed from fix to fix.
///
/// State: position error (east, north; true minus indicated, metres), velocity error (m/s), heading error (radians,
/// clockwise). A heading error h turns the indicated velocity: `de/dt = dv_e + h v_n`, `dn/dt = dv_n - h v_e`: the law of
/// dead reckoning (odometer, log, airspeed); an INS's heading error acts through the Earth's rate and the turns. Velocity
/// errors are a first-order Gauss-Markov process or a random walk, heading a random walk; position has noise of its own
/// for what the model leaves out (Groves, section 14.2, reduced to the horizontal plane). A fix is tested by its
/// normalised innovation and refused beyond the gate.
///
/// ```
/// use geomag_core::navigation::ins_feedback::{InsErrorModel, InsFeedback};
/// let mut feedback = InsFeedback::new(InsErrorModel::default(), false, 0.999)?;
/// feedback.step(0.0, 0.0, 0.0, None)?;
/// let fix = ([300.0, -200.0], [[2500.0, 0.0], [0.0, 2500.0]]);
/// let step = feedback.step(60.0, 600.0, 0.0, Some(fix))?;
/// assert!(step.accepted && (step.after.offset_m[0] - 300.0).abs() < 10.0);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InsFeedback {
    model: InsErrorModel,
    geographic: bool,
    gate: f64,
    filter: ErrorStateFilter,
    last: Option<(f64, [f64; 2])>,
    accepted: usize,
    refused: usize,
}

impl Saved for InsFeedback {
    const NAME: &'static str = "InsFeedback";

    fn check(&self) -> Result<()> {
        self.model.check()?;
        require_positive("gate", self.gate)?;
        self.filter.check(5)?;
        match self.last {
            None => Ok(()),
            Some((time_s, place)) => {
                require_finite("time_s", &[time_s])?;
                require_place("last", self.geographic, place)
            }
        }
    }
}

impl InsFeedback {
    /// A filter of an INS with the given error model.
    ///
    /// `geographic` says that positions are longitude and latitude; `gate_probability` is the share of good fixes that
    /// the gate lets through.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a negative number or a probability outside (0, 1).
    pub fn new(model: InsErrorModel, geographic: bool, gate_probability: f64) -> Result<Self> {
        model.check()?;
        if !(gate_probability > 0.0 && gate_probability < 1.0) {
            return Err(Error::invalid("gate_probability", "a number between 0 and 1", gate_probability));
        }
        let variance = |s: f64| s * s;
        let [p, v, h] = [
            variance(model.position_sigma_m),
            variance(model.velocity_sigma_m_s),
            variance(model.heading_sigma_deg.to_radians()),
        ];
        let covariance = DMatrix::from_diagonal(&DVector::from_vec(vec![p, p, v, v, h]));
        Ok(Self {
            model,
            geographic,
            // Chi-square with two degrees of freedom is exponential: its quantile is in closed form.
            gate: -2.0 * (-gate_probability).ln_1p(),
            filter: ErrorStateFilter::new(DVector::zeros(5), &covariance)?,
            last: None,
            accepted: 0,
            refused: 0,
        })
    }

    /// Advances to an indicated position at a time, and takes a fix of it where there is one: the offset (true minus
    /// indicated, metres east-north) and its covariance.
    ///
    /// # Errors
    /// [`Error::Invalid`] where time does not advance or the covariance is not symmetric, [`Error::NotFinite`], [`Error::NotPositiveDefinite`] for a fix
    /// whose covariance is not. The filter is then as before.
    #[allow(clippy::type_complexity)] // offset and covariance
    pub fn step(
        &mut self,
        time_s: f64,
        x: f64,
        y: f64,
        fix: Option<([f64; 2], [[f64; 2]; 2])>,
    ) -> Result<FeedbackStep> {
        require_finite("step [time_s, x, y]", &[time_s, x, y])?;
        require_place("step", self.geographic, [x, y])?;
        if let Some((offset, covariance)) = &fix {
            require_finite("fix offset_m", offset)?;
            crate::kalman::symmetric("fix covariance_m2", 2, covariance.as_flattened())?;
            require_positive("fix covariance_m2[0][0]", covariance[0][0])?;
            let det = covariance[0][0] * covariance[1][1] - covariance[0][1] * covariance[1][0];
            if det <= 0.0 {
                return Err(Error::NotPositiveDefinite {
                    what: "fix covariance_m2".into(),
                    detail: format!("determinant {det}"),
                });
            }
        }
        let mut filter = self.filter.clone();
        if let Some((last_time, last_point)) = self.last {
            let dt = time_s - last_time;
            if dt <= 0.0 {
                return Err(Error::invalid("time_s", format!("a time after {last_time}"), time_s));
            }
            let moved = displacement_m(self.geographic, last_point, [x, y]);
            self.predict(&mut filter, dt, moved)?;
        }
        let before = self.corrected(&filter, x, y);
        let (mut nis, mut accepted) = (None, false);
        if let Some((offset, covariance)) = fix {
            let mut matrix = DMatrix::zeros(2, 5);
            matrix[(0, 0)] = 1.0;
            matrix[(1, 1)] = 1.0;
            let noise = dmatrix![covariance[0][0], covariance[0][1]; covariance[1][0], covariance[1][1]];
            let update = filter.update(&DVector::from_column_slice(&offset), &matrix, &noise, self.gate)?;
            nis = Some(update.nis);
            accepted = update.accepted;
            self.accepted = self.accepted.saturating_add(usize::from(accepted));
            self.refused = self.refused.saturating_add(usize::from(!accepted));
        }
        let after = self.corrected(&filter, x, y);
        self.filter = filter;
        self.last = Some((time_s, [x, y]));
        Ok(FeedbackStep { before, after, nis, accepted })
    }

    /// [`InsFeedback::step`] with a matcher's answer for this very position. An answer that is no fix, or that has no
    /// covariance and is given none, is not used.
    ///
    /// # Errors
    /// As [`InsFeedback::step`].
    pub fn step_with_fix(
        &mut self,
        time_s: f64,
        x: f64,
        y: f64,
        fix: &Fix,
        covariance_m2: Option<[[f64; 2]; 2]>,
    ) -> Result<FeedbackStep> {
        let covariance = covariance_m2.or(fix.covariance_m2);
        let usable = covariance.filter(|_| fix.ok());
        let offset = if usable.is_some() { displacement_m(self.geographic, [x, y], [fix.x, fix.y]) } else { [0.0; 2] };
        self.step(time_s, x, y, usable.map(|c| (offset, c)))
    }

    fn predict(&self, filter: &mut ErrorStateFilter, dt: f64, moved: [f64; 2]) -> Result<()> {
        let m = &self.model;
        // Over one step: velocity error decays by a, and moves the position by tau (1 - a).
        let tau = m.velocity_time_constant_s;
        let (a, lever) = if tau.is_infinite() { (1.0, dt) } else { ((-dt / tau).exp(), tau * -(-dt / tau).exp_m1()) };
        let mut f = DMatrix::identity(5, 5);
        for axis in 0..2 {
            f[(axis, axis + 2)] = lever;
            f[(axis + 2, axis + 2)] = a;
        }
        f[(0, 4)] = moved[1];
        f[(1, 4)] = -moved[0];
        // Noise of the velocity reaches the position through its integral; for steps that are short against tau these
        // are the integrals of a random walk, which bound the decaying ones.
        let (qp, qv) = (m.position_walk_m_sqrt_s.powi(2), m.velocity_walk_m_s_sqrt_s.powi(2));
        let qh = m.heading_walk_deg_sqrt_s.to_radians().powi(2);
        let mut q = DMatrix::zeros(5, 5);
        for axis in 0..2 {
            q[(axis, axis)] = qp * dt + qv * dt.powi(3) / 3.0;
            q[(axis, axis + 2)] = qv * dt * dt / 2.0;
            q[(axis + 2, axis)] = qv * dt * dt / 2.0;
            q[(axis + 2, axis + 2)] = qv * dt;
        }
        // The heading's walk turns the step's own displacement, on the average half way through.
        let turned = [moved[1], -moved[0]];
        for i in 0..2 {
            for j in 0..2 {
                q[(i, j)] += qh * dt * turned[i] * turned[j] / 3.0;
            }
            q[(i, 4)] += qh * dt * turned[i] / 2.0;
            q[(4, i)] += qh * dt * turned[i] / 2.0;
        }
        q[(4, 4)] = qh * dt;
        filter.predict(&f, &q)
    }

    fn corrected(&self, filter: &ErrorStateFilter, x: f64, y: f64) -> CorrectedPosition {
        let (s, c) = (filter.state(), filter.covariance());
        let [east, north] = if self.geographic { metres_per_degree(y) } else { [1.0, 1.0] };
        CorrectedPosition {
            x: x + s[0] / east,
            y: y + s[1] / north,
            offset_m: [s[0], s[1]],
            covariance_m2: [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]],
        }
    }

    /// Estimated velocity error, m/s east and north.
    pub fn velocity_error_m_s(&self) -> [f64; 2] {
        [self.filter.state()[2], self.filter.state()[3]]
    }

    /// Estimated heading error, degrees clockwise.
    pub fn heading_error_deg(&self) -> f64 {
        self.filter.state()[4].to_degrees()
    }

    /// The filter itself: states east, north (m), velocity east, north (m/s), heading (rad).
    pub fn filter(&self) -> &ErrorStateFilter {
        &self.filter
    }

    /// Fixes used so far.
    pub fn accepted(&self) -> usize {
        self.accepted
    }

    /// Fixes refused so far.
    pub fn refused(&self) -> usize {
        self.refused
    }

    /// Whether positions are longitude and latitude.
    pub fn geographic(&self) -> bool {
        self.geographic
    }
}
