//! `GridMap`.

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::field::Field;
use geomag_core::grid::{Axis, GridMap, GridValues, Interpolation, MapHeight, MapSigma};
use geomag_core::map_error::{DistanceLayer, FilterLaw, Forecast, Lapses, MapErrorModel, Recalibration};
use numpy::{PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{array, broadcast, in_place, is_single, matrix, shaped, vector};
use crate::class::{Reduced, reduced};
use crate::error::{PyRes, invalid};
use crate::harmonic::PyHarmonicMap;
use crate::stack::PyMapStack;

/// Reads the name of an interpolation.
pub fn interpolation(name: &str) -> PyRes<Interpolation> {
    match name {
        "bilinear" => Ok(Interpolation::Bilinear),
        "bicubic" => Ok(Interpolation::Bicubic),
        other => Err(invalid("interpolation", "'bilinear' or 'bicubic'", format!("'{other}'"))),
    }
}

/// The same where `method` is still given, its old name.
pub fn read_by(py: Python<'_>, told: Interpolation, method: Option<&str>) -> PyRes<Interpolation> {
    let Some(old) = method else { return Ok(told) };
    crate::options::old_name(py, "method", "interpolation")?;
    interpolation(old)
}

/// A regular grid of field values: the stored map that matchers compare with.
///
/// For regular maps in metres (projected) or degrees (geographic). Not for scattered data: grid it first (see
/// `geomag.survey`).
///
/// Parameters
/// ----------
/// values : array of shape (len(y), len(x))
///     Field values, row = y, column = x; float32 stays float32, anything else becomes float64. NaN is a hole.
/// x, y : arrays
///     Evenly spaced coordinates, in either direction: metres east and north, or degrees of longitude and latitude.
///     Longitudes may jump by 360 where the map crosses the date line.
/// geographic : bool
///     Whether the coordinates are degrees.
/// sigma : float or array of the shape of values, optional
///     Standard deviation of the stored values against the true field, value units. 0 says that the nodes are exact; what lies between
///     them is still the map's to guess (see `interpolation=` of the matchers).
/// correlation_m : float, optional
///     Length over which those errors decorrelate, metres; one cell where nothing is said. A map gridded from survey lines errs over about
///     one or two line spacings; one whose nodes were measured one by one not at all (0). The longer it is, the fewer samples count as
///     independent. A learnt error model takes its place.
/// height_m : float or array of the shape of values, optional
///     Height of the values, metres above the height datum, positive up: a level, or a surface draped over the ground. The
///     datum (ellipsoid, geoid, mean sea level) is the map's own; the heights of tracks are counted from the same.
/// name, units, crs : str, optional
///     Carried along.
/// ground_scale : float, array of shape (len(y),) or (len(y), 2), optional
///     Metres on the ground per map unit (east, north), one or one a row, for projections that stretch (Mercator); one by default.
///     `read_grid` gives it where the file says the projection.
/// line_spacing_m : float, optional
///     Distance between the survey lines that the map was made of, metres. It changes no answer by itself: see
///     `geomag.survey.with_line_spacing`.
///
/// Raises
/// ------
/// ShapeError, InvalidInputError (uneven axes, latitudes beyond the poles), NotFiniteError (infinite values)
///
/// Notes
/// -----
/// Stored once, with both axes ascending, and shared by every matcher made from it. Between nodes the map is bilinear
/// or, on request, cubic convolution (Keys 1981, doi 10.1109/TASSP.1981.1163711).
///
/// Arrays stay as they are given: a map of the whole circle of longitude ends at its last column, so that neither samples nor searches cross
/// its seam. `geomag.io.close_seam` carries it on beyond either end, as `read_grid` does for files.
///
/// Examples
/// --------
/// >>> import geomag
/// >>> grid = geomag.GridMap([[0.0, 1.0], [10.0, 11.0]], x=[0, 100], y=[0, 100])
/// >>> grid.sample(50, 50)
/// 5.5
/// >>> grid.gradient(50, 50)
/// (0.01, 0.1)
#[pyclass(frozen, name = "GridMap", module = "geomag", weakref)]
pub struct PyGridMap {
    /// The map, shared with every matcher made from it.
    pub inner: Arc<GridMap>,
    labels: Labels,
    /// Whether columns and rows of the arrays that it was made of ran the other way: layers that come later do too.
    turned: [bool; 2],
}

/// What is said of a map and no kernel asks for.
#[derive(Clone, Default)]
struct Labels {
    name: Option<String>,
    units: Option<String>,
    crs: Option<String>,
    line_spacing_m: Option<f64>,
}

impl PyGridMap {
    /// A map made on the Rust side.
    /// A map without labels.
    pub fn of(inner: Arc<GridMap>) -> Self {
        Self { inner, labels: Labels::default(), turned: [false; 2] }
    }

    pub fn from_core(inner: GridMap, name: Option<String>, units: Option<String>, crs: Option<String>) -> Self {
        let labels = Labels { name, units, crs, line_spacing_m: None };
        Self { inner: Arc::new(inner), labels, turned: [false; 2] }
    }

    /// Another map with this one's name, units and reference system.
    pub fn named_alike(&self, inner: GridMap) -> Self {
        Self { inner: Arc::new(inner), labels: self.labels.clone(), turned: [false; 2] }
    }
}

/// A length that is told, above zero.
fn length(what: &'static str, told: Option<f64>) -> PyRes<Option<f64>> {
    match told {
        Some(length) if !(length.is_finite() && length > 0.0) => Err(invalid(what, "a finite number > 0", length)),
        other => Ok(other),
    }
}

/// Values of a NumPy array in their own precision, row-major, with the shape.
fn grid_values(object: &Bound<'_, PyAny>) -> PyRes<(GridValues, usize, usize)> {
    if is_single(object) && !object.hasattr("mask")? {
        let copy = match in_place::<f32>(object)? {
            Some(_) => object.clone(),
            None => object.call_method1("astype", ("float32",))?,
        };
        if let Some(array) = in_place::<f32>(&copy)? {
            let &[rows, columns] = array.shape() else {
                return Err(Error::shape("values", "two dimensions (y, x)", format!("{:?}", array.shape())).into());
            };
            let read = array.try_readonly().map_err(PyErr::from)?;
            return Ok((GridValues::F32(read.as_array().iter().copied().collect()), rows, columns));
        }
    }
    let (values, rows, columns) = matrix("values", object)?;
    Ok((GridValues::F64(values), rows, columns))
}

/// The rounding that coordinates stored in single precision carry.
fn axis_resolution(object: &Bound<'_, PyAny>, values: &[f64]) -> f64 {
    if is_single(object) {
        2.0 * f64::from(f32::EPSILON) * values.iter().fold(0.0_f64, |m, v| m.max(v.abs()))
    } else {
        0.0
    }
}

fn axis_array<'py>(py: Python<'py>, axis: &Axis) -> PyRes<Bound<'py, PyAny>> {
    shaped(py, (0..axis.len()).map(|i| axis.at(i)).collect(), &[axis.len()])
}

