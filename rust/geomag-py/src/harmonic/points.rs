//! Points, vectors and standard deviations as arguments.

use geomag_core::error::Error;
use geomag_core::harmonic::{Positions, Region};
use pyo3::prelude::*;

use crate::arrays::{array, broadcast, matrix, vector};
use crate::error::PyRes;
use crate::frame::vectors;

/// One vector or one a point.
pub(super) fn main_vectors(object: &Bound<'_, PyAny>) -> PyRes<Vec<[f64; 3]>> {
    Ok(vectors("main_field", object)?.0)
}

/// Points of the frame, of shapes that broadcast.
pub(super) struct Points {
    axes: [Vec<f64>; 3],
    pub(super) shape: Vec<usize>,
}

impl Points {
    pub(super) fn new(north: &Bound<'_, PyAny>, east: &Bound<'_, PyAny>, down: &Bound<'_, PyAny>) -> PyRes<Self> {
        let (axes, shape) = broadcast(["north_m", "east_m", "down_m"], [north, east, down])?;
        Ok(Self { axes, shape })
    }

    pub(super) fn positions(&self) -> Result<Positions<'_>, Error> {
        Positions::new(&self.axes[0], &self.axes[1], &self.axes[2])
    }
}

/// Standard deviations as told: none, one, or one a point.
pub(super) fn sigmas(object: Option<&Bound<'_, PyAny>>) -> PyRes<Vec<f64>> {
    object.map_or_else(|| Ok(Vec::new()), |o| vector("sigma", o))
}

/// Numbers of any shape, flattened.
pub(super) fn flat(what: &str, object: &Bound<'_, PyAny>) -> PyRes<Vec<f64>> {
    Ok(array(what, object)?.as_array().iter().copied().collect())
}

/// The box of a model.
pub(super) fn region(what: &str, object: &Bound<'_, PyAny>) -> PyRes<Region> {
    match matrix(what, object)? {
        (values, 3, 2) => Ok(Region {
            north_m: [values[0], values[1]],
            east_m: [values[2], values[3]],
            down_m: [values[4], values[5]],
        }),
        (_, rows, columns) => {
            Err(Error::shape(what, "(3, 2): north, east, down from and to", format!("({rows}, {columns})")).into())
        }
    }
}
