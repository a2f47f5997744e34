//! The description of a steering problem.

use ppvi::lattice::{Costs, LARGEST_COST, Motion, Shape, Transition};
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
    /// The straight action; `None` where there is none.
    pub straight: Option<Straight>,
}

/// Nearly straight insertion: the needle turns all the time, or for a part of it (duty cycle), so that its curvature
/// averages out (Minhas et al. 2007). It ends with the bevel with which it began.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Straight {
    /// The curvature that remains, to the side of the bevel, as a share of that of the needle: 0 to 1.
    pub curvature_share: f64,
    /// Cost of a mm.
    pub cost_per_mm: f64,
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
        self.validate_straight()?;
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

    /// The needle with the curvature at a position, mm.
    #[inline]
    pub(crate) fn needle_at(&self, place: [f64; 2]) -> Bicycle {
        self.tissues.needle_at(self.needle, place)
    }

    /// Cost of a step of a motion from a position, mm, where the needle has this curvature: in proportion to its length.
    #[inline]
    pub(crate) fn step_cost(&self, motion: Motion, needle: Bicycle, from: [f64; 2]) -> f64 {
        let Setup { needle: nominal, costs, clearance, .. } = self;
        let cost = match (motion, self.straight) {
            (Motion::Straight, Some(straight)) => straight.cost_per_mm * needle.step_length(),
            _ if needle.step.is_some() || needle.radius == nominal.radius => costs.step,
            _ => costs.step * (needle.radius / nominal.radius),
        };
        if clearance.is_free() { cost } else { cost + clearance.cost_per_mm(from) * needle.step_length() }
    }

    /// The path of a motion of the needle: one with the curvature that remains, and steps of the same length.
    #[inline]
    pub(crate) fn moving(&self, motion: Motion, needle: Bicycle) -> Bicycle {
        match (motion, self.straight) {
            (Motion::Straight, Some(straight)) => {
                Bicycle { radius: needle.radius / straight.curvature_share, step: Some(needle.step_length()), ..needle }
            }
            _ => needle,
        }
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

    /// Standard deviation of the tip noise of a step, rad.
    pub fn noise_sd(&self) -> f64 {
        let squares = self.noise.iter().enumerate().map(|(steps, chance)| 2.0 * chance * (steps * steps) as f64);
        self.noise_step() * squares.sum::<f64>().sqrt()
    }

    fn validate_straight(&self) -> Result<()> {
        match self.straight {
            Some(Straight { curvature_share: share, .. }) if !(0.0..=1.0).contains(&share) => {
                Err(Error::parameter("straight_curvature_share", share, "must be from 0 to 1"))
            }
            Some(Straight { cost_per_mm: cost, .. }) if !(0.0..=LARGEST_COST).contains(&cost) => {
                Err(Error::parameter("straight_per_mm", cost, "must not be negative, and at most 1e20"))
            }
            _ => Ok(()),
        }
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
            straight: None,
        };
        let message = |noise, step| setup(noise, step).shape().map_err(|error| error.to_string()).err();
        assert_eq!(message(&[0.5, 0.25], Some(0.1)), None);
        assert!(message(&[0.5, 0.5], None).is_some_and(|text| text.starts_with("tip_noise = 1.5")));
        assert!(message(&[], None).is_some_and(|text| text.starts_with("tip_noise = 0 entries")));
        assert!(message(&[1.5, -0.25], None).is_some_and(|text| text.starts_with("tip_noise = -0.25")));
        assert!(message(&[1.0], Some(0.0)).is_some_and(|text| text.starts_with("tip_noise_step_deg = 0")));
    }
}
