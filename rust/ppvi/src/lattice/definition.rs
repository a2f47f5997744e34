//! The lattice as an MDP like any other: the definition of what the sweeps compute.

use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{Costs, Motion, Region, STRAIGHT, Shape, Shift, outcome};
use crate::mdp::{Facts, Mdp};

impl LatticeMdp {
    /// `(i, j, k, b)` of a state number.
    pub(crate) fn coordinates(&self, state: usize) -> (usize, usize, usize, usize) {
        let Shape { ny, headings, .. } = self.parts.shape;
        let (b, k) = (state % 2, state / 2 % headings);
        (state / 2 / headings / ny, state / 2 / headings % ny, k, b)
    }

    /// The steps of a motion from a grid point at heading `k`.
    #[inline]
    fn steps(&self, motion: Motion, i: usize, j: usize, k: usize) -> &Region {
        self.parts.step(motion, self.directions[k].region(&self.parts, i, j))
    }

    /// The motion of an action, the bevel with which it arrives, and the cost of turning.
    #[inline]
    fn chosen(&self, bevel: usize, action: usize) -> (Motion, usize, f64) {
        match action {
            0 => (Motion::Curved, bevel, 0.0),
            1 => (Motion::Curved, 1 - bevel, self.parts.costs.rotation),
            _ => (Motion::Straight, bevel, 0.0),
        }
    }

    /// Calls `visit(None or Some((i, j)), weight)` for the grid points a displaced position is split into.
    fn for_each_corner(&self, from: (usize, usize), shift: Shift, mut visit: impl FnMut(Option<(usize, usize)>, f64)) {
        let Shape { nx, ny, .. } = self.parts.shape;
        for (u, wu) in [(0, 1.0 - shift.fraction[0]), (1, shift.fraction[0])] {
            for (v, wv) in [(0, 1.0 - shift.fraction[1]), (1, shift.fraction[1])] {
                if wu * wv > 0.0 {
                    let i = from.0 as i64 + i64::from(shift.cell[0]) + u;
                    let j = from.1 as i64 + i64::from(shift.cell[1]) + v;
                    let on_grid = (0..nx as i64).contains(&i) && (0..ny as i64).contains(&j);
                    visit(on_grid.then_some((i as usize, j as usize)), wu * wv);
                }
            }
        }
    }

    /// Q-value of a step with an outcome code that arrives with a bevel, without the cost of turning.
    #[inline]
    fn q_arriving(
        &self,
        steps: &Region,
        code: u8,
        (i, j, k): (usize, usize, usize),
        arriving: usize,
        values: &[f64],
    ) -> f64 {
        let costs = &self.parts.costs;
        let Region { step_cost: step, stencil, turn, .. } = steps;
        match code {
            outcome::TARGET => return *step,
            outcome::COLLISION => return step + costs.collision,
            outcome::EXIT => return step + costs.exit,
            _ => {}
        }
        let Shape { ny, headings, .. } = self.parts.shape;
        let taps = turn[arriving].taps();
        let wraps = |cell: i32| !(0..headings as i64).contains(&(k as i64 + i64::from(cell)));
        let may_wrap = taps.first().is_some_and(|tap| wraps(tap.0)) || taps.last().is_some_and(|tap| wraps(tap.0));
        let mut expectation = 0.0;
        self.for_each_corner((i, j), stencil[k][arriving], |corner, weight| {
            let Some((i, j)) = corner else {
                expectation += weight * self.value_outside();
                return;
            };
            let headings_here = &values[(i * ny + j) * headings * 2..][..headings * 2];
            let mut mean = 0.0;
            for (cell, p) in taps {
                let heading = k as i64 + i64::from(*cell);
                let heading = if may_wrap { heading.rem_euclid(headings as i64) } else { heading };
                mean += p * headings_here[heading as usize * 2 + arriving];
            }
            expectation += weight * mean;
        });
        step + costs.discount * expectation
    }
}

impl Mdp for LatticeMdp {
    fn states(&self) -> usize {
        self.parts.shape.states()
    }

    fn discount(&self) -> f64 {
        self.parts.costs.discount
    }

