//! A proof that no path exists: one backward pass over sets of poses, too large by construction.
//!
//! # What is proved
//!
//! A path is any curve whose curvature is nowhere larger than that of the most curved tissue, which stays in the cone, and whose
//! voxels are free from its start to the target: any roll angles, any duty cycles, changed anywhere, but no
//! noise. With p along the axis and the slope q = (dy/dp, dz/dp), a curvature of at most c means
//!
//! ```text
//! |dq/dp| <= K = c (1 + |q|^2)^(3/2),    (y, z)' = q.
//! ```
//!
//! So the position is the integral of the slope, and the slope is Lipschitz. The poses on a slice are covered by closed
//! cells: a voxel times a square of slopes with the half side r. A cell is *open* if a path might lead from one of its poses to
//! the target. From slope q0 the path stays, after the distance t, within q0 t +- K t^2 / 2 of its start on each axis; if it
//! arrives with q1 after the distance A, its displacement is within
//!
//! ```text
//! A (q0 + q1) / 2 +- (K^2 A^2 - (q1 - q0)^2) / (4 K),
//! ```
//!
//! the area between the steepest ways up and down. Both intervals are widened by the half sides of the cells. A cell is
//! open if its voxel is free, at each slice on the way some voxel of the interval is not an obstacle, and
//! either a target voxel lies in an interval, or an open cell of the slice at distance A does. Obstacles have so been
//! shrunk and the target grown, by as much as the cells are wide.
//!
//! Every path leads through open cells only (induction from the target backwards). So **no path starts in a cell that is
//! not open**. The reverse is not true: an open cell proves nothing.

use std::ops::RangeInclusive;

use ppvi::space::voxel;
use ppvi::{Error, Result, StopFlag};
use rayon::prelude::*;

use crate::space::arc::{SpacePose, unit};
use crate::space::volume::Volume;

/// What is known about the paths from a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SpaceVerdict {
    /// No path of this curvature leads to the target.
    Impossible,
    /// The policy succeeds with this probability.
    Possible(f64),
    /// Neither is shown.
    Undecided,
}

/// Widening of all intervals, mm, for the rounding of their ends.
const ROUNDING: f64 = 1e-7;

/// The open cells of a volume.
#[derive(Debug, Clone)]
pub struct Feasibility {
    volume: Volume,
    /// Half side of the squares of slopes.
    half: f64,
    /// Squares from the axis to the rim.
    reach: i32,
    words: usize,
    /// Bits `[slice][slope][j][k]`.
    open: Vec<Vec<u64>>,
}

/// Bits `[j][k]` of a slice.
type Plane = Vec<u64>;

/// Offsets of voxels along y and z.
type Reach = [RangeInclusive<i32>; 2];

impl Feasibility {
    /// Makes the pass for a volume and a cone with this half angle, rad, with squares of slopes with the side `slopes`, and
    /// steps of `advance` slices.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a cone outside (0, 80 degrees], a side outside [0.01, 1], or no advance.
    pub fn new(volume: &Volume, cone: f64, slopes: f64, advance: usize) -> Result<Self> {
        if !(cone > 0.0 && cone <= 80f64.to_radians()) {
            return Err(Error::parameter("cone_deg", cone.to_degrees(), "must be above 0 and at most 80"));
        }
        if !(0.01..=1.0).contains(&slopes) {
            return Err(Error::parameter("slopes", slopes, "must be between 0.01 and 1"));
        }
        if advance == 0 {
            return Err(Error::parameter("advance", advance, "must be at least one slice"));
        }
        if volume.voxels().refinement() != 1 {
            return Err(Error::parameter(
                "refinement",
                volume.voxels().refinement(),
                "must be 1: a voxel for each point",
            ));
        }
        let [slices, _, nz] = volume.shape();
        let reach = (cone.tan() / slopes + 0.5).ceil() as i32;
        let words = nz.div_ceil(64);
        let mut cells =
            Feasibility { volume: volume.clone(), half: 0.5 * slopes, reach, words, open: vec![Vec::new(); slices] };
        let planes = |kinds: fn(u8) -> bool| (0..slices).map(|slice| cells.plane(slice, kinds)).collect::<Vec<_>>();
        let pass = Pass {
            cells: &cells,
            limit: cone.tan(),
            curvature: volume.curvatures().iter().copied().fold(0.0, f64::max),
            advance,
            free: planes(|code| code == voxel::FREE),
            passable: planes(|code| code == voxel::FREE || code == voxel::TARGET),
            target: planes(|code| code == voxel::TARGET),
        };
        let mut open = vec![Vec::new(); slices];
        let stop = StopFlag::current();
        for slice in (0..slices).rev() {
            let side = 2 * reach + 1;
            let row = |number: i32| pass.open(slice, [number / side - reach, number % side - reach], &open);
            let rows: Vec<Plane> = (0..side * side)
                .into_par_iter()
                .map(|number| {
                    stop.check();
                    row(number)
                })
                .collect();
            open[slice] = rows.concat();
        }
        cells.open = open;
        Ok(cells)
    }

