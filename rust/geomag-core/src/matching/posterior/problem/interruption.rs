//! A search that may be stopped from outside.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{Error, Result};
use crate::monitor::Monitor;

/// Whether somebody wants the search to stop: asked between blocks of candidates, by whichever thread has one.
#[derive(Default)]
pub(in super::super) struct Interruption<'a> {
    monitor: Option<&'a dyn Monitor>,
    stopped: AtomicBool,
}

impl<'a> Interruption<'a> {
    pub fn by(monitor: &'a dyn Monitor) -> Self {
        Self { monitor: Some(monitor), stopped: AtomicBool::new(false) }
    }

    /// Whether to stop, here and from now on.
    pub fn now(&self) -> bool {
        let Some(monitor) = self.monitor else { return false };
        if self.stopped.load(Ordering::Relaxed) {
            return true;
        }
        let stop = monitor.advance(0, 0).is_err();
        if stop {
            self.stopped.store(true, Ordering::Relaxed);
        }
        stop
    }

    /// # Errors
    /// [`Error::Interrupted`] where the search was stopped: what it found is worth nothing.
    pub fn none(&self) -> Result<()> {
        if self.stopped.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }
}
