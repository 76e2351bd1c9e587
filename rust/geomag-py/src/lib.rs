//! Python bindings of geomag-core: convert, detach, call, map errors. No arithmetic lives here.

use pyo3::prelude::*;

#[pymodule]
mod _geomag {}
