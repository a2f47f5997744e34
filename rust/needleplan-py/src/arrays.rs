//! The contents of NumPy arrays during long work, while other threads of Python may write to them.

use std::borrow::Cow;

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

/// Rows of x, y, heading and bevel.
///
/// # Errors
/// ValueError for an array of another shape, or one that is not contiguous in C order.
pub(crate) fn poses(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; 4]>> {
    if array.shape()[1] != 4 {
        return Err(PyValueError::new_err(format!("starts: expected shape [n, 4], found {:?}", array.shape())));
    }
    Ok(contiguous("starts", array)?.as_chunks().0.to_vec())
}
