//! The functions `path_moved` and `path_corrected`: one step of the tip filter.

use needle::path_state::{self, PATH_SIZE, PathNoise, PathPiece, SENSED_SIZE};
use numpy::ndarray::{Array1, Array2};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::contiguous;
use crate::work::at_once;

type State<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// Copies of a state, `[columns]`, and its covariance, `[columns, columns]`.
fn copied(state: &PyReadonlyArray1<'_, f64>, covariance: &PyReadonlyArray2<'_, f64>) -> PyResult<(Vec<f64>, Vec<f64>)> {
    let (state, covariance) = (contiguous("state", state)?.to_vec(), contiguous("covariance", covariance)?.to_vec());
    let columns = state.len();
    if covariance.len() != columns * columns || (columns != PATH_SIZE && columns < SENSED_SIZE) {
        let rule = format!("{PATH_SIZE} or at least {SENSED_SIZE} columns and a square covariance");
        return Err(PyValueError::new_err(format!("state: expected {rule}, found {columns}, {}", covariance.len())));
    }
    Ok((state, covariance))
}

fn returned(py: Python<'_>, state: Vec<f64>, covariance: Vec<f64>) -> PyResult<State<'_>> {
    let columns = state.len();
    let covariance = Array2::from_shape_vec((columns, columns), covariance);
    let covariance = covariance.map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok((Array1::from(state).into_pyarray(py), covariance.into_pyarray(py)))
}

/// State and covariance at the end of a piece of the path.
///
/// `piece` holds length (mm), mean cosine and sine of the roll, rotation of the base (rad), and whether it is in tissue;
/// `noise` the fields of `PathNoise`.
#[pyfunction]
pub(crate) fn path_moved<'py>(
    py: Python<'py>,
    state: PyReadonlyArray1<'py, f64>,
    covariance: PyReadonlyArray2<'py, f64>,
    piece: (f64, f64, f64, f64, bool),
    planned_per_mm: f64,
    noise: [f64; 6],
) -> PyResult<State<'py>> {
    let (mut state, mut covariance) = copied(&state, &covariance)?;
    let (length, cos, sin, turned, fresh) = piece;
    let [slip, heading, factor, change, decay, roll] = noise;
    let (piece, noise) =
        (PathPiece { length, cos, sin, turned, fresh }, PathNoise { slip, heading, factor, change, decay, roll });
    at_once(|| {
        path_state::moved(&mut state, &mut covariance, &piece, planned_per_mm, &noise);
        Ok(())
    })?;
    returned(py, state, covariance)
}

/// Normalised squared innovation of a measurement of two numbers, and state and covariance after it.
#[pyfunction]
#[pyo3(signature = (state, covariance, columns, model, innovation, *, variance, gate))]
#[expect(clippy::too_many_arguments, reason = "the arguments of a measurement equation")]
pub(crate) fn path_corrected<'py>(
    py: Python<'py>,
    state: PyReadonlyArray1<'py, f64>,
    covariance: PyReadonlyArray2<'py, f64>,
    columns: Vec<usize>,
    model: Vec<[f64; 2]>,
    innovation: [f64; 2],
    variance: f64,
    gate: f64,
) -> PyResult<(f64, State<'py>)> {
    let (mut state, mut covariance) = copied(&state, &covariance)?;
    if columns.len() != model.len() || columns.iter().any(|&column| column >= state.len()) {
        return Err(PyValueError::new_err("columns: expected one column of the state for each pair of the model"));
    }
    let squared = at_once(|| {
        Ok(path_state::corrected(&mut state, &mut covariance, &columns, &model, innovation, variance, gate))
    })?;
    Ok((squared, returned(py, state, covariance)?))
}
