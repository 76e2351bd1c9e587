//! `UnscentedKalmanFilter` and `ExtendedKalmanFilter`.

use geomag_core::error::Error;
use geomag_core::kalman::{ExtendedKalmanFilter, Innovation, MAX_STATES, Scaling, UnscentedKalmanFilter};
use geomag_core::scaling_options;
use numpy::{PyArray1, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::arrays::{array, shaped, vector};
use crate::class::{Reduced, reduced_to_bytes};
use crate::error::{PyError, PyRes, invalid};
use crate::lock::{Shared, Turns};
use crate::navigator::PyFieldSensor;
use crate::options::old_name;

type CoreMatrix = nalgebra::DMatrix<f64>;

fn row_major<'py>(py: Python<'py>, m: &CoreMatrix) -> PyRes<Bound<'py, PyAny>> {
    shaped(py, m.transpose().as_slice().to_vec(), &[m.nrows(), m.ncols()])
}

/// The limit of an update, by its name or by its old one.
fn limit(py: Python<'_>, max_nis: Option<f64>, gate: Option<f64>) -> PyRes<Option<f64>> {
    if gate.is_some() {
        old_name(py, "gate", "max_nis")?;
    }
    Ok(max_nis.or(gate))
}

/// A square matrix: given whole, as its diagonal, or as one number times the identity.
fn covariance(what: &str, n: usize, object: &Bound<'_, PyAny>) -> PyRes<Vec<f64>> {
    if n > MAX_STATES {
        return Err(invalid(what, &format!("at most {MAX_STATES} rows"), n));
    }
    let array = array(what, object)?;
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    let diagonal = |at: &dyn Fn(usize) -> f64| {
        (0..n * n).map(|k| if k / n == k % n { at(k / n) } else { 0.0 }).collect::<Vec<_>>()
    };
    match array.shape() {
        [] => Ok(diagonal(&|_| values[0])),
        &[len] if len == n => Ok(diagonal(&|i| values[i])),
        &[rows, columns] if rows == n && columns == n => Ok(values),
        other => Err(Error::shape(what, format!("({n}, {n}), ({n},) or a number"), format!("{other:?}")).into()),
    }
}

