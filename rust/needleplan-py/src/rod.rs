//! The function `rod_stations`: shapes of needles in layered tissue.

use needle::Rod;
use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::contiguous;
use crate::work::at_once;

/// Positions and tangents, normals and curvatures, `[needles, places, 3]`.
type Stations<'py> =
    (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>);

/// Positions, tangents, normals and curvatures, `[needles, places, 3]`, of needles of some inserted lengths,
/// `[needles]`, at places from the entry, `[needles, places]`; `intrinsic_per_mm` is `[needles, layers]`.
#[pyfunction]
#[pyo3(signature = (*, lengths_mm, places_mm, intrinsic_per_mm, boundaries_mm, start_per_mm, torsion_ratio))]
pub(crate) fn rod_stations<'py>(
    py: Python<'py>,
    lengths_mm: PyReadonlyArray1<'py, f64>,
    places_mm: PyReadonlyArray2<'py, f64>,
    intrinsic_per_mm: PyReadonlyArray2<'py, f64>,
    boundaries_mm: Vec<f64>,
    start_per_mm: [f64; 3],
    torsion_ratio: f64,
) -> PyResult<Stations<'py>> {
    let (needles, places, layers) = (lengths_mm.shape()[0], places_mm.shape()[1], intrinsic_per_mm.shape()[1]);
    if places_mm.shape()[0] != needles || intrinsic_per_mm.shape()[0] != needles || places == 0 || layers == 0 {
        return Err(PyValueError::new_err(format!(
            "places_mm, intrinsic_per_mm: expected {needles} rows that are not empty, found {:?} and {:?}",
            places_mm.shape(),
            intrinsic_per_mm.shape()
        )));
    }
    let lengths = contiguous("lengths_mm", &lengths_mm)?;
    let (rows, laws) = (contiguous("places_mm", &places_mm)?, contiguous("intrinsic_per_mm", &intrinsic_per_mm)?);
    let mut columns: [Vec<f64>; 4] = [(); 4].map(|()| Vec::with_capacity(needles * places * 3));
    at_once(|| {
        for ((length, row), law) in lengths.iter().zip(rows.chunks(places)).zip(laws.chunks(layers)) {
            for station in Rod::new(*length, law, &boundaries_mm, torsion_ratio)?.stations(start_per_mm, row)? {
                let [tangent, normal, _] = station.axes;
                for (column, value) in columns.iter_mut().zip([station.position, tangent, normal, station.curvature]) {
                    column.extend(value);
                }
            }
        }
        Ok(())
    })?;
    let [position, tangent, normal, curvature] = columns.map(|column| {
        Array3::from_shape_vec([needles, places, 3], column).map_err(|error| PyValueError::new_err(error.to_string()))
    });
    Ok((position?.into_pyarray(py), tangent?.into_pyarray(py), normal?.into_pyarray(py), curvature?.into_pyarray(py)))
}
