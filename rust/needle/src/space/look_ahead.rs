//! Decisions and predictions at exact poses by a look ahead.
//!
//! The step of every action is made in the continuous model. Its end lies on a slice; there the table is read by the
//! rules of the pass: bilinear in the slice, with the same treatment of grid points that are not free, those of decisions
//! and those of success ([`Corners`]), and with the stencil of the exact direction. So at a grid point the look ahead finds the value of the table.

use ppvi::Result;
use ppvi::space::voxel;
use rayon::prelude::*;

use crate::space::arc::{SpacePose, turned};
use crate::space::execution::{SpaceExecutor, StepEnd};
use crate::space::feasibility::{Feasibility, SpaceVerdict};
use crate::workspace::Event;

/// Nodes of a normal distribution, in standard deviations, and their weights.
const NODES: [(f64, f64); 3] =
    [(-1.732_050_807_568_877_2, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877_2, 1.0 / 6.0)];

/// Equally likely nodes of a normal distribution with its variance, for the first step of a prediction. Where the next step
/// meets an obstacle or not, success is a step function of the angle, which no node may decide by much.
const FIRST_NODES: [(f64, f64); 5] = [(-1.464, 0.2), (-0.599, 0.2), (0.0, 0.2), (0.599, 0.2), (1.464, 0.2)];

/// Steps that a prediction of success makes at most before it reads the table.
const STEPS: u32 = 4;

/// How much of the predicted success an interpolated value may decide: its probability, times the range of the values that
/// it is interpolated from.
const DOUBT: f64 = 0.005;

/// Decision and prediction at a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceAnswer {
    /// Best action.
    pub action: usize,
    /// Cost-to-go.
    pub value: f64,
    /// Probability of success.
    pub success: f64,
}

