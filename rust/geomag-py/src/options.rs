//! What a row of a table of options becomes in Python: an argument, its conversion, its line in a docstring, a field of a frozen object.

use pyo3::prelude::*;

use crate::arrays::{pair, vector};
use crate::error::{PyError, PyRes, invalid};

/// A row as numpydoc has it.
macro_rules! row_doc {
    ($name:ident; $python:literal; $($line:literal)+) => { concat!(stringify!($name), " : ", $python $(, "\n    ", $line)+) };
}

/// Arguments that are no options of the core, each explained once.
macro_rules! shared_doc {
    (grid) => {
        "grid : GridMap, MapStack or HarmonicMap\n    The stored map."
    };
    (track) => {
        "track : Track\n    Indicated positions and measured values."
    };
    (search) => {
        "search : SearchBox, optional\n    Where to look, in place of the keywords of the same names."
    };
    (channels) => {
        concat!(
            "channels : sequence of (GridMap, values, sigma), optional\n",
            "    Further fields measured along the same track, each with its own map."
        )
    };
    (sigma) => {
        concat!(
            "sigma : float, optional\n",
            "    Standard deviation of the sensor, value units; by default what the map's own lines say."
        )
    };
    (parts) => {
        concat!(
            "search : SearchBox, optional\n    Where to look, in place of the keywords of the same names.\n",
            "prior : InsPrior, optional\n    What the INS may be wrong by beside the offset, likewise.\n",
            "accept : Acceptance, optional\n    What counts as a fix, likewise."
        )
    };
    (threads) => {
        concat!(
            "threads : int, optional\n",
            "    Threads to use, 1 to 512, all cores by default; the answers do not depend on it."
        )
    };
    (progress) => {
        "progress : bool or callable, optional\n    True for a bar, or a callable (done, total)."
    };
}

/// The type that is extracted from Python.
macro_rules! py_type {
    (number) => { f64 };
    (maybe_number) => { Option<f64> };
    (maybe_pair) => { Option<Py<PyAny>> };
    (count) => { i128 };
    (size) => { i128 };
    (interpolation) => { &str };
    (flag) => { bool };
    (tally) => { i128 };
    (maybe_size) => { Option<i128> };
    (maybe_name) => { Option<&str> };
    (reach) => { Option<f64> };
    (headings) => { Option<Py<PyAny>> };
    (scales) => { Option<Py<PyAny>> };
    (weights) => { Option<Py<PyAny>> };
    (starts) => { Option<Py<PyAny>> };
    (pivot) => { &str };
    (unknown) => { &str };
    (transform) => { &str };
    (field_method) => { &str };
}

/// The type that Python is answered with.
macro_rules! answered_type {
    (number) => { f64 };
    (maybe_number) => { Option<f64> };
    (maybe_pair) => { Option<(f64, f64)> };
    (count) => { u64 };
    (size) => { usize };
}

/// The core's value of an argument.
macro_rules! py_value {
    ($py:ident maybe_pair $name:ident) => {
        $crate::options::maybe_pair($py, stringify!($name), $name.as_ref())?
    };
    ($py:ident interpolation $name:ident) => {
        $crate::options::interpolation($name)?
    };
    ($py:ident count $name:ident) => {
        $crate::options::whole(stringify!($name), $name)?
    };
    ($py:ident size $name:ident) => {
        $crate::options::whole(stringify!($name), $name)?
    };
    ($py:ident tally $name:ident) => {
        $crate::options::whole(stringify!($name), $name)?
    };
    ($py:ident maybe_size $name:ident) => {
        $name.map(|n| $crate::options::whole(stringify!($name), n)).transpose()?
    };
    ($py:ident reach $name:ident) => {
        $name.unwrap_or(f64::INFINITY)
    };
    ($py:ident headings $name:ident) => {
        $crate::options::vector_or($py, stringify!($name), $name.as_ref(), 0.0)?
    };
    ($py:ident scales $name:ident) => {
        $crate::options::vector_or($py, stringify!($name), $name.as_ref(), 1.0)?
    };
    ($py:ident weights $name:ident) => {
        $crate::arrays::optional_vector(stringify!($name), $name.as_ref().map(|w| w.bind($py)))?
    };
    ($py:ident pivot $name:ident) => {
        $crate::grid_search::pivot($name)?
    };
    ($py:ident unknown $name:ident) => {
        $crate::iema::unknown($name)?
    };
    ($py:ident field_method $name:ident) => {
        $crate::navigator::filter($name)?
    };
    ($py:ident transform $name:ident) => {
        $crate::contour::transform_kind($name)?
    };
    ($py:ident $kind:ident $name:ident) => {
        $name
    };
}

/// Python's value of a field.
macro_rules! answered {
    (maybe_pair $value:expr) => {
        $value.map(|[x, y]| (x, y))
    };
    ($kind:ident $value:expr) => {
        $value
    };
}

