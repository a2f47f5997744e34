//! Open space: where a path is too short to meet anything, and needs no test.
//!
//! Each spacing of the grid is divided into two cells along each axis, if its voxels allow it. A cell is open if all its voxels are free, the
//! box around the target does not touch it, and the grid points nearest to its corners have one tissue. The depth of a cell is the
//! number of rings of open cells around it, itself included: 0 if it is not open. A path that begins in a cell of depth d and is
//! shorter than d - 1 cells stays in open cells, which have one tissue, since neighbours share corners.

use rayon::prelude::*;

use crate::space::arc::Vec3;
use crate::space::volume::Volume;

/// Largest depth. A part of a step is rarely longer than four spacings.
const MOST_DEPTH: u8 = 10;

/// Cells for each spacing, if so many divide its voxels.
const CELLS: usize = 2;

/// Depths of all cells.
#[derive(Debug, Clone)]
pub(crate) struct OpenSpace {
    shape: [usize; 3],
    /// Voxels of a cell along each axis.
    voxels: usize,
    /// Least size of a cell along an axis, mm.
    size: f64,
    depths: Vec<u8>,
}

impl OpenSpace {
    /// Finds the depths of the cells of a volume.
    pub(crate) fn new(volume: &Volume) -> Self {
        let r = volume.voxels().refinement();
        let cells = if r.is_multiple_of(CELLS) { CELLS } else { 1 };
        let (shape, voxels) = (volume.shape().map(|points| points * cells), r / cells);
        let mut open = vec![1u8; shape.iter().product()];
        let slices = open.par_chunks_mut(shape[1] * shape[2]).enumerate();
        slices.for_each(|(slice, open)| mark(volume, [slice, shape[1], shape[2]], voxels, open));
        let mut depths = open.clone();
        for _ in 1..MOST_DEPTH {
            if !open.contains(&1) {
                break;
            }
            erode(&mut open, shape);
            depths.par_iter_mut().zip(&open).for_each(|(depth, open)| *depth += open);
        }
        let size = volume.spacing().into_iter().fold(f64::INFINITY, f64::min) / cells as f64;
        OpenSpace { shape, voxels, size, depths }
    }

    /// Length, mm, of the paths from a point that meet nothing and stay in its tissue: shorter ones than this.
    #[inline]
    pub(crate) fn around(&self, volume: &Volume, point: Vec3) -> f64 {
        let [x, y, z] = volume.cell(point).map(|voxel| voxel as u32 as usize / self.voxels);
        if x >= self.shape[0] || y >= self.shape[1] || z >= self.shape[2] {
            return 0.0;
        }
        let depth = self.depths[(x * self.shape[1] + y) * self.shape[2] + z];
        f64::from(depth.saturating_sub(1)) * self.size
    }
}

/// Marks with 0 the cells of a slice, of `ny` by `nz`, that are not open.
fn mark(volume: &Volume, [slice, ny, nz]: [usize; 3], voxels: usize, open: &mut [u8]) {
    let (grid, points, r) = (volume.voxels(), volume.shape(), volume.voxels().refinement());
    for (x, y) in (slice * voxels..(slice + 1) * voxels).flat_map(|x| (0..ny * voxels).map(move |y| (x, y))) {
        grid.for_each_code(x, y, |z, _| open[y / voxels * nz + z / voxels] = 0);
    }
    if let Some(body) = volume.target() {
        let face = |cell: usize, axis: usize| ((cell * voxels) as f64 - 0.5) * volume.spacing()[axis] / r as f64;
        for (number, open) in open.iter_mut().enumerate() {
            let cell = [slice, number / nz, number % nz];
            let [low, high] = [0, 1].map(|end| [0, 1, 2].map(|axis| face(cell[axis] + end, axis)));
            *open &= u8::from(!body.is_near(low, high));
        }
    }
    let tissues = volume.tissues();
    if tissues.is_empty() {
        return;
    }
    // The grid points that are nearest to the faces of a cell.
    let corners = |cell: usize, axis: usize| {
        [cell, cell + 1].map(|face| ((2 * face * voxels + r).saturating_sub(1) / (2 * r)).min(points[axis] - 1))
    };
    let tissue = |[x, y, z]: [usize; 3]| tissues[(x * points[1] + y) * points[2] + z];
    for (number, open) in open.iter_mut().enumerate() {
        let [xs, ys, zs] = [corners(slice, 0), corners(number / nz, 1), corners(number % nz, 2)];
        let own = tissue([xs[0], ys[0], zs[0]]);
        let is_own = |x: usize| ys.into_iter().all(|y| zs.into_iter().all(|z| tissue([x, y, z]) == own));
        *open &= u8::from(xs.into_iter().all(is_own));
    }
}

/// Keeps the cells whose 26 neighbours are all open.
fn erode(open: &mut [u8], [nx, ny, nz]: [usize; 3]) {
    let plane = ny * nz;
    open.par_chunks_mut(plane).for_each(|slice| {
        for row in slice.chunks_exact_mut(nz) {
            erode_line(row, 1);
        }
        erode_line(slice, nz);
    });
    // Threads share the columns along the axis only if each copies them, which takes longer than this.
    if nx > 0 {
        erode_line(open, plane);
    }
}