/// A function of the state: a Python callable, a matrix, or a field sensor that needs no Python at all.
enum Model<'py> {
    Callable(Bound<'py, PyAny>),
    Matrix(Vec<f64>, usize),
    Sensor(Bound<'py, PyFieldSensor>),
}

impl<'py> Model<'py> {
    fn new(what: &str, object: &Bound<'py, PyAny>, states: usize) -> PyRes<Self> {
        if let Ok(sensor) = object.cast::<PyFieldSensor>() {
            return Ok(Self::Sensor(sensor.clone()));
        }
        if object.is_callable() {
            return Ok(Self::Callable(object.clone()));
        }
        let (values, rows, columns) = crate::arrays::matrix(what, object)?;
        if columns == states {
            Ok(Self::Matrix(values, rows))
        } else {
            let needed = format!("a callable, a FieldSensor or a matrix with {states} columns");
            Err(invalid(what, &needed, format!("({rows}, {columns})")))
        }
    }

    fn call(&self, py: Python<'py>, what: &str, x: &[f64], out: &mut [f64]) -> PyRes<()> {
        match self {
            Self::Callable(f) => {
                let result = f.call1((PyArray1::from_slice(py, x),))?;
                let values = vector(what, &result)?;
                if values.len() != out.len() {
                    let needed = format!("({},)", out.len());
                    return Err(Error::shape(what, needed, format!("({},)", values.len())).into());
                }
                out.copy_from_slice(&values);
            }
            Self::Matrix(m, rows) => {
                if *rows != out.len() {
                    let needed = format!("({}, {})", out.len(), x.len());
                    return Err(Error::shape(what, needed, format!("({rows}, {})", x.len())).into());
                }
                for (o, row) in out.iter_mut().zip(m.chunks_exact(x.len())) {
                    *o = row.iter().zip(x).map(|(a, b)| a * b).sum();
                }
            }
            Self::Sensor(sensor) => {
                let sensing = &sensor.get().inner;
                if sensing.len() != out.len() || x.len() < 2 {
                    let needed = format!("{} numbers of a state that starts with x and y", sensing.len());
                    return Err(Error::shape(what, needed, format!("{} of {}", out.len(), x.len())).into());
                }
                sensing.read(&[[x[0], x[1]]], out);
            }
        }
        Ok(())
    }
}

impl PyUnscentedKalmanFilter {
    fn made(filter: UnscentedKalmanFilter) -> Self {
        Self { inner: Shared::new(filter), turns: Turns::default() }
    }

    fn snapshot(&self, py: Python<'_>) -> UnscentedKalmanFilter {
        self.inner.with(py, |f| f.clone())
    }

    /// A change that may call Python: on a copy, so that a model may look at the filter, and one after the other, so that none is
    /// lost.
    fn change<T>(&self, py: Python<'_>, change: impl FnOnce(&mut UnscentedKalmanFilter) -> PyRes<T>) -> PyRes<T> {
        self.turns.take(py, "UnscentedKalmanFilter", || {
            let mut filter = self.snapshot(py);
            let done = change(&mut filter)?;
            self.inner.with(py, |f| *f = filter);
            Ok(done)
        })
    }
}

macro_rules! unscented_class {
    (scaling [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*]) => {
        /// The scaled unscented Kalman filter, for any motion and any measurement.
        ///
        /// Parameters
        /// ----------
        /// x : array of shape (n,)
        ///     Mean of the state.
        /// P : array of shape (n, n)
        ///     Its covariance, symmetric positive definite.
        $(#[doc = row_doc!($name; $python; $($line)+)])*
        ///
        /// Notes
        /// -----
        /// `predict(f, Q)` and `update(z, h, R)` take a callable `state -> array`, a matrix for linear models, or (as h) a
        /// `FieldSensor`, which is read without Python. Q and R may be given whole, as a diagonal or as one number, and may be
        /// singular. Carried as a Cholesky factor that is turned by orthogonal transformations: for beta >= alpha**2 the
        /// covariance is positive definite by construction. Sigma points are drawn anew for every call.
        ///
        /// Sources: Julier & Uhlmann; Wan & van der Merwe 2000 (scaled transform); Zhao et al. 2012 with its predicted and
        /// innovation covariances mended.
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> ukf = geomag.UnscentedKalmanFilter([0.0, 1.0], np.diag([4.0, 1.0]))
        /// >>> ukf.predict(lambda x: [x[0] + x[1], x[1]], 0.1)
        /// >>> ukf.update([1.5], lambda x: [x[0]], 0.5)
        /// True
        /// >>> round(ukf.nis, 4)
        /// 0.0446
        #[pyclass(frozen, name = "UnscentedKalmanFilter", module = "geomag")]
        pub struct PyUnscentedKalmanFilter {
            inner: Shared<UnscentedKalmanFilter>,
            turns: Turns,
        }

        #[pymethods]
        impl PyUnscentedKalmanFilter {
            #[new]
            #[pyo3(signature = (x, P, *, $($name = $default,)*))]
            #[allow(non_snake_case)] // P as in every text on filters
            fn new(x: &Bound<'_, PyAny>, P: &Bound<'_, PyAny>, $($name: py_type!($kind),)*) -> PyRes<Self> {
                let mean = vector("x", x)?;
                let p = covariance("P", mean.len(), P)?;
                let inner = UnscentedKalmanFilter::new(&mean, &p, Scaling { $($name: py_value!(py $kind $name),)* })?;
                Ok(Self::made(inner))
            }

            /// Predicts with the model `f` (state (n,) to state (n,)) and the process noise `Q` (n, n).
            ///
            /// Raises `NotFiniteError`, `ShapeError`, `NotPositiveDefiniteError`; after an error the filter is as it was.
            #[allow(non_snake_case)] // Q as in every text on filters
            fn predict(&self, py: Python<'_>, f: &Bound<'_, PyAny>, Q: &Bound<'_, PyAny>) -> PyRes<()> {
                let n = self.inner.with(py, |f| f.estimate().len());
                let (model, q) = (Model::new("f", f, n)?, covariance("Q", n, Q)?);
                self.change(py, |filter| filter.predict::<PyError>(|x, out| model.call(py, "f", x, out), &q))
            }

            /// Takes in a measurement `z` (m,) with the model `h` (state (n,) to measurement (m,)) and its noise `R` (m, m).
            ///
            /// A measurement whose normalised innovation squared exceeds `max_nis` changes nothing (`gate` is its old name). Returns whether
            /// it was taken. Raises as
            /// `predict`.
            #[pyo3(signature = (z, h, R, *, max_nis = None, gate = None))]
            #[allow(non_snake_case)] // R as in every text on filters
            fn update(
                &self,
                py: Python<'_>,
                z: &Bound<'_, PyAny>,
                h: &Bound<'_, PyAny>,
                R: &Bound<'_, PyAny>,
                max_nis: Option<f64>,
                gate: Option<f64>,
            ) -> PyRes<bool> {
                let max_nis = limit(py, max_nis, gate)?;
                let z = vector("z", z)?;
                let n = self.inner.with(py, |f| f.estimate().len());
                let (model, r) = (Model::new("h", h, n)?, covariance("R", z.len(), R)?);
                self.change(py, |filter| {
                    Ok(filter.update::<PyError>(&z, |x, out| model.call(py, "h", x, out), &r, max_nis)?.accepted)
                })
            }

            /// State, (n,).
            #[getter]
            fn x<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                let mean = self.snapshot(py).estimate().mean().to_vec();
                let shape = [mean.len()];
                shaped(py, mean, &shape)
            }

            #[setter]
            fn set_x(&self, py: Python<'_>, x: &Bound<'_, PyAny>) -> PyRes<()> {
                let mean = vector("x", x)?;
                self.change(py, |filter| {
                    let p = filter.estimate().covariance();
                    Ok(filter.set(&mean, p.as_slice())?)
                })
            }

            /// Covariance of the state, (n, n).
            #[getter(P)]
            fn covariance<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                row_major(py, &self.snapshot(py).estimate().covariance())
            }

            #[setter(P)]
            fn set_covariance(&self, py: Python<'_>, p: &Bound<'_, PyAny>) -> PyRes<()> {
                let p = covariance("P", self.inner.with(py, |f| f.estimate().len()), p)?;
                self.change(py, |filter| {
                    let mean = filter.estimate().mean().to_vec();
                    Ok(filter.set(&mean, &p)?)
                })
            }

            /// Spread of the sigma points.
            #[getter]
            fn alpha(&self, py: Python<'_>) -> f64 {
                self.snapshot(py).scaling().alpha
            }

            /// Prior knowledge of the distribution; 2 for a normal one.
            #[getter]
            fn beta(&self, py: Python<'_>) -> f64 {
                self.snapshot(py).scaling().beta
            }

            /// Secondary scaling of the sigma points.
            #[getter]
            fn kappa(&self, py: Python<'_>) -> f64 {
                self.snapshot(py).scaling().kappa
            }

            /// Normalised innovation squared of the newest update; None before the first.
            #[getter]
            fn nis(&self, py: Python<'_>) -> Option<f64> {
                self.snapshot(py).innovation().map(|i| i.nis)
            }

            /// Innovation of the last update, (m,); none before one.
            #[getter]
            fn innovation<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
                residual(py, self.snapshot(py).innovation())
            }

            /// Covariance of the last innovation, (m, m); none before one.
            #[getter(S)]
            fn innovation_covariance<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
                self.snapshot(py).innovation().map(|i| row_major(py, &i.covariance)).transpose()
            }

            /// Gain of the last update, (n, m); none before one.
            #[getter(K)]
            fn gain<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
                self.snapshot(py).innovation().map(|i| row_major(py, &i.gain)).transpose()
            }

            /// How often a pivot had to be raised to keep P positive definite.
            #[getter]
            fn regularisations(&self, py: Python<'_>) -> u64 {
                self.snapshot(py).estimate().regularisations()
            }

            /// Sigma points of the present estimate, (2 n + 1, n).
            fn sigma_points<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
                row_major(py, &self.snapshot(py).sigma_points().transpose())
            }

            fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
                reduced_to_bytes(slf, &geomag_core::state::save(&slf.get().snapshot(slf.py()))?)
            }

            #[staticmethod]
            fn _restore(bytes: &[u8]) -> PyRes<Self> {
                Ok(Self::made(geomag_core::state::load(bytes)?))
            }

            fn __repr__(&self, py: Python<'_>) -> String {
                let filter = self.snapshot(py);
                let s = filter.scaling();
                let nis = filter.innovation().map_or_else(|| "no update yet".to_owned(), |i| format!("NIS {:.3}", i.nis));
                format!(
                    "UnscentedKalmanFilter({} states, alpha {}, beta {}, kappa {}, {nis})",
                    filter.estimate().len(),
                    s.alpha,
                    s.beta,
                    s.kappa
                )
            }
        }
    };
}

