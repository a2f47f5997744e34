//! The lattice MDP: its parts, the outcomes of all steps, and how they are stored.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::lattice::direction::Direction;
use crate::lattice::parts::{LatticeParts, Motion, Shape, Transition, outcome};
use crate::lattice::plane::{Plane, copy};
use crate::lattice::terminal_mask::{TerminalMask, terminal_masks};
use crate::memory::filled;
use crate::partition::Partition;
use crate::stop::StopFlag;

/// A Markov decision process on a lattice; [`crate::lattice`] has the mathematics.
#[derive(Debug, Clone)]
pub struct LatticeMdp {
    pub(crate) parts: LatticeParts,
    /// In which direction each heading moves.
    pub(crate) directions: Vec<Direction>,
    /// `[motion][heading][arriving bevel]` planes of `[i][j]`, or of `[j][i]` for headings that move vertically, since sweeps
    /// process them in that order.
    pub(crate) outcomes: Vec<u8>,
    /// The outcomes in the order of the sweeps, by sector.
    pub(crate) terminal_masks: Vec<TerminalMask>,
}

impl LatticeMdp {
    /// Validates the parts and takes the outcome of every step.
    ///
    /// `write_outcomes(motion, k, bevel, codes)` is called once for each motion, heading index `k` and arriving bevel
    /// index, on any thread of the current rayon pool. It writes the [`outcome`] codes of the steps from all grid points to
    /// `codes[i * ny + j]`; `codes` holds arbitrary codes before.
    ///
    /// # Errors
    /// The errors of [`LatticeParts::validate`], and [`Error::Parameter`] for a code above [`outcome::AT_TARGET`], a
    /// nearest step that continues beyond the grid, or a grid point that is absorbing for one of the motions only.
    ///
    /// # Examples
    /// A point that moves right on a row of five grid points, whichever its bevel, until it enters the last one:
    ///
    /// ```
    /// use ppvi::StopRule;
    /// use ppvi::lattice::{
    ///     Costs, HeadingKernel, LatticeMdp, LatticeParts, Region, Shape, Shift, Transition, outcome, sweep,
    /// };
    ///
    /// # fn main() -> ppvi::Result<()> {
    /// let right = Shift { cell: [1, 0], fraction: [0.0, 0.0] };
    /// let straight = HeadingKernel::new(vec![(0, 1.0)])?;
    /// let parts = LatticeParts {
    ///     shape: Shape { nx: 5, ny: 1, headings: 1 },
    ///     spacing: [1.0, 1.0],
    ///     transition: Transition::Nearest,
    ///     costs: Costs { step: 2.0, rotation: 1.0, collision: 100.0, exit: 100.0, discount: 1.0 },
    ///     regions: vec![Region {
    ///         step_length: 1.0,
    ///         step_cost: 2.0,
    ///         stencil: vec![[right, right]],
    ///         turn: [straight.clone(), straight],
    ///     }],
    ///     straight: Vec::new(),
    ///     region_of: Vec::new(),
    /// };
    /// let lattice = LatticeMdp::new(parts, |_, _, _, codes| {
    ///     codes.copy_from_slice(&[0, 0, 0, outcome::TARGET, outcome::AT_TARGET]);
    /// })?;
    /// let solution = sweep::solve(&lattice, StopRule::new(1e-3)?, None)?;
    /// assert_eq!(solution.values, [8.0, 8.0, 6.0, 6.0, 4.0, 4.0, 2.0, 2.0, 0.0, 0.0]);
    /// # Ok(())
    /// # }
    /// ```
    pub fn new(parts: LatticeParts, write_outcomes: impl Fn(Motion, usize, usize, &mut [u8]) + Sync) -> Result<Self> {
        parts.validate()?;
        let directions = Direction::of_headings(parts.shape.headings, parts.spacing);
        let outcomes = gather_outcomes(&parts, &directions, write_outcomes)?;
        require_same_points(&parts, &outcomes)?;
        let terminal_masks = terminal_masks(&parts, &directions, &outcomes);
        Ok(LatticeMdp { parts, directions, outcomes, terminal_masks })
    }

    /// Numbers of grid points and headings.
    pub fn shape(&self) -> Shape {
        self.parts.shape
    }

    /// The parts that define the problem.
    pub fn parts(&self) -> &LatticeParts {
        &self.parts
    }

    /// The regular grid partition of the thesis: `[px, py]` blocks of grid points, with all headings and bevels.
    ///
    /// # Errors
    /// The errors of [`Partition::grid`].
    pub fn partition(&self, partitions: [usize; 2]) -> Result<Partition> {
        let Shape { nx, ny, headings } = self.parts.shape;
        let place = |state: usize| [state / 2 / headings / ny, state / 2 / headings % ny];
        Partition::grid(self.parts.shape.states(), [nx, ny], partitions, place)
    }

    /// Outcome codes of the steps of a motion, in table layout by the bevel with which they arrive.
    ///
    /// # Panics
    /// For a motion that the lattice does not have.
    pub fn outcome_table(&self, motion: Motion) -> Vec<u8> {
        let Shape { nx, ny, headings } = self.parts.shape;
        let stop = StopFlag::current();
        let points = (0..nx * ny).inspect(|_| stop.check());
        let states = points.flat_map(|p| (0..headings * 2).map(move |plane| (p / ny, p % ny, plane)));
        states.map(|(i, j, plane)| self.outcome(motion, i, j, plane / 2, plane % 2)).collect()
    }

