//! `Iema` and its steps.

use std::sync::Arc;

use geomag_core::field::Field;
use geomag_core::lattice::DEFAULT_MAX_CANDIDATES;
use geomag_core::matching::iema::{Iema, IemaOptions, IemaStep, Unknown};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays::{pair, shaped};
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::field;
use crate::lock::Shared;
use crate::long_call;
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

#[pymethods]
impl PyIemaStep {
    /// `searching`, `fixed` or `lost`.
    #[getter]
    fn status(&self) -> &'static str {
        self.inner.status.as_str()
    }

    /// Samples seen, this one included.
    #[getter]
    fn n_samples(&self) -> usize {
        self.inner.n_samples
    }

    /// Candidates left.
    #[getter]
    fn n_feasible(&self) -> usize {
        self.inner.n_feasible
    }

    /// Extent (x, y) of the feasible set, map units.
    #[getter]
    fn extent(&self) -> (f64, f64) {
        self.inner.extent.into()
    }

    /// Offset (x, y) of the greatest score, map units; NaN when lost and until a candidate had a map value.
    #[getter]
    fn best_offset(&self) -> (f64, f64) {
        self.inner.best_offset.into()
    }

    /// Log of the greatest score.
    #[getter]
    fn log_score(&self) -> f64 {
        self.inner.log_score
    }

    /// Greatest log score outside one map cell of the best; NaN where there is none.
    #[getter]
    fn runner_up(&self) -> f64 {
        self.inner.runner_up
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

/// Iterative evaluation matching: the gated offset matrix, sample by sample.
///
/// For a track whose INS error is (nearly) constant over the search, known sensor noise and a known bound of the error.
/// Not for: unknown bias, outliers beyond `max_misses`, heading error; and its wrong fixes are not announced: see
/// `PosteriorMatcher` for a declared risk.
///
/// Parameters
/// ----------
/// grid : GridMap
///     The stored map.
/// sigma : float
///     Standard deviation of the sensor, value units, > 0.
/// half_width : float or (float, float)
///     Bound of the INS error at the start (x, y), map units.
/// tolerance : float or (float, float)
///     Extent of the feasible set at which the answer counts as unique, map units; 0 is the paper's rule.
/// step : float or (float, float), optional
///     Lattice step, map units; the map spacing by default.
/// max_misses : int
///     Gate violations that a candidate survives.
/// unknown : {'keep', 'drop'}
///     What becomes of candidates off the map or on holes.
/// gate : float
///     Gate in standard deviations; 3 in the paper.
/// max_candidates : int
///     A larger lattice is refused before memory is taken; one of more than 2^31 offsets always is. Each candidate that is
///     left after the first sample takes 24 bytes, and as much again while they are gathered.
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
    #[pyo3(signature = (grid, sigma, half_width, tolerance = None, *, step = None, max_misses = 0, unknown = "keep",
                        gate = 3.0, max_candidates = DEFAULT_MAX_CANDIDATES))]
    #[allow(clippy::too_many_arguments)] // one each, keyword-only
    fn new(
        grid: &Bound<'_, PyAny>,
        sigma: f64,
        half_width: &Bound<'_, PyAny>,
        tolerance: Option<&Bound<'_, PyAny>>,
        step: Option<&Bound<'_, PyAny>>,
        max_misses: u32,
        unknown: &str,
        gate: f64,
        max_candidates: u64,
    ) -> PyRes<Self> {
        let options = IemaOptions {
            tolerance: tolerance.map_or(Ok([0.0; 2]), |t| pair("tolerance", t))?,
            step: step.map(|s| pair("step", s)).transpose()?,
            max_misses,
            unknown: match unknown {
                "keep" => Unknown::Keep,
                "drop" => Unknown::Drop,
                other => return Err(invalid("unknown", "'keep' or 'drop'", format!("'{other}'"))),
            },
            gate,
            max_candidates,
            ..IemaOptions::new(sigma, pair("half_width", half_width)?)
        };
        Ok(Self { inner: Shared::new(Iema::new(field(grid)?, options)?), grid: grid.clone().unbind() })
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

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let py = slf.py();
        let bytes = slf.get().inner.saved(py)?;
        Ok((slf.get_type().getattr("_restore")?, (slf.get().grid.clone_ref(py), bytes).into_pyobject(py)?))
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
