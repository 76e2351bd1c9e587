//! State that several Python threads may use at once: one policy for all of it.
//!
//! What happens under a lock is a closure that can be sent to another thread, so it holds no Python object and no token of the
//! interpreter: arguments are converted before the lock is taken, results after it is given back. Whoever waits lets the
//! interpreter go, for the holder may be in a long call.

use std::sync::{Mutex, PoisonError};
use std::thread::ThreadId;

use geomag_core::fix::Fix;
use geomag_core::matching::stream::{Sample, Step, Stream};
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use pyo3::types::PyBytes;

use crate::error::{PyRes, invalid};
use crate::long_call;

/// State behind a lock.
///
/// A poisoned lock is taken: updates replace the state whole, so a panic cannot leave a half-made one.
pub struct Shared<T>(Mutex<T>);

impl<T: Send> Shared<T> {
    pub fn new(state: T) -> Self {
        Self(Mutex::new(state))
    }

    /// Short work: the interpreter is kept while it is done, not while it is waited for.
    pub fn with<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut T) -> R + Send) -> R {
        let state = &mut *self.0.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner);
        crate::pool::working(|| work(state))
    }

    /// Long work: other Python threads run meanwhile.
    pub fn detached<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut T) -> R + Send) -> R {
        crate::pool::detached(py, || self.alone(work))
    }

    /// For whoever has let the interpreter go already.
    pub fn alone<R>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// What every stream of matching shares in Python.
impl<S: Stream> Shared<S> {
    /// Takes one sample; other Python threads run meanwhile, and Ctrl-C is heard where it takes `units` (about a nanosecond each).
    pub fn take(&self, py: Python<'_>, units: u64, sample: &Sample) -> PyRes<Step> {
        long_call::run(py, units, None, None, |monitor| self.alone(|s| s.take(sample, monitor)))
    }

    /// The answer on the samples held.
    pub fn answer(&self, py: Python<'_>) -> PyRes<Fix> {
        Ok(self.detached(py, |s| s.answer())?)
    }

    /// Begins again.
    pub fn begin_again(&self, py: Python<'_>) -> PyRes<()> {
        Ok(self.with(py, Stream::begin_again)?)
    }

    /// Samples seen.
    pub fn seen(&self, py: Python<'_>) -> usize {
        self.with(py, |s| s.seen())
    }

    /// The state as bytes.
    pub fn saved<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &self.with(py, |s| s.saved())?))
    }
}

/// Turns at an object whose changes call Python: they take turns, while anybody may look at the state between them.
#[derive(Default)]
pub struct Turns {
    turn: Mutex<()>,
    owner: Mutex<Option<ThreadId>>,
}

impl Turns {
    /// Does `work` when its turn comes; the interpreter is let go while waiting.
    ///
    /// A model that changes the filter which is calling it would wait for itself: refused.
    pub fn take<R>(&self, py: Python<'_>, what: &str, work: impl FnOnce() -> PyRes<R>) -> PyRes<R> {
        let me = std::thread::current().id();
        let owner = || self.owner.lock().unwrap_or_else(PoisonError::into_inner);
        if *owner() == Some(me) {
            return Err(invalid(what, "a model that leaves the filter that calls it as it is", "a change of it"));
        }
        let _turn = self.turn.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner);
        *owner() = Some(me);
        let done = work();
        *owner() = None;
        done
    }
}
