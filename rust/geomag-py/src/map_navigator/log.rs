//! Columns of a log.

use geomag_core::error::Error;
use geomag_core::navigation::navigator::FlightInput;
use pyo3::prelude::*;

use crate::arrays::{matrix, optional_vector, vector};
use crate::error::PyRes;

/// Columns of a log as they were passed.
pub struct Log {
    pub time_s: Vec<f64>,
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub velocity_m_s: Option<Vec<[f64; 2]>>,
    pub heading_deg: Option<Vec<f64>>,
    pub height_m: Option<Vec<f64>>,
    pub readings: Option<Vec<f64>>,
    pub terms: Option<Vec<f64>>,
}

impl Log {
    #[allow(clippy::too_many_arguments)] // one each
    pub fn new(
        time_s: &Bound<'_, PyAny>,
        x: &Bound<'_, PyAny>,
        y: &Bound<'_, PyAny>,
        velocity_m_s: Option<&Bound<'_, PyAny>>,
        heading_deg: Option<&Bound<'_, PyAny>>,
        height_m: Option<&Bound<'_, PyAny>>,
        readings: Option<&Bound<'_, PyAny>>,
    ) -> PyRes<Self> {
        let time_s = vector("time_s", time_s)?;
        let n = time_s.len();
        // A height of the whole flight may be one number.
        let height_m = optional_vector("height_m", height_m)?.map(|h| if h.len() == 1 { vec![h[0]; n] } else { h });
        Ok(Self {
            x: vector("x", x)?,
            y: vector("y", y)?,
            velocity_m_s: velocity_m_s.map(|v| pairs("velocity_m_s", v)).transpose()?,
            heading_deg: optional_vector("heading_deg", heading_deg)?,
            height_m,
            readings: optional_vector("readings", readings)?,
            terms: None,
            time_s,
        })
    }

    pub fn input(&self) -> FlightInput<'_> {
        FlightInput {
            time_s: &self.time_s,
            x: &self.x,
            y: &self.y,
            velocity_m_s: self.velocity_m_s.as_deref(),
            heading_deg: self.heading_deg.as_deref(),
            height_m: self.height_m.as_deref(),
            readings: self.readings.as_deref(),
            terms: self.terms.as_deref(),
        }
    }
}

/// (n, 2) numbers.
fn pairs(what: &str, object: &Bound<'_, PyAny>) -> PyRes<Vec<[f64; 2]>> {
    let (values, rows, columns) = matrix(what, object)?;
    if columns != 2 {
        return Err(Error::shape(what, "(n, 2) east, north", format!("({rows}, {columns})")).into());
    }
    Ok(values.chunks_exact(2).map(|c| [c[0], c[1]]).collect())
}
