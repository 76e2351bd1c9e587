//! Which threads compute: those of rayon, and in a process that was forked, new ones.
//!
//! `fork` copies the thread that calls it and no other. A child would wait for ever for the workers of a pool that its parent had
//! begun to use, so that every process after a fork computes in a pool of its own, made when it is first needed.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Forks between this process and the one that imported the module.
static FORKS: AtomicUsize = AtomicUsize::new(0);

/// The pools of forked processes, one a generation. What a fork leaves half made is of an older one, and is not touched again.
static POOLS: [OnceLock<Option<ThreadPool>>; 32] = [const { OnceLock::new() }; 32];

/// Runs work where its threads are.
pub fn working<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    let forks = FORKS.load(Ordering::Relaxed);
    let Some(before) = forks.checked_sub(1) else { return work() };
    let build = || ThreadPoolBuilder::new().build().ok();
    match POOLS.get(before) {
        Some(kept) => match kept.get_or_init(build) {
            Some(pool) => pool.install(work),
            None => work(),
        },
        None => match build() {
            Some(pool) => pool.install(work),
            None => work(),
        },
    }
}

/// The same without the interpreter.
pub fn detached<R: Send>(py: Python<'_>, work: impl FnOnce() -> R + Send) -> R {
    py.detach(|| working(work))
}

/// Told by the interpreter in every child.
#[pyfunction]
fn _after_fork() {
    FORKS.fetch_add(1, Ordering::Relaxed);
}

/// Asks to be told of forks, where there are any.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let os = module.py().import("os")?;
    if os.hasattr("register_at_fork")? {
        let told = pyo3::types::PyDict::new(module.py());
        told.set_item("after_in_child", wrap_pyfunction!(_after_fork, module)?)?;
        os.call_method("register_at_fork", (), Some(&told))?;
    }
    Ok(())
}