/// Whether coordinates ran down where their axis runs up.
fn turned(coordinates: &[f64], axis: &Axis) -> bool {
    (coordinates[0] - axis.first()).abs() > 0.5 * axis.step()
}

/// A layer of numbers >= 0 (NaN where unknown) of a map's shape.
fn positive_layer(what: &str, object: &Bound<'_, PyAny>, shape: (usize, usize)) -> PyRes<Vec<f64>> {
    let values = layer(what, object, shape)?;
    match values.iter().position(|s| s.is_infinite() || *s < 0.0) {
        None => Ok(values),
        Some(i) => {
            let place = format!("{what}[{}, {}]", i / shape.1, i % shape.1);
            Err(invalid(&place, "a finite number >= 0 (NaN where unknown)", values[i]))
        }
    }
}

/// A layer of a map's shape.
fn layer(what: &str, object: &Bound<'_, PyAny>, shape: (usize, usize)) -> PyRes<Vec<f64>> {
    let (values, rows, columns) = matrix(what, object)?;
    if (rows, columns) != shape {
        return Err(Error::shape(what, format!("{shape:?} as values"), format!("({rows}, {columns})")).into());
    }
    Ok(values)
}

/// A layer turned as the values of its map were, so that it lies as they do.
fn turn(layer: &[f64], (rows, columns): (usize, usize), turned: [bool; 2]) -> Vec<f64> {
    let from = |i: usize, n: usize, turned: bool| if turned { n - 1 - i } else { i };
    let at = |k: usize| from(k / columns, rows, turned[1]) * columns + from(k % columns, columns, turned[0]);
    (0..layer.len()).map(|k| layer[at(k)]).collect()
}

