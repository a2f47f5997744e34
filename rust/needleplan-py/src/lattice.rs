//! The class `Lattice`: a steering problem, its solvers, evaluations of its policies, and executions.

use std::borrow::Cow;

use needle::{Area, Bicycle, Clearance, Execution, Executor, Setup, SteeringProblem, Straight, Tissues, Workspace};
use numpy::ndarray::Array4;
use numpy::{
    IntoPyArray, PyArray1, PyArray4, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray4, PyUntypedArrayMethods,
};
use ppvi::lattice::evaluation::{self, Evaluation, OptimalValues};
use ppvi::lattice::{Costs, LatticeMdp, Motion, Shape, Transition, greedy, refined, sweep};
use ppvi::{Mdp, Order, PrioritizedOptions, Priority, StopRule, Storage, TabularMdp, prioritized, value_iteration};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{self, elements};
use crate::lookup::{FEW, Looked};
use crate::runs::{Rings, area, check_steps, ending, execution};
use crate::solve::{in_parts, narrow, report_dict, stop_rule};
use crate::work::{at_once, exception, run, watch};

/// The steering problem of a needle on a regular grid.
#[pyclass(frozen, module = "needleplan._ppvi")]
pub(crate) struct Lattice {
    problem: SteeringProblem,
}

impl Lattice {
    fn lattice(&self) -> &LatticeMdp {
        self.problem.lattice()
    }

    /// Makes an array `[nx, ny, headings, 2]` from the elements of a table.
    fn table<'py, T: numpy::Element>(&self, py: Python<'py>, values: Vec<T>) -> PyResult<Bound<'py, PyArray4<T>>> {
        let Shape { nx, ny, headings } = self.lattice().shape();
        let array = Array4::from_shape_vec((nx, ny, headings, 2), values);
        Ok(array.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
    }

    /// Returns the elements of a table, as [`elements`].
    ///
    /// # Errors
    /// ValueError if the table does not have the shape of the lattice or is not contiguous.
    fn slice<'a, T: numpy::Element + Copy>(
        &self,
        name: &str,
        table: &'a PyReadonlyArray4<'_, T>,
    ) -> PyResult<Cow<'a, [T]>> {
        let Shape { nx, ny, headings } = self.lattice().shape();
        if table.shape() != [nx, ny, headings, 2] {
            return Err(PyValueError::new_err(format!(
                "{name}: expected shape [{nx}, {ny}, {headings}, 2], found {:?}",
                table.shape()
            )));
        }
        elements(name, table)
    }

    fn evaluation<'py>(&self, py: Python<'py>, name: &str, evaluation: Evaluation) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        dict.set_item(name, self.table(py, evaluation.values)?)?;
        dict.set_item("residual", evaluation.change)?;
        dict.set_item("converged", evaluation.converged)?;
        Ok(dict)
    }
}

