//! Calibrated matching.

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::field::Field;
use geomag_core::matching::posterior::{self, Channel, PosteriorOptions};
use geomag_core::track::Track;
use pyo3::prelude::*;

use crate::arrays::{pair, vector};
use crate::error::PyRes;
use crate::fix::PyFix;
use crate::grid::field;
use crate::long_call;
use crate::track::PyTrack;

/// A further field measured along the track: its map, values and sensor sigma.
type Extra = (Arc<dyn Field>, Vec<f64>, Option<f64>);

#[allow(clippy::too_many_arguments)] // one each, keyword-only in Python
pub fn options(
    half_width: &Bound<'_, PyAny>,
    step: Option<&Bound<'_, PyAny>>,
    tolerance_m: Option<f64>,
    max_risk: f64,
    bias_sigma: Option<f64>,
    drift_sigma_m: f64,
    heading_sigma_deg: f64,
    scale_sigma: f64,
    position_sigma_m: f64,
    nu: Option<f64>,
    min_overlap: f64,
    min_goodness: f64,
    max_candidates: u64,
    surface: bool,
) -> PyRes<PosteriorOptions> {
    let half_width = pair("half_width", half_width)?;
    let step = step.map(|s| pair("step", s)).transpose()?;
    let options = PosteriorOptions {
        half_width,
        step,
        tolerance_m,
        max_risk,
        bias_sigma,
        drift_sigma_m,
        heading_sigma_deg,
        scale_sigma,
        position_sigma_m,
        nu,
        min_overlap,
        min_goodness,
        max_candidates,
        surface,
    };
    options.validate()?;
    Ok(options)
}

fn extras(more: Option<Vec<Bound<'_, PyAny>>>) -> PyRes<Vec<Extra>> {
    let mut out = Vec::new();
    for item in more.unwrap_or_default() {
        let (grid, values, sigma): (Bound<'_, PyAny>, Bound<'_, PyAny>, Option<f64>) = item.extract()?;
        out.push((field(&grid)?, vector("values of a further field", &values)?, sigma));
    }
    Ok(out)
}

#[pyfunction]
#[pyo3(signature = (grid, track, *, half_width, sigma = None, tolerance_m = None, max_risk = 0.01, step = None,
    bias_sigma = None, drift_sigma_m = 0.0, heading_sigma_deg = 0.0, scale_sigma = 0.0, position_sigma_m = 0.0, nu = None,
    min_overlap = 0.8, min_goodness = 1e-3, max_candidates = 4_000_000, surface = false, more = None))]
#[allow(clippy::too_many_arguments)] // one each, keyword-only
pub fn match_posterior(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    track: &Bound<'_, PyTrack>,
    half_width: &Bound<'_, PyAny>,
    sigma: Option<f64>,
    tolerance_m: Option<f64>,
    max_risk: f64,
    step: Option<&Bound<'_, PyAny>>,
    bias_sigma: Option<f64>,
    drift_sigma_m: f64,
    heading_sigma_deg: f64,
    scale_sigma: f64,
    position_sigma_m: f64,
    nu: Option<f64>,
    min_overlap: f64,
    min_goodness: f64,
    max_candidates: u64,
    surface: bool,
    more: Option<Vec<Bound<'_, PyAny>>>,
) -> PyRes<PyFix> {
    let map = field(grid)?;
    let options = options(
        half_width,
        step,
        tolerance_m,
        max_risk,
        bias_sigma,
        drift_sigma_m,
        heading_sigma_deg,
        scale_sigma,
        position_sigma_m,
        nu,
        min_overlap,
        min_goodness,
        max_candidates,
        surface,
    )?;
    let more = extras(more)?;
    let track = &track.get().inner;
    let fix = py.detach(|| {
        let mut channels = vec![Channel { field: &*map, values: track.values(), sigma }];
        channels.extend(more.iter().map(|(f, v, s)| Channel { field: &**f, values: v, sigma: *s }));
        posterior::match_channels(&channels, track, &options)
    })?;
    Ok(fix.into())
}

#[pyfunction]
#[pyo3(signature = (grid, tracks, *, half_width, sigma = None, tolerance_m = None, max_risk = 0.01, step = None,
    bias_sigma = None, drift_sigma_m = 0.0, heading_sigma_deg = 0.0, scale_sigma = 0.0, position_sigma_m = 0.0, nu = None,
    min_overlap = 0.8, min_goodness = 1e-3, max_candidates = 4_000_000, progress = None))]
#[allow(clippy::too_many_arguments)] // one each, keyword-only
pub fn match_posterior_many(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    tracks: Vec<Bound<'_, PyTrack>>,
    half_width: &Bound<'_, PyAny>,
    sigma: Option<f64>,
    tolerance_m: Option<f64>,
    max_risk: f64,
    step: Option<&Bound<'_, PyAny>>,
    bias_sigma: Option<f64>,
    drift_sigma_m: f64,
    heading_sigma_deg: f64,
    scale_sigma: f64,
    position_sigma_m: f64,
    nu: Option<f64>,
    min_overlap: f64,
    min_goodness: f64,
    max_candidates: u64,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyRes<Vec<PyFix>> {
    let map = field(grid)?;
    let options = options(
        half_width,
        step,
        tolerance_m,
        max_risk,
        bias_sigma,
        drift_sigma_m,
        heading_sigma_deg,
        scale_sigma,
        position_sigma_m,
        nu,
        min_overlap,
        min_goodness,
        max_candidates,
        false,
    )?;
    let tracks: Vec<Track> = tracks.iter().map(|t| (*t.get().inner).clone()).collect();
    let units = tracks.len() as u64 * 4_000_000;
    let fixes = long_call::run(py, units, None, progress, |monitor| -> Result<_, Error> {
        posterior::match_many(&*map, &tracks, sigma, &options, monitor)
    })?;
    Ok(fixes.into_iter().map(PyFix::from).collect())
}
