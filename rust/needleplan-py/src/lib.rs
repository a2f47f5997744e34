//! The binding: arrays in, arrays out. Everything it calls is an ordinary function of this crate.

mod lattice;
mod lookup;
mod tabular;

use std::ops::ControlFlow;
use std::time::Duration;

use numpy::PyArray1;
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::{Error, Observer, Progress, Report, StopRule};

impl From<Error> for PyErr {
    fn from(error: Error) -> PyErr {
        match error {
            Error::TooLarge { .. } => PyMemoryError::new_err(error.to_string()),
            _ => PyValueError::new_err(error.to_string()),
        }
    }
}

/// Runs `work` without the GIL, on `threads` threads (default: all).
fn detached<R: Send>(py: Python<'_>, threads: Option<usize>, work: impl FnOnce() -> R + Send) -> PyResult<R> {
    let Some(threads) = threads else {
        return Ok(py.detach(work));
    };
    if threads == 0 || threads > 1024 {
        return Err(PyValueError::new_err(format!("threads = {threads}: must be between 1 and 1024")));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|error| PyValueError::new_err(format!("threads = {threads}: {error}")))?;
    Ok(py.detach(|| pool.install(work)))
}

/// Calls back into Python between sweeps: signals first, then the caller's function; an exception stops the solve.
fn solve_with_progress<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
    solve: impl FnOnce(Observer<'_>) -> crate::Result<R> + Send,
) -> PyResult<R> {
    let mut raised: Option<PyErr> = None;
    let mut observe = |state: &Progress| {
        let outcome = Python::attach(|py| {
            py.check_signals()?;
            if let Some(progress) = &progress {
                progress.call1(py, (state.sweeps, state.residual, state.threshold))?;
            }
            Ok(())
        });
        match outcome {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                raised = Some(error);
                ControlFlow::Break(())
            }
        }
    };
    let solution = detached(py, threads, || solve(&mut observe))?;
    match raised {
        Some(error) => Err(error),
        None => Ok(solution?),
    }
}

fn stop_rule(tolerance: f64, max_sweeps: Option<u64>, time_limit_s: Option<f64>) -> PyResult<StopRule> {
    let mut rule = StopRule::new(tolerance)?;
    if let Some(max_sweeps) = max_sweeps {
        rule.max_sweeps = max_sweeps;
    }
    if let Some(seconds) = time_limit_s {
        let limit = Duration::try_from_secs_f64(seconds);
        rule.time_limit = Some(limit.map_err(|_| {
            PyValueError::new_err(format!("time_limit_s = {seconds}: must be finite and not negative"))
        })?);
    }
    rule.validate()?;
    Ok(rule)
}

fn report_dict<'py>(py: Python<'py>, report: Report, states: usize) -> PyResult<Bound<'py, PyDict>> {
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

#[pymodule]
fn _ppvi(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<lattice::Lattice>()?;
    module.add_class::<tabular::Tabular>()?;
    module.add_function(wrap_pyfunction!(lookup::lookup_many, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}
