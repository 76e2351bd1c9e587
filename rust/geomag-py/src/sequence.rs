//! `delta_modulation`, `DeltaModulator`, `choose_sequence`, `energy_bandwidth`, `tune_sequence`.

use geomag_core::matching::contour::ContourOptions;
use geomag_core::matching::sequence::{
    DeltaModulator, SequenceRules, choose_sequence_monitored, delta_modulation, energy_bandwidth_monitored,
};
use geomag_core::matching::tuning::{BpsoOptions, InsDraw, Setting, TuneMethod, TuneOptions, tune_sequence};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{optional_vector, vector};
use crate::class::{Reduced, reduced_to_bytes};
use crate::contour::transform_kind;
use crate::error::{PyRes, invalid};
use crate::grid::PyGridMap;
use crate::lock::Shared;
use crate::track::PyTrack;
use crate::{long_call, state};

/// About the nanoseconds of a sum over all pairs of values.
fn pairs(values: usize) -> u64 {
    (values as u64).saturating_mul(values as u64)
}

fn indices<'py>(py: Python<'py>, keep: &[usize]) -> Bound<'py, PyAny> {
    PyArray1::from_vec(py, keep.iter().map(|&k| k as i64).collect()).into_any()
}

fn codes_array<'py>(py: Python<'py>, codes: &[bool]) -> Bound<'py, PyAny> {
    PyArray1::from_vec(py, codes.iter().map(|&c| u8::from(c)).collect()).into_any()
}

/// Indices and codes of delta modulation; the public function wraps them.
#[pyfunction(name = "_delta_modulation")]
pub fn py_delta_modulation<'py>(
    py: Python<'py>,
    values: &Bound<'py, PyAny>,
    quantum: f64,
) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let values = vector("values", values)?;
    let made = crate::pool::detached(py, || delta_modulation(&values, quantum))?;
    Ok((indices(py, &made.keep), codes_array(py, &made.codes)))
}

/// Delta modulation of a stream: says of each value whether its sample is to be matched.
///
/// Parameters
/// ----------
/// quantum : float
///     Step of the staircase, value units: more than the sensor's noise.
///
/// Examples
/// --------
/// >>> import geomag
/// >>> modulator = geomag.DeltaModulator(1.0)
/// >>> [modulator.update(v) for v in (0.0, 1.0, 2.0, 3.0, 2.6)]
/// [False, False, True, True, False]
#[pyclass(frozen, name = "DeltaModulator", module = "geomag")]
pub struct PyDeltaModulator {
    inner: Shared<DeltaModulator>,
}

#[pymethods]
impl PyDeltaModulator {
    #[new]
    fn new(quantum: f64) -> PyRes<Self> {
        Ok(Self { inner: Shared::new(DeltaModulator::new(quantum)?) })
    }

    /// Take the next value; True where its sample is chosen.
    fn update(&self, py: Python<'_>, value: f64) -> PyRes<bool> {
        Ok(self.inner.with(py, |m| m.update(value))?.chosen)
    }

    /// Begin again: no value seen.
    fn reset(&self, py: Python<'_>) {
        self.inner.with(py, DeltaModulator::reset);
    }

    /// Quantum, value units.
    #[getter]
    fn quantum(&self, py: Python<'_>) -> f64 {
        self.inner.with(py, |m| m.quantum())
    }

    /// Values taken so far.
    #[getter]
    fn count(&self, py: Python<'_>) -> usize {
        self.inner.with(py, |m| m.count())
    }

    /// Where the staircase stands; None before the first value.
    #[getter]
    fn staircase(&self, py: Python<'_>) -> Option<f64> {
        self.inner.with(py, |m| m.staircase())
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        reduced_to_bytes(slf, &slf.get().inner.with(slf.py(), |m| state::save(m))?)
    }

    #[staticmethod]
    fn _restore(bytes: &[u8]) -> PyRes<Self> {
        Ok(Self { inner: Shared::new(state::load(bytes)?) })
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        self.inner.with(py, |m| format!("DeltaModulator(quantum {}, {} values taken)", m.quantum(), m.count()))
    }
}

/// Frequency, cycles per metre, under which a share of the energy of evenly spaced values lies (mean removed).
///
/// Rule 1 of a matching sequence: it needs two samples a period of this frequency. 0 for constant values.
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> s = 50.0 * np.arange(400)
/// >>> round(1 / geomag.energy_bandwidth(np.sin(2 * np.pi * s / 2000), 50.0))
/// 2000
#[pyfunction(name = "energy_bandwidth")]
#[pyo3(signature = (values, spacing_m, *, share = 0.96))]
pub fn py_energy_bandwidth(py: Python<'_>, values: &Bound<'_, PyAny>, spacing_m: f64, share: f64) -> PyRes<f64> {
    let values = vector("values", values)?;
    long_call::run(py, pairs(values.len()), None, None, |monitor| {
        energy_bandwidth_monitored(&values, spacing_m, share, monitor)
    })
}

