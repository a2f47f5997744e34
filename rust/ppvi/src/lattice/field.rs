//! One number for every state, in the order in which whole-lattice passes are fast.

use rayon::prelude::*;

use crate::lattice::Shape;
use crate::lattice::plane::{Plane, copy};
use crate::memory::Array;

/// `[i][heading][bevel][j]`, j contiguous. Tables, the public layout, are `[i][j][heading][bevel]`.
pub(crate) struct Field<T: Copy> {
    pub shape: Shape,
    pub values: Array<T>,
}

impl<T: Copy + Default + Send + Sync> Field<T> {
    pub(crate) fn new(shape: Shape) -> Self {
        Field { shape, values: Array::filled(T::default(), shape.states()) }
    }

    /// From a table.
    pub(crate) fn of_table(shape: Shape, table: &[T]) -> Self {
        let mut field = Field::new(shape);
        let planes = shape.headings * 2;
        let columns = field.values.par_chunks_mut(shape.ny * planes).zip(table.par_chunks(shape.ny * planes));
        columns.for_each(|(column, table)| {
            let from = Plane { start: 0, stride: planes, reversed: false };
            let to = Plane { start: 0, stride: shape.ny, reversed: false };
            copy((table, from), (column, to), [shape.ny, planes], true, |value| value);
        });
        field
    }
}

impl<T: Copy> Field<T> {
    /// Where one heading and bevel stand, as a plane of rows i.
    pub(crate) fn plane(&self, k: usize, bevel: usize) -> Plane {
        let Shape { ny, headings, .. } = self.shape;
        Plane { start: (k * 2 + bevel) * ny, stride: headings * 2 * ny, reversed: false }
    }

    /// Grid points along x and y.
    pub(crate) fn extent(&self) -> [usize; 2] {
        [self.shape.nx, self.shape.ny]
    }
}
