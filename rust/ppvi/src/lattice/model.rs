//! The lattice MDP: its parts, the outcomes of all steps, and how they are stored.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::lattice::direction::Direction;
use crate::lattice::parts::{LatticeParts, Shape, Transition, outcome};
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
    /// `[heading][arriving bevel]` planes of `[i][j]`, or of `[j][i]` for headings that move vertically, since sweeps
    /// process them in that order.
    pub(crate) outcomes: Vec<u8>,
    /// The outcomes in the order of the sweeps, by sector.
    pub(crate) terminal_masks: Vec<TerminalMask>,
}

impl LatticeMdp {
    /// Validates the parts and takes the outcome of every step.
    ///
    /// `write_outcomes(k, bevel, codes)` is called once for each heading index `k` and arriving bevel index, on any
    /// thread of the current rayon pool. It writes the [`outcome`] codes of the steps from all grid points to
    /// `codes[i * ny + j]`; `codes` holds arbitrary codes before.
    ///
    /// # Errors
    /// The errors of [`LatticeParts::validate`], and [`Error::Parameter`] for a code above [`outcome::AT_TARGET`].
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
    ///     region_of: Vec::new(),
    /// };
    /// let lattice = LatticeMdp::new(parts, |_, _, codes| {
    ///     codes.copy_from_slice(&[0, 0, 0, outcome::TARGET, outcome::AT_TARGET]);
    /// })?;
    /// let solution = sweep::solve(&lattice, StopRule::new(1e-3)?, None)?;
    /// assert_eq!(solution.values, [8.0, 8.0, 6.0, 6.0, 4.0, 4.0, 2.0, 2.0, 0.0, 0.0]);
    /// # Ok(())
    /// # }
    /// ```
    pub fn new(parts: LatticeParts, write_outcomes: impl Fn(usize, usize, &mut [u8]) + Sync) -> Result<Self> {
        parts.validate()?;
        let directions = Direction::of_headings(parts.shape.headings, parts.spacing);
        let outcomes = gather_outcomes(&parts, &directions, write_outcomes)?;
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

    /// Outcome codes in table layout.
    pub fn outcome_table(&self) -> Vec<u8> {
        let Shape { nx, ny, headings } = self.parts.shape;
        let stop = StopFlag::current();
        let points = (0..nx * ny).inspect(|_| stop.check());
        let states = points.flat_map(|p| (0..headings * 2).map(move |plane| (p / ny, p % ny, plane)));
        states.map(|(i, j, plane)| self.outcome(i, j, plane / 2, plane % 2)).collect()
    }

    /// Outcome code of the step from `(i, j, k)` that arrives with bevel index `bevel`.
    pub fn outcome(&self, i: usize, j: usize, k: usize, bevel: usize) -> u8 {
        self.outcomes[self.outcome_place(i, j, k, bevel)]
    }

    /// Index of the outcome of a step in `outcomes`.
    #[inline]
    pub(crate) fn outcome_place(&self, i: usize, j: usize, k: usize, bevel: usize) -> usize {
        let Shape { nx, ny, .. } = self.parts.shape;
        let vertical = self.directions[k].is_vertical();
        self.parts.shape.plane(k, bevel) + if vertical { j * nx + i } else { i * ny + j }
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
    write_outcomes: impl Fn(usize, usize, &mut [u8]) + Sync,
) -> Result<Vec<u8>> {
    let Shape { nx, ny, headings } = parts.shape;
    let mut outcomes = filled(0u8, headings * 2 * nx * ny);
    let stop = StopFlag::current();
    outcomes.par_chunks_mut(nx * ny).enumerate().try_for_each_init(
        || vec![0u8; nx * ny],
        |plane, (row, to)| {
            stop.check();
            let (k, bevel) = (row / 2, row % 2);
            write_outcomes(k, bevel, plane);
            // Not `Iterator::max`, which the compiler does not vectorise.
            let largest = plane.iter().fold(0, |largest, code| if *code > largest { *code } else { largest });
            if largest > outcome::AT_TARGET {
                let found = format!("{largest} at heading {k}, bevel index {bevel}");
                return Err(Error::parameter("outcomes", found, "must be a code from CONTINUES to AT_TARGET"));
            }
            require_ends_on_grid(parts, directions[k], [k, bevel], plane)?;
            let vertical = directions[k].is_vertical();
            let from = Plane { start: 0, stride: ny };
            let into = Plane { start: 0, stride: if vertical { nx } else { ny } };
            copy((plane, from), (to, into), [nx, ny], vertical, |code| code);
            Ok(())
        },
    )?;
    Ok(outcomes)
}

/// Checks that no nearest step of heading `k` and arriving bevel index `bevel` continues beyond the grid: the sweep and
/// the definition would read different values there. Interpolated steps read the cost of an exit.
fn require_ends_on_grid(
    parts: &LatticeParts,
    direction: Direction,
    [k, bevel]: [usize; 2],
    codes: &[u8],
) -> Result<()> {
    if parts.transition == Transition::Interpolated {
        return Ok(());
    }
    let Shape { nx, ny, .. } = parts.shape;
    let cells = |axis: usize| parts.regions.iter().map(move |region| region.stencil[k][bevel].cell[axis]);
    let reach = [0, 1].map(|axis| cells(axis).map(|cell| cell.unsigned_abs() as usize).max().unwrap_or(0));
    let near = |at: usize, points: usize, axis: usize| at < reach[axis] || at + reach[axis] >= points;
    for i in 0..nx {
        for j in 0..ny {
            if !(near(i, nx, 0) || near(j, ny, 1)) || codes[i * ny + j] != outcome::CONTINUES {
                continue;
            }
            let [dx, dy] = parts.regions[direction.region(parts, i, j)].stencil[k][bevel].cell;
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