/// Choose the samples of a track to match: the sampling theorem, one a cell, and delta modulation.
///
/// Parameters
/// ----------
/// along_m : array of shape (n,)
///     Along-track distance of each sample, metres, ascending (``track.distance_m()``).
/// values : array of shape (n,)
///     Measured values.
/// quantum : float
///     Quantum of the delta modulation, value units (rule 3).
/// cell_m : float
///     One map cell, metres.
/// min_cells : float
///     Least distance between chosen samples, cells (rule 2).
/// energy_share : float
///     Share of the field's energy that the sampling must carry (rule 1).
///
/// Returns
/// -------
/// dict
///     keep (indices), filled (those that rule 1 brought back), greatest_gap_m, sampled_enough (rule 1 holds).
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> s = 100.0 * np.arange(200)
/// >>> chosen = geomag.choose_sequence(s, 50 * np.sin(s / 2000), quantum=4.0, cell_m=250.0)
/// >>> bool(np.diff(s[chosen['keep']]).min() >= 250), chosen['sampled_enough']
/// (True, True)
#[pyfunction(name = "choose_sequence")]
#[pyo3(signature = (along_m, values, *, quantum, cell_m, min_cells = 1.0, energy_share = 0.96))]
pub fn py_choose_sequence<'py>(
    py: Python<'py>,
    along_m: &Bound<'py, PyAny>,
    values: &Bound<'py, PyAny>,
    quantum: f64,
    cell_m: f64,
    min_cells: f64,
    energy_share: f64,
) -> PyRes<Bound<'py, PyDict>> {
    let (along_m, values) = (vector("along_m", along_m)?, vector("values", values)?);
    let rules = SequenceRules { quantum, cell_m, min_cells, energy_share };
    let chosen = long_call::run(py, pairs(values.len()), None, None, |monitor| {
        choose_sequence_monitored(&along_m, &values, &rules, monitor)
    })?;
    let d = PyDict::new(py);
    d.set_item("keep", indices(py, &chosen.keep))?;
    d.set_item("filled", indices(py, &chosen.filled))?;
    d.set_item("greatest_gap_m", chosen.greatest_gap_m)?;
    d.set_item("sampled_enough", chosen.sampled_enough)?;
    Ok(d)
}

fn setting_dict<'py>(py: Python<'py>, s: &Setting) -> PyRes<Bound<'py, PyDict>> {
    let d = PyDict::new(py);
    d.set_item("length", s.length)?;
    d.set_item("quantum", s.quantum)?;
    d.set_item("objective", s.objective)?;
    d.set_item("error_m", s.error_m)?;
    d.set_item("cost", s.cost)?;
    d.set_item("failures", s.failures)?;
    Ok(d)
}

