//! Position bound over a map. Settings come as JSON from `geomag.blocks`.

use geomag_core::information::{NodeBlock, TrackInformation};
use pyo3::prelude::*;

use crate::arrays::{array, shaped, vector};
use crate::error::{PyRes, invalid};
use crate::synthetic::settings;
use numpy::PyUntypedArrayMethods;

/// Nodes (rows, columns) that the bound at a node reaches to.
#[pyfunction]
pub fn bound_reach(
    options_json: &str,
    spacing: [f64; 2],
    geographic: bool,
    latitude_deg: f64,
) -> PyRes<(usize, usize)> {
    let [rows, columns] =
        settings::<TrackInformation>("track", options_json)?.reach(spacing, geographic, latitude_deg)?;
    Ok((rows, columns))
}

/// Errors and samples, (headings, rows, columns) each, of a block of a map.
#[pyfunction]
pub fn bound_block<'py>(
    py: Python<'py>,
    values: &Bound<'py, PyAny>,
    y: &Bound<'py, PyAny>,
    spacing: [f64; 2],
    geographic: bool,
    options_json: &str,
) -> PyRes<Vec<(Bound<'py, PyAny>, Bound<'py, PyAny>)>> {
    let options: TrackInformation = settings("track", options_json)?;
    let values = array("block values", values)?;
    let &[rows, columns] = values.shape() else {
        return Err(invalid("block values", "two dimensions", format!("{:?}", values.shape())));
    };
    let y = vector("block y", y)?;
    let flat: Vec<f64> = values.as_array().iter().copied().collect();
    let bounds =
        crate::pool::detached(py, || options.bound(&NodeBlock { values: &flat, y: &y, columns, spacing, geographic }))?;
    let wide = |v: Vec<f32>| shaped(py, v.into_iter().map(f64::from).collect(), &[rows, columns]);
    bounds.into_iter().map(|b| Ok((wide(b.error_m)?, wide(b.samples)?))).collect()
}