scaling_options!(unscented_class);

fn residual<'py>(py: Python<'py>, innovation: Option<&Innovation>) -> PyRes<Option<Bound<'py, PyAny>>> {
    innovation.map(|i| shaped(py, i.residual.as_slice().to_vec(), &[i.residual.len()])).transpose()
}

/// The extended Kalman filter: predicted values and Jacobians come from the caller.
///
/// Cheaper than the unscented filter where gradients are known, and as good where the field is straight within the
/// position error. On linear models it is the Kalman filter. P, Q and R as in `UnscentedKalmanFilter`.
///
/// Examples
/// --------
/// >>> import geomag
/// >>> ekf = geomag.ExtendedKalmanFilter([0.0], 1.0)
/// >>> ekf.predict([0.5], [[1.0]], 1.0)
/// >>> ekf.update([2.5], [0.5], [[1.0]], 2.0)
/// True
/// >>> round(float(ekf.x[0]), 9)
/// 1.5
#[pyclass(frozen, name = "ExtendedKalmanFilter", module = "geomag")]
pub struct PyExtendedKalmanFilter {
    inner: Shared<ExtendedKalmanFilter>,
}

impl PyExtendedKalmanFilter {
    fn snapshot(&self, py: Python<'_>) -> ExtendedKalmanFilter {
        self.inner.with(py, |f| f.clone())
    }
}

