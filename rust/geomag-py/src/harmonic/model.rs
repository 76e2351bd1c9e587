//! `RectangularHarmonicModel`.

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::harmonic::{
    HarmonicMap, MAX_ORDER, Observations, Positions, Quantity, RectangularHarmonicModel, leave_out, select, terms,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use super::fitting;
use super::map::PyHarmonicMap;
use super::observations::PyFieldObservations;
use super::points::{Points, region};
use super::quantity::{main_vector, quantity};
use super::request::{Request, keywords};
use crate::arrays::{broadcast, matrix, pair, shaped, vector};
use crate::error::{PyRes, file_error, invalid};
use crate::frame::{PyLocalFrame, stacked, vectors};
use crate::long_call;

/// A rectangular harmonic model of a potential field in a source-free box.
///
/// In the frame of the model (x north, y east, z down, metres)
/// ``V = A x + B y + C z + sum_q sum_t P_tr(x, y) exp(u z)`` and the field is ``-grad V``. Made by `fit`,
/// `fit_observations`, `from_coefficients` or `from_json`.
///
/// For maps of tens to hundreds of kilometres from any mixture of observations, for upward continuation and for smooth
/// gradients. Not for a region with sources in it, nor for the main field itself.
///
/// Sources: Alldredge 1981, doi 10.1029/JB086iB04p03021; Zhao, Huang, Wang, Liu 2012,
/// doi 10.3969/j.issn.1006-1576.2012.12.010, with its garbled sums mended.
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> north, east = (a.ravel() for a in np.meshgrid(np.linspace(-5e3, 5e3, 15), np.linspace(-5e3, 5e3, 15)))
/// >>> down = 30 * np.cos(north / 1e3)                    # of V = -3e4 cos(x / 1 km) exp(z / 1 km) at z = 0
/// >>> field = np.stack([-30 * np.sin(north / 1e3), 0 * down, down], axis=-1)
/// >>> model = geomag.RectangularHarmonicModel.fit(north, east, 0.0, field, order=12)
/// >>> bool(abs(model.field(1e3, 0.0, -500.0)[2] - 30 * np.cos(1) * np.exp(-0.5)) < 0.02)
/// True
/// >>> model.field(9e4, 0.0, 0.0)
/// array([nan, nan, nan])
#[pyclass(frozen, name = "RectangularHarmonicModel", module = "geomag", weakref)]
pub struct PyHarmonicModel {
    /// The model, shared with maps and navigators made from it.
    pub inner: Arc<RectangularHarmonicModel>,
}

impl PyHarmonicModel {
    fn fitted(
        py: Python<'_>,
        observations: &Observations,
        threads: Option<usize>,
        progress: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyRes<Self> {
        let request = Request::new(&keywords(py, options)?)?;
        let model = long_call::run(py, request.units(observations.len()), threads, progress, |monitor| {
            request.run(observations, monitor)
        })?;
        Ok(Self { inner: Arc::new(model) })
    }

    fn scattered<'py, T: Send>(
        &self,
        py: Python<'py>,
        axes: [&Bound<'py, PyAny>; 3],
        evaluate: impl FnOnce(&RectangularHarmonicModel, &Positions<'_>) -> Result<T, Error> + Send,
    ) -> PyRes<(T, Vec<usize>)> {
        let points = Points::new(axes[0], axes[1], axes[2])?;
        let positions = points.positions()?;
        let model = &*self.inner;
        let values = crate::pool::detached(py, || evaluate(model, &positions))?;
        Ok((values, points.shape))
    }

    /// The map of a scalar on a level.
    pub fn level(&self, quantity: Quantity, down_m: Option<f64>, height_m: Option<f64>) -> PyRes<HarmonicMap> {
        let model = Arc::clone(&self.inner);
        match (down_m, height_m) {
            (Some(_), Some(_)) => Err(invalid("level", "one of down_m and height_m", "both")),
            (down, None) => Ok(HarmonicMap::at_down(model, quantity, down.unwrap_or(0.0))?),
            (None, Some(height)) => Ok(HarmonicMap::at_height(model, quantity, height)?),
        }
    }
}

#[pymethods]
impl PyHarmonicModel {
    /// Fit a model to field vectors, anomalies or intensities at points of the frame.
    ///
    /// Parameters
    /// ----------
    /// north_m, east_m, down_m : array
    ///     Points in the frame, metres, of shapes that broadcast to n points.
    /// field : array of shape (n, 3) or (n,)
    ///     North, east, down in the axes of the frame, NaN components left out; with `main_field` a scalar a point.
    /// main_field : array of shape (3,) or (n, 3), optional
    ///     Main field, north, east, down in the axes of the frame, in the unit of `field`: `field` is then a scalar.
    /// kind : {'anomaly', 'intensity'}
    ///     What the scalar is: the projection on the main field, or the length of main field plus model.
    /// sigma : float or array of shape (n,), optional
    ///     Standard deviation of the observations, field unit, > 0; all alike by default.
    /// threads : int, optional
    ///     Threads to use, all cores by default; the answer does not depend on it.
    /// progress : bool or callable, optional
    ///     True for a bar, or a callable (done, total).
    /// order : int or sequence of int
    ///     N, 0 to 60, 12 by default; ``3 + 2 N (N + 1)`` coefficients. Of several, here and in the other options that
    ///     may be sequences, cross-validation takes the best.
    /// period_ratio : float or sequence of float
    ///     Periods over the extent of the points, >= 1; 1.5 by default, 1 is the paper's.
    /// periods_m : (float, float), optional
    ///     Periods (north, east) in metres instead.
    /// ridge : float or sequence of float
    ///     Ridge for columns of unit norm, 1e-9 by default; 0 for plain least squares.
    /// truncation : float, optional
    ///     Leave out singular values below this share of the largest, instead of a ridge.
    /// damping_m, spectrum_power, anisotropy : float or sequence of float
    ///     How the ridge grows with the wave number u: ``(u / u0)**spectrum_power * exp(2 u damping_m)``, u with the north
    ///     counted more where `anisotropy` is above 1. For survey lines; 0, 0 and 1 by default: all alike.
    /// huber : float, optional
    ///     Huber's bound in standard deviations (1.345 is usual): larger residuals count linearly.
    /// max_iterations : int
    ///     Most solutions for intensities and for Huber's weights, 20 by default.
    /// covariance : bool
    ///     Keep the covariance of the coefficients, without which there is no `sigma`; True by default.
    /// misfit : bool
    ///     Learn `misfit` from left-out points, so that `sigma` holds what the order leaves out; False by default.
    /// folds, groups, seed : int, sequence of n labels, int
    ///     Parts of a cross-validation (5), points that are left out together (a label a point, of any kind), seed of the
    ///     deal (0).
    /// frame : LocalFrame, optional
    ///     Where the frame is on the Earth: needed for degrees and heights later.
    /// unit : str
    ///     Unit of the field, 'nT' by default.
    ///
    /// Returns
    /// -------
    /// RectangularHarmonicModel
    ///
    /// Raises
    /// ------
    /// InvalidInputError, ShapeError, NotFiniteError
    ///     For options out of range, arrays that do not fit each other, values that are not finite.
    /// TooFewSamplesError
    ///     For fewer numbers than coefficients, unless a prior (`damping_m`, `spectrum_power`) settles them.
    /// RankDeficientError
    ///     Where neither the points nor a ridge decide the coefficients.
    ///
    /// Examples
    /// --------
    /// >>> import numpy as np, geomag
    /// >>> north, east = (a.ravel() for a in np.meshgrid(np.linspace(-5e3, 5e3, 15), np.linspace(-5e3, 5e3, 15)))
    /// >>> down = 30 * np.cos(north / 1e3)
    /// >>> field = np.stack([-30 * np.sin(north / 1e3), 0 * down, down], axis=-1)
    /// >>> model = geomag.RectangularHarmonicModel.fit(north, east, 0.0, field, order=[6, 12])
    /// >>> model.order, model.summary["n_observations"]
    /// (12, 675)
    #[staticmethod]
    #[pyo3(signature = (north_m, east_m, down_m, field, *, main_field = None, kind = "anomaly", sigma = None,
                        threads = None, progress = None, **options))]
    #[allow(clippy::too_many_arguments)] // one each, keyword-only
    fn fit<'py>(
        py: Python<'py>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        field: &Bound<'py, PyAny>,
        main_field: Option<&Bound<'py, PyAny>>,
        kind: &str,
        sigma: Option<&Bound<'py, PyAny>>,
        threads: Option<usize>,
        progress: Option<&Bound<'py, PyAny>>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyRes<Self> {
        let observations = fitting::observations([north_m, east_m, down_m], field, main_field, kind, sigma)?;
        Self::fitted(py, &observations, threads, progress, options)
    }

    /// Fit a model to a mixture of observations.
    ///
    /// Parameters
    /// ----------
    /// observations : FieldObservations
    ///     Components, anomalies and intensities, each with its own sigma.
    /// threads, progress, **options
    ///     As in `fit`: `order`, `period_ratio`, `periods_m`, `ridge`, `truncation`, `damping_m`, `spectrum_power`, `anisotropy`,
    ///     `huber`, `max_iterations`, `covariance`, `misfit`, `folds`, `groups`, `seed`, `frame`, `unit`.
    ///
    /// Returns
    /// -------
    /// RectangularHarmonicModel
    ///
    /// Raises
    /// ------
    /// InvalidInputError, ShapeError, NotFiniteError, TooFewSamplesError, RankDeficientError
    ///     As `fit`.
    #[staticmethod]
    #[pyo3(signature = (observations, *, threads = None, progress = None, **options))]
    fn fit_observations(
        py: Python<'_>,
        observations: &PyFieldObservations,
        threads: Option<usize>,
        progress: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyRes<Self> {
        Self::fitted(py, &observations.snapshot(py), threads, progress, options)
    }

    /// Cross-validate orders, period ratios, ridges and priors without keeping a model.
    ///
    /// Parameters
    /// ----------
    /// observations : FieldObservations
    ///     What is fitted and left out.
    /// threads, progress, **options
    ///     As in `fit`; a list for `order`, `period_ratio`, `ridge`, `damping_m`, `spectrum_power` or `anisotropy` is tried in all
    ///     combinations, in `folds` parts, with `groups` left out together.
    ///
    /// Returns
    /// -------
    /// best : dict
    ///     The choice of least `rms`: `order`, `period_ratio`, `ridge`, `damping_m`, `spectrum_power`, `anisotropy`, `rms` (of the
    ///     weighted residuals of what was left out) and `rms_error` (its standard error over the parts).
    /// all : list of dict
    ///     Every choice, in the order tried.
    ///
    /// Raises
    /// ------
    /// InvalidInputError, ShapeError, NotFiniteError, TooFewSamplesError, RankDeficientError
    ///     As `fit`; also for fewer than two parts and fewer labels than parts.
    #[staticmethod]
    #[pyo3(signature = (observations, *, threads = None, progress = None, **options))]
    fn select<'py>(
        py: Python<'py>,
        observations: &PyFieldObservations,
        threads: Option<usize>,
        progress: Option<&Bound<'py, PyAny>>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyRes<(Bound<'py, PyDict>, Bound<'py, PyList>)> {
        let observations = observations.snapshot(py);
        let request = Request::new(&keywords(py, options)?)?;
        let found = long_call::run(py, request.units(observations.len()), threads, progress, |monitor| {
            select(&observations, &request.selection(), &request.options, monitor)
        })?;
        fitting::choices(py, &found)
    }

    /// Predict each part of the observations from the others: how far off a model is where it was not fitted.
    ///
    /// Parameters
    /// ----------
    /// observations : FieldObservations
    ///     What is fitted and left out; n numbers.
    /// threads, progress, **options
    ///     As in `fit`, one value each (of several the first counts); `folds` parts, with `groups` left out together.
    ///
    /// Returns
    /// -------
    /// dict
    ///     `errors` (n,), observed minus predicted, and `sigma` (n,), of the coefficients alone, both in the unit of the field;
    ///     `nugget` and `scale`, the `misfit` that agrees with them best.
    ///
    /// Raises
    /// ------
    /// InvalidInputError, ShapeError, NotFiniteError, TooFewSamplesError, RankDeficientError
    ///     As `fit`; also for fewer than two parts and fewer labels than parts.
    #[staticmethod]
    #[pyo3(signature = (observations, *, threads = None, progress = None, **options))]
    fn leave_out<'py>(
        py: Python<'py>,
        observations: &PyFieldObservations,
        threads: Option<usize>,
        progress: Option<&Bound<'py, PyAny>>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyRes<Bound<'py, PyDict>> {
        let observations = observations.snapshot(py);
        let request = Request::new(&keywords(py, options)?)?;
        let units = request.units(observations.len()).saturating_mul(request.folds as u64);
        let left = long_call::run(py, units, threads, progress, |monitor| {
            let groups = request.groups.as_deref();
            leave_out(&observations, &request.options, request.folds, groups, request.seed, monitor)
        })?;
        fitting::left_out(py, left)
    }

    /// A model from coefficients that are known.
    ///
    /// Parameters
    /// ----------
    /// order : int
    ///     N.
    /// periods_m : (float, float)
    ///     Periods (north, east), metres, > 0.
    /// coefficients : array of shape (3 + 2 N (N + 1),)
    ///     A, B, C, then those of `terms(order)`; field unit times metre, A, B and C field unit.
    /// region : array of shape (3, 2)
    ///     From and to along north, east and down, metres: where the model answers.
    /// frame : LocalFrame, optional
    ///     Where the frame is on the Earth.
    /// unit : str
    ///     Unit of the field.
    /// covariance : array of shape (n, n), optional
    ///     Covariance of the coefficients, for `sigma`.
    ///
    /// Returns
    /// -------
    /// RectangularHarmonicModel
    ///
    /// Raises
    /// ------
    /// InvalidInputError, ShapeError, NotFiniteError
    #[staticmethod]
    #[pyo3(signature = (order, periods_m, coefficients, *, region, frame = None, unit = "nT", covariance = None))]
    fn from_coefficients(
        order: usize,
        periods_m: &Bound<'_, PyAny>,
        coefficients: &Bound<'_, PyAny>,
        region: &Bound<'_, PyAny>,
        frame: Option<&PyLocalFrame>,
        unit: &str,
        covariance: Option<&Bound<'_, PyAny>>,
    ) -> PyRes<Self> {
        let coefficients = vector("coefficients", coefficients)?;
        let periods = pair("periods_m", periods_m)?;
        let mut model = RectangularHarmonicModel::new(order, periods, coefficients, self::region("region", region)?)?
            .with_frame(frame.map(|f| f.inner))
            .with_unit(unit);
        if let Some(covariance) = covariance {
            let (values, rows, columns) = matrix("covariance", covariance)?;
            if rows != columns {
                return Err(Error::shape("covariance", "a square matrix", format!("({rows}, {columns})")).into());
            }
            model = model.with_covariance(&values)?;
        }
        Ok(Self { inner: Arc::new(model) })
    }

    /// `(t, r, along x, along y)` of every coefficient after A, B, C.
    #[staticmethod]
    fn terms(order: usize) -> PyRes<Vec<(usize, usize, &'static str, &'static str)>> {
        if order > MAX_ORDER {
            return Err(invalid("order", &format!("at most {MAX_ORDER}"), order));
        }
        let name = |sine: bool| if sine { "sin" } else { "cos" };
        Ok(terms(order).map(|t| (t.t, t.r, name(t.sine_x), name(t.sine_y))).collect())
    }

    /// Field at points in the frame (metres, any shape that broadcasts): that shape and (3,) for north, east, down, in the model's
    /// unit. NaN outside the region of the observations unless `extrapolate`.
    #[pyo3(signature = (north_m, east_m, down_m, *, extrapolate = false))]
    fn field<'py>(
        &self,
        py: Python<'py>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        extrapolate: bool,
    ) -> PyRes<Bound<'py, PyAny>> {
        let (values, shape) =
            self.scattered(py, [north_m, east_m, down_m], |model, p| Ok(model.field(p, extrapolate)))?;
        stacked(py, values, &shape)
    }

    /// Total intensity of the modelled field plus a constant `main_field` (3,), at points as in `field`.
    #[pyo3(signature = (north_m, east_m, down_m, *, main_field = None, extrapolate = false))]
    fn intensity<'py>(
        &self,
        py: Python<'py>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        main_field: Option<&Bound<'py, PyAny>>,
        extrapolate: bool,
    ) -> PyRes<Bound<'py, PyAny>> {
        let main = main_vector(main_field)?.unwrap_or([0.0; 3]);
        let (values, shape) =
            self.scattered(py, [north_m, east_m, down_m], |model, p| Ok(model.intensity(p, main, extrapolate)))?;
        shaped(py, values, &shape)
    }

    /// Potential at points as in `field`, field unit times metre.
    #[pyo3(signature = (north_m, east_m, down_m, *, extrapolate = false))]
    fn potential<'py>(
        &self,
        py: Python<'py>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        extrapolate: bool,
    ) -> PyRes<Bound<'py, PyAny>> {
        let (values, shape) =
            self.scattered(py, [north_m, east_m, down_m], |model, p| Ok(model.potential(p, extrapolate)))?;
        shaped(py, values, &shape)
    }

    /// Gradient tensor at points as in `field`: their shape and (3, 3), row = component, column = direction, field unit per metre.
    /// Symmetric, trace zero.
    #[pyo3(signature = (north_m, east_m, down_m, *, extrapolate = false))]
    fn gradient<'py>(
        &self,
        py: Python<'py>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        extrapolate: bool,
    ) -> PyRes<Bound<'py, PyAny>> {
        let (values, mut shape) =
            self.scattered(py, [north_m, east_m, down_m], |model, p| Ok(model.gradient(p, extrapolate)))?;
        shape.extend([3, 3]);
        shaped(py, values.into_flattened().into_flattened(), &shape)
    }

    /// Standard deviation of the modelled field at points as in `field`: their shape and (3,) for the components, or along
    /// `direction` ((3,) or one a point) the points' shape.
    ///
    /// The error of the fit, and where the model was told of it (`misfit`) what the order leaves out. Raises `InvalidInputError` where
    /// the model has no covariance.
    #[pyo3(signature = (north_m, east_m, down_m, *, direction = None, extrapolate = false))]
    fn sigma<'py>(
        &self,
        py: Python<'py>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: &Bound<'py, PyAny>,
        direction: Option<&Bound<'py, PyAny>>,
        extrapolate: bool,
    ) -> PyRes<Bound<'py, PyAny>> {
        let axes = [north_m, east_m, down_m];
        if let Some(direction) = direction {
            let directions = vectors("direction", direction)?.0;
            let (values, shape) =
                self.scattered(py, axes, |model, p| model.sigma_along(p, &directions, extrapolate))?;
            return shaped(py, values, &shape);
        }
        let (values, shape) = self.scattered(py, axes, |model, p| model.sigma(p, extrapolate))?;
        stacked(py, values, &shape)
    }

    /// Field on a grid at one height: axes `north_m` (n,) and `east_m` (m,), one `down_m`; (n, m, 3). The same as `field`, faster.
    #[pyo3(signature = (north_m, east_m, down_m, *, extrapolate = false))]
    fn field_grid<'py>(
        &self,
        py: Python<'py>,
        north_m: &Bound<'py, PyAny>,
        east_m: &Bound<'py, PyAny>,
        down_m: f64,
        extrapolate: bool,
    ) -> PyRes<Bound<'py, PyAny>> {
        let (north, east) = (vector("north_m", north_m)?, vector("east_m", east_m)?);
        let model = &*self.inner;
        let values = crate::pool::detached(py, || model.field_grid(&north, &east, down_m, extrapolate))?;
        stacked(py, values, &[north.len(), east.len()])
    }

    /// Field, north, east, down at each point itself, at geographic points (degrees, degrees, metres above the frame's Earth).
    ///
    /// Raises `InvalidInputError` for a model without a frame.
    #[pyo3(signature = (latitude_deg, longitude_deg, height_m, *, extrapolate = false))]
    fn field_geographic<'py>(
        &self,
        py: Python<'py>,
        latitude_deg: &Bound<'py, PyAny>,
        longitude_deg: &Bound<'py, PyAny>,
        height_m: &Bound<'py, PyAny>,
        extrapolate: bool,
    ) -> PyRes<Bound<'py, PyAny>> {
        let names = ["latitude_deg", "longitude_deg", "height_m"];
        let ([lat, lon, h], shape) = broadcast(names, [latitude_deg, longitude_deg, height_m])?;
        let values = crate::pool::detached(py, || self.inner.field_geographic(&lat, &lon, &h, extrapolate))?;
        stacked(py, values, &shape)
    }

    /// The model at one height as a field that matchers take in place of a map.
    ///
    /// `quantity` is 'north', 'east', 'down', or with `main_field` 'projection' (the field along it), 'anomaly' or 'intensity'; the
    /// level is `down_m` in the frame or `height_m` above the Earth.
    #[pyo3(signature = (quantity = "down", *, main_field = None, down_m = None, height_m = None))]
    fn to_map(
        &self,
        quantity: &str,
        main_field: Option<&Bound<'_, PyAny>>,
        down_m: Option<f64>,
        height_m: Option<f64>,
    ) -> PyRes<PyHarmonicMap> {
        let quantity = self::quantity(quantity, main_vector(main_field)?)?;
        Ok(PyHarmonicMap { inner: Arc::new(self.level(quantity, down_m, height_m)?), down_m, height_m })
    }

    /// A `GridMap` of the model at one height, at the nodes of two ascending axes. Options as in `to_map`.
    #[pyo3(signature = (x, y, *, quantity = "down", main_field = None, down_m = None, height_m = None))]
    #[allow(clippy::too_many_arguments)] // one each, keyword-only
    fn sample_to_grid<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        y: &Bound<'py, PyAny>,
        quantity: &str,
        main_field: Option<&Bound<'py, PyAny>>,
        down_m: Option<f64>,
        height_m: Option<f64>,
    ) -> PyRes<Bound<'py, PyAny>> {
        self.to_map(quantity, main_field, down_m, height_m)?.to_grid(py, x, y)
    }

    /// The model as text, or into the file `path`; without the covariance of the coefficients where `covariance` is false.
    #[pyo3(signature = (path = None, *, covariance = true))]
    fn to_json(&self, py: Python<'_>, path: Option<std::path::PathBuf>, covariance: bool) -> PyRes<Option<String>> {
        let text = crate::pool::detached(py, || {
            if covariance { self.inner.to_json() } else { (*self.inner).clone().without_covariance().to_json() }
        })?;
        match path {
            None => Ok(Some(text)),
            Some(path) => {
                std::fs::write(&path, text).map_err(|e| file_error(&path, &e))?;
                Ok(None)
            }
        }
    }

    /// A model from a file that `to_json` wrote, or from its text.
    ///
    /// Parameters
    /// ----------
    /// path : str or path
    ///     The file; a text that begins with a brace is taken as the model itself.
    ///
    /// Returns
    /// -------
    /// RectangularHarmonicModel
    ///
    /// Raises
    /// ------
    /// MissingFileError, ReadError
    ///     Where the file is not there or cannot be read.
    /// StateError
    ///     Where it holds no model.
    #[staticmethod]
    fn from_json(py: Python<'_>, path: &Bound<'_, PyAny>) -> PyRes<Self> {
        let given: Option<String> = path.extract().ok();
        let text = match given {
            Some(text) if text.trim_start().starts_with('{') => text,
            _ => {
                let path: std::path::PathBuf = path.extract()?;
                std::fs::read_to_string(&path).map_err(|e| file_error(&path, &e))?
            }
        };
        Ok(Self { inner: Arc::new(crate::pool::detached(py, || RectangularHarmonicModel::from_json(&text))?) })
    }

    /// Order of the model.
    #[getter]
    fn order(&self) -> usize {
        self.inner.order()
    }

    /// Periods (north, east), metres.
    #[getter]
    fn periods_m(&self) -> (f64, f64) {
        self.inner.periods_m().into()
    }

    /// Coefficients, (n,): those of the constants first, then in the order of `terms`.
    #[getter]
    fn coefficients<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        let coefficients = self.inner.coefficients();
        shaped(py, coefficients.to_vec(), &[coefficients.len()])
    }

    /// Covariance of the coefficients, (n, n); none where the model was not fitted.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
        let n = self.inner.coefficients().len();
        self.inner.covariance().map(|c| shaped(py, c, &[n, n])).transpose()
    }

    /// Box that the observations filled: (3, 2), lower and upper bound north, east, down, metres.
    #[getter]
    fn region<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        let r = self.inner.region();
        shaped(py, [r.north_m, r.east_m, r.down_m].concat(), &[3, 2])
    }

    /// The local frame, where there is one.
    #[getter]
    fn frame(&self) -> Option<PyLocalFrame> {
        self.inner.frame().map(|&inner| PyLocalFrame { inner })
    }

    /// Unit of the field.
    #[getter]
    fn unit(&self) -> &str {
        self.inner.unit()
    }

    /// (nugget, scale) of `sigma**2 = nugget**2 + (scale * s)**2`, s from the covariance of the coefficients; (0, 1)
    /// where the model was not told of its misfit.
    #[getter]
    fn misfit(&self) -> (f64, f64) {
        let misfit = self.inner.misfit();
        (misfit.nugget, misfit.scale)
    }

    /// How the fit went; none where the model was not fitted. `undetermined` names the constants that no observation senses, such as a
    /// uniform field to the north where only the vertical component was measured: they are left out, nil in the model.
    #[getter]
    fn summary<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyDict>>> {
        let Some(s) = self.inner.summary() else { return Ok(None) };
        Ok(Some(fitting::summary(py, s)?))
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.inner == other.inner
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyRes<(Bound<'py, PyAny>, (String,))> {
        Ok((slf.get_type().getattr("from_json")?, (slf.get().inner.to_json()?,)))
    }

    fn __repr__(&self) -> String {
        let m = &self.inner;
        let [north, east] = m.periods_m();
        let fitted = m.summary().map_or_else(String::new, |s| {
            format!(", {} observations, residual {:.4} {} rms", s.n_observations, s.residual_rms, m.unit())
        });
        format!(
            "RectangularHarmonicModel(order {}, {} coefficients, periods {:.1} x {:.1} km{fitted})",
            m.order(),
            m.coefficients().len(),
            north / 1e3,
            east / 1e3
        )
    }
}