impl PyGridMap {
    /// With a ground scale: one number, one a row, or a pair a row; `falling` where rows come from north to south.
    fn scaled(&self, scale: &Bound<'_, PyAny>, falling: bool) -> PyRes<Self> {
        let rows = self.shape().0;
        let pairs = array("ground_scale", scale)?;
        let values: Vec<f64> = pairs.as_array().iter().copied().collect();
        let mut pairs: Vec<[f64; 2]> = match *pairs.shape() {
            [] => vec![[values[0]; 2]; rows],
            [n] if n == rows => values.iter().map(|v| [*v; 2]).collect(),
            [n, 2] if n == rows => values.as_chunks::<2>().0.to_vec(),
            ref other => {
                let needed = format!("one number, ({rows},) or ({rows}, 2) as the rows");
                return Err(Error::shape("ground_scale", needed, format!("{other:?}")).into());
            }
        };
        if falling {
            pairs.reverse();
        }
        Ok(Self {
            inner: Arc::new((*self.inner).clone().with_ground_scale(Some(pairs))?),
            labels: self.labels.clone(),
            turned: self.turned,
        })
    }

    fn with_model(&self, model: Option<MapErrorModel>) -> Result<Self, Error> {
        Ok(Self {
            inner: Arc::new((*self.inner).clone().with_error_model(model)?),
            labels: self.labels.clone(),
            turned: self.turned,
        })
    }
}

