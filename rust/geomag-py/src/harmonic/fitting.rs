//! What is fitted, and what is said of a fit.

use geomag_core::harmonic::{FitSummary, Left, Observations, Selection, uniform_name};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use super::points::{Points, flat, main_vectors, sigmas};
use crate::arrays::shaped;
use crate::error::{PyRes, invalid};
use crate::frame::vectors;

/// Field vectors, or with a main field scalars, at points of the frame.
pub(super) fn observations(
    axes: [&Bound<'_, PyAny>; 3],
    field: &Bound<'_, PyAny>,
    main_field: Option<&Bound<'_, PyAny>>,
    kind: &str,
    sigma: Option<&Bound<'_, PyAny>>,
) -> PyRes<Observations> {
    let points = Points::new(axes[0], axes[1], axes[2])?;
    let mut observations = Observations::new();
    let sigma = sigmas(sigma)?;
    let positions = points.positions()?;
    match main_field {
        None => observations.vector(&positions, &vectors("field", field)?.0, &sigma)?,
        Some(main) => {
            let (values, main) = (flat("field", field)?, main_vectors(main)?);
            match kind {
                "anomaly" => observations.anomaly(&positions, &values, &main, &sigma)?,
                "intensity" => observations.intensity(&positions, &values, &main, &sigma)?,
                other => return Err(invalid("kind", "'anomaly' or 'intensity'", format!("'{other}'"))),
            }
        }
    }
    Ok(observations)
}

/// The best choice of a cross-validation, and all of them.
pub(super) fn choices<'py>(py: Python<'py>, found: &Selection) -> PyRes<(Bound<'py, PyDict>, Bound<'py, PyList>)> {
    let list = PyList::empty(py);
    let mut best = PyDict::new(py);
    for (k, c) in found.candidates.iter().enumerate() {
        let entry = PyDict::new(py);
        entry.set_item("order", c.order)?;
        entry.set_item("period_ratio", c.period_ratio)?;
        entry.set_item("ridge", c.ridge)?;
        entry.set_item("damping_m", c.prior.damping_m)?;
        entry.set_item("spectrum_power", c.prior.power)?;
        entry.set_item("anisotropy", c.prior.anisotropy)?;
        entry.set_item("rms", c.rms)?;
        entry.set_item("rms_error", c.rms_error)?;
        if k == found.best {
            best = entry.copy()?;
        }
        list.append(entry)?;
    }
    Ok((best, list))
}

/// Errors of what was left out.
pub(super) fn left_out(py: Python<'_>, left: Left) -> PyRes<Bound<'_, PyDict>> {
    let out = PyDict::new(py);
    let shape = [left.errors.len()];
    out.set_item("errors", shaped(py, left.errors, &shape)?)?;
    out.set_item("sigma", shaped(py, left.sigma, &shape)?)?;
    out.set_item("nugget", left.misfit.nugget)?;
    out.set_item("scale", left.misfit.scale)?;
    Ok(out)
}

/// How a fit went.
pub(super) fn summary<'py>(py: Python<'py>, s: &FitSummary) -> PyRes<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("n_observations", s.n_observations)?;
    out.set_item("residual_rms", s.residual_rms)?;
    out.set_item("unit_sigma", s.unit_sigma)?;
    out.set_item("effective_parameters", s.effective_parameters)?;
    out.set_item("iterations", s.iterations)?;
    out.set_item("converged", s.converged)?;
    out.set_item("undetermined", s.undetermined.iter().map(uniform_name).collect::<Vec<_>>())?;
    Ok(out)
}
