//! The structured MDP of a planar needle: positions on a grid, headings on a circle, two bevel sides.
//!
//! A state is `(i, j, k, b)`: grid column, grid row, heading index, bevel (0: -1, 1: +1). Action 0 inserts, action 1
//! turns the needle by 180 degrees and then inserts, so the step always *arrives* with a bevel b' = b xor action.
//! What the step does depends on (k, b') and the region of equal curvature, not on the action:
//!
//! ```text
//! position   moves by stencil[k][b'], the same all over a region           (a displacement stencil)
//! heading    k + (b' ? +1 : -1) + m with probability noise[|m|]            (a circular convolution)
//! outcome    continues, or ends at target, obstacle or border              (2-3 bits, from `workspace`)
//! ```
//!
//! so with W(k', b') = sum over m of noise[|m|] V(k' + m, b') the Q-values are shifted reads of W, and
//! V(b) = min(Q(b), rotation + Q(1 - b)). `sector` and `sweep` turn that into code; this file is the definition, and it
//! is an [`Mdp`](crate::Mdp) like any other, with the states numbered as in the table: `((i * ny + j) * headings + k) * 2 + b`.

#[cfg(target_arch = "x86_64")]
pub(crate) mod avx2;
pub(crate) mod backup;
mod classification;
mod definition;
pub(crate) mod direction;
pub(crate) mod endings;
pub(crate) mod engine;
pub mod evaluation;
pub(crate) mod halo;
pub(crate) mod kernel;
pub(crate) mod lanes;
pub(crate) mod plane;
pub(crate) mod real;
pub(crate) mod region;
pub(crate) mod sector;
pub(crate) mod store;
pub mod sweep;

use crate::bicycle::Bicycle;
use crate::error::{Error, Result, parameter};
use crate::lattice::direction::Direction;
use crate::lattice::endings::{Endings, endings};
pub use crate::lattice::region::Shift;
use crate::lattice::region::{Region, regions};
use crate::partition::Partition;
use crate::tissues::Tissues;
use crate::workspace::{Workspace, grid_points};

/// Outcome codes of a step; [`Event`]s have the same numbers.
pub mod outcome {
    /// The execution goes on.
    pub const CONTINUES: u8 = 0;
    /// Ends at the target.
    pub const TARGET: u8 = 1;
    /// Ends in an obstacle.
    pub const COLLISION: u8 = 2;
    /// Ends outside the workspace.
    pub const EXIT: u8 = 3;
    /// The state itself is an obstacle point (absorbing).
    pub const AT_OBSTACLE: u8 = 4;
    /// The state itself is a target point (absorbing).
    pub const AT_TARGET: u8 = 5;
    /// Padding of rows: not a state.
    pub(crate) const OUTSIDE: u8 = 6;
    /// No policy surely ends from here: found by the solver, not by the geometry.
    pub(crate) const ENDLESS: u8 = 7;
    pub(crate) const CODES: usize = 8;
}

/// Grid points that a sweep looks at together: a vector of single precision. Rows are padded to a multiple of it.
pub(crate) const LANES: usize = 8;

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
}

/// Costs of a step, of a rotation, of failures; the discount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Costs {
    /// Cost of inserting one step.
    pub step: f64,
    /// Cost of turning the needle.
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
            if !(value >= 0.0 && value.is_finite()) {
                return Err(parameter(name, value, "must be finite and not negative"));
            }
        }
        if !(self.step >= 0.0 && self.step.is_finite()) {
            return Err(parameter("insertion_per_mm", self.step, "must be finite and not negative"));
        }
        if !(self.discount > 0.0 && self.discount <= 1.0) {
            return Err(parameter("discount", self.discount, "must be in (0, 1]"));
        }
        if self.discount == 1.0 && self.step == 0.0 {
            return Err(parameter("insertion_per_mm", self.step, "must be positive where the discount is 1"));
        }
        Ok(())
    }
}

/// How a displacement is brought back to the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transition {
    /// To the nearest grid point (the thesis).
    Nearest,
    /// To the four grid points around it, with bilinear weights: unbiased.
    Interpolated,
}

/// What a lattice is made from.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Rectangle, obstacles, target.
    pub workspace: Workspace,
    /// Curvature and headings.
    pub needle: Bicycle,
    /// Grid spacing along x and y, mm.
    pub spacing: [f64; 2],
    /// P(0), P(+-1), P(+-2), ... heading steps.
    pub noise: Vec<f64>,
    /// Points of each arc that are tested.
    pub arc_samples: usize,
    /// Nearest or interpolated.
    pub transition: Transition,
    /// Costs and discount; the cost of a step is that of the needle's own radius.
    pub costs: Costs,
    /// Where the needle bends how much.
    pub tissues: Tissues,
}

/// The lattice MDP; see the module for the mathematics.
#[derive(Debug, Clone)]
pub struct LatticeMdp {
    pub(crate) setup: Setup,
    pub(crate) shape: Shape,
    /// The radii of curvature that occur at grid points.
    pub(crate) regions: Vec<Region>,
    /// Region by grid point, `[i][j]`; empty where there is only one.
    pub(crate) region_of: Vec<u8>,
    /// In which direction each heading moves.
    pub(crate) directions: Vec<Direction>,
    /// `[heading][arriving bevel]` planes of `[i][j]`, or of `[j][i]` for headings that move vertically, since they are
    /// swept in that order.
    pub(crate) outcomes: Vec<u8>,
    /// The same as runs.
    pub(crate) endings: Endings,
}

