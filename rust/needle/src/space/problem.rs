//! A steering problem in 3D: its description, and the Markov decision process made from it.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use ppvi::lattice::LARGEST_COST;
use ppvi::space::{Branch, FailureCosts, SpaceMdp, SpaceParts, SpaceShape, SpaceStep};
use ppvi::{Error, Result};
use rayon::prelude::*;

use crate::setup::Straight;
use crate::space::arc::{SpaceArc, SpacePose, Vec3, bevel};
use crate::space::directions::DirectionGrid;
use crate::space::open_space::OpenSpace;
use crate::space::volume::Volume;

/// Chords of a part of a step, for each spacing of the grid that it may pass along. With the spacing h an arc of the radius R is
/// h^2 / (128 R) from its chord at most: for 2 mm and 40 mm, 0.001 mm.
const CHORDS_PER_SPACING: f64 = 4.0;

/// Share of the way of a step after which the noise turns the tip in the plan: 1 - 1 / sqrt(3). So direction and position
/// after the step have the variance that noise all along the way gives them.
pub(crate) const DISTURBED_AT: f64 = 0.422_649_730_810_374_2;

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
    /// Price of a mm of insertion from each grid point, beside that of the step; empty if there is none.
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

    /// Number of chords into which each part of a step is cut: at least four for each spacing along the longest way. All
    /// voxels that a chord crosses are tested for events.
    pub(crate) fn samples(&self) -> usize {
        let spacing = self.volume.spacing();
        let longest = (1.0 - DISTURBED_AT) * self.advance as f64 * spacing[0] / self.cone.cos();
        let least = spacing.into_iter().fold(f64::INFINITY, f64::min);
        (CHORDS_PER_SPACING * longest / least).ceil() as usize
    }
}

/// A [`SpaceSetup`] and its Markov decision process, which belong together.
#[derive(Debug, Clone)]
pub struct SpaceProblem {
    setup: SpaceSetup,
    directions: DirectionGrid,
    mdp: SpaceMdp,
    pub(crate) open: OnceLock<OpenSpace>,
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
            voxels: volume.voxels().clone(),
            regions: regions.collect(),
            region_of: volume.tissues().to_vec(),
            look: (0..directions.count()).map(|direction| half_way(&setup, directions.tangent(direction))).collect(),
            prices: setup.prices.clone(),
        };
        let mdp = SpaceMdp::new(parts)?;
        Ok(SpaceProblem { setup, directions, mdp, open: OnceLock::new() })
    }

    /// The description.
    pub fn setup(&self) -> &SpaceSetup {
        &self.setup
    }

    /// The directions.
    pub fn directions(&self) -> &DirectionGrid {
        &self.directions
    }

    /// Length, mm, of the paths from a point that meet nothing and stay in its tissue: shorter ones than this.
    #[inline]
    pub(crate) fn open_around(&self, point: Vec3) -> f64 {
        self.open.get_or_init(|| OpenSpace::new(&self.setup.volume)).around(&self.setup.volume, point)
    }

    /// The Markov decision process.
    pub fn mdp(&self) -> &SpaceMdp {
        &self.mdp
    }
}

/// The grid point half a step ahead, whose tissue bends the whole step in the plan.
fn half_way(setup: &SpaceSetup, tangent: Vec3) -> [i32; 3] {
    let spacing = setup.volume.spacing();
    let half = 0.5 * setup.advance as f64 * spacing[0] / tangent[0];
    [0, 1, 2].map(|axis| (half * tangent[axis] / spacing[axis]).round() as i32)
}

