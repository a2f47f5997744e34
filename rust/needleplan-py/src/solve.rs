//! What the solvers of both problem types share: stop rules, progress and signals, reports, errors.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use numpy::PyArray1;
use ppvi::{Error, Observer, Progress, Report, StopRule};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::threads::with_pool;

/// Time between two looks at Python's signals while a solver runs.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// Time that a solver's thread waits for the progress callback before it offers itself to the pool.
const ANSWER_INTERVAL: Duration = Duration::from_millis(1);

/// The Python exception for an error of the solvers.
pub(crate) fn exception(error: Error) -> PyErr {
    match error {
        Error::TooLarge { .. } => PyMemoryError::new_err(error.to_string()),
        _ => PyValueError::new_err(error.to_string()),
    }
}

/// Runs a solver on the threads of [`with_pool`], while this thread handles signals and calls `progress`.
///
/// # Errors
/// The exception of a signal (KeyboardInterrupt) or of the callback, which stops the solver; otherwise the solver's.
pub(crate) fn solve_with_progress<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
    solve: impl FnOnce(Observer<'_>) -> ppvi::Result<R> + Send,
) -> PyResult<R> {
    let (states, reported) = channel::<Progress>();
    let (answers, answered) = channel::<ControlFlow<()>>();
    let stopped = AtomicBool::new(false);
    let (stopped, reports) = (&stopped, progress.is_some());
    let mut observe = move |state: &Progress| {
        if stopped.load(Ordering::Relaxed) {
            return ControlFlow::Break(());
        }
        if !reports || states.send(*state).is_err() {
            return ControlFlow::Continue(());
        }
        wait(&answered)
    };
    let call_back = |state: Option<Progress>| {
        Python::attach(|py| {
            py.check_signals()?;
            if let (Some(progress), Some(state)) = (&progress, state) {
                progress.call1(py, (state.sweeps, state.residual, state.threshold))?;
            }
            Ok(())
        })
    };
    let mut raised: Option<PyErr> = None;
    let mut solution = None;
    with_pool(threads, |pool| {
        py.detach(|| {
            pool.in_place_scope(|scope| {
                let (solution, reported) = (&mut solution, reported);
                // The channels close when the solver returns, and with them the loop below.
                scope.spawn(move |_| *solution = Some(solve(&mut observe)));
                loop {
                    let state = match reported.recv_timeout(SIGNAL_INTERVAL) {
                        Ok(state) => Some(state),
                        Err(RecvTimeoutError::Timeout) => None,
                        Err(RecvTimeoutError::Disconnected) => break,
                    };
                    if raised.is_none()
                        && let Err(error) = call_back(state)
                    {
                        raised = Some(error);
                        stopped.store(true, Ordering::Relaxed);
                    }
                    if state.is_some() {
                        let go_on = if raised.is_none() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
                        // Fails only if the solver has panicked.
                        let _ = answers.send(go_on);
                    }
                }
            });
        });
    })?;
    match (raised, solution) {
        (Some(error), _) => Err(error),
        (None, Some(solution)) => solution.map_err(exception),
        (None, None) => unreachable!("the scope ends after the solver"),
    }
}

/// Waits for the answer of the progress callback. The callback may itself need a thread of the pool, and this may be
/// the only one.
fn wait(answered: &Receiver<ControlFlow<()>>) -> ControlFlow<()> {
    loop {
        match answered.recv_timeout(ANSWER_INTERVAL) {
            Ok(answer) => return answer,
            Err(RecvTimeoutError::Disconnected) => return ControlFlow::Break(()),
            Err(RecvTimeoutError::Timeout) => rayon::yield_now(),
        };
    }
}

/// The stop rule with these limits; None leaves the default.
///
/// # Errors
/// ValueError for a limit out of range.
pub(crate) fn stop_rule(tolerance: f64, max_sweeps: Option<u64>, time_limit_s: Option<f64>) -> PyResult<StopRule> {
    let mut rule = StopRule::new(tolerance).map_err(exception)?;
    if let Some(max_sweeps) = max_sweeps {
        rule.max_sweeps = max_sweeps;
    }
    if let Some(seconds) = time_limit_s {
        let limit = Duration::try_from_secs_f64(seconds);
        rule.time_limit = Some(limit.map_err(|_| {
            PyValueError::new_err(format!("time_limit_s = {seconds}: must be finite and not negative"))
        })?);
    }
    rule.validate().map_err(exception)?;
    Ok(rule)
}

/// A report as the dictionary that Python gets.
pub(crate) fn report_dict<'py>(py: Python<'py>, report: Report, states: usize) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("status", report.status.name())?;
    dict.set_item("residual", report.residual)?;
    dict.set_item("error_bound", report.error_bound)?;
    dict.set_item("backups", report.backups)?;
    dict.set_item("sweeps", report.backups as f64 / states as f64)?;
    dict.set_item("partitions", report.partitions)?;
    dict.set_item("partitions_processed", report.partitions_processed)?;
    dict.set_item("order", PyArray1::from_vec(py, report.order))?;
    dict.set_item("seconds_solving", report.seconds_solving)?;
    dict.set_item("seconds_priorities", report.seconds_priorities)?;
    Ok(dict)
}
