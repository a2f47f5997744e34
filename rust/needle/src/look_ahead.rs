//! Decisions and predictions at exact poses by a look one step ahead.
//!
//! The step of every action is made in the continuous model; at its end the table is interpolated over position and
//! heading. Costs and success change little along the motion, and fast across it: needles side by side end differently. So
//! the table is not read along x and y but along the tangent of the needle and across it, at *stations*. On a grid that is
//! coarse along the motion, or off its columns, this is far closer to executions.

use ppvi::lattice::{Motion, STRAIGHT, Shape, Transition, outcome};
use ppvi::{Error, Result, cubic_weights};
use rayon::prelude::*;

use crate::lookup::{Answers, Pose};
use crate::rollout::{Executor, motion};
use crate::workspace::Event;

/// Poses from which a prediction of success makes steps at most, before it reads the table: enough for all that may be
/// reached in the last three or four steps.
const POSES: usize = 200;

/// Cells across the motion that a target must be wide for the table to resolve it.
const RESOLVED_CELLS: f64 = 3.0;

/// Steps from the target within which success has its width.
const UNRESOLVED_STEPS: f64 = 8.0;

/// Distance below which two poses with one heading are followed as one: in radii of the target, and in distances by which a
/// noise step moves the end of the next step. Success may change fully within such a distance.
const ALIKE_RADII: f64 = 0.1;
const ALIKE_NOISE: f64 = 0.3;

/// Difference of two headings that count as one, in noise steps. It grows where steps do not turn by whole noise steps.
const ALIKE_HEADING: f64 = 0.1;

/// How much of the predicted success an interpolated value may decide: its probability, times the range of the values that
/// it is interpolated from. A pose with less is not followed.
const DOUBT: f64 = 0.003;

/// Sum of the weights of the grid points around a pose that are free up to which they are not divided by it, as in
/// [`ppvi::lattice`].
const LEAST_SUM: f64 = 0.05;

/// A pose that an execution may reach.
struct Reached {
    pose: Pose,
    /// Its probability.
    weight: f64,
    /// Its success by the table.
    success: f64,
    /// How much of the predicted success `success` may decide.
    doubt: f64,
}

