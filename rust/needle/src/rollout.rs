//! Executions of a policy in the continuous bicycle model with heading noise.
//!
//! A table is solved on a grid, but the needle moves continuously. A rollout keeps the exact pose. Each step takes an
//! action from the policy, moves along the arc, tests points of the arc for events, and adds a random number of heading
//! steps. Every run has its own random stream, so results do not depend on the number of threads.

use ppvi::lattice::{LatticeMdp, Motion, STRAIGHT};
use ppvi::{Error, Result, StopFlag};
use rand::rand_core::Rng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;

use crate::arc::Arc;
use crate::bicycle::Bicycle;
use crate::lookup::{Pose, TableGrid};
use crate::problem::SteeringProblem;
use crate::random::stream;
use crate::setup::Setup;
use crate::surroundings::{AsPlanned, Surroundings, Truth};
use crate::unseen::Unseen;
use crate::workspace::Event;

/// Number of pieces of equal length of an arc through tissues of different curvature, if the whole arc is tested.
const PIECES: usize = 4;

/// How the action at a pose between grid points is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Execution {
    /// The policy at the nearest grid point.
    Nearest,
    /// One step of look-ahead from the exact pose, with values interpolated between grid points.
    Greedy,
}

/// Number of runs that are shared among threads at a time. Few enough that a stop flag, which ends each share by
/// itself, ends them all in a few milliseconds.
const BATCH: usize = 1 << 15;

/// Executes the policy of a table.
#[derive(Debug, Clone, Copy)]
pub struct Executor<'a> {
    pub(crate) setup: &'a Setup,
    pub(crate) lattice: &'a LatticeMdp,
    grid: TableGrid,
    policy: &'a [u8],
    pub(crate) values: &'a [f32],
    execution: Execution,
    arc_samples: usize,
}

/// One execution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// The event at the end; `None` if the limit on steps was reached.
    pub event: Option<Event>,
    /// Inserted length, mm.
    pub length: f64,
    /// The part of it that was inserted straight, mm.
    pub straight_length: f64,
    /// Number of turns.
    pub turns: u32,
    /// Discounted cost, as in the objective.
    pub cost: f64,
}

/// A run with every pose and action.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Poses, the start first.
    pub poses: Vec<Pose>,
    /// The action between every pose and the next.
    pub actions: Vec<u8>,
    /// Totals.
    pub run: Run,
}

impl<'a> Executor<'a> {
    /// Takes the tables of a solved problem. `arc_samples` is the number of tested points of each arc, by default that
    /// of the setup; 0 tests the whole arc.
    ///
    /// # Errors
    /// [`Error::Length`] for a table of the wrong size, [`Error::Parameter`] for more than 10,000 arc samples.
    pub fn new(
        problem: &'a SteeringProblem,
        policy: &'a [u8],
        values: &'a [f32],
        execution: Execution,
        arc_samples: Option<usize>,
    ) -> Result<Self> {
        let (setup, lattice) = (problem.setup(), problem.lattice());
        let expected = lattice.shape().states();
        for (name, found) in [("policy", policy.len()), ("values", values.len())] {
            if found != expected {
                return Err(Error::Length { name, expected, found });
            }
        }
        let arc_samples = arc_samples.unwrap_or(setup.arc_samples);
        if arc_samples > 10_000 {
            return Err(Error::parameter("arc_samples", arc_samples, "must be between 0 and 10,000"));
        }
        let grid = TableGrid::new(lattice.shape(), setup.spacing, setup.workspace.size)?;
        Ok(Executor { setup, lattice, grid, policy, values, execution, arc_samples })
    }

    /// Runs `runs` executions from each start, a row of x, y, heading and bevel, on the current rayon pool. Returns
    /// them start after start.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the first start that the table does not contain, and `runs` if the results
    /// do not fit into the memory.
    pub fn rollout(
        &self,
        starts: &[[f64; 4]],
        runs: usize,
        seed: u64,
        noise: bool,
        max_steps: u32,
    ) -> Result<Vec<Run>> {
        self.rollout_in(starts, &[], runs, seed, noise, max_steps)
    }

