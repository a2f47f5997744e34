//! What a problem in a volume is made of: the shape of the grid, the voxels, the steps, and the costs.

use crate::error::{Error, Result};
use crate::lattice::LARGEST_COST;
use crate::memory::is_granted;
use crate::space::collision::{CollisionGrid, voxel};

/// Largest number of states.
const MAX_STATES: u128 = 1 << 40;

/// Bytes for each state of a slice that a pass keeps: value and success in single precision.
const KEPT_BYTES: u128 = 8;

/// Largest number of actions: policies are bytes.
const MAX_ACTIONS: usize = 255;

/// Largest variance of a landing beside that of its branches, in squared grid points.
const LARGEST_SPREAD: f64 = 1.0;

/// Largest deviation of a sum of probabilities from one.
const SUM_TOLERANCE: f64 = 1e-9;

/// Numbers of grid points and directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpaceShape {
    /// Slices along the axis.
    pub slices: usize,
    /// Grid points of a slice along y.
    pub ny: usize,
    /// Grid points of a slice along z.
    pub nz: usize,
    /// Directions.
    pub directions: usize,
}

impl SpaceShape {
    /// Grid points of a slice.
    pub fn plane(&self) -> usize {
        self.ny * self.nz
    }

    /// States of a slice.
    pub fn slice_states(&self) -> usize {
        self.directions * self.plane()
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.slices * self.slice_states()
    }

    /// Number of the state `(slice, direction, j, k)`.
    #[inline]
    pub fn state(&self, slice: usize, direction: usize, j: usize, k: usize) -> usize {
        ((slice * self.directions + direction) * self.ny + j) * self.nz + k
    }

    /// Number of the grid point at an offset from `(slice, j, k)`, or None outside the grid.
    #[inline]
    pub fn point(&self, slice: usize, j: usize, k: usize, offset: [i32; 3]) -> Option<usize> {
        let moved = |at: usize, by: i32, count: usize| {
            let at = at as i64 + i64::from(by);
            (at >= 0 && at < count as i64).then_some(at as usize)
        };
        let (slice, j) = (moved(slice, offset[0], self.slices)?, moved(j, offset[1], self.ny)?);
        Some((slice * self.ny + j) * self.nz + moved(k, offset[2], self.nz)?)
    }

    fn validate(&self, advance: usize) -> Result<()> {
        let states = [self.slices, self.ny, self.nz, self.directions].iter().map(|n| *n as u128).product::<u128>();
        if states == 0 {
            return Err(Error::parameter("shape", format!("{self:?}"), "must not be empty"));
        }
        let needed_bytes = states / self.slices as u128 * (advance as u128 + 1) * KEPT_BYTES;
        if states > MAX_STATES || !is_granted(needed_bytes) {
            let rule = "more than 2^40 states, or slices of a step that are more than the memory; use a coarser grid or \
                fewer directions";
            return Err(Error::TooLarge { states, needed_bytes, rule });
        }
        Ok(())
    }
}

/// One of the ways in which a step may go on from its middle, with the direction that it ends in.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Number of the direction after the step.
    pub direction: u32,
    /// Probability.
    pub weight: f64,
    /// Number of its path in [`SpaceStep::rests`].
    pub rest: usize,
    /// Landing relative to the start, in whole grid points along y and z.
    pub cell: [i32; 2],
    /// The rest of the landing, in [0, 1).
    pub fraction: [f64; 2],
}

impl Branch {
    /// The voxel of the landing relative to that of the start, along y and z; `refinement`: voxels for each spacing.
    pub fn voxel(&self, refinement: usize) -> [i32; 2] {
        let r = refinement as f64;
        [0, 1].map(|axis| self.cell[axis] * refinement as i32 + (self.fraction[axis] * r).round() as i32)
    }

    /// The last grid point around the landing, relative to the start, along y and z.
    pub(crate) fn upper_corner(&self) -> [i32; 2] {
        self.cell.map(|at| at + 1)
    }
}

/// A step: what an action does in a direction.
#[derive(Debug, Clone, PartialEq)]
pub struct SpaceStep {
    /// Cost of the step.
    pub cost: f64,
    /// Length, in the unit of the prices of places.
    pub length: f64,
    /// Voxels that all branches pass after the start, in order, relative to the voxel of the start: along the axis, y, z.
    pub path: Vec<[i32; 3]>,
    /// The paths of the branches after that, in the same way. The last voxel of each is that of the landing. Branches that
    /// pass the same voxels share one.
    pub rests: Vec<Vec<[i32; 3]>>,
    /// Ways in which the step may go on; empty if it cannot.
    pub branches: Vec<Branch>,
    /// Probability that a branch which reaches its landing has left the directions of the grid.
    pub lost: f64,
    /// Variance of the landing beside that of the branches, in squared grid points along y and z. Only the cubic
    /// interpolation adds it, since the linear one adds more than that by itself.
    pub spread: [f64; 2],
}

