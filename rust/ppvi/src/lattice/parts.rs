//! What a lattice is made of: the shape of the grid, the costs, the steps, and the codes of their outcomes.

use crate::error::{Error, Result};
use crate::lattice::heading::HeadingKernel;
use crate::memory::is_granted;

/// Outcome codes of a step.
pub mod outcome {
    /// The execution goes on.
    pub const CONTINUES: u8 = 0;
    /// The step ends at the target.
    pub const TARGET: u8 = 1;
    /// The step ends in an obstacle.
    pub const COLLISION: u8 = 2;
    /// The step ends outside the workspace.
    pub const EXIT: u8 = 3;
    /// The grid point lies in an obstacle: its states are absorbing.
    pub const AT_OBSTACLE: u8 = 4;
    /// The grid point lies in the target: its states are absorbing.
    pub const AT_TARGET: u8 = 5;
    /// Padding of rows: not a state.
    pub(crate) const OUTSIDE: u8 = 6;
    /// No policy ends the execution from here with probability one. Found by the solver, not given by the caller.
    pub(crate) const IMPROPER: u8 = 7;
    /// Number of codes.
    pub(crate) const CODES: usize = 8;
}

/// Grid points that a sweep processes together: a vector of single precision. Rows are padded to a multiple of it.
pub(crate) const LANES: usize = 8;

/// Number of directions in which steps go.
const DIRECTIONS: usize = 4;

/// Largest number of states of a lattice.
const MAX_STATES: u128 = 1 << 40;

/// Bytes for each state that a solve needs about.
const STATE_BYTES: u128 = 16;

/// Largest cost of a step, a rotation or a failure. Tables are in single precision, and no sum of costs may overflow it.
pub const LARGEST_COST: f64 = 1e20;

const COST_RULE: &str = "must not be negative, and at most 1e20: tables are in single precision";

/// How a step is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// Actions 0 and 1: along the arc of the bevel with which the step arrives.
    Curved,
    /// Action 2, where there is one: with the needle turning all the way, so that its path is nearly straight. The step
    /// arrives with the bevel with which it began.
    Straight,
}

/// Number of the straight action.
pub const STRAIGHT: u8 = 2;

/// Numbers of grid points and headings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Grid points along x.
    pub nx: usize,
    /// Grid points along y.
    pub ny: usize,
    /// Headings of a full turn.
    pub headings: usize,
}

impl Shape {
    /// Number of states.
    pub fn states(&self) -> usize {
        self.nx * self.ny * self.headings * 2
    }

    /// Checks that there are states, and that they can be numbered and stored.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a shape without states, [`Error::TooLarge`] for more than 2^40 states or more than the
    /// memory holds.
    pub fn validate(&self) -> Result<()> {
        let states = self.nx as u128 * self.ny as u128 * self.headings as u128 * 2;
        if states == 0 {
            return Err(Error::parameter("shape", format!("{self:?}"), "must not be empty"));
        }
        if states > MAX_STATES {
            let rule = "more than 2^40 states; use a coarser grid or fewer headings";
            return Err(Error::TooLarge { states, needed_bytes: states * STATE_BYTES, rule });
        }
        if !is_granted(states * STATE_BYTES) {
            let rule = "more than the memory; use a coarser grid or fewer headings";
            return Err(Error::TooLarge { states, needed_bytes: states * STATE_BYTES, rule });
        }
        Ok(())
    }

    /// Index, in an outcome table, of the first grid point of the plane of a motion, heading `k` and arriving bevel index
    /// `bevel`.
    #[inline]
    pub(crate) fn plane(&self, motion: Motion, k: usize, bevel: usize) -> usize {
        ((motion as usize * self.headings + k) * 2 + bevel) * self.nx * self.ny
    }
}

