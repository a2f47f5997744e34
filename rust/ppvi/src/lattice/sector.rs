//! A quarter of the headings, stored so that the needle always moves towards larger `u`.
//!
//! In the sector "right" u is the grid column and v the grid row, in "up" they are exchanged; in "left" and "down" u is
//! reversed as well. Rows are contiguous in v and padded, so that a step is a read of a shifted row. What does not move
//! along is stored by *place*, the grid column or row: u, or its reverse.
//!
//! A sector stores its values at the end headings, which are the halos of other sectors, and W, its values convolved
//! with the heading noise. A sweep against the motion computes all values of a sector from its halo alone, so W is
//! stored for the last few columns only, which fit into the cache. W is stored whole if the grid is so coarse that steps
//! do not leave their column, and if sweeps leave out strips ([`crate::lattice::pending`]), which read what earlier
//! sweeps have computed. `Store` takes the values of a whole sector on request.

use std::ops::Range;

use crate::lattice::cubic::{Cells, CubicWeights, Reading};
use crate::lattice::direction::Arc;
use crate::lattice::kernel::StageCosts;
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{LANES, LatticeParts, Region, Shape, Shift};
use crate::lattice::pending::Pending;
use crate::lattice::plane::{Plane, copy, copy_few};
use crate::lattice::real::Real;
use crate::lattice::terminal_mask::TerminalMask;
use crate::lattice::turns::Turns;
use crate::memory::Array;

/// W, the values at the ends, and the steps of the headings of a sector.
pub(crate) struct Sector<T: Copy> {
    pub arc: Arc,
    /// Extent along u and v.
    pub extent: [usize; 2],
    /// Row length, a multiple of [`LANES`].
    pub lanes: usize,
    /// How far steps reach along u and v.
    pub pad: [usize; 2],
    /// W, `[column][turn][count][bevel][pad + lanes + pad]`, for each turn of the regions. Column u is at
    /// [`Sector::column`].
    pub convolved: Array<T>,
    /// Rows of a column of W.
    rows: usize,
    /// Columns of W: a power of two less one, or all ones where W is stored whole.
    mask: usize,
    /// V of the headings at the ends, `[place][strip][plane][LANES]`; see [`Ends`].
    pub edges: Array<T>,
    pub ends: Ends,
    /// `[place][strip][count][bevel][LANES]`: the actions of the policy; empty without a policy.
    policy_mask: Array<u8>,
    /// `[motion][region][count][bevel]`, along (u, v).
    pub shifts: Vec<[Shift; 2]>,
    /// As `shifts`, and the cells; empty unless the reading is cubic.
    pub cubic: Vec<[CubicWeights<T>; 2]>,
    pub cells: Cells,
    /// Upper limit of cubic interpolation.
    pub limit: T,
    /// Whether every step reads only columns further downstream, as it does unless the grid is coarse for the step.
    downstream: bool,
    /// Whether W is stored whole.
    pub whole: bool,
    pub pending: Pending,
    /// `[place][strip]`: whether the last sweep backed up the strip.
    pub swept: Vec<bool>,
}

/// Inputs of a whole pass.
#[derive(Clone, Copy)]
pub(crate) struct PassInputs<'a, T> {
    pub lattice: &'a LatticeMdp,
    pub turns: &'a Turns<T>,
    pub costs: &'a StageCosts<T>,
}

