//! Long computations: interpreter released, Ctrl-C heard, progress reported.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::time::Duration;

use geomag_core::error::{Error, Result as CoreResult};
use geomag_core::monitor::{Monitor, Quiet};
use pyo3::prelude::*;

use crate::error::{PyRes, invalid};

/// Work below this many units is done at once: starting a thread would cost more than it takes.
const SHORT: u64 = 20_000_000;
/// More threads than this are not started: the answers are the same, and the system may not have them to give.
const MOST_THREADS: usize = 1024;

struct Shared {
    stop: AtomicBool,
    done: AtomicU64,
    total: AtomicU64,
}

impl Monitor for Shared {
    fn advance(&self, done: u64, total: u64) -> CoreResult<()> {
        self.done.store(done, Ordering::Relaxed);
        self.total.store(total, Ordering::Relaxed);
        if self.stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// Runs `work` without the interpreter. Where it is long (`units`, about a nanosecond each) or `progress` is wanted,
/// signals are checked and progress is reported about ten times a second.
///
/// `threads` limits the threads of the computation, itself limited to [`MOST_THREADS`]; all cores where it is None.
///
/// `progress` is None or False, True (a bar on standard error), or a callable `(done, total)`.
pub fn run<T: Send>(
    py: Python<'_>,
    units: u64,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&dyn Monitor) -> CoreResult<T> + Send,
) -> PyRes<T> {
    let report = match progress {
        None => None,
        Some(p) if p.is_none() => None,
        Some(p) if p.is_callable() => Some(p.clone()),
        Some(p) => match p.extract::<bool>() {
            Ok(false) => None,
            Ok(true) => Some(py.import("geomag._progress")?.getattr("bar")?.call0()?),
            Err(_) => return Err(invalid("progress", "True, False or a callable (done, total)", p.repr()?)),
        },
    };
    let pool = match threads {
        None => None,
        Some(0) => return Err(invalid("threads", "at least 1", 0)),
        Some(n) => Some(
            rayon::ThreadPoolBuilder::new()
                .num_threads(n.min(MOST_THREADS))
                .build()
                .map_err(|e| invalid("threads", "a number of threads that the system grants", e))?,
        ),
    };
    let work = move |monitor: &dyn Monitor| match &pool {
        Some(pool) => pool.install(|| work(monitor)),
        None => work(monitor),
    };
    if report.is_none() && units < SHORT {
        return Ok(py.detach(|| work(&Quiet))?);
    }
    let shared = Shared { stop: AtomicBool::new(false), done: AtomicU64::new(0), total: AtomicU64::new(0) };
    let (sender, mut receiver) = mpsc::channel();
    let (result, interruption) = std::thread::scope(|scope| {
        let shared = &shared;
        scope.spawn(move || {
            // A closed channel means that nobody waits any more; there is nothing left to tell.
            let _ = sender.send(work(shared));
        });
        let mut interruption = None;
        loop {
            // mpsc receivers are not Sync; a mutable borrow is enough to lend one to the detached closure.
            let lent = &mut receiver;
            match py.detach(move || lent.recv_timeout(Duration::from_millis(100))) {
                Ok(result) => break (Some(result), interruption),
                Err(mpsc::RecvTimeoutError::Disconnected) => break (None, interruption),
                Err(mpsc::RecvTimeoutError::Timeout) => {}
            }
            let heard = py.check_signals().and_then(|()| match &report {
                Some(report) => report
                    .call1((shared.done.load(Ordering::Relaxed), shared.total.load(Ordering::Relaxed)))
                    .map(|_| ()),
                None => Ok(()),
            });
            if let Err(error) = heard {
                shared.stop.store(true, Ordering::Relaxed);
                interruption.get_or_insert(error);
            }
        }
    });
    if let Some(error) = interruption {
        return Err(error.into());
    }
    let result = result.ok_or(Error::Interrupted)??;
    if let Some(report) = report {
        let total = shared.total.load(Ordering::Relaxed);
        report.call1((total, total))?;
    }
    Ok(result)
}
