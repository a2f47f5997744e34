//! Areas and executions, from Python and to it.

use needle::{Area, Event, Execution};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Rings of vertices, mm.
pub(crate) type Rings = Vec<Vec<[f64; 2]>>;

/// Largest limit on the steps of an execution: a path stores all its poses.
const MOST_STEPS: u32 = 10_000_000;

/// The area of rings of vertices and all points within `reach` of them; a ring of one vertex is a disc, one of two a
/// capsule.
pub(crate) fn area((rings, reach): (Rings, f64)) -> ppvi::Result<Area> {
    match rings.first().map(Vec::as_slice) {
        Some([centre]) => Area::disc(*centre, reach),
        Some([a, b]) => Area::capsule(*a, *b, reach),
        _ => Area::rings(rings)?.with_margin(reach),
    }
}

pub(crate) fn execution(greedy: bool) -> Execution {
    if greedy { Execution::Greedy } else { Execution::Nearest }
}

/// Outcome codes of executions: those of events, and 4 for the limit on steps.
pub(crate) fn ending(event: Option<Event>) -> u8 {
    event.map_or(4, |event| event as u8)
}

/// # Errors
/// ValueError for a limit on steps above [`MOST_STEPS`].
pub(crate) fn check_steps(max_steps: u32) -> PyResult<()> {
    if max_steps <= MOST_STEPS {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("max_steps = {max_steps}: must be at most {MOST_STEPS}")))
}
