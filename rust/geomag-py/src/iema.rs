//! `Iema` and its steps.

use std::sync::Arc;

use geomag_core::field::Field;
use geomag_core::matching::iema::{Iema, IemaOptions, IemaStep, Unknown};
use geomag_core::{common_options, iema_options, step_options};
use pyo3::prelude::*;

use crate::arrays::shaped;
use crate::class::{Reduced, properties, reduced};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::field;
use crate::lock::Shared;
use crate::long_call;
use crate::options::{maybe_pair, old_name};
use crate::posterior::{Extent, PySearchBox, boxed};
use crate::track::PyTrack;

/// Candidates from which a step is worth releasing the interpreter for.
const MANY: usize = 50_000;

/// What one sample did to the feasible set of an `Iema`.
///
/// `status` is `searching` while several candidates are left, `fixed` when they are near enough to each other, `lost` when
/// none is; `fix` is the answer at this step, to be used where it is `ok`.
#[pyclass(frozen, name = "IemaStep", module = "geomag")]
pub struct PyIemaStep {
    inner: IemaStep,
    field: Arc<dyn Field>,
}

properties! {
    PyIemaStep: step {
        /// `searching`, `fixed` or `lost`.
        status: &'static str = step.status.as_str();

        /// Samples seen, this one included.
        n_samples: usize = step.n_samples;

        /// Candidates left.
        n_feasible: usize = step.n_feasible;

        /// Extent (x, y) of the feasible set, map units.
        extent: (f64, f64) = step.extent.into();

        /// Offset (x, y) of the greatest score, map units; NaN when lost and until a candidate had a map value.
        best_offset: (f64, f64) = step.best_offset.into();

        /// Log of the greatest score.
        log_score: f64 = step.log_score;

        /// Greatest log score outside one map cell of the best; NaN where there is none.
        runner_up: f64 = step.runner_up;
    }

    /// The answer at this step as a `Fix`; its track is the newest point alone.
    #[getter]
    fn fix(&self) -> PyFix {
        self.inner.fix(&*self.field).into()
    }

    fn __repr__(&self) -> String {
        let s = &self.inner;
        format!(
            "IemaStep({}, sample {}, {} feasible, extent {:.6} x {:.6}, best offset {:.6}, {:.6})",
            s.status, s.n_samples, s.n_feasible, s.extent[0], s.extent[1], s.best_offset[0], s.best_offset[1]
        )
    }
}