/// A frozen object of Python with a property a row, over a struct with a field a row and a `validate`.
macro_rules! record_class {
    (
        { $(#[$meta:meta])*; $(#[$after:meta])* $class:ident $called:literal $inner:ident; { $($methods:tt)* } }
        $($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*
    ) => {
        $(#[$meta])*
        ///
        /// Parameters
        /// ----------
        $($(#[doc = row_doc!($name; $python; $($line)+)])*)*
        $(#[$after])*
        #[pyclass(frozen, eq, name = $called, module = "geomag")]
        #[derive(Clone, PartialEq)]
        pub struct $class {
            pub inner: $inner,
        }

        #[pymethods]
        impl $class {
            #[new]
            #[pyo3(signature = (*, $($($name = $default,)*)*))]
            #[allow(clippy::too_many_arguments)] // one each, keyword-only
            fn new(py: Python<'_>, $($($name: py_type!($kind),)*)*) -> PyRes<Self> {
                // Extents alone need the interpreter.
                let _ = py;
                let inner = $inner { $($($name: py_value!(py $kind $name),)*)* };
                inner.validate()?;
                Ok(Self { inner })
            }

            $($(
                $(#[doc = $line])+
                #[getter]
                fn $name(&self) -> answered_type!($kind) {
                    answered!($kind self.inner.$name)
                }
            )*)*

            /// All of them by name.
            fn to_dict<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, pyo3::types::PyDict>> {
                let out = pyo3::types::PyDict::new(py);
                $($(out.set_item(stringify!($name), self.$name())?;)*)*
                Ok(out)
            }

            fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyRes<(Bound<'py, PyAny>, Bound<'py, pyo3::types::PyTuple>)> {
                let values = slf.get().to_dict(slf.py())?;
                Ok((slf.get_type().getattr("_restore")?, (values,).into_pyobject(slf.py())?))
            }

            #[classmethod]
            fn _restore<'py>(
                class: &Bound<'py, pyo3::types::PyType>,
                values: &Bound<'py, pyo3::types::PyDict>,
            ) -> PyRes<Bound<'py, PyAny>> {
                Ok(class.call((), Some(values))?)
            }

            fn __repr__(&self, py: Python<'_>) -> PyRes<String> {
                let said = |(name, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| Ok(format!("{name}={}", value.repr()?));
                let fields = self.to_dict(py)?.iter().filter(|(_, v)| !v.is_none()).map(said).collect::<PyResult<Vec<_>>>()?;
                Ok(format!("{}({})", $called, fields.join(", ")))
            }

            $($methods)*
        }
    };
}

/// A pair in Python, where there is one.
pub fn maybe_pair(py: Python<'_>, name: &str, given: Option<&Py<PyAny>>) -> PyRes<Option<[f64; 2]>> {
    given.map(|value| pair(name, value.bind(py))).transpose()
}

/// A whole number that is not negative and not larger than its type.
pub fn whole<T: TryFrom<i128>>(name: &str, given: i128) -> PyRes<T> {
    T::try_from(given).map_err(|_| invalid(name, "a whole number >= 0", given))
}

/// Numbers in Python, or one that stands for them.
pub fn vector_or(py: Python<'_>, name: &str, given: Option<&Py<PyAny>>, default: f64) -> PyRes<Vec<f64>> {
    given.map_or(Ok(vec![default]), |value| vector(name, value.bind(py)))
}

pub use crate::grid::interpolation;

/// Says that a keyword has a newer name; the old one goes on working.
pub fn old_name(py: Python<'_>, old: &str, new: &str) -> PyRes<()> {
    let text = std::ffi::CString::new(format!("{old}= is the old name of {new}=")).unwrap_or_default();
    let category = py.get_type::<pyo3::exceptions::PyDeprecationWarning>();
    Ok(PyErr::warn(py, &category, &text, 1)?)
}

/// A keyword that there is not, with the one that was meant where there is one much like it.
pub fn unexpected(key: &str, known: &[&str]) -> PyError {
    let distance = |name: &&&str| {
        let (a, b): (Vec<char>, Vec<char>) = (key.chars().collect(), name.chars().collect());
        let mut row: Vec<usize> = (0..=b.len()).collect();
        for (i, x) in a.iter().enumerate() {
            let mut before = std::mem::replace(&mut row[0], i + 1);
            for (j, y) in b.iter().enumerate() {
                let here = (before + usize::from(x != y)).min(row[j] + 1).min(row[j + 1] + 1);
                before = std::mem::replace(&mut row[j + 1], here);
            }
        }
        row[b.len()]
    };
    let near = known.iter().min_by_key(distance).filter(|name| distance(name) <= 1 + name.len() / 3);
    let meant = near.map(|name| format!("; did you mean '{name}'?")).unwrap_or_default();
    pyo3::exceptions::PyTypeError::new_err(format!("unexpected keyword argument '{key}'{meant}")).into()
}
