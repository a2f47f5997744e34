//! The binding: arrays in, arrays out. Everything it calls is an ordinary function of this crate.

use std::ops::ControlFlow;
use std::time::Duration;

use numpy::ndarray::Array4;
use numpy::{
    IntoPyArray, PyArray1, PyArray4, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray4,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::bicycle::Bicycle;
use crate::lattice::evaluation::{self, Evaluation};
use crate::lattice::sweep;
use crate::lattice::{Costs, LatticeMdp, Setup, Shape, Transition};
use crate::lookup::{Table, TableGrid};
use crate::prioritized::{PrioritizedOptions, prioritized};
use crate::rollout::{Execution, Executor};
use crate::workspace::{Polygon, Workspace};
use crate::{Error, Mdp, Observer, Partition, Progress, Report, Solution, StopRule, TabularMdp, value_iteration};

impl From<Error> for PyErr {
    fn from(error: Error) -> PyErr {
        match error {
            Error::TooLarge { .. } => PyMemoryError::new_err(error.to_string()),
            _ => PyValueError::new_err(error.to_string()),
        }
    }
}

/// Runs `work` without the GIL, on `threads` threads (default: all).
fn detached<R: Send>(py: Python<'_>, threads: Option<usize>, work: impl FnOnce() -> R + Send) -> PyResult<R> {
    let Some(threads) = threads else {
        return Ok(py.detach(work));
    };
    if threads == 0 || threads > 1024 {
        return Err(PyValueError::new_err(format!("threads = {threads}: must be between 1 and 1024")));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|error| PyValueError::new_err(format!("threads = {threads}: {error}")))?;
    Ok(py.detach(|| pool.install(work)))
}

/// Calls back into Python between sweeps: signals first, then the caller's function; an exception stops the solve.
fn solve_with_progress<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
    solve: impl FnOnce(Observer<'_>) -> crate::Result<R> + Send,
) -> PyResult<R> {
    let mut raised: Option<PyErr> = None;
    let mut observe = |state: &Progress| {
        let outcome = Python::attach(|py| {
            py.check_signals()?;
            if let Some(progress) = &progress {
                progress.call1(py, (state.sweeps, state.residual, state.threshold))?;
            }
            Ok(())
        });
        match outcome {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                raised = Some(error);
                ControlFlow::Break(())
            }
        }
    };
    let solution = detached(py, threads, || solve(&mut observe))?;
    match raised {
        Some(error) => Err(error),
        None => Ok(solution?),
    }
}

fn stop_rule(tolerance: f64, max_sweeps: Option<u64>, time_limit_s: Option<f64>) -> PyResult<StopRule> {
    let mut rule = StopRule::new(tolerance)?;
    if let Some(max_sweeps) = max_sweeps {
        rule.max_sweeps = max_sweeps;
    }
    if let Some(seconds) = time_limit_s {
        let limit = Duration::try_from_secs_f64(seconds);
        rule.time_limit = Some(limit.map_err(|_| {
            PyValueError::new_err(format!("time_limit_s = {seconds}: must be finite and not negative"))
        })?);
    }
    rule.validate()?;
    Ok(rule)
}

fn report_dict<'py>(py: Python<'py>, report: Report, states: usize) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("status", report.status.name())?;
    dict.set_item("residual", report.residual)?;
    dict.set_item("error_bound", report.error_bound)?;
    dict.set_item("backups", report.backups)?;
    dict.set_item("sweeps", report.backups as f64 / states as f64)?;
    dict.set_item("partitions", report.partitions)?;
    dict.set_item("partitions_processed", report.partitions_processed)?;
    dict.set_item("order", PyArray1::from_vec(py, report.order))?;
    dict.set_item("seconds_solving", report.seconds_solving)?;
    dict.set_item("seconds_priorities", report.seconds_priorities)?;
    Ok(dict)
}

/// The needle-steering MDP on a regular grid.
#[pyclass(frozen, module = "needleplan._ppvi")]
struct Lattice {
    lattice: LatticeMdp,
}

