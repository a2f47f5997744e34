//! The functions `lattice_codes`, a segmentation in the voxels of a lattice, and `impossible`, a proof on them.

use needle::space::{Feasibility, Segmentation, Volume};
use numpy::ndarray::Array3;
use numpy::{IntoPyArray, PyArray1, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use ppvi::space::CollisionGrid;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::elements;
use crate::arrays::space_poses as poses;
use crate::work::run;

/// Codes of the voxels of a lattice, `[x, y, z]`: those of `codes` at their centres, and 2 where an obstacle, grown by
/// the `growth_mm` of its kind, reaches.
#[pyfunction]
#[pyo3(signature = (*, codes, obstacles, growth_mm, axes, sizes_mm, origin_mm, count, size_mm, threads=None))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn lattice_codes<'py>(
    py: Python<'py>,
    codes: PyReadonlyArray3<'_, u8>,
    obstacles: PyReadonlyArray3<'_, u8>,
    growth_mm: Vec<f64>,
    axes: [[f64; 3]; 3],
    sizes_mm: [f64; 3],
    origin_mm: [f64; 3],
    count: [usize; 3],
    size_mm: f64,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let shape = [codes.shape()[0], codes.shape()[1], codes.shape()[2]];
    let (codes, obstacles) = (elements("codes", &codes)?, elements("obstacles", &obstacles)?);
    let (codes, obstacles, growth_mm) = (&*codes, &*obstacles, &*growth_mm);
    let file = Segmentation { shape, codes, obstacles, growth_mm, axes, sizes_mm, origin_mm };
    let found = run(py, threads, || file.codes_of(count, size_mm))?;
    let found = Array3::from_shape_vec(count, found);
    Ok(found.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
}

/// Whether no path from each pose, `[n, 6]`, reaches the target through voxels with the centres at grid points; `slopes` is the
/// side of the squares of slopes.
#[pyfunction]
#[pyo3(signature = (poses_mm, *, voxels, spacing_mm, curvature_radii_mm, cone_rad, slopes, advance, threads=None))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn impossible<'py>(
    py: Python<'py>,
    poses_mm: PyReadonlyArray2<'_, f64>,
    voxels: PyReadonlyArray3<'_, u8>,
    spacing_mm: [f64; 3],
    curvature_radii_mm: Vec<f64>,
    cone_rad: f64,
    slopes: f64,
    advance: usize,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyArray1<bool>>> {
    let (starts, shape) = (poses(&poses_mm)?, [voxels.shape()[0], voxels.shape()[1], voxels.shape()[2]]);
    let codes = elements("voxels", &voxels)?;
    // The proof holds for the largest curvature anywhere.
    let least = curvature_radii_mm.into_iter().fold(f64::INFINITY, f64::min);
    let proof = run(py, threads, || {
        let volume = Volume::new(CollisionGrid::new(shape, 1, &codes)?, spacing_mm, vec![], &[least])?;
        Feasibility::new(&volume, cone_rad, slopes, advance)
    })?;
    Ok(PyArray1::from_vec(py, starts.into_iter().map(|pose| proof.is_impossible(pose)).collect()))
}
