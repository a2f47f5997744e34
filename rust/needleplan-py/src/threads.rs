//! The threads that the solvers run on.
//!
//! Rayon's global pool is not used: its threads do not exist in a forked process, which would wait for them for ever.
//! Every process has a pool of its own instead, built when it is first needed.

use std::ptr::null_mut;
use std::sync::atomic::{AtomicPtr, Ordering};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// A pool, and the process whose threads it has.
struct ProcessPool {
    process: u32,
    pool: ThreadPool,
}

/// The pool built last, by this process or by one that it was forked from. Not a lock: a fork may copy a locked one.
static LATEST: AtomicPtr<ProcessPool> = AtomicPtr::new(null_mut());

/// Calls `work` with a pool of `threads` threads; by default with the pool of this process.
///
/// # Errors
/// ValueError if `threads` is out of range or the threads cannot be started.
pub(crate) fn with_pool<R>(threads: Option<usize>, work: impl FnOnce(&ThreadPool) -> R) -> PyResult<R> {
    match threads {
        None => Ok(work(process_pool()?)),
        Some(threads) if (1..=1024).contains(&threads) => {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build();
            Ok(work(&pool.map_err(|error| PyValueError::new_err(format!("threads = {threads}: {error}")))?))
        }
        Some(threads) => Err(PyValueError::new_err(format!("threads = {threads}: must be between 1 and 1024"))),
    }
}

/// The pool of this process, with one thread for each processor (or `RAYON_NUM_THREADS`).
fn process_pool() -> PyResult<&'static ThreadPool> {
    let process = std::process::id();
    let latest = LATEST.load(Ordering::Acquire);
    // SAFETY: a pointer in LATEST is null or comes from Box::into_raw below, and is never freed.
    if let Some(latest) = unsafe { latest.as_ref() }
        && latest.process == process
    {
        return Ok(&latest.pool);
    }
    let pool = ThreadPoolBuilder::new().build();
    let pool = pool.map_err(|error| PyValueError::new_err(format!("the solver's threads: {error}")))?;
    let own = Box::into_raw(Box::new(ProcessPool { process, pool }));
    // The parent's pool is abandoned and not dropped, because dropping it would signal threads that do not exist here.
    let found = match LATEST.compare_exchange(latest, own, Ordering::AcqRel, Ordering::Acquire) {
        Ok(_) => own,
        // Another thread of this process has been first.
        Err(first) => {
            // SAFETY: `own` comes from Box::into_raw, and nobody else has it.
            drop(unsafe { Box::from_raw(own) });
            first
        }
    };
    // SAFETY: as above, and not null.
    Ok(unsafe { &(*found).pool })
}
