//! What the bindings' classes have in common: properties that are read off the value inside, and pickling.

use pyo3::PyClass;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};

use crate::error::PyRes;

/// The methods of a class with a core value `inner`: first what is read off it, `name: type = expression;` a property
/// (`name(py): ...` where the expression needs the interpreter), then all other methods as they stand.
macro_rules! properties {
    ($class:ident: $inner:ident {
        $($(#[$attribute:meta])* $name:ident $(($py:ident))?: $type:ty = $value:expr;)*
    } $($method:tt)*) => {
        #[pymethods]
        impl $class {
            $(
                $(#[$attribute])*
                #[getter]
                #[allow(clippy::extra_unused_lifetimes)] // of those that need no interpreter
                fn $name<'py>(&self $(, $py: Python<'py>)?) -> $type {
                    let $inner = &self.inner;
                    $value
                }
            )*

            $($method)*
        }
    };
}
pub(crate) use properties;

/// What `__reduce__` returns: the class's `_restore` and its arguments.
pub type Reduced<'py> = PyRes<(Bound<'py, PyAny>, Bound<'py, PyTuple>)>;

/// An object as the call of its class's `_restore` with `arguments`.
pub fn reduced<'py, T, A>(slf: &Bound<'py, T>, arguments: A) -> Reduced<'py>
where
    T: PyClass,
    A: IntoPyObject<'py, Target = PyTuple, Output = Bound<'py, PyTuple>, Error = PyErr>,
{
    Ok((slf.as_any().get_type().getattr("_restore")?, arguments.into_pyobject(slf.py())?))
}

/// An object as the call of its class's `_restore` with its saved state, bytes, alone.
pub fn reduced_to_bytes<'py, T: PyClass>(slf: &Bound<'py, T>, bytes: &[u8]) -> Reduced<'py> {
    reduced(slf, (PyBytes::new(slf.py(), bytes),))
}
