//! The classes `Space` and `SolvedSpace`: a steering problem in a volume, its tables, look-ups and executions.

use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use needle::Straight;
use needle::space::{SpaceCosts, SpaceExecutor, SpaceProblem, SpaceSetup, TargetBody, Volume};
use numpy::ndarray::{Array2, Array4};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray4, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use ppvi::Order;
use ppvi::Status;
use ppvi::space::{CollisionGrid, PassOptions, PassReport, SpaceTables, SpaceView, solve, solve_into};
use pyo3::exceptions::PyValueError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{contiguous, elements, one_pose, space_poses as poses, space_truths};
use crate::slice_file::SliceFile;
use crate::space_runs::{described, path_arrays, rollout_arrays};
use crate::work::{run, watch};

/// A steering problem in a volume.
#[pyclass(frozen, module = "needleplan._ppvi")]
pub(crate) struct Space {
    problem: Arc<SpaceProblem>,
}

/// A problem and its tables, as arrays that cannot be written to: of this process, or of a file that is mapped into memory.
#[pyclass(frozen, module = "needleplan._ppvi")]
pub(crate) struct SolvedSpace {
    problem: Arc<SpaceProblem>,
    values: Py<PyArray4<f32>>,
    policy: Py<PyArray4<u8>>,
    success: Py<PyArray4<u16>>,
    report: PassReport,
}

