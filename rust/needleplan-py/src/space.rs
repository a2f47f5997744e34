//! The classes `Space` and `SolvedSpace`: a steering problem in a volume, its tables, look-ups and executions.

use std::sync::Arc;
use std::time::Duration;

use needle::space::{Feasibility, SpaceCosts, SpaceExecutor, SpacePose, SpaceProblem, SpaceSetup, Volume};
use needle::{Event, Straight};
use numpy::ndarray::{Array2, Array4};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray4, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use ppvi::Status;
use ppvi::space::{Order, PassOptions, PassReport, SpaceTables, solve};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{contiguous, elements};
use crate::work::{run, watch};

/// A steering problem in a volume.
#[pyclass(frozen, module = "needleplan._ppvi")]
pub(crate) struct Space {
    problem: Arc<SpaceProblem>,
}

/// A problem and its tables.
#[pyclass(frozen, module = "needleplan._ppvi")]
pub(crate) struct SolvedSpace {
    problem: Arc<SpaceProblem>,
    tables: SpaceTables,
}

/// Rows of position, mm, and tangent.
///
/// # Errors
/// ValueError for an array of another shape, or one that is not contiguous in C order.
fn poses(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<SpacePose>> {
    if array.shape()[1] != 6 {
        return Err(PyValueError::new_err(format!("poses: expected shape [n, 6], found {:?}", array.shape())));
    }
    let rows = contiguous("poses", array)?.as_chunks::<6>().0;
    Ok(rows
        .iter()
        .map(|[x, y, z, dx, dy, dz]| SpacePose { position: [*x, *y, *z], tangent: [*dx, *dy, *dz] })
        .collect())
}

#[pymethods]
impl Space {
    #[new]
    #[pyo3(signature = (*, voxels, spacing_mm, curvature_radii_mm, advance, rolls, cone_rad, direction_spacing_rad,
        noise_rad_per_sqrt_mm, insertion_per_mm, rotation, collision, exit, tissues=None, prices=None, straight=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        voxels: PyReadonlyArray3<'_, u8>,
        spacing_mm: [f64; 3],
        curvature_radii_mm: Vec<f64>,
        advance: usize,
        rolls: usize,
        cone_rad: f64,
        direction_spacing_rad: f64,
        noise_rad_per_sqrt_mm: f64,
        insertion_per_mm: f64,
        rotation: f64,
        collision: f64,
        exit: f64,
        tissues: Option<PyReadonlyArray3<'_, u8>>,
        prices: Option<PyReadonlyArray3<'_, f32>>,
        straight: Option<(f64, f64)>,
    ) -> PyResult<Self> {
        let shape = [voxels.shape()[0], voxels.shape()[1], voxels.shape()[2]];
        let codes = elements("voxels", &voxels)?.into_owned();
        let tissues =
            tissues.as_ref().map_or(Ok(vec![]), |array| elements("tissues", array).map(|codes| codes.into_owned()))?;
        let prices =
            prices.as_ref().map_or(Ok(vec![]), |array| elements("prices", array).map(|prices| prices.into_owned()))?;
        let problem = run(py, None, || {
            SpaceProblem::new(SpaceSetup {
                volume: Volume::new(shape, spacing_mm, codes, tissues, &curvature_radii_mm)?,
                advance,
                rolls,
                straight: straight.map(|(curvature_share, cost_per_mm)| Straight { curvature_share, cost_per_mm }),
                cone: cone_rad,
                direction_spacing: direction_spacing_rad,
                noise: noise_rad_per_sqrt_mm,
                costs: SpaceCosts { insertion_per_mm, rotation, collision, exit },
                prices,
            })
        })?;
        Ok(Space { problem: Arc::new(problem) })
    }

    /// Slices, directions, grid points along y and along z.
    #[getter]
    fn shape(&self) -> [usize; 4] {
        let shape = self.problem.mdp().shape();
        [shape.slices, shape.directions, shape.ny, shape.nz]
    }

    /// Unit vectors of the directions, `[directions, 3]`.
    fn tangents<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let grid = self.problem.directions();
        Array2::from_shape_fn((grid.count(), 3), |(direction, axis)| grid.tangent(direction)[axis]).into_pyarray(py)
    }

    /// Makes the backward pass.
    #[pyo3(signature = (*, cubic_success=true, time_limit_s=None, threads=None, progress=None))]
    fn solve(
        &self,
        py: Python<'_>,
        cubic_success: bool,
        time_limit_s: Option<f64>,
        threads: Option<usize>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<SolvedSpace> {
        let limit = |seconds: f64| {
            let rule = || PyValueError::new_err(format!("time_limit_s = {seconds}: must be finite and not negative"));
            Duration::try_from_secs_f64(seconds).map_err(|_| rule())
        };
        let options = PassOptions {
            success: if cubic_success { Order::Cubic } else { Order::Linear },
            time_limit: time_limit_s.map(limit).transpose()?,
        };
        let tables =
            watch(py, threads, progress, |reports| solve(self.problem.mdp(), &options, Some(&mut reports.observer())))?;
        Ok(SolvedSpace { problem: self.problem.clone(), tables })
    }

    /// The problem with the finished tables of a file, each flat and in the order of `SolvedSpace.values`.
    #[pyo3(signature = (*, values, policy, success, seconds))]
    fn restore(
        &self,
        py: Python<'_>,
        values: PyReadonlyArray1<'_, f32>,
        policy: PyReadonlyArray1<'_, u8>,
        success: PyReadonlyArray1<'_, u16>,
        seconds: f64,
    ) -> PyResult<SolvedSpace> {
        let report = PassReport {
            status: Status::Converged,
            first_slice: 0,
            backups: self.problem.mdp().shape().states() as u64,
            seconds,
        };
        let tables = SpaceTables {
            values: contiguous("values", &values)?.to_vec(),
            policy: contiguous("policy", &policy)?.to_vec(),
            success: contiguous("success", &success)?.to_vec(),
            report,
        };
        run(py, None, || SpaceExecutor::new(&self.problem, &tables).map(|_| ()))?;
        Ok(SolvedSpace { problem: self.problem.clone(), tables })
    }

    /// Whether no path from each pose, `[n, 6]`, reaches the target; `slopes` is the side of the squares of slopes.
    #[pyo3(signature = (poses_mm, *, slopes, advance, threads=None))]
    fn impossible<'py>(
        &self,
        py: Python<'py>,
        poses_mm: PyReadonlyArray2<'_, f64>,
        slopes: f64,
        advance: usize,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let (starts, setup) = (poses(&poses_mm)?, self.problem.setup());
        let proof = run(py, threads, || Feasibility::new(&setup.volume, setup.cone, slopes, advance))?;
        Ok(PyArray1::from_vec(py, starts.into_iter().map(|pose| proof.is_impossible(pose)).collect()))
    }
}

