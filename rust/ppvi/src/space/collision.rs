//! What is where: codes of voxels, finer than the grid of the values.
//!
//! Values live at grid points, collisions are tested in voxels. Each spacing of the grid is divided into r voxels along each
//! axis; r is the *refinement*. The grid point i is the centre of voxel r i, so the voxel with the number f reaches from
//! (f - 1/2) / r to (f + 1/2) / r spacings. The voxels of a grid with n points have the numbers 0 to r n - 1.

use std::sync::Arc;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::memory::is_granted;

/// Codes of voxels. Those of the ends are the codes of [`crate::lattice::outcome`].
pub mod voxel {
    /// The execution goes on.
    pub const FREE: u8 = 0;
    /// The execution succeeds.
    pub const TARGET: u8 = 1;
    /// The execution ends with a collision.
    pub const OBSTACLE: u8 = 2;
    /// The execution has left the workspace.
    pub const OUTSIDE: u8 = 3;
}

/// Codes in a word, two bits each.
const CODES: usize = 32;

/// Largest refinement: 8^3 voxels for each grid point.
const MOST_REFINEMENT: usize = 8;

/// Largest number of voxels along an axis, so that places fit into an i32.
const MOST_VOXELS: usize = 1 << 24;

/// Codes of [`voxel`] of all voxels of a grid, two bits each. Clones share them.
#[derive(Debug, Clone, PartialEq)]
pub struct CollisionGrid {
    points: [usize; 3],
    refinement: usize,
    /// Words of a row along z.
    row: usize,
    words: Arc<Vec<u64>>,
    /// Codes at the grid points, `[i][j][k]`.
    at_points: Arc<Vec<u8>>,
}

impl CollisionGrid {
    /// Makes the codes of all voxels, slice by slice and in parallel: `fill(f, codes)` writes those of the slice `f`, which are
    /// free before, `[y][z]`.
    ///
    /// # Errors
    /// [`Error::Parameter`] for an empty grid, a refinement outside 1 to 8, or codes above 3; [`Error::TooLarge`] for more
    /// voxels than fit into the memory.
    pub fn build(points: [usize; 3], refinement: usize, fill: impl Fn(usize, &mut [u8]) + Sync) -> Result<Self> {
        if !(1..=MOST_REFINEMENT).contains(&refinement) {
            return Err(Error::parameter("refinement", refinement, "must be between 1 and 8"));
        }
        if points.iter().any(|count| !(1..=MOST_VOXELS / refinement).contains(count)) {
            return Err(Error::parameter("points", format!("{points:?}"), "must be at least one along each axis"));
        }
        let [nx, ny, nz] = points.map(|count| count * refinement);
        let row = nz.div_ceil(CODES);
        let needed_bytes = (nx * ny) as u128 * (row * size_of::<u64>()) as u128;
        if !is_granted(needed_bytes) {
            let rule = "more voxels than the memory; use a coarser grid";
            return Err(Error::TooLarge { states: (nx * ny) as u128 * nz as u128, needed_bytes, rule });
        }
        let mut words = vec![0; nx * ny * row];
        let wrong = words
            .par_chunks_mut(ny * row)
            .enumerate()
            .map_init(
                || vec![voxel::FREE; ny * nz],
                |codes, (slice, words)| {
                    codes.fill(voxel::FREE);
                    fill(slice, codes);
                    for (codes, words) in codes.chunks_exact(nz).zip(words.chunks_exact_mut(row)) {
                        for (codes, word) in codes.chunks(CODES).zip(words) {
                            *word = codes.iter().rev().fold(0, |word, code| word << 2 | u64::from(code & 3));
                        }
                    }
                    codes.iter().copied().max().unwrap_or_default()
                },
            )
            .max()
            .filter(|code| *code > voxel::OUTSIDE);
        if let Some(code) = wrong {
            return Err(Error::parameter("voxels", code, "must be codes of voxels, 0 to 3"));
        }
        let mut grid = CollisionGrid { points, refinement, row, words: Arc::new(words), at_points: Arc::default() };
        let at = |point: usize| {
            let place = [point / points[2] / points[1], point / points[2] % points[1], point % points[2]];
            grid.code(place.map(|at| (at * refinement) as i32))
        };
        grid.at_points = Arc::new((0..points.iter().product()).map(at).collect());
        Ok(grid)
    }

