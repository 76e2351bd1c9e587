//! `LocalFrame`.

use geomag_core::constants::GEOMAGNETIC_RADIUS_M;
use geomag_core::error::Error;
use geomag_core::frame::{Earth, LocalFrame};
use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays::{array, broadcast, shaped};
use crate::error::{PyRes, invalid};

/// A local frame: origin at a geographic point, axes north, east, down there, metres.
///
/// Parameters
/// ----------
/// latitude_deg, longitude_deg : float
///     Origin, degrees.
/// height_m : float
///     Its height above the ellipsoid (or sphere), metres.
/// earth : {'wgs84', 'sphere'}
///     The figure that coordinates refer to.
/// radius_m : float
///     Radius of the sphere, metres; the geomagnetic reference radius by default.
///
/// Notes
/// -----
/// Arrays of any shape broadcast. Forward and inverse undo each other to nanometres. On the sphere the coordinates are
/// those of Zhao et al. (2012), corrected.
///
/// Examples
/// --------
/// >>> import geomag
/// >>> frame = geomag.LocalFrame(33.0, 118.0)
/// >>> north, east, down = frame.forward(34.0, 118.0, 0.0)
/// >>> round(north), round(east), round(down)
/// (110908, 0, 968)
#[pyclass(frozen, name = "LocalFrame", module = "geomag")]
#[derive(Clone)]
pub struct PyLocalFrame {
    /// The frame.
    pub inner: LocalFrame,
}

type Triple<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>);

fn triple<'py>(py: Python<'py>, values: Vec<[f64; 3]>, shape: &[usize]) -> PyRes<Triple<'py>> {
    let axis = |i: usize| shaped(py, values.iter().map(|v| v[i]).collect(), shape);
    Ok((axis(0)?, axis(1)?, axis(2)?))
}

/// Vectors along the last axis of an array, with the shape of the other axes.
pub fn vectors(what: &str, object: &Bound<'_, PyAny>) -> PyRes<(Vec<[f64; 3]>, Vec<usize>)> {
    let array = array(what, object)?;
    let view = array.as_array();
    let shape = view.shape().to_vec();
    match shape.split_last() {
        Some((3, rest)) => {
            let flat: Vec<f64> = view.iter().copied().collect();
            Ok((flat.as_chunks::<3>().0.to_vec(), rest.to_vec()))
        }
        _ => Err(Error::shape(what, "(..., 3): north, east, down", format!("{shape:?}")).into()),
    }
}

/// `[..., 3]` from vectors.
pub fn stacked<'py>(py: Python<'py>, values: Vec<[f64; 3]>, shape: &[usize]) -> PyRes<Bound<'py, PyAny>> {
    let mut full = shape.to_vec();
    full.push(3);
    shaped(py, values.into_flattened(), &full)
}

/// Refuses latitudes beyond the poles, which the formulas would take for places on the other side.
pub fn require_latitudes(latitude_deg: &[f64]) -> PyRes<()> {
    match latitude_deg.iter().position(|l| l.abs() > 90.0) {
        Some(i) => Err(invalid(&format!("latitude_deg[{i}]"), "a latitude in [-90, 90] degrees", latitude_deg[i])),
        None => Ok(()),
    }
}

impl PyLocalFrame {
    fn rotate<'py>(
        &self,
        py: Python<'py>,
        latitude_deg: &Bound<'py, PyAny>,
        longitude_deg: &Bound<'py, PyAny>,
        vector: &Bound<'py, PyTuple>,
        turn: impl Fn(&LocalFrame, f64, f64, [f64; 3]) -> [f64; 3] + Sync,
    ) -> PyRes<Bound<'py, PyAny>> {
        let frame = &self.inner;
        match vector.len() {
            1 => {
                let given = array("vector", &vector.get_item(0)?)?;
                if given.shape().last() != Some(&3) {
                    let got = format!("{:?}", given.shape());
                    return Err(Error::shape("vector", "(..., 3): north, east, down", got).into());
                }
                let part = |i: usize| given.get_item((py.Ellipsis(), i));
                let (n, e, d) = (part(0)?, part(1)?, part(2)?);
                let names = ["latitude_deg", "longitude_deg", "vector", "vector", "vector"];
                let ([lat, lon, n, e, d], shape) = broadcast(names, [latitude_deg, longitude_deg, &n, &e, &d])?;
                require_latitudes(&lat)?;
                let turned = crate::pool::detached(py, || {
                    (0..n.len()).map(|i| turn(frame, lat[i], lon[i], [n[i], e[i], d[i]])).collect()
                });
                stacked(py, turned, &shape)
            }
            3 => {
                let (n, e, d) = (vector.get_item(0)?, vector.get_item(1)?, vector.get_item(2)?);
                let names = ["latitude_deg", "longitude_deg", "north", "east", "down"];
                let ([lat, lon, n, e, d], shape) = broadcast(names, [latitude_deg, longitude_deg, &n, &e, &d])?;
                require_latitudes(&lat)?;
                let turned = crate::pool::detached(py, || {
                    (0..n.len()).map(|i| turn(frame, lat[i], lon[i], [n[i], e[i], d[i]])).collect()
                });
                Ok(triple(py, turned, &shape)?.into_pyobject(py)?.into_any())
            }
            other => Err(invalid("vector", "one array (..., 3) or three arrays north, east, down", other)),
        }
    }
}

