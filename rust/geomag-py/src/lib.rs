//! Python bindings of geomag-core: convert, detach, call, map errors. No arithmetic lives here.

// pyo3 passes extracted arguments by value.
#![allow(clippy::needless_pass_by_value)]
// Signatures of Python methods are documented in the stub, where Python users look.
#![allow(missing_docs)]
// Docstrings are Python's: numpydoc, not Markdown.
#![allow(clippy::doc_markdown, clippy::doc_link_with_quotes)]
// The tuples of __reduce__ are spelt out where they are written.
#![allow(clippy::type_complexity)]
// The conversion of an option may be none: see options.rs.
#![allow(clippy::redundant_field_names)]

use geomag_core::state;
use pyo3::prelude::*;

/// A filter's step is a few dozen small matrices: the system's allocator would be a quarter of it.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[macro_use]
mod options;

mod arrays;
mod campaign;
mod class;
mod compensation;
mod contour;
mod error;
mod fix;
mod frame;
mod grid;
mod grid_search;
mod gridding;
mod harmonic;
mod iema;
mod information;
mod ins_feedback;
mod kalman;
mod lock;
mod long_call;
mod main_field;
mod map_navigator;
mod navigator;
mod pool;
mod posterior;
mod sequence;
mod stack;
mod synthetic;
mod track;

#[pymodule(gil_used = false)]
mod _geomag {
    #[pymodule_export]
    use crate::campaign::{campaign_flight, campaign_rows};
    #[pymodule_export]
    use crate::compensation::{PyCompensator, tolles_lawson_terms};
    #[pymodule_export]
    use crate::contour::{
        PySlidingContour, contour_settings, py_closest_contour_point, py_fit_transform, py_match_contour,
    };
    #[pymodule_export]
    use crate::fix::PyFix;
    #[pymodule_export]
    use crate::frame::PyLocalFrame;
    #[pymodule_export]
    use crate::grid::PyGridMap;
    #[pymodule_export]
    use crate::grid_search::py_match_grid;
    #[pymodule_export]
    use crate::gridding::{py_distances_to_data, py_minimum_curvature};
    #[pymodule_export]
    use crate::harmonic::{PyFieldObservations, PyHarmonicMap, PyHarmonicModel};
    #[pymodule_export]
    use crate::iema::{PyIema, PyIemaStep};
    #[pymodule_export]
    use crate::information::{bound_block, bound_reach};
    #[pymodule_export]
    use crate::ins_feedback::{PyCorrectedPosition, PyFeedbackStep, PyInsFeedback};
    #[pymodule_export]
    use crate::kalman::{PyExtendedKalmanFilter, PyUnscentedKalmanFilter};
    #[pymodule_export]
    use crate::main_field::PyMainFieldModel;
    #[pymodule_export]
    use crate::map_navigator::{
        PyInsModel, PyMatcherPlan, PyNavigator, PyNavigatorStep, py_displacements_m, py_navigate, py_radii_m,
    };
    #[pymodule_export]
    use crate::navigator::{PyFieldNavigator, PyFieldNavigatorStep, PyFieldSensor};
    #[pymodule_export]
    use crate::posterior::{
        PyAcceptance, PyInsPrior, PyPosteriorMatcher, PyPosteriorStep, PyPrediction, PySearchBox, match_posterior,
        match_posterior_many, predict_many,
    };
    #[pymodule_export]
    use crate::sequence::{
        PyDeltaModulator, py_choose_sequence, py_delta_modulation, py_energy_bandwidth, py_tune_sequence,
    };
    #[pymodule_export]
    use crate::stack::PyMapStack;
    #[pymodule_export]
    use crate::synthetic::{PyPath, PySyntheticField, draw_ins_error, fly};
    #[pymodule_export]
    use crate::track::PyTrack;

    use pyo3::prelude::*;
    use pyo3::types::PyTuple;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::pool::register(module)?;
        module.add("instruction_sets", PyTuple::new(module.py(), geomag_core::instructions::available())?)?;
        module.add(
            "instruction_set",
            geomag_core::instructions::instruction_set().map_err(crate::error::PyError::from)?,
        )?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
