//! What the solvers of both problem types share: stop rules and reports.

use std::time::Duration;

use numpy::PyArray1;
use ppvi::lattice::sweep::LatticeSolution;
use ppvi::{Report, Solution, StopRule};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::work::exception;

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

/// Values, actions, and the report.
pub(crate) fn in_parts(solved: LatticeSolution) -> (Vec<f32>, Vec<u8>, Report) {
    (solved.values, solved.policy, solved.report)
}

/// Values in single precision, actions, and the report.
pub(crate) fn narrow(solution: Solution) -> (Vec<f32>, Vec<u8>, Report) {
    let Solution { values, policy, report } = solution;
    (values.into_iter().map(|v| v as f32).collect(), policy.into_iter().map(|action| action as u8).collect(), report)
}
