//! A segmentation in the voxels of a lattice: which voxels an obstacle of the file reaches.
//!
//! Voxels of the file and of the lattice are boxes of two orientations. A box of the lattice is blocked by a box of an
//! obstacle that is grown by g if no axis separates them by at least g. The tested axes are unit vectors: the normals of both
//! boxes, their cross products (Gottschalk, Lin and Manocha 1996), and the direction from the nearest point of the box of
//! the file to the centre of the other one. With g = 0, exactly the boxes with a common volume are blocked. With g > 0 every
//! box closer than g is, and beside edges and corners some that are a little farther away. The orientations are the same for
//! all pairs, so the extent of both boxes along an axis is a constant.

use ppvi::space::voxel;
use ppvi::{Error, Result};
use rayon::prelude::*;

use crate::space::arc::Vec3;

/// Overlap, mm, that counts as rounding.
const ROUNDING_MM: f64 = 1e-6;

/// Cross products that are shorter belong to parallel axes.
const PARALLEL: f64 = 1e-6;

/// Voxels of a file, and their place in a lattice.
#[derive(Debug, Clone, Copy)]
pub struct Segmentation<'a> {
    /// Numbers of voxels along i, j and k.
    pub shape: [usize; 3],
    /// Codes of [`voxel`] for lattice voxels with the centre in a voxel, `[i][j][k]`.
    pub codes: &'a [u8],
    /// Kind of the obstacle of each voxel, `[i][j][k]`; 0: none.
    pub obstacles: &'a [u8],
    /// Distance, mm, by which obstacles of each kind are grown, from kind 1 on.
    pub growth_mm: &'a [f64],
    /// Rows: the unit vectors of i, j and k in the lattice.
    pub axes: [Vec3; 3],
    /// Size of a voxel, mm.
    pub sizes_mm: Vec3,
    /// Centre of voxel (0, 0, 0) in the lattice, mm.
    pub origin_mm: Vec3,
}

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A voxel of an obstacle: its centre and its growth, mm.
type Body = (Vec3, f64);

/// How two boxes lie to each other.
struct Pair {
    /// Unit vectors, and half of the extent of both boxes along them.
    axes: Vec<(Vec3, f64)>,
    of_file: [Vec3; 3],
    half_of_file: Vec3,
    half: f64,
}

impl Pair {
    fn new(of_file: [Vec3; 3], sizes: Vec3, size: f64) -> Self {
        let (half_of_file, half) = (sizes.map(|size| 0.5 * size), 0.5 * size);
        let unit = |axis: usize| [0, 1, 2].map(|at| f64::from(u8::from(at == axis)));
        let mut axes: Vec<Vec3> = (0..3).map(unit).chain(of_file).collect();
        for (own, its) in (0..3).flat_map(|own| of_file.map(|its| (unit(own), its))) {
            let cross = [0, 1, 2].map(|at| {
                let (next, last) = ((at + 1) % 3, (at + 2) % 3);
                own[next] * its[last] - own[last] * its[next]
            });
            let length = dot(cross, cross).sqrt();
            if length > PARALLEL {
                axes.push(cross.map(|x| x / length));
            }
        }
        let extent = |axis: &Vec3| {
            let of_lattice: f64 = axis.iter().map(|x| half * x.abs()).sum();
            of_lattice + (0..3).map(|at| half_of_file[at] * dot(*axis, of_file[at]).abs()).sum::<f64>()
        };
        let axes = axes.iter().map(|axis| (*axis, extent(axis))).collect();
        Pair { axes, of_file, half_of_file, half }
    }

    /// Whether a box whose centre is at `apart` from that of a box of the file is blocked by it.
    #[inline]
    fn is_blocked(&self, apart: Vec3, growth: f64) -> bool {
        let least = growth - ROUNDING_MM;
        if self.axes.iter().any(|(axis, extent)| dot(*axis, apart).abs() - extent >= least) {
            return false;
        }
        let mut away = [0.0; 3];
        for (axis, half) in self.of_file.into_iter().zip(self.half_of_file) {
            let along = dot(apart, axis);
            let beyond = (along.abs() - half).max(0.0) * along.signum();
            (0..3).for_each(|at| away[at] += beyond * axis[at]);
        }
        let distance = dot(away, away).sqrt();
        let extent: f64 = away.iter().map(|x| self.half * x.abs()).sum();
        distance <= ROUNDING_MM || distance - extent / distance < least
    }
}