#[pymethods]
impl Lattice {
    #[new]
    #[pyo3(signature = (*, width_mm, height_mm, spacing_mm, obstacles, target_center_mm, target_radius_mm, curvature_radius_mm,
        headings, tip_noise, arc_samples, interpolated, insertion_per_mm, rotation, collision, exit, discount,
        layers=Vec::new(), tissues=Vec::new(), step_mm=None, tip_noise_step_rad=None,
        clearance_mm=0.0, clearance_per_mm=0.0, straight=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        width_mm: f64,
        height_mm: f64,
        spacing_mm: [f64; 2],
        obstacles: Vec<(Rings, f64)>,
        target_center_mm: [f64; 2],
        target_radius_mm: f64,
        curvature_radius_mm: f64,
        headings: usize,
        tip_noise: Vec<f64>,
        arc_samples: usize,
        interpolated: bool,
        insertion_per_mm: f64,
        rotation: f64,
        collision: f64,
        exit: f64,
        discount: f64,
        layers: Vec<(f64, f64)>,
        tissues: Vec<(Rings, f64, f64)>,
        step_mm: Option<f64>,
        tip_noise_step_rad: Option<f64>,
        clearance_mm: f64,
        clearance_per_mm: f64,
        straight: Option<(f64, f64)>,
    ) -> PyResult<Self> {
        let problem = run(py, None, || {
            let obstacles: Vec<Area> = obstacles.into_iter().map(area).collect::<ppvi::Result<_>>()?;
            let clearance = Clearance::new(&obstacles, clearance_mm, clearance_per_mm)?;
            let workspace = Workspace::new([width_mm, height_mm], obstacles, target_center_mm, target_radius_mm)?;
            let mut needle = Bicycle::new(curvature_radius_mm, headings)?;
            if let Some(length) = step_mm {
                needle = needle.with_step(length)?;
            }
            let costs = Costs { step: insertion_per_mm * needle.step_length(), rotation, collision, exit, discount };
            let transition = if interpolated { Transition::Interpolated } else { Transition::Nearest };
            let region = |(rings, reach, radius)| Ok((area((rings, reach))?, radius));
            let regions = tissues.into_iter().map(region).collect::<ppvi::Result<_>>()?;
            let (noise, tissues) = (tip_noise, Tissues::new(layers, regions)?);
            let (spacing, noise_step) = (spacing_mm, tip_noise_step_rad);
            SteeringProblem::new(Setup {
                workspace,
                needle,
                spacing,
                noise,
                noise_step,
                arc_samples,
                transition,
                costs,
                tissues,
                clearance,
                straight: straight.map(|(curvature_share, cost_per_mm)| Straight { curvature_share, cost_per_mm }),
            })
        })?;
        Ok(Lattice { problem })
    }

    #[getter]
    fn shape(&self) -> (usize, usize, usize, usize) {
        let Shape { nx, ny, headings } = self.lattice().shape();
        (nx, ny, headings, 2)
    }

    #[getter]
    fn step_mm(&self) -> f64 {
        self.problem.setup().needle.step_length()
    }

    #[pyo3(signature = (*, method, partitions, priority, tolerance, max_sweeps=None, time_limit_s=None, threads=None, progress=None))]
    #[allow(clippy::too_many_arguments)]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        method: &str,
        partitions: [usize; 2],
        priority: &str,
        tolerance: f64,
        max_sweeps: Option<u64>,
        time_limit_s: Option<f64>,
        threads: Option<usize>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        // The table is in single precision.
        let rule = StopRule { storage: Storage::Single, ..stop_rule(tolerance, max_sweeps, time_limit_s)? };
        let lattice = self.lattice();
        let (values, policy, report) = match method {
            "sweep" => watch(py, threads, progress, |reports| {
                sweep::solve(lattice, rule, Some(&mut reports.observer())).map(in_parts)
            })?,
            "ppvi" if priority == Priority::Bound.name() => watch(py, threads, progress, |reports| {
                sweep::prioritized(lattice, partitions, rule, Some(&mut reports.observer())).map(in_parts)
            })?,
            "vi" => watch(py, threads, progress, |reports| {
                value_iteration(lattice, rule, Some(&mut reports.observer())).map(narrow)
            })?,
            "ppvi" => {
                let priority = priority.parse().map_err(exception)?;
                let options = PrioritizedOptions { priority, ..PrioritizedOptions::default() };
                watch(py, threads, progress, |reports| {
                    let partition = lattice.partition(partitions)?;
                    prioritized(lattice, &partition, options, rule, Some(&mut reports.observer())).map(narrow)
                })?
            }
            other => {
                return Err(PyValueError::new_err(format!(
                    "method = {other:?}: must be \"sweep\", \"ppvi\" or \"vi\""
                )));
            }
        };
        let dict = report_dict(py, report, lattice.states())?;
        dict.set_item("values", self.table(py, values)?)?;
        dict.set_item("policy", self.table(py, policy)?)?;
        Ok(dict)
    }

    /// Probability of reaching the target under a policy, with cubic or linear interpolation. Values and residual of its
    /// solve make this faster.
    #[pyo3(signature = (policy, *, values=None, residual=f64::INFINITY, cubic=true, bound=true, threads=None))]
    #[allow(clippy::too_many_arguments)]
    fn success<'py>(
        &self,
        py: Python<'py>,
        policy: PyReadonlyArray4<'py, u8>,
        values: Option<PyReadonlyArray4<'py, f32>>,
        residual: f64,
        cubic: bool,
        bound: bool,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let policy = self.slice("policy", &policy)?;
        let order = if cubic { Order::Cubic } else { Order::Linear };
        let values = values.as_ref().map(|values| self.slice("values", values)).transpose()?;
        let optimal = values.as_ref().map(|values| OptimalValues { values, residual });
        let (result, error_bound) = run(py, threads, || {
            let success = evaluation::success_from(self.lattice(), &policy, order, optimal)?;
            let bound =
                if bound { evaluation::success_error(self.lattice(), &policy, order, &success, optimal)? } else { 1.0 };
            Ok((success, bound))
        })?;
        let dict = self.evaluation(py, "success", result)?;
        dict.set_item("error_bound", error_bound)?;
        Ok(dict)
    }

    /// The policy of executions of a table on this grid, which is `times` finer than that of the table.
    #[pyo3(signature = (values, times, threads=None))]
    fn executed_policy<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray4<'py, f32>,
        times: usize,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray4<u8>>> {
        let &[nx, ny, headings, _] = values.shape() else { unreachable!("four axes") };
        let (from, values) = (Shape { nx, ny, headings }, elements("values", &values)?);
        let policy =
            run(py, threads, || greedy(self.lattice(), &refined(&values, from, self.lattice().shape(), times)?))?;
        self.table(py, policy)
    }

    /// Expected length and number of rotations of a policy; infinite where the policy may not end.
    #[pyo3(signature = (policy, threads=None))]
    fn expectations<'py>(
        &self,
        py: Python<'py>,
        policy: PyReadonlyArray4<'py, u8>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let policy = self.slice("policy", &policy)?;
        let expected = run(py, threads, || evaluation::expectations(self.lattice(), &policy))?;
        let dict = PyDict::new(py);
        dict.set_item("length_mm", self.table(py, expected.length)?)?;
        dict.set_item("turns", self.table(py, expected.turns)?)?;
        dict.set_item("converged", expected.converged)?;
        Ok(dict)
    }

    /// Event code at each point [n, 2] of the plane, in mm: 0 none, 1 target, 2 collision, 3 exit.
    fn events<'py>(&self, py: Python<'py>, points: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray1<u8>>> {
        if points.shape()[1] != 2 {
            return Err(PyValueError::new_err(format!("points: expected shape [n, 2], found {:?}", points.shape())));
        }
        let (rows, _) = points.as_slice()?.as_chunks::<2>();
        let workspace = &self.problem.setup().workspace;
        Ok(PyArray1::from_iter(py, rows.iter().map(|point| workspace.event(*point).map_or(0, |event| event as u8))))
    }

    /// Outcome code of the step that arrives with the bevel of the state, for every state.
    fn outcomes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray4<u8>>> {
        let outcomes = run(py, None, || Ok(self.lattice().outcome_table(Motion::Curved)))?;
        self.table(py, outcomes)
    }

    /// Executions in the continuous model. `truths`: turn, shift along x, y and z, relative curvature, and length
    /// behind the tip for each start.
    #[pyo3(signature = (policy, values, starts, *, runs, seed, greedy=false, arc_samples=None, noise=true, max_steps, truths=None, threads=None))]
    #[allow(clippy::too_many_arguments)]
    fn rollout<'py>(
        &self,
        py: Python<'py>,
        policy: PyReadonlyArray4<'py, u8>,
        values: PyReadonlyArray4<'py, f32>,
        starts: PyReadonlyArray2<'py, f64>,
        runs: usize,
        seed: u64,
        greedy: bool,
        arc_samples: Option<usize>,
        noise: bool,
        max_steps: u32,
        truths: Option<PyReadonlyArray2<'py, f64>>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (policy, values) = (self.slice("policy", &policy)?, self.slice("values", &values)?);
        let starts = arrays::poses(&starts)?;
        let truths = truths.as_ref().map_or(Ok(vec![]), arrays::truths)?;
        check_steps(max_steps)?;
        let (outcomes, lengths, straight, turns, costs) = run(py, threads, || {
            let executor = Executor::new(&self.problem, &policy, &values, execution(greedy), arc_samples)?;
            let results = executor.rollout_in(&starts, &truths, runs, seed, noise, max_steps)?;
            let outcomes: Vec<u8> = results.iter().map(|run| ending(run.event)).collect();
            let lengths: Vec<f32> = results.iter().map(|run| run.length as f32).collect();
            let straight: Vec<f32> = results.iter().map(|run| run.straight_length as f32).collect();
            let turns: Vec<u32> = results.iter().map(|run| run.turns).collect();
            let costs: Vec<f64> = results.iter().map(|run| run.cost).collect();
            Ok((outcomes, lengths, straight, turns, costs))
        })?;
        let (dict, shape) = (PyDict::new(py), [starts.len(), runs]);
        dict.set_item("outcome", outcomes.into_pyarray(py).reshape(shape)?)?;
        dict.set_item("length_mm", lengths.into_pyarray(py).reshape(shape)?)?;
        dict.set_item("straight_mm", straight.into_pyarray(py).reshape(shape)?)?;
        dict.set_item("turns", turns.into_pyarray(py).reshape(shape)?)?;
        dict.set_item("cost", costs.into_pyarray(py).reshape(shape)?)?;
        Ok(dict)
    }

    /// Actions, costs and success probabilities at exact poses, by a look one step ahead.
    #[pyo3(signature = (policy, values, success, poses, threads=None))]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        policy: PyReadonlyArray4<'py, u8>,
        values: PyReadonlyArray4<'py, f32>,
        success: PyReadonlyArray4<'py, f32>,
        poses: PyReadonlyArray2<'py, f64>,
        threads: Option<usize>,
    ) -> PyResult<Looked<'py>> {
        let rows = arrays::poses(&poses)?;
        let predict = |policy: &[u8], values: &[f32], success: &[f32]| {
            Executor::new(&self.problem, policy, values, Execution::Greedy, None)?.predict(&rows, success)
        };
        let (policy, values) = (self.slice("policy", &policy)?, self.slice("values", &values)?);
        let success = self.slice("success", &success)?;
        let answers = if rows.len() <= FEW {
            at_once(|| predict(&policy, &values, &success))?
        } else {
            run(py, threads, || predict(&policy, &values, &success))?
        };
        Ok((answers.actions.into_pyarray(py), answers.values.into_pyarray(py), answers.success.into_pyarray(py)))
    }

    /// One execution in the continuous model, with all its poses.
    #[pyo3(signature = (policy, values, start, *, greedy=false, noise=false, seed=0, arc_samples=None, max_steps))]
    #[allow(clippy::too_many_arguments)]
    fn path<'py>(
        &self,
        py: Python<'py>,
        policy: PyReadonlyArray4<'py, u8>,
        values: PyReadonlyArray4<'py, f32>,
        start: [f64; 4],
        greedy: bool,
        noise: bool,
        seed: u64,
        arc_samples: Option<usize>,
        max_steps: u32,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (policy, values) = (self.slice("policy", &policy)?, self.slice("values", &values)?);
        check_steps(max_steps)?;
        let trace = run(py, None, || {
            let executor = Executor::new(&self.problem, &policy, &values, execution(greedy), arc_samples)?;
            executor.trace(start, noise.then_some(seed), max_steps)
        })?;
        let rows: Vec<f64> = trace.poses.iter().flat_map(|pose| [pose.x, pose.y, pose.heading, pose.bevel]).collect();
        let dict = PyDict::new(py);
        dict.set_item("poses", PyArray1::from_vec(py, rows).reshape([trace.poses.len(), 4])?)?;
        dict.set_item("actions", PyArray1::from_vec(py, trace.actions))?;
        dict.set_item("outcome", ending(trace.run.event))?;
        dict.set_item("length_mm", trace.run.length)?;
        dict.set_item("straight_mm", trace.run.straight_length)?;
        dict.set_item("turns", trace.run.turns)?;
        dict.set_item("cost", trace.run.cost)?;
        Ok(dict)
    }

    /// The same MDP as explicit sparse rows.
    fn tabular<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (mdp, action_offsets, row_offsets) = run(py, None, || {
            let mdp = TabularMdp::from_mdp(self.lattice())?;
            let offsets = |offsets: &[usize]| offsets.iter().map(|offset| *offset as i64).collect::<Vec<i64>>();
            let (action_offsets, row_offsets) = (offsets(mdp.parts().action_offsets), offsets(mdp.parts().row_offsets));
            Ok((mdp, action_offsets, row_offsets))
        })?;
        let dict = PyDict::new(py);
        let parts = mdp.parts();
        dict.set_item("action_offsets", action_offsets.into_pyarray(py))?;
        dict.set_item("row_offsets", row_offsets.into_pyarray(py))?;
        dict.set_item("successors", PyArray1::from_slice(py, parts.successors))?;
        dict.set_item("probabilities", PyArray1::from_slice(py, parts.probabilities))?;
        dict.set_item("stage_costs", PyArray1::from_slice(py, parts.stage_costs))?;
        dict.set_item("discount", mdp.discount())?;
        Ok(dict)
    }
}
