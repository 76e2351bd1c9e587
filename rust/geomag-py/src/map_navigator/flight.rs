//! Whole flights.

use geomag_core::navigation::navigator::{NavigatedFlight, NavigatorStep, Smoothing, navigate};
use geomag_core::stack::extent;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::keywords;
use super::log::Log;
use crate::arrays::{matrix, shaped};
use crate::error::PyRes;
use crate::long_call;
use crate::stack::field_over;

/// Columns of a flight by name.
fn columns<'py>(py: Python<'py>, flight: &NavigatedFlight) -> PyRes<Bound<'py, PyDict>> {
    let n = flight.steps.len();
    let out = PyDict::new(py);
    let number = |f: &dyn Fn(&NavigatorStep) -> f64| shaped(py, flight.steps.iter().map(f).collect(), &[n]);
    let two = |f: &dyn Fn(&NavigatorStep) -> [f64; 2]| shaped(py, flight.steps.iter().flat_map(f).collect(), &[n, 2]);
    let four = |f: &dyn Fn(&NavigatorStep) -> [[f64; 2]; 2]| {
        shaped(py, flight.steps.iter().flat_map(|s| f(s).concat()).collect(), &[n, 2, 2])
    };
    out.set_item("x", number(&|s| s.x)?)?;
    out.set_item("y", number(&|s| s.y)?)?;
    out.set_item("covariance_m2", four(&|s| s.covariance_m2)?)?;
    out.set_item("covariance_filter_m2", four(&|s| s.covariance_filter_m2)?)?;
    out.set_item("velocity_error_m_s", two(&|s| s.velocity_error_m_s)?)?;
    out.set_item("heading_error_deg", number(&|s| s.heading_error_deg)?)?;
    out.set_item("tilt_error_mrad", two(&|s| s.tilt_error_mrad)?)?;
    out.set_item("bias", number(&|s| s.bias)?)?;
    out.set_item("nis", number(&|s| s.nis.unwrap_or(f64::NAN))?)?;
    out.set_item("running_nis", number(&|s| s.running_nis)?)?;
    out.set_item("protection_level_m", number(&|s| s.protection_level_m)?)?;
    out.set_item("last_fix", number(&|s| s.last_fix_s.unwrap_or(f64::NAN))?)?;
    out.set_item("resets", number(&|s| f64::from(s.resets))?)?;
    let words = |f: &dyn Fn(&NavigatorStep) -> &'static str| flight.steps.iter().map(f).collect::<Vec<_>>();
    out.set_item("status", words(&|s| s.status.as_str()))?;
    out.set_item("reason", words(&|s| s.reason.as_str()))?;
    out.set_item("outcome", words(&|s| s.outcome.as_str()))?;
    out.set_item("inputs", flight.inputs.as_str())?;
    out.set_item("state", shaped(py, flight.state.clone(), &[flight.state.len()])?)?;
    if let Some(smoothed) = &flight.smoothed {
        out.set_item("smooth_x", shaped(py, smoothed.iter().map(|s| s.x).collect(), &[n])?)?;
        out.set_item("smooth_y", shaped(py, smoothed.iter().map(|s| s.y).collect(), &[n])?)?;
        let covariance = smoothed.iter().flat_map(|s| s.covariance_m2.concat()).collect();
        out.set_item("smooth_covariance_m2", shaped(py, covariance, &[n, 2, 2])?)?;
    }
    Ok(out)
}

/// Columns of a whole flight from those of its log; see `geomag.navigate`.
#[pyfunction]
#[pyo3(name = "_navigate", signature = (grid, log, *, lag_s = None, progress = None, **options))]
pub fn py_navigate<'py>(
    py: Python<'py>,
    grid: &Bound<'py, PyAny>,
    log: &Bound<'py, PyDict>,
    lag_s: Option<f64>,
    progress: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyRes<Bound<'py, PyDict>> {
    let options = keywords::options(options)?;
    let column = |name: &str| log.get_item(name).map(|v| v.filter(|v| !v.is_none()));
    let [velocity_m_s, heading_deg, height_m, readings] =
        [column("velocity_m_s")?, column("heading_deg")?, column("height_m")?, column("readings")?];
    let [time_s, x, y] = ["time_s", "x", "y"].map(|name| log.as_any().get_item(name));
    let terms = column("terms")?;
    let mut log = Log::new(
        &time_s?,
        &x?,
        &y?,
        velocity_m_s.as_ref(),
        heading_deg.as_ref(),
        height_m.as_ref(),
        readings.as_ref(),
    )?;
    let field = field_over(grid, [log.height_m.as_deref().and_then(extent)])?;
    let geographic = field.geographic();
    log.terms = terms.map(|t| matrix("terms", &t).map(|t| t.0)).transpose()?;
    let smoothing = match lag_s {
        None => Smoothing::No,
        Some(f64::INFINITY) => Smoothing::Flight,
        Some(lag) => Smoothing::Lag(lag),
    };
    // A step takes a few microseconds, a match now and then some milliseconds.
    let units = log.time_s.len() as u64 * 20_000;
    let flight = long_call::run(py, units, None, progress, |monitor| {
        navigate(field, &log.input(), options, smoothing, monitor)
    })?;
    let out = columns(py, &flight)?;
    out.set_item("geographic", geographic)?;
    Ok(out)
}