/// The same along one axis, in which neighbours are `stride` apart.
fn erode_line(line: &mut [u8], stride: usize) {
    let mut before = vec![0; stride];
    for start in (0..line.len()).step_by(stride) {
        let (own, next) = line[start..].split_at_mut(stride);
        for (at, own) in own.iter_mut().enumerate() {
            let kept = before[at] & *own & next.get(at).copied().unwrap_or(0);
            (before[at], *own) = (*own, kept);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::target::TargetBody;
    use crate::space::{SpaceCosts, SpaceExecutor, SpacePose, SpaceProblem, SpaceSetup};
    use crate::workspace::Event;
    use ppvi::space::{CollisionGrid, PassOptions, solve, voxel};

    fn numbers() -> impl FnMut() -> f64 {
        let mut state = 5u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    #[test]
    fn nothing_is_met_and_the_tissue_stays_on_ways_that_are_shorter_than_it_says() {
        let (points, spacing, mut random) = ([18, 16, 14], [2.0, 1.5, 2.5], numbers());
        for (refinement, with_target) in [(1, false), (3, true), (2, false)] {
            let shape = points.map(|count| count * refinement);
            let mut codes = vec![voxel::FREE; shape.iter().product()];
            for _ in 0..3 {
                let at = shape.map(|count| (random() * count as f64) as usize);
                codes[(at[0] * shape[1] + at[1]) * shape[2] + at[2]] = 1 + (3.0 * random()) as u8;
            }
            let tissues = (0..points.iter().product::<usize>()).map(|at| u8::from(at / (16 * 14) > 11)).collect();
            let body = TargetBody::ball([20.0, 12.0, 20.0], 2.2).unwrap();
            let voxels = CollisionGrid::new(points, refinement, &codes).unwrap();
            let volume = Volume::new(voxels, spacing, tissues, &[40.0, 60.0]).unwrap();
            let volume = volume.with_target(with_target.then_some(body));
            let space = OpenSpace::new(&volume);
            let (mut open, mut deepest) = (0, 0.0f64);
            for _ in 0..20_000 {
                let from = [0, 1, 2].map(|axis| (random() * 1.2 - 0.1) * points[axis] as f64 * spacing[axis]);
                let free = space.around(&volume, from);
                (open, deepest) = (open + usize::from(free > 0.0), deepest.max(free));
                let way = [0; 3].map(|_| 2.0 * random() - 1.0);
                let length = way.iter().map(|part| part * part).sum::<f64>().sqrt();
                let share = free * random() / length;
                let to = [0, 1, 2].map(|axis| from[axis] + share * way[axis]);
                if free > 0.0 {
                    assert_eq!(volume.met(from, to).0, voxel::FREE);
                    assert_eq!([from, to].map(|point| volume.code(point)), [voxel::FREE; 2]);
                    assert_eq!(volume.curvature(from), volume.curvature(to));
                }
            }
            assert!(open > 3000 && deepest > 2.9, "{open} {deepest}");
        }
    }

    #[test]
    fn executions_are_those_in_which_every_piece_is_tested() {
        let points = [22, 14, 14];
        let code = |at: usize| match [at / (28 * 28), at / 28 % 28, at % 28] {
            [36..=43, 12..=15, 12..=15] => voxel::TARGET,
            [16..=20, 4..=10, 10..=18] => voxel::OBSTACLE,
            _ => voxel::FREE,
        };
        let codes: Vec<u8> = (0..44 * 28 * 28).map(code).collect();
        for with_tissues in [false, true] {
            let tissues = (0..22 * 14 * 14).map(|at| u8::from(at / (14 * 14) > 9)).collect();
            let tissues = if with_tissues { tissues } else { vec![] };
            let voxels = CollisionGrid::new(points, 2, &codes).unwrap();
            let mut problem = SpaceProblem::new(SpaceSetup {
                volume: Volume::new(voxels, [2.0; 3], tissues, &[40.0, 30.0]).unwrap(),
                advance: 2,
                rolls: 8,
                straight: None,
                cone: 45f64.to_radians(),
                direction_spacing: 9f64.to_radians(),
                noise: 3f64.to_radians(),
                costs: SpaceCosts { insertion_per_mm: 1.0, rotation: 2.0, collision: 1e4, exit: 1e4 },
                prices: vec![],
            })
            .unwrap();
            let tables = solve(problem.mdp(), &PassOptions::default(), None).unwrap();
            let start = SpacePose { position: [0.0, 12.0, 13.0], tangent: [1.0, 0.0, 0.0] };
            let runs =
                |problem: &SpaceProblem| SpaceExecutor::new(problem, &tables).unwrap().rollout(start, 400, 3).unwrap();
            let fast = runs(&problem);
            let mut closed = OpenSpace::new(&problem.setup().volume);
            closed.depths.fill(0);
            problem.open = closed.into();
            let slow = runs(&problem);
            // A tie between actions may fall to the other side by rounding.
            let apart =
                fast.iter().zip(&slow).filter(|(a, b)| a.event != b.event || (a.length - b.length).abs() > 1e-9);
            assert!(apart.count() <= 4);
            let reached = slow.iter().filter(|run| run.event == Event::Target).count();
            assert!((40..360).contains(&reached), "{reached}");
        }
    }
}
