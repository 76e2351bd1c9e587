//! How a long computation reports progress and learns that it should stop.

use crate::error::Result;

/// Told now and then how far a computation is; an error from it stops the computation.
pub trait Monitor: Sync {
    /// `done` units of `total` are finished.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::error::Error::Interrupted) where the caller wants it to stop.
    fn advance(&self, done: u64, total: u64) -> Result<()>;
}

/// A monitor that never interrupts and says nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Quiet;

impl Monitor for Quiet {
    fn advance(&self, _done: u64, _total: u64) -> Result<()> {
        Ok(())
    }
}
