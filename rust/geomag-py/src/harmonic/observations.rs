//! `FieldObservations`.

use geomag_core::error::Error;
use geomag_core::harmonic::{Observations, Positions};
use pyo3::prelude::*;

use super::points::{Points, flat, main_vectors, sigmas};
use crate::error::PyRes;
use crate::frame::vectors;
use crate::lock::Shared;

/// `Observations::anomaly` or `Observations::intensity`.
type ScalarReadings = fn(&mut Observations, &Positions<'_>, &[f64], &[[f64; 3]], &[f64]) -> Result<(), Error>;

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
    inner: Shared<Observations>,
}

impl PyFieldObservations {
    /// What was added so far.
    pub fn snapshot(&self, py: Python<'_>) -> Observations {
        self.inner.with(py, |o| o.clone())
    }

    fn change(&self, py: Python<'_>, change: impl FnOnce(&mut Observations) -> Result<(), Error> + Send) -> PyRes<()> {
        Ok(self.inner.with(py, |o| {
            // A failed addition must leave nothing behind.
            let mut copy = o.clone();
            change(&mut copy)?;
            *o = copy;
            Ok::<(), Error>(())
        })?)
    }

    /// Adds scalar readings, with the main field that they are read along.
    fn scalar(
        &self,
        py: Python<'_>,
        [north_m, east_m, down_m]: [&Bound<'_, PyAny>; 3],
        values: &Bound<'_, PyAny>,
        main_field: &Bound<'_, PyAny>,
        sigma: Option<&Bound<'_, PyAny>>,
        add: ScalarReadings,
    ) -> PyRes<()> {
        let points = Points::new(north_m, east_m, down_m)?;
        let (values, main, sigma) = (flat("values", values)?, main_vectors(main_field)?, sigmas(sigma)?);
        let positions = points.positions()?;
        self.change(py, |o| add(o, &positions, &values, &main, &sigma))
    }
}

#[pymethods]
impl PyFieldObservations {
    #[new]
    fn new() -> Self {
        Self { inner: Shared::new(Observations::new()) }
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
        let positions = points.positions()?;
        slf.get().change(slf.py(), |o| o.vector(&positions, &values, &sigma))?;
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
        slf.get().scalar(slf.py(), [north_m, east_m, down_m], values, main_field, sigma, Observations::anomaly)?;
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
        slf.get().scalar(slf.py(), [north_m, east_m, down_m], values, main_field, sigma, Observations::intensity)?;
        Ok(slf)
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.inner.with(py, |o| o.len())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        self.inner.with(py, |o| format!("FieldObservations({} numbers at {} points)", o.len(), o.point_count()))
    }
}
