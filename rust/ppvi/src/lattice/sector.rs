//! A quarter of the headings, stored so that the needle always moves towards larger `u`.
//!
//! In the sector "right" u is the grid column and v the grid row, in "up" they are exchanged; in "left" and "down" u is
//! reversed as well. Values are stored `[u][heading][bevel][v]` with v contiguous and padded, so that a step is a read
//! of a shifted row.

use multiversion::multiversion;

use crate::lattice::field::Field;
use crate::lattice::halo::Halo;
use crate::lattice::kernel::{GOES_ON, LANES, Numbers, back_up_row, blend_row, convolve_row, follow_row};
use crate::lattice::plane::{Plane, copy};
use crate::lattice::real::Real;
use crate::lattice::{LatticeMdp, Shape, Shift};
use crate::memory::Array;

/// The grid direction in which the headings of a sector move the most, in cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Direction {
    Right,
    Up,
    Left,
    Down,
}

impl Direction {
    pub(crate) const ALL: [Direction; 4] = [Direction::Right, Direction::Up, Direction::Left, Direction::Down];

    /// The direction of a heading, measured in cells.
    pub(crate) fn of(heading: f64, spacing: [f64; 2]) -> Self {
        let (sin, cos) = heading.sin_cos();
        let (x, y) = (cos / spacing[0], sin / spacing[1]);
        match (x.abs() >= y.abs(), x > 0.0, y > 0.0) {
            (true, true, _) => Direction::Right,
            (true, false, _) => Direction::Left,
            (false, _, true) => Direction::Up,
            (false, _, false) => Direction::Down,
        }
    }

    pub(crate) fn is_vertical(self) -> bool {
        matches!(self, Direction::Up | Direction::Down)
    }

    pub(crate) fn is_reversed(self) -> bool {
        matches!(self, Direction::Left | Direction::Down)
    }
}

/// Which headings a sector has: `first .. first + count`, modulo the number of headings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Arc {
    pub direction: Direction,
    pub first: usize,
    pub count: usize,
}

impl Arc {
    /// All (heading of the sector, bevel).
    pub(crate) fn planes(self) -> impl Iterator<Item = (usize, usize)> {
        (0..self.count * 2).map(|plane| (plane / 2, plane % 2))
    }
}

/// Values of the headings of a sector and what their sweeps need.
pub(crate) struct Sector<T: Copy> {
    pub arc: Arc,
    /// Extent along u and v.
    pub extent: [usize; 2],
    /// Row length, a multiple of [`LANES`].
    pub lanes: usize,
    /// Padding of the convolved values on each side of u and of v.
    pad: [usize; 2],
    /// `[u][count][bevel][lanes]`.
    pub values: Array<T>,
    /// Convolved values W, `[pad + u + pad][count + 2][bevel][pad + lanes + pad]`: one heading more on each side.
    convolved: Array<T>,
    /// `[u][count][bevel][lanes]`: Q-value of the step that arrives with the bevel if it ends, else [`GOES_ON`].
    ended: Array<T>,
    /// `[u][count][bevel][lanes]`: whether the policy turns the needle; empty without a policy.
    turns: Array<u8>,
    /// `[count][bevel]`, along (u, v).
    shifts: Vec<[Shift; 2]>,
    /// Whether every step reads only columns further downstream, as it does unless the grid is coarse for the step.
    downstream: bool,
}

impl<T: Real> Sector<T> {
    /// A sector with values `start` everywhere (the first sweep sets the absorbing states); a policy makes its sweeps follow it.
    pub(crate) fn new(
        lattice: &LatticeMdp,
        arc: Arc,
        numbers: &Numbers<T>,
        start: T,
        policy: Option<&Field<u8>>,
    ) -> Self {
        let Shape { nx, ny, headings } = lattice.shape;
        let extent = if arc.direction.is_vertical() { [ny, nx] } else { [nx, ny] };
        let shifts: Vec<[Shift; 2]> = (0..arc.count)
            .map(|q| lattice.stencil[(arc.first + q) % headings].map(|shift| orient(shift, arc.direction)))
            .collect();
        let downstream = shifts.iter().flatten().all(|shift| shift.cell[0] > 0);
        let reach = |axis: usize| {
            shifts.iter().flatten().map(|shift| shift.cell[axis].unsigned_abs() as usize + 1).max().unwrap_or(1)
        };
        let pad = [reach(0), reach(1)];
        let lanes = extent[1].next_multiple_of(LANES);
        let size = extent[0] * arc.count * 2 * lanes;
        let padded = (extent[0] + 2 * pad[0]) * (arc.count + 2) * 2 * (lanes + 2 * pad[1]);
        let mut sector = Sector {
            arc,
            extent,
            lanes,
            pad,
            values: Array::filled(start, size),
            convolved: Array::filled(numbers.outside(), padded),
            ended: Array::filled(numbers.outside(), size),
            turns: Array::filled(0, if policy.is_some() { size } else { 0 }),
            shifts,
            downstream,
        };
        sector.load_outcomes(lattice, numbers);
        sector.fill_convolved(start);
        if let Some(policy) = policy {
            let mut turns = std::mem::take(&mut sector.turns);
            sector.import(policy, &mut turns, |action| action);
            sector.turns = turns;
        }
        sector
    }

