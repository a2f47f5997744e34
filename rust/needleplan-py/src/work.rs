//! Long work, off the thread that asks for it.
//!
//! The work runs on a pool. The calling thread releases the GIL and waits. Every [`INTERVAL`] it looks at Python's
//! signals and calls the progress callback; it takes the GIL for nothing else, and the work never waits for it. An
//! exception of either raises the stop flag of the work.
//!
//! This is also the only place where a panic is caught: it becomes a RuntimeError.

use std::any::Any;
use std::marker::PhantomData;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use ppvi::{Error, Observer, Progress, StopFlag};
use pyo3::exceptions::{PyMemoryError, PyRuntimeError, PyStopIteration, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use rayon::ThreadPool;

use crate::threads::with_pool;

/// Time between two looks at Python's signals, and between two calls of a progress callback.
const INTERVAL: Duration = Duration::from_millis(50);

/// The Python exception for an error of the solvers.
pub(crate) fn exception(error: Error) -> PyErr {
    match error {
        Error::TooLarge { .. } => PyMemoryError::new_err(error.to_string()),
        _ => PyValueError::new_err(error.to_string()),
    }
}

/// The exception for a panic.
fn defect(panic: &(dyn Any + Send)) -> PyErr {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message");
    PyRuntimeError::new_err(format!(
        "this is a defect of needleplan and not of the input; please report it at {}/issues: {text}",
        env!("CARGO_PKG_REPOSITORY")
    ))
}

/// Does short work at once, with the GIL.
///
/// # Errors
/// That of the work; RuntimeError if it panics.
pub(crate) fn at_once<R>(work: impl FnOnce() -> ppvi::Result<R>) -> PyResult<R> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| defect(&*panic))?.map_err(exception)
}

/// Does long work on a pool of `threads` threads; by default on the pool of this process.
///
/// # Errors
/// The exception of a signal (KeyboardInterrupt), which ends the work; otherwise that of the work; RuntimeError if it
/// panics; ValueError if `threads` is out of range.
pub(crate) fn run<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    work: impl FnOnce() -> ppvi::Result<R> + Send,
) -> PyResult<R> {
    watch(py, threads, None, |_| work())
}

/// [`run`] for a solver. `progress` is called with sweeps, residual and threshold during the solve and once at its end.
/// If it raises StopIteration, the solver ends with what it has.
///
/// # Errors
/// As [`run`], and the exception of the callback, which ends the work.
pub(crate) fn watch<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(&Reports) -> ppvi::Result<R> + Send,
) -> PyResult<R> {
    let reports = Reports { wanted: progress.is_some(), latest: Mutex::new(None), enough: AtomicBool::new(false) };
    let needs_gil = progress.is_some() || is_main_thread(py)?;
    let attend = |py: Python<'_>| -> PyResult<()> {
        py.check_signals()?;
        let state = *reports.latest();
        if let (Some(callback), Some(state)) = (&progress, state) {
            match callback.call1(py, (state.sweeps, state.residual, state.threshold)) {
                Err(error) if error.is_instance_of::<PyStopIteration>(py) => {
                    reports.enough.store(true, Ordering::Relaxed)
                }
                answer => drop(answer?),
            }
        }
        Ok(())
    };
    let stop = StopFlag::new();
    let mut raised = None;
    let mut result = None;
    with_pool(threads, |pool| {
        py.detach(|| {
            let (result, stop, reports) = (&mut result, &stop, &reports);
            let task = Task::start(pool, move || {
                *result = Some(catch_unwind(AssertUnwindSafe(|| stop.guard(|| work(reports)))));
            });
            while !task.is_done_after(INTERVAL) {
                if needs_gil
                    && raised.is_none()
                    && let Err(error) = Python::attach(attend)
                {
                    raised = Some(error);
                    stop.raise();
                    task.cancel();
                }
            }
        });
    })?;
    if let Some(error) = raised {
        return Err(error);
    }
    let result = result.unwrap_or_else(|| Err(Box::new("the work has no result")));
    let result = result.map_err(|panic| defect(&*panic))?.and_then(|result| result).map_err(exception)?;
    attend(py)?;
    Ok(result)
}