#[pymethods]
impl PyExtendedKalmanFilter {
    #[new]
    #[allow(non_snake_case)] // P as in every text on filters
    fn new(x: &Bound<'_, PyAny>, P: &Bound<'_, PyAny>) -> PyRes<Self> {
        let mean = vector("x", x)?;
        let p = covariance("P", mean.len(), P)?;
        Ok(Self { inner: Shared::new(ExtendedKalmanFilter::new(&mean, &p)?) })
    }

    /// Predicts: `state` (n,) is where the model leads, `F` (n, n) its derivative there, `Q` (n, n) the process noise.
    ///
    /// Raises `NotFiniteError`, `ShapeError`, `NotPositiveDefiniteError`; after an error the filter is as it was.
    #[allow(non_snake_case)] // F, Q as in every text on filters
    fn predict(
        &self,
        py: Python<'_>,
        state: &Bound<'_, PyAny>,
        F: &Bound<'_, PyAny>,
        Q: &Bound<'_, PyAny>,
    ) -> PyRes<()> {
        let state = vector("state", state)?;
        let (f, _, _) = crate::arrays::matrix("F", F)?;
        let q = covariance("Q", state.len(), Q)?;
        Ok(self.inner.with(py, |filter| filter.predict(&state, &f, &q))?)
    }