impl<T: Real> Sector<T> {
    /// A sector with values `start` everywhere; a policy makes its sweeps follow it, with this reading. With `skips` W is
    /// stored whole.
    pub(crate) fn new(
        inputs: PassInputs<'_, T>,
        arc: Arc,
        start: T,
        policy: Option<(&[u8], Reading)>,
        skips: bool,
    ) -> Self {
        let PassInputs { lattice, turns, costs } = inputs;
        let headings = lattice.parts.shape.headings;
        let extent = arc.extent(lattice.parts.shape);
        let oriented = |region: &Region, q: usize| {
            region.stencil[arc.heading(q, headings)].map(|shift| arc.direction.orient(shift))
        };
        let by_heading = |region| (0..arc.count).map(move |q| oriented(region, q));
        let shifts: Vec<[Shift; 2]> = lattice.parts.steps().flat_map(by_heading).collect();
        let reading = policy.map_or(Reading::Transitions, |(_, reading)| reading);
        // Points that are read on each side of the cell in which a step ends.
        let aside = usize::from(reading.is_cubic());
        let downstream = shifts.iter().flatten().all(|shift| shift.cell[0] > aside as i32);
        let whole = skips || !downstream;
        let reach = |axis: usize| {
            shifts.iter().flatten().map(|shift| shift.cell[axis].unsigned_abs() as usize + 1 + aside).max().unwrap_or(1)
        };
        let pad = [reach(0), reach(1)];
        let lanes = extent[1].next_multiple_of(LANES);
        let columns = if whole { extent[0] + 2 * pad[0] } else { (pad[0] + 1).next_power_of_two() };
        let ends = Ends::new(arc.count, turns.beyond);
        let rows = turns.count() * arc.count * 2;
        let (mut cubic, mut cells) = (Vec::new(), Cells::default());
        if reading.is_cubic() {
            cubic.extend(shifts.iter().map(|pair| pair.map(|shift| CubicWeights::new(shift, reading))));
            cells = Cells::new(lattice, arc, lanes, pad);
        }
        let mut sector = Sector {
            arc,
            extent,
            lanes,
            pad,
            convolved: Array::filled(costs.outside(), columns * rows * (lanes + 2 * pad[1])),
            rows,
            mask: if whole { usize::MAX } else { columns - 1 },
            edges: Array::filled(start, extent[0] * lanes * ends.planes()),
            ends,
            policy_mask: Array::filled(0, if policy.is_some() { extent[0] * arc.count * 2 * lanes } else { 0 }),
            pending: Pending::new([extent[0], lanes / LANES], &shifts, aside),
            swept: vec![false; extent[0] * lanes / LANES],
            shifts,
            cubic,
            cells,
            limit: T::of(if reading == Reading::Cubic { 1.0 } else { f64::INFINITY }),
            downstream,
            whole,
        };
        if !downstream {
            sector.fill_convolved(start);
        }
        if let Some((policy, _)) = policy {
            sector.import(policy, lattice.parts.shape);
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
        self.rows * self.width()
    }

    /// Where column `u`, given as u + pad, begins in W.
    #[inline(always)]
    pub(crate) fn column(&self, padded: usize) -> usize {
        (padded & self.mask) * self.column_size()
    }

    /// Takes over the state of a sector of another precision. The padding keeps what is outside in this precision.
    pub(crate) fn load<S: Real>(&mut self, other: &Sector<S>) {
        let convert = |to: &mut [T], from: &[S]| {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = T::of(from.widen()));
        };
        convert(&mut self.edges, &other.edges);
        self.swept.fill(true);
        if !self.downstream {
            let (width, column) = (self.width(), self.column_size());
            let inside = self.pad[0] * column..(self.pad[0] + self.extent[0]) * column;
            let to = self.convolved[inside.clone()].chunks_exact_mut(width);
            for (to, from) in to.zip(other.convolved[inside].chunks_exact(width)) {
                convert(&mut to[self.pad[1]..][..self.extent[1]], &from[self.pad[1]..][..self.extent[1]]);
            }
        }
    }

    /// Starts with `value(state)` at the ends, by the number of the state.
    pub(crate) fn start_from(&mut self, shape: Shape, value: impl Fn(usize) -> T) {
        let (arc, strips, length) = (self.arc, self.strips(), self.extent[1]);
        let of_bevel = |(bevel, ends): (usize, &[Range<usize>; 2])| {
            let headings = ends.clone().into_iter().flatten();
            headings.map(move |q| arc.heading(q, shape.headings) * 2 + bevel).collect::<Vec<usize>>()
        };
        let planes: Vec<usize> = self.ends.kept.iter().enumerate().flat_map(of_bevel).collect();
        for (number, strip) in self.edges.chunks_exact_mut((planes.len() * LANES).max(1)).enumerate() {
            let (place, first) = (number / strips, number % strips * LANES);
            for v in first..length.min(first + LANES) {
                let (i, j) = if arc.direction.is_vertical() { (v, place) } else { (place, v) };
                let point = (i * shape.ny + j) * shape.headings * 2;
                for (lanes, plane) in strip.chunks_exact_mut(LANES).zip(&planes) {
                    lanes[v - first] = value(point + plane);
                }
            }
        }
    }

    /// Copies the sector's part of a policy table to the policy mask.
    fn import(&mut self, policy: &[u8], shape: Shape) {
        let (arc, size) = (self.arc, self.arc.count * 2 * LANES);
        for (number, strip) in self.policy_mask.chunks_exact_mut(size).enumerate() {
            let (place, first) = (number / (self.lanes / LANES), number % (self.lanes / LANES) * LANES);
            let length = LANES.min(self.extent[1] - first);
            for run in arc.runs(shape.headings) {
                let from = arc.table_plane(shape, place, first, run.heading);
                let to = Plane { start: run.begin * 2 * LANES, stride: LANES };
                copy((policy, from), (strip, to), [length, run.count * 2], true, |action| action);
            }
        }
    }

