//! What a pass and executions in a volume return, as Python objects.

use needle::space::{SpacePath, SpaceRun};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1};
use ppvi::space::PassReport;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Outcome, length and its straight part, mm, number of turns, and cost of each run.
pub(crate) fn rollout_arrays<'py>(py: Python<'py>, runs: &[SpaceRun]) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("outcome", PyArray1::from_iter(py, runs.iter().map(|run| run.event as u8)))?;
    dict.set_item("length_mm", PyArray1::from_iter(py, runs.iter().map(|run| run.length)))?;
    dict.set_item("straight_mm", PyArray1::from_iter(py, runs.iter().map(|run| run.straight)))?;
    dict.set_item("turns", PyArray1::from_iter(py, runs.iter().map(|run| run.turns)))?;
    dict.set_item("cost", PyArray1::from_iter(py, runs.iter().map(|run| run.cost)))?;
    Ok(dict)
}

/// The same of paths, with the codes of the voxels that have ended them, the poses of all of them, `[n, 6]`, position in mm and
/// tangent, the rows of those before a turn, and how many are before each path and in all.
pub(crate) fn path_arrays<'py>(py: Python<'py>, paths: &[SpacePath]) -> PyResult<Bound<'py, PyDict>> {
    let runs: Vec<SpaceRun> = paths.iter().map(|path| path.run).collect();
    let dict = rollout_arrays(py, &runs)?;
    let (mut bounds, mut turns) = (vec![0i64], vec![]);
    for path in paths {
        let first = bounds.last().copied().unwrap_or_default();
        turns.extend(path.turns.iter().map(|turn| first + *turn as i64));
        bounds.push(first + path.poses.len() as i64);
    }
    let poses: Vec<f64> =
        paths.iter().flat_map(|path| &path.poses).flat_map(|pose| [pose.position, pose.tangent]).flatten().collect();
    let poses = Array2::from_shape_vec((poses.len() / 6, 6), poses);
    dict.set_item("end", PyArray1::from_iter(py, paths.iter().map(|path| path.end)))?;
    dict.set_item("poses", poses.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))?;
    dict.set_item("turn_rows", PyArray1::from_vec(py, turns))?;
    dict.set_item("bounds", PyArray1::from_vec(py, bounds))?;
    Ok(dict)
}

/// Status, first finished slice, number of backups and seconds.
pub(crate) fn described(py: Python<'_>, report: PassReport) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("status", report.status.name())?;
    dict.set_item("first_slice", report.first_slice)?;
    dict.set_item("backups", report.backups)?;
    dict.set_item("seconds", report.seconds)?;
    Ok(dict)
}
