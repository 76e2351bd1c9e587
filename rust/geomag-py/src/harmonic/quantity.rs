//! Which scalar of the field is meant: its name and the main field that it needs.

use geomag_core::error::Error;
use geomag_core::harmonic::Quantity;
use pyo3::prelude::*;

use crate::arrays::vector;
use crate::error::{PyRes, invalid};

/// Reads the name of a scalar of the field.
pub fn quantity(name: &str, main_field: Option<[f64; 3]>) -> PyRes<Quantity> {
    let main = || main_field.ok_or_else(|| invalid("main_field", "the main field (north, east, down)", "None"));
    match name {
        "north" => Ok(Quantity::North),
        "east" => Ok(Quantity::East),
        "down" => Ok(Quantity::Down),
        "projection" => Ok(Quantity::Projection(main()?)),
        "anomaly" => Ok(Quantity::Anomaly(main()?)),
        "intensity" => Ok(Quantity::Intensity(main()?)),
        other => Err(invalid(
            "quantity",
            "'north', 'east', 'down', 'projection', 'anomaly' or 'intensity'",
            format!("'{other}'"),
        )),
    }
}

/// Name and main field of a quantity.
pub fn quantity_name(quantity: Quantity) -> (&'static str, Option<[f64; 3]>) {
    match quantity {
        Quantity::North => ("north", None),
        Quantity::East => ("east", None),
        Quantity::Down => ("down", None),
        Quantity::Projection(main) => ("projection", Some(main)),
        Quantity::Anomaly(main) => ("anomaly", Some(main)),
        Quantity::Intensity(main) | Quantity::ProjectedIntensity(main) => ("intensity", Some(main)),
    }
}

/// One vector of three numbers.
pub fn main_vector(object: Option<&Bound<'_, PyAny>>) -> PyRes<Option<[f64; 3]>> {
    object
        .map(|o| match vector("main_field", o)?.as_slice() {
            &[n, e, d] => Ok([n, e, d]),
            other => Err(Error::shape("main_field", "(3,): north, east, down", format!("({},)", other.len())).into()),
        })
        .transpose()
}