/// The step of an action in a direction of the grid. [The module](crate::space) has the mathematics of its branches.
fn grid_step(
    setup: &SpaceSetup,
    directions: &DirectionGrid,
    curvature: f64,
    direction: usize,
    action: usize,
) -> SpaceStep {
    let (volume, spacing) = (&setup.volume, setup.volume.spacing());
    let (roll, share) = setup.motion(action);
    let tangent = directions.tangent(direction);
    let start = SpacePose { position: [0.0; 3], tangent };
    let arc = SpaceArc { start, normal: bevel(tangent, roll), curvature: curvature * share };
    let advance = setup.advance as f64 * spacing[0];
    let (Some(length), Some(first)) = (arc.length_to(advance), arc.length_to(DISTURBED_AT * advance)) else {
        // It turns back before the plane: as long as the straight step, and lost.
        let length = advance / tangent[0];
        let cost = setup.step_cost(action, length);
        return SpaceStep { cost, length, path: vec![], rests: vec![], branches: vec![], lost: 1.0, spread: [0.0; 2] };
    };
    let mean = arc.at(length).tangent;
    let stencil = directions.stencil(mean, setup.noise * setup.noise * length);
    let left = advance - arc.at(first).position[0];
    let fan = |place: [usize; 2]| {
        let rest = arc.disturbed(first, [mean, stencil.kicked(place)]);
        rest.length_to(left).map(|length| (rest, length))
    };
    // Where a branch lands along y depends on its disturbance along u, but for little, and along z on that along v. So
    // branches share columns, in which the pass sums them.
    let landing = |place: [usize; 2], axis: usize| {
        let (rest, length) = fan(place)?;
        Some(snap(rest.at(length).position[axis] / spacing[axis]))
    };
    let [along_y, along_z] = [[0, 1, 2].map(|i| landing([i, 1], 1)), [0, 1, 2].map(|j| landing([1, j], 2))];
    let samples = setup.samples();
    let ends = |arc: SpaceArc, length: f64, number: usize| {
        (1..=number).map(move |sample| arc.at(length * sample as f64 / samples as f64).position)
    };
    let mut path = Vec::new();
    let turn = pass_chords(volume, &mut path, ([0; 3], [0.0; 3]), ends(arc, first, samples));
    let voxel = path.last().copied().unwrap_or_default();
    let (mut rests, mut branches): (Vec<Vec<[i32; 3]>>, Vec<Branch>) = Default::default();
    for tap in &stencil.taps {
        let [i, j] = tap.place;
        // A branch that turns back before the plane is lost.
        let (Some((rest, length)), Some(y), Some(z)) = (fan(tap.place), along_y[i], along_z[j]) else { continue };
        let (cell, fraction) = ([y, z].map(|x| x.floor() as i32), [y, z].map(|x| x - x.floor()));
        let mut rest_path = Vec::new();
        let before = pass_chords(volume, &mut rest_path, (voxel, turn), ends(rest, length, samples - 1));
        let landing = [setup.advance as f64 * spacing[0], y * spacing[1], z * spacing[2]];
        let end = volume.cell(landing);
        volume.passed(before, landing).filter(|at| *at != end).for_each(|at| pass(&mut rest_path, voxel, at));
        let refinement = volume.voxels().refinement();
        let mut branch = Branch { direction: tap.direction, weight: tap.weight, rest: 0, cell, fraction };
        let [near_y, near_z] = branch.voxel(refinement);
        pass(&mut rest_path, [i32::MIN; 3], [(setup.advance * refinement) as i32, near_y, near_z]);
        branch.rest = rests.iter().position(|path| *path == rest_path).unwrap_or_else(|| {
            rests.push(rest_path);
            rests.len() - 1
        });
        branches.push(branch);
    }
    let within: f64 = branches.iter().map(|branch| branch.weight).sum();
    branches.iter_mut().for_each(|branch| branch.weight /= within);
    let lost = if branches.is_empty() { 1.0 } else { (1.0 - (1.0 - stencil.lost) * within).max(0.0) };
    let spread = |axis: usize, landings: [Option<f64>; 3]| {
        let [Some(low), _, Some(high)] = landings else { return 0.0 };
        let (kicks, share) = (stencil.kicks[axis], stencil.shares[axis]);
        let slope = (high - low) / (kicks[2] - kicks[0]).max(1e-12);
        (slope * slope * stencil.variances[axis] * (1.0 - share)).min(1.0)
    };
    let spread = [spread(0, along_y), spread(1, along_z)];
    SpaceStep { cost: setup.step_cost(action, length), length, path, rests, branches, lost, spread }
}

/// Adds a voxel to a path that begins after the voxel `before`, unless the path is in it.
fn pass(path: &mut Vec<[i32; 3]>, before: [i32; 3], voxel: [i32; 3]) {
    if *path.last().unwrap_or(&before) != voxel {
        path.push(voxel);
    }
}

/// Adds the voxels that chords cross to a path, from a place in the voxel `start` to the ends of the chords, one after the other.
/// Returns the last end.
fn pass_chords(
    volume: &Volume,
    path: &mut Vec<[i32; 3]>,
    (start, mut place): ([i32; 3], [f64; 3]),
    ends: impl Iterator<Item = [f64; 3]>,
) -> [f64; 3] {
    for end in ends {
        volume.passed(place, end).for_each(|voxel| pass(path, start, voxel));
        place = end;
    }
    place
}

/// The nearest whole number if it is closer than rounding errors.
fn snap(x: f64) -> f64 {
    if (x - x.round()).abs() < 1e-9 { x.round() } else { x }
}