impl Lattice {
    fn table<'py, T: numpy::Element>(&self, py: Python<'py>, values: Vec<T>) -> PyResult<Bound<'py, PyArray4<T>>> {
        let Shape { nx, ny, headings } = self.lattice.shape();
        let array = Array4::from_shape_vec((nx, ny, headings, 2), values);
        Ok(array.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
    }

    /// The elements of a table that has the lattice's shape.
    fn slice<'a, T: numpy::Element>(&self, name: &str, table: &'a PyReadonlyArray4<'_, T>) -> PyResult<&'a [T]> {
        let Shape { nx, ny, headings } = self.lattice.shape();
        if table.shape() != [nx, ny, headings, 2] {
            return Err(PyValueError::new_err(format!(
                "{name}: expected shape [{nx}, {ny}, {headings}, 2], found {:?}",
                table.shape()
            )));
        }
        Ok(table.as_slice()?)
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
    #[pyo3(signature = (*, width_mm, height_mm, spacing_mm, polygons, target_center_mm, target_radius_mm, curvature_radius_mm,
        headings, tip_noise, arc_samples, interpolated, insertion_per_mm, rotation, collision, exit, discount))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        width_mm: f64,
        height_mm: f64,
        spacing_mm: [f64; 2],
        polygons: Vec<Vec<[f64; 2]>>,
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
    ) -> PyResult<Self> {
        let obstacles = polygons.into_iter().map(Polygon::new).collect::<crate::Result<_>>()?;
        let workspace = Workspace::new([width_mm, height_mm], obstacles, target_center_mm, target_radius_mm)?;
        let needle = Bicycle::new(curvature_radius_mm, headings)?;
        let costs = Costs { step: insertion_per_mm * needle.step_length(), rotation, collision, exit, discount };
        let transition = if interpolated { Transition::Interpolated } else { Transition::Nearest };
        let setup = Setup { workspace, needle, spacing: spacing_mm, noise: tip_noise, arc_samples, transition, costs };
        Ok(Lattice { lattice: py.detach(|| LatticeMdp::new(setup))? })
    }

    #[getter]
    fn shape(&self) -> (usize, usize, usize, usize) {
        let Shape { nx, ny, headings } = self.lattice.shape();
        (nx, ny, headings, 2)
    }

    #[getter]
    fn step_mm(&self) -> f64 {
        self.lattice.setup().needle.step_length()
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
        let rule = stop_rule(tolerance, max_sweeps, time_limit_s)?;
        let lattice = &self.lattice;
        let (values, policy, report) = match method {
            "sweep" => {
                let solved =
                    solve_with_progress(py, threads, progress, |observer| sweep::solve(lattice, rule, Some(observer)))?;
                (solved.values, solved.policy, solved.report)
            }
            "vi" => narrow(solve_with_progress(py, threads, progress, |observer| {
                value_iteration(lattice, rule, Some(observer))
            })?),
            "ppvi" => {
                let options = PrioritizedOptions { priority: priority.parse()?, ..PrioritizedOptions::default() };
                narrow(solve_with_progress(py, threads, progress, |observer| {
                    prioritized(lattice, &lattice.partition(partitions)?, options, rule, Some(observer))
                })?)
            }
            other => {
                return Err(PyValueError::new_err(format!("method = {other:?}: must be \"sweep\", \"ppvi\" or \"vi\"")));
            }
        };
        let dict = report_dict(py, report, lattice.states())?;
        dict.set_item("values", self.table(py, values)?)?;
        dict.set_item("policy", self.table(py, policy)?)?;
        Ok(dict)
    }

    /// Probability of reaching the target under a policy.
    #[pyo3(signature = (policy, threads=None))]
    fn success<'py>(
        &self,
        py: Python<'py>,
        policy: PyReadonlyArray4<'py, u8>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let policy = self.slice("policy", &policy)?;
        let result = detached(py, threads, || evaluation::success(&self.lattice, policy))??;
        self.evaluation(py, "success", result)
    }

    /// Expected length and number of turns of a policy; infinite where it need not end.
    #[pyo3(signature = (policy, threads=None))]
    fn expectations<'py>(
        &self,
        py: Python<'py>,
        policy: PyReadonlyArray4<'py, u8>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let policy = self.slice("policy", &policy)?;
        let expected = detached(py, threads, || evaluation::expectations(&self.lattice, policy))??;
        let dict = PyDict::new(py);
        dict.set_item("length_mm", self.table(py, expected.length)?)?;
        dict.set_item("turns", self.table(py, expected.turns)?)?;
        dict.set_item("converged", expected.converged)?;
        Ok(dict)
    }

    /// What the step that arrives with a bevel does, for every state.
    fn outcomes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray4<u8>>> {
        let outcomes = py.detach(|| self.lattice.outcome_table());
        self.table(py, outcomes)
    }

    /// Executions in the continuous model.
    #[pyo3(signature = (policy, values, starts, *, runs, seed, greedy=false, arc_samples=None, noise=true, max_steps, threads=None))]
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
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (policy, values) = (self.slice("policy", &policy)?, self.slice("values", &values)?);
        let starts = poses(&starts)?;
        let executor = Executor::new(&self.lattice, policy, values, execution(greedy), arc_samples)?;
        let results = detached(py, threads, || executor.rollout(&starts, runs, seed, noise, max_steps))??;
        let dict = PyDict::new(py);
        let shape = [starts.len(), runs];
        dict.set_item(
            "outcome",
            PyArray1::from_vec(py, results.iter().map(|run| ending(run.event)).collect()).reshape(shape)?,
        )?;
        dict.set_item(
            "length_mm",
            PyArray1::from_vec(py, results.iter().map(|run| run.length as f32).collect()).reshape(shape)?,
        )?;
        dict.set_item("turns", PyArray1::from_vec(py, results.iter().map(|run| run.turns).collect()).reshape(shape)?)?;
        dict.set_item("cost", PyArray1::from_vec(py, results.iter().map(|run| run.cost).collect()).reshape(shape)?)?;
        Ok(dict)
    }

    /// One execution, every pose.
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
        let executor = Executor::new(&self.lattice, policy, values, execution(greedy), arc_samples)?;
        let trace = executor.trace(start, noise.then_some(seed), max_steps)?;
        let rows: Vec<f64> = trace.poses.iter().flat_map(|pose| [pose.x, pose.y, pose.heading, pose.bevel]).collect();
        let dict = PyDict::new(py);
        dict.set_item("poses", PyArray1::from_vec(py, rows).reshape([trace.poses.len(), 4])?)?;
        dict.set_item("actions", PyArray1::from_vec(py, trace.actions))?;
        dict.set_item("outcome", ending(trace.run.event))?;
        dict.set_item("length_mm", trace.run.length)?;
        dict.set_item("turns", trace.run.turns)?;
        dict.set_item("cost", trace.run.cost)?;
        Ok(dict)
    }

    /// The same MDP as explicit sparse rows.
    fn tabular<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let mdp = py.detach(|| TabularMdp::from_mdp(&self.lattice))?;
        let dict = PyDict::new(py);
        let parts = mdp.parts();
        let offsets = |offsets: &[usize]| PyArray1::from_iter(py, offsets.iter().map(|offset| *offset as i64));
        dict.set_item("action_offsets", offsets(parts.action_offsets))?;
        dict.set_item("row_offsets", offsets(parts.row_offsets))?;
        dict.set_item("successors", PyArray1::from_slice(py, parts.successors))?;
        dict.set_item("probabilities", PyArray1::from_slice(py, parts.probabilities))?;
        dict.set_item("stage_costs", PyArray1::from_slice(py, parts.stage_costs))?;
        dict.set_item("discount", mdp.discount())?;
        Ok(dict)
    }
}

