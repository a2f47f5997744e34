//! The class `Tabular`: any finite MDP in compressed sparse rows.

use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use ppvi::{
    Dependencies, Error, Evaluation, Mdp, Partition, PrioritizedOptions, StateDependents, TabularMdp, is_small,
    policy_iteration, prioritized, tabular_sweep, value_iteration,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{contiguous, elements};
use crate::solve::{report_dict, stop_rule};
use crate::work::{exception, run, watch, watch_here};

/// A problem with its own copies of the arrays, since Python may change those that it gave.
#[pyclass(frozen, module = "needleplan._ppvi")]
pub(crate) struct Tabular {
    mdp: TabularMdp<'static>,
}

/// Offsets as unsigned integers. A negative offset becomes a very large one, which the validation refuses.
fn offsets<'a>(name: &str, array: &'a PyReadonlyArray1<'_, i64>) -> PyResult<&'a [usize]> {
    let cast = bytemuck::try_cast_slice(contiguous(name, array)?);
    cast.map_err(|_| PyValueError::new_err(format!("{name}: 64-bit offsets need a 64-bit machine")))
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
        let action_offsets = offsets("action_offsets", &action_offsets)?;
        let row_offsets = offsets("row_offsets", &row_offsets)?;
        let successors = contiguous("successors", &successors)?;
        let probabilities = contiguous("probabilities", &probabilities)?;
        let stage_costs = contiguous("stage_costs", &stage_costs)?;
        let mdp = run(py, None, || {
            TabularMdp::new(
                action_offsets.to_vec(),
                row_offsets.to_vec(),
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

    #[pyo3(signature = (*, method, labels=None, priority="bound", start=None, tolerance, max_sweeps=None, time_limit_s=None, threads=None, progress=None))]
    #[allow(clippy::too_many_arguments)]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        method: &str,
        labels: Option<PyReadonlyArray1<'py, u32>>,
        priority: &str,
        start: Option<PyReadonlyArray1<'py, f64>>,
        tolerance: f64,
        max_sweeps: Option<u64>,
        time_limit_s: Option<f64>,
        threads: Option<usize>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let rule = stop_rule(tolerance, max_sweeps, time_limit_s)?;
        let (mdp, labels) = (&self.mdp, labels.as_ref().map(|labels| elements("labels", labels)).transpose()?);
        let start = start.as_ref().map(|start| elements("start", start)).transpose()?;
        let solution = match method {
            "sweep" => watch(py, threads, progress, |reports| tabular_sweep(mdp, rule, Some(&mut reports.observer())))?,
            "vi" => watch(py, threads, progress, |reports| value_iteration(mdp, rule, Some(&mut reports.observer())))?,
            "ppvi" => {
                let options = PrioritizedOptions {
                    priority: priority.parse().map_err(exception)?,
                    ..PrioritizedOptions::default()
                };
                watch(py, threads, progress, |reports| {
                    let partition = partition(labels.as_deref(), mdp.states())?;
                    prioritized(mdp, &partition, options, rule, Some(&mut reports.observer()))
                })?
            }
            "auto" | "mpi" | "pi" => {
                let evaluation = match method {
                    "mpi" => Evaluation::Sweeps,
                    "pi" => Evaluation::Solve,
                    _ => Evaluation::Auto,
                };
                let start = start.as_deref();
                match is_small(mdp) {
                    true => watch_here(py, progress, |observer| {
                        policy_iteration(mdp, evaluation, start, rule, Some(observer))
                    })?,
                    false => watch(py, threads, progress, |reports| {
                        policy_iteration(mdp, evaluation, start, rule, Some(&mut reports.observer()))
                    })?,
                }
            }
            other => {
                let message = format!("method = {other:?}: is not a method");
                return Err(PyValueError::new_err(message));
            }
        };
        let dict = report_dict(py, solution.report, mdp.states())?;
        dict.set_item("values", solution.values.into_pyarray(py))?;
        dict.set_item("policy", solution.policy.into_pyarray(py))?;
        Ok(dict)
    }

    /// The Q-value of every row, with `discount` in place of that of the problem.
    fn q_values<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'py, f64>,
        discount: f64,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let (mdp, values) = (&self.mdp, elements("values", &values)?);
        let q = run(py, None, || {
            if values.len() != mdp.states() {
                return Err(Error::Length { name: "values", expected: mdp.states(), found: values.len() });
            }
            let q = |row: usize| {
                let (successors, probabilities, cost) = mdp.row(row);
                let entries = successors.iter().zip(probabilities).filter(|(_, p)| **p > 0.0);
                cost + discount * entries.fold(0.0, |sum, (&next, p)| sum + p * values[next as usize])
            };
            Ok((0..mdp.parts().stage_costs.len()).map(q).collect::<Vec<f64>>())
        })?;
        Ok(q.into_pyarray(py))
    }

    /// Offsets, successors and probabilities of the rows, as the constructor takes them.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (parts, dict) = (self.mdp.parts(), PyDict::new(py));
        let offsets = |offsets: &[usize]| offsets.iter().map(|&offset| offset as i64).collect::<Vec<_>>();
        dict.set_item("row_offsets", offsets(parts.row_offsets).into_pyarray(py))?;
        dict.set_item("successors", parts.successors.to_vec().into_pyarray(py))?;
        dict.set_item("probabilities", parts.probabilities.to_vec().into_pyarray(py))?;
        Ok(dict)
    }

    /// The problem with another discount.
    fn with_discount(&self, py: Python<'_>, discount: f64) -> PyResult<Tabular> {
        Ok(Tabular { mdp: run(py, None, || self.mdp.with_discount(discount))? })
    }

    /// The problem with the actions of a policy only, given as positions among the rows of the states.
    fn under_policy(&self, py: Python<'_>, policy: PyReadonlyArray1<'_, u32>) -> PyResult<Tabular> {
        let policy = elements("policy", &policy)?;
        Ok(Tabular { mdp: run(py, None, || self.mdp.under_policy(&policy))? })
    }

    /// The maps of Table 6.1 of the thesis, in compressed rows: SDS by state, PDP by partition, and SDP by pair of PDP.
    #[pyo3(signature = (labels))]
    fn dependencies<'py>(&self, py: Python<'py>, labels: PyReadonlyArray1<'py, u32>) -> PyResult<Bound<'py, PyDict>> {
        let labels = elements("labels", &labels)?;
        let maps = run(py, None, || {
            let partition = partition(Some(&labels), self.mdp.states())?;
            let (states, maps) = (StateDependents::new(&self.mdp), Dependencies::new(&self.mdp, &partition));
            let (mut sds_offsets, mut sds) = (vec![0i64], Vec::new());
            for state in 0..states.states() {
                sds.extend_from_slice(states.sds(state));
                sds_offsets.push(sds.len() as i64);
            }
            let (mut pdp_offsets, mut pdp, mut sdp_offsets, mut sdp) = (vec![0i64], Vec::new(), vec![0i64], Vec::new());
            for p in 0..partition.count() {
                for pair in maps.pairs(p) {
                    pdp.push(maps.dependent(pair) as u32);
                    sdp.extend_from_slice(maps.states(pair));
                    sdp_offsets.push(sdp.len() as i64);
                }
                pdp_offsets.push(pdp.len() as i64);
            }
            Ok((sds_offsets, sds, pdp_offsets, pdp, sdp_offsets, sdp))
        })?;
        let (sds_offsets, sds, pdp_offsets, pdp, sdp_offsets, sdp) = maps;
        let dict = PyDict::new(py);
        dict.set_item("sds_offsets", sds_offsets.into_pyarray(py))?;
        dict.set_item("sds", sds.into_pyarray(py))?;
        dict.set_item("pdp_offsets", pdp_offsets.into_pyarray(py))?;
        dict.set_item("pdp", pdp.into_pyarray(py))?;
        dict.set_item("sdp_offsets", sdp_offsets.into_pyarray(py))?;
        dict.set_item("sdp", sdp.into_pyarray(py))?;
        Ok(dict)
    }
}

/// Makes a partition from one label per state. Without labels all states are in one partition.
///
/// # Errors
/// [`Error::Length`] unless there is one label per state; [`Error::Parameter`] for a label that is not below the number of
/// states, because the memory grows with the largest label.
fn partition(labels: Option<&[u32]>, states: usize) -> ppvi::Result<Partition> {
    let Some(labels) = labels else {
        return Partition::whole(states);
    };
    if labels.len() != states {
        return Err(Error::Length { name: "labels", expected: states, found: labels.len() });
    }
    let partitions = labels.iter().max().map_or(1, |label| *label as usize + 1);
    if partitions > states.max(1) {
        return Err(Error::parameter("labels", partitions - 1, "must be less than the number of states"));
    }
    Partition::from_labels(labels.to_vec(), partitions)
}