    /// Whether no path leads from a pose to the target. False also for what the pass does not cover: poses between two
    /// slices, outside the volume or the cone.
    pub fn is_impossible(&self, pose: SpacePose) -> bool {
        let [x, y, z] = unit(pose.tangent);
        let slices = pose.position[0] / self.volume.spacing()[0];
        let Some(index) = self.volume.index(pose.position) else { return false };
        if (slices - slices.round()).abs() > 1e-9 || x.is_nan() || x <= 0.0 {
            return false;
        }
        let square = [y / x, z / x].map(|slope| (slope / (2.0 * self.half)).round() as i32);
        if square.iter().any(|at| at.abs() > self.reach) || self.volume.voxels().at_points()[index] == voxel::TARGET {
            return false;
        }
        let [_, ny, nz] = self.volume.shape();
        let plane = &self.open[slices.round() as usize][self.number(square) * ny * self.words..][..ny * self.words];
        let (j, k) = (index / nz % ny, index % nz);
        plane[j * self.words + k / 64] >> (k % 64) & 1 == 0
    }

    /// Number of a square of slopes.
    fn number(&self, [u, v]: [i32; 2]) -> usize {
        ((u + self.reach) * (2 * self.reach + 1) + v + self.reach) as usize
    }

    /// The voxels of a slice whose codes are of a kind.
    fn plane(&self, slice: usize, kind: impl Fn(u8) -> bool) -> Plane {
        let [_, ny, nz] = self.volume.shape();
        let mut bits = vec![0; ny * self.words];
        for (point, code) in self.volume.voxels().at_points()[slice * ny * nz..][..ny * nz].iter().enumerate() {
            bits[point / nz * self.words + point % nz / 64] |= u64::from(kind(*code)) << (point % nz % 64);
        }
        bits
    }

    /// Adds to `sum` the voxels from which one of these offsets leads into the plane.
    fn dilate(&self, plane: &[u64], [rows, columns]: &Reach, sum: &mut [u64]) {
        let words = self.words;
        let mut along = vec![0u64; plane.len()];
        for by in columns.clone() {
            let (whole, shift) = (i64::from(by).div_euclid(64), i64::from(by).rem_euclid(64) as u32);
            for (row, along) in plane.chunks_exact(words).zip(along.chunks_exact_mut(words)) {
                let at = |word: i64| usize::try_from(word).ok().and_then(|word| row.get(word)).copied().unwrap_or(0);
                for (word, bits) in along.iter_mut().enumerate() {
                    let first = word as i64 + whole;
                    *bits |= if shift == 0 { at(first) } else { at(first) >> shift | at(first + 1) << (64 - shift) };
                }
            }
        }
        let count = (plane.len() / words) as i64;
        for by in rows.clone() {
            for row in 0.max(-i64::from(by))..count.min(count - i64::from(by)) {
                let from = (row + i64::from(by)) as usize * words;
                for word in 0..words {
                    sum[row as usize * words + word] |= along[from + word];
                }
            }
        }
    }
}

/// The backward pass.
struct Pass<'a> {
    cells: &'a Feasibility,
    /// Largest slope of the cone.
    limit: f64,
    /// Largest curvature, 1/mm.
    curvature: f64,
    advance: usize,
    free: Vec<Plane>,
    passable: Vec<Plane>,
    target: Vec<Plane>,
}