    /// [`Executor::rollout`] where the plan is wrong: as the truth of each start says, or as planned if there is none.
    ///
    /// # Errors
    /// As [`Executor::rollout`], and [`Error::Length`] for another number of truths than of starts.
    pub fn rollout_in(
        &self,
        starts: &[[f64; 4]],
        truths: &[Truth],
        runs: usize,
        seed: u64,
        noise: bool,
        max_steps: u32,
    ) -> Result<Vec<Run>> {
        if !truths.is_empty() && truths.len() != starts.len() {
            return Err(Error::Length { name: "truths", expected: starts.len(), found: truths.len() });
        }
        for (row, start) in starts.iter().enumerate() {
            self.check(*start, row)?;
        }
        let mut results = Vec::new();
        let total = starts.len().saturating_mul(runs);
        if results.try_reserve_exact(total).is_err() {
            return Err(Error::parameter("runs", runs, "must be so few that their results fit into the memory"));
        }
        let stop = StopFlag::current();
        let run = |index: usize| {
            let mut random = noise.then(|| stream(seed, index as u64));
            let start = Pose::of(starts[index / runs]);
            let truth = truths.get(index / runs).map(|truth| Unseen::new(*truth));
            self.run(start, truth, max_steps, random.as_mut(), &stop, |_, _| {})
        };
        for first in (0..total).step_by(BATCH) {
            stop.check();
            results.par_extend((first..total.min(first + BATCH)).into_par_iter().with_min_len(64).map(run));
        }
        Ok(results)
    }

    /// Runs one execution and records its poses and actions; with tip noise if `seed` is given.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a start that the table does not contain.
    pub fn trace(&self, start: [f64; 4], seed: Option<u64>, max_steps: u32) -> Result<Trace> {
        self.check(start, 0)?;
        let (mut poses, mut actions) = (vec![Pose::of(start)], Vec::new());
        let mut random = seed.map(|seed| stream(seed, 0));
        let run = self.run(Pose::of(start), None, max_steps, random.as_mut(), &StopFlag::current(), |action, pose| {
            actions.push(action);
            poses.push(pose);
        });
        Ok(Trace { poses, actions, run })
    }

    pub(crate) fn check(&self, start: [f64; 4], row: usize) -> Result<()> {
        match self.grid.index(Pose::of(start)) {
            Some(_) => Ok(()),
            None => {
                let rule = "must be finite, in the workspace, with bevel -1 or +1";
                Err(Error::parameter("start", format!("{start:?} (row {row})"), rule))
            }
        }
    }

    fn run(
        &self,
        start: Pose,
        mut truth: Option<Unseen>,
        max_steps: u32,
        mut random: Option<&mut Xoshiro256PlusPlus>,
        stop: &StopFlag,
        mut record: impl FnMut(u8, Pose),
    ) -> Run {
        let costs = &self.setup.costs;
        let event = match &truth {
            None => self.setup.workspace.event([start.x, start.y]),
            Some(unseen) => self.true_start(&unseen.truth, start),
        };
        let mut run = Run { event, length: 0.0, straight_length: 0.0, turns: 0, cost: 0.0 };
        let (mut pose, mut weight) = (start, 1.0);
        for _ in 0..max_steps {
            if run.event.is_some() {
                break;
            }
            stop.check();
            let action = match self.execution {
                Execution::Nearest => self.grid.index(pose).map_or(0, |index| self.policy[index]),
                Execution::Greedy => self.greedy_action(pose),
            };
            let needle = self.needle_at(pose);
            let is_late = truth.as_ref().is_some_and(Unseen::is_late);
            let (event, mut next) = match &mut truth {
                None => self.step(pose, action),
                Some(unseen) if is_late => self.late_step(unseen, pose, action, random.as_deref_mut()),
                Some(unseen) => self.true_step(&unseen.truth, pose, action, needle.step_length()),
            };
            let turn = u8::from(action == 1);
            run.turns += u32::from(turn);
            run.length += needle.step_length();
            run.straight_length += if action == STRAIGHT { needle.step_length() } else { 0.0 };
            let step_cost = self.setup.step_cost(motion(action), needle, [pose.x, pose.y]);
            run.cost += weight * (step_cost + f64::from(turn) * costs.rotation + self.setup.failure_cost(event));
            weight *= costs.discount;
            if let Some(random) = random.as_mut().filter(|_| !is_late) {
                let steps = heading_noise(&self.setup.noise, random);
                next.heading += f64::from(steps) * self.setup.noise_step();
            }
            record(action, next);
            run.event = event;
            pose = next;
        }
        run
    }

    /// The needle with the curvature at the position of the tip.
    pub(crate) fn needle_at(&self, pose: Pose) -> Bicycle {
        self.setup.needle_at([pose.x, pose.y])
    }

    /// Makes the step of an action. Returns the first event and its pose, or no event and the pose at the end.
    pub(crate) fn step(&self, from: Pose, action: u8) -> (Option<Event>, Pose) {
        let (event, end, _) = self.step_in(&AsPlanned, from, action, self.needle_at(from).step_length());
        (event, end)
    }

