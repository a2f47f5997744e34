//! The Python binding: arrays in, arrays out. Everything it calls is an ordinary function of `ppvi`, `needle` or
//! `needleplan_guard`.

mod arrays;
mod bristle;
mod guard;
mod lattice;
mod line;
mod lookup;
mod path_state;
mod robot;
mod robot_threads;
mod rod;
mod runs;
mod segmentation;
mod slice_file;
mod solve;
mod space;
mod space_runs;
mod tabular;
mod threads;
mod work;

use pyo3::prelude::*;

#[pymodule]
fn _ppvi(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<lattice::Lattice>()?;
    module.add_class::<tabular::Tabular>()?;
    module.add_class::<space::Space>()?;
    module.add_class::<space::SolvedSpace>()?;
    module.add_function(wrap_pyfunction!(lookup::lookup_many, module)?)?;
    module.add_function(wrap_pyfunction!(segmentation::lattice_codes, module)?)?;
    module.add_function(wrap_pyfunction!(segmentation::impossible, module)?)?;
    module.add_function(wrap_pyfunction!(rod::rod_stations, module)?)?;
    module.add_function(wrap_pyfunction!(path_state::path_moved, module)?)?;
    module.add_function(wrap_pyfunction!(path_state::path_corrected, module)?)?;
    module.add_function(wrap_pyfunction!(bristle::slid, module)?)?;
    module.add_function(wrap_pyfunction!(bristle::yielding, module)?)?;
    module.add_function(wrap_pyfunction!(bristle::dragged, module)?)?;
    module.add_class::<guard::ForceWindow>()?;
    module.add_class::<guard::RepeatedStop>()?;
    module.add_class::<guard::HeartbeatTimer>()?;
    module.add_class::<guard::DeadmanTimer>()?;
    module.add_class::<robot::RobotSupervisor>()?;
    module.add_class::<line::RobotLine>()?;
    module.add_function(wrap_pyfunction!(guard::guard_causes, module)?)?;
    module.add_function(wrap_pyfunction!(guard::guard_validated, module)?)?;
    module.add_function(wrap_pyfunction!(guard::guard_ordered, module)?)?;
    module.add_function(wrap_pyfunction!(guard::guard_against_insertion, module)?)?;
    module.add_function(wrap_pyfunction!(guard::guard_against_retraction, module)?)?;
    module.add_function(wrap_pyfunction!(guard::guard_against_rotation, module)?)?;
    module.add_function(wrap_pyfunction!(guard::guard_delay, module)?)?;
    module.add_function(wrap_pyfunction!(guard::guard_freshness, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}
