//! Values and actions on the way from a sweep to the tables.
//!
//! Values are never negative, so the sign of a staged value can hold an action: minus stands for action 1. One array
//! then serves for both. Where there is a straight action, a second array holds the values of the best action with a
//! minus for it.

use std::marker::PhantomData;

use crate::lattice::direction::Arc;
use crate::lattice::lanes::Narrow;
use crate::lattice::parts::{LANES, STRAIGHT, Shape};
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
    /// Number of headings.
    count: usize,
    turned: Plate,
    straight: Plate,
    /// The largest finite value so far, by lane.
    largest: [f32; LANES],
}

/// The rows that a backup fills, `[heading][bevel]`.
pub(crate) struct Staged<'a> {
    /// Values of the better curved step, negative if the needle turns.
    pub turned: &'a mut [[[f32; LANES]; 2]],
    /// Values of the best action, negative if that is the straight one; empty if there is none.
    pub straight: &'a mut [[[f32; LANES]; 2]],
}

/// Numbers of a strip in the order of a backup and in that of the tables.
struct Plate {
    /// `[heading][bevel]`, a multiple of four headings.
    rows: Vec<[[f32; LANES]; 2]>,
    /// `[LANES][heading][bevel]`.
    points: Vec<f32>,
}

impl Plate {
    fn new(count: usize) -> Self {
        let rows = vec![[[0.0; LANES]; 2]; count.next_multiple_of(LANES / 2)];
        let points = vec![0.0; rows.len() * 2 * LANES];
        Plate { rows, points }
    }

    /// Brings the rows into the order of the tables.
    #[inline(always)]
    fn transpose<V: Narrow>(&mut self) {
        let point = self.rows.len() * 2;
        for (number, rows) in self.rows.as_flattened().as_chunks::<LANES>().0.iter().enumerate() {
            let [a, b, c, d, e, f, g, h] = rows;
            let rows = [V::load(a), V::load(b), V::load(c), V::load(d), V::load(e), V::load(f), V::load(g), V::load(h)];
            for (point, numbers) in self.points.chunks_exact_mut(point).zip(V::transpose(rows)) {
                numbers.store(&mut point.as_chunks_mut().0[number]);
            }
        }
    }
}

impl StagingBuffer {
    /// Room for `count` headings.
    pub(crate) fn new(count: usize, has_straight: bool) -> Self {
        let straight = Plate::new(if has_straight { count } else { 0 });
        StagingBuffer { count, turned: Plate::new(count), straight, largest: [0.0; LANES] }
    }

    /// The rows to be filled.
    #[inline(always)]
    pub(crate) fn staged(&mut self) -> Staged<'_> {
        let has_straight = !self.straight.rows.is_empty();
        let straight = &mut self.straight.rows[..if has_straight { self.count } else { 0 }];
        Staged { turned: &mut self.turned.rows[..self.count], straight }
    }

    /// The largest finite value written.
    pub(crate) fn largest(&self) -> f64 {
        f64::from(self.largest.into_iter().fold(0.0, f32::max))
    }

    /// Writes the strip whose first grid point is `first` of the column at `place`.
    #[inline(always)]
    pub(crate) fn write<V: Narrow>(&mut self, part: &mut TableWriter<'_>, place: usize, first: usize) {
        let mut largest = V::load(&self.largest);
        self.turned.transpose::<V>();
        self.straight.transpose::<V>();
        let point = self.turned.rows.len() * 2;
        let Shape { ny, headings, .. } = part.shape;
        let vertical = part.arc.direction.is_vertical();
        let length = if vertical { part.shape.nx } else { ny };
        for (lane, v) in (first..length).enumerate().take(LANES) {
            let turned = &self.turned.points[lane * point..][..point];
            let (i, j) = if vertical { (v, place) } else { (place, v) };
            for run in part.arc.runs(headings) {
                let at = ((i * ny + j) * headings + run.heading) * 2;
                let kept = run.begin * 2..(run.begin + run.count) * 2;
                if self.straight.points.is_empty() {
                    part.write::<V>(&turned[kept], None, at, &mut largest);
                } else {
                    let straight = &self.straight.points[lane * point..][kept.clone()];
                    part.write::<V>(&turned[kept], Some(straight), at, &mut largest);
                }
            }
        }
        largest.store(&mut self.largest);
    }
}

impl TableWriter<'_> {
    /// Writes kept numbers of a few headings of this part from `at` on; `straight` are those of the straight action.
    #[inline(always)]
    fn write<V: Narrow>(&mut self, kept: &[f32], straight: Option<&[f32]>, at: usize, largest: &mut V) {
        let n = kept.len();
        assert!(at + n <= self.shape.states(), "within the table");
        assert!(straight.is_none_or(|straight| straight.len() == n), "one number each");
        if n < LANES {
            for (offset, number) in kept.iter().enumerate() {
                let straight = straight.map(|straight| straight[offset]);
                let (values, actions) = match straight {
                    None => V::splat(*number).split(),
                    Some(straight) => split_both(V::splat(*number), V::splat(straight)),
                };
                *largest = values.larger_finite(*largest);
                // SAFETY: within the table, and of this part.
                unsafe {
                    self.values.add(at + offset).write(straight.unwrap_or(*number).abs());
                    self.actions.add(at + offset).write(actions[0]);
                }
            }
            return;
        }
        // Whole vectors; the last one ends with the numbers, so that it may begin among those before.
        for start in (0..n).step_by(LANES).map(|start| start.min(n - LANES)) {
            let (values, actions) = match straight {
                None => load_at::<V>(kept, start).split(),
                Some(straight) => split_both(load_at::<V>(kept, start), load_at::<V>(straight, start)),
            };
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

#[inline(always)]
fn load_at<V: Narrow>(numbers: &[f32], start: usize) -> V {
    let Some(numbers) = numbers[start..].first_chunk() else { unreachable!("a whole vector") };
    V::load(numbers)
}

/// Values and actions from both arrays of staged numbers.
#[inline(always)]
fn split_both<V: Narrow>(turned: V, straight: V) -> (V, [u8; LANES]) {
    let (mut actions, (values, is_straight)) = (turned.split().1, straight.split());
    for l in 0..LANES {
        actions[l] = if is_straight[l] != 0 { STRAIGHT } else { actions[l] };
    }
    (values, actions)
}
