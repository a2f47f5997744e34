//! The Python binding: arrays in, arrays out. Everything it calls is an ordinary function of `ppvi` or `needle`.

mod arrays;
mod bristle;
mod lattice;
mod lookup;
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
    module.add_function(wrap_pyfunction!(bristle::slid, module)?)?;
    module.add_function(wrap_pyfunction!(bristle::yielding, module)?)?;
    module.add_function(wrap_pyfunction!(bristle::dragged, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}
