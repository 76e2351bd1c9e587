//! Long computations: interpreter released, Ctrl-C heard, progress reported.

use std::num::NonZero;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::Duration;

use geomag_core::error::{Error, Result as CoreResult};
use geomag_core::monitor::{Monitor, Quiet};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::{PyRes, invalid};

/// Work below this many units is done at once: starting a thread would cost more than it takes.
pub const SHORT: u64 = 20_000_000;

/// Threads that a caller can ask for: starting a million would take for ever.
const MOST_THREADS: usize = 512;

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

/// Threads that were asked for before, by process and number: starting them takes longer than small work does.
static POOLS: Mutex<Vec<(u32, usize, Arc<ThreadPool>)>> = Mutex::new(Vec::new());

/// A pool of `n` threads; kept for the next call where the machine has as many.
fn pool(n: usize) -> PyRes<Arc<ThreadPool>> {
    let process = std::process::id();
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((.., pool)) = pools.iter().find(|(owner, threads, _)| (*owner, *threads) == (process, n)) {
        return Ok(pool.clone());
    }
    let built = ThreadPoolBuilder::new().num_threads(n).build();
    let built = Arc::new(built.map_err(|e| invalid("threads", "a number of threads that the system grants", e))?);
    if n <= std::thread::available_parallelism().map_or(1, NonZero::get) {
        // Threads do not outlive a fork, and what they may have held cannot be given back.
        let (own, others) = std::mem::take(&mut *pools).into_iter().partition(|(owner, ..)| *owner == process);
        *pools = own;
        std::mem::forget::<Vec<_>>(others);
        pools.push((process, n, built.clone()));
    }
    Ok(built)
}

/// Runs `work` without the interpreter. Where it is long (`units`, about a nanosecond each) or `progress` is wanted,
/// signals are checked and progress is reported about ten times a second.
///
/// `threads` limits the threads of the computation, 1 to 512; all cores where it is None.
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
        Some(n) if n == 0 || n > MOST_THREADS => {
            return Err(invalid("threads", &format!("1 to {MOST_THREADS}"), n));
        }
        Some(n) => Some(pool(n)?),
    };
    let work = move |monitor: &dyn Monitor| match &pool {
        Some(pool) => pool.install(|| work(monitor)),
        None => crate::pool::working(|| work(monitor)),
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