impl SolvedSpace {
    /// Makes an array `[slices, directions, ny, nz]`.
    fn table<'py, T: numpy::Element>(&self, py: Python<'py>, values: Vec<T>) -> PyResult<Bound<'py, PyArray4<T>>> {
        let shape = self.problem.mdp().shape();
        let array = Array4::from_shape_vec((shape.slices, shape.directions, shape.ny, shape.nz), values);
        Ok(array.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
    }
}

#[pymethods]
impl SolvedSpace {
    /// Cost-to-go.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray4<f32>>> {
        self.table(py, self.tables.values.clone())
    }

    /// Best action: roll angles in order, then the straight step.
    #[getter]
    fn policy<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray4<u8>>> {
        self.table(py, self.tables.policy.clone())
    }

    /// Probability of success, in units of 1 / 65535.
    #[getter]
    fn success<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray4<u16>>> {
        self.table(py, self.tables.success.clone())
    }

    /// Status, first finished slice, number of backups and seconds.
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (dict, report) = (PyDict::new(py), self.tables.report);
        dict.set_item("status", report.status.name())?;
        dict.set_item("first_slice", report.first_slice)?;
        dict.set_item("backups", report.backups)?;
        dict.set_item("seconds", report.seconds)?;
        Ok(dict)
    }

    /// Best action, cost and success at each pose, `[n, 6]`.
    #[pyo3(signature = (poses_mm, *, threads=None))]
    fn look_up<'py>(
        &self,
        py: Python<'py>,
        poses_mm: PyReadonlyArray2<'_, f64>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let starts = poses(&poses_mm)?;
        let answers = run(py, threads, || SpaceExecutor::new(&self.problem, &self.tables)?.look_up_many(&starts))?;
        let dict = PyDict::new(py);
        dict.set_item("action", PyArray1::from_iter(py, answers.iter().map(|answer| answer.action as u8)))?;
        dict.set_item("value", PyArray1::from_iter(py, answers.iter().map(|answer| answer.value)))?;
        dict.set_item("success", PyArray1::from_iter(py, answers.iter().map(|answer| answer.success)))?;
        Ok(dict)
    }

    /// Executions from a pose, `[1, 6]`: whether each has reached the target, its length, mm, rotations and cost.
    #[pyo3(signature = (pose_mm, *, runs, seed, threads=None))]
    fn rollout<'py>(
        &self,
        py: Python<'py>,
        pose_mm: PyReadonlyArray2<'_, f64>,
        runs: usize,
        seed: u64,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let [start] = poses(&pose_mm)?[..] else {
            return Err(PyValueError::new_err("pose_mm: expected one row"));
        };
        let runs = run(py, threads, || SpaceExecutor::new(&self.problem, &self.tables)?.rollout(start, runs, seed))?;
        let dict = PyDict::new(py);
        dict.set_item("success", PyArray1::from_iter(py, runs.iter().map(|run| run.event == Event::Target)))?;
        dict.set_item("length_mm", PyArray1::from_iter(py, runs.iter().map(|run| run.length)))?;
        dict.set_item("rotations", PyArray1::from_iter(py, runs.iter().map(|run| run.rotations)))?;
        dict.set_item("cost", PyArray1::from_iter(py, runs.iter().map(|run| run.cost)))?;
        Ok(dict)
    }
}