/// Costs of a step, of a rotation and of failures, and the discount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Costs {
    /// Cost of inserting one step at the needle's nominal curvature. A [`Region`] states the cost of its own steps.
    pub step: f64,
    /// Cost of switching the bevel.
    pub rotation: f64,
    /// Cost of hitting an obstacle.
    pub collision: f64,
    /// Cost of leaving the workspace.
    pub exit: f64,
    /// Discount factor, in (0, 1].
    pub discount: f64,
}

impl Costs {
    fn validate(&self) -> Result<()> {
        for (name, value) in [("rotation", self.rotation), ("collision", self.collision), ("exit", self.exit)] {
            if !(0.0..=LARGEST_COST).contains(&value) {
                return Err(Error::parameter(name, value, COST_RULE));
            }
        }
        if !(self.discount > 0.0 && self.discount <= 1.0) {
            return Err(Error::parameter("discount", self.discount, "must be in (0, 1]"));
        }
        self.validate_step(self.step)
    }

    /// Checks the cost of a step.
    fn validate_step(&self, cost: f64) -> Result<()> {
        if !(0.0..=LARGEST_COST).contains(&cost) {
            return Err(Error::parameter("insertion_per_mm", cost, COST_RULE));
        }
        if self.discount == 1.0 && cost == 0.0 {
            return Err(Error::parameter("insertion_per_mm", cost, "must be positive where the discount is 1"));
        }
        Ok(())
    }
}

/// How a displaced position is mapped to grid points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transition {
    /// To the nearest grid point (the thesis).
    Nearest,
    /// To the four grid points around it, with bilinear weights: unbiased.
    Interpolated,
}

/// A displacement in grid cells: whole cells, and the fraction of a cell beyond them (zero for nearest transitions).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shift {
    /// Whole cells along x and y.
    pub cell: [i32; 2],
    /// Fractions in [0, 1).
    pub fraction: [f64; 2],
}

impl Shift {
    /// Converts a displacement to cells of `spacing` (the same unit) on a grid of `points` points along x and y.
    pub fn new(displacement: [f64; 2], spacing: [f64; 2], transition: Transition, points: [usize; 2]) -> Self {
        let mut shift = Shift { cell: [0; 2], fraction: [0.0; 2] };
        for axis in 0..2 {
            let cells = displacement[axis] / spacing[axis];
            let whole = match transition {
                Transition::Nearest => nearest_cell(cells),
                // A fraction that differs from zero by rounding only must not read the point one cell further.
                Transition::Interpolated if (cells - cells.round()).abs() < 1e-9 => cells.round(),
                Transition::Interpolated => cells.floor(),
            };
            // All displacements beyond the grid are equivalent.
            let beyond = points[axis] as f64 + 1.0;
            shift.cell[axis] = whole.clamp(-beyond, beyond) as i32;
            if transition == Transition::Interpolated {
                shift.fraction[axis] = (cells - whole).max(0.0);
                if shift.fraction[axis] < 1e-9 {
                    shift.fraction[axis] = 0.0;
                }
            }
        }
        shift
    }

    /// Whether the displacement stays on or next to a grid of `points` points, with fractions in [0, 1).
    fn is_valid(&self, points: [usize; 2]) -> bool {
        (0..2).all(|axis| {
            self.cell[axis].unsigned_abs() as usize <= points[axis] + 1 && (0.0..1.0).contains(&self.fraction[axis])
        })
    }
}

/// The nearest whole number; halves, to within rounding, away from zero, so that mirrored steps land on mirrored
/// points.
fn nearest_cell(cells: f64) -> f64 {
    (cells.abs() + 0.5 + 1e-9).floor().copysign(cells)
}

/// Steps of one motion that depend on heading and bevel only: those in tissue of one curvature.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// Length of a step, in the unit of the grid spacing.
    pub step_length: f64,
    /// Cost of a step.
    pub step_cost: f64,
    /// Displacements of a step, `[heading][arriving bevel]`.
    pub stencil: Vec<[Shift; 2]>,
    /// Change of the heading in a step with its noise, by arriving bevel.
    pub turn: [HeadingKernel; 2],
}

