//! Decisions and predictions at exact poses by a look one step ahead.
//!
//! The step of either action is made in the continuous model; at its end the table is interpolated linearly over x, y and
//! heading.

use ppvi::lattice::{Shape, outcome};
use ppvi::{Error, Result};
use rayon::prelude::*;

use crate::lookup::{Answers, Pose};
use crate::rollout::Executor;
use crate::workspace::Event;

impl Executor<'_> {
    pub(crate) fn greedy_action(&self, pose: Pose) -> u8 {
        let [insert, rotate] = self.step_values(pose);
        u8::from(rotate < insert)
    }

    /// Q-values at an exact pose, by action.
    fn step_values(&self, pose: Pose) -> [f64; 2] {
        let costs = &self.setup.costs;
        let ends = [costs.collision, costs.exit];
        let value = |bevel: f64| {
            let (event, end) = self.step(pose, bevel);
            let after = match event {
                Some(_) => self.setup.failure_cost(event),
                None => costs.discount * self.expectation(self.values, end, ends),
            };
            self.setup.step_cost(self.needle_at(pose), [pose.x, pose.y]) + after
        };
        [value(pose.bevel), value(-pose.bevel) + costs.rotation]
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
            let [insert, rotate] = self.step_values(pose);
            let action = u8::from(rotate < insert);
            let (event, end) = self.step(pose, if action == 1 { -pose.bevel } else { pose.bevel });
            let reached = match event {
                Some(event) => f64::from(u8::from(event == Event::Target)),
                None => self.expectation(success, end, [0.0, 0.0]),
            };
            (action, insert.min(rotate) as f32, reached as f32)
        };
        let rows: Vec<(u8, f32, f32)> = poses.par_iter().with_min_len(256).map(answer).collect();
        Ok(Answers {
            actions: rows.iter().map(|row| row.0).collect(),
            values: rows.iter().map(|row| row.1).collect(),
            success: rows.iter().map(|row| row.2).collect(),
        })
    }

    /// Expectation of a table over the noise at the end of a step, interpolated linearly along x, y and heading.
    /// `ends` are the values in obstacles and outside the grid.
    fn expectation(&self, table: &[f32], end: Pose, [in_obstacle, outside]: [f64; 2]) -> f64 {
        let Shape { nx, ny, headings } = self.lattice.shape();
        let spacing = self.setup.spacing;
        let (u, v) = (end.x / spacing[0], end.y / spacing[1]);
        let (i, j) = (u.floor() as i64, v.floor() as i64);
        let (fu, fv) = (u - u.floor(), v - v.floor());
        let b = usize::from(end.bevel > 0.0);
        let per_rad = 1.0 / self.setup.needle.heading_step();
        let (turned, noise_cells) = (end.heading * per_rad, self.setup.noise_step() * per_rad);
        let mut expectation = 0.0;
        for (di, wu) in [(0, 1.0 - fu), (1, fu)] {
            for (dj, wv) in [(0, 1.0 - fv), (1, fv)] {
                let (i, j, weight) = (i + di, j + dj, wu * wv);
                if weight == 0.0 {
                    continue;
                }
                if !((0..nx as i64).contains(&i) && (0..ny as i64).contains(&j)) {
                    expectation += weight * outside;
                    continue;
                }
                let (i, j) = (i as usize, j as usize);
                if self.lattice.outcome(i, j, 0, 0) == outcome::AT_OBSTACLE {
                    expectation += weight * in_obstacle;
                    continue;
                }
                let point = &table[(i * ny + j) * headings * 2..][..headings * 2];
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
            }
        }
        expectation
    }
}
