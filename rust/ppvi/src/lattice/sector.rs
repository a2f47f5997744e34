//! A quarter of the headings, stored so that the needle always moves towards larger `u`.
//!
//! In the sector "right" u is the grid column and v the grid row, in "up" they are exchanged; in "left" and "down" u is
//! reversed as well. Rows are contiguous in v and padded, so that a step is a read of a shifted row.
//!
//! A sweep against the motion needs nothing of the sweep before it: it makes all values anew from what stands around the
//! sector (`halo`). So what is kept of a sector are the values at its ends, for the halos of the others, and W, its
//! values convolved with the noise of the heading, of the last few columns only: the cache holds them, and a sweep costs
//! arithmetic instead of memory. Only where the grid is so coarse that steps do not leave their column is W kept whole.
//! Values of the whole sector are written when they are wanted (`Store`).

use crate::lattice::direction::Arc;
use crate::lattice::field::Field;
use crate::lattice::kernel::Numbers;
use crate::lattice::plane::{Plane, copy};
use crate::lattice::real::Real;
use crate::lattice::{LANES, LatticeMdp, Region, Shift};
use crate::memory::Array;

/// W of the last columns, the values at the ends, and the steps of the headings of a sector.
pub(crate) struct Sector<T: Copy> {
    pub arc: Arc,
    /// Extent along u and v.
    pub extent: [usize; 2],
    /// Row length, a multiple of [`LANES`].
    pub lanes: usize,
    /// How far steps reach along u and v.
    pub pad: [usize; 2],
    /// W, `[column][count + 2][bevel][pad + lanes + pad]`: one heading more on each side. Column u is at [`Sector::column`].
    pub convolved: Array<T>,
    /// Columns of W: a power of two less one, or all ones where W is kept whole.
    mask: usize,
    /// V of the headings at the ends, `[slots][bevel][u][lanes]`; see [`Sector::slot`].
    pub edges: Array<T>,
    slots: usize,
    /// `[u][count][bevel][lanes]`: whether the policy turns the needle; empty without a policy.
    pub turns: Array<u8>,
    /// `[region][count][bevel]`, along (u, v).
    pub shifts: Vec<[Shift; 2]>,
    /// Whether every step reads only columns further downstream, as it does unless the grid is coarse for the step.
    pub downstream: bool,
}

/// What a whole pass is given.
#[derive(Clone, Copy)]
pub(crate) struct Task<'a, T> {
    pub lattice: &'a LatticeMdp,
    pub noise: &'a [T],
    pub numbers: &'a Numbers<T>,
}

impl<T: Real> Sector<T> {
    /// A sector with values `start` everywhere; a policy makes its sweeps follow it.
    pub(crate) fn new(task: Task<'_, T>, arc: Arc, start: T, policy: Option<&Field<u8>>) -> Self {
        let Task { lattice, noise, numbers } = task;
        let headings = lattice.shape.headings;
        let extent = arc.extent(lattice.shape);
        let oriented = |region: &Region, q: usize| {
            region.stencil[arc.heading(q, headings)].map(|shift| arc.direction.orient(shift))
        };
        let by_heading = |region| (0..arc.count).map(move |q| oriented(region, q));
        let shifts: Vec<[Shift; 2]> = lattice.regions.iter().flat_map(by_heading).collect();
        let downstream = shifts.iter().flatten().all(|shift| shift.cell[0] > 0);
        let reach = |axis: usize| {
            shifts.iter().flatten().map(|shift| shift.cell[axis].unsigned_abs() as usize + 1).max().unwrap_or(1)
        };
        let pad = [reach(0), reach(1)];
        let lanes = extent[1].next_multiple_of(LANES);
        let columns = if downstream { (pad[0] + 1).next_power_of_two() } else { extent[0] + 2 * pad[0] };
        let slots = arc.count.min(2 * noise.len());
        let mut sector = Sector {
            arc,
            extent,
            lanes,
            pad,
            convolved: Array::filled(numbers.outside(), columns * (arc.count + 2) * 2 * (lanes + 2 * pad[1])),
            mask: if downstream { columns - 1 } else { usize::MAX },
            edges: Array::filled(start, slots * 2 * extent[0] * lanes),
            slots,
            turns: Array::filled(0, if policy.is_some() { extent[0] * arc.count * 2 * lanes } else { 0 }),
            shifts,
            downstream,
        };
        if !downstream {
            sector.fill_convolved(start);
        }
        if let Some(policy) = policy {
            sector.import(policy);
        }
        sector
    }

    /// W of constant values; the padding keeps what is outside.
    fn fill_convolved(&mut self, start: T) {
        let (width, column) = (self.width(), self.column_size());
        let inside = self.pad[0] * column..(self.pad[0] + self.extent[0]) * column;
        for row in self.convolved[inside].chunks_exact_mut(width) {
            row[self.pad[1]..][..self.extent[1]].fill(start);
        }
    }

    /// Length of a row of W.
    #[inline(always)]
    pub(crate) fn width(&self) -> usize {
        self.lanes + 2 * self.pad[1]
    }

    /// Length of a column of W.
    #[inline(always)]
    pub(crate) fn column_size(&self) -> usize {
        (self.arc.count + 2) * 2 * self.width()
    }

    /// Where column `u`, given as u + pad, begins in W.
    #[inline(always)]
    pub(crate) fn column(&self, padded: usize) -> usize {
        (padded & self.mask) * self.column_size()
    }

    /// Takes over the state of a sector of another precision.
    pub(crate) fn load<S: Real>(&mut self, other: &Sector<S>) {
        let convert = |to: &mut Array<T>, from: &Array<S>| {
            to.iter_mut().zip(from.iter()).for_each(|(to, from)| *to = T::of(from.widen()));
        };
        convert(&mut self.edges, &other.edges);
        if !self.downstream {
            convert(&mut self.convolved, &other.convolved);
        }
    }

    /// Copies the sector's part of a policy.
    fn import(&mut self, policy: &Field<u8>) {
        let stride = self.arc.count * 2 * self.lanes;
        let Arc { direction, .. } = self.arc;
        for (q, bevel) in self.arc.planes() {
            let from = (&policy.values[..], policy.plane(self.arc.heading(q, policy.shape.headings), bevel));
            let to = Plane { start: (q * 2 + bevel) * self.lanes, stride, reversed: direction.is_reversed() };
            copy(from, (&mut self.turns, to), policy.extent(), direction.is_vertical(), |action| action);
        }
    }

    /// Where the values of heading `q` stand among the edges; None for a heading far from both ends.
    pub(crate) fn slot(&self, q: usize) -> Option<usize> {
        let between = self.arc.count - self.slots;
        let half = self.slots.div_ceil(2);
        if q < half { Some(q) } else { (q >= half + between).then(|| q - between) }
    }

    /// The values of heading `q`, as a plane of the edges with rows u.
    pub(crate) fn edge(&self, q: usize, bevel: usize) -> Option<Plane> {
        let start = (self.slot(q)? * 2 + bevel) * self.extent[0] * self.lanes;
        Some(Plane { start, stride: self.lanes, reversed: self.arc.direction.is_reversed() })
    }

    /// The largest finite value at the ends: about the largest value.
    pub(crate) fn max(&self) -> f64 {
        let larger = |max: T, value: &T| if *value > max && value.widen() < f64::INFINITY { *value } else { max };
        let rows = self.edges.chunks_exact(self.lanes).map(|row| &row[..self.extent[1]]);
        rows.flatten().fold(T::default(), larger).widen()
    }
}
