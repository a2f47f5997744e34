//! A steering problem in space: its description, and the Markov decision process made from it.

use std::f64::consts::TAU;

use ppvi::lattice::LARGEST_COST;
use ppvi::space::{FailureCosts, SpaceMdp, SpaceParts, SpaceShape, SpaceStep};
use ppvi::{Error, Result};
use rayon::prelude::*;

use crate::setup::Straight;
use crate::space::arc::{SpaceArc, SpacePose, Vec3, bevel};
use crate::space::directions::DirectionGrid;
use crate::space::volume::Volume;

/// Points of a step that are tested, for each voxel edge that it may pass along.
const SAMPLES_PER_VOXEL: f64 = 4.0;

/// Costs of steps and failures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceCosts {
    /// Cost of a mm.
    pub insertion_per_mm: f64,
    /// Cost of turning to the roll angle of a step, whatever the angle.
    pub rotation: f64,
    /// Cost of a collision.
    pub collision: f64,
    /// Cost of leaving the volume or the cone.
    pub exit: f64,
}

/// A needle in a volume, the grid on which it is planned for, and the costs.
#[derive(Debug, Clone, PartialEq)]
pub struct SpaceSetup {
    /// Voxels and curvature.
    pub volume: Volume,
    /// Slices that a step advances.
    pub advance: usize,
    /// Number of roll angles, equally spaced from the y axis on.
    pub rolls: usize,
    /// The straight action; None where there is none.
    pub straight: Option<Straight>,
    /// Half angle of the cone of directions, rad.
    pub cone: f64,
    /// Spacing of the directions, rad.
    pub direction_spacing: f64,
    /// Standard deviation of the tangent after 1 mm, in each of two directions across it, rad; it grows with the root of the
    /// length.
    pub noise: f64,
    /// Costs.
    pub costs: SpaceCosts,
    /// Price of a mm of insertion from each voxel, beside that of the step; empty if there is none.
    pub prices: Vec<f32>,
}

impl SpaceSetup {
    fn validate(&self) -> Result<()> {
        let costs = &self.costs;
        for (name, cost) in [("rotation", costs.rotation), ("collision", costs.collision), ("exit", costs.exit)] {
            if !(0.0..=LARGEST_COST).contains(&cost) {
                return Err(Error::parameter(name, cost, "must not be negative, and at most 1e20"));
            }
        }
        if !(costs.insertion_per_mm > 0.0 && costs.insertion_per_mm <= LARGEST_COST) {
            let rule = "must be positive, and at most 1e20";
            return Err(Error::parameter("insertion_per_mm", costs.insertion_per_mm, rule));
        }
        if !(1..=64).contains(&self.rolls) {
            return Err(Error::parameter("rolls", self.rolls, "must be between 1 and 64"));
        }
        if !(1..=64).contains(&self.advance) {
            return Err(Error::parameter("advance", self.advance, "must be between 1 and 64 slices"));
        }
        if !(self.noise >= 0.0 && self.noise.is_finite()) {
            return Err(Error::parameter("tip_noise", self.noise, "must be finite and not negative"));
        }
        match self.straight {
            Some(Straight { curvature_share: share, .. }) if !(0.0..=1.0).contains(&share) => {
                Err(Error::parameter("straight_curvature_share", share, "must be from 0 to 1"))
            }
            Some(Straight { cost_per_mm: cost, .. }) if !(cost > 0.0 && cost <= LARGEST_COST) => {
                Err(Error::parameter("straight_per_mm", cost, "must be positive, and at most 1e20"))
            }
            _ => Ok(()),
        }
    }

    /// Number of actions: the roll angles, and the straight step if there is one.
    pub fn actions(&self) -> usize {
        self.rolls + usize::from(self.straight.is_some())
    }

    /// Roll angle, rad, of an action and the share of the curvature that it uses.
    #[inline]
    pub(crate) fn motion(&self, action: usize) -> (f64, f64) {
        match self.straight {
            Some(straight) if action == self.rolls => (0.0, straight.curvature_share),
            _ => (TAU * action as f64 / self.rolls as f64, 1.0),
        }
    }

    /// Cost of a step of an action.
    #[inline]
    pub(crate) fn step_cost(&self, action: usize, length: f64) -> f64 {
        match self.straight {
            Some(straight) if action == self.rolls => straight.cost_per_mm * length,
            _ => self.costs.insertion_per_mm * length + self.costs.rotation,
        }
    }

    /// Number of points of a step that are tested for events: at least four for each voxel edge along its longest way.
    pub(crate) fn samples(&self) -> usize {
        let spacing = self.volume.spacing();
        let longest = self.advance as f64 * spacing[0] / self.cone.cos();
        let least = spacing.into_iter().fold(f64::INFINITY, f64::min);
        (SAMPLES_PER_VOXEL * longest / least).ceil() as usize
    }
}