    /// Takes in a measurement `z` (m,) where `expected` (m,) was to be read, `H` (m, n) its derivative, `R` (m, m) its noise.
    ///
    /// `max_nis` and the answer are those of `UnscentedKalmanFilter.update`.
    #[pyo3(signature = (z, expected, H, R, *, max_nis = None, gate = None))]
    #[allow(non_snake_case)] // H, R as in every text on filters
    #[allow(clippy::too_many_arguments)] // one each
    fn update(
        &self,
        py: Python<'_>,
        z: &Bound<'_, PyAny>,
        expected: &Bound<'_, PyAny>,
        H: &Bound<'_, PyAny>,
        R: &Bound<'_, PyAny>,
        max_nis: Option<f64>,
        gate: Option<f64>,
    ) -> PyRes<bool> {
        let max_nis = limit(py, max_nis, gate)?;
        let (z, expected) = (vector("z", z)?, vector("expected", expected)?);
        let (h, _, _) = crate::arrays::matrix("H", H)?;
        let r = covariance("R", z.len(), R)?;
        Ok(self.inner.with(py, |filter| filter.update(&z, &expected, &h, &r, max_nis).map(|i| i.accepted))?)
    }

    /// State, (n,).
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        let mean = self.snapshot(py).estimate().mean().to_vec();
        let shape = [mean.len()];
        shaped(py, mean, &shape)
    }

    #[setter]
    fn set_x(&self, py: Python<'_>, x: &Bound<'_, PyAny>) -> PyRes<()> {
        let mean = vector("x", x)?;
        Ok(self.inner.with(py, |filter| {
            let p = filter.estimate().covariance();
            filter.set(&mean, p.as_slice())
        })?)
    }

    /// Covariance of the state, (n, n).
    #[getter(P)]
    fn covariance<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        row_major(py, &self.snapshot(py).estimate().covariance())
    }

    #[setter(P)]
    fn set_covariance(&self, py: Python<'_>, p: &Bound<'_, PyAny>) -> PyRes<()> {
        let p = covariance("P", self.inner.with(py, |f| f.estimate().len()), p)?;
        Ok(self.inner.with(py, |filter| {
            let mean = filter.estimate().mean().to_vec();
            filter.set(&mean, &p)
        })?)
    }

    /// Normalised innovation squared of the newest update; None before the first.
    #[getter]
    fn nis(&self, py: Python<'_>) -> Option<f64> {
        self.snapshot(py).innovation().map(|i| i.nis)
    }

    /// Innovation of the last update, (m,); none before one.
    #[getter]
    fn innovation<'py>(&self, py: Python<'py>) -> PyRes<Option<Bound<'py, PyAny>>> {
        residual(py, self.snapshot(py).innovation())
    }

    /// How often a pivot had to be raised to keep P positive definite.
    #[getter]
    fn regularisations(&self, py: Python<'_>) -> u64 {
        self.snapshot(py).estimate().regularisations()
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        reduced_to_bytes(slf, &geomag_core::state::save(&slf.get().snapshot(slf.py()))?)
    }

    #[staticmethod]
    fn _restore(bytes: &[u8]) -> PyRes<Self> {
        Ok(Self { inner: Shared::new(geomag_core::state::load(bytes)?) })
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let filter = self.snapshot(py);
        let nis = filter.innovation().map_or_else(|| "no update yet".to_owned(), |i| format!("NIS {:.3}", i.nis));
        format!("ExtendedKalmanFilter({} states, {nis})", filter.estimate().len())
    }
}