/// Tune length and quantum of the matching sequence for a planned track.
///
/// The planned track holds true positions with the field along them; its last point is the correction point. Every
/// setting is averaged over the same draws of INS error and noise, so no lucky draw decides.
///
/// Parameters
/// ----------
/// grid : GridMap
///     The map.
/// track : Track
///     The planned track: positions and field values, densely sampled.
/// sigma : float
///     Noise of the sensor, value units.
/// offset_m, heading_sigma_deg, scale_sigma : float
///     INS error at the correction point: length of the offset (any direction), heading and scale errors.
/// min_length, max_length : int
///     Lengths; the greatest is by default the number of samples that the largest quantum gives.
/// quanta : array
///     Quanta to try, ascending; 1 to 15 by default.
/// weights : (float, float)
///     Weights of error and cost.
/// error_range_m : (float, float), optional
///     Errors that count as 0 and 1; one and two cells by default.
/// cost_range : (float, float), optional
///     Costs that count as 0 and 1.
/// cost_per_work : float
///     Cost of one point in one iteration. 1 counts work, the same on every machine; seconds measured on this one make
///     the cost time.
/// draws, seed : int
///     Number of draws, at most 1,000,000 and 2^28 samples in all, and their seed.
/// transform, radius_m, converged_m, max_iterations
///     As for `match_contour`; the radius is three times `offset_m` by default.
/// method : {'exhaustive', 'bpso'}
///     Every setting, in parallel; or binary particle swarm (`particles`, `iterations`, at most 1,000,000 each). There may
///     be at most 1,000,000 settings.
/// threads : int, optional
///     Threads to use; the answer does not depend on it.
/// progress : bool or callable, optional
///     True for a bar, or a callable (done, total).
///
/// Returns
/// -------
/// dict
///     length, quantum, objective, error_m, cost, failures of the best setting; settings (all that were evaluated);
///     max_length; iterations.
///
/// Notes
/// -----
/// Source: Duan, Xiao, Qi, J. Astronautics 2018(2).
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 40000.0, 250.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 3900)[None, :] * np.cos(x / 4100)[:, None], x, x)
/// >>> k = np.arange(80.0)
/// >>> tx, ty = 5000 + 200 * k, 7000 + 180 * k
/// >>> best = geomag.tune_sequence(grid, geomag.Track(tx, ty, grid.sample(tx, ty)), sigma=0.5, offset_m=790.0,
/// ...                             max_length=6, quanta=[2.0, 4.0], draws=5)
/// >>> len(best['settings']), 3 <= best['length'] <= 6
/// (8, True)
#[pyfunction(name = "tune_sequence")]
#[pyo3(signature = (grid, track, *, sigma, offset_m, heading_sigma_deg = 0.0, scale_sigma = 0.0, min_length = 3,
                    max_length = None, quanta = None, weights = (0.5, 0.5), error_range_m = None, cost_range = None,
                    cost_per_work = 1.0, draws = 30, seed = 0, transform = "rigid", radius_m = None,
                    converged_m = 1.0, max_iterations = 300, method = "exhaustive", particles = 30,
                    iterations = 100, threads = None, progress = None))]
#[allow(clippy::too_many_arguments)] // one each, keyword-only
pub fn py_tune_sequence<'py>(
    py: Python<'py>,
    grid: &Bound<'py, PyAny>,
    track: &PyTrack,
    sigma: f64,
    offset_m: f64,
    heading_sigma_deg: f64,
    scale_sigma: f64,
    min_length: usize,
    max_length: Option<usize>,
    quanta: Option<&Bound<'py, PyAny>>,
    weights: (f64, f64),
    error_range_m: Option<(f64, f64)>,
    cost_range: Option<(f64, f64)>,
    cost_per_work: f64,
    draws: usize,
    seed: u64,
    transform: &str,
    radius_m: Option<f64>,
    converged_m: f64,
    max_iterations: usize,
    method: &str,
    particles: usize,
    iterations: usize,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyRes<Bound<'py, PyDict>> {
    let map = match grid.cast::<PyGridMap>() {
        Ok(grid) => grid.get().inner.clone(),
        Err(_) => return Err(invalid("grid", "a geomag.GridMap", grid.get_type().name()?)),
    };
    let defaults = TuneOptions::default();
    let default_radius = if offset_m > 0.0 { 3.0 * offset_m } else { f64::INFINITY };
    let options = TuneOptions {
        min_length,
        max_length,
        quanta: optional_vector("quanta", quanta)?.unwrap_or(defaults.quanta),
        weights: weights.into(),
        error_range_m: error_range_m.map(Into::into),
        cost_range: cost_range.map(Into::into),
        cost_per_work,
        draws,
        sigma,
        ins: InsDraw { offset_m, heading_sigma_deg, scale_sigma },
        matching: ContourOptions {
            transform: transform_kind(transform)?,
            radius_m: radius_m.unwrap_or(default_radius),
            converged_m,
            max_iterations,
            ..ContourOptions::default()
        },
        seed,
    };
    let method = match method {
        "exhaustive" => TuneMethod::Exhaustive,
        "bpso" => TuneMethod::Bpso(BpsoOptions { particles, iterations, ..BpsoOptions::default() }),
        other => return Err(invalid("method", "'exhaustive' or 'bpso'", format!("'{other}'"))),
    };
    let track = track.on(py, grid)?;
    // Some hundred microseconds a trial.
    let trials = options.quanta.len().saturating_mul(max_length.unwrap_or(30)).saturating_mul(draws) as u64;
    let tuned = long_call::run(py, trials.saturating_mul(300_000), threads, progress, |monitor| {
        tune_sequence(&map, &track, &options, &method, monitor)
    })?;
    let d = setting_dict(py, &tuned.best)?;
    let settings = tuned.settings.iter().map(|s| setting_dict(py, s)).collect::<PyRes<Vec<_>>>()?;
    d.set_item("settings", settings)?;
    d.set_item("max_length", tuned.max_length)?;
    d.set_item("iterations", tuned.iterations)?;
    Ok(d)
}