/// A [`SpaceSetup`] and its Markov decision process, which belong together.
#[derive(Debug, Clone)]
pub struct SpaceProblem {
    setup: SpaceSetup,
    directions: DirectionGrid,
    mdp: SpaceMdp,
}

impl SpaceProblem {
    /// Validates the setup and makes the steps.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a value out of range, those of [`DirectionGrid::new`] and of [`SpaceMdp::new`].
    pub fn new(setup: SpaceSetup) -> Result<Self> {
        setup.validate()?;
        let directions = DirectionGrid::new(setup.cone, setup.direction_spacing)?;
        let volume = &setup.volume;
        let [slices, ny, nz] = volume.shape();
        let curvatures = volume.curvatures().par_iter();
        let actions = setup.actions();
        let regions = curvatures.map(|curvature| {
            let step = |number: usize| grid_step(&setup, &directions, *curvature, number / actions, number % actions);
            (0..directions.count() * actions).map(step).collect()
        });
        let parts = SpaceParts {
            shape: SpaceShape { slices, ny, nz, directions: directions.count() },
            advance: setup.advance,
            costs: FailureCosts { collision: setup.costs.collision, exit: setup.costs.exit },
            voxels: volume.codes().to_vec(),
            regions: regions.collect(),
            region_of: volume.tissues().to_vec(),
            look: (0..directions.count()).map(|direction| half_way(&setup, directions.tangent(direction))).collect(),
            prices: setup.prices.clone(),
        };
        let mdp = SpaceMdp::new(parts)?;
        Ok(SpaceProblem { setup, directions, mdp })
    }

    /// The description.
    pub fn setup(&self) -> &SpaceSetup {
        &self.setup
    }

    /// The directions.
    pub fn directions(&self) -> &DirectionGrid {
        &self.directions
    }

    /// The Markov decision process.
    pub fn mdp(&self) -> &SpaceMdp {
        &self.mdp
    }
}

/// The voxel half a step ahead, whose tissue bends the whole step in the plan.
fn half_way(setup: &SpaceSetup, tangent: Vec3) -> [i32; 3] {
    let spacing = setup.volume.spacing();
    let half = 0.5 * setup.advance as f64 * spacing[0] / tangent[0];
    [0, 1, 2].map(|axis| (half * tangent[axis] / spacing[axis]).round() as i32)
}

/// The step of an action in a direction of the grid.
fn grid_step(
    setup: &SpaceSetup,
    directions: &DirectionGrid,
    curvature: f64,
    direction: usize,
    action: usize,
) -> SpaceStep {
    let spacing = setup.volume.spacing();
    let (roll, share) = setup.motion(action);
    let tangent = directions.tangent(direction);
    let start = SpacePose { position: [0.0; 3], tangent };
    let arc = SpaceArc { start, normal: bevel(tangent, roll), curvature: curvature * share };
    let advance = setup.advance as f64 * spacing[0];
    let Some(length) = arc.length_to(advance) else {
        // It turns back before the plane: as long as the straight step, and lost.
        let length = advance / tangent[0];
        let cost = setup.step_cost(action, length);
        return SpaceStep { cost, length, path: vec![], cell: [0; 2], fraction: [0.0; 2], taps: vec![], lost: 1.0 };
    };
    let end = arc.at(length);
    let (taps, lost) = directions.stencil(end.tangent, setup.noise * setup.noise * length);
    let landing = [1, 2].map(|axis| snap(end.position[axis] / spacing[axis]));
    let (cell, fraction) = (landing.map(|x| x.floor() as i32), landing.map(|x| x - x.floor()));
    let mut path: Vec<[i32; 3]> = Vec::new();
    let samples = setup.samples();
    for sample in 1..=samples {
        let voxel = if sample == samples {
            let near = |axis: usize| cell[axis] + i32::from(fraction[axis] >= 0.5);
            [setup.advance as i32, near(0), near(1)]
        } else {
            let point = arc.at(length * sample as f64 / samples as f64).position;
            [0, 1, 2].map(|axis| (point[axis] / spacing[axis] + 0.5).floor() as i32)
        };
        if path.last() != Some(&voxel) && (voxel != [0; 3] || !path.is_empty()) {
            path.push(voxel);
        }
    }
    SpaceStep { cost: setup.step_cost(action, length), length, path, cell, fraction, taps, lost }
}

/// The nearest whole number if it is closer than rounding errors.
fn snap(x: f64) -> f64 {
    if (x - x.round()).abs() < 1e-9 { x.round() } else { x }
}
