//! Look-ups in a table. They need no lattice.

use needle::{Table, TableGrid};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2, PyReadonlyArray4, PyUntypedArrayMethods};
use ppvi::lattice::Shape;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::solve::exception;
use crate::threads::detached;

/// Actions, values, success probabilities.
type Looked<'py> = (Bound<'py, PyArray1<u8>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>);

/// Actions, values and success probabilities at the states nearest to many poses.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
#[pyo3(signature = (values, policy, success, spacing_mm, size_mm, poses, threads=None))]
pub(crate) fn lookup_many<'py>(
    py: Python<'py>,
    values: PyReadonlyArray4<'py, f32>,
    policy: PyReadonlyArray4<'py, u8>,
    success: PyReadonlyArray4<'py, f32>,
    spacing_mm: [f64; 2],
    size_mm: [f64; 2],
    poses: PyReadonlyArray2<'py, f64>,
    threads: Option<usize>,
) -> PyResult<Looked<'py>> {
    let &[nx, ny, headings, 2] = values.shape() else {
        return Err(PyValueError::new_err(format!(
            "values: expected shape [nx, ny, headings, 2], found {:?}",
            values.shape()
        )));
    };
    if poses.shape()[1] != 4 {
        return Err(PyValueError::new_err(format!("poses: expected shape [n, 4], found {:?}", poses.shape())));
    }
    let grid = TableGrid::new(Shape { nx, ny, headings }, spacing_mm, size_mm).map_err(exception)?;
    let table = Table { values: values.as_slice()?, policy: policy.as_slice()?, success: success.as_slice()? };
    let (rows, _) = poses.as_slice()?.as_chunks::<4>();
    let answers = detached(py, threads, || grid.look_up_many(rows, &table))?.map_err(exception)?;
    Ok((answers.actions.into_pyarray(py), answers.values.into_pyarray(py), answers.success.into_pyarray(py)))
}
