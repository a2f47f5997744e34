//! The functions `slid`, `yielding` and `dragged`: bristles of friction along sampled motions.

use needle::bristle::{self, Compliance};
use numpy::ndarray::{Array1, Array2};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::contiguous;
use crate::work::at_once;

/// ValueError unless an array has as many elements as there are samples.
fn long(name: &str, found: usize, samples: usize) -> PyResult<()> {
    let rule = || PyValueError::new_err(format!("{name}: expected {samples} samples, found {found}"));
    if found == samples && samples > 0 { Ok(()) } else { Err(rule()) }
}

/// Dahl's bristle along each of several motions, `[motions, samples]`, for each length, `[motions * lengths, samples]`.
#[pyfunction]
pub(crate) fn slid<'py>(
    py: Python<'py>,
    velocity_mm_s: PyReadonlyArray2<'_, f64>,
    time_s: PyReadonlyArray1<'_, f64>,
    lengths_mm: Vec<f64>,
    start: f64,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (motions, samples) = (velocity_mm_s.shape()[0], velocity_mm_s.shape()[1]);
    let (velocity, time) = (contiguous("velocity_mm_s", &velocity_mm_s)?, contiguous("time_s", &time_s)?);
    long("time_s", time.len(), samples)?;
    let mut found = vec![0.0; motions * lengths_mm.len() * samples];
    at_once(|| {
        let mut rows = found.chunks_exact_mut(samples);
        for motion in velocity.chunks_exact(samples) {
            for (&length, row) in lengths_mm.iter().zip(&mut rows) {
                bristle::slid(motion, time, length, start, row);
            }
        }
        Ok(())
    })?;
    let found = Array2::from_shape_vec((motions * lengths_mm.len(), samples), found);
    Ok(found.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
}

/// Mean of elastoplastic elements along a motion, `[samples]`; `yields` are their travels in units of the length.
#[pyfunction]
pub(crate) fn yielding<'py>(
    py: Python<'py>,
    velocity_mm_s: PyReadonlyArray1<'_, f64>,
    time_s: PyReadonlyArray1<'_, f64>,
    length_mm: f64,
    yields: Vec<f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (velocity, time) = (contiguous("velocity_mm_s", &velocity_mm_s)?, contiguous("time_s", &time_s)?);
    long("time_s", time.len(), velocity.len())?;
    let mut found = vec![0.0; velocity.len()];
    at_once(|| {
        bristle::yielding(velocity, time, length_mm, &yields, &mut found);
        Ok(())
    })?;
    Ok(Array1::from(found).into_pyarray(py))
}

/// Bristle and tissue displacement (mm) along a motion in compliant tissue, `[2, samples]`; `start` holds the first ones.
#[pyfunction]
pub(crate) fn dragged<'py>(
    py: Python<'py>,
    velocity_mm_s: PyReadonlyArray1<'_, f64>,
    time_s: PyReadonlyArray1<'_, f64>,
    largest_mm: PyReadonlyArray1<'_, f64>,
    lag_s: f64,
    presliding_mm: f64,
    start: [f64; 2],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (velocity, time) = (contiguous("velocity_mm_s", &velocity_mm_s)?, contiguous("time_s", &time_s)?);
    let largest_mm = contiguous("largest_mm", &largest_mm)?;
    let samples = velocity.len();
    long("time_s", time.len(), samples)?;
    long("largest_mm", largest_mm.len(), samples)?;
    let mut found = vec![0.0; 2 * samples];
    at_once(|| {
        let (bristle, moved) = found.split_at_mut(samples);
        (bristle[0], moved[0]) = (start[0], start[1]);
        Compliance { largest_mm, lag_s, presliding_mm }.drag(velocity, time, bristle, moved);
        Ok(())
    })?;
    let found = Array2::from_shape_vec((2, samples), found);
    Ok(found.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
}