    /// W of constant values; the padding keeps what is outside.
    fn fill_convolved(&mut self, start: T) {
        let width = self.lanes + 2 * self.pad[1];
        let column = (self.arc.count + 2) * 2 * width;
        let inside = self.pad[0] * column..(self.pad[0] + self.extent[0]) * column;
        for row in self.convolved[inside].chunks_exact_mut(width) {
            row[self.pad[1]..][..self.extent[1]].fill(start);
        }
    }

    /// Where heading `q` of the sector stands in its arrays, as a plane of rows u.
    pub(crate) fn plane(&self, q: usize, bevel: usize) -> Plane {
        let stride = self.arc.count * 2 * self.lanes;
        Plane { start: (q * 2 + bevel) * self.lanes, stride, reversed: self.arc.direction.is_reversed() }
    }

    /// Copies the sector's part of a field into one of its arrays.
    fn import<A: Copy + Default, B: Copy>(&self, field: &Field<A>, to: &mut [B], convert: impl Fn(A) -> B + Copy) {
        let vertical = self.arc.direction.is_vertical();
        for (q, bevel) in self.arc.planes() {
            let from = (&field.values[..], field.plane((self.arc.first + q) % field.shape.headings, bevel));
            copy(from, (to, self.plane(q, bevel)), field.extent(), vertical, convert);
        }
    }

    /// Replaces the values; the convolved values follow with [`Sector::convolve_all`].
    pub(crate) fn load<S: Real>(&mut self, field: &Field<S>) {
        let mut values = std::mem::take(&mut self.values);
        self.import(field, &mut values, |value| T::of(value.widen()));
        self.values = values;
    }

    /// Gives infinite values to the marked states. Both bevels of a pose have the same two steps to choose from, so they
    /// are marked together, and both their steps can be taken as ended with an infinite cost.
    pub(crate) fn exclude(&mut self, endless: &Field<u8>) {
        let mut marks = Array::filled(0u8, self.values.len());
        self.import(endless, &mut marks, |mark| mark);
        for ((value, ended), mark) in self.values.iter_mut().zip(self.ended.iter_mut()).zip(marks.iter()) {
            if *mark != 0 {
                (*value, *ended) = (T::of(f64::INFINITY), T::of(f64::INFINITY));
            }
        }
    }

    /// Copies the values into a field.
    pub(crate) fn export(&self, field: &mut Field<T>) {
        let vertical = self.arc.direction.is_vertical();
        for (q, bevel) in self.arc.planes() {
            let to = field.plane((self.arc.first + q) % field.shape.headings, bevel);
            copy((&self.values, self.plane(q, bevel)), (&mut field.values, to), self.extent, vertical, |value| value);
        }
    }

    fn load_outcomes(&mut self, lattice: &LatticeMdp, numbers: &Numbers<T>) {
        let Shape { nx, ny, headings } = lattice.shape;
        let mut by_code = [T::of(GOES_ON); 256];
        by_code[1..6].copy_from_slice(&numbers.ended[1..6]);
        let vertical = self.arc.direction.is_vertical();
        for (q, bevel) in self.arc.planes() {
            let k = (self.arc.first + q) % headings;
            let plane = &lattice.outcomes[(k * 2 + bevel) * nx * ny..][..nx * ny];
            let from = (plane, Plane { start: 0, stride: ny, reversed: false });
            let to = self.plane(q, bevel);
            copy(from, (&mut self.ended, to), [nx, ny], vertical, |code| by_code[code as usize]);
        }
        for row in self.values.chunks_exact_mut(self.lanes) {
            row[self.extent[1]..].fill(numbers.outside());
        }
    }

    /// Recomputes all of W, after values were loaded.
    pub(crate) fn convolve_all(&mut self, halo: &Halo<T>, noise: &[T]) {
        for u in 0..self.extent[0] {
            self.convolve_column(u, halo, noise);
        }
    }

    #[inline(always)]
    fn convolve_column(&mut self, u: usize, halo: &Halo<T>, noise: &[T]) {
        let count = self.arc.count;
        let width = self.lanes + 2 * self.pad[1];
        let column = &mut self.convolved[(u + self.pad[0]) * (count + 2) * 2 * width..][..(count + 2) * 2 * width];
        let values = &self.values[u * count * 2 * self.lanes..][..count * 2 * self.lanes];
        let own = values.chunks_exact(self.lanes);
        let rows: Vec<&[T]> =
            halo.rows(u, 0..noise.len()).chain(own).chain(halo.rows(u, noise.len()..2 * noise.len())).collect();
        for (r, pair) in column.chunks_exact_mut(2 * width).enumerate() {
            for (bevel, row) in pair.chunks_exact_mut(width).enumerate() {
                let out = &mut row[self.pad[1]..][..self.lanes];
                // Row r of W is centred on heading r - 1 of the sector; taps reach noise.len() - 1 to each side.
                convolve_row(out, noise, |tap| rows[(r + tap) * 2 + bevel]);
            }
        }
    }