fn narrow(solution: Solution) -> (Vec<f32>, Vec<u8>, Report) {
    let Solution { values, policy, mut report } = solution;
    let largest = values.iter().fold(0.0, |max, value| f64::max(max, *value));
    // The table is in single precision.
    report.error_bound += largest * f64::from(f32::EPSILON) / 2.0;
    (values.into_iter().map(|v| v as f32).collect(), policy.into_iter().map(|action| action as u8).collect(), report)
}

fn execution(greedy: bool) -> Execution {
    if greedy { Execution::Greedy } else { Execution::Nearest }
}

/// Outcome codes of executions: those of events, and 4 for the limit on steps.
fn ending(event: Option<crate::workspace::Event>) -> u8 {
    event.map_or(4, |event| event as u8)
}

fn poses(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; 4]>> {
    if array.shape()[1] != 4 {
        return Err(PyValueError::new_err(format!("poses: expected shape [n, 4], found {:?}", array.shape())));
    }
    let (rows, _) = array.as_slice()?.as_chunks::<4>();
    Ok(rows.to_vec())
}

/// Table entries of many poses.
#[pyfunction]
#[pyo3(signature = (values, policy, success, spacing_mm, poses, threads=None))]
fn lookup_many<'py>(
    py: Python<'py>,
    values: PyReadonlyArray4<'py, f32>,
    policy: PyReadonlyArray4<'py, u8>,
    success: PyReadonlyArray4<'py, f32>,
    spacing_mm: [f64; 2],
    poses: PyReadonlyArray2<'py, f64>,
    threads: Option<usize>,
) -> PyResult<(Bound<'py, PyArray1<u8>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>)> {
    let &[nx, ny, headings, 2] = values.shape() else {
        return Err(PyValueError::new_err(format!(
            "values: expected shape [nx, ny, headings, 2], found {:?}",
            values.shape()
        )));
    };
    if poses.shape()[1] != 4 {
        return Err(PyValueError::new_err(format!("poses: expected shape [n, 4], found {:?}", poses.shape())));
    }
    let grid = TableGrid::new(Shape { nx, ny, headings }, spacing_mm)?;
    let table = Table { values: values.as_slice()?, policy: policy.as_slice()?, success: success.as_slice()? };
    let (rows, _) = poses.as_slice()?.as_chunks::<4>();
    let answers = detached(py, threads, || grid.look_up_many(rows, &table))??;
    Ok((answers.actions.into_pyarray(py), answers.values.into_pyarray(py), answers.success.into_pyarray(py)))
}

