//! Executions in the continuous model with noise of the tangent.

use ppvi::space::{SUCCESS_STEPS, SpaceTables, voxel};
use ppvi::{Error, Result, StopFlag};
use rand::SeedableRng;
use rand::rand_core::Rng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;

use crate::space::arc::{SpaceArc, SpacePose, Vec3, bevel, turned, unit};
use crate::space::problem::SpaceProblem;
use crate::workspace::Event;

/// Runs that are shared among threads at a time.
const BATCH: usize = 1 << 12;

/// Executes the policy of solved tables.
#[derive(Debug, Clone, Copy)]
pub struct SpaceExecutor<'a> {
    pub(crate) problem: &'a SpaceProblem,
    pub(crate) tables: &'a SpaceTables,
}

/// One execution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceRun {
    /// How it ended.
    pub event: Event,
    /// Inserted length, mm.
    pub length: f64,
    /// Steps that turn the needle to another roll angle than the step before.
    pub rotations: u32,
    /// Sum of all costs.
    pub cost: f64,
}

/// The end of a step in the continuous model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepEnd {
    pub event: Option<Event>,
    pub pose: SpacePose,
    /// Inserted length, mm.
    pub length: f64,
    /// Length of the whole step, mm, which is its price even if an event ends it.
    pub whole: f64,
}

fn event(code: u8) -> Option<Event> {
    match code {
        voxel::TARGET => Some(Event::Target),
        voxel::OBSTACLE => Some(Event::Collision),
        voxel::OUTSIDE => Some(Event::Exit),
        _ => None,
    }
}

impl<'a> SpaceExecutor<'a> {
    /// Takes a problem and its tables.
    ///
    /// # Errors
    /// [`Error::Length`] for tables of another size.
    pub fn new(problem: &'a SpaceProblem, tables: &'a SpaceTables) -> Result<Self> {
        let expected = problem.mdp().shape().states();
        let lengths =
            [("values", tables.values.len()), ("policy", tables.policy.len()), ("success", tables.success.len())];
        match lengths.into_iter().find(|(_, found)| *found != expected) {
            Some((name, found)) => Err(Error::Length { name, expected, found }),
            None => Ok(SpaceExecutor { problem, tables }),
        }
    }

    /// Checks that a pose is in the volume and in the cone; its tangent gets the length one.
    pub(crate) fn checked(&self, pose: SpacePose) -> Result<SpacePose> {
        let pose = SpacePose { tangent: unit(pose.tangent), ..pose };
        let finite = pose.tangent.iter().all(|x| x.is_finite());
        if !finite
            || self.problem.setup().volume.index(pose.position).is_none()
            || !self.problem.directions().contains(pose.tangent)
        {
            let rule = "must be finite, in the volume, with a tangent in the cone";
            return Err(Error::parameter("pose", format!("{pose:?}"), rule));
        }
        Ok(pose)
    }

    /// Event at a pose: that of its voxel, or the exit from the cone.
    pub(crate) fn event_at(&self, pose: &SpacePose) -> Option<Event> {
        let cone = || (!self.problem.directions().contains(pose.tangent)).then_some(Event::Exit);
        event(self.problem.setup().volume.code(pose.position)).or_else(cone)
    }

    pub(crate) fn failure_cost(&self, event: Event) -> f64 {
        let costs = &self.problem.setup().costs;
        match event {
            Event::Collision => costs.collision,
            Event::Exit => costs.exit,
            Event::Target => 0.0,
        }
    }

    /// Advance, mm, of the step from a position along the axis: to the plane `advance` slices beyond the one that it has
    /// reached.
    fn advance(&self, x: f64) -> f64 {
        let setup = self.problem.setup();
        let spacing = setup.volume.spacing()[0];
        let reached = (x / spacing + 1e-6).floor();
        (reached + setup.advance as f64) * spacing - x
    }

    /// Makes a step, without the noise at its end.
    pub(crate) fn step(&self, from: SpacePose, action: usize) -> StepEnd {
        let setup = self.problem.setup();
        let (roll, share) = setup.motion(action);
        let advance = self.advance(from.position[0]);
        let normal = bevel(from.tangent, roll);
        if setup.volume.tissues().is_empty() {
            let arc = SpaceArc { start: from, normal, curvature: setup.volume.curvatures()[0] * share };
            return self.along(arc, advance);
        }
        self.through_tissues(from, normal, advance, share)
    }

    /// Moves along an arc until it has advanced, or to the first of the tested points with an event.
    fn along(&self, arc: SpaceArc, advance: f64) -> StepEnd {
        let setup = self.problem.setup();
        let Some(length) = arc.length_to(advance) else {
            let whole = advance / arc.start.tangent[0];
            return StepEnd { event: Some(Event::Exit), pose: arc.start, length: whole, whole };
        };
        let samples = setup.samples();
        for sample in 1..=samples {
            let s = length * sample as f64 / samples as f64;
            let pose = arc.at(s);
            let met = event(setup.volume.code(pose.position));
            if met.is_some() || sample == samples {
                return StepEnd { event: met, pose, length: s, whole: length };
            }
        }
        unreachable!("a step has samples")
    }

