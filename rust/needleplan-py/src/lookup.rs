//! Look-ups in a table. They need no lattice.

use needle::{Table, TableGrid};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2, PyReadonlyArray4, PyUntypedArrayMethods};
use ppvi::lattice::Shape;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{contiguous, elements};
use crate::work::{at_once, run};

/// Largest number of poses that are looked up on the caller's thread: in less time than another thread needs to start.
pub(crate) const FEW: usize = 256;

/// Actions, values, success probabilities.
pub(crate) type Looked<'py> = (Bound<'py, PyArray1<u8>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>);

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
    let look_up = |values: &[f32], policy: &[u8], success: &[f32], poses: &[f64]| {
        let grid = TableGrid::new(Shape { nx, ny, headings }, spacing_mm, size_mm)?;
        grid.look_up_many(poses.as_chunks().0, &Table { values, policy, success })
    };
    let answers = if poses.shape()[0] <= FEW {
        let (values, policy) = (contiguous("values", &values)?, contiguous("policy", &policy)?);
        let (success, poses) = (contiguous("success", &success)?, contiguous("poses", &poses)?);
        at_once(|| look_up(values, policy, success, poses))?
    } else {
        let (values, policy) = (elements("values", &values)?, elements("policy", &policy)?);
        let (success, poses) = (elements("success", &success)?, elements("poses", &poses)?);
        run(py, threads, || look_up(&values, &policy, &success, &poses))?
    };
    Ok((answers.actions.into_pyarray(py), answers.values.into_pyarray(py), answers.success.into_pyarray(py)))
}