/// Anybody's sparse MDP.
#[pyclass(frozen, module = "needleplan._ppvi")]
struct Tabular {
    mdp: TabularMdp<'static>,
}

#[pymethods]
impl Tabular {
    #[new]
    #[pyo3(signature = (*, action_offsets, row_offsets, successors, probabilities, stage_costs, discount))]
    fn new(
        py: Python<'_>,
        action_offsets: PyReadonlyArray1<'_, i64>,
        row_offsets: PyReadonlyArray1<'_, i64>,
        successors: PyReadonlyArray1<'_, u32>,
        probabilities: PyReadonlyArray1<'_, f64>,
        stage_costs: PyReadonlyArray1<'_, f64>,
        discount: f64,
    ) -> PyResult<Self> {
        let offsets = |name: &str, array: &PyReadonlyArray1<'_, i64>| {
            let convert = |&offset: &i64| {
                usize::try_from(offset).map_err(|_| PyValueError::new_err(format!("{name}: {offset} is negative")))
            };
            array.as_slice()?.iter().map(convert).collect::<PyResult<Vec<usize>>>()
        };
        let action_offsets = offsets("action_offsets", &action_offsets)?;
        let row_offsets = offsets("row_offsets", &row_offsets)?;
        let (successors, probabilities) = (successors.as_slice()?, probabilities.as_slice()?);
        let stage_costs = stage_costs.as_slice()?;
        let mdp = py.detach(|| {
            TabularMdp::new(
                action_offsets,
                row_offsets,
                successors.to_vec(),
                probabilities.to_vec(),
                stage_costs.to_vec(),
                discount,
            )
        })?;
        Ok(Tabular { mdp })
    }

    #[getter]
    fn states(&self) -> usize {
        self.mdp.states()
    }

    #[pyo3(signature = (*, method, labels=None, priority="bound", tolerance, max_sweeps=None, time_limit_s=None, threads=None, progress=None))]
    #[allow(clippy::too_many_arguments)]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        method: &str,
        labels: Option<PyReadonlyArray1<'py, u32>>,
        priority: &str,
        tolerance: f64,
        max_sweeps: Option<u64>,
        time_limit_s: Option<f64>,
        threads: Option<usize>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let rule = stop_rule(tolerance, max_sweeps, time_limit_s)?;
        let mdp = &self.mdp;
        let solution = match method {
            "vi" => solve_with_progress(py, threads, progress, |observer| value_iteration(mdp, rule, Some(observer)))?,
            "ppvi" => {
                let partition = match labels {
                    Some(labels) => partition_of(labels.as_slice()?)?,
                    None => Partition::whole(mdp.states())?,
                };
                let options = PrioritizedOptions { priority: priority.parse()?, ..PrioritizedOptions::default() };
                solve_with_progress(py, threads, progress, |observer| {
                    prioritized(mdp, &partition, options, rule, Some(observer))
                })?
            }
            other => {
                return Err(PyValueError::new_err(format!("method = {other:?}: must be \"sweep\", \"ppvi\" or \"vi\"")));
            }
        };
        let dict = report_dict(py, solution.report, mdp.states())?;
        dict.set_item("values", solution.values.into_pyarray(py))?;
        dict.set_item("policy", solution.policy.into_pyarray(py))?;
        Ok(dict)
    }
}

fn partition_of(labels: &[u32]) -> PyResult<Partition> {
    let partitions = labels.iter().max().map_or(1, |label| *label as usize + 1);
    Ok(Partition::from_labels(labels.to_vec(), partitions)?)
}

#[pymodule]
fn _ppvi(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Lattice>()?;
    module.add_class::<Tabular>()?;
    module.add_function(wrap_pyfunction!(lookup_many, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}
