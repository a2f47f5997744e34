//! One number for every state, in the order in which whole-lattice passes are fast.

use rayon::prelude::*;

use crate::lattice::plane::{Plane, copy};
use crate::lattice::{Shape, real::Real};
use crate::memory::{Array, filled};

/// `[i][heading][bevel][j]`, j contiguous. Tables, the public layout, are `[i][j][heading][bevel]`.
#[derive(Debug)]
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

impl<T: Real> Field<T> {
    /// As a table in single precision.
    pub(crate) fn table(&self) -> Vec<f32> {
        let mut table = filled(0f32, self.values.len());
        let size = self.shape.ny * self.shape.headings * 2;
        table.par_chunks_mut(size).zip(self.values.par_chunks(size)).for_each(|(table, column)| {
            column_to_table(self.shape, column, table, |value| value.widen() as f32);
        });
        table
    }

    /// The largest finite value.
    pub(crate) fn max(&self) -> f64 {
        let larger = |max: f64, value: &T| {
            let value = value.widen();
            if value > max && value < f64::INFINITY { value } else { max }
        };
        let largest = |part: &[T]| part.iter().fold(0.0, larger);
        self.values.par_chunks(1 << 14).map(largest).reduce(|| 0.0, f64::max)
    }
}

/// One grid column from `[heading][bevel][j]` to `[j][heading][bevel]`. A column fits the cache, so the plain loop is the
/// fast one.
#[inline(always)]
pub(crate) fn column_to_table<A: Copy, B>(shape: Shape, column: &[A], table: &mut [B], convert: impl Fn(A) -> B) {
    let planes = shape.headings * 2;
    for (plane, row) in column.chunks_exact(shape.ny).enumerate() {
        for (entries, value) in table.chunks_exact_mut(planes).zip(row) {
            entries[plane] = convert(*value);
        }
    }
}
