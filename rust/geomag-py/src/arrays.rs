//! `NumPy` in and out: read-only arrays (or anything array-like) in, owned arrays out.

use numpy::ndarray::{ArrayD, IxDyn};
use numpy::{Element, IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use geomag_core::error::Error;

use crate::error::{PyRes, invalid};

/// An array whose elements Rust may refer to where they lie: of this type in native byte order, each at a multiple of
/// its size from the next. A column of packed records is not: `ndarray` would round its strides down.
pub fn in_place<'a, 'py, T: Element>(object: &'a Bound<'py, PyAny>) -> PyRes<Option<&'a Bound<'py, PyArrayDyn<T>>>> {
    let Ok(array) = object.cast::<PyArrayDyn<T>>() else { return Ok(None) };
    let size = size_of::<T>() as isize;
    let whole = array.data().is_aligned() && array.strides().iter().all(|s| s % size == 0);
    Ok((whole && !object.hasattr(intern!(object.py(), "mask"))?).then_some(array))
}

/// Whether an object is an array of single-precision numbers, in whatever byte order and layout.
pub fn is_single(object: &Bound<'_, PyAny>) -> bool {
    let py = object.py();
    let described = || -> PyResult<(String, usize)> {
        let dtype = object.getattr(intern!(py, "dtype"))?;
        Ok((dtype.getattr(intern!(py, "kind"))?.extract()?, dtype.getattr(intern!(py, "itemsize"))?.extract()?))
    };
    described().is_ok_and(|(kind, size)| kind == "f" && size == 4)
}

/// Anything array-like as a double array; numbers only, masked entries become NaN.
pub fn array<'py>(what: &str, object: &Bound<'py, PyAny>) -> PyRes<PyReadonlyArrayDyn<'py, f64>> {
    if let Some(array) = in_place::<f64>(object)? {
        return Ok(array.try_readonly().map_err(PyErr::from)?);
    }
    let py = object.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let plain = |o: &Bound<'py, PyAny>| -> PyResult<Bound<'py, PyAny>> { numpy.call_method1("asanyarray", (o,)) };
    let loose = plain(object).map_err(|e| invalid(what, "an array of numbers", e))?;
    let dtype = loose.getattr("dtype")?;
    let kind: String = dtype.getattr("kind")?.extract()?;
    if !matches!(kind.as_str(), "f" | "i" | "u" | "b") {
        return Err(invalid(what, "an array of real numbers", format!("dtype {}", dtype.str()?)));
    }
    let kwargs = PyDict::new(py);
    kwargs.set_item("dtype", "float64")?;
    let mut double = loose.call_method("astype", ("float64",), None)?;
    if double.hasattr("mask")? && double.hasattr("filled")? {
        double = double.call_method1("filled", (f64::NAN,))?;
    }
    let array = numpy.call_method("asarray", (double,), Some(&kwargs))?;
    let array = array.cast_into::<PyArrayDyn<f64>>().map_err(PyErr::from)?;
    Ok(array.try_readonly().map_err(PyErr::from)?)
}

/// A one-dimensional array as a vector. A scalar is taken as one element.
pub fn vector(what: &str, object: &Bound<'_, PyAny>) -> PyRes<Vec<f64>> {
    let array = array(what, object)?;
    if array.ndim() > 1 {
        return Err(Error::shape(what, "one dimension", format!("{:?}", array.shape())).into());
    }
    Ok(array.as_array().iter().copied().collect())
}

/// An optional one-dimensional array.
pub fn optional_vector(what: &str, object: Option<&Bound<'_, PyAny>>) -> PyRes<Option<Vec<f64>>> {
    object.map(|o| vector(what, o)).transpose()
}

/// A two-dimensional array as row-major values with its shape.
pub fn matrix(what: &str, object: &Bound<'_, PyAny>) -> PyRes<(Vec<f64>, usize, usize)> {
    let array = array(what, object)?;
    let &[rows, columns] = array.shape() else {
        return Err(Error::shape(what, "two dimensions", format!("{:?}", array.shape())).into());
    };
    Ok((array.as_array().iter().copied().collect(), rows, columns))
}

/// Arrays of any shape broadcast against each other, flattened row-major, with the common shape.
pub fn broadcast<const N: usize>(
    names: [&str; N],
    objects: [&Bound<'_, PyAny>; N],
) -> PyRes<([Vec<f64>; N], Vec<usize>)> {
    let mut arrays = Vec::with_capacity(N);
    for (name, object) in names.iter().zip(objects) {
        arrays.push(array(name, object)?);
    }
    let rank = arrays.iter().map(|a| a.ndim()).max().unwrap_or(0);
    let mut shape = vec![1_usize; rank];
    for (name, array) in names.iter().zip(&arrays) {
        let own = array.shape();
        for (axis, &n) in own.iter().enumerate() {
            let at = &mut shape[rank - own.len() + axis];
            if *at == 1 {
                *at = n;
            } else if n != 1 && n != *at {
                return Err(Error::shape(*name, format!("broadcastable to {shape:?}"), format!("{own:?}")).into());
            }
        }
    }
    let mut out = Vec::with_capacity(N);
    for (name, array) in names.iter().zip(&arrays) {
        let view = array.as_array();
        if let (true, Some(values)) = (array.shape() == shape.as_slice(), view.as_slice()) {
            out.push(values.to_vec());
            continue;
        }
        let view = view
            .broadcast(IxDyn(&shape))
            .ok_or_else(|| invalid(name, "a broadcastable shape", format!("{:?}", array.shape())))?;
        out.push(view.iter().copied().collect());
    }
    let out: [Vec<f64>; N] =
        out.try_into().map_err(|_| invalid("arrays", "one result each", "another number of them"))?;
    Ok((out, shape))
}

/// Flat values as an array of the given shape; a zero-dimensional one becomes a float.
pub fn shaped<'py>(py: Python<'py>, values: Vec<f64>, shape: &[usize]) -> PyRes<Bound<'py, PyAny>> {
    if shape.is_empty() {
        return Ok(values[0].into_pyobject(py).map_err(PyErr::from)?.into_any());
    }
    let array = ArrayD::from_shape_vec(IxDyn(shape), values).map_err(|e| invalid("result", "its own shape", e))?;
    Ok(array.into_pyarray(py).into_any())
}

/// `[x, y]` points as an (n, 2) array.
pub fn points<'py>(py: Python<'py>, points: &[[f64; 2]]) -> PyRes<Bound<'py, PyAny>> {
    shaped(py, points.iter().flatten().copied().collect(), &[points.len(), 2])
}

/// A pair from a number (used twice) or two numbers.
pub fn pair(what: &str, object: &Bound<'_, PyAny>) -> PyRes<[f64; 2]> {
    match vector(what, object)?.as_slice() {
        &[both] => Ok([both, both]),
        &[x, y] => Ok([x, y]),
        other => Err(Error::shape(what, "one number or a pair (x, y)", format!("{} numbers", other.len())).into()),
    }
}
