//! Values and actions on the way from a sweep to the tables.
//!
//! Values are never negative, so the sign of a staged value can hold the action: minus stands for action 1. One array
//! then serves for both.

use std::marker::PhantomData;

use crate::lattice::direction::Arc;
use crate::lattice::lanes::Narrow;
use crate::lattice::parts::{LANES, Shape};
use crate::memory::reserved;

/// Tables that are being written, `[i][j][heading][bevel]`.
pub(crate) struct Store {
    shape: Shape,
    values: Vec<f32>,
    actions: Vec<u8>,
}

impl Store {
    pub(crate) fn new(shape: Shape) -> Self {
        Store { shape, values: reserved(shape.states()), actions: reserved(shape.states()) }
    }

    /// Parts of the tables, which may be written at the same time.
    pub(crate) fn parts(&mut self, arcs: impl Iterator<Item = Arc>) -> Vec<TableWriter<'_>> {
        let (values, actions, shape) = (self.values.as_mut_ptr(), self.actions.as_mut_ptr(), self.shape);
        let mut owned = vec![false; shape.headings];
        let part = |arc: Arc| {
            for q in 0..arc.count {
                let before = std::mem::replace(&mut owned[arc.heading(q, shape.headings)], true);
                assert!(!before, "no heading has two parts");
            }
            TableWriter { arc, shape, values, actions, table: PhantomData }
        };
        arcs.map(part).collect()
    }

    /// The tables.
    ///
    /// # Safety
    ///
    /// Parts of all headings have been written at all grid points.
    pub(crate) unsafe fn finish(mut self) -> (Vec<f32>, Vec<u8>) {
        let states = self.shape.states();
        // SAFETY: so much has been reserved, and the caller says that it has been written.
        unsafe {
            self.values.set_len(states);
            self.actions.set_len(states);
        }
        (self.values, self.actions)
    }
}

/// The headings of a sector in tables.
pub(crate) struct TableWriter<'a> {
    arc: Arc,
    shape: Shape,
    values: *mut f32,
    actions: *mut u8,
    table: PhantomData<&'a mut Store>,
}

// SAFETY: parts of one table have no heading in common, so that no two write the same number; nothing is read.
unsafe impl Send for TableWriter<'_> {}

/// A strip of values and actions before it is written to the tables.
pub(crate) struct StagingBuffer {
    /// `[heading][bevel]`, a multiple of four headings.
    rows: Vec<[[f32; LANES]; 2]>,
    /// `[LANES][heading][bevel]`.
    points: Vec<f32>,
    /// The largest finite value so far, by lane.
    largest: [f32; LANES],
}

impl StagingBuffer {
    /// Room for `count` headings.
    pub(crate) fn new(count: usize) -> Self {
        let rows = vec![[[0.0; LANES]; 2]; count.next_multiple_of(LANES / 2)];
        let points = vec![0.0; rows.len() * 2 * LANES];
        StagingBuffer { rows, points, largest: [0.0; LANES] }
    }

    /// The values of the first `count` headings.
    #[inline(always)]
    pub(crate) fn rows(&mut self, count: usize) -> &mut [[[f32; LANES]; 2]] {
        &mut self.rows[..count]
    }

    /// The largest finite value written.
    pub(crate) fn largest(&self) -> f64 {
        f64::from(self.largest.into_iter().fold(0.0, f32::max))
    }

    /// Writes the strip whose first grid point is `first` of the column at `place`.
    #[inline(always)]
    pub(crate) fn write<V: Narrow>(&mut self, part: &mut TableWriter<'_>, place: usize, first: usize) {
        let point = self.rows.len() * 2;
        let mut largest = V::load(&self.largest);
        for (number, rows) in self.rows.as_flattened().as_chunks::<LANES>().0.iter().enumerate() {
            let [a, b, c, d, e, f, g, h] = rows;
            let rows = [V::load(a), V::load(b), V::load(c), V::load(d), V::load(e), V::load(f), V::load(g), V::load(h)];
            for (point, numbers) in self.points.chunks_exact_mut(point).zip(V::transpose(rows)) {
                numbers.store(&mut point.as_chunks_mut().0[number]);
            }
        }
        let Shape { ny, headings, .. } = part.shape;
        let vertical = part.arc.direction.is_vertical();
        let length = if vertical { part.shape.nx } else { ny };
        for (v, numbers) in (first..length).zip(self.points.chunks_exact(point)) {
            let (i, j) = if vertical { (v, place) } else { (place, v) };
            for run in part.arc.runs(headings) {
                let at = ((i * ny + j) * headings + run.heading) * 2;
                part.write(&numbers[run.begin * 2..][..run.count * 2], at, &mut largest);
            }
        }
        largest.store(&mut self.largest);
    }
}

impl TableWriter<'_> {
    /// Writes kept numbers of a few headings of this part from `at` on.
    #[inline(always)]
    fn write<V: Narrow>(&mut self, kept: &[f32], at: usize, largest: &mut V) {
        let n = kept.len();
        assert!(at + n <= self.shape.states(), "within the table");
        if n < LANES {
            for (offset, number) in kept.iter().enumerate() {
                let (values, actions) = V::splat(*number).split();
                *largest = values.larger_finite(*largest);
                // SAFETY: within the table, and of this part.
                unsafe {
                    self.values.add(at + offset).write(number.abs());
                    self.actions.add(at + offset).write(actions[0]);
                }
            }
            return;
        }
        // Whole vectors; the last one ends with the numbers, so that it may begin among those before.
        for start in (0..n).step_by(LANES).map(|start| start.min(n - LANES)) {
            let Some(numbers) = kept[start..].first_chunk() else { unreachable!("a whole vector") };
            let (values, actions) = V::load(numbers).split();
            *largest = values.larger_finite(*largest);
            let mut magnitudes = [0.0; LANES];
            values.store(&mut magnitudes);
            // SAFETY: within the table, and of this part; arrays are aligned as their numbers.
            unsafe {
                self.values.add(at + start).cast::<[f32; LANES]>().write(magnitudes);
                self.actions.add(at + start).cast::<[u8; LANES]>().write(actions);
            }
        }
    }
}
