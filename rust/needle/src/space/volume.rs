//! A volume: what the tip meets, and how strongly the needle bends.

use ppvi::space::{CollisionGrid, voxel};
use ppvi::{Error, Result};

use crate::space::arc::Vec3;
use crate::space::target::{TargetBody, cell_of, crossed};

/// Share of a piece by which a way may enter an obstacle before the target, where both have a face at the same place.
const SAME_FACE: f64 = 1e-9;

/// A grid of points, the voxels between them in which collisions are tested, and the tissues at the points.
///
/// Grid point `(i, j, k)` is at `(i, j, k) * spacing` mm: slice along the axis, y, z. [`CollisionGrid`] says where voxels are.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    voxels: CollisionGrid,
    spacing: Vec3,
    /// Size of a voxel, mm.
    size: Vec3,
    /// Number of the tissue at each grid point; empty if there is only one.
    tissues: Vec<u8>,
    /// Curvature of the needle in each tissue, 1/mm.
    curvatures: Vec<f64>,
    /// The target as it was given; None: the voxels with its code.
    target: Option<TargetBody>,
}

impl Volume {
    /// Makes a volume from its voxels, the spacing of its grid points, mm, the number of the tissue at
    /// each point (empty if there is only one), and the radius of the needle in each tissue, mm (infinite: straight).
    ///
    /// # Errors
    /// [`Error::Parameter`] for a spacing or radius that is not positive, or tissues without a radius; [`Error::Length`] for
    /// another number of tissues than of grid points.
    pub fn new(voxels: CollisionGrid, spacing: Vec3, tissues: Vec<u8>, radii: &[f64]) -> Result<Self> {
        let (expected, found) = (voxels.at_points().len(), tissues.len());
        if found != expected && found != 0 {
            return Err(Error::Length { name: "tissues", expected, found });
        }
        if !spacing.iter().all(|s| *s > 0.0 && s.is_finite()) {
            return Err(Error::parameter("spacing_mm", format!("{spacing:?}"), "must be positive and finite"));
        }
        if let Some(radius) = radii.iter().find(|radius| radius.is_nan() || **radius <= 0.0) {
            return Err(Error::parameter("curvature_radius_mm", radius, "must be positive"));
        }
        let highest = tissues.iter().copied().max().unwrap_or(0);
        if usize::from(highest) >= radii.len() {
            return Err(Error::parameter("tissues", highest, "must have a radius of curvature"));
        }
        let curvatures = radii.iter().map(|radius| radius.recip()).collect();
        let size = spacing.map(|spacing| spacing / voxels.refinement() as f64);
        Ok(Volume { voxels, spacing, size, tissues, curvatures, target: None })
    }

    /// The volume with a target that executions enter, whatever voxels have its code.
    #[must_use]
    pub fn with_target(self, target: Option<TargetBody>) -> Self {
        Volume { target, ..self }
    }

    /// The target as it was given.
    pub(crate) fn target(&self) -> Option<&TargetBody> {
        self.target.as_ref()
    }

    /// Grid points along the axis, y and z.
    pub fn shape(&self) -> [usize; 3] {
        self.voxels.points()
    }

    /// Distance of grid points, mm.
    pub fn spacing(&self) -> Vec3 {
        self.spacing
    }

    /// What is where.
    pub fn voxels(&self) -> &CollisionGrid {
        &self.voxels
    }

    /// Numbers of tissues at the grid points `[i][j][k]`; empty if there is only one.
    pub fn tissues(&self) -> &[u8] {
        &self.tissues
    }

    /// Curvature in each tissue, 1/mm.
    pub fn curvatures(&self) -> &[f64] {
        &self.curvatures
    }

    /// Index of the grid point that is nearest to a point in the volume, None outside.
    #[inline]
    pub fn index(&self, point: Vec3) -> Option<usize> {
        let (points, shape) = (self.voxels.points(), self.voxels.shape());
        let at = |axis: usize| {
            let voxel = point[axis] / self.size[axis] + 0.5;
            // NaN fails both comparisons. The conversion rounds towards zero.
            let is_within = voxel >= 0.0 && voxel < shape[axis] as f64;
            is_within.then(|| ((point[axis] / self.spacing[axis] + 0.5) as usize).min(points[axis] - 1))
        };
        Some((at(0)? * points[1] + at(1)?) * points[2] + at(2)?)
    }

