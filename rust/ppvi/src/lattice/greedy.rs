//! The policy of executions between the grid points of a table: one look ahead with its values.
//!
//! An execution takes the action with the least cost of its step and of the interpolated table at its end. On a finer
//! lattice of the same problem this is one backup of the interpolated table.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::lattice::engine::Engine;
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::Shape;
use crate::lattice::sweep::planning_costs;
use crate::memory::filled;
use crate::stop::StopFlag;

/// The better actions at all states if the costs at the ends of steps are `values`, in table layout.
///
/// # Errors
/// [`Error::Length`] for a table of another size.
pub fn greedy(lattice: &LatticeMdp, values: &[f32]) -> Result<Vec<u8>> {
    let expected = lattice.parts.shape.states();
    if values.len() != expected {
        return Err(Error::Length { name: "values", expected, found: values.len() });
    }
    let costs = planning_costs(lattice);
    let mut engine = Engine::<f32>::new(lattice, &lattice.terminal_masks, &costs, 0.0, None, true);
    Ok(engine.greedy(values))
}

/// A table on a grid that is `times` finer along x and y, interpolated linearly between grid points. `from` and `to` are the
/// shapes of the grids.
///
/// # Errors
/// [`Error::Length`] for a table of another size, [`Error::Parameter`] for shapes of which the one does not cover the other
/// or with other headings.
pub fn refined(values: &[f32], from: Shape, to: Shape, times: usize) -> Result<Vec<f32>> {
    if values.len() != from.states() {
        return Err(Error::Length { name: "values", expected: from.states(), found: values.len() });
    }
    let covers = |points: usize, finer: usize| (points - 1) * times + 1 >= finer;
    if times == 0 || from.headings != to.headings || !covers(from.nx, to.nx) || !covers(from.ny, to.ny) {
        return Err(Error::parameter("times", times, "must lead from the one grid to the other"));
    }
    let point = from.headings * 2;
    let place = |at: usize, points: usize| {
        let low = (at / times).min(points - 1);
        ([low, (low + 1).min(points - 1)], (at % times) as f32 / times as f32)
    };
    let stop = StopFlag::current();
    let mut finer = filled(0.0f32, to.states());
    finer.par_chunks_exact_mut(to.ny * point).enumerate().for_each(|(i, column)| {
        stop.check();
        let (columns, f) = place(i, from.nx);
        for (j, row) in column.chunks_exact_mut(point).enumerate() {
            let (rows, g) = place(j, from.ny);
            for (i, wu) in columns.into_iter().zip([1.0 - f, f]) {
                for (j, wv) in rows.into_iter().zip([1.0 - g, g]) {
                    // Zero times an infinite value is no number.
                    if wu * wv > 0.0 {
                        let values = &values[(i * from.ny + j) * point..][..point];
                        row.iter_mut().zip(values).for_each(|(to, value)| *to += wu * wv * value);
                    }
                }
            }
        }
    });
    Ok(finer)
}