/// Costs of the two failures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FailureCosts {
    /// Cost of hitting an obstacle.
    pub collision: f64,
    /// Cost of leaving the volume or the directions.
    pub exit: f64,
}

impl FailureCosts {
    /// Cost of an end in a voxel with this code; 0 in the target.
    pub(crate) fn of(&self, code: u8) -> f64 {
        match code {
            voxel::OBSTACLE => self.collision,
            voxel::OUTSIDE => self.exit,
            _ => 0.0,
        }
    }
}

/// A problem in a volume; [`crate::space`] has the mathematics.
#[derive(Debug, Clone, PartialEq)]
pub struct SpaceParts {
    /// Shape of the grid.
    pub shape: SpaceShape,
    /// Slices that a step advances.
    pub advance: usize,
    /// Costs of failures.
    pub costs: FailureCosts,
    /// What is where.
    pub voxels: CollisionGrid,
    /// Steps, `[region][direction][action]`.
    pub regions: Vec<Vec<SpaceStep>>,
    /// Region of each grid point, `[slice][j][k]`; empty if there is only one region.
    pub region_of: Vec<u8>,
    /// For each direction: the grid point at which the region of a step is read, relative to its start; the nearest one of the
    /// grid counts. Empty: at the start.
    pub look: Vec<[i32; 3]>,
    /// Price of a unit of length of the steps from each grid point, `[slice][j][k]`; empty if there is none.
    pub prices: Vec<f32>,
}

impl SpaceParts {
    /// Number of actions.
    pub fn actions(&self) -> usize {
        self.regions.first().map_or(0, |steps| steps.len() / self.shape.directions.max(1))
    }

    /// The step of an action.
    #[inline]
    pub fn step(&self, region: usize, direction: usize, action: usize) -> &SpaceStep {
        &self.regions[region][direction * self.actions() + action]
    }

    /// The region of the steps in a direction from a grid point.
    #[inline]
    pub fn region(&self, slice: usize, direction: usize, j: usize, k: usize) -> usize {
        if self.region_of.is_empty() {
            return 0;
        }
        let [ds, dj, dk] = self.look.get(direction).copied().unwrap_or_default();
        let near = |at: usize, by: i32, count: usize| (at as i64 + i64::from(by)).clamp(0, count as i64 - 1) as usize;
        let SpaceShape { slices, ny, nz, .. } = self.shape;
        let (slice, j) = (near(slice, ds, slices), near(j, dj, ny));
        usize::from(self.region_of[(slice * ny + j) * nz + near(k, dk, nz)])
    }

    /// Writes the regions of the steps in a direction from all points of a row, as [`SpaceParts::region`] has them.
    pub(crate) fn regions_of_row(&self, slice: usize, direction: usize, j: usize, regions: &mut [u8]) {
        let [ds, dj, dk] = self.look.get(direction).copied().unwrap_or_default();
        let near = |at: usize, by: i32, count: usize| (at as i64 + i64::from(by)).clamp(0, count as i64 - 1) as usize;
        let SpaceShape { slices, ny, nz, .. } = self.shape;
        let row = &self.region_of[(near(slice, ds, slices) * ny + near(j, dj, ny)) * nz..][..nz];
        // Points whose voxel is before the first of the row take that one, and those behind the last one that.
        let [before, end] = [0, nz as i64].map(|edge| (edge - i64::from(dk)).clamp(0, nz as i64) as usize);
        let first = near(before, dk, nz);
        regions[..before].fill(row[0]);
        regions[before..end].copy_from_slice(&row[first..first + end - before]);
        regions[end..].fill(row[nz - 1]);
    }

    /// The price of a unit of length from a grid point.
    #[inline]
    pub fn price(&self, point: usize) -> f64 {
        self.prices.get(point).copied().map_or(0.0, f64::from)
    }