    /// A way that begins at a point.
    pub(crate) fn way(&self, start: Vec3) -> Way<'_> {
        Way { volume: self, at: start, cell: None }
    }

    /// Place of a point in the unit grid of the voxels.
    #[inline]
    fn place(&self, point: Vec3) -> Vec3 {
        [0, 1, 2].map(|axis| point[axis] / self.size[axis] + 0.5)
    }

    /// Place of the voxel that contains a point, which may be outside the volume.
    #[inline]
    pub(crate) fn cell(&self, point: Vec3) -> [i32; 3] {
        cell_of(self.place(point))
    }

    /// The voxels of a straight way after that of its start, in order, and the share of the way at which it enters each.
    fn entered(&self, from: Vec3, to: Vec3) -> impl Iterator<Item = (f64, [i32; 3])> + use<> {
        crossed(self.place(from), self.place(to))
    }

    /// The voxels of a straight way after that of its start, in order.
    pub(crate) fn passed(&self, from: Vec3, to: Vec3) -> impl Iterator<Item = [i32; 3]> + use<> {
        self.entered(from, to).map(|(_, cell)| cell)
    }

    /// Code of the voxel that contains a point; that of the target in it, unless the voxel is blocked.
    #[inline]
    pub fn code(&self, point: Vec3) -> u8 {
        if point.iter().any(|x| x.is_nan()) {
            return voxel::OUTSIDE;
        }
        let code = self.voxels.code(self.cell(point));
        match &self.target {
            Some(body) if code == voxel::FREE || code == voxel::TARGET => {
                if body.contains(point) {
                    voxel::TARGET
                } else {
                    voxel::FREE
                }
            }
            _ => code,
        }
    }

    /// What a straight way meets first after the voxel of its start, and the share of the way before it: up to the face of a
    /// blocked voxel, or within the target. Free and 1 if there is nothing.
    #[cold]
    pub(crate) fn met(&self, from: Vec3, to: Vec3) -> (u8, f64) {
        let (start, mut ways) = (self.cell(from), self.entered(from, to).peekable());
        let is_target = |cell| self.voxels.code(cell) == voxel::TARGET;
        let (mut part, mut blocked) = (None, None);
        match &self.target {
            Some(body) => part = body.part(from, to),
            None if is_target(start) => part = Some([0.0, 0.0]),
            None => {}
        }
        while let Some((share, cell)) = ways.next() {
            match self.voxels.code(cell) {
                voxel::FREE => {}
                voxel::TARGET if self.target.is_some() => {}
                voxel::TARGET => {
                    part = part.or(Some([share, ways.peek().map_or(1.0, |(next, _)| *next)]));
                }
                code => {
                    blocked = Some((code, share));
                    break;
                }
            }
        }
        match (part, blocked) {
            (Some([enters, leaves]), blocked) if blocked.is_none_or(|(_, face)| enters <= face + SAME_FACE) => {
                let leaves = blocked.map_or(leaves, |(_, face)| leaves.min(face.max(enters)));
                (voxel::TARGET, if enters > 0.0 { 0.5 * (enters + leaves) } else { 0.0 })
            }
            (_, Some((code, share))) => (code, share.clamp(0.0, 1.0)),
            _ => (voxel::FREE, 1.0),
        }
    }

    /// Curvature, 1/mm, at a point; outside the volume that of the first tissue.
    #[inline]
    pub fn curvature(&self, point: Vec3) -> f64 {
        let tissue = self.index(point).and_then(|index| self.tissues.get(index)).copied().unwrap_or(0);
        self.curvatures[usize::from(tissue)]
    }
}

/// A way through a volume in straight pieces.
#[derive(Debug)]
pub(crate) struct Way<'a> {
    volume: &'a Volume,
    at: Vec3,
    /// The voxel at this point; None if it is not asked yet.
    cell: Option<[i32; 3]>,
}

impl Way<'_> {
    /// Goes straight on to a point, on a piece that meets nothing.
    #[inline]
    pub(crate) fn pass(&mut self, point: Vec3) {
        (self.at, self.cell) = (point, None);
    }

    /// Goes straight on to a point, and returns the code of what this piece meets first, after the voxel of its start: the
    /// target, or a voxel that is not free; free if there is nothing.
    #[inline]
    pub(crate) fn to(&mut self, point: Vec3) -> u8 {
        let (volume, from, b) = (self.volume, self.at, self.volume.cell(point));
        let a = self.cell.unwrap_or_else(|| volume.cell(from));
        (self.at, self.cell) = (point, Some(b));
        if let Some(body) = &volume.target
            && body.is_near(from, point)
        {
            return volume.met(from, point).0;
        }
        // Far from the target as it was given, a voxel with its code is free.
        let met = |cell| match volume.voxels.code(cell) {
            voxel::TARGET if volume.target.is_some() => voxel::FREE,
            code => code,
        };
        if (0..3).map(|axis| a[axis].abs_diff(b[axis])).fold(0, u32::saturating_add) > 1 {
            return volume.passed(from, point).map(met).find(|code| *code != voxel::FREE).unwrap_or(voxel::FREE);
        }
        met(b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_way_passes_all_voxels_that_close_points_are_in() {
        let volume =
            Volume::new(CollisionGrid::new([1; 3], 2, &[0; 8]).unwrap(), [2.0, 1.5, 1.0], vec![], &[1.0]).unwrap();
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut through = 0;
        for _ in 0..2000 {
            let from = [0; 3].map(|_| 8.0 * random() - 4.0);
            let to = from.map(|x| x + 3.0 * (random() - 0.5));
            let ends = [from, to].map(|point| volume.cell(point));
            let passed: Vec<[i32; 3]> = volume.passed(from, to).collect();
            let whole: Vec<[i32; 3]> = [ends[0]].into_iter().chain(passed.iter().copied()).collect();
            assert_eq!(whole.last(), Some(&ends[1]));
            // Each voxel shares a face with the one before.
            let apart = |a: [i32; 3], b: [i32; 3]| (0..3).map(|axis| (a[axis] - b[axis]).abs()).sum::<i32>();
            assert!(whole.windows(2).all(|pair| apart(pair[0], pair[1]) <= 1));
            through += passed.len();
            for sample in 0..=1000 {
                let share = f64::from(sample) / 1000.0;
                let cell = volume.cell([0, 1, 2].map(|axis| from[axis] + share * (to[axis] - from[axis])));
                assert!(whole.contains(&cell), "{from:?} {to:?} {cell:?} {whole:?}");
            }
        }
        assert!(through > 1000);
    }
}