    /// Takes the codes of all voxels, `[x][y][z]`.
    ///
    /// # Errors
    /// As [`CollisionGrid::build`], and [`Error::Length`] for another number of codes.
    pub fn new(points: [usize; 3], refinement: usize, codes: &[u8]) -> Result<Self> {
        let expected = points.iter().map(|count| count * refinement).product();
        if codes.len() != expected {
            return Err(Error::Length { name: "voxels", expected, found: codes.len() });
        }
        let slice = expected / (points[0] * refinement).max(1);
        CollisionGrid::build(points, refinement, |at, of_slice| {
            of_slice.copy_from_slice(&codes[at * slice..][..slice]);
        })
    }

    /// Numbers of grid points.
    pub fn points(&self) -> [usize; 3] {
        self.points
    }

    /// Voxels for each spacing along an axis.
    pub fn refinement(&self) -> usize {
        self.refinement
    }

    /// Numbers of voxels along the axes.
    pub fn shape(&self) -> [usize; 3] {
        self.points.map(|count| count * self.refinement)
    }

    /// Codes of the voxels of which grid points are the centres, `[i][j][k]`.
    pub fn at_points(&self) -> &[u8] {
        &self.at_points
    }

    /// Code of a voxel; outside beyond the grid.
    #[inline]
    pub fn code(&self, [x, y, z]: [i32; 3]) -> u8 {
        let [nx, ny, nz] = self.points;
        let r = self.refinement;
        let (x, y, z) = (x as u32 as usize, y as u32 as usize, z as u32 as usize);
        if x >= nx * r || y >= ny * r || z >= nz * r {
            return voxel::OUTSIDE;
        }
        let word = self.words[(x * ny * r + y) * self.row + z / CODES];
        (word >> (z % CODES * 2) & 3) as u8
    }

    /// The codes of a row along z, two bits each from the lowest on.
    pub(crate) fn row(&self, x: usize, y: usize) -> &[u64] {
        &self.words[(x * self.points[1] * self.refinement + y) * self.row..][..self.row]
    }

    /// Writes the codes of a slice, `[y][z]`.
    pub fn slice(&self, x: usize, codes: &mut [u8]) {
        let [_, ny, nz] = self.shape();
        for (y, codes) in codes.chunks_exact_mut(nz).enumerate().take(ny) {
            for (codes, word) in codes.chunks_mut(CODES).zip(self.row(x, y)) {
                codes.iter_mut().enumerate().for_each(|(at, code)| *code = (word >> (2 * at) & 3) as u8);
            }
        }
    }

    /// Calls `visit(z, code)` for the voxels of a row that are not free.
    pub fn for_each_code(&self, x: usize, y: usize, mut visit: impl FnMut(usize, u8)) {
        for (number, word) in self.row(x, y).iter().enumerate() {
            let mut left = *word;
            while left != 0 {
                let at = left.trailing_zeros() as usize / 2;
                visit(number * CODES + at, (word >> (2 * at) & 3) as u8);
                left &= !(3 << (2 * at));
            }
        }
    }

    /// Calls `visit(j, k)` for the grid points of a slice that have a voxel with a code, perhaps several times.
    pub(crate) fn for_each_point(&self, slice: usize, code: u8, mut visit: impl FnMut(usize, usize)) {
        let r = self.refinement;
        for (x, y) in (slice * r..(slice + 1) * r).flat_map(|x| (0..self.points[1] * r).map(move |y| (x, y))) {
            self.for_each_code(x, y, |z, found| {
                if found == code {
                    visit(y / r, z / r);
                }
            });
        }
    }