    /// One sweep against the direction of motion; returns the largest change of a value.
    pub(crate) fn sweep(&mut self, halo: &Halo<T>, noise: &[T], numbers: &Numbers<T>, interpolated: bool) -> f64 {
        match (interpolated, self.turns.is_empty()) {
            (false, true) => sweep_columns::<T, false, false>(self, halo, noise, numbers),
            (false, false) => sweep_columns::<T, false, true>(self, halo, noise, numbers),
            (true, true) => sweep_columns::<T, true, false>(self, halo, noise, numbers),
            (true, false) => sweep_columns::<T, true, true>(self, halo, noise, numbers),
        }
    }

    /// The row of W that the step of heading `q` reads at column `u`, moved by further `(du, dv)` cells.
    #[inline(always)]
    fn successors(&self, u: usize, q: usize, bevel: usize, [du, dv]: [i64; 2]) -> &[T] {
        let shift = &self.shifts[q][bevel];
        let width = self.lanes + 2 * self.pad[1];
        let turned = if bevel == 1 { q + 2 } else { q };
        let to_u = (u as i64 + self.pad[0] as i64 + i64::from(shift.cell[0]) + du) as usize;
        let to_v = (self.pad[1] as i64 + i64::from(shift.cell[1]) + dv) as usize;
        &self.convolved[((to_u * (self.arc.count + 2) + turned) * 2 + bevel) * width + to_v..][..self.lanes]
    }

    /// E V(s') of a row of steps: a row of W as it stands, or the blend of four, in `buffer`.
    #[inline(always)]
    fn expectation<'a, const INTERPOLATED: bool>(
        &'a self,
        u: usize,
        q: usize,
        bevel: usize,
        buffer: &'a mut [T],
    ) -> &'a [T] {
        if !INTERPOLATED {
            return self.successors(u, q, bevel, [0, 0]);
        }
        let [a, b, c, d] = [[0, 0], [0, 1], [1, 0], [1, 1]].map(|further| self.successors(u, q, bevel, further));
        let [fu, fv] = self.shifts[q][bevel].fraction;
        let weights = [(1.0 - fu) * (1.0 - fv), (1.0 - fu) * fv, fu * (1.0 - fv), fu * fv];
        blend_row(buffer, a, b, c, d, weights.map(T::of));
        buffer
    }
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn sweep_columns<T: Real, const INTERPOLATED: bool, const POLICY: bool>(
    sector: &mut Sector<T>,
    halo: &Halo<T>,
    noise: &[T],
    numbers: &Numbers<T>,
) -> f64 {
    let mut change = vec![T::default(); sector.lanes];
    let mut buffers = [change.clone(), change.clone()];
    let pair = 2 * sector.lanes;
    if !sector.downstream {
        // Columns not yet swept are read, too: they must not hold the halo of the pass before.
        sector.convolve_all(halo, noise);
    }
    for u in (0..sector.extent[0]).rev() {
        let column = u * sector.arc.count * pair;
        let mut values = std::mem::take(&mut sector.values);
        for q in 0..sector.arc.count {
            let (minus, plus) = values[column + q * pair..][..pair].split_at_mut(sector.lanes);
            let (ended_minus, ended_plus) = sector.ended[column + q * pair..][..pair].split_at(sector.lanes);
            let [buffer_minus, buffer_plus] = &mut buffers;
            let to_minus = sector.expectation::<INTERPOLATED>(u, q, 0, buffer_minus);
            let to_plus = sector.expectation::<INTERPOLATED>(u, q, 1, buffer_plus);
            if POLICY {
                let (turns_minus, turns_plus) = sector.turns[column + q * pair..][..pair].split_at(sector.lanes);
                follow_row(
                    minus,
                    plus,
                    &mut change,
                    ended_minus,
                    ended_plus,
                    to_minus,
                    to_plus,
                    turns_minus,
                    turns_plus,
                    numbers,
                );
            } else {
                back_up_row(minus, plus, &mut change, ended_minus, ended_plus, to_minus, to_plus, numbers);
            }
        }
        sector.values = values;
        sector.convolve_column(u, halo, noise);
    }
    change.iter().map(|c| c.widen()).fold(0.0, f64::max)
}

/// A displacement along (u, v).
fn orient(shift: Shift, direction: Direction) -> Shift {
    let Shift { mut cell, mut fraction } = shift;
    if direction.is_vertical() {
        cell.swap(0, 1);
        fraction.swap(0, 1);
    }
    if direction.is_reversed() {
        // -(cell + fraction) = -(cell + 1) + (1 - fraction).
        cell[0] = -cell[0];
        if fraction[0] > 0.0 {
            cell[0] -= 1;
            fraction[0] = 1.0 - fraction[0];
        }
    }
    Shift { cell, fraction }
}
