//! One place where core errors become Python exceptions.

use geomag_core::error::Error;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;

/// Result of a binding: `?` works on core errors and on Python's own.
pub type PyRes<T> = Result<T, PyError>;

/// A Python exception made from either side.
#[derive(Debug)]
pub struct PyError(PyErr);

impl From<PyErr> for PyError {
    fn from(error: PyErr) -> Self {
        Self(error)
    }
}

impl From<PyError> for PyErr {
    fn from(error: PyError) -> Self {
        error.0
    }
}

impl From<Error> for PyError {
    fn from(error: Error) -> Self {
        let name = match &error {
            Error::Shape { .. } => "ShapeError",
            Error::NotFinite { .. } | Error::NotFiniteNode { .. } => "NotFiniteError",
            Error::TooFewSamples { .. } => "TooFewSamplesError",
            Error::TooManyCandidates { .. } | Error::NoMemory { .. } => "CandidateLimitError",
            Error::NotPositiveDefinite { .. } => "NotPositiveDefiniteError",
            Error::RankDeficient { .. } => "RankDeficientError",
            Error::State { .. } => "StateError",
            Error::Interrupted => return Self(pyo3::exceptions::PyKeyboardInterrupt::new_err(())),
            _ => "InvalidInputError",
        };
        Self(Python::attach(|py| raise(py, name, &error.to_string())))
    }
}

/// An [`Error::Invalid`] as a Python exception.
pub fn invalid(what: &str, needed: &str, got: impl ToString) -> PyError {
    Error::invalid(what, needed, got).into()
}

/// A file that cannot be read or written.
pub fn file_error(path: &std::path::Path, error: &std::io::Error) -> PyError {
    let name = if error.kind() == std::io::ErrorKind::NotFound { "MissingFileError" } else { "ReadError" };
    Python::attach(|py| raise(py, name, &format!("{}: {error}", path.display()))).into()
}

fn raise(py: Python<'_>, name: &str, message: &str) -> PyErr {
    static MODULE: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let class = MODULE
        .get_or_try_init(py, || py.import("geomag._errors").map(|m| m.into_any().unbind()))
        .and_then(|module| module.bind(py).getattr(name))
        .and_then(|class| Ok(class.cast_into::<PyType>()?));
    match class {
        Ok(class) => PyErr::from_type(class, (message.to_owned(),)),
        Err(error) => error,
    }
}