    /// The voxels of a part of the grid: so many points from a grid point on.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a part that is not in the grid.
    pub fn part(&self, first: [usize; 3], points: [usize; 3]) -> Result<Self> {
        if (0..3).any(|axis| first[axis] + points[axis] > self.points[axis]) {
            return Err(Error::parameter("points", format!("{first:?}, {points:?}"), "must be a part of the grid"));
        }
        let [low, count] = [first, points].map(|place| place.map(|at| at * self.refinement));
        CollisionGrid::build(points, self.refinement, |x, codes| {
            for (y, codes) in codes.chunks_exact_mut(count[2]).enumerate() {
                self.for_each_code(low[0] + x, low[1] + y, |z, code| {
                    if let Some(known) = z.checked_sub(low[2]).and_then(|z| codes.get_mut(z)) {
                        *known = code;
                    }
                });
            }
        })
    }

    /// The place of a voxel relative to the grid: which of the voxels of a grid point it is, and the grid point, both along
    /// each axis. Voxels before the first one belong to points before the first one.
    #[inline]
    pub(crate) fn place(&self, voxel: [i32; 3]) -> ([usize; 3], [i32; 3]) {
        let r = self.refinement as i32;
        (voxel.map(|at| at.rem_euclid(r) as usize), voxel.map(|at| at.div_euclid(r)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_that_were_given() {
        let (points, r) = ([2, 3, 13], 3);
        let [nx, ny, nz] = points.map(|count| count * r);
        let codes: Vec<u8> = (0..nx * ny * nz).map(|at| (at * 7 % 11 % 4) as u8).collect();
        let grid = CollisionGrid::new(points, r, &codes).unwrap();
        for (at, code) in codes.iter().enumerate() {
            let place = [at / nz / ny, at / nz % ny, at % nz];
            assert_eq!(grid.code(place.map(|at| at as i32)), *code);
            if place.iter().all(|at| at % r == 0) {
                let [i, j, k] = place.map(|at| at / r);
                assert_eq!(grid.at_points()[(i * points[1] + j) * points[2] + k], *code);
            }
        }
        for beyond in [[-1, 0, 0], [0, ny as i32, 0], [0, 0, nz as i32], [i32::MIN, 0, 0]] {
            assert_eq!(grid.code(beyond), voxel::OUTSIDE);
        }
        let mut slice = vec![9; ny * nz];
        grid.slice(4, &mut slice);
        assert_eq!(slice, codes[4 * ny * nz..][..ny * nz]);
        let part = grid.part([1, 1, 2], [1, 2, 10]).unwrap();
        for (x, y, z) in [(0, 0, 0), (2, 5, 29), (1, 3, 7)] {
            assert_eq!(part.code([x, y, z]), grid.code([x + 3, y + 3, z + 6]));
        }
        assert_eq!(grid.place([-1, 4, 0]), ([2, 1, 0], [-1, 1, 0]));
    }

    #[test]
    fn wrong_grids_are_refused() {
        let codes = vec![0; 8];
        assert!(CollisionGrid::new([2; 3], 1, &codes).is_ok());
        assert!(CollisionGrid::new([2; 3], 2, &codes).is_err());
        assert!(CollisionGrid::new([2; 3], 0, &[]).is_err() && CollisionGrid::new([0, 2, 2], 1, &[]).is_err());
        assert!(CollisionGrid::new([1; 3], 9, &[0; 729]).is_err());
        assert!(CollisionGrid::new([2; 3], 1, &[0, 0, 4, 0, 0, 0, 0, 0]).is_err());
        assert!(CollisionGrid::new([2; 3], 1, &codes).unwrap().part([1, 0, 0], [2, 1, 1]).is_err());
    }
}
