//! `Track`.

use std::sync::Arc;

use geomag_core::track::Track;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays::{optional_vector, shaped, vector};
use crate::error::{PyRes, invalid};

/// The indicated track: positions as the INS gives them, with the measured values.
#[pyclass(frozen, name = "Track", module = "geomag")]
pub struct PyTrack {
    /// The samples.
    pub inner: Arc<Track>,
}

#[pymethods]
impl PyTrack {
    #[new]
    #[pyo3(signature = (x, y, values, time_s = None))]
    fn new(
        x: &Bound<'_, PyAny>,
        y: &Bound<'_, PyAny>,
        values: &Bound<'_, PyAny>,
        time_s: Option<&Bound<'_, PyAny>>,
    ) -> PyRes<Self> {
        let track = Track::new(
            vector("track x", x)?,
            vector("track y", y)?,
            vector("track values", values)?,
            optional_vector("track time_s", time_s)?,
        )?;
        Ok(Self { inner: Arc::new(track) })
    }

    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.x().to_vec(), &[self.inner.len()])
    }

    #[getter]
    fn y<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.y().to_vec(), &[self.inner.len()])
    }

    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.values().to_vec(), &[self.inner.len()])
    }

    #[getter]
    fn time_s<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
        self.inner.time_s().map(|t| shaped(py, t.to_vec(), &[t.len()])).transpose()
    }

    #[pyo3(signature = (*, geographic = false))]
    fn distance_m<'py>(&self, py: Python<'py>, geographic: bool) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.distance_m(geographic), &[self.inner.len()])
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __getitem__(&self, index: &Bound<'_, PyAny>) -> PyRes<Self> {
        let slice = index.cast::<pyo3::types::PySlice>().map_err(|_| invalid("track index", "a slice", index))?;
        let at = slice.indices(self.inner.len() as isize)?;
        let mut picks = Vec::with_capacity(at.slicelength);
        let mut i = at.start;
        for _ in 0..at.slicelength {
            picks.push(i as usize);
            i += at.step;
        }
        let pick = |v: &[f64]| picks.iter().map(|&i| v[i]).collect::<Vec<_>>();
        let t = &self.inner;
        Ok(Self { inner: Arc::new(Track::new(pick(t.x()), pick(t.y()), pick(t.values()), t.time_s().map(pick))?) })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let py = slf.py();
        let this = slf.get();
        let arguments = (this.x(py)?, this.y(py)?, this.values(py)?, this.time_s(py)?).into_pyobject(py)?;
        Ok((slf.get_type().into_any(), arguments))
    }

    fn __repr__(&self) -> String {
        let t = &self.inner;
        let [x, y] = t.newest();
        format!("Track({} samples, newest at x {x:.6} y {y:.6})", t.len())
    }
}