#[pymethods]
impl PyLocalFrame {
    #[new]
    #[pyo3(signature = (latitude_deg, longitude_deg, height_m = 0.0, *, earth = "wgs84", radius_m = GEOMAGNETIC_RADIUS_M))]
    fn new(latitude_deg: f64, longitude_deg: f64, height_m: f64, earth: &str, radius_m: f64) -> PyRes<Self> {
        let earth = match earth {
            "wgs84" => Earth::Wgs84,
            "sphere" => Earth::Sphere { radius_m },
            other => return Err(invalid("earth", "'wgs84' or 'sphere'", format!("'{other}'"))),
        };
        Ok(Self { inner: LocalFrame::new(latitude_deg, longitude_deg, height_m, earth)? })
    }

    /// Latitude of the origin, degrees.
    #[getter]
    fn latitude_deg(&self) -> f64 {
        self.inner.latitude_deg()
    }

    /// Longitude of the origin, degrees.
    #[getter]
    fn longitude_deg(&self) -> f64 {
        self.inner.longitude_deg()
    }

    /// Height of the origin, metres.
    #[getter]
    fn height_m(&self) -> f64 {
        self.inner.height_m()
    }

    /// `'wgs84'` or `'sphere'`.
    #[getter]
    fn earth(&self) -> &'static str {
        match self.inner.earth() {
            Earth::Wgs84 => "wgs84",
            Earth::Sphere { .. } => "sphere",
        }
    }

    /// Radius of the sphere, metres; none on the ellipsoid.
    #[getter]
    fn radius_m(&self) -> Option<f64> {
        match self.inner.earth() {
            Earth::Wgs84 => None,
            Earth::Sphere { radius_m } => Some(radius_m),
        }
    }

    /// North, east, down (metres, in the frame) of geographic points (degrees, degrees, metres), three arrays of their shape.
    ///
    /// NaN gives NaN; raises `InvalidInputError` for a latitude beyond a pole.
    #[pyo3(signature = (latitude_deg, longitude_deg, height_m = None))]
    fn forward<'py>(
        &self,
        py: Python<'py>,
        latitude_deg: &Bound<'py, PyAny>,
        longitude_deg: &Bound<'py, PyAny>,
        height_m: Option<&Bound<'py, PyAny>>,
    ) -> PyRes<Triple<'py>> {
        let zero = 0.0_f64.into_pyobject(py).map_err(PyErr::from)?.into_any();
        let names = ["latitude_deg", "longitude_deg", "height_m"];
        let ([lat, lon, h], shape) = broadcast(names, [latitude_deg, longitude_deg, height_m.unwrap_or(&zero)])?;
        require_latitudes(&lat)?;
        let out =
            crate::pool::detached(py, || (0..lat.len()).map(|i| self.inner.forward(lat[i], lon[i], h[i])).collect());
        triple(py, out, &shape)
    }

    /// Latitude, longitude (degrees) and height (metres) of points in the frame (metres), three arrays of their shape.
    fn inverse<'py>(
        &self,
        py: Python<'py>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
    ) -> PyRes<Triple<'py>> {
        let ([n, e, d], shape) = broadcast(["north_m", "east_m", "down_m"], [north_m, east_m, down_m])?;
        let out = crate::pool::detached(py, || (0..n.len()).map(|i| self.inner.inverse([n[i], e[i], d[i]])).collect());
        triple(py, out, &shape)
    }

    /// Turns vectors given north-east-down at their own points into north-east-down at the origin. Lengths are kept.
    #[pyo3(signature = (latitude_deg, longitude_deg, *vector))]
    fn rotate_to_origin<'py>(
        &self,
        py: Python<'py>,
        latitude_deg: &Bound<'py, PyAny>,
        longitude_deg: &Bound<'py, PyAny>,
        vector: &Bound<'py, PyTuple>,
    ) -> PyRes<Bound<'py, PyAny>> {
        self.rotate(py, latitude_deg, longitude_deg, vector, LocalFrame::rotate_to_origin)
    }

    /// Turns vectors given north-east-down at the origin into north-east-down at points of their own.
    #[pyo3(signature = (latitude_deg, longitude_deg, *vector))]
    fn rotate_from_origin<'py>(
        &self,
        py: Python<'py>,
        latitude_deg: &Bound<'py, PyAny>,
        longitude_deg: &Bound<'py, PyAny>,
        vector: &Bound<'py, PyTuple>,
    ) -> PyRes<Bound<'py, PyAny>> {
        self.rotate(py, latitude_deg, longitude_deg, vector, LocalFrame::rotate_from_origin)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.inner == other.inner
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyRes<(Bound<'py, PyAny>, (f64, f64, f64, Option<f64>))> {
        let f = &slf.get().inner;
        let arguments = (f.latitude_deg(), f.longitude_deg(), f.height_m(), slf.get().radius_m());
        Ok((slf.get_type().getattr("_restore")?, arguments))
    }

    #[staticmethod]
    #[pyo3(signature = (latitude_deg, longitude_deg, height_m, radius_m))]
    fn _restore(latitude_deg: f64, longitude_deg: f64, height_m: f64, radius_m: Option<f64>) -> PyRes<Self> {
        let earth = radius_m.map_or(Earth::Wgs84, |radius_m| Earth::Sphere { radius_m });
        Ok(Self { inner: LocalFrame::new(latitude_deg, longitude_deg, height_m, earth)? })
    }

    fn __repr__(&self) -> String {
        let f = &self.inner;
        let figure = match f.earth() {
            Earth::Wgs84 => "wgs84".to_owned(),
            Earth::Sphere { radius_m } => format!("sphere of {radius_m} m"),
        };
        format!("LocalFrame({}, {}, {} m, {figure})", f.latitude_deg(), f.longitude_deg(), f.height_m())
    }
}
