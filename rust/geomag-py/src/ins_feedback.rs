//! `InsFeedback` and its steps.

use geomag_core::error::Error;
use geomag_core::ins_feedback_options;
use geomag_core::navigation::ins_feedback::{CorrectedPosition, FeedbackStep, InsErrorModel, InsFeedback};
use pyo3::prelude::*;

use crate::arrays::{matrix, pair, shaped};
use crate::class::{Reduced, properties, reduced_to_bytes};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::lock::Shared;
use crate::options::old_name;
use crate::state;

fn covariance(object: &Bound<'_, PyAny>) -> PyRes<[[f64; 2]; 2]> {
    let (v, rows, columns) = matrix("covariance_m2", object)?;
    if (rows, columns) != (2, 2) {
        return Err(Error::shape("covariance_m2", "(2, 2) east-north", format!("({rows}, {columns})")).into());
    }
    Ok([[v[0], v[1]], [v[2], v[3]]])
}

/// A position of the INS corrected by what the filter knows of its error; `before` and `after` of a `FeedbackStep`.
///
/// `x`, `y` are the indicated position plus `offset_m`, in map units.
#[pyclass(frozen, name = "CorrectedPosition", module = "geomag")]
pub struct PyCorrectedPosition {
    inner: CorrectedPosition,
}

properties! {
    PyCorrectedPosition: position {
        /// East, map units.
        x: f64 = position.x;

        /// North, map units.
        y: f64 = position.y;

        /// True minus indicated, metres (east, north).
        offset_m: (f64, f64) = position.offset_m.into();

        /// Covariance, square metres, east-north.
        covariance_m2(py): PyRes<Bound<'py, PyAny>> = shaped(py, position.covariance_m2.concat(), &[2, 2]);
    }

    fn __repr__(&self) -> String {
        let c = &self.inner;
        let sigma = |i: usize| c.covariance_m2[i][i].max(0.0).sqrt();
        format!("CorrectedPosition(x {:.6}, y {:.6}, sigma {:.1} x {:.1} m)", c.x, c.y, sigma(0), sigma(1))
    }
}

/// One step of an `InsFeedback`: the corrected position before and after the fix of this step.
///
/// Without a fix, and where the gate refuses it (`accepted` False with a `nis`), both are the same.
#[pyclass(frozen, name = "FeedbackStep", module = "geomag")]
pub struct PyFeedbackStep {
    inner: FeedbackStep,
}

properties! {
    PyFeedbackStep: step {
        /// As predicted, before any fix of this step.
        before: PyCorrectedPosition = PyCorrectedPosition { inner: step.before };

        /// After the fix of this step.
        after: PyCorrectedPosition = PyCorrectedPosition { inner: step.after };

        /// Normalised innovation squared of the fix (chi-square, 2 degrees of freedom); None without a fix.
        nis: Option<f64> = step.nis;

        /// Whether a fix was used.
        accepted: bool = step.accepted;
    }

    fn __repr__(&self) -> String {
        let what = match (self.inner.nis, self.inner.accepted) {
            (None, _) => "no fix".to_owned(),
            (Some(nis), true) => format!("fix used, NIS {nis:.2}"),
            (Some(nis), false) => format!("fix refused, NIS {nis:.2}"),
        };
        format!("FeedbackStep(x {:.6}, y {:.6}, {what})", self.inner.after.x, self.inner.after.y)
    }
}