/// Everything that defines a [`LatticeMdp`](crate::lattice::LatticeMdp) but the outcomes of its steps.
#[derive(Debug, Clone, PartialEq)]
pub struct LatticeParts {
    /// Numbers of grid points and headings. Heading k is the angle 2 pi k / headings from +x.
    pub shape: Shape,
    /// Distances of neighbouring grid points along x and y.
    pub spacing: [f64; 2],
    /// Nearest or interpolated.
    pub transition: Transition,
    /// Costs and discount.
    pub costs: Costs,
    /// 1 to 256 regions.
    pub regions: Vec<Region>,
    /// The straight steps, one for each region; empty where there is no straight action.
    pub straight: Vec<Region>,
    /// Index of the region of the steps from each grid point, `[direction][i][j]`, in the order of
    /// [`Direction::ALL`](crate::lattice::Direction::ALL): a step can depend on what lies ahead. Empty if there is only one region.
    pub region_of: Vec<u8>,
}

impl LatticeParts {
    /// The motions there are.
    pub fn motions(&self) -> &'static [Motion] {
        if self.straight.is_empty() { &[Motion::Curved] } else { &[Motion::Curved, Motion::Straight] }
    }

    /// The steps of every motion and region, `[motion][region]`.
    pub(crate) fn steps(&self) -> impl Iterator<Item = &Region> + Clone {
        self.regions.iter().chain(&self.straight)
    }

    /// The index, among [`LatticeParts::steps`], of the steps of a motion in a region.
    #[inline(always)]
    pub(crate) fn step_number(&self, motion: Motion, region: usize) -> usize {
        motion as usize * self.regions.len() + region
    }

    /// The steps of a motion in a region.
    #[inline(always)]
    pub(crate) fn step(&self, motion: Motion, region: usize) -> &Region {
        match motion {
            Motion::Curved => &self.regions[region],
            Motion::Straight => &self.straight[region],
        }
    }

    /// Checks all fields.
    ///
    /// # Errors
    /// [`Error::Parameter`] or [`Error::Length`] names the first field that breaks a rule, [`Error::TooLarge`] a grid
    /// of more than 2^40 states.
    pub fn validate(&self) -> Result<()> {
        self.costs.validate()?;
        if let Some(spacing) = self.spacing.iter().find(|spacing| !(**spacing > 0.0 && spacing.is_finite())) {
            return Err(Error::parameter("spacing_mm", spacing, "must be positive and finite"));
        }
        self.shape.validate()?;
        self.validate_regions()
    }

    fn validate_regions(&self) -> Result<()> {
        let Shape { nx, ny, headings } = self.shape;
        let count = self.regions.len();
        if count == 0 || count > 256 {
            return Err(Error::parameter("regions", count, "must number 1 to 256"));
        }
        if !self.straight.is_empty() && self.straight.len() != count {
            return Err(Error::Length { name: "straight", expected: count, found: self.straight.len() });
        }
        for region in self.steps() {
            self.costs.validate_step(region.step_cost)?;
            if region.stencil.len() != headings {
                return Err(Error::Length { name: "stencil", expected: headings, found: region.stencil.len() });
            }
            if let Some(shift) = region.stencil.iter().flatten().find(|shift| !shift.is_valid([nx, ny])) {
                let rule = "must stay on or next to the grid, with fractions in [0, 1)";
                return Err(Error::parameter("stencil", format!("{shift:?}"), rule));
            }
        }
        let expected = if count == 1 && self.region_of.is_empty() { 0 } else { DIRECTIONS * nx * ny };
        if self.region_of.len() != expected {
            return Err(Error::Length { name: "region_of", expected, found: self.region_of.len() });
        }
        match self.region_of.iter().find(|region| usize::from(**region) >= count) {
            Some(region) => Err(Error::parameter("region_of", region, "must be less than the number of regions")),
            None => Ok(()),
        }
    }
}
