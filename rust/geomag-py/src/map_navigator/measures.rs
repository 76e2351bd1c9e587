//! Displacements and radii of whole flights.

use geomag_core::error::Error;
use geomag_core::frame::displacement_m;
use geomag_core::navigation::navigator::radii_m;
use pyo3::prelude::*;

use crate::arrays::{shaped, vector};
use crate::error::PyRes;

/// Displacements from places to places, metres (n, 2) east, north.
#[pyfunction]
#[pyo3(name = "_displacements_m")]
pub fn py_displacements_m<'py>(
    py: Python<'py>,
    geographic: bool,
    x: &Bound<'py, PyAny>,
    y: &Bound<'py, PyAny>,
    to_x: &Bound<'py, PyAny>,
    to_y: &Bound<'py, PyAny>,
) -> PyRes<Bound<'py, PyAny>> {
    let (x, y, to_x, to_y) = (vector("x", x)?, vector("y", y)?, vector("to_x", to_x)?, vector("to_y", to_y)?);
    let n = x.len();
    if [y.len(), to_x.len(), to_y.len()] != [n; 3] {
        return Err(Error::shape("places", format!("({n},) each"), "other lengths").into());
    }
    let out = (0..n).flat_map(|k| displacement_m(geographic, [x[k], y[k]], [to_x[k], to_y[k]])).collect();
    shaped(py, out, &[n, 2])
}

/// Radii that hold errors of covariances (n, 2, 2) with a probability, metres (n,).
#[pyfunction]
#[pyo3(name = "_radii_m")]
pub fn py_radii_m<'py>(
    py: Python<'py>,
    covariances_m2: &Bound<'py, PyAny>,
    probability: f64,
) -> PyRes<Bound<'py, PyAny>> {
    let array = crate::arrays::array("covariances_m2", covariances_m2)?;
    let shape = array.as_array().shape().to_vec();
    if shape.len() != 3 || shape[1..] != [2, 2] {
        return Err(Error::shape("covariances_m2", "(n, 2, 2)", format!("{shape:?}")).into());
    }
    let flat: Vec<f64> = array.as_array().iter().copied().collect();
    let matrices: Vec<[[f64; 2]; 2]> = flat.chunks_exact(4).map(|c| [[c[0], c[1]], [c[2], c[3]]]).collect();
    let radii = radii_m(&matrices, probability)?;
    shaped(py, radii, &[shape[0]])
}
