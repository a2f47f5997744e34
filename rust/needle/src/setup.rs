//! The description of a steering problem.

use ppvi::lattice::{Costs, Shape, Transition};
use ppvi::{Error, Result};

use crate::bicycle::Bicycle;
use crate::clearance::Clearance;
use crate::tissues::Tissues;
use crate::workspace::{Event, Workspace, grid_points};

/// A needle in a workspace, the grid on which it is planned for, and the costs.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Rectangle, obstacles, target.
    pub workspace: Workspace,
    /// Nominal curvature, and the number of headings.
    pub needle: Bicycle,
    /// Grid spacing along x and y, mm.
    pub spacing: [f64; 2],
    /// P(0), P(+-1), P(+-2), ... noise steps.
    pub noise: Vec<f64>,
    /// Noise step, rad; `None`: a heading step.
    pub noise_step: Option<f64>,
    /// Number of points of each arc that are tested for collision, exit and target; 0 tests the whole arc.
    pub arc_samples: usize,
    /// Nearest or interpolated.
    pub transition: Transition,
    /// Costs and discount. The cost of a step is that of the nominal curvature.
    pub costs: Costs,
    /// Curvature by position.
    pub tissues: Tissues,
    /// Price of insertion close to obstacles, beside the cost of a step.
    pub clearance: Clearance,
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
        self.validate_noise()?;
        if self.tissues.is_straight_somewhere() && self.needle.step.is_none() {
            let rule = "must be finite, or the scenario needs step_mm";
            return Err(Error::parameter("curvature_radius_mm", f64::INFINITY, rule));
        }
        let shape = Shape {
            nx: grid_points(self.workspace.size[0], self.spacing[0])?,
            ny: grid_points(self.workspace.size[1], self.spacing[1])?,
            headings: self.needle.headings,
        };
        shape.validate()?;
        Ok(shape)
    }

    /// Cost of a step from a position, mm, where the needle has this curvature: in proportion to its length.
    #[inline]
    pub(crate) fn step_cost(&self, needle: Bicycle, from: [f64; 2]) -> f64 {
        let Setup { needle: nominal, costs, clearance, .. } = self;
        let cost = if needle.step.is_some() || needle.radius == nominal.radius {
            costs.step
        } else {
            costs.step * (needle.radius / nominal.radius)
        };
        if clearance.is_free() { cost } else { cost + clearance.cost_per_mm(from) * needle.step_length() }
    }

    /// The cost of the end of an execution: zero in the target, or if it has not ended.
    pub(crate) fn failure_cost(&self, event: Option<Event>) -> f64 {
        match event {
            Some(Event::Collision) => self.costs.collision,
            Some(Event::Exit) => self.costs.exit,
            _ => 0.0,
        }
    }

    /// Noise step, rad.
    pub fn noise_step(&self) -> f64 {
        self.noise_step.unwrap_or(self.needle.heading_step())
    }

    fn validate_noise(&self) -> Result<()> {
        let noise = &self.noise;
        if noise.is_empty() || noise.len() > 64 {
            return Err(Error::parameter("tip_noise", format!("{} entries", noise.len()), "must have 1 to 64 entries"));
        }
        if let Some(p) = noise.iter().find(|p| !(**p >= 0.0 && p.is_finite())) {
            return Err(Error::parameter("tip_noise", p, "must be finite and not negative"));
        }
        let sum = noise[0] + 2.0 * noise[1..].iter().sum::<f64>();
        if (sum - 1.0).abs() > 1e-9 {
            return Err(Error::parameter("tip_noise", sum, "P(0) + 2 P(1) + 2 P(2) + ... must be one"));
        }
        match self.noise_step {
            Some(step) if !(step > 0.0 && step.is_finite()) => {
                Err(Error::parameter("tip_noise_step_deg", step.to_degrees(), "must be positive and finite"))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_a_distribution() {
        let setup = |noise: &[f64], noise_step: Option<f64>| Setup {
            workspace: Workspace::new([4.0, 4.0], Vec::new(), [2.0, 2.0], 1.0).unwrap(),
            needle: Bicycle::new(4.0, 8).unwrap(),
            spacing: [1.0; 2],
            noise: noise.to_vec(),
            noise_step,
            arc_samples: 1,
            transition: Transition::Nearest,
            costs: Costs { step: 1.0, rotation: 1.0, collision: 1.0, exit: 1.0, discount: 1.0 },
            tissues: Tissues::default(),
            clearance: Clearance::default(),
        };
        let message = |noise, step| setup(noise, step).shape().map_err(|error| error.to_string()).err();
        assert_eq!(message(&[0.5, 0.25], Some(0.1)), None);
        assert!(message(&[0.5, 0.5], None).is_some_and(|text| text.starts_with("tip_noise = 1.5")));
        assert!(message(&[], None).is_some_and(|text| text.starts_with("tip_noise = 0 entries")));
        assert!(message(&[1.5, -0.25], None).is_some_and(|text| text.starts_with("tip_noise = -0.25")));
        assert!(message(&[1.0], Some(0.0)).is_some_and(|text| text.starts_with("tip_noise_step_deg = 0")));
    }
}