    /// Checks every part.
    ///
    /// # Errors
    /// [`Error::Length`] for an array of the wrong length, [`Error::TooLarge`] for too many states, and
    /// [`Error::Parameter`] for anything else that breaks a rule.
    pub fn validate(&self) -> Result<()> {
        self.shape.validate(self.advance)?;
        let points = self.shape.slices * self.shape.plane();
        let length = |name, expected: usize, found: usize, optional: bool| match found {
            0 if optional => Ok(()),
            _ if found == expected => Ok(()),
            _ => Err(Error::Length { name, expected, found }),
        };
        let SpaceShape { slices, ny, nz, .. } = self.shape;
        if self.voxels.points() != [slices, ny, nz] {
            let found = self.voxels.at_points().len();
            return Err(Error::Length { name: "voxels", expected: points, found });
        }
        length("region_of", points, self.region_of.len(), true)?;
        length("prices", points, self.prices.len(), true)?;
        length("look", self.shape.directions, self.look.len(), true)?;
        if self.advance == 0 {
            return Err(Error::parameter("advance", self.advance, "must be at least one slice"));
        }
        if let Some(price) = self.prices.iter().find(|price| !(0.0..=LARGEST_COST as f32).contains(*price)) {
            return Err(Error::parameter("prices", price, "must not be negative, and at most 1e20"));
        }
        if let Some(region) = self.region_of.iter().find(|region| usize::from(**region) >= self.regions.len()) {
            return Err(Error::parameter("region_of", region, "must be numbers of regions"));
        }
        for (name, cost) in [("collision", self.costs.collision), ("exit", self.costs.exit)] {
            if !(0.0..=LARGEST_COST).contains(&cost) {
                return Err(Error::parameter(name, cost, "must not be negative, and at most 1e20"));
            }
        }
        let actions = self.actions();
        if !(1..=MAX_ACTIONS).contains(&actions) {
            return Err(Error::parameter("actions", actions, "must be between 1 and 255"));
        }
        for steps in &self.regions {
            length("steps of a region", self.shape.directions * actions, steps.len(), false)?;
            steps.iter().try_for_each(|step| self.validate_step(step))?;
        }
        Ok(())
    }

    fn validate_step(&self, step: &SpaceStep) -> Result<()> {
        let SpaceStep { cost, length, path, rests, branches, lost, spread } = step;
        let wrong = |value: String, rule| Err(Error::parameter("step", value, rule));
        if !(*cost > 0.0 && *cost <= LARGEST_COST && *length > 0.0 && *length <= LARGEST_COST) {
            return wrong(
                format!("cost {cost}, length {length}"),
                "must cost something and have a length, at most 1e20",
            );
        }
        let farthest = self.advance * self.voxels.refinement();
        if path.iter().chain(rests.iter().flatten()).any(|[ahead, ..]| *ahead < 0 || *ahead as usize > farthest) {
            return wrong(format!("{path:?}"), "must lead from the slice of its start to that of its landing");
        }
        let weights = || branches.iter().map(|branch| branch.weight);
        let sum = if branches.is_empty() { 1.0 } else { weights().sum::<f64>() };
        if weights().chain([*lost]).any(|weight| !(0.0..=1.0 + SUM_TOLERANCE).contains(&weight))
            || (sum - 1.0).abs() > SUM_TOLERANCE
        {
            return wrong(format!("{branches:?}, {lost} lost"), "must have branches whose probabilities sum to one");
        }
        if !spread.iter().all(|variance| (0.0..=LARGEST_SPREAD).contains(variance)) {
            return wrong(format!("{spread:?}"), "must have a spread from 0 to 1");
        }
        branches.iter().try_for_each(|branch| self.validate_branch(branch, rests))
    }

    fn validate_branch(&self, branch: &Branch, rests: &[Vec<[i32; 3]>]) -> Result<()> {
        let Branch { direction, rest, fraction, .. } = branch;
        let wrong = |value: String, rule| Err(Error::parameter("branch", value, rule));
        if *direction as usize >= self.shape.directions {
            return wrong(direction.to_string(), "must end in directions of the grid");
        }
        if !fraction.iter().all(|f| (0.0..1.0).contains(f)) {
            return wrong(format!("{fraction:?}"), "must have fractions in [0, 1)");
        }
        let refinement = self.voxels.refinement();
        let [y, z] = branch.voxel(refinement);
        let last = rests.get(*rest).and_then(|path| path.last());
        if last != Some(&[(self.advance * refinement) as i32, y, z]) {
            return wrong(format!("{last:?}"), "must have a path that ends in the voxel of its landing");
        }
        Ok(())
    }
}