impl LatticeMdp {
    /// Validates the setup and classifies every arc.
    pub fn new(setup: Setup) -> Result<Self> {
        setup.costs.validate()?;
        validate_noise(&setup.noise)?;
        for (name, value) in [("spacing_mm", setup.spacing[0]), ("spacing_mm", setup.spacing[1])] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(parameter(name, value, "must be positive and finite"));
            }
        }
        if setup.arc_samples == 0 || setup.arc_samples > 1000 {
            return Err(parameter("arc_samples", setup.arc_samples, "must be between 1 and 1000"));
        }
        let shape = Shape {
            nx: grid_points(setup.workspace.size[0], setup.spacing[0])?,
            ny: grid_points(setup.workspace.size[1], setup.spacing[1])?,
            headings: setup.needle.headings,
        };
        let states = shape.nx as u128 * shape.ny as u128 * shape.headings as u128 * 2;
        if states > 1 << 40 {
            let rule = "more than 2^40 states; use a coarser grid or fewer headings";
            return Err(Error::TooLarge { states, needed_bytes: states * 16, rule });
        }
        let (regions, region_of) = regions(&setup, shape)?;
        let heading = |k| Direction::of(setup.needle.heading(k), setup.spacing);
        let directions = (0..shape.headings).map(heading).collect();
        let mut lattice =
            LatticeMdp { setup, shape, regions, region_of, directions, outcomes: Vec::new(), endings: Vec::new() };
        lattice.outcomes = lattice.classify();
        lattice.endings = endings(&lattice, &lattice.outcomes);
        Ok(lattice)
    }

    /// Numbers of grid points and headings.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// What it was made from.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// The regular grid partition of the thesis: `[px, py]` blocks of grid points, with all headings and bevels.
    pub fn partition(&self, partitions: [usize; 2]) -> Result<Partition> {
        let Shape { nx, ny, headings } = self.shape;
        let place = |state: usize| [state / 2 / headings / ny, state / 2 / headings % ny];
        Partition::grid(self.shape.states(), [nx, ny], partitions, place)
    }

    /// Outcome codes in table layout.
    pub fn outcome_table(&self) -> Vec<u8> {
        let Shape { nx, ny, headings } = self.shape;
        let states = (0..nx * ny).flat_map(|p| (0..headings * 2).map(move |plane| (p / ny, p % ny, plane)));
        states.map(|(i, j, plane)| self.outcome(i, j, plane / 2, plane % 2)).collect()
    }

    /// Outcome code of the step from `(i, j, k)` that arrives with bevel index `bevel`.
    pub fn outcome(&self, i: usize, j: usize, k: usize, bevel: usize) -> u8 {
        self.outcomes[self.outcome_place(i, j, k, bevel)]
    }

    /// Where the outcome of a step stands.
    #[inline]
    pub(crate) fn outcome_place(&self, i: usize, j: usize, k: usize, bevel: usize) -> usize {
        let Shape { nx, ny, .. } = self.shape;
        let vertical = self.directions[k].is_vertical();
        self.outcome_plane(k, bevel) + if vertical { j * nx + i } else { i * ny + j }
    }

    /// How the needle bends at a grid point.
    #[inline]
    pub(crate) fn region(&self, i: usize, j: usize) -> &Region {
        &self.regions[self.region_of.get(i * self.shape.ny + j).map_or(0, |region| usize::from(*region))]
    }

    /// Where the outcomes of a heading and an arriving bevel begin.
    #[inline]
    pub(crate) fn outcome_plane(&self, k: usize, bevel: usize) -> usize {
        (k * 2 + bevel) * self.shape.nx * self.shape.ny
    }

    pub(crate) fn is_interpolated(&self) -> bool {
        self.setup.transition == Transition::Interpolated
    }

    /// Value of an absorbing state: zero, but with interpolation an obstacle point carries the collision's cost, since
    /// it is a corner of cells from which one still can miss the obstacle.
    pub fn value_at(&self, code: u8) -> f64 {
        match (code, self.setup.transition) {
            (outcome::AT_OBSTACLE, Transition::Interpolated) => self.setup.costs.collision,
            _ => 0.0,
        }
    }

    /// The value of what lies outside the grid, where interpolation reaches there.
    pub fn value_outside(&self) -> f64 {
        match self.setup.transition {
            Transition::Interpolated => self.setup.costs.exit,
            Transition::Nearest => 0.0,
        }
    }
}

fn validate_noise(noise: &[f64]) -> Result<()> {
    if noise.is_empty() || noise.len() > 64 {
        return Err(parameter("tip_noise", format!("{} entries", noise.len()), "must have 1 to 64 entries"));
    }
    if let Some(p) = noise.iter().find(|p| !(**p >= 0.0 && p.is_finite())) {
        return Err(parameter("tip_noise", p, "must be finite and not negative"));
    }
    let sum = noise[0] + 2.0 * noise[1..].iter().sum::<f64>();
    if (sum - 1.0).abs() > 1e-9 {
        return Err(parameter("tip_noise", sum, "P(0) + 2 P(1) + 2 P(2) + ... must be one"));
    }
    Ok(())
}