    /// [`Executor::step`] of this length, mm, in given surroundings. Returns also the length at which it ends.
    pub(crate) fn step_in(
        &self,
        surroundings: &impl Surroundings,
        from: Pose,
        action: u8,
        length: f64,
    ) -> (Option<Event>, Pose, f64) {
        let (motion, bevel) = (motion(action), if action == 1 { -from.bevel } else { from.bevel });
        if !self.setup.tissues.is_uniform() {
            return self.step_through_tissues(surroundings, from, (motion, bevel), length);
        }
        let needle = &self.setup.moving(motion, surroundings.needle(self.setup, from));
        if self.arc_samples == 0 {
            return self.along(surroundings, from, bevel, needle, length);
        }
        let mut pose = Pose { bevel, ..from };
        for sample in 1..=self.arc_samples {
            let t = sample as f64 / self.arc_samples as f64;
            let [dx, dy] = needle.displacement(from.heading, bevel, t);
            pose = Pose { x: from.x + dx, y: from.y + dy, heading: from.heading + bevel * t * needle.turn(), bevel };
            if let Some(event) = surroundings.event(self.setup, [pose.x, pose.y]) {
                return (Some(event), pose, t * length);
            }
        }
        (None, pose, length)
    }

    /// [`Executor::step_in`] where the curvature varies. The arc consists of equally long pieces, each with the curvature
    /// at its start, or, if the whole arc is tested, near its middle: half a piece along the heading at its start.
    fn step_through_tissues(
        &self,
        surroundings: &impl Surroundings,
        from: Pose,
        (motion, bevel): (Motion, f64),
        length: f64,
    ) -> (Option<Event>, Pose, f64) {
        let pieces = if self.arc_samples == 0 { PIECES } else { self.arc_samples };
        let piece = length / pieces as f64;
        let mut pose = Pose { bevel, ..from };
        for number in 0..pieces {
            if self.arc_samples == 0 {
                let (sin, cos) = pose.heading.sin_cos();
                let middle = Pose { x: pose.x + 0.5 * piece * cos, y: pose.y + 0.5 * piece * sin, ..pose };
                let needle = self.setup.moving(motion, surroundings.needle(self.setup, middle));
                let (event, end, met) = self.along(surroundings, pose, bevel, &needle, piece);
                if event.is_some() {
                    return (event, end, number as f64 * piece + met);
                }
                pose = end;
                continue;
            }
            let needle = self.setup.moving(motion, surroundings.needle(self.setup, pose));
            let t = piece / needle.step_length();
            let [dx, dy] = needle.displacement(pose.heading, bevel, t);
            let heading = pose.heading + bevel * t * needle.turn();
            pose = Pose { x: pose.x + dx, y: pose.y + dy, heading, bevel };
            if let Some(event) = surroundings.event(self.setup, [pose.x, pose.y]) {
                return (Some(event), pose, (number + 1) as f64 * piece);
            }
        }
        (None, pose, length)
    }

    /// Moves along a whole arc of one radius. Returns the first event with its pose and length, or no event and the end.
    fn along(
        &self,
        surroundings: &impl Surroundings,
        from: Pose,
        bevel: f64,
        needle: &Bicycle,
        length: f64,
    ) -> (Option<Event>, Pose, f64) {
        let arc = Arc::new([from.x, from.y], from.heading, bevel / needle.radius, length);
        let met = surroundings.first_event(self.setup, &arc);
        let s = met.map_or(length, |(_, s)| s);
        let [x, y] = arc.point(s);
        (met.map(|(event, _)| event), Pose { x, y, heading: arc.heading(s), bevel }, s)
    }
}

/// The motion of an action.
#[inline]
pub(crate) fn motion(action: u8) -> Motion {
    if action == STRAIGHT { Motion::Straight } else { Motion::Curved }
}

/// A random number of heading steps with P(+-m) = noise[m].
fn heading_noise(noise: &[f64], random: &mut Xoshiro256PlusPlus) -> i32 {
    // 53 random bits in [0, 1).
    let mut u = (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64 - noise[0];
    for (m, p) in noise.iter().enumerate().skip(1) {
        for side in [-1, 1] {
            if u < 0.0 {
                break;
            }
            u -= p;
            if u < 0.0 {
                return side * m as i32;
            }
        }
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_given_probabilities() {
        let noise = [0.466, 0.24, 0.027];
        let mut random = stream(7, 0);
        let mut counts = [0u32; 5];
        for _ in 0..1_000_000 {
            counts[(heading_noise(&noise, &mut random) + 2) as usize] += 1;
        }
        for (count, p) in counts.iter().zip([0.027, 0.24, 0.466, 0.24, 0.027]) {
            let deviation = (f64::from(*count) - 1e6 * p) / (1e6 * p * (1.0 - p)).sqrt();
            assert!(deviation.abs() < 5.0, "{counts:?}");
        }
    }
}
