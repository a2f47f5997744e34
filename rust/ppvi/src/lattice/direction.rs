//! The four directions in which headings move over the grid, and the headings of each.

use std::f64::consts::TAU;

use crate::lattice::parts::{LatticeParts, Shape, Shift};
use crate::lattice::plane::Plane;

/// The grid direction in which a heading moves the most, in cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Towards larger x.
    Right,
    /// Towards larger y.
    Up,
    /// Towards smaller x.
    Left,
    /// Towards smaller y.
    Down,
}

impl Direction {
    /// All four, in the order of the tables that are given by direction.
    pub const ALL: [Direction; 4] = [Direction::Right, Direction::Up, Direction::Left, Direction::Down];

    /// The directions of all headings of a circle, on a grid of this spacing.
    pub fn of_headings(headings: usize, spacing: [f64; 2]) -> Vec<Self> {
        let step = TAU / headings as f64;
        (0..headings).map(|k| Self::of(k as f64 * step, spacing)).collect()
    }

    /// The direction of a heading (rad), measured in cells.
    fn of(heading: f64, spacing: [f64; 2]) -> Self {
        let (sin, cos) = heading.sin_cos();
        let (x, y) = (cos / spacing[0], sin / spacing[1]);
        match (x.abs() >= y.abs(), x > 0.0, y > 0.0) {
            (true, true, _) => Direction::Right,
            (true, false, _) => Direction::Left,
            (false, _, true) => Direction::Up,
            (false, _, false) => Direction::Down,
        }
    }

    /// The number of the region of the steps from a grid point in this direction.
    #[inline]
    pub(crate) fn region(self, parts: &LatticeParts, i: usize, j: usize) -> usize {
        let Shape { nx, ny, .. } = parts.shape;
        parts.region_of.get((self as usize * nx + i) * ny + j).map_or(0, |region| usize::from(*region))
    }

    pub(crate) fn is_vertical(self) -> bool {
        matches!(self, Direction::Up | Direction::Down)
    }

    pub(crate) fn is_reversed(self) -> bool {
        matches!(self, Direction::Left | Direction::Down)
    }

    /// A displacement along (u, v), where u points in this direction.
    pub(crate) fn orient(self, shift: Shift) -> Shift {
        let Shift { mut cell, mut fraction } = shift;
        if self.is_vertical() {
            cell.swap(0, 1);
            fraction.swap(0, 1);
        }
        if self.is_reversed() {
            // -(cell + fraction) = -(cell + 1) + (1 - fraction).
            cell[0] = -cell[0];
            if fraction[0] > 0.0 {
                cell[0] -= 1;
                fraction[0] = 1.0 - fraction[0];
            }
        }
        Shift { cell, fraction }
    }
}

/// Which headings a sector has: `first .. first + count`, modulo the number of headings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Arc {
    pub direction: Direction,
    pub first: usize,
    pub count: usize,
}

/// Headings `begin .. begin + count` of a sector, which are those from `heading` on of the circle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Run {
    pub begin: usize,
    pub count: usize,
    pub heading: usize,
}

impl Arc {
    /// The headings of each direction: they are consecutive on the circle. Directions without a heading are left out.
    pub(crate) fn all(directions: &[Direction]) -> Vec<Arc> {
        let n = directions.len();
        let arc = |direction: Direction| {
            let count = directions.iter().filter(|d| **d == direction).count();
            let begins = |k: &usize| directions[*k] == direction && directions[(k + n - 1) % n] != direction;
            (count > 0).then(|| Arc { direction, first: (0..n).find(begins).unwrap_or(0), count })
        };
        Direction::ALL.into_iter().filter_map(arc).collect()
    }

    /// Grid points along u and along v.
    pub(crate) fn extent(self, shape: Shape) -> [usize; 2] {
        if self.direction.is_vertical() { [shape.ny, shape.nx] } else { [shape.nx, shape.ny] }
    }

    /// The heading index of heading `q` of the sector.
    pub(crate) fn heading(self, q: usize, headings: usize) -> usize {
        (self.first + q) % headings
    }

    /// The headings as consecutive ones of a table: they may run over the end of the circle.
    pub(crate) fn runs(self, headings: usize) -> [Run; 2] {
        let before = (headings - self.first).min(self.count);
        [
            Run { begin: 0, count: before, heading: self.first },
            Run { begin: before, count: self.count - before, heading: 0 },
        ]
    }

    /// The states of a table, `[i][j][heading][bevel]`, from `heading` on at the points of a column of the sector from
    /// `first` on: a row for each point.
    pub(crate) fn table_plane(self, shape: Shape, place: usize, first: usize, heading: usize) -> Plane {
        let point = shape.headings * 2;
        let (i, j, stride) =
            if self.direction.is_vertical() { (first, place, shape.ny * point) } else { (place, first, point) };
        Plane { start: (i * shape.ny + j) * point + heading * 2, stride }
    }

    /// All (heading of the sector, bevel).
    pub(crate) fn planes(self) -> impl Iterator<Item = (usize, usize)> {
        (0..self.count * 2).map(|plane| (plane / 2, plane % 2))
    }
}
