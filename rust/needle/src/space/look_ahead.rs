//! Decisions and predictions at exact poses by a look ahead.
//!
//! The step of every action is made in the continuous model, with the branches of the exact pose. They end on a slice; there
//! the table is read by the rule of the pass, bilinear in the slice. So at a grid point the look ahead finds the value of the
//! table.

use ppvi::Result;
use rayon::prelude::*;

use crate::space::arc::{SpacePose, Vec3, turned};
use crate::space::execution::{Course, Followed, SpaceExecutor};
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

/// Poses that a thread takes at least.
const AT_LEAST: usize = 4;

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
        let success = self.success_after(self.course(pose, action), (1.0, STEPS));
        Ok(SpaceAnswer { action, value, success })
    }

    /// The answers at many poses, in parallel.
    ///
    /// # Errors
    /// As [`SpaceExecutor::look_up`].
    pub fn look_up_many(&self, poses: &[SpacePose]) -> Result<Vec<SpaceAnswer>> {
        poses.par_iter().with_min_len(AT_LEAST).map(|pose| self.look_up(*pose)).collect()
    }

    /// Best action and cost at many poses, in parallel: the same as the answers have, in a small part of their time.
    ///
    /// # Errors
    /// As [`SpaceExecutor::look_up`].
    pub fn decide_many(&self, poses: &[SpacePose]) -> Result<Vec<(usize, f64)>> {
        let decide = |pose: &SpacePose| {
            let pose = self.checked(*pose)?;
            Ok(self.event_at(&pose).map_or_else(|| self.best_action(pose), |event| (0, self.failure_cost(event))))
        };
        poses.par_iter().with_min_len(AT_LEAST).map(decide).collect()
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
    ///
    /// The action of the table is tried first. It is often the best one, so that others are soon known to cost more.
    pub(crate) fn best_action(&self, pose: SpacePose) -> (usize, f64) {
        let setup = self.problem.setup();
        let price = self.price(pose.position);
        let first = self.stored_action(&pose);
        let mut best = (0, f64::INFINITY);
        for action in std::iter::once(first).chain((0..setup.actions()).filter(|action| *action != first)) {
            let cost = self.cost_up_to(self.course(pose, action), best.1, |length| {
                setup.step_cost(action, length) + price * length
            });
            if cost < best.1 || (cost == best.1 && action < best.0) {
                best = (action, cost);
            }
        }
        best
    }

    /// The action of the table at the nearest grid point, or the first one.
    fn stored_action(&self, pose: &SpacePose) -> usize {
        let place = self.problem.setup().volume.index(pose.position);
        let state = place.zip(self.problem.directions().nearest(pose.tangent));
        let action =
            state.map_or(0, |(point, direction)| usize::from(self.tables.policy[self.state(point, direction)]));
        action.min(self.problem.setup().actions() - 1)
    }

    /// Expected cost of a step and what comes after it, by the branches of the exact pose; `step` is the cost of the step by
    /// its length.
    ///
    /// Costs are not negative. Where a part of them already exceeds `enough`, this part is returned, and the branches that
    /// are left are not followed.
    fn cost_up_to(&self, course: Course, enough: f64, step: impl Fn(f64) -> f64) -> f64 {
        let setup = self.problem.setup();
        let Course { from, planes: [_, end], share } = course;
        let straight = (end - from.pose.position[0]) / from.pose.tangent[0];
        let Some((first, mean)) = self.undisturbed(course) else { return step(straight) + setup.costs.exit };
        let length = first.length + mean.length;
        let cost = step(length);
        if let Some(event) = self.met(&first) {
            return cost + self.failure_cost(event);
        }
        let mean = mean.tip.pose.tangent;
        let stencil = self.problem.directions().stencil(mean, setup.noise * setup.noise * length);
        // The nine branches, each followed when it is asked for first.
        let mut followed = [[None; 3]; 3];
        let mut branch = |i: usize, j: usize| {
            *followed[i][j]
                .get_or_insert_with(|| self.follow(first.tip.turned(mean, stencil.kicked([i, j])), end, share))
        };
        let (mut sum, mut within) = (0.0, 0.0);
        for tap in &stencil.taps {
            if cost + sum > enough {
                return cost + sum;
            }
            let [i, j] = tap.place;
            let (Some(mut rest), Some(of_y), Some(of_z)) = (branch(i, j), branch(i, 1), branch(1, j)) else {
                continue;
            };
            // Branches share columns, as in the plan.
            rest.tip.pose.position = [end, of_y.tip.pose.position[1], of_z.tip.pose.position[2]];
            let after = match self.met(&rest) {
                Some(event) => self.failure_cost(event),
                None => stencil.lost * setup.costs.exit + (1.0 - stencil.lost) * self.stored_cost(&rest, tap.direction),
            };
            (sum, within) = (sum + tap.weight * after, within + tap.weight);
        }
        cost + (sum + (1.0 - within) * setup.costs.exit)
    }

    /// Cost-to-go by the table at the end of a step in a direction of the grid.
    fn stored_cost(&self, end: &Followed, direction: u32) -> f64 {
        let (costs, mut sum) = (&self.problem.setup().costs, 0.0);
        self.around(end.tip.pose.position, |weight, point| {
            let stored = |point| f64::from(self.tables.values[self.state(point, direction)]);
            sum += weight * point.map_or(costs.exit, stored);
        });
        sum
    }

    /// The two parts of a step without noise, the second one not tested for events; None if it turns back.
    fn undisturbed(&self, Course { from, planes: [turn, end], share }: Course) -> Option<(Followed, Followed)> {
        let first = self.follow(from, turn, share)?;
        Some((first, self.follow_untested(first.tip, end, share)?))
    }

    /// Probability of success after a step.
    ///
    /// The noise turns the tip once, as in the plan. It has 25 nodes in the first step, then nine (three for each
    /// angle: Gauss and Hermite). Where the table is certain, it is read at the node: where its grid points differ by little,
    /// or the node is unlikely. Otherwise the step of the node is made in the same way. `weight` is the probability of the
    /// step, `steps` the number of steps that are left to make. Of the nodes that meet nothing, those beyond the rim of the
    /// cone are left out; the probability of leaving the cone is that of the stencil.
    fn success_after(&self, course: Course, (weight, steps): (f64, u32)) -> f64 {
        let Some((first, mean)) = self.undisturbed(course) else { return 0.0 };
        if let Some(event) = self.met(&first) {
            return f64::from(u8::from(event == Event::Target));
        }
        let directions = self.problem.directions();
        let sigma = self.problem.setup().noise * (first.length + mean.length).sqrt();
        let nodes: &[(f64, f64)] = if steps == STEPS { &FIRST_NODES } else { &NODES };
        let (mut ended, mut goes_on, mut within, mut sum) = (0.0, 0.0, 0.0, 0.0);
        for (a, wa) in nodes {
            for (b, wb) in nodes {
                let likely = wa * wb;
                let from = first.tip.pose.tangent;
                let tip = first.tip.turned(from, turned(from, [a * sigma, b * sigma]));
                let Some(rest) = self.follow(tip, course.planes[1], course.share) else { continue };
                if let Some(event) = self.met(&rest) {
                    ended += likely * f64::from(u8::from(event == Event::Target));
                    continue;
                }
                goes_on += likely;
                let pose = rest.tip.pose;
                if !directions.contains(pose.tangent) {
                    continue;
                }
                within += likely;
                let (mean, range) = self.stored_success(pose);
                sum += likely
                    * if weight * likely * range > DOUBT && steps > 1 {
                        let (action, _) = self.best_action(pose);
                        self.success_after(self.course(pose, action), (weight * likely, steps - 1))
                    } else {
                        mean
                    };
            }
        }
        if within == 0.0 {
            return ended;
        }
        // What leaves the cone is lost, whatever nodes are beyond its rim.
        let lost = directions.stencil(mean.tip.pose.tangent, sigma * sigma).lost;
        ended + goes_on * (1.0 - lost) * sum / within
    }

    /// Success at a pose on a slice by the table, and the range of the numbers that it is interpolated from.
    pub(crate) fn stored_success(&self, pose: SpacePose) -> (f64, f64) {
        let stencil = self.problem.directions().stencil(pose.tangent, 0.0);
        let (mut mean, mut low, mut high) = (0.0, 1.0f64, 0.0f64);
        self.around(pose.position, |weight, point| {
            for tap in &stencil.taps {
                let success = point.map_or(0.0, |point| self.success_of(self.state(point, tap.direction)));
                mean += weight * tap.weight * success;
                (low, high) = (low.min(success), high.max(success));
            }
        });
        (mean * (1.0 - stencil.lost), high - low)
    }

    /// Number of the state at a grid point in a direction.
    fn state(&self, point: usize, direction: u32) -> usize {
        let shape = self.problem.mdp().shape();
        (point / shape.plane() * shape.directions + direction as usize) * shape.plane() + point % shape.plane()
    }

    /// Calls `visit(weight, point)` for the grid points among which a position on a slice is shared; None is beyond the grid.
    fn around(&self, position: Vec3, mut visit: impl FnMut(f64, Option<usize>)) {
        let (volume, shape) = (&self.problem.setup().volume, self.problem.mdp().shape());
        let spacing = volume.spacing();
        let slice = (position[0] / spacing[0]).round() as usize;
        let at = [1, 2].map(|axis| position[axis] / spacing[axis]);
        let (j, k) = (at[0].floor(), at[1].floor());
        for (dj, wj) in [(0, 1.0 - (at[0] - j)), (1, at[0] - j)] {
            for (dk, wk) in [(0, 1.0 - (at[1] - k)), (1, at[1] - k)] {
                let weight = wj * wk;
                if weight >= 1e-9 {
                    visit(weight, shape.point(slice, 0, 0, [0, j as i32 + dj, k as i32 + dk]));
                }
            }
        }
    }
}