    /// The same where the curvature varies: in pieces as long as those between tested points, each with the curvature at
    /// its start.
    fn through_tissues(&self, from: SpacePose, mut normal: Vec3, advance: f64, share: f64) -> StepEnd {
        let setup = self.problem.setup();
        let samples = setup.samples();
        let piece = advance / from.tangent[0] / samples as f64;
        let (mut pose, mut length) = (from, 0.0);
        for _ in 0..8 * samples {
            let arc = SpaceArc { start: pose, normal, curvature: setup.volume.curvature(pose.position) * share };
            let left = arc.length_to(from.position[0] + advance - pose.position[0]);
            let is_last = left.is_some_and(|left| left <= piece);
            let s = left.filter(|_| is_last).unwrap_or(piece);
            (pose, normal, length) = (arc.at(s), arc.normal_at(s), length + s);
            let met = event(setup.volume.code(pose.position));
            if met.is_some() || is_last {
                return StepEnd { event: met, pose, length, whole: length.max(advance / from.tangent[0]) };
            }
        }
        StepEnd { event: Some(Event::Exit), pose, length, whole: length }
    }

    /// Executes the policy many times by a look one step ahead. Each run has its own random stream, so results do not depend
    /// on the number of threads.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a start outside the volume or the cone.
    pub fn rollout(&self, start: SpacePose, runs: usize, seed: u64) -> Result<Vec<SpaceRun>> {
        let start = self.checked(start)?;
        let stop = StopFlag::current();
        let mut all = Vec::with_capacity(runs);
        for first in (0..runs).step_by(BATCH) {
            let batch = (first..runs.min(first + BATCH)).into_par_iter().with_min_len(16).map(|run| {
                stop.check();
                self.run(start, &mut stream(seed, run as u64), |_| ())
            });
            all.par_extend(batch);
        }
        Ok(all)
    }

    /// One execution; `record` takes the pose after every step.
    pub(crate) fn run(
        &self,
        start: SpacePose,
        random: &mut Xoshiro256PlusPlus,
        mut record: impl FnMut(SpacePose),
    ) -> SpaceRun {
        let setup = self.problem.setup();
        let (mut pose, mut last) = (start, None);
        let mut run = SpaceRun { event: Event::Exit, length: 0.0, rotations: 0, cost: 0.0 };
        let mut met = self.event_at(&pose);
        while met.is_none() {
            let (action, _) = self.best_action(pose);
            let end = self.step(pose, action);
            run.length += end.length;
            run.rotations += u32::from(action < setup.rolls && last.is_some_and(|last| last != action));
            run.cost += setup.step_cost(action, end.whole) + self.price(pose.position) * end.whole;
            last = Some(action);
            pose = end.pose;
            met = end.event;
            if met.is_none() {
                pose.tangent = disturbed(pose.tangent, setup.noise * end.length.sqrt(), random);
                met = self.event_at(&pose);
            }
            record(pose);
        }
        run.event = met.unwrap_or(Event::Exit);
        run.cost += self.failure_cost(run.event);
        run
    }

    /// Price of a mm at a position.
    pub(crate) fn price(&self, position: Vec3) -> f64 {
        let setup = self.problem.setup();
        let index = setup.volume.index(position).filter(|_| !setup.prices.is_empty());
        index.map_or(0.0, |index| f64::from(setup.prices[index]))
    }

    /// Stored success of a state.
    #[inline]
    pub(crate) fn success_of(&self, state: usize) -> f64 {
        f64::from(self.tables.success[state]) / f64::from(SUCCESS_STEPS)
    }
}

/// A tangent turned by two independent normal angles across it, each with this standard deviation, rad.
fn disturbed(tangent: Vec3, sigma: f64, random: &mut Xoshiro256PlusPlus) -> Vec3 {
    if sigma == 0.0 {
        return tangent;
    }
    turned(tangent, normal_pair(random).map(|x| x * sigma))
}

/// Two independent standard normal numbers (Box and Muller 1958).
fn normal_pair(random: &mut Xoshiro256PlusPlus) -> [f64; 2] {
    let mut uniform = || ((random.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    let (radius, (sin, cos)) = ((-2.0 * uniform().ln()).sqrt(), (std::f64::consts::TAU * uniform()).sin_cos());
    [radius * cos, radius * sin]
}

/// The random stream of a run: seed and run number, mixed by splitmix64 inside `seed_from_u64`.
pub(crate) fn stream(seed: u64, run: u64) -> Xoshiro256PlusPlus {
    let spread = run.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(32);
    Xoshiro256PlusPlus::seed_from_u64(seed ^ spread)
}
