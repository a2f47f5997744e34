//! Copies of the headings next to a sector, taken from their owners before the sector is swept.
//!
//! A sector never reads another one during a sweep, only its halo; that is what makes the sectors of a wave independent
//! and the result the same for any number of threads.

use crate::lattice::plane::{Plane, copy};
use crate::lattice::real::Real;
use crate::lattice::sector::Sector;
use crate::memory::Array;

/// Headings `first - reach .. first` and `first + count .. first + count + reach`, laid out as in the sector.
pub(crate) struct Halo<T: Copy> {
    reach: usize,
    lanes: usize,
    /// `[u][2 * reach][bevel][lanes]`.
    values: Array<T>,
    /// What was there before the last pull.
    before: Array<T>,
}

impl<T: Real> Halo<T> {
    /// A halo of `start` values, for noise with `reach` = taps on one side, plus one for the arc itself.
    pub(crate) fn new(sector: &Sector<T>, reach: usize, start: T, padding: T) -> Self {
        let lanes = sector.lanes;
        let mut values = Array::filled(start, sector.extent[0] * 2 * reach * 2 * lanes);
        let mut before = Array::filled(start, values.len());
        for array in [&mut values, &mut before] {
            for row in array.chunks_exact_mut(lanes) {
                row[sector.extent[1]..].fill(padding);
            }
        }
        Halo { reach, lanes, values, before }
    }

    /// The rows of some headings at column `u`, bevel after bevel.
    #[inline(always)]
    pub(crate) fn rows(&self, u: usize, headings: std::ops::Range<usize>) -> impl Iterator<Item = &[T]> {
        let column = u * 2 * self.reach;
        let part = (column + headings.start) * 2 * self.lanes..(column + headings.end) * 2 * self.lanes;
        self.values[part].chunks_exact(self.lanes)
    }

    /// Refreshes the halo of `sectors[of]` from the owners of its headings.
    pub(crate) fn pull(&mut self, sectors: &[Sector<T>], of: usize, headings: usize) {
        std::mem::swap(&mut self.values, &mut self.before);
        let target = &sectors[of];
        let reversed = target.arc.direction.is_reversed();
        for index in 0..2 * self.reach {
            let offset = if index < self.reach { index } else { index + target.arc.count };
            let heading = (target.arc.first + headings * self.reach + offset - self.reach) % headings;
            for source in sectors {
                let q = (heading + headings - source.arc.first) % headings;
                if q >= source.arc.count {
                    continue;
                }
                let transposed = target.arc.direction.is_vertical() != source.arc.direction.is_vertical();
                let reach = self.reach;
                for bevel in (0..2).filter(|bevel| is_read(reach, index, *bevel)) {
                    let stride = 2 * self.reach * 2 * self.lanes;
                    let to = Plane { start: (index * 2 + bevel) * self.lanes, stride, reversed };
                    let Some(edge) = source.edge(q, bevel) else { unreachable!("halos reach no further than edges") };
                    copy((&source.edges, edge), (&mut self.values, to), source.extent, transposed, |value| value);
                }
            }
        }
    }

    /// How much the last pull changes what a sector with `count` headings reads of W, at most; roughly, where that is far
    /// above `threshold`.
    pub(crate) fn seam(&self, count: usize, noise: &[T], threshold: f64) -> f64 {
        let offset = |index: usize| if index < self.reach { index } else { index + count } as i64 - self.reach as i64;
        // Steps that arrive with bevel -1 read headings -1 .. count - 1, those with bevel +1 the headings 1 .. count + 1.
        let centres = [0, 1].map(|bevel: usize| (2 * bevel as i64 - 1)..(count as i64 + 2 * bevel as i64 - 1));
        let mut rows = Vec::new();
        for (bevel, centres) in centres.into_iter().enumerate() {
            for centre in centres {
                let weight = |index: usize| noise.get((offset(index) - centre).unsigned_abs() as usize);
                let taps: Vec<(usize, T)> =
                    (0..2 * self.reach).filter_map(|index| Some((index * 2 + bevel, *weight(index)?))).collect();
                if !taps.is_empty() {
                    rows.push(taps);
                }
            }
        }
        let planes = 4 * self.reach;
        let sample = self.values.len() / planes / self.lanes / 2 * planes * self.lanes;
        let column = sample..sample + planes * self.lanes;
        let rough = largest_change(&self.values[column.clone()], &self.before[column], planes, self.lanes, &rows);
        if rough > threshold { rough } else { largest_change(&self.values, &self.before, planes, self.lanes, &rows) }
    }
}

/// Whether W of a sector has a use for a heading of its halo with a bevel: steps turn the heading by one to the side of their
/// bevel, so that they reach two headings less far beyond the other end.
fn is_read(reach: usize, index: usize, bevel: usize) -> bool {
    let (below, distance) = if index < reach { (true, reach - index) } else { (false, index - reach + 1) };
    below == (bevel == 0) || distance + 2 <= reach
}

/// The largest change, over `rows`, of sums of weighted rows in `[u][planes][lanes]` arrays.
#[multiversion::multiversion(targets("x86_64+avx+avx2"))]
fn largest_change<T: Real>(new: &[T], old: &[T], planes: usize, lanes: usize, rows: &[Vec<(usize, T)>]) -> f64 {
    let mut largest = vec![T::default(); lanes];
    let mut changes = vec![T::default(); planes * lanes];
    let mut sum = vec![T::default(); lanes];
    for (new, old) in new.chunks_exact(changes.len()).zip(old.chunks_exact(changes.len())) {
        for ((change, new), old) in changes.iter_mut().zip(new).zip(old) {
            *change = *new - *old;
        }
        for taps in rows {
            sum.fill(T::default());
            for (plane, weight) in taps {
                let row = &changes[plane * lanes..][..lanes];
                sum.iter_mut().zip(row).for_each(|(sum, change)| *sum = *sum + *weight * *change);
            }
            for (largest, sum) in largest.iter_mut().zip(&sum) {
                let change = sum.magnitude();
                *largest = if change > *largest { change } else { *largest };
            }
        }
    }
    largest.iter().fold(0.0, |max, change| f64::max(max, change.widen()))
}