macro_rules! iema_class {
    (
        extent [$(($bound:ident: $bound_kind:ident = $bound_default:tt; $bound_python:literal; $($bound_line:literal)+))*]
        overlap $overlap:tt
        $($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*
    ) => {
        /// Iterative evaluation matching: the gated offset matrix, sample by sample.
        ///
        /// For a track whose INS error is (nearly) constant over the search, known sensor noise and a known bound of the error.
        /// Not for: unknown bias, outliers beyond `max_misses`, heading error; and its wrong fixes are not announced: see
        /// `PosteriorMatcher` for a declared risk.
        ///
        /// Parameters
        /// ----------
        #[doc = shared_doc!(grid)]
        /// sigma : float
        ///     Standard deviation of the sensor, value units, > 0.
        $(#[doc = row_doc!($bound; $bound_python; $($bound_line)+)])*
        /// tolerance : float or (float, float), optional
        ///     Extent of the feasible set at which the answer counts as unique, map units; 0 by default, the paper's rule.
        /// tolerance_m : float or (float, float), optional
        ///     The same in metres.
        $($(#[doc = row_doc!($name; $python; $($line)+)])*)*
        #[doc = shared_doc!(search)]
        /// gate : float, optional
        ///     Old name of `gate_sigmas`; it warns.
        ///
        /// Notes
        /// -----
        /// Source: Huang, Sun, Wang, Liu, Gao, J. Nanjing Univ. Aeronautics & Astronautics 44(4), 2012, 565-569.
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> x = np.arange(60.0)
        /// >>> grid = geomag.GridMap(90 * np.sin(x / 4)[None, :] * np.cos(x / 5)[:, None], x, x)
        /// >>> iema = geomag.Iema(grid, sigma=1.0, half_width=(5, 5))
        /// >>> k = np.arange(20.0)
        /// >>> track = geomag.Track(18.3 + k, 25.6 + 0.7 * k, grid.sample(20.3 + k, 22.6 + 0.7 * k))
        /// >>> fix = iema.run(track)
        /// >>> fix.status, fix.offset
        /// ('fixed', (2.0, -3.0))
        #[pyclass(frozen, name = "Iema", module = "geomag")]
        pub struct PyIema {
            inner: Shared<Iema>,
            grid: Py<PyAny>,
        }

        #[pymethods]
        impl PyIema {
            #[new]
            #[pyo3(signature = (grid, sigma, *, $($bound = $bound_default,)* tolerance = None, tolerance_m = None,
                $($($name = $default,)*)* search = None, gate = None))]
            #[allow(clippy::too_many_arguments)] // one each, keyword-only
            fn new(
                py: Python<'_>,
                grid: &Bound<'_, PyAny>,
                sigma: f64,
                $($bound: py_type!($bound_kind),)*
                tolerance: Option<Py<PyAny>>,
                tolerance_m: Option<Py<PyAny>>,
                $($($name: py_type!($kind),)*)*
                search: Option<Py<PySearchBox>>,
                gate: Option<f64>,
            ) -> PyRes<Self> {
                let given = IemaOptions { $($($name: py_value!(py $kind $name),)*)* ..IemaOptions::new(sigma, [0.0; 2]) };
                let extent = Extent { $($bound: py_value!(py $bound_kind $bound),)* };
                let tolerance = [maybe_pair(py, "tolerance", tolerance.as_ref())?, maybe_pair(py, "tolerance_m", tolerance_m.as_ref())?];
                let field = field(grid)?;
                let options = in_units(py, &*field, given, extent, tolerance, search.as_ref(), gate)?;
                Ok(Self { inner: Shared::new(Iema::new(field, options)?), grid: grid.clone().unbind() })
            }

            /// Take one sample: indicated position (map units), measured value, and height where the map is a `MapStack`. Returns an
            /// `IemaStep`.
            #[pyo3(signature = (x, y, value, height_m = None))]
            fn update(&self, py: Python<'_>, x: f64, y: f64, value: f64, height_m: Option<f64>) -> PyRes<PyIemaStep> {
                let take = |iema: &mut Iema| iema.update_at(x, y, value, height_m).map(|step| (step, iema.field().clone()));
                let many = self.inner.with(py, |iema| iema.n_feasible() > MANY);
                let (inner, field) = if many { self.inner.detached(py, take) } else { self.inner.with(py, take) }?;
                Ok(PyIemaStep { inner, field })
            }

            /// Run over a whole track from a fresh start; stops at the first fix, or when lost. Returns a `Fix`.
            fn run(&self, py: Python<'_>, track: &PyTrack) -> PyRes<PyFix> {
                let track = track.on(py, self.grid.bind(py))?;
                // At worst every candidate stays.
                let units = (self.inner.with(py, |iema| iema.lattice().len()) as u64).saturating_mul(track.len() as u64);
                let fix = long_call::run(py, units, None, None, |monitor| {
                    self.inner.alone(|iema| iema.run_monitored(&track, monitor))
                })?;
                Ok(fix.into())
            }

            /// Begin again: every candidate feasible, no sample seen.
            fn reset(&self, py: Python<'_>) {
                self.inner.with(py, Iema::reset);
            }

            /// The offset matrix: True where feasible; row = y offset ascending, column = x offset ascending.
            #[getter]
            fn feasible<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                let (lattice, feasible) = self.inner.with(py, |iema| (*iema.lattice(), iema.feasible()));
                let (rows, columns) = (lattice.rows(), lattice.columns());
                let flat = numpy::PyArray1::from_vec(py, feasible);
                Ok(numpy::PyArrayMethods::reshape(&flat, [rows, columns])?.into_any())
            }

            /// Log of the evaluation matrix, minus infinity where infeasible; laid out as `feasible`.
            #[getter]
            fn log_scores<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                let (lattice, scores) = self.inner.with(py, |iema| (*iema.lattice(), iema.log_scores()));
                shaped(py, scores, &[lattice.rows(), lattice.columns()])
            }

            /// x offsets of the columns and y offsets of the rows, map units.
            #[getter]
            fn offsets<'py>(&self, py: Python<'py>) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
                let lattice = self.inner.with(py, |iema| *iema.lattice());
                let x: Vec<f64> = (0..lattice.columns()).map(|c| lattice.offset(0, c)[0]).collect();
                let y: Vec<f64> = (0..lattice.rows()).map(|r| lattice.offset(r, 0)[1]).collect();
                let (columns, rows) = (x.len(), y.len());
                Ok((shaped(py, x, &[columns])?, shaped(py, y, &[rows])?))
            }

            /// Samples seen since the start or the last reset.
            #[getter]
            fn n_samples(&self, py: Python<'_>) -> usize {
                self.inner.seen(py)
            }

            /// Candidates left.
            #[getter]
            fn n_feasible(&self, py: Python<'_>) -> usize {
                self.inner.with(py, |iema| iema.n_feasible())
            }

            fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
                let (py, this) = (slf.py(), slf.get());
                reduced(slf, (this.grid.clone_ref(py), this.inner.saved(py)?))
            }

            #[staticmethod]
            fn _restore(grid: &Bound<'_, PyAny>, bytes: &[u8]) -> PyRes<Self> {
                Ok(Self { inner: Shared::new(Iema::restore(field(grid)?, bytes)?), grid: grid.clone().unbind() })
            }

            fn __repr__(&self, py: Python<'_>) -> String {
                let (lattice, samples, left) =
                    self.inner.with(py, |iema| (*iema.lattice(), iema.n_samples(), iema.n_feasible()));
                let (rows, columns) = (lattice.rows(), lattice.columns());
                format!("Iema({rows} x {columns} offsets, {samples} samples, {left} feasible)")
            }
        }
    };
}