    fn actions(&self, state: usize) -> usize {
        let (i, j, k, b) = self.coordinates(state);
        match self.outcome(Motion::Curved, i, j, k, b) {
            outcome::AT_OBSTACLE.. => 0,
            _ => 1 + self.parts.motions().len(),
        }
    }

    fn absorbing_value(&self, state: usize) -> f64 {
        let (i, j, k, b) = self.coordinates(state);
        self.value_at(self.outcome(Motion::Curved, i, j, k, b))
    }

    fn stage_cost(&self, state: usize, action: usize) -> f64 {
        let (i, j, k, b) = self.coordinates(state);
        let costs = &self.parts.costs;
        let (motion, arriving, turning) = self.chosen(b, action);
        let region = self.steps(motion, i, j, k);
        let mut cost = region.step_cost + turning;
        match self.outcome(motion, i, j, k, arriving) {
            outcome::COLLISION => cost += costs.collision,
            outcome::EXIT => cost += costs.exit,
            outcome::CONTINUES => self.for_each_corner((i, j), region.stencil[k][arriving], |corner, weight| {
                if corner.is_none() {
                    cost += costs.discount * weight * self.value_outside();
                }
            }),
            _ => {}
        }
        cost
    }

    fn for_each_successor(&self, state: usize, action: usize, mut visit: impl FnMut(usize, f64)) {
        let (i, j, k, b) = self.coordinates(state);
        let Shape { ny, headings, .. } = self.parts.shape;
        let (motion, arriving, _) = self.chosen(b, action);
        if self.outcome(motion, i, j, k, arriving) != outcome::CONTINUES {
            return;
        }
        let Region { stencil, turn, .. } = self.steps(motion, i, j, k);
        self.for_each_corner((i, j), stencil[k][arriving], |corner, weight| {
            let Some((i, j)) = corner else { return };
            for (cell, p) in turn[arriving].taps() {
                let heading = (k as i64 + i64::from(*cell)).rem_euclid(headings as i64) as usize;
                visit(((i * ny + j) * headings + heading) * 2 + arriving, weight * p);
            }
        });
    }

    fn backup(&self, state: usize, values: &[f64]) -> (f64, usize) {
        let (i, j, k, b) = self.coordinates(state);
        let code = self.outcome(Motion::Curved, i, j, k, b);
        if code >= outcome::AT_OBSTACLE {
            return (self.value_at(code), 0);
        }
        let curved = self.steps(Motion::Curved, i, j, k);
        let insert = self.q_arriving(curved, code, (i, j, k), b, values);
        let other = self.outcome(Motion::Curved, i, j, k, 1 - b);
        let rotate = self.q_arriving(curved, other, (i, j, k), 1 - b, values) + self.parts.costs.rotation;
        let better = if rotate < insert { (rotate, 1) } else { (insert, 0) };
        if self.parts.straight.is_empty() {
            return better;
        }
        let code = self.outcome(Motion::Straight, i, j, k, b);
        let straight = self.q_arriving(self.steps(Motion::Straight, i, j, k), code, (i, j, k), b, values);
        if straight < better.0 { (straight, usize::from(STRAIGHT)) } else { better }
    }

    /// Without a discount the cheaper failure, which is what most of a hard workspace is worth; with one, 0 as in the
    /// thesis.
    fn start_value(&self) -> f64 {
        let costs = &self.parts.costs;
        if costs.discount < 1.0 { 0.0 } else { costs.exit.min(costs.collision) }
    }

    fn facts(&self) -> Facts {
        let Costs { rotation, collision, exit, .. } = self.parts.costs;
        let steps = self.parts.steps().map(|region| region.step_cost);
        let cheapest = steps.clone().fold(f64::INFINITY, f64::min);
        let mut facts = Facts::default();
        for kernel in self.parts.steps().flat_map(|region| &region.turn) {
            let sum = kernel.taps().iter().map(|(_, p)| p).sum();
            // Four corners, and the rounding of their weights.
            facts.add(4 * kernel.taps().len() + 4, sum, cheapest);
        }
        facts.largest_stage_cost = steps.fold(0.0, f64::max) + rotation + collision.max(exit);
        facts
    }
}