impl Segmentation<'_> {
    /// Codes of the voxels of a lattice, `[x][y][z]`: so many, with the size `size_mm`; the centre of the first is the origin.
    /// Beyond the file is outside.
    ///
    /// # Errors
    /// [`Error::Length`] for arrays of another shape, [`Error::Parameter`] for a kind without a growth.
    pub fn codes_of(&self, count: [usize; 3], size_mm: f64) -> Result<Vec<u8>> {
        let expected: usize = self.shape.iter().product();
        for (name, found) in [("codes", self.codes.len()), ("obstacles", self.obstacles.len())] {
            if found != expected {
                return Err(Error::Length { name, expected, found });
            }
        }
        let highest = self.obstacles.par_iter().copied().max().unwrap_or(0);
        if usize::from(highest) > self.growth_mm.len() {
            return Err(Error::parameter("obstacles", highest, "must be kinds with a growth"));
        }
        let pair = Pair::new(self.axes, self.sizes_mm, size_mm);
        let slices = self.bodies_of_slices(count, size_mm, &pair);
        let (plane, mut codes) = (count[1] * count[2], vec![voxel::FREE; count.iter().product()]);
        codes.par_chunks_mut(plane.max(1)).zip(slices).enumerate().for_each(|(x, (codes, bodies))| {
            self.read(x, count, size_mm, codes);
            for (centre, growth) in &bodies {
                let range = |axis: usize| self.range(&pair, axis, (*centre, *growth), count[axis], size_mm);
                for (y, z) in range(1).flat_map(|y| range(2).map(move |z| (y, z))) {
                    let code = &mut codes[y * count[2] + z];
                    let at = [x, y, z].map(|at| at as f64 * size_mm);
                    let apart = [0, 1, 2].map(|axis| at[axis] - centre[axis]);
                    if *code != voxel::OBSTACLE && *code != voxel::OUTSIDE && pair.is_blocked(apart, *growth) {
                        *code = voxel::OBSTACLE;
                    }
                }
            }
        });
        Ok(codes)
    }

    /// The voxels of a lattice, along an axis, that a body can block.
    fn range(&self, pair: &Pair, axis: usize, body: Body, count: usize, size: f64) -> std::ops::Range<usize> {
        let reach = pair.axes[axis].1 + body.1;
        let [low, high] = [-reach, reach].map(|by| (body.0[axis] + by) / size);
        low.ceil().max(0.0) as usize..((high.floor() + 1.0).max(0.0) as usize).min(count)
    }

    /// The voxels of obstacles that can block voxels of each slice of a lattice. Those without a free neighbour are not grown.
    fn bodies_of_slices(&self, count: [usize; 3], size: f64, pair: &Pair) -> Vec<Vec<Body>> {
        let [ni, nj, nk] = self.shape;
        let place = |i: usize, j: usize, k: usize| (i * nj + j) * nk + k;
        let of_slice = |i: usize| {
            let mut bodies = Vec::new();
            for (j, k) in (0..nj).flat_map(|j| (0..nk).map(move |k| (j, k))) {
                let kind = self.obstacles[place(i, j, k)];
                if kind == 0 {
                    continue;
                }
                let index = [i, j, k].map(|at| at as f64);
                let centre = [0, 1, 2].map(|at| {
                    let of_axis = |axis: usize| index[axis] * self.sizes_mm[axis] * self.axes[axis][at];
                    self.origin_mm[at] + of_axis(0) + of_axis(1) + of_axis(2)
                });
                let growth = self.growth_mm[usize::from(kind) - 1];
                let near = |axis: usize| !self.range(pair, axis, (centre, growth), count[axis], size).is_empty();
                if !(near(0) && near(1) && near(2)) {
                    continue;
                }
                let around = |at: usize, count: usize| at.saturating_sub(1)..(at + 2).min(count);
                let is_inner = || {
                    let inside = |i: usize, j: usize| around(k, nk).all(|k| self.obstacles[place(i, j, k)] == kind);
                    around(i, ni).all(|i| around(j, nj).all(|j| inside(i, j)))
                };
                bodies.push((centre, if growth > 0.0 && is_inner() { 0.0 } else { growth }));
            }
            bodies
        };
        let all: Vec<Vec<Body>> = (0..ni).into_par_iter().map(of_slice).collect();
        let mut slices = vec![Vec::new(); count[0]];
        for body in all.into_iter().flatten() {
            self.range(pair, 0, body, count[0], size).for_each(|x| slices[x].push(body));
        }
        slices
    }

    /// Reads the codes at the centres of the voxels of a slice.
    fn read(&self, x: usize, count: [usize; 3], size: f64, codes: &mut [u8]) {
        for (y, codes) in codes.chunks_exact_mut(count[2]).enumerate() {
            for (z, code) in codes.iter_mut().enumerate() {
                let at = [x, y, z].map(|at| at as f64 * size);
                let apart = [0, 1, 2].map(|axis| at[axis] - self.origin_mm[axis]);
                let index = [0, 1, 2].map(|axis| dot(apart, self.axes[axis]) / self.sizes_mm[axis] + 0.5);
                let is_within = (0..3).all(|axis| index[axis] >= 0.0 && index[axis] < self.shape[axis] as f64);
                *code = match is_within {
                    true => {
                        let [i, j, k] = index.map(|at| at as usize);
                        self.codes[(i * self.shape[1] + j) * self.shape[2] + k]
                    }
                    false => voxel::OUTSIDE,
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(angle: f64) -> [Vec3; 3] {
        let (sin, cos) = angle.sin_cos();
        [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]
    }

    /// The voxels that one obstacle of 1.2 x 0.8 x 2 mm at (5, 5, 5) blocks.
    fn blocked(angle: f64, growth: f64, size: f64, count: usize) -> Vec<[f64; 3]> {
        let one = Segmentation {
            shape: [1; 3],
            codes: &[voxel::FREE],
            obstacles: &[1],
            growth_mm: &[growth],
            axes: turned(angle),
            sizes_mm: [1.2, 0.8, 2.0],
            origin_mm: [5.0; 3],
        };
        // Codes outside are free here, so that only the obstacle counts.
        let pair = Pair::new(one.axes, one.sizes_mm, size);
        let all = (0..count.pow(3)).map(|at| [at / count / count, at / count % count, at % count]);
        let places = all.map(|place| place.map(|at| at as f64 * size));
        places.filter(|at| pair.is_blocked(at.map(|x| x - 5.0), growth)).collect()
    }

    /// Distance of a point from the obstacle.
    fn distance(angle: f64, at: Vec3) -> f64 {
        let beyond = turned(angle).into_iter().zip([0.6, 0.4, 1.0]);
        beyond.map(|(axis, half)| (dot(at.map(|x| x - 5.0), axis).abs() - half).max(0.0).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn voxels_with_a_point_near_an_obstacle_are_blocked_and_those_far_away_are_not() {
        for (angle, growth) in [(0.0, 0.0), (0.4, 0.0), (0.9, 0.7), (0.0, 0.3)] {
            let size = 0.3;
            let found = blocked(angle, growth, size, 34);
            let all = (0..34usize.pow(3)).map(|at| [at / 34 / 34, at / 34 % 34, at % 34].map(|at| at as f64 * size));
            for at in all {
                // Points of the voxel, its surface left out.
                let points =
                    (0..343).map(|n| [n / 49, n / 7 % 7, n % 7].map(|n| 0.3 * (f64::from(n) / 3.0 - 1.0) * 0.499));
                let points = points.map(|by| [0, 1, 2].map(|axis| at[axis] + by[axis]));
                let least = points.map(|point| distance(angle, point)).fold(f64::INFINITY, f64::min);
                let is_blocked = found.contains(&at);
                if least < growth || (growth == 0.0 && least == 0.0) {
                    assert!(is_blocked, "{angle} {growth} {at:?} {least}");
                }
                if least > growth + 0.15 {
                    assert!(!is_blocked, "{angle} {growth} {at:?} {least}");
                }
            }
            assert!(found.len() > 50);
        }
    }

    #[test]
    fn boxes_that_only_touch_are_free() {
        // Voxels of 0.2 mm, whose faces lie on those of the obstacle: 6 x 4 x 10 of them are in it.
        let pair = Pair::new(turned(0.0), [1.2, 0.8, 2.0], 0.2);
        let all = (0..24i32.pow(3)).map(|at| [at / 576 - 12, at / 24 % 24 - 12, at % 24 - 12]);
        let within = all.filter(|place| pair.is_blocked(place.map(|at| 0.2 * (f64::from(at) + 0.5)), 0.0));
        assert_eq!(within.count(), 240);
    }

    #[test]
    fn codes_are_read_at_centres_and_the_end_of_the_file_is_outside() {
        let codes = [voxel::FREE, voxel::TARGET, voxel::OUTSIDE, voxel::FREE];
        let file = Segmentation {
            shape: [4, 1, 1],
            codes: &codes,
            obstacles: &[0, 0, 2, 2],
            growth_mm: &[0.0, 0.0],
            axes: turned(0.0),
            sizes_mm: [1.0, 4.0, 4.0],
            origin_mm: [0.5, 0.0, 0.0],
        };
        let found = file.codes_of([11, 1, 1], 0.5).unwrap();
        assert_eq!(found, [0, 0, 1, 1, 3, 3, 2, 2, 3, 3, 3]);
        assert!(Segmentation { growth_mm: &[0.0], ..file }.codes_of([2, 1, 1], 0.5).is_err());
        assert!(Segmentation { codes: &codes[1..], ..file }.codes_of([2, 1, 1], 0.5).is_err());
    }
}
