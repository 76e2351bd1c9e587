//! State that several Python threads may use at once.

use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use pyo3::sync::MutexExt;

/// Takes the lock; lets the interpreter go while waiting, for whoever holds the lock may be in a long call, and waiting
/// with the interpreter would stop every other thread.
///
/// A poisoned lock is taken: updates replace the state whole, so a panic cannot leave a half-made one.
pub fn attached<'a, T>(py: Python<'_>, mutex: &'a Mutex<T>) -> MutexGuard<'a, T> {
    mutex.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
}

/// Takes the lock where the interpreter has been let go already.
pub fn detached<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