impl Pass<'_> {
    /// Offsets of the voxels that intervals of displacements along y and z reach from a voxel.
    fn offsets(&self, intervals: [[f64; 2]; 2]) -> Reach {
        [0, 1].map(|axis| {
            let ([low, high], spacing) = (intervals[axis], self.cells.volume.spacing()[axis + 1]);
            // Start and end are anywhere in their voxels.
            let wide = spacing + ROUNDING;
            ((low - wide) / spacing).ceil() as i32..=((high + wide) / spacing).floor() as i32
        })
    }

    /// Displacements at the distances from `t0` to `t1` from a slope of a square, on one axis.
    fn ahead(&self, slope: f64, [t0, t1]: [f64; 2], steepest: f64) -> [f64; 2] {
        let half = self.cells.half;
        let spread = |t: f64| half * t + 0.5 * steepest * t * t;
        [(slope * t0).min(slope * t1) - spread(t1), (slope * t0).max(slope * t1) + spread(t1)]
    }

    /// The open voxels of a slice for a square of slopes.
    fn open(&self, slice: usize, square: [i32; 2], open: &[Vec<u64>]) -> Plane {
        let cells = self.cells;
        let [slices, ny, _] = cells.volume.shape();
        let nothing = vec![0u64; ny * cells.words];
        let slope = square.map(|at| 2.0 * cells.half * f64::from(at));
        let nearest = square.map(|at| cells.half * f64::from((2 * at.abs() - 1).max(0)));
        if nearest[0].hypot(nearest[1]) > self.limit {
            return nothing;
        }
        // The steepest slope within the step decides the bound on its change.
        let spacing = cells.volume.spacing()[0];
        let length = self.advance as f64 * spacing;
        let bound = |slope: f64| self.curvature * (1.0 + slope * slope).powf(1.5);
        let largest = slope[0].hypot(slope[1]) + 1.5 * cells.half + bound(self.limit) * length;
        let steepest = bound(largest.min(self.limit));
        let reach = |t0: f64, t1: f64| self.offsets(slope.map(|slope| self.ahead(slope, [t0, t1], steepest)));
        let mut alive = self.free[slice].clone();
        let mut found = nothing.clone();
        let and = |bits: &mut Plane, with: &[u64]| bits.iter_mut().zip(with).for_each(|(bits, with)| *bits &= with);
        for ahead in 0..=self.advance {
            if slice + ahead >= slices {
                return found;
            }
            let t = ahead as f64 * spacing;
            // The voxels of this slice extend half a spacing to both sides.
            let mut hit = nothing.clone();
            let (from, to) = ((t - 0.5 * spacing).max(0.0), (t + 0.5 * spacing).min(length));
            cells.dilate(&self.target[slice + ahead], &reach(from, to), &mut hit);
            and(&mut hit, &alive);
            found.iter_mut().zip(&hit).for_each(|(found, hit)| *found |= hit);
            let mut passed = nothing.clone();
            cells.dilate(&self.passable[slice + ahead], &reach(t, t), &mut passed);
            and(&mut alive, &passed);
        }
        let mut on = nothing;
        let far = ((steepest * length / (2.0 * cells.half)).ceil() as i32) + 1;
        let plane = ny * cells.words;
        for u in (square[0] - far).max(-cells.reach)..=(square[0] + far).min(cells.reach) {
            for v in (square[1] - far).max(-cells.reach)..=(square[1] + far).min(cells.reach) {
                let apart =
                    [u - square[0], v - square[1]].map(|by| 2.0 * cells.half * f64::from((by.abs() - 1).max(0)));
                if apart[0].hypot(apart[1]) > steepest * length + 1e-9 {
                    continue;
                }
                let next = [u, v].map(|at| 2.0 * cells.half * f64::from(at));
                let interval = |axis: usize| {
                    let middle = 0.5 * length * (slope[axis] + next[axis]);
                    let bent = steepest * length * length / 4.0;
                    let spread = if steepest > 0.0 { bent - apart[axis] * apart[axis] / (4.0 * steepest) } else { 0.0 };
                    let spread = spread.max(0.0) + cells.half * length;
                    [middle - spread, middle + spread]
                };
                let source = &open[slice + self.advance][cells.number([u, v]) * plane..][..plane];
                cells.dilate(source, &self.offsets([interval(0), interval(1)]), &mut on);
            }
        }
        and(&mut on, &alive);
        found.iter_mut().zip(&on).for_each(|(found, on)| *found |= on);
        found
    }
}
