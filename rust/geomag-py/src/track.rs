//! `Track`.

use std::sync::Arc;

use geomag_core::field::Field;
use geomag_core::track::Track;
use pyo3::prelude::*;

use crate::arrays::{optional_vector, shaped, vector};
use crate::class::{Reduced, properties, reduced};
use crate::error::{PyRes, invalid};
use crate::grid::PyGridMap;

/// The indicated track: positions as the INS gives them, with the measured values, oldest first.
///
/// Parameters
/// ----------
/// x, y : arrays of shape (n,), n >= 1
///     Indicated positions, map units (metres, or degrees of longitude and latitude).
/// values : array of shape (n,)
///     Measured values, the map's unit.
/// time_s : array of shape (n,), optional
///     Times in seconds, not falling.
/// height_m : float or array of shape (n,), optional
///     Height of the samples, metres above the height datum of the map, positive up: see `GridMap`.
/// geographic : bool, optional
///     Whether positions are degrees of longitude and latitude (WGS84). Said, they are brought to the coordinates of a
///     map with a CRS, or refused on one without; not said, they are taken as the map's.
///
/// Raises
/// ------
/// TooFewSamplesError, ShapeError, NotFiniteError (naming the first bad sample), InvalidInputError
///
/// Examples
/// --------
/// >>> import geomag
/// >>> track = geomag.Track([0.0, 30.0], [0.0, 40.0], [12.5, 13.0])
/// >>> len(track), track.distance_m()[-1]
/// (2, np.float64(50.0))
#[pyclass(frozen, name = "Track", module = "geomag")]
pub struct PyTrack {
    /// The samples.
    pub inner: Arc<Track>,
    /// Whether positions are degrees, where it is known.
    geographic: Option<bool>,
}

impl PyTrack {
    /// A track made on the Rust side, of whatever its map is in.
    pub fn from_core(track: Track) -> Self {
        Self { inner: Arc::new(track), geographic: None }
    }

    /// The samples in the coordinates of a map: brought there by its CRS where the track says that it is in others.
    pub fn on(&self, py: Python<'_>, map: &Bound<'_, PyAny>) -> PyRes<Arc<Track>> {
        match (self.geographic, map.cast::<PyGridMap>()) {
            (Some(degrees), Ok(grid)) if grid.get().inner.geographic() != degrees => {
                let own = Py::new(py, Self { inner: self.inner.clone(), geographic: self.geographic })?;
                let aligned = py.import("geomag.projection")?.getattr("align")?.call1((map, own))?;
                Ok(aligned.cast::<Self>().map_err(PyErr::from)?.get().inner.clone())
            }
            _ => Ok(self.inner.clone()),
        }
    }
}

/// [`PyTrack::on`] of several.
pub fn all_on(py: Python<'_>, map: &Bound<'_, PyAny>, tracks: &[Bound<'_, PyTrack>]) -> PyRes<Vec<Track>> {
    tracks.iter().map(|t| Ok((*t.get().on(py, map)?).clone())).collect()
}

properties! {
    PyTrack: track {
        /// Indicated x, map units.
        x(py): PyRes<Bound<'py, PyAny>> = shaped(py, track.x().to_vec(), &[track.len()]);

        /// Indicated y, map units.
        y(py): PyRes<Bound<'py, PyAny>> = shaped(py, track.y().to_vec(), &[track.len()]);

        /// Measured values.
        values(py): PyRes<Bound<'py, PyAny>> = shaped(py, track.values().to_vec(), &[track.len()]);

        /// Times in seconds, or None.
        time_s(py): PyRes<Option<Bound<'py, PyAny>>> =
            track.time_s().map(|t| shaped(py, t.to_vec(), &[t.len()])).transpose();

        /// Heights in metres above the height datum of the map, one a sample, or None.
        height_m(py): PyRes<Option<Bound<'py, PyAny>>> =
            track.height_m().map(|h| shaped(py, h.to_vec(), &[h.len()])).transpose();
    }

    #[new]
    #[pyo3(signature = (x, y, values, time_s = None, *, height_m = None, geographic = None))]
    fn new(
        x: &Bound<'_, PyAny>,
        y: &Bound<'_, PyAny>,
        values: &Bound<'_, PyAny>,
        time_s: Option<&Bound<'_, PyAny>>,
        height_m: Option<&Bound<'_, PyAny>>,
        geographic: Option<bool>,
    ) -> PyRes<Self> {
        let track = Track::new(
            vector("track x", x)?,
            vector("track y", y)?,
            vector("track values", values)?,
            optional_vector("track time_s", time_s)?,
        )?;
        let height = optional_vector("track height_m", height_m)?.map(|h| match h.as_slice() {
            &[everywhere] => vec![everywhere; track.len()],
            _ => h,
        });
        Ok(Self { inner: Arc::new(track.with_height(height)?), geographic })
    }

    /// Whether positions are degrees of longitude and latitude; None where it was not said: they are as the map's then.
    #[getter]
    fn geographic(&self) -> Option<bool> {
        self.geographic
    }

    /// Along-track distance of every sample from the first, metres.
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
        let track = Track::new(pick(t.x()), pick(t.y()), pick(t.values()), t.time_s().map(pick))?;
        Ok(Self { inner: Arc::new(track.with_height(t.height_m().map(pick))?), geographic: self.geographic })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        let py = slf.py();
        let this = slf.get();
        let arguments =
            (this.x(py)?, this.y(py)?, this.values(py)?, this.time_s(py)?, this.height_m(py)?, this.geographic);
        reduced(slf, arguments)
    }

    #[staticmethod]
    #[pyo3(signature = (x, y, values, time_s, height_m, geographic = None))]
    fn _restore(
        x: &Bound<'_, PyAny>,
        y: &Bound<'_, PyAny>,
        values: &Bound<'_, PyAny>,
        time_s: Option<&Bound<'_, PyAny>>,
        height_m: Option<&Bound<'_, PyAny>>,
        geographic: Option<bool>,
    ) -> PyRes<Self> {
        Self::new(x, y, values, time_s, height_m, geographic)
    }

    fn __repr__(&self) -> String {
        let t = &self.inner;
        let [x, y] = t.newest();
        format!("Track({} samples, newest at x {x:.6} y {y:.6})", t.len())
    }
}
