//! The class `Tabular`: any finite MDP in compressed sparse rows.

use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use ppvi::{
    Dependencies, Mdp, Partition, PrioritizedOptions, StateDependents, TabularMdp, prioritized, tabular_sweep,
    value_iteration,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::solve::{exception, report_dict, solve_with_progress, stop_rule};
use crate::threads::detached;

/// The arrays of a problem. They belong to NumPy and are not copied. Because Python may change them, every use
/// validates them again.
#[pyclass(frozen, module = "needleplan._ppvi")]
pub(crate) struct Tabular {
    action_offsets: Py<PyArray1<i64>>,
    row_offsets: Py<PyArray1<i64>>,
    successors: Py<PyArray1<u32>>,
    probabilities: Py<PyArray1<f64>>,
    stage_costs: Py<PyArray1<f64>>,
    discount: f64,
}

/// Offsets as unsigned integers. A negative offset becomes a very large one, which the validation refuses.
fn offsets<'a>(name: &str, array: &'a PyReadonlyArray1<'_, i64>) -> PyResult<&'a [usize]> {
    let cast = bytemuck::try_cast_slice(array.as_slice()?);
    cast.map_err(|_| PyValueError::new_err(format!("{name}: 64-bit offsets need a 64-bit machine")))
}

impl Tabular {
    /// Locks the arrays against writing, validates them, and calls `use_it` with the problem.
    fn lend<R>(&self, py: Python<'_>, use_it: impl FnOnce(Python<'_>, &TabularMdp<'_>) -> PyResult<R>) -> PyResult<R> {
        fn lock<'py, T: numpy::Element>(
            array: &Py<PyArray1<T>>,
            py: Python<'py>,
        ) -> PyResult<PyReadonlyArray1<'py, T>> {
            use numpy::PyArrayMethods;
            array.bind(py).try_readonly().map_err(|error| PyValueError::new_err(error.to_string()))
        }
        let action_offsets = lock(&self.action_offsets, py)?;
        let row_offsets = lock(&self.row_offsets, py)?;
        let successors = lock(&self.successors, py)?;
        let probabilities = lock(&self.probabilities, py)?;
        let stage_costs = lock(&self.stage_costs, py)?;
        let (action_offsets, row_offsets) =
            (offsets("action_offsets", &action_offsets)?, offsets("row_offsets", &row_offsets)?);
        let (successors, probabilities) = (successors.as_slice()?, probabilities.as_slice()?);
        let stage_costs = stage_costs.as_slice()?;
        let discount = self.discount;
        let mdp = detached(py, None, || {
            TabularMdp::new(action_offsets, row_offsets, successors, probabilities, stage_costs, discount)
        })?
        .map_err(exception)?;
        use_it(py, &mdp)
    }
}

#[pymethods]
impl Tabular {
    #[new]
    #[pyo3(signature = (*, action_offsets, row_offsets, successors, probabilities, stage_costs, discount))]
    fn new(
        py: Python<'_>,
        action_offsets: Py<PyArray1<i64>>,
        row_offsets: Py<PyArray1<i64>>,
        successors: Py<PyArray1<u32>>,
        probabilities: Py<PyArray1<f64>>,
        stage_costs: Py<PyArray1<f64>>,
        discount: f64,
    ) -> PyResult<Self> {
        let problem = Tabular { action_offsets, row_offsets, successors, probabilities, stage_costs, discount };
        problem.lend(py, |_, _| Ok(()))?;
        Ok(problem)
    }

    #[getter]
    fn states(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.action_offsets.bind(py).len()?.saturating_sub(1))
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
        let (solution, states) = self.lend(py, |py, mdp| {
            let solution = match method {
                "sweep" => {
                    solve_with_progress(py, threads, progress, |observer| tabular_sweep(mdp, rule, Some(observer)))?
                }
                "vi" => {
                    solve_with_progress(py, threads, progress, |observer| value_iteration(mdp, rule, Some(observer)))?
                }
                "ppvi" => {
                    let partition = partition(labels.as_ref(), mdp.states())?;
                    let options = PrioritizedOptions {
                        priority: priority.parse().map_err(exception)?,
                        ..PrioritizedOptions::default()
                    };
                    solve_with_progress(py, threads, progress, |observer| {
                        prioritized(mdp, &partition, options, rule, Some(observer))
                    })?
                }
                other => {
                    let message = format!("method = {other:?}: must be \"sweep\", \"ppvi\" or \"vi\"");
                    return Err(PyValueError::new_err(message));
                }
            };
            Ok((solution, mdp.states()))
        })?;
        let dict = report_dict(py, solution.report, states)?;
        dict.set_item("values", solution.values.into_pyarray(py))?;
        dict.set_item("policy", solution.policy.into_pyarray(py))?;
        Ok(dict)
    }

    /// The maps of Table 6.1 of the thesis, in compressed rows: SDS by state, PDP by partition, and SDP by pair of PDP.
    #[pyo3(signature = (labels))]
    fn dependencies<'py>(&self, py: Python<'py>, labels: PyReadonlyArray1<'py, u32>) -> PyResult<Bound<'py, PyDict>> {
        let (states, partitions, maps) = self.lend(py, |py, mdp| {
            let partition = partition(Some(&labels), mdp.states())?;
            detached(py, None, || (StateDependents::new(mdp), partition.count(), Dependencies::new(mdp, &partition)))
        })?;
        let dict = PyDict::new(py);
        let (mut sds_offsets, mut sds) = (vec![0i64], Vec::new());
        for state in 0..states.states() {
            sds.extend_from_slice(states.sds(state));
            sds_offsets.push(sds.len() as i64);
        }
        let (mut pdp_offsets, mut pdp, mut sdp_offsets, mut sdp) = (vec![0i64], Vec::new(), vec![0i64], Vec::new());
        for p in 0..partitions {
            for pair in maps.pairs(p) {
                pdp.push(maps.dependent(pair) as u32);
                sdp.extend_from_slice(maps.states(pair));
                sdp_offsets.push(sdp.len() as i64);
            }
            pdp_offsets.push(pdp.len() as i64);
        }
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
fn partition(labels: Option<&PyReadonlyArray1<'_, u32>>, states: usize) -> PyResult<Partition> {
    let Some(labels) = labels else {
        return Partition::whole(states).map_err(exception);
    };
    let labels = labels.as_slice()?;
    let partitions = labels.iter().max().map_or(1, |label| *label as usize + 1);
    Partition::from_labels(labels.to_vec(), partitions).map_err(exception)
}
