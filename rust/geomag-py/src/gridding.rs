//! Survey points to grids.

use geomag_core::grid::Axis;
use geomag_core::gridding::{distances_to_data, minimum_curvature};
use pyo3::prelude::*;

use crate::arrays::{shaped, vector};
use crate::error::PyRes;
use crate::long_call;

/// Minimum-curvature values (rows, columns) of points on the grid of two axes given as (first, step, length).
#[pyfunction]
#[pyo3(name = "_minimum_curvature", signature = (x, y, values, x_axis, y_axis, *, aspect, weight = f64::INFINITY, reach = f64::INFINITY, sweeps = 120, progress = None))]
#[allow(clippy::too_many_arguments)] // one each
pub fn py_minimum_curvature<'py>(
    py: Python<'py>,
    x: &Bound<'_, PyAny>,
    y: &Bound<'_, PyAny>,
    values: &Bound<'_, PyAny>,
    x_axis: (f64, f64, usize),
    y_axis: (f64, f64, usize),
    aspect: f64,
    weight: f64,
    reach: f64,
    sweeps: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyRes<Bound<'py, PyAny>> {
    let (x, y, values) = (vector("x", x)?, vector("y", y)?, vector("values", values)?);
    let (xs, ys) = (Axis::new(x_axis.0, x_axis.1, x_axis.2)?, Axis::new(y_axis.0, y_axis.1, y_axis.2)?);
    let units = [xs.len(), ys.len(), sweeps, 4].iter().fold(1_u64, |product, &n| product.saturating_mul(n as u64));
    let out = long_call::run(py, units, None, progress, |monitor| {
        minimum_curvature([&x, &y, &values], &xs, &ys, aspect, weight, reach, sweeps, monitor)
    })?;
    shaped(py, out, &[ys.len(), xs.len()])
}

/// Distances in metres (rows, columns) from every node: to the nearest point, and to the points on either side, the harmonic mean of that and of the distance to the
/// nearest on the other side (twice the first where there is none).
#[pyfunction]
#[pyo3(name = "_distances_to_data", signature = (x, y, x_axis, y_axis, *, cell_m))]
pub fn py_distances_to_data<'py>(
    py: Python<'py>,
    x: &Bound<'_, PyAny>,
    y: &Bound<'_, PyAny>,
    x_axis: (f64, f64, usize),
    y_axis: (f64, f64, usize),
    cell_m: (f64, f64),
) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let (x, y) = (vector("x", x)?, vector("y", y)?);
    let (xs, ys) = (Axis::new(x_axis.0, x_axis.1, x_axis.2)?, Axis::new(y_axis.0, y_axis.1, y_axis.2)?);
    let out = crate::pool::detached(py, || distances_to_data(&x, &y, &xs, &ys, cell_m.into()))?;
    let shape = [ys.len(), xs.len()];
    Ok((shaped(py, out.nearest, &shape)?, shaped(py, out.either_side, &shape)?))
}