common_options!(step_options iema_options iema_class);

/// The options in units of the map; metres are taken at its middle.
fn in_units(
    py: Python<'_>,
    field: &dyn Field,
    given: IemaOptions,
    extent: Extent,
    [tolerance, tolerance_m]: [Option<[f64; 2]>; 2],
    search: Option<&Py<PySearchBox>>,
    gate: Option<f64>,
) -> PyRes<IemaOptions> {
    let usual = IemaOptions::new(1.0, [0.0; 2]).max_candidates;
    let (extent, step, max_candidates) = boxed(search, extent, given.step, (given.max_candidates, usual))?;
    if tolerance.is_some() && tolerance_m.is_some() {
        return Err(invalid("tolerance", "map units or metres, not both", "both"));
    }
    // An extent in metres is one in map units like the others.
    let of_metres = Extent { half_width: None, half_width_m: tolerance_m, step_m: None };
    let tolerance = tolerance.or(tolerance_m.map(|_| of_metres.in_units(field, None, None).0));
    let (half_width, step) = extent.check(step)?.in_units(field, None, step);
    if gate.is_some() {
        old_name(py, "gate", "gate_sigmas")?;
    }
    let gate_sigmas = gate.unwrap_or(given.gate_sigmas);
    Ok(IemaOptions { half_width, step, max_candidates, gate_sigmas, tolerance: tolerance.unwrap_or([0.0; 2]), ..given })
}

/// Reads the name of a policy.
pub fn unknown(name: &str) -> PyRes<Unknown> {
    match name {
        "keep" => Ok(Unknown::Keep),
        "drop" => Ok(Unknown::Drop),
        other => Err(invalid("unknown", "'keep' or 'drop'", format!("'{other}'"))),
    }
}