impl SpaceExecutor<'_> {
    /// Best action, cost and success at a pose.
    ///
    /// # Errors
    /// [`ppvi::Error::Parameter`] for a pose outside the volume or the cone.
    pub fn look_up(&self, pose: SpacePose) -> Result<SpaceAnswer> {
        let pose = self.checked(pose)?;
        if let Some(event) = self.event_at(&pose) {
            let success = f64::from(u8::from(event == Event::Target));
            return Ok(SpaceAnswer { action: 0, value: self.failure_cost(event), success });
        }
        let (action, value) = self.best_action(pose);
        let success = self.success_after(&self.step(pose, action), (1.0, STEPS));
        Ok(SpaceAnswer { action, value, success })
    }

    /// The answers at many poses, in parallel.
    ///
    /// # Errors
    /// As [`SpaceExecutor::look_up`].
    pub fn look_up_many(&self, poses: &[SpacePose]) -> Result<Vec<SpaceAnswer>> {
        poses.par_iter().with_min_len(64).map(|pose| self.look_up(*pose)).collect()
    }

    /// What is known about a pose: possible if the policy succeeds at least with the probability `enough`, impossible if the
    /// proof says so, otherwise undecided.
    ///
    /// # Errors
    /// As [`SpaceExecutor::look_up`].
    pub fn verdict(&self, pose: SpacePose, proof: &Feasibility, enough: f64) -> Result<SpaceVerdict> {
        let answer = self.look_up(pose)?;
        Ok(match answer.success {
            success if success >= enough => SpaceVerdict::Possible(success),
            _ if proof.is_impossible(pose) => SpaceVerdict::Impossible,
            _ => SpaceVerdict::Undecided,
        })
    }

    /// The action with the least expected cost at an exact pose, and this cost. Of equal ones the first counts.
    pub(crate) fn best_action(&self, pose: SpacePose) -> (usize, f64) {
        let setup = self.problem.setup();
        let price = self.price(pose.position);
        let mut best = (0, f64::INFINITY);
        for action in 0..setup.actions() {
            let end = self.step(pose, action);
            let cost = setup.step_cost(action, end.whole) + price * end.whole;
            let after = match end.event {
                Some(event) => self.failure_cost(event),
                None => self.expectation(&end, Corners::Fail, [setup.costs.collision, setup.costs.exit], |state| {
                    f64::from(self.tables.values[state])
                }),
            };
            if cost + after < best.1 {
                best = (action, cost + after);
            }
        }
        best
    }

    /// Expected value after a step without event, by the stencil of the exact direction. `failures` count in obstacles, and
    /// outside or beyond the cone.
    fn expectation(&self, end: &StepEnd, corners: Corners, failures: [f64; 2], table: impl Fn(usize) -> f64) -> f64 {
        let noise = self.problem.setup().noise;
        let mut sum = 0.0;
        self.read(end.pose, noise * noise * end.length, corners, |weight, at| {
            sum += weight
                * match at {
                    At::State(state) => table(state),
                    At::Obstacle => failures[0],
                    At::Outside => failures[1],
                };
        });
        sum
    }

    /// Probability of success after a step.
    ///
    /// The noise of the tangent has 25 nodes in the first step, then nine (three for each angle: Gauss and Hermite). Where
    /// the table is certain, it is read at the node: where its grid points differ by little, or the node is unlikely.
    /// Otherwise the step of the node is made in the same way. `weight` is the probability of the step, `steps` the number
    /// of steps that are left to make. Nodes beyond the rim of the cone are left out; the probability of leaving the cone
    /// is that of the stencil.
    fn success_after(&self, end: &StepEnd, (weight, steps): (f64, u32)) -> f64 {
        if let Some(event) = end.event {
            return f64::from(u8::from(event == Event::Target));
        }
        let setup = self.problem.setup();
        let sigma = setup.noise * end.length.sqrt();
        let nodes: &[(f64, f64)] = if steps == STEPS { &FIRST_NODES } else { &NODES };
        let (mut sum, mut within) = (0.0, 0.0);
        for (a, wa) in nodes {
            for (b, wb) in nodes {
                let likely = wa * wb;
                let pose = SpacePose { tangent: turned(end.pose.tangent, [a * sigma, b * sigma]), ..end.pose };
                if !self.problem.directions().contains(pose.tangent) {
                    continue;
                }
                within += likely;
                let (mut mean, mut low, mut high) = (0.0, 1.0f64, 0.0f64);
                self.read(pose, 0.0, Corners::Extend, |weight, at| {
                    let success = if let At::State(state) = at { self.success_of(state) } else { 0.0 };
                    (mean, low, high) = (mean + weight * success, low.min(success), high.max(success));
                });
                sum += likely
                    * if weight * likely * (high - low) > DOUBT && steps > 1 {
                        let (action, _) = self.best_action(pose);
                        self.success_after(&self.step(pose, action), (weight * likely, steps - 1))
                    } else {
                        mean
                    };
            }
        }
        if within == 0.0 {
            return self.expectation(end, Corners::Extend, [0.0; 2], |state| self.success_of(state));
        }
        // What leaves the cone is lost, whatever nodes are beyond its rim.
        let (_, lost) = self.problem.directions().stencil(end.pose.tangent, sigma * sigma);
        (1.0 - lost) * sum / within
    }

    /// Calls `visit(weight, at)` for the states and failures among which a pose on a slice, in a free voxel, is shared.
    /// `variance` is that of the noise which its tangent still gets, rad^2.
    fn read(&self, pose: SpacePose, variance: f64, corners: Corners, mut visit: impl FnMut(f64, At)) {
        let (taps, beyond) = self.problem.directions().stencil(pose.tangent, variance);
        if beyond > 0.0 {
            visit(beyond, At::Outside);
        }
        let (volume, shape) = (&self.problem.setup().volume, self.problem.mdp().shape());
        let spacing = volume.spacing();
        let slice = (pose.position[0] / spacing[0]).round() as usize;
        let at = [1, 2].map(|axis| pose.position[axis] / spacing[axis]);
        let inside = |j: i64, k: i64| shape.point(slice, 0, 0, [0, j as i32, k as i32]).is_some();
        let code = |j: i64, k: i64| {
            let point = shape.point(slice, 0, 0, [0, j as i32, k as i32]);
            point.map_or(voxel::OUTSIDE, |point| volume.codes()[point])
        };
        let mut add = |j: i64, k: i64, weight: f64| {
            let first = shape.state(slice, 0, j as usize, k as usize);
            let state = |direction: u32| At::State(first + direction as usize * shape.plane());
            taps.iter().for_each(|tap| visit(weight * tap.weight, state(tap.direction)));
        };
        let mut failed = [0.0; 2];
        let (j, k) = (at[0].floor(), at[1].floor());
        for (dj, wj) in [(0, 1.0 - (at[0] - j)), (1, at[0] - j)] {
            for (dk, wk) in [(0, 1.0 - (at[1] - k)), (1, at[1] - k)] {
                let (j, k, weight) = (j as i64 + dj, k as i64 + dk, wj * wk);
                if weight < 1e-9 {
                    continue;
                }
                match code(j, k) {
                    voxel::FREE => add(j, k, weight),
                    voxel::OBSTACLE if corners == Corners::Fail => failed[0] += weight * (1.0 - beyond),
                    voxel::OUTSIDE if corners == Corners::Fail || !inside(j, k) => failed[1] += weight * (1.0 - beyond),
                    _ => {
                        let around = (-1..=1).flat_map(|a| (-1..=1).map(move |b| (j + a, k + b)));
                        let free: Vec<_> = around.filter(|(j, k)| code(*j, *k) == voxel::FREE).collect();
                        free.iter().for_each(|(j, k)| add(*j, *k, weight / free.len() as f64));
                    }
                }
            }
        }
        for (weight, at) in failed.into_iter().zip([At::Obstacle, At::Outside]).filter(|(weight, _)| *weight > 0.0) {
            visit(weight, at);
        }
    }
}

/// What grid points in obstacles and outside count as, beside a pose in a free voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Corners {
    /// The failures that they are: for decisions.
    Fail,
    /// The mean of their free neighbours: for the probability of success, which nothing maximises.
    Extend,
}

/// What a pose is read from.
#[derive(Debug, Clone, Copy, PartialEq)]
enum At {
    /// A state of the table.
    State(usize),
    /// A grid point in an obstacle.
    Obstacle,
    /// A grid point outside the volume, or a direction outside the cone.
    Outside,
}
