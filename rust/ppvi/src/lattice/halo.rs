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
}

impl<T: Real> Halo<T> {
    /// A halo of `start` values, for noise with `reach` = taps on one side, plus one for the arc itself.
    pub(crate) fn new(sector: &Sector<T>, reach: usize, start: T, padding: T) -> Self {
        let lanes = sector.lanes;
        let mut values = Array::filled(start, sector.extent[0] * 2 * reach * 2 * lanes);
        for row in values.chunks_exact_mut(lanes) {
            row[sector.extent[1]..].fill(padding);
        }
        Halo { reach, lanes, values }
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
                for bevel in 0..2 {
                    let stride = 2 * self.reach * 2 * self.lanes;
                    let to = Plane { start: (index * 2 + bevel) * self.lanes, stride, reversed };
                    let from = (&source.values[..], source.plane(q, bevel));
                    copy(from, (&mut self.values, to), source.extent, transposed, |value| value);
                }
            }
        }
    }
}
