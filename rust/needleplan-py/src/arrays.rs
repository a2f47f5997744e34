//! The contents of NumPy arrays during long work, while other threads of Python may write to them.

use std::borrow::Cow;

use needle::Truth;
use needle::space::{SpacePose, SpaceTruth};
use numpy::ndarray::Dimension;
use numpy::{Element, PyReadonlyArray, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::intern;
use pyo3::prelude::*;

/// Returns the elements of an array: borrowed if it is read-only, otherwise a copy.
///
/// # Errors
/// ValueError if the array is not contiguous in C order.
pub(crate) fn elements<'a, T: Element + Copy, D: Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, T, D>,
) -> PyResult<Cow<'a, [T]>> {
    let elements = contiguous(name, array)?;
    let flags = array.getattr(intern!(array.py(), "flags"))?;
    let writeable: bool = flags.getattr(intern!(array.py(), "writeable"))?.extract()?;
    Ok(if writeable { Cow::Owned(elements.to_vec()) } else { Cow::Borrowed(elements) })
}

/// Returns the elements of an array, borrowed.
///
/// # Errors
/// As [`elements`].
pub(crate) fn contiguous<'a, T: Element, D: Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, T, D>,
) -> PyResult<&'a [T]> {
    let elements = if array.is_c_contiguous() { array.as_slice().ok() } else { None };
    elements.ok_or_else(|| PyValueError::new_err(format!("{name}: must be contiguous in C order")))
}

/// Rows of `N` numbers.
///
/// # Errors
/// ValueError for an array of another shape, or one that is not contiguous in C order.
fn rows<'a, const N: usize>(name: &str, array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [[f64; N]]> {
    if array.shape()[1] != N {
        return Err(PyValueError::new_err(format!("{name}: expected shape [n, {N}], found {:?}", array.shape())));
    }
    Ok(contiguous(name, array)?.as_chunks().0)
}

/// Rows of x, y, heading and bevel.
///
/// # Errors
/// As [`rows`].
pub(crate) fn poses(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; 4]>> {
    Ok(rows("starts", array)?.to_vec())
}

/// Rows of the turn, rad, the shift along x, y and z, mm, the relative curvature, and the length behind the tip, mm.
///
/// # Errors
/// As [`rows`].
pub(crate) fn truths(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Truth>> {
    let truth = |[turn, x, y, aside, curvature, behind]: &[f64; 6]| Truth {
        turn: *turn,
        shift: [*x, *y],
        aside: *aside,
        curvature: *curvature,
        behind: *behind,
    };
    Ok(rows("truths", array)?.iter().map(truth).collect())
}

/// Rows of position, mm, and tangent.
///
/// # Errors
/// As [`rows`].
pub(crate) fn space_poses(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<SpacePose>> {
    let pose = |[x, y, z, dx, dy, dz]: &[f64; 6]| SpacePose { position: [*x, *y, *z], tangent: [*dx, *dy, *dz] };
    Ok(rows("poses", array)?.iter().map(pose).collect())
}

/// The pose of an array with one row.
///
/// # Errors
/// As [`space_poses`], and ValueError for another number of rows.
pub(crate) fn one_pose(array: &PyReadonlyArray2<'_, f64>) -> PyResult<SpacePose> {
    match space_poses(array)?[..] {
        [start] => Ok(start),
        _ => Err(PyValueError::new_err("pose_mm: expected one row")),
    }
}

/// Rows of the three rows of a rigid motion, each rotation and shift, mm, the relative curvature, and the length behind the
/// tip, mm.
///
/// # Errors
/// As [`rows`].
pub(crate) fn space_truths(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<SpaceTruth>> {
    let truth = |row: &[f64; 14]| SpaceTruth {
        rows: [0, 1, 2].map(|axis| [0, 1, 2, 3].map(|at| row[4 * axis + at])),
        curvature: row[12],
        behind: row[13],
    };
    Ok(rows("truths", array)?.iter().map(truth).collect())
}
