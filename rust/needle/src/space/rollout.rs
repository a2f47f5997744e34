//! Whole executions: their statistics, and their paths.

use ppvi::space::voxel;
use ppvi::{Result, StopFlag};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;

use crate::random::stream;
use crate::space::arc::{SpacePose, Vec3};
use crate::space::execution::SpaceExecutor;
use crate::space::watch::Watch;
use crate::workspace::Event;

/// Runs that are shared among threads at a time.
const BATCH: usize = 1 << 12;

/// One execution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceRun {
    /// How it ended.
    pub event: Event,
    /// Inserted length, mm.
    pub length: f64,
    /// The part of it that was inserted straight, mm.
    pub straight: f64,
    /// Steps that turn the needle to another roll angle than the step before.
    pub turns: u32,
    /// Sum of all costs.
    pub cost: f64,
}

/// An execution with its path.
#[derive(Debug, Clone, PartialEq)]
pub struct SpacePath {
    /// How it went. The length is that up to the last point.
    pub run: SpaceRun,
    /// Code of the voxel that has ended it; free if the tangent has left the cone.
    pub end: u8,
    /// The first pose, and those at the ends of all chords. The last position is on the face of the voxel that has ended the
    /// execution, or within the target.
    pub poses: Vec<SpacePose>,
    /// Numbers of the poses at which the needle is turned to another roll angle.
    pub turns: Vec<usize>,
}

/// Poses and numbers of rotations.
struct Trail(Vec<SpacePose>, Vec<usize>);

impl Watch for Trail {
    fn passes(&mut self, pose: SpacePose) -> Vec3 {
        self.0.push(pose);
        pose.position
    }
    fn rotates(&mut self) {
        self.1.push(self.0.len() - 1);
    }
}

impl SpaceExecutor<'_> {
    /// Executes the policy many times by a look one step ahead. Each run has its own random stream, so results do not depend
    /// on the number of threads.
    ///
    /// # Errors
    /// [`ppvi::Error::Parameter`] for a start outside the volume or the cone.
    pub fn rollout(&self, start: SpacePose, runs: usize, seed: u64) -> Result<Vec<SpaceRun>> {
        let start = self.checked(start)?;
        let (stop, noise) = (StopFlag::current(), self.problem.setup().noise);
        let mut all = Vec::with_capacity(runs);
        for first in (0..runs).step_by(BATCH) {
            let batch = (first..runs.min(first + BATCH)).into_par_iter().with_min_len(16).map(|run| {
                stop.check();
                self.run(start, noise, &mut stream(seed, run as u64), &mut ())
            });
            all.par_extend(batch);
        }
        Ok(all)
    }

    /// Executes the policy once from each pose: without noise, or with that of run 0, 1, 2 ... of [`SpaceExecutor::rollout`].
    ///
    /// # Errors
    /// As [`SpaceExecutor::rollout`].
    pub fn paths(&self, starts: &[SpacePose], seed: Option<u64>) -> Result<Vec<SpacePath>> {
        let stop = StopFlag::current();
        let path = |(run, start): (usize, &SpacePose)| {
            stop.check();
            let start = self.checked(*start)?;
            Ok(self.path(start, seed.map(|seed| stream(seed, run as u64))))
        };
        starts.par_iter().enumerate().map(path).collect()
    }

    fn path(&self, start: SpacePose, random: Option<Xoshiro256PlusPlus>) -> SpacePath {
        let noise = random.as_ref().map_or(0.0, |_| self.problem.setup().noise);
        let mut trail = Trail(vec![start], vec![]);
        let mut run = self.run(start, noise, &mut random.unwrap_or_else(|| stream(0, 0)), &mut trail);
        let (Trail(mut poses, turns), volume) = (trail, &self.problem.setup().volume);
        let end = if let [.., SpacePose { position: from, .. }, SpacePose { position: last, .. }] = &mut poses[..] {
            let (code, share) = volume.met(*from, *last);
            let way = [0, 1, 2].map(|axis| last[axis] - from[axis]);
            run.length -= (1.0 - share) * way.iter().map(|part| part * part).sum::<f64>().sqrt();
            *last = [0, 1, 2].map(|axis| from[axis] + share * way[axis]);
            code
        } else {
            volume.code(start.position)
        };
        debug_assert!(end != voxel::FREE || run.event == Event::Exit);
        SpacePath { run, end, poses, turns }
    }

    /// One execution with noise, rad after 1 mm.
    pub(crate) fn run(
        &self,
        start: SpacePose,
        noise: f64,
        random: &mut Xoshiro256PlusPlus,
        watch: &mut impl Watch,
    ) -> SpaceRun {
        let setup = self.problem.setup();
        let (mut pose, mut last) = (start, None);
        let mut run = SpaceRun { event: Event::Exit, length: 0.0, straight: 0.0, turns: 0, cost: 0.0 };
        let mut met = watch.event().or_else(|| self.event_at(&pose));
        while met.is_none() {
            let (action, _) = self.best_action(watch.believed(pose));
            if action < setup.rolls && last.is_some_and(|last| last != action) {
                run.turns += 1;
                watch.rotates();
            }
            let course = self.course(pose, action);
            let end = self.step(course, noise, random, watch);
            // A step costs as much as a whole one, even if an event ends it.
            let whole = end.length.max((course.planes[1] - pose.position[0]) / pose.tangent[0]);
            run.length += end.length;
            if action >= setup.rolls {
                run.straight += end.length;
            }
            run.cost += setup.step_cost(action, whole) + self.price(pose.position) * whole;
            last = Some(action);
            pose = end.pose;
            met = watch.event().or(end.event).or_else(|| self.event_at(&watch.believed(pose)));
        }
        run.event = met.map_or(Event::Exit, |event| watch.judged(event));
        run.cost += self.failure_cost(run.event);
        run
    }
}