    /// Whether sweeps follow a policy.
    pub(crate) fn has_policy(&self) -> bool {
        !self.policy_mask.is_empty()
    }

    /// The policy mask of a strip, `[heading][bevel]`; empty without a policy.
    #[inline(always)]
    pub(crate) fn policy_mask(&self, place: usize, strip: usize) -> &[[[u8; LANES]; 2]] {
        if self.policy_mask.is_empty() {
            return &[];
        }
        let size = self.arc.count * 2 * LANES;
        let mask = &self.policy_mask[(place * self.strips() + strip) * size..][..size];
        mask.as_chunks::<LANES>().0.as_chunks::<2>().0
    }

    /// The place of column `u`.
    #[inline(always)]
    pub(crate) fn place(&self, u: usize) -> usize {
        if self.arc.direction.is_reversed() { self.extent[0] - 1 - u } else { u }
    }

    /// The turns with which steps read each column, `[column][turn]`: those of the columns before it, as far as steps
    /// reach. Where tissues differ, each column is read with few of the turns.
    pub(crate) fn read_turns(&self, parts: &LatticeParts, terminal_mask: &TerminalMask, turns: &Turns<T>) -> Vec<bool> {
        let count = turns.count();
        let mut read = vec![!self.downstream || count == 1; self.extent[0] * count];
        if read.first() == Some(&false) {
            for u in 0..self.extent[0] {
                for (piece, motion) in terminal_mask
                    .pieces(self.place(u))
                    .iter()
                    .flat_map(|piece| parts.motions().iter().map(move |m| (piece, *m)))
                {
                    let turn = turns.of_step(parts.step_number(motion, piece.region));
                    let reached = u + 1..(u + self.pad[0] + 1).min(self.extent[0]);
                    reached.for_each(|to| read[to * count + turn] = true);
                }
            }
        }
        read
    }

    /// Strips of a column.
    #[inline(always)]
    pub(crate) fn strips(&self) -> usize {
        self.lanes / LANES
    }

    /// Stores the values of a strip at the ends of the sector.
    #[inline(always)]
    pub(crate) fn put_edges(&mut self, place: usize, strip: usize, values: [&mut [[T; LANES]]; 2]) {
        let planes = self.ends.planes();
        let start = (place * self.strips() + strip) * planes * LANES;
        let mut to = self.edges[start..][..planes * LANES].as_chunks_mut::<LANES>().0;
        for (values, [low, high]) in values.into_iter().zip(self.ends.kept.clone()) {
            for part in [low, high] {
                let (now, rest) = to.split_at_mut(part.len());
                copy_few(now, &values[part]);
                to = rest;
            }
        }
    }

    /// The largest finite value at the ends: about the largest value.
    pub(crate) fn max(&self) -> f64 {
        let larger = |max: T, value: &T| if *value > max && value.widen() < f64::INFINITY { *value } else { max };
        // Over all lanes: the lanes of the padding hold the value outside the grid, which does not exceed the exit
        // cost.
        self.edges.iter().fold(T::default(), larger).widen()
    }
}

/// The headings whose values other sectors read: by bevel, a range at the low end and a range at the high end.
///
#[derive(Debug, Clone)]
pub(crate) struct Ends {
    kept: [[Range<usize>; 2]; 2],
}

impl Ends {
    /// `beyond` are the headings that sectors read below and above their own, by bevel.
    fn new(count: usize, beyond: [[usize; 2]; 2]) -> Self {
        let ends = |low: usize, high: usize| {
            let low = low.min(count);
            [0..low, low.max(count.saturating_sub(high))..count]
        };
        Ends { kept: beyond.map(|[below, above]| ends(above, below)) }
    }

    /// Planes in all.
    #[inline(always)]
    pub(crate) fn planes(&self) -> usize {
        self.kept.iter().flatten().map(Range::len).sum()
    }

    /// The plane of heading `q`, where it is kept.
    pub(crate) fn plane(&self, q: usize, bevel: usize) -> Option<usize> {
        let mut before = 0;
        for (of, range) in self.kept.iter().enumerate().flat_map(|(of, ends)| ends.iter().map(move |range| (of, range)))
        {
            if of == bevel && range.contains(&q) {
                return Some(before + q - range.start);
            }
            before += range.len();
        }
        None
    }
}
