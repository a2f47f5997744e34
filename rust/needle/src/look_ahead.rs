//! Decisions and predictions at exact poses by a look one step ahead.
//!
//! The step of every action is made in the continuous model; at its end the table is interpolated linearly over x, y and
//! heading.

use ppvi::lattice::{Motion, STRAIGHT, Shape, outcome};
use ppvi::{Error, Result};
use rayon::prelude::*;

use crate::lookup::{Answers, Pose};
use crate::rollout::{Executor, motion};
use crate::workspace::Event;

/// Steps that a prediction of success makes at most before it reads the table. The position is then spread over several
/// cells by the noise.
const STEPS: u32 = 8;

/// How much of the predicted success an interpolated value may decide: its probability, times the range of the values that
/// it is interpolated from. So at most 1 / DOUBT poses are followed at each step.
const DOUBT: f64 = 0.005;

impl Executor<'_> {
    pub(crate) fn greedy_action(&self, pose: Pose) -> u8 {
        self.best_action(pose).0
    }

    /// The action with the least Q-value at an exact pose, and this value. Of equal ones the first counts.
    fn best_action(&self, pose: Pose) -> (u8, f64) {
        let costs = &self.setup.costs;
        let value = |action: u8| {
            let (event, end) = self.step(pose, action);
            let after = match event {
                Some(_) => self.setup.failure_cost(event),
                None => costs.discount * self.expectation(self.values, end, [costs.collision, costs.exit]),
            };
            let step = self.setup.step_cost(motion(action), self.needle_at(pose), [pose.x, pose.y]);
            step + after + if action == 1 { costs.rotation } else { 0.0 }
        };
        let last = if self.setup.straight.is_some() { STRAIGHT } else { 1 };
        let better = |best: (u8, f64), action| {
            let value = value(action);
            if value < best.1 { (action, value) } else { best }
        };
        (1..=last).fold((0, value(0)), better)
    }

    /// Predicts actions, costs and success at exact poses by a look one step ahead: the step of either action in the
    /// continuous model, and the interpolated table at its end. `success` is the table of success probabilities.
    ///
    /// # Errors
    /// [`Error::Length`] for a table of the wrong size, [`Error::Parameter`] for a pose that the table does not contain.
    pub fn predict(&self, poses: &[[f64; 4]], success: &[f32]) -> Result<Answers> {
        let expected = self.lattice.shape().states();
        if success.len() != expected {
            return Err(Error::Length { name: "success", expected, found: success.len() });
        }
        for (row, pose) in poses.iter().enumerate() {
            self.check(*pose, row)?;
        }
        let answer = |pose: &[f64; 4]| {
            let pose = Pose::of(*pose);
            match self.setup.workspace.event([pose.x, pose.y]) {
                Some(Event::Target) => return (0, 0.0, 1.0),
                Some(event) => return (0, self.setup.failure_cost(Some(event)) as f32, 0.0),
                None => {}
            }
            let (action, value) = self.best_action(pose);
            let reached = self.success_after(pose, action, success, (1.0, STEPS));
            (action, value as f32, reached as f32)
        };
        let rows: Vec<(u8, f32, f32)> = poses.par_iter().with_min_len(256).map(answer).collect();
        Ok(Answers {
            actions: rows.iter().map(|row| row.0).collect(),
            values: rows.iter().map(|row| row.1).collect(),
            success: rows.iter().map(|row| row.2).collect(),
        })
    }

    /// Probability that an execution which takes `action` at a pose reaches the target.
    ///
    /// The step ends at a pose for each noise of the heading. Its success is interpolated where that is certain: where
    /// the corners of its cell differ by little, or the pose itself is unlikely. Otherwise its own step is made in the
    /// same way. `weight` is the probability of the pose, `steps` the number of steps that are left to make.
    fn success_after(&self, pose: Pose, action: u8, success: &[f32], (weight, steps): (f64, u32)) -> f64 {
        let (event, end) = self.step(pose, action);
        if let Some(event) = event {
            return f64::from(u8::from(event == Event::Target));
        }
        let mut sum = 0.0;
        for (m, p) in self.setup.noise.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            let turned = m as f64 * self.setup.noise_step();
            let sides = [-turned, turned];
            for turn in &sides[usize::from(m == 0)..] {
                let next = Pose { heading: end.heading + turn, ..end };
                let (mean, range) = self.interpolated(success, next);
                let likely = weight * p;
                sum += p * if likely * range > DOUBT && steps > 1 {
                    self.success_after(next, self.greedy_action(next), success, (likely, steps - 1))
                } else {
                    mean
                };
            }
        }
        sum
    }

    /// A table of success interpolated linearly over x, y and heading, and the range of the values that it is made of.
    fn interpolated(&self, success: &[f32], pose: Pose) -> (f64, f64) {
        let (headings, b) = (self.lattice.shape().headings, usize::from(pose.bevel > 0.0));
        let cells = pose.heading / self.setup.needle.heading_step();
        let whole = cells.floor();
        let (mut mean, mut low, mut high) = (0.0, 1.0f64, 0.0f64);
        let mut add = |weight: f64, value: f64| {
            if weight > 1e-9 {
                (mean, low, high) = (mean + weight * value, low.min(value), high.max(value));
            }
        };
        self.for_each_corner(pose, |weight, corner| {
            let Corner::Point(first) = corner else { return add(weight, 0.0) };
            for (k, share) in [(whole, 1.0 - (cells - whole)), (whole + 1.0, cells - whole)] {
                let k = k.rem_euclid(headings as f64) as usize % headings;
                add(weight * share, f64::from(success[first + k * 2 + b]));
            }
        });
        (mean, high - low)
    }

    /// Expectation of a table over the noise at the end of a step, interpolated linearly along x, y and heading.
    /// `ends` are the values in obstacles and outside the grid.
    fn expectation(&self, table: &[f32], end: Pose, [in_obstacle, outside]: [f64; 2]) -> f64 {
        let headings = self.lattice.shape().headings;
        let b = usize::from(end.bevel > 0.0);
        let per_rad = 1.0 / self.setup.needle.heading_step();
        let (turned, noise_cells) = (end.heading * per_rad, self.setup.noise_step() * per_rad);
        let mut expectation = 0.0;
        self.for_each_corner(end, |weight, corner| {
            let first = match corner {
                Corner::Outside => return expectation += weight * outside,
                Corner::InObstacle => return expectation += weight * in_obstacle,
                Corner::Point(first) => first,
            };
            let point = &table[first..][..headings * 2];
            let at = |cells: f64| {
                let whole = if (cells - cells.round()).abs() < 1e-9 { cells.round() } else { cells.floor() };
                let fraction = (cells - whole).max(0.0);
                let value = |k: f64| f64::from(point[k.rem_euclid(headings as f64) as usize % headings * 2 + b]);
                if fraction < 1e-9 {
                    value(whole)
                } else {
                    (1.0 - fraction) * value(whole) + fraction * value(whole + 1.0)
                }
            };
            for (m, p) in self.setup.noise.iter().enumerate().filter(|(_, p)| **p > 0.0) {
                let noise = m as f64 * noise_cells;
                let mean = if m == 0 { at(turned) } else { at(turned - noise) + at(turned + noise) };
                expectation += weight * p * mean;
            }
        });
        expectation
    }

    /// Calls `visit(weight, corner)` for the grid points around a position with their bilinear weights.
    #[inline(always)]
    fn for_each_corner(&self, Pose { x, y, .. }: Pose, mut visit: impl FnMut(f64, Corner)) {
        let Shape { nx, ny, headings } = self.lattice.shape();
        let spacing = self.setup.spacing;
        let (u, v) = (x / spacing[0], y / spacing[1]);
        let (i, j) = (u.floor() as i64, v.floor() as i64);
        let (fu, fv) = (u - u.floor(), v - v.floor());
        for (di, wu) in [(0, 1.0 - fu), (1, fu)] {
            for (dj, wv) in [(0, 1.0 - fv), (1, fv)] {
                let (i, j, weight) = (i + di, j + dj, wu * wv);
                if weight == 0.0 {
                    continue;
                }
                if !((0..nx as i64).contains(&i) && (0..ny as i64).contains(&j)) {
                    visit(weight, Corner::Outside);
                    continue;
                }
                let (i, j) = (i as usize, j as usize);
                visit(
                    weight,
                    match self.lattice.outcome(Motion::Curved, i, j, 0, 0) {
                        outcome::AT_OBSTACLE => Corner::InObstacle,
                        _ => Corner::Point((i * ny + j) * headings * 2),
                    },
                );
            }
        }
    }
}

/// A grid point at the corner of a cell.
enum Corner {
    Outside,
    InObstacle,
    /// The index of its first state.
    Point(usize),
}