#[pymethods]
impl PyGridMap {
    #[new]
    #[pyo3(signature = (values, x, y, *, geographic = false, sigma = None, correlation_m = None, height_m = None, name = None,
        units = None, crs = None, ground_scale = None, line_spacing_m = None))]
    #[allow(clippy::too_many_arguments)] // one each, keyword-only
    fn new(
        values: &Bound<'_, PyAny>,
        x: &Bound<'_, PyAny>,
        y: &Bound<'_, PyAny>,
        geographic: bool,
        sigma: Option<&Bound<'_, PyAny>>,
        correlation_m: Option<f64>,
        height_m: Option<&Bound<'_, PyAny>>,
        name: Option<String>,
        units: Option<String>,
        crs: Option<String>,
        ground_scale: Option<&Bound<'_, PyAny>>,
        line_spacing_m: Option<f64>,
    ) -> PyRes<Self> {
        let labels = Labels { name, units, crs, line_spacing_m: length("line_spacing_m", line_spacing_m)? };
        let (grid_values, rows, columns) = grid_values(values)?;
        let (xs, ys) = (vector("x", x)?, vector("y", y)?);
        if (rows, columns) != (ys.len(), xs.len()) {
            let needed = format!("({}, {}) from the axes (y, x)", ys.len(), xs.len());
            return Err(Error::shape("values", needed, format!("({rows}, {columns})")).into());
        }
        let resolution = axis_resolution(x, &xs).max(axis_resolution(y, &ys));
        let mut inner = GridMap::with_resolution(grid_values, &xs, &ys, geographic, resolution)?;
        let turned = [turned(&xs, inner.x()), turned(&ys, inner.y())];
        if let Some(sigma) = sigma {
            let layer = if let Ok(constant) = sigma.extract::<f64>() {
                MapSigma::Constant(constant)
            } else {
                MapSigma::Grid(turn(&positive_layer("sigma", sigma, (rows, columns))?, (rows, columns), turned))
            };
            inner = inner.with_sigma(Some(layer))?;
        }
        inner = inner.with_correlation_m(correlation_m)?;
        if let Some(height) = height_m {
            let layer = if let Ok(level) = height.extract::<f64>() {
                MapHeight::Level(level)
            } else {
                MapHeight::Drape(turn(&layer("height_m", height, (rows, columns))?, (rows, columns), turned))
            };
            inner = inner.with_height(Some(layer))?;
        }
        let map = Self { inner: Arc::new(inner), labels, turned };
        match ground_scale {
            None => Ok(map),
            Some(scale) => map.scaled(scale, turned[1]),
        }
    }

    /// Make a map of a two-dimensional xarray.DataArray; see `geomag.io.grid_from_xarray` for the options.
    #[staticmethod]
    #[pyo3(signature = (data_array, **options))]
    fn from_xarray<'py>(
        data_array: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyRes<Bound<'py, PyAny>> {
        let module = data_array.py().import("geomag.io")?;
        Ok(module.getattr("grid_from_xarray")?.call((data_array,), options)?)
    }

    /// The map as an xarray.DataArray.
    fn to_xarray<'py>(slf: &Bound<'py, Self>) -> PyRes<Bound<'py, PyAny>> {
        Ok(slf.py().import("geomag.io")?.getattr("grid_to_xarray")?.call1((slf,))?)
    }

    /// The map at another height, or a `MapStack` of it at several: see `geomag.continuation.continue_to` for the options.
    #[pyo3(signature = (height_m, **options))]
    fn continue_to<'py>(
        slf: &Bound<'py, Self>,
        height_m: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyRes<Bound<'py, PyAny>> {
        let module = slf.py().import("geomag.continuation")?;
        Ok(module.getattr("continue_to")?.call((slf, height_m), options)?)
    }

    /// The change of the field with height, value units per metre, upward positive: see `geomag.continuation.vertical_gradient`.
    #[pyo3(signature = (**options))]
    fn vertical_gradient<'py>(
        slf: &Bound<'py, Self>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyRes<Bound<'py, PyAny>> {
        let module = slf.py().import("geomag.continuation")?;
        Ok(module.getattr("vertical_gradient")?.call((slf,), options)?)
    }

    /// Write the map to a netCDF file (CF conventions) with all that it knows; `GridMap.open` gives it back to the last bit.
    fn save(slf: &Bound<'_, Self>, path: &Bound<'_, PyAny>) -> PyRes<()> {
        slf.py().import("geomag.io")?.getattr("save_grid")?.call1((slf, path))?;
        Ok(())
    }

    /// The map that `save` wrote. Raises `ReadError` for any other file, which `geomag.read_grid` may read.
    #[staticmethod]
    fn open<'py>(path: &Bound<'py, PyAny>) -> PyRes<Bound<'py, PyAny>> {
        Ok(path.py().import("geomag.io")?.getattr("open_grid")?.call1((path,))?)
    }

    /// x of the columns (east), ascending, map units.
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        axis_array(py, self.inner.x())
    }

    /// y of the rows (north), ascending, map units.
    #[getter]
    fn y<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        axis_array(py, self.inner.y())
    }

    /// A copy of the values: row = y ascending, column = x ascending.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        let shape = [self.inner.y().len(), self.inner.x().len()];
        match self.inner.values() {
            GridValues::F64(v) => shaped(py, v.clone(), &shape),
            GridValues::F32(v) => {
                let array = numpy::PyArray1::from_slice(py, v);
                Ok(array.reshape(shape)?.into_any())
            }
        }
    }

    /// Standard deviation of the values: None, a number, or an array laid out as the values.
    #[getter]
    fn sigma<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
        match self.inner.map_sigma() {
            None => Ok(None),
            Some(MapSigma::Constant(s)) => Ok(Some(shaped(py, vec![*s], &[])?)),
            Some(MapSigma::Grid(g)) => Ok(Some(shaped(py, g.clone(), &[self.inner.y().len(), self.inner.x().len()])?)),
        }
    }

    /// Height of the values, metres above the height datum: None, a number, or an array laid out as the values.
    #[getter]
    fn height_m<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
        match self.inner.height() {
            None => Ok(None),
            Some(MapHeight::Level(h)) => Ok(Some(shaped(py, vec![*h], &[])?)),
            Some(MapHeight::Drape(d)) => {
                Ok(Some(shaped(py, d.clone(), &[self.inner.y().len(), self.inner.x().len()])?))
            }
        }
    }

    /// The same map with the statistics of its errors: see `geomag.survey`.
    ///
    /// A layer `distance_m` lies as the arrays that the map was made of, north up or not, as `sigma` does there; with
    /// `layout="values"` it lies as `values`, y ascending, which is what `error_model` says of its own.
    ///
    /// The five after `distance_m` are what a filter has to know (`Navigator`): sigma of a single sample over the stored
    /// sigma; that of the mean over a batch over that of a sample; misfit of crossing lines, value units; displacement of the map's
    /// features and the length over which it changes, both in distances to the data. Where one is given the others have their
    /// defaults; without any the navigator uses its own. `recalibration` (slope, intercept) is a line in log-odds from the risk that the
    /// posterior computes to the one that is declared; `forecast` (level, spread, registration) says how planned flights fare (`predict_many`): level is a factor on the map's
    /// errors in simulated flights, spread one on the standard deviation that the local information gives, and registration, in distances to the data, what no information takes away, per axis. `covariance_factor` leads from the covariance that the posterior computes of a fix to the one that is declared. `lapses` (share, metres) makes tracks shorter than that length riskier: of those of length l a
    /// share times ((metres / l)^2 - 1) is taken to be wrong whatever the posterior says. `misfit_threshold` is the log evidence that an effect which was not told must gain for a fix to be
    /// rejected, as in `match_posterior`.
    #[pyo3(signature = (*, nu, scale_spread, correlation, registration, distance_m, sample_factor = None,
                        batch_factor = None, crossover = None, registration_m_per_d = None, registration_length = None,
                        recalibration = None, forecast = None, layout = "given",
                        misfit_threshold = None, lapses = None, covariance_factor = None))]
    #[allow(clippy::too_many_arguments)] // one each, keyword-only
    fn with_error_model(
        &self,
        nu: f64,
        scale_spread: f64,
        correlation: f64,
        registration: f64,
        distance_m: &Bound<'_, PyAny>,
        sample_factor: Option<f64>,
        batch_factor: Option<f64>,
        crossover: Option<f64>,
        registration_m_per_d: Option<f64>,
        registration_length: Option<f64>,
        recalibration: Option<(f64, f64)>,
        forecast: Option<ForecastNumbers>,
        layout: &str,
        misfit_threshold: Option<f64>,
        lapses: Option<(f64, f64)>,
        covariance_factor: Option<f64>,
    ) -> PyRes<Self> {
        let layer = if let Ok(constant) = distance_m.extract::<f64>() {
            DistanceLayer::Constant(constant)
        } else {
            let turned = match layout {
                "given" => self.turned,
                "values" => [false; 2],
                other => return Err(invalid("layout", "'given' or 'values'", format!("'{other}'"))),
            };
            let values = turn(&positive_layer("distance_m", distance_m, self.shape())?, self.shape(), turned);
            DistanceLayer::Grid(values.into_iter().map(|d| d as f32).collect())
        };
        let stated = [sample_factor, batch_factor, crossover, registration_m_per_d, registration_length];
        let usual = FilterLaw::default();
        let filter = stated.iter().any(Option::is_some).then(|| FilterLaw {
            sample_factor: sample_factor.unwrap_or(usual.sample_factor),
            batch_factor: batch_factor.unwrap_or(usual.batch_factor),
            crossover: crossover.unwrap_or(usual.crossover),
            registration_m_per_d: registration_m_per_d.unwrap_or(usual.registration_m_per_d),
            registration_length: registration_length.unwrap_or(usual.registration_length),
        });
        let recalibration = recalibration.map(|(slope, intercept)| Recalibration { slope, intercept });
        let forecast = forecast.map(Forecast::from);
        let lapses = lapses.map(|(share, length_m)| Lapses { share, length_m });
        let model = MapErrorModel {
            nu,
            scale_spread,
            correlation,
            registration,
            distance_m: layer,
            filter,
            recalibration,
            forecast,
            misfit_threshold,
            lapses,
            covariance_factor,
        };
        Ok(self.with_model(Some(model))?)
    }

    /// Length over which the errors that `sigma` states decorrelate, metres; None where nothing was said.
    #[getter]
    fn correlation_m(&self) -> Option<f64> {
        self.inner.correlation_m()
    }

    /// The statistics of the map's errors as a dictionary, or None.
    #[getter]
    fn error_model<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyDict>>> {
        let Some(model) = self.inner.error_model() else { return Ok(None) };
        let out = PyDict::new(py);
        out.set_item("nu", model.nu)?;
        out.set_item("scale_spread", model.scale_spread)?;
        out.set_item("correlation", model.correlation)?;
        out.set_item("registration", model.registration)?;
        match &model.distance_m {
            DistanceLayer::Constant(d) => out.set_item("distance_m", d)?,
            DistanceLayer::Grid(layer) => {
                let values = layer.iter().map(|d| f64::from(*d)).collect();
                out.set_item("distance_m", shaped(py, values, &[self.shape().0, self.shape().1])?)?;
                if self.turned != [false; 2] {
                    out.set_item("layout", "values")?;
                }
            }
        }
        if let Some(law) = &model.filter {
            out.set_item("sample_factor", law.sample_factor)?;
            out.set_item("batch_factor", law.batch_factor)?;
            out.set_item("crossover", law.crossover)?;
            out.set_item("registration_m_per_d", law.registration_m_per_d)?;
            out.set_item("registration_length", law.registration_length)?;
        }
        if let Some(line) = &model.recalibration {
            out.set_item("recalibration", (line.slope, line.intercept))?;
        }
        if let Some(forecast) = &model.forecast {
            out.set_item("forecast", (forecast.level, forecast.spread, forecast.registration))?;
        }
        if let Some(lapses) = &model.lapses {
            out.set_item("lapses", (lapses.share, lapses.length_m))?;
        }
        if let Some(factor) = model.covariance_factor {
            out.set_item("covariance_factor", factor)?;
        }
        if let Some(threshold) = model.misfit_threshold {
            out.set_item("misfit_threshold", threshold)?;
        }
        Ok(Some(out))
    }

    /// (rows, columns).
    #[getter]
    fn shape(&self) -> (usize, usize) {
        (self.inner.y().len(), self.inner.x().len())
    }

    /// Spacing (x, y), map units.
    #[getter]
    fn spacing(&self) -> (f64, f64) {
        (self.inner.x().step(), self.inner.y().step())
    }

    /// Spacing (east, north) at the middle of the map, metres.
    #[getter]
    fn spacing_m(&self) -> (f64, f64) {
        let y = 0.5 * (self.inner.y().first() + self.inner.y().last());
        let [east, north] = self.inner.metres_per_unit(y);
        (self.inner.x().step() * east, self.inner.y().step() * north)
    }

    /// Whether coordinates are degrees of longitude and latitude.
    #[getter]
    fn geographic(&self) -> bool {
        self.inner.geographic()
    }

    /// Metres on the ground per map unit (east, north) of every row, y ascending, shape (len(y), 2); None where a metre of the
    /// map is one on the ground.
    #[getter]
    fn ground_scale<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
        self.inner.ground_scale().map(|rows| shaped(py, rows.concat(), &[rows.len(), 2])).transpose()
    }

    /// The same map with the scale of its projection: see `geomag.projection.true_scale`.
    fn with_ground_scale(&self, ground_scale: &Bound<'_, PyAny>) -> PyRes<Self> {
        self.scaled(ground_scale, false)
    }

    /// Number of NaN nodes.
    #[getter]
    fn holes(&self) -> usize {
        self.inner.holes()
    }

    /// Mean of the values that are not NaN.
    #[getter]
    fn mean(&self) -> f64 {
        self.inner.mean()
    }

    /// Name of the field, where known.
    #[getter]
    fn name(&self) -> Option<&str> {
        self.labels.name.as_deref()
    }

    /// Unit of the values, where known.
    #[getter]
    fn units(&self) -> Option<&str> {
        self.labels.units.as_deref()
    }

    /// Coordinate reference system as text, where known.
    #[getter]
    fn crs(&self) -> Option<&str> {
        self.labels.crs.as_deref()
    }

    /// Distance between the survey lines behind the map, metres, where known.
    #[getter]
    fn line_spacing_m(&self) -> Option<f64> {
        self.labels.line_spacing_m
    }

    /// Metres per map unit (east, north) at a y: one on projected maps, WGS84 radii on geographic ones.
    ///
    /// Raises `InvalidInputError` for a latitude beyond a pole.
    pub fn metres_per_unit(&self, y: f64) -> PyRes<(f64, f64)> {
        if self.inner.geographic() && y.abs() > 90.0 {
            return Err(invalid("y of a geographic map", "a latitude in [-90, 90] degrees", y));
        }
        let [east, north] = self.inner.metres_per_unit(y);
        Ok((east, north))
    }

    /// Values at points; arrays of any shape are broadcast. NaN off the map and next to holes.
    #[pyo3(signature = (x, y, *, interpolation = "bilinear", method = None))]
    fn sample<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        y: &Bound<'py, PyAny>,
        interpolation: &str,
        method: Option<&str>,
    ) -> PyRes<Bound<'py, PyAny>> {
        let interpolation = read_by(py, self::interpolation(interpolation)?, method)?;
        let ([x, y], shape) = broadcast(["x", "y"], [x, y])?;
        let values = crate::pool::detached(py, || self.inner.sample_many(&x, &y, interpolation));
        shaped(py, values, &shape)
    }

    /// Gradient (east, north) per metre at points, analytic; NaN off the map and next to holes.
    #[pyo3(signature = (x, y, *, interpolation = "bilinear", method = None))]
    fn gradient<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        y: &Bound<'py, PyAny>,
        interpolation: &str,
        method: Option<&str>,
    ) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let interpolation = read_by(py, self::interpolation(interpolation)?, method)?;
        let ([x, y], shape) = broadcast(["x", "y"], [x, y])?;
        let (east, north) = crate::pool::detached(py, || {
            x.iter()
                .zip(&y)
                .map(|(&x, &y)| self.inner.sample_and_gradient(x, y, interpolation).1)
                .map(|[e, n]| (e, n))
                .unzip::<f64, f64, Vec<_>, Vec<_>>()
        });
        Ok((shaped(py, east, &shape)?, shaped(py, north, &shape)?))
    }

    /// Least and greatest bilinear value within half_width (x, y) of points; NaN where any of it is unknown.
    #[pyo3(signature = (x, y, *, half_width))]
    fn bounds<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        y: &Bound<'py, PyAny>,
        half_width: &Bound<'py, PyAny>,
    ) -> PyRes<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let [half_x, half_y] = crate::arrays::pair("half_width", half_width)?;
        let ([x, y], shape) = broadcast(["x", "y"], [x, y])?;
        let (least, greatest) = crate::pool::detached(py, || {
            x.iter()
                .zip(&y)
                .map(|(&x, &y)| self.inner.bounds(x, y, half_x, half_y).unwrap_or((f64::NAN, f64::NAN)))
                .unzip::<f64, f64, Vec<_>, Vec<_>>()
        });
        Ok((shaped(py, least, &shape)?, shaped(py, greatest, &shape)?))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        let py = slf.py();
        let this = slf.get();
        let (x, y) = (this.inner.x(), this.inner.y());
        let axes = ((x.first(), x.step()), (y.first(), y.step()));
        let labels = &this.labels;
        let text = (labels.name.clone(), labels.units.clone(), labels.crs.clone());
        let correlation_m = this.inner.correlation_m();
        let model = this.error_model(py)?;
        let errors = (this.sigma(py)?, correlation_m);
        let arguments = (
            this.values(py)?,
            axes,
            this.inner.geographic(),
            errors,
            text,
            model,
            this.height_m(py)?,
            this.ground_scale(py)?,
            this.turned,
            labels.line_spacing_m,
        );
        reduced(slf, arguments)
    }

    #[staticmethod]
    #[pyo3(signature = (values, axes, geographic, errors, text, model, height_m = None, ground_scale = None,
                        turned = [false, false], line_spacing_m = None))]
    #[allow(clippy::type_complexity, clippy::too_many_arguments)] // the tuple that __reduce__ wrote
    fn _restore(
        values: &Bound<'_, PyAny>,
        axes: ((f64, f64), (f64, f64)),
        geographic: bool,
        errors: (Option<Bound<'_, PyAny>>, Option<f64>),
        text: (Option<String>, Option<String>, Option<String>),
        model: Option<&Bound<'_, PyDict>>,
        height_m: Option<&Bound<'_, PyAny>>,
        ground_scale: Option<&Bound<'_, PyAny>>,
        turned: [bool; 2],
        line_spacing_m: Option<f64>,
    ) -> PyRes<Self> {
        let (values, rows, columns) = grid_values(values)?;
        // Axes are rebuilt from start and step, so that a map comes back to the last bit.
        let x = Axis::new(axes.0.0, axes.0.1, columns)?;
        let y = Axis::new(axes.1.0, axes.1.1, rows)?;
        let (sigma, correlation_m) = errors;
        let sigma = match sigma {
            None => None,
            Some(s) => Some(match s.extract::<f64>() {
                Ok(constant) => MapSigma::Constant(constant),
                Err(_) => MapSigma::Grid(matrix("sigma", &s)?.0),
            }),
        };
        let height = match height_m {
            None => None,
            Some(h) => Some(match h.extract::<f64>() {
                Ok(level) => MapHeight::Level(level),
                Err(_) => MapHeight::Drape(matrix("height_m", h)?.0),
            }),
        };
        let inner = GridMap::from_axes(values, x, y, geographic)?
            .with_sigma(sigma)?
            .with_correlation_m(correlation_m)?
            .with_height(height)?;
        let line_spacing_m = length("line_spacing_m", line_spacing_m)?;
        let labels = Labels { name: text.0, units: text.1, crs: text.2, line_spacing_m };
        let mut map = Self { inner: Arc::new(inner), labels, turned };
        if let Some(scale) = ground_scale {
            map = map.scaled(scale, false)?;
        }
        let Some(model) = model else { return Ok(map) };
        let number = |key: &str| -> PyRes<f64> {
            match model.get_item(key)? {
                Some(value) => Ok(value.extract()?),
                None => Err(invalid("saved error model", key, "nothing")),
            }
        };
        let optional = |key: &str| -> PyRes<Option<f64>> { Ok(model.get_item(key)?.map(|v| v.extract()).transpose()?) };
        let pair =
            |key: &str| -> PyRes<Option<(f64, f64)>> { Ok(model.get_item(key)?.map(|v| v.extract()).transpose()?) };
        let Some(distance) = model.get_item("distance_m")? else {
            return Err(invalid("saved error model", "distance_m", "nothing"));
        };
        map.with_error_model(
            number("nu")?,
            number("scale_spread")?,
            number("correlation")?,
            number("registration")?,
            &distance,
            optional("sample_factor")?,
            optional("batch_factor")?,
            optional("crossover")?,
            optional("registration_m_per_d")?,
            optional("registration_length")?,
            pair("recalibration")?,
            model.get_item("forecast")?.map(|v| v.extract()).transpose()?,
            "values",
            optional("misfit_threshold")?,
            pair("lapses")?,
            optional("covariance_factor")?,
        )
    }

    fn __repr__(&self) -> String {
        let (x, y) = (self.inner.x(), self.inner.y());
        let unit = if self.inner.geographic() { "deg" } else { "m" };
        format!(
            "GridMap({}{} x {} nodes, x {:.6}..{:.6} y {:.6}..{:.6} {unit}, spacing {:.6} x {:.6} {unit}, {}{})",
            self.labels.name.as_ref().map(|n| format!("{n}, ")).unwrap_or_default(),
            y.len(),
            x.len(),
            x.first(),
            x.last(),
            y.first(),
            y.last(),
            x.step(),
            y.step(),
            match self.inner.values() {
                GridValues::F32(_) => "float32",
                GridValues::F64(_) => "float64",
            },
            if self.inner.holes() > 0 { format!(", {} holes", self.inner.holes()) } else { String::new() },
        )
    }
}

/// Level, spread and registration of a forecast, or the first two, which is no registration.
#[derive(FromPyObject)]
enum ForecastNumbers {
    Law(f64, f64, f64),
    Factors(f64, f64),
}

impl From<ForecastNumbers> for Forecast {
    fn from(numbers: ForecastNumbers) -> Self {
        match numbers {
            ForecastNumbers::Law(level, spread, registration) => Self { level, spread, registration },
            ForecastNumbers::Factors(level, spread) => Self { level, spread, ..Self::default() },
        }
    }
}

/// The field behind whatever was passed as a map.
pub fn field(object: &Bound<'_, PyAny>) -> PyRes<Arc<dyn Field>> {
    if let Ok(grid) = object.cast::<PyGridMap>() {
        return Ok(grid.get().inner.clone());
    }
    if let Ok(map) = object.cast::<PyHarmonicMap>() {
        return Ok(map.get().inner.clone());
    }
    if let Ok(stack) = object.cast::<PyMapStack>() {
        return Ok(stack.get().inner.clone());
    }
    Err(invalid("grid", "a geomag.GridMap, MapStack or HarmonicMap", object.get_type().name()?))
}
