//! All values of a sector and their actions, on the way to the tables.

use multiversion::multiversion;

use crate::lattice::Shape;
use crate::lattice::kernel::larger_row;
use crate::lattice::plane::{Plane, copy};
use crate::lattice::real::Real;
use crate::lattice::sector::Sector;
use crate::memory::Array;

/// `[u][count][bevel][lanes]`, in the order of the sector.
pub(crate) struct Store<T: Copy> {
    values: Array<T>,
    /// Empty where a policy was given.
    actions: Array<u8>,
    /// Length of a column.
    column: usize,
}

/// A part of the tables: some grid columns from `first` on, `[i][j][heading][bevel]`.
pub(crate) struct Block<'a> {
    pub first: usize,
    pub values: &'a mut [f32],
    pub actions: &'a mut [u8],
}

impl<T: Real> Store<T> {
    pub(crate) fn new(sector: &Sector<T>) -> Self {
        let column = sector.arc.count * 2 * sector.lanes;
        let size = sector.extent[0] * column;
        let actions = Array::any(if sector.turns.is_empty() { size } else { 0 });
        Store { values: Array::any(size), actions, column }
    }

    /// Values and actions of column `u`.
    pub(crate) fn column(&mut self, u: usize) -> (&mut [T], &mut [u8]) {
        let part = u * self.column..(u + 1) * self.column;
        let noted = if self.actions.is_empty() { 0..0 } else { part.clone() };
        (&mut self.values[part], &mut self.actions[noted])
    }

    /// Copies what falls into `block` there. Returns the largest finite value.
    pub(crate) fn copy_to(&self, sector: &Sector<T>, shape: Shape, block: &mut Block<'_>) -> f64 {
        copy_columns(self, sector, shape, block)
    }
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn copy_columns<T: Real>(store: &Store<T>, sector: &Sector<T>, shape: Shape, block: &mut Block<'_>) -> f64 {
    let Shape { ny, headings, .. } = shape;
    let columns = block.values.len() / (ny * headings * 2);
    let Sector { arc, lanes, extent, .. } = *sector;
    let vertical = arc.direction.is_vertical();
    let (skipped, length) = if vertical { (block.first, columns) } else { (0, ny) };
    let mut largest = vec![T::default(); length];
    for place in if vertical { 0..ny } else { block.first..block.first + columns } {
        let u = if arc.direction.is_reversed() { extent[0] - 1 - place } else { place };
        for row in store.values[u * store.column..][..store.column].chunks_exact(lanes) {
            larger_row(&mut largest, &row[skipped..][..length]);
        }
        // From [heading][bevel][v] to [v][heading][bevel]; the headings of a sector may run over the end of the circle.
        let (start, stride) = if vertical {
            (place * headings * 2, ny * headings * 2)
        } else {
            ((place - block.first) * ny * headings * 2, headings * 2)
        };
        let before = (headings - arc.first).min(arc.count);
        for (begin, count, heading) in [(0, before, arc.first), (before, arc.count - before, 0)] {
            let from = u * store.column + begin * 2 * lanes + skipped;
            let from = Plane { start: from, stride: lanes, reversed: false };
            let to = Plane { start: start + heading * 2, stride, reversed: false };
            let size = [count * 2, length];
            copy((&store.values, from), (block.values, to), size, true, |value| value.widen() as f32);
            if !store.actions.is_empty() {
                copy((&store.actions, from), (block.actions, to), size, true, |action| action);
            }
        }
    }
    let largest = largest.iter().fold(0.0, |max, value| f64::max(max, value.widen()));
    if largest < f64::INFINITY {
        return largest;
    }
    // Rare: states from which no policy ends.
    let finite = block.values.iter().filter(|value| value.is_finite());
    finite.fold(0.0, |max, value| f64::max(max, f64::from(*value)))
}