    /// Outcome code of the step of a motion from `(i, j, k)` that arrives with bevel index `bevel`.
    ///
    /// # Panics
    /// For a motion that the lattice does not have.
    #[inline]
    pub fn outcome(&self, motion: Motion, i: usize, j: usize, k: usize, bevel: usize) -> u8 {
        self.outcomes[self.outcome_place(motion, i, j, k, bevel)]
    }

    /// Index of the outcome of a step in `outcomes`.
    #[inline]
    pub(crate) fn outcome_place(&self, motion: Motion, i: usize, j: usize, k: usize, bevel: usize) -> usize {
        let Shape { nx, ny, .. } = self.parts.shape;
        let vertical = self.directions[k].is_vertical();
        self.parts.shape.plane(motion, k, bevel) + if vertical { j * nx + i } else { i * ny + j }
    }

    pub(crate) fn is_interpolated(&self) -> bool {
        self.parts.transition == Transition::Interpolated
    }

    /// Value of an absorbing state with this outcome code. It is zero, except for obstacle points with interpolation:
    /// such a point is a corner of cells from which the obstacle can still be missed, so its value is the cost of a
    /// collision.
    pub fn value_at(&self, code: u8) -> f64 {
        match (code, self.parts.transition) {
            (outcome::AT_OBSTACLE, Transition::Interpolated) => self.parts.costs.collision,
            _ => 0.0,
        }
    }

    /// The value of positions outside the grid, which interpolation may read.
    pub fn value_outside(&self) -> f64 {
        match self.parts.transition {
            Transition::Interpolated => self.parts.costs.exit,
            Transition::Nearest => 0.0,
        }
    }
}

/// All outcome codes, laid out as [`LatticeMdp::outcomes`] says.
fn gather_outcomes(
    parts: &LatticeParts,
    directions: &[Direction],
    write_outcomes: impl Fn(Motion, usize, usize, &mut [u8]) + Sync,
) -> Result<Vec<u8>> {
    let Shape { nx, ny, headings } = parts.shape;
    let mut outcomes = filled(0u8, parts.motions().len() * headings * 2 * nx * ny);
    let stop = StopFlag::current();
    outcomes.par_chunks_mut(nx * ny).enumerate().try_for_each_init(
        || vec![0u8; nx * ny],
        |plane, (row, to)| {
            stop.check();
            let (motion, k, bevel) = (parts.motions()[row / 2 / headings], row / 2 % headings, row % 2);
            write_outcomes(motion, k, bevel, plane);
            // Not `Iterator::max`, which the compiler does not vectorise.
            let largest = plane.iter().fold(0, |largest, code| if *code > largest { *code } else { largest });
            if largest > outcome::AT_TARGET {
                let found = format!("{largest} at heading {k}, bevel index {bevel}");
                return Err(Error::parameter("outcomes", found, "must be a code from CONTINUES to AT_TARGET"));
            }
            require_ends_on_grid(parts, directions[k], (motion, k, bevel), plane)?;
            let vertical = directions[k].is_vertical();
            let from = Plane { start: 0, stride: ny };
            let into = Plane { start: 0, stride: if vertical { nx } else { ny } };
            copy((plane, from), (to, into), [nx, ny], vertical, |code| code);
            Ok(())
        },
    )?;
    Ok(outcomes)
}

/// Checks that the same grid points are absorbing for both motions, since that is a property of the point.
fn require_same_points(parts: &LatticeParts, outcomes: &[u8]) -> Result<()> {
    if parts.straight.is_empty() {
        return Ok(());
    }
    let (curved, straight) = outcomes.split_at(outcomes.len() / 2);
    let absorbing = |code: &u8| if *code >= outcome::AT_OBSTACLE { *code } else { 0 };
    match curved.iter().zip(straight).find(|(a, b)| absorbing(a) != absorbing(b)) {
        None => Ok(()),
        Some((a, b)) => {
            let rule = "must be absorbing for both motions at the same grid points";
            Err(Error::parameter("outcomes", format!("{a} and {b}"), rule))
        }
    }
}

/// Checks that no nearest step of a motion, heading `k` and arriving bevel index `bevel` continues beyond the grid: the sweep
/// and the definition would read different values there. Interpolated steps read the cost of an exit.
fn require_ends_on_grid(
    parts: &LatticeParts,
    direction: Direction,
    (motion, k, bevel): (Motion, usize, usize),
    codes: &[u8],
) -> Result<()> {
    if parts.transition == Transition::Interpolated {
        return Ok(());
    }
    let Shape { nx, ny, .. } = parts.shape;
    let cells = |axis: usize| {
        (0..parts.regions.len()).map(move |region| parts.step(motion, region).stencil[k][bevel].cell[axis])
    };
    let reach = [0, 1].map(|axis| cells(axis).map(|cell| cell.unsigned_abs() as usize).max().unwrap_or(0));
    let near = |at: usize, points: usize, axis: usize| at < reach[axis] || at + reach[axis] >= points;
    for i in 0..nx {
        for j in 0..ny {
            if !(near(i, nx, 0) || near(j, ny, 1)) || codes[i * ny + j] != outcome::CONTINUES {
                continue;
            }
            let [dx, dy] = parts.step(motion, direction.region(parts, i, j)).stencil[k][bevel].cell;
            let on_grid =
                |at: usize, cell: i32, points: usize| (0..points as i64).contains(&(at as i64 + i64::from(cell)));
            if !(on_grid(i, dx, nx) && on_grid(j, dy, ny)) {
                let found = format!("CONTINUES at point ({i}, {j}), heading {k}, bevel index {bevel}");
                let rule = "must be another code, such as EXIT, where a step ends beyond the grid";
                return Err(Error::parameter("outcomes", found, rule));
            }
        }
    }
    Ok(())
}