impl Reached {
    /// Takes over the probability of a pose nearby. The mean pose is kept.
    fn join(&mut self, other: &Reached) {
        let weight = self.weight + other.weight;
        let mean = |a: f64, b: f64| (a * self.weight + b * other.weight) / weight;
        let Pose { x, y, heading, bevel } = self.pose;
        let to = other.pose;
        self.pose = Pose { x: mean(x, to.x), y: mean(y, to.y), heading: mean(heading, to.heading), bevel };
        self.success = mean(self.success, other.success);
        self.doubt += other.doubt;
        self.weight = weight;
    }
}

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
            let reached = self.success_after(pose, action, success);
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
    /// The step ends at a pose for each noise of the heading. Where the table may decide the most, the step from that pose is
    /// made too, and so on, until the table decides little everywhere or the [`POSES`] are used up.
    fn success_after(&self, pose: Pose, action: u8, success: &[f32]) -> f64 {
        let mut reached: Vec<Reached> = Vec::new();
        let mut sum = self.follow(pose, action, 1.0, success, &mut reached);
        for _ in 1..POSES {
            let most = |best: usize, at: usize| if reached[at].doubt > reached[best].doubt { at } else { best };
            let Some(at) = (0..reached.len()).reduce(most) else { break };
            let Reached { pose, weight, doubt, .. } = reached[at];
            if doubt <= DOUBT {
                break;
            }
            reached.swap_remove(at);
            sum += self.follow(pose, self.greedy_action(pose), weight, success, &mut reached);
        }
        sum + reached.iter().map(|reached| reached.weight * reached.success).sum::<f64>()
    }

    /// Makes the step of an action from a pose of the probability `weight`. Returns the probability of the success that is
    /// decided by it, and adds the poses at its end whose success is not.
    fn follow(&self, pose: Pose, action: u8, weight: f64, success: &[f32], reached: &mut Vec<Reached>) -> f64 {
        let (event, end) = self.step(pose, action);
        if let Some(event) = event {
            return if event == Event::Target { weight } else { 0.0 };
        }
        let mut decided = 0.0;
        for (m, p) in self.setup.noise.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            let turned = m as f64 * self.setup.noise_step();
            let sides = [-turned, turned];
            for turn in &sides[usize::from(m == 0)..] {
                let pose = Pose { heading: end.heading + turn, ..end };
                let (mean, range) = self.interpolated(success, pose);
                let weight = weight * p;
                let doubt = weight * if self.is_unresolved(pose) { 1.0 } else { range };
                let next = Reached { pose, weight, success: mean, doubt };
                if let Some(other) = reached.iter_mut().find(|other| self.are_alike(&other.pose, &pose)) {
                    other.join(&next);
                } else if doubt > DOUBT {
                    reached.push(next);
                } else {
                    decided += weight * mean;
                }
            }
        }
        decided
    }

    /// Whether the table does not resolve the success around a pose. Without noise success is 0 or 1 everywhere, with jumps
    /// that no grid resolves. With noise success is as wide as the target close to it.
    fn is_unresolved(&self, pose: Pose) -> bool {
        let ([x, y], radius) = (self.setup.workspace.target, self.setup.workspace.target_radius);
        let (sin, cos) = pose.heading.sin_cos();
        let [dx, dy] = self.setup.spacing;
        let across = if sin.abs() > cos.abs() { dx * sin.abs() } else { dy * cos.abs() };
        let near = radius + UNRESOLVED_STEPS * self.needle_at(pose).step_length();
        self.setup.noise[1..].iter().all(|p| *p == 0.0)
            || 2.0 * radius < RESOLVED_CELLS * across && (pose.x - x).hypot(pose.y - y) < near
    }

    /// Whether two poses are followed as one.
    fn are_alike(&self, one: &Pose, other: &Pose) -> bool {
        let noise = self.setup.noise_step();
        let of_noise = ALIKE_NOISE * noise * self.needle_at(*one).step_length();
        (one.heading - other.heading).abs() < ALIKE_HEADING * noise
            && one.bevel == other.bevel
            && (one.x - other.x).hypot(one.y - other.y) < of_noise.min(ALIKE_RADII * self.setup.workspace.target_radius)
    }

    /// A table of success interpolated over position and heading, and the range of the values at the corners, where
    /// points that are not free count as 0.
    ///
    /// It is cubic at four stations with four points each, or where one of these is not free, linear over the free corners
    /// at two. Along the heading it is of the same order.
    fn interpolated(&self, success: &[f32], pose: Pose) -> (f64, f64) {
        let (headings, b) = (self.lattice.shape().headings, usize::from(pose.bevel > 0.0));
        let cells = pose.heading / self.setup.needle.heading_step();
        let whole = cells.floor();
        let sides = [(whole, 1.0 - (cells - whole)), (whole + 1.0, cells - whole)]
            .map(|(k, share)| (k.rem_euclid(headings as f64) as usize % headings * 2 + b, share));
        let at = |first: usize, side: usize| f64::from(success[first + sides[side].0]);
        let (mut mean, mut sum, mut low, mut high) = (0.0, 0.0, 1.0f64, 0.0f64);
        self.for_each_corner(pose, |weight, corner| {
            let Corner::Point(first) = corner else {
                low = 0.0;
                return;
            };
            sum += weight;
            for side in (0..2).filter(|side| sides[*side].1 > 1e-9) {
                let value = at(first, side);
                (mean, low, high) = (mean + weight * sides[side].1 * value, low.min(value), high.max(value));
            }
        });
        let range = (high - low).max(0.0);
        if self.setup.transition == Transition::Nearest {
            return (mean, range);
        }
        let around = cubic_weights(cells - whole);
        let along_heading = |first: usize| {
            let value = |side: usize| {
                let k = (whole + side as f64 - 1.0).rem_euclid(headings as f64) as usize % headings;
                f64::from(success[first + k * 2 + b])
            };
            around.iter().enumerate().map(|(side, weight)| weight * value(side)).sum::<f64>()
        };
        if let Some(mean) = self.cubic(pose, along_heading) {
            return (mean.clamp(0.0, 1.0), range);
        }
        (if sum > LEAST_SUM { mean / sum } else { mean }, range)
    }

    /// A quantity of grid points, by their first states, interpolated with four points around each of the four stations
    /// nearest to a pose; None if one of them is not free.
    fn cubic(&self, pose: Pose, value: impl Fn(usize) -> f64) -> Option<f64> {
        let Shape { ny, headings, .. } = self.lattice.shape();
        let stations = self.stations(pose);
        let [lines, points] = stations.extent;
        let first = |cells: f64, count: usize| {
            let first = cells.floor() as i64 - 1;
            (first >= 0 && first + 4 <= count as i64).then_some(first as usize)
        };
        let mut sum = 0.0;
        for (line, along) in
            (first(stations.along, lines)?..).zip(cubic_weights(stations.along - stations.along.floor()))
        {
            let place = stations.place(line as f64);
            for (point, across) in (first(place, points)?..).zip(cubic_weights(place - place.floor())) {
                let (i, j) = stations.point(line, point);
                if self.lattice.outcome(Motion::Curved, i, j, 0, 0) == outcome::AT_OBSTACLE {
                    return None;
                }
                sum += along * across * value((i * ny + j) * headings * 2);
            }
        }
        Some(sum)
    }

    /// Expectation of a table over the noise at the end of a step, interpolated linearly at two stations, and along the heading.
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

    /// Calls `visit(weight, corner)` for the two grid points around each of the two stations nearest to a pose, with their
    /// linear weights.
    #[inline(always)]
    fn for_each_corner(&self, pose: Pose, mut visit: impl FnMut(f64, Corner)) {
        let Shape { ny, headings, .. } = self.lattice.shape();
        let stations = self.stations(pose);
        let [lines, points] = stations.extent;
        let (line, behind) = (stations.along.floor(), stations.along - stations.along.floor());
        for (line, along) in [(line, 1.0 - behind), (line + 1.0, behind)] {
            // Beside the border of the grid a station may lie beyond it.
            let place = stations.place(line).clamp(0.0, (points - 1) as f64);
            for (point, across) in [(place.floor(), 1.0 - place.fract()), (place.floor() + 1.0, place.fract())] {
                let weight = along * across;
                if weight == 0.0 {
                    continue;
                }
                if !(0.0..lines as f64).contains(&line) {
                    visit(weight, Corner::Outside);
                    continue;
                }
                let (i, j) = stations.point(line as usize, point as usize);
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

    /// The stations of a pose.
    #[inline(always)]
    fn stations(&self, Pose { x, y, heading, .. }: Pose) -> Stations {
        let Shape { nx, ny, .. } = self.lattice.shape();
        let spacing = self.setup.spacing;
        let ((u, v), (sin, cos)) = ((x / spacing[0], y / spacing[1]), heading.sin_cos());
        if sin.abs() > cos.abs() {
            let slope = cos / sin * spacing[1] / spacing[0];
            Stations { along: v, across: u, slope, is_steep: true, extent: [ny, nx] }
        } else {
            let slope = sin / cos * spacing[0] / spacing[1];
            Stations { along: u, across: v, slope, is_steep: false, extent: [nx, ny] }
        }
    }
}

/// Where a table is read for a pose: at the grid lines across its motion, columns unless the heading is nearer to y than to x,
/// where its tangent crosses them.
struct Stations {
    /// Place of the pose along and across the motion, in cells.
    along: f64,
    across: f64,
    /// Cells across for each cell along.
    slope: f64,
    /// Whether the lines are rows of the grid.
    is_steep: bool,
    /// Number of lines, and of points on each.
    extent: [usize; 2],
}

impl Stations {
    /// Where the tangent crosses a line, in cells across.
    #[inline(always)]
    fn place(&self, line: f64) -> f64 {
        self.across + (line - self.along) * self.slope
    }

    /// The grid point of a number on a line.
    #[inline(always)]
    fn point(&self, line: usize, point: usize) -> (usize, usize) {
        if self.is_steep { (point, line) } else { (line, point) }
    }
}

/// A grid point beside a station.
enum Corner {
    Outside,
    InObstacle,
    /// The index of its first state.
    Point(usize),
}
