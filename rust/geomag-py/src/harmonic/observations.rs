//! `FieldObservations`.

use std::sync::{Mutex, PoisonError};

use geomag_core::error::Error;
use geomag_core::harmonic::Observations;
use pyo3::prelude::*;

use super::{Points, flat, main_vectors, sigmas};
use crate::error::PyRes;
use crate::frame::vectors;

/// What a harmonic model is fitted to: any mixture of components, anomalies and intensities, each with its own weight.
///
/// Every `add_` returns the object, so that calls can be chained. Positions are north, east, down of the model's frame in
/// metres; `sigma` is the standard deviation (a number, or one a point).
///
/// Examples
/// --------
/// >>> import geomag
/// >>> data = geomag.FieldObservations()
/// >>> data = data.add_vector([0.0, 1e3], [0.0, 0.0], [-80.0, -80.0], [[10.0, 2.0, -5.0], [8.0, 1.0, -4.0]], sigma=2.0)
/// >>> data.add_anomaly([0.0], [5e2], [-80.0], [4.0], main_field=[31e3, 0.0, 38e3])
/// FieldObservations(7 numbers at 3 points)
#[pyclass(frozen, name = "FieldObservations", module = "geomag")]
pub struct PyFieldObservations {
    inner: Mutex<Observations>,
}

impl PyFieldObservations {
    /// What was added so far.
    pub fn snapshot(&self) -> Observations {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn change(&self, change: impl FnOnce(&mut Observations) -> Result<(), Error>) -> PyRes<()> {
        // A failed addition must leave nothing behind.
        let mut guard = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let mut copy = guard.clone();
        change(&mut copy)?;
        *guard = copy;
        Ok(())
    }
}

#[pymethods]
impl PyFieldObservations {
    #[new]
    fn new() -> Self {
        Self { inner: Mutex::new(Observations::new()) }
    }

    /// Adds components `field` (n, 3), north, east, down in the axes of the frame, at points in the frame, metres; a NaN component
    /// is left out.
    ///
    /// `sigma` > 0, field unit, one for all or one a point. Returns itself; after an error nothing was added.
    #[pyo3(signature = (north_m, east_m, down_m, field, *, sigma = None))]
    fn add_vector<'py>(
        slf: Bound<'py, Self>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        field: &Bound<'py, PyAny>,
        sigma: Option<&Bound<'py, PyAny>>,
    ) -> PyRes<Bound<'py, Self>> {
        let points = Points::new(north_m, east_m, down_m)?;
        let (values, sigma) = (vectors("field", field)?.0, sigmas(sigma)?);
        slf.get().change(|o| o.vector(&points.positions()?, &values, &sigma))?;
        Ok(slf)
    }

    /// Adds total-field anomalies `values` (n,): the projection of the field on the direction of `main_field`, (3,) or one a
    /// point (n, 3), of any length but zero.
    /// Returns itself; after an error nothing was added.
    #[pyo3(signature = (north_m, east_m, down_m, values, *, main_field, sigma = None))]
    fn add_anomaly<'py>(
        slf: Bound<'py, Self>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        values: &Bound<'py, PyAny>,
        main_field: &Bound<'py, PyAny>,
        sigma: Option<&Bound<'py, PyAny>>,
    ) -> PyRes<Bound<'py, Self>> {
        let points = Points::new(north_m, east_m, down_m)?;
        let (values, main, sigma) = (flat("values", values)?, main_vectors(main_field)?, sigmas(sigma)?);
        slf.get().change(|o| o.anomaly(&points.positions()?, &values, &main, &sigma))?;
        Ok(slf)
    }

    /// Adds total intensities `values` (n,): the length of main field plus model. `main_field` as in `add_anomaly`. Returns itself;
    /// after an error nothing was added.
    #[pyo3(signature = (north_m, east_m, down_m, values, *, main_field, sigma = None))]
    fn add_intensity<'py>(
        slf: Bound<'py, Self>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        values: &Bound<'py, PyAny>,
        main_field: &Bound<'py, PyAny>,
        sigma: Option<&Bound<'py, PyAny>>,
    ) -> PyRes<Bound<'py, Self>> {
        let points = Points::new(north_m, east_m, down_m)?;
        let (values, main, sigma) = (flat("values", values)?, main_vectors(main_field)?, sigmas(sigma)?);
        slf.get().change(|o| o.intensity(&points.positions()?, &values, &main, &sigma))?;
        Ok(slf)
    }

    fn __len__(&self) -> usize {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).len()
    }

    fn __repr__(&self) -> String {
        let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        format!("FieldObservations({} numbers at {} points)", inner.len(), inner.point_count())
    }
}
