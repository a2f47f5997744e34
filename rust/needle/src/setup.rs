//! The description of a steering problem.

use ppvi::lattice::{Costs, Shape, Transition};
use ppvi::{Error, Result};

use crate::bicycle::Bicycle;
use crate::tissues::Tissues;
use crate::workspace::{Workspace, grid_points};

/// A needle in a workspace, the grid on which it is planned for, and the costs.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Rectangle, obstacles, target.
    pub workspace: Workspace,
    /// Nominal curvature, and the number of headings.
    pub needle: Bicycle,
    /// Grid spacing along x and y, mm.
    pub spacing: [f64; 2],
    /// P(0), P(+-1), P(+-2), ... heading steps.
    pub noise: Vec<f64>,
    /// Number of points of each arc that are tested for collision, exit and target; 0 tests the whole arc.
    pub arc_samples: usize,
    /// Nearest or interpolated.
    pub transition: Transition,
    /// Costs and discount. The cost of a step is that of the nominal curvature.
    pub costs: Costs,
    /// Curvature by position.
    pub tissues: Tissues,
}

impl Setup {
    /// Shape of the grid.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a spacing or a number of arc samples out of range, [`Error::TooLarge`] for a grid of
    /// more than 2^40 states.
    pub fn shape(&self) -> Result<Shape> {
        if let Some(spacing) = self.spacing.iter().find(|spacing| !(**spacing > 0.0 && spacing.is_finite())) {
            return Err(Error::parameter("spacing_mm", spacing, "must be positive and finite"));
        }
        if self.arc_samples > 1000 {
            return Err(Error::parameter("arc_samples", self.arc_samples, "must be between 0 and 1000"));
        }
        let shape = Shape {
            nx: grid_points(self.workspace.size[0], self.spacing[0])?,
            ny: grid_points(self.workspace.size[1], self.spacing[1])?,
            headings: self.needle.headings,
        };
        shape.validate()?;
        Ok(shape)
    }
}