macro_rules! ins_feedback_class {
    (
        model [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*]
        stream [$(($of:ident: $of_kind:ident = $of_default:tt; $of_python:literal; $($of_line:literal)+))*]
    ) => {
        /// The horizontal error of an INS, followed from fix to fix.
        ///
        /// A linear Kalman filter of position, velocity and heading error. A fix is tested by its normalised innovation and
        /// refused beyond the gate. Its heading error turns the indicated velocity, as in dead reckoning with an odometer, a log or an
        /// airspeed; in an INS a heading error acts through the Earth's rate instead, which `navigate` models. Not for attitude or
        /// height.
        ///
        /// Parameters
        /// ----------
        $(#[doc = row_doc!($name; $python; $($line)+)])*
        $(#[doc = row_doc!($of; $of_python; $($of_line)+)])*
        /// position_walk_m, velocity_walk_m_s, heading_walk_deg : float, optional
        ///     Old names of the walks, which warn.
        ///
        /// Notes
        /// -----
        /// Source: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, chapters 3 and 14,
        /// reduced to the horizontal plane.
        ///
        /// Examples
        /// --------
        /// >>> import geomag
        /// >>> feedback = geomag.InsFeedback(position_sigma_m=500.0)
        /// >>> _ = feedback.step(0.0, 0.0, 0.0)
        /// >>> step = feedback.step(60.0, 600.0, 0.0, offset_m=(300.0, -200.0), covariance_m2=[[2500.0, 0.0], [0.0, 2500.0]])
        /// >>> step.accepted, [round(v, -1) for v in step.after.offset_m]
        /// (True, [300.0, -200.0])
        #[pyclass(frozen, name = "InsFeedback", module = "geomag")]
        pub struct PyInsFeedback {
            inner: Shared<InsFeedback>,
        }

        /// What a stream is told beside its model.
        struct Of {
            $($of: py_type!($of_kind),)*
        }

        #[pymethods]
        impl PyInsFeedback {
            #[new]
            #[pyo3(signature = (*, $($name = $default,)* $($of = $of_default,)*
                position_walk_m = None, velocity_walk_m_s = None, heading_walk_deg = None))]
            #[allow(clippy::too_many_arguments)] // one each, keyword-only
            fn new(
                py: Python<'_>,
                $($name: py_type!($kind),)*
                $($of: py_type!($of_kind),)*
                position_walk_m: Option<f64>,
                velocity_walk_m_s: Option<f64>,
                heading_walk_deg: Option<f64>,
            ) -> PyRes<Self> {
                let mut model = InsErrorModel { $($name: py_value!(py $kind $name),)* };
                for (old, name, new) in [
                    (position_walk_m, "position_walk_m", &mut model.position_walk_m_sqrt_s),
                    (velocity_walk_m_s, "velocity_walk_m_s", &mut model.velocity_walk_m_s_sqrt_s),
                    (heading_walk_deg, "heading_walk_deg", &mut model.heading_walk_deg_sqrt_s),
                ] {
                    if let Some(old) = old {
                        old_name(py, name, &format!("{name}_sqrt_s"))?;
                        *new = old;
                    }
                }
                let of = Of { $($of,)* };
                Ok(Self { inner: Shared::new(InsFeedback::new(model, of.geographic, of.gate_probability)?) })
            }

            /// Advance to an indicated position at a time, and take a fix of it where there is one.
            ///
            /// The fix is either `fix`, a matcher's answer for this very position (not used unless ``fix.ok`` and it has a
            /// covariance or is given `covariance_m2`), or `offset_m` (true minus indicated, east and north) with
            /// `covariance_m2`. Returns a `FeedbackStep`.
            #[pyo3(signature = (time_s, x, y, fix = None, *, offset_m = None, covariance_m2 = None))]
            #[allow(clippy::too_many_arguments)] // one each, keyword-only
            fn step(
                &self,
                py: Python<'_>,
                time_s: f64,
                x: f64,
                y: f64,
                fix: Option<&PyFix>,
                offset_m: Option<&Bound<'_, PyAny>>,
                covariance_m2: Option<&Bound<'_, PyAny>>,
            ) -> PyRes<PyFeedbackStep> {
                let covariance = covariance_m2.map(covariance).transpose()?;
                let offset = offset_m.map(|o| pair("offset_m", o)).transpose()?;
                let inner = match (fix, offset) {
                    (Some(_), Some(_)) => return Err(invalid("step", "fix or offset_m", "both")),
                    (Some(fix), None) => self.inner.with(py, |f| f.step_with_fix(time_s, x, y, &fix.inner, covariance))?,
                    (None, Some(offset)) => {
                        let covariance = covariance.ok_or_else(|| invalid("covariance_m2", "(2, 2) with offset_m", "None"))?;
                        self.inner.with(py, |f| f.step(time_s, x, y, Some((offset, covariance))))?
                    }
                    (None, None) => self.inner.with(py, |f| f.step(time_s, x, y, None))?,
                };
                Ok(PyFeedbackStep { inner })
            }

            /// Estimated velocity error, m/s (east, north).
            #[getter]
            fn velocity_error_m_s(&self, py: Python<'_>) -> (f64, f64) {
                self.inner.with(py, |f| f.velocity_error_m_s()).into()
            }

            /// Estimated heading error, degrees clockwise.
            #[getter]
            fn heading_error_deg(&self, py: Python<'_>) -> f64 {
                self.inner.with(py, |f| f.heading_error_deg())
            }

            /// State: position error east, north (m), velocity error east, north (m/s), heading error (rad).
            #[getter]
            fn state<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                shaped(py, self.inner.with(py, |f| f.filter().state().to_vec()), &[5])
            }

            /// Covariance of the state, (5, 5).
            #[getter]
            fn covariance<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                shaped(py, self.inner.with(py, |f| f.filter().covariance().as_slice().to_vec()), &[5, 5])
            }

            /// Fixes used so far.
            #[getter]
            fn accepted(&self, py: Python<'_>) -> usize {
                self.inner.with(py, |f| f.accepted())
            }

            /// Fixes refused so far.
            #[getter]
            fn refused(&self, py: Python<'_>) -> usize {
                self.inner.with(py, |f| f.refused())
            }

            fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
                reduced_to_bytes(slf, &slf.get().inner.with(slf.py(), |f| state::save(f))?)
            }

            #[staticmethod]
            fn _restore(bytes: &[u8]) -> PyRes<Self> {
                Ok(Self { inner: Shared::new(state::load(bytes)?) })
            }

            fn __repr__(&self, py: Python<'_>) -> String {
                self.inner.with(py, |f| format!("InsFeedback({} fixes used, {} refused)", f.accepted(), f.refused()))
            }
        }
    };
}

ins_feedback_options!(ins_feedback_class);