#[pymethods]
impl Space {
    #[new]
    #[pyo3(signature = (*, voxels, spacing_mm, curvature_radii_mm, advance, rolls, cone_rad, direction_spacing_rad,
        noise_rad_per_sqrt_mm, insertion_per_mm, rotation, collision, exit, refinement=1, tissues=None, prices=None,
        straight=None, target_ball=None, target_voxels=None))]
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
        refinement: usize,
        tissues: Option<PyReadonlyArray3<'_, u8>>,
        prices: Option<PyReadonlyArray3<'_, f32>>,
        straight: Option<(f64, f64)>,
        target_ball: Option<[f64; 4]>,
        target_voxels: Option<([[f64; 4]; 3], PyReadonlyArray3<'_, u8>)>,
    ) -> PyResult<Self> {
        let target_voxels = target_voxels.as_ref().map(|(rows, array)| {
            let inside = elements("target_voxels", array)?.iter().map(|code| *code != 0).collect();
            Ok::<_, PyErr>((*rows, [0, 1, 2].map(|axis| array.shape()[axis]), inside))
        });
        let target_voxels = target_voxels.transpose()?;
        let shape = [voxels.shape()[0], voxels.shape()[1], voxels.shape()[2]];
        let codes = elements("voxels", &voxels)?;
        let tissues =
            tissues.as_ref().map_or(Ok(vec![]), |array| elements("tissues", array).map(|codes| codes.into_owned()))?;
        let prices =
            prices.as_ref().map_or(Ok(vec![]), |array| elements("prices", array).map(|prices| prices.into_owned()))?;
        let problem = run(py, None, move || {
            let target = match (target_ball, target_voxels) {
                (Some([x, y, z, radius]), _) => Some(TargetBody::ball([x, y, z], radius)?),
                (None, Some((rows, count, inside))) => Some(TargetBody::voxels(rows, count, inside)?),
                (None, None) => None,
            };
            let voxels = CollisionGrid::new(shape.map(|count| count / refinement.max(1)), refinement, &codes)?;
            SpaceProblem::new(SpaceSetup {
                volume: Volume::new(voxels, spacing_mm, tissues, &curvature_radii_mm)?.with_target(target),
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
        self.sizes()
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
        let options = pass_options(cubic_success, time_limit_s)?;
        let mdp = self.problem.mdp();
        let tables = watch(py, threads, progress, |reports| solve(mdp, &options, Some(&mut reports.observer())))?;
        let SpaceTables { values, policy, success, report } = tables;
        Ok(SolvedSpace {
            problem: self.problem.clone(),
            values: self.table(py, values)?,
            policy: self.table(py, policy)?,
            success: self.table(py, success)?,
            report,
        })
    }

    /// Makes the backward pass and writes each slice to an existing file when it is finished. `offsets` are the places of the
    /// first bytes of values, policy and success; numbers have the byte order of the machine. Returns the report.
    #[pyo3(signature = (path, offsets, *, cubic_success=true, time_limit_s=None, threads=None, progress=None))]
    #[allow(clippy::too_many_arguments)]
    fn solve_to<'py>(
        &self,
        py: Python<'py>,
        path: PathBuf,
        offsets: [u64; 3],
        cubic_success: bool,
        time_limit_s: Option<f64>,
        threads: Option<usize>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let options = pass_options(cubic_success, time_limit_s)?;
        let mut file = SliceFile::open(&path, offsets)?;
        let mdp = self.problem.mdp();
        let report = watch(py, threads, progress, |reports| {
            solve_into(mdp, &options, Some(&mut reports.observer()), |solved| file.take(solved))
        });
        file.require_written()?;
        described(py, report?)
    }

    /// The problem with the finished tables of a file, `[slices, directions, ny, nz]`. They are copied if they can be written
    /// to, and otherwise borrowed.
    #[pyo3(signature = (*, values, policy, success, seconds))]
    fn restore(
        &self,
        py: Python<'_>,
        values: Bound<'_, PyArray4<f32>>,
        policy: Bound<'_, PyArray4<u8>>,
        success: Bound<'_, PyArray4<u16>>,
        seconds: f64,
    ) -> PyResult<SolvedSpace> {
        let report = PassReport {
            status: Status::Converged,
            first_slice: 0,
            backups: self.problem.mdp().shape().states() as u64,
            seconds,
        };
        Ok(SolvedSpace {
            problem: self.problem.clone(),
            values: self.borrowed(py, "values", values)?,
            policy: self.borrowed(py, "policy", policy)?,
            success: self.borrowed(py, "success", success)?,
            report,
        })
    }
}

impl Space {
    /// Numbers of slices, directions, and grid points along y and along z.
    fn sizes(&self) -> [usize; 4] {
        let shape = self.problem.mdp().shape();
        [shape.slices, shape.directions, shape.ny, shape.nz]
    }

    /// Makes an array `[slices, directions, ny, nz]` that cannot be written to.
    fn table<T: numpy::Element>(&self, py: Python<'_>, values: Vec<T>) -> PyResult<Py<PyArray4<T>>> {
        let array = Array4::from_shape_vec(self.sizes(), values);
        let array = array.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py);
        array.call_method1(intern!(py, "setflags"), (false,))?;
        Ok(array.unbind())
    }

    /// Borrows an array that cannot be written to, and copies another one.
    ///
    /// # Errors
    /// ValueError for an array of another shape, one that is not contiguous in C order, or not aligned.
    fn borrowed<T: numpy::Element + Copy>(
        &self,
        py: Python<'_>,
        name: &str,
        array: Bound<'_, PyArray4<T>>,
    ) -> PyResult<Py<PyArray4<T>>> {
        let (shape, flags) = (self.sizes(), array.getattr(intern!(py, "flags"))?);
        let is_aligned: bool = flags.getattr(intern!(py, "aligned"))?.extract()?;
        if array.shape() != shape || !is_aligned {
            let found = array.shape();
            return Err(PyValueError::new_err(format!(
                "{name}: expected shape {shape:?} and aligned, found {found:?}"
            )));
        }
        let readable = array.readonly();
        let is_writeable: bool = flags.getattr(intern!(py, "writeable"))?.extract()?;
        match elements(name, &readable)? {
            Cow::Owned(copy) if is_writeable => self.table(py, copy),
            _ => Ok(array.clone().unbind()),
        }
    }
}

/// The options of a pass.
///
/// # Errors
/// ValueError for a time limit that is not finite or negative.
fn pass_options(cubic_success: bool, time_limit_s: Option<f64>) -> PyResult<PassOptions> {
    let limit = |seconds: f64| {
        let rule = || PyValueError::new_err(format!("time_limit_s = {seconds}: must be finite and not negative"));
        Duration::try_from_secs_f64(seconds).map_err(|_| rule())
    };
    Ok(PassOptions {
        success: if cubic_success { Order::Cubic } else { Order::Linear },
        time_limit: time_limit_s.map(limit).transpose()?,
    })
}

impl SolvedSpace {
    /// Does work with the tables, on a pool.
    fn with_tables<R: Send>(
        &self,
        py: Python<'_>,
        threads: Option<usize>,
        work: impl FnOnce(SpaceExecutor<'_>) -> ppvi::Result<R> + Send,
    ) -> PyResult<R> {
        let values = self.values.bind(py).readonly();
        let policy = self.policy.bind(py).readonly();
        let success = self.success.bind(py).readonly();
        let tables = SpaceView {
            values: contiguous("values", &values)?,
            policy: contiguous("policy", &policy)?,
            success: contiguous("success", &success)?,
        };
        run(py, threads, || work(SpaceExecutor::new(&self.problem, tables)?))
    }
}

#[pymethods]
impl SolvedSpace {
    /// Cost-to-go.
    #[getter]
    fn values(&self, py: Python<'_>) -> Py<PyArray4<f32>> {
        self.values.clone_ref(py)
    }

    /// Best action: roll angles in order, then the straight step.
    #[getter]
    fn policy(&self, py: Python<'_>) -> Py<PyArray4<u8>> {
        self.policy.clone_ref(py)
    }

    /// Probability of success, in units of 1 / 65535.
    #[getter]
    fn success(&self, py: Python<'_>) -> Py<PyArray4<u16>> {
        self.success.clone_ref(py)
    }

    /// Status, first finished slice, number of backups and seconds.
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        described(py, self.report)
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
        let answers = self.with_tables(py, threads, |executor| executor.look_up_many(&starts))?;
        let dict = PyDict::new(py);
        dict.set_item("action", PyArray1::from_iter(py, answers.iter().map(|answer| answer.action as u8)))?;
        dict.set_item("value", PyArray1::from_iter(py, answers.iter().map(|answer| answer.value)))?;
        dict.set_item("success", PyArray1::from_iter(py, answers.iter().map(|answer| answer.success)))?;
        Ok(dict)
    }

    /// Best action and cost at each pose, `[n, 6]`, without the success, which takes most of the time of `look_up`.
    #[pyo3(signature = (poses_mm, *, threads=None))]
    fn decide<'py>(
        &self,
        py: Python<'py>,
        poses_mm: PyReadonlyArray2<'_, f64>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let starts = poses(&poses_mm)?;
        let found = self.with_tables(py, threads, |executor| executor.decide_many(&starts))?;
        let dict = PyDict::new(py);
        dict.set_item("action", PyArray1::from_iter(py, found.iter().map(|(action, _)| *action as u8)))?;
        dict.set_item("value", PyArray1::from_iter(py, found.iter().map(|(_, value)| *value)))?;
        Ok(dict)
    }

    /// Independent numbers whose mean is the success from a pose, `[1, 6]`.
    #[pyo3(signature = (pose_mm, *, runs, seed, threads=None))]
    fn estimate<'py>(
        &self,
        py: Python<'py>,
        pose_mm: PyReadonlyArray2<'_, f64>,
        runs: usize,
        seed: u64,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let start = one_pose(&pose_mm)?;
        let numbers = self.with_tables(py, threads, |executor| executor.estimate(start, runs, seed))?;
        Ok(PyArray1::from_vec(py, numbers))
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
        let start = one_pose(&pose_mm)?;
        let runs = self.with_tables(py, threads, |executor| executor.rollout(start, runs, seed))?;
        rollout_arrays(py, &runs)
    }

    /// Outcomes of an execution from each pose, `[n, 6]`, with the noise of the first runs of a rollout, where the plan is
    /// wrong as `truths`, `[n, 14]`, say: the rows of a rigid motion from believed to true positions, the relative curvature,
    /// and the length behind the tip, mm, whose tip noise is not known.
    /// `anatomy` has the voxels of the true anatomy in the same frame, if they are not those of the plan.
    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (poses_mm, truths, *, center_mm, seed, anatomy=None, threads=None))]
    fn true_outcomes<'py>(
        &self,
        py: Python<'py>,
        poses_mm: PyReadonlyArray2<'_, f64>,
        truths: PyReadonlyArray2<'_, f64>,
        center_mm: [f64; 3],
        seed: u64,
        anatomy: Option<&Space>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray1<u8>>> {
        let (starts, truths) = (poses(&poses_mm)?, space_truths(&truths)?);
        let anatomy = anatomy.map(|space| &space.problem.setup().volume);
        let work = |executor: SpaceExecutor<'_>| executor.rollout_in(&starts, &truths, center_mm, anatomy, seed);
        let runs = self.with_tables(py, threads, work)?;
        Ok(PyArray1::from_iter(py, runs.iter().map(|run| run.event as u8)))
    }

    /// Executions from each pose, `[n, 6]`, with their points: without noise, or with that of the first runs of a rollout.
    #[pyo3(signature = (poses_mm, *, seed=None, threads=None))]
    fn paths<'py>(
        &self,
        py: Python<'py>,
        poses_mm: PyReadonlyArray2<'_, f64>,
        seed: Option<u64>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let starts = poses(&poses_mm)?;
        let paths = self.with_tables(py, threads, |executor| executor.paths(&starts, seed))?;
        path_arrays(py, &paths)
    }
}