/// [`watch`] for a solver that calls its observer more often than every [`INTERVAL`] and needs no pool: on this thread, since
/// another one would take longer to start than a small problem takes.
///
/// # Errors
/// As [`watch`].
pub(crate) fn watch_here<R: Send>(
    py: Python<'_>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(Observer) -> ppvi::Result<R> + Send,
) -> PyResult<R> {
    let call = |py: Python<'_>, state: &Progress| -> PyResult<bool> {
        let Some(callback) = &progress else { return Ok(true) };
        match callback.call1(py, (state.sweeps, state.residual, state.threshold)) {
            Err(error) if error.is_instance_of::<PyStopIteration>(py) => Ok(false),
            answer => answer.map(|_| true),
        }
    };
    let (mut latest, mut raised, mut attended) = (None, None, Instant::now());
    let mut observer = |state: &Progress| {
        latest = Some(*state);
        if attended.elapsed() < INTERVAL {
            return ControlFlow::Continue(());
        }
        attended = Instant::now();
        match Python::attach(|py| py.check_signals().and_then(|()| call(py, state))) {
            Ok(true) => ControlFlow::Continue(()),
            Ok(false) => ControlFlow::Break(()),
            Err(error) => {
                raised = Some(error);
                ControlFlow::Break(())
            }
        }
    };
    let result = py.detach(|| catch_unwind(AssertUnwindSafe(|| work(&mut observer))));
    if let Some(error) = raised {
        return Err(error);
    }
    let result = result.map_err(|panic| defect(&*panic))?.map_err(exception)?;
    if let Some(state) = latest {
        call(py, &state)?;
    }
    Ok(result)
}

/// Whether this is the thread on which Python handles signals.
fn is_main_thread(py: Python<'_>) -> PyResult<bool> {
    let threading = py.import(intern!(py, "threading"))?;
    let main = threading.call_method0(intern!(py, "main_thread"))?.getattr(intern!(py, "ident"))?;
    threading.call_method0(intern!(py, "get_ident"))?.eq(main)
}

/// What a solver tells the waiting thread.
pub(crate) struct Reports {
    wanted: bool,
    latest: Mutex<Option<Progress>>,
    /// Set if the callback has ended the solve.
    enough: AtomicBool,
}

impl Reports {
    fn latest(&self) -> MutexGuard<'_, Option<Progress>> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The observer of the solver.
    pub(crate) fn observer(&self) -> impl FnMut(&Progress) -> ControlFlow<()> + Send {
        |state| {
            if self.wanted {
                *self.latest() = Some(*state);
            }
            if self.enough.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        }
    }
}

type Work<'a> = Box<dyn FnOnce() + Send + 'a>;

/// Work on a pool that borrows from the thread that waits for it. A scope of rayon would do, if work could be taken
/// back that has not begun: a pool may be busy with the work of others for minutes.
struct Task<'a> {
    /// The work, until the pool begins it.
    waiting: Arc<Mutex<Option<Work<'static>>>>,
    /// Closed when the work has run or is dropped.
    done: Receiver<()>,
    borrows: PhantomData<&'a ()>,
}

impl<'a> Task<'a> {
    /// Queues work that does not panic.
    fn start(pool: &ThreadPool, work: impl FnOnce() + Send + 'a) -> Self {
        let (open, done) = channel();
        let work: Work<'a> = Box::new(move || {
            // Consumes `work`, and with it everything that it borrows.
            work();
            drop(open);
        });
        // SAFETY: only the lifetime changes, so it has to be shown that the work does not outlive 'a. Either the pool
        // takes it and runs it, which ends with `drop(open)`, or `cancel` takes it and drops it on the thread that
        // holds this task. The drop of the task, within 'a, waits until one of the two has happened. A task is not
        // leaked: it stays a local variable of `watch`.
        let work = unsafe { std::mem::transmute::<Work<'a>, Work<'static>>(work) };
        let waiting = Arc::new(Mutex::new(Some(work)));
        let task = Task { waiting: waiting.clone(), done, borrows: PhantomData };
        pool.spawn(move || {
            if let Some(work) = take(&waiting) {
                work();
            }
        });
        task
    }

    /// Waits for the work, at most for some time; whether it is done.
    fn is_done_after(&self, time: Duration) -> bool {
        matches!(self.done.recv_timeout(time), Err(RecvTimeoutError::Disconnected))
    }

    /// Drops the work if the pool has not begun it.
    fn cancel(&self) {
        drop(take(&self.waiting));
    }
}

impl Drop for Task<'_> {
    fn drop(&mut self) {
        self.cancel();
        while self.done.recv().is_ok() {}
    }
}

fn take(work: &Mutex<Option<Work<'static>>>) -> Option<Work<'static>> {
    work.lock().unwrap_or_else(PoisonError::into_inner).take()
}
