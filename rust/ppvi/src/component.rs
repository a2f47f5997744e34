//! Policy iteration in one strongly connected component, with the values of all other states fixed.
//!
//! The component is compiled to rows without self-loops: with the probability p of staying, an action of the value
//! k + g p V(s) + rest is replaced by (k + rest) / (1 - g p), which has the same fixed points. Changes are measured in
//! units of the original rows, by the factor 1 - g p.
//!
//! One round is a Gauss-Seidel sweep over all actions, which also chooses the policy, and an evaluation of this policy:
//! by Gauss-Seidel sweeps, and if they converge slowly by a direct or iterative solve of its equations
//! (`policy_equations.rs`). An evaluation that does not reduce its residual is taken back. The sweeps alone converge, so
//! the rounds do.

use crate::mdp::Mdp;
use crate::policy_equations::{Equations, largest};
use crate::tabular::TabularMdp;
use crate::termination::Status;

/// Policy sweeps of a round before the rate of convergence is judged.
const PROBE_SWEEPS: u32 = 4;

/// Policy sweeps of a round of modified policy iteration.
const MODIFIED_SWEEPS: u32 = 20;

/// Reduction of the change at which an evaluation by sweeps is accurate enough for the next choice of the policy.
const PROBE_REDUCTION: f64 = 0.1;

/// Accuracy of an iterative evaluation of a policy that may still change, relative to its residual.
const INEXACT: f64 = 0.01;

/// Accuracy of an iterative evaluation in exact policy iteration, relative to its residual.
const EXACT: f64 = 1e-10;

/// Rounds without a smaller change after which a change near the rounding is taken as final.
const MOST_STALLED_ROUNDS: u32 = 8;

/// Mark of a state outside the component in the table of places.
pub(crate) const OUTSIDE: u32 = u32::MAX;

/// How policies are evaluated; see [`crate::policy_iteration`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Evaluation {
    /// By a few sweeps, or by a solve of the equations where sweeps converge slowly.
    #[default]
    Auto,
    /// By a fixed number of sweeps.
    Sweeps,
    /// By a solve of the equations.
    Solve,
}

/// A component and the state of its solve.
#[derive(Debug, Default)]
pub(crate) struct Component {
    states: Vec<u32>,
    /// Rows of state i: `rows[i]..rows[i + 1]`. Entries of row r: `ends[r]..ends[r + 1]`.
    rows: Vec<u32>,
    ends: Vec<u32>,
    columns: Vec<u32>,
    weights: Vec<f64>,
    constants: Vec<f64>,
    /// Change of the original row for a change of one of the row without self-loop.
    scales: Vec<f64>,
    values: Vec<f64>,
    choices: Vec<u32>,
    /// Whether the discount is 1: no value is negative, and the equations of a policy that may not end are singular.
    undiscounted: bool,
    equations: Equations,
    /// Backups of single states.
    pub backups: u64,
}

/// What ends the solve of a component.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Goal {
    /// Largest change of a sweep that is small enough.
    pub threshold: f64,
    /// Change that may be rounding.
    pub floor: f64,
}

impl Component {
    /// Compiles a component. `places` must hold [`OUTSIDE`] for all states, and does so again afterwards.
    pub fn compile(&mut self, mdp: &TabularMdp, states: &[u32], values: &[f64], places: &mut [u32]) {
        self.states.clear();
        self.states.extend_from_slice(states);
        self.fill(mdp, values, places);
        if let Some(order) = self.better_order() {
            self.states = order.into_iter().map(|place| states[place as usize]).collect();
            self.fill(mdp, values, places);
        }
        self.values.clear();
        self.values.extend(self.states.iter().map(|&state| values[state as usize]));
        self.choices.clear();
        self.choices.resize(self.states.len(), OUTSIDE);
    }

    fn fill(&mut self, mdp: &TabularMdp, values: &[f64], places: &mut [u32]) {
        for (place, &state) in self.states.iter().enumerate() {
            places[state as usize] = place as u32;
        }
        for offsets in [&mut self.rows, &mut self.ends] {
            offsets.clear();
            offsets.push(0);
        }
        self.columns.clear();
        self.weights.clear();
        self.constants.clear();
        self.scales.clear();
        let discount = mdp.discount();
        self.undiscounted = discount == 1.0;
        for &state in &self.states {
            for row in mdp.rows(state as usize) {
                let (successors, probabilities, cost) = mdp.row(row);
                let (begin, mut outside, mut stays) = (self.columns.len(), 0.0, 0.0);
                for (&next, &probability) in successors.iter().zip(probabilities) {
                    let place = places[next as usize];
                    if next == state {
                        stays += probability;
                    } else if place != OUTSIDE {
                        self.columns.push(place);
                        self.weights.push(discount * probability);
                    } else if probability > 0.0 {
                        outside += probability * values[next as usize];
                    }
                }
                let scale = 1.0 - discount * stays;
                // An action that never leaves the state costs infinitely much without discount.
                if scale <= 0.0 || outside == f64::INFINITY {
                    self.columns.truncate(begin);
                    self.weights.truncate(begin);
                    continue;
                }
                self.weights[begin..].iter_mut().for_each(|weight| *weight /= scale);
                self.ends.push(self.columns.len() as u32);
                self.constants.push((cost + discount * outside) / scale);
                self.scales.push(scale);
            }
            self.rows.push(self.constants.len() as u32);
        }
        for &state in &self.states {
            places[state as usize] = OUTSIDE;
        }
    }

    /// Returns an order of the states in which neighbours are near (Cuthill and McKee 1969), as places in the present
    /// order, or None if it would not halve the mean distance of neighbours.
    fn better_order(&self) -> Option<Vec<u32>> {
        let n = self.states.len();
        let distance = |places: &dyn Fn(u32) -> u32| -> f64 {
            let mut sum = 0.0;
            self.each_edge(|from, to| sum += f64::from(places(from).abs_diff(places(to))));
            sum / self.columns.len().max(1) as f64
        };
        // A problem on a square grid has a mean distance of about sqrt(n).
        let present = distance(&|place| place);
        if present <= 4.0 * (n as f64).sqrt() {
            return None;
        }
        let mut offsets = vec![0u32; n + 1];
        self.each_edge(|from, to| {
            offsets[from as usize + 1] += 1;
            offsets[to as usize + 1] += 1;
        });
        for place in 0..n {
            offsets[place + 1] += offsets[place];
        }
        let (mut ends, mut neighbours) = (offsets.clone(), vec![0u32; offsets[n] as usize]);
        self.each_edge(|from, to| {
            for (at, neighbour) in [(from, to), (to, from)] {
                neighbours[ends[at as usize] as usize] = neighbour;
                ends[at as usize] += 1;
            }
        });
        let search = |first: u32| {
            let (mut order, mut seen) = (vec![first], vec![false; n]);
            seen[first as usize] = true;
            let mut next = 0;
            while let Some(&place) = order.get(next) {
                next += 1;
                for &neighbour in &neighbours[offsets[place as usize] as usize..offsets[place as usize + 1] as usize] {
                    if !std::mem::replace(&mut seen[neighbour as usize], true) {
                        order.push(neighbour);
                    }
                }
            }
            order
        };
        // From the state that is farthest from some state. All are reached: dropped rows are in no policy.
        let order = search(*search(0).last()?);
        if order.len() < n {
            return None;
        }
        let mut places = vec![0u32; n];
        order.iter().enumerate().for_each(|(place, &old)| places[old as usize] = place as u32);
        (distance(&|place| places[place as usize]) < 0.5 * present).then_some(order)
    }

    fn each_edge(&self, mut visit: impl FnMut(u32, u32)) {
        for state in 0..self.states.len() {
            let (first, last) = (self.rows[state] as usize, self.rows[state + 1] as usize);
            for entry in self.ends[first] as usize..self.ends[last] as usize {
                visit(state as u32, self.columns[entry]);
            }
        }
    }

    /// Writes the values to those of all states.
    pub fn write(&self, values: &mut [f64]) {
        for (&state, &value) in self.states.iter().zip(&self.values) {
            values[state as usize] = value;
        }
    }

    /// Improves the values until a sweep changes none by more than the goal allows. `check` is called after every round
    /// with the change, and may end the solve with a status.
    pub fn solve(
        &mut self,
        evaluation: Evaluation,
        goal: Goal,
        mut check: impl FnMut(&mut Self, f64) -> Option<Status>,
    ) -> Option<Status> {
        let (mut reverse, mut least, mut stalled) = (false, f64::INFINITY, 0);
        // Rounds to pass without a solve of the equations, and their number after the next failure.
        let (mut pause, mut penalty) = (0u32, 1u32);
        loop {
            let (change, switches) = self.sweep(reverse);
            reverse = !reverse;
            stalled = if change < least { 0 } else { stalled + 1 };
            least = least.min(change);
            if change <= goal.threshold || change <= goal.floor && stalled > MOST_STALLED_ROUNDS {
                return None;
            }
            let ended = check(self, change);
            if ended.is_some() {
                return ended;
            }
            self.collect();
            if evaluation == Evaluation::Sweeps {
                self.policy_sweeps(MODIFIED_SWEEPS, &mut reverse);
                continue;
            }
            let accuracy = match (evaluation, switches) {
                (Evaluation::Solve, _) => EXACT,
                (_, 0) => (0.1 * goal.threshold / change).clamp(EXACT, INEXACT),
                _ => INEXACT,
            };
            if evaluation == Evaluation::Auto
                && self.policy_sweeps(PROBE_SWEEPS, &mut reverse) <= PROBE_REDUCTION * change
            {
                continue;
            }
            if pause > 0 {
                pause -= 1;
            } else if self.solve_equations(accuracy) {
                penalty = 1;
            } else {
                pause = penalty;
                penalty = (2 * penalty).min(64);
            }
        }
    }

    /// A Gauss-Seidel sweep over all actions. Returns the largest change, in units of the original rows, and the number
    /// of states whose choice has changed.
    fn sweep(&mut self, reverse: bool) -> (f64, usize) {
        let (n, mut largest, mut switches) = (self.states.len(), 0.0f64, 0);
        for index in 0..n {
            let state = if reverse { n - 1 - index } else { index };
            let (mut best, mut choice) = (f64::INFINITY, OUTSIDE);
            let rows = self.rows[state] as usize..self.rows[state + 1] as usize;
            let mut begin = self.ends[rows.start] as usize;
            for row in rows {
                let end = self.ends[row + 1] as usize;
                let pairs = self.columns[begin..end].iter().zip(&self.weights[begin..end]);
                let q =
                    pairs.fold(self.constants[row], |sum, (&next, &weight)| sum + weight * self.values[next as usize]);
                begin = end;
                // Of equal actions the present one stays.
                if q < best || q == best && row as u32 == self.choices[state] {
                    (best, choice) = (q, row as u32);
                }
            }
            if choice == OUTSIDE {
                self.values[state] = f64::INFINITY;
                continue;
            }
            switches += usize::from(choice != self.choices[state]);
            let change = (best - self.values[state]).abs() * self.scales[choice as usize];
            largest = if change <= largest { largest } else { change };
            self.values[state] = best;
            self.choices[state] = choice;
        }
        self.backups += n as u64;
        (largest, switches)
    }

    /// Compiles the equations of the policy.
    fn collect(&mut self) {
        self.equations.clear();
        for &choice in &self.choices {
            let row = choice as usize;
            let entries = self.ends[row] as usize..self.ends[row + 1] as usize;
            self.equations.push(self.constants[row], &self.columns[entries.clone()], &self.weights[entries]);
        }
    }

    /// Evaluates the policy by at most `count` sweeps in alternating directions. Returns the largest change of the last.
    fn policy_sweeps(&mut self, count: u32, reverse: &mut bool) -> f64 {
        let mut change = 0.0;
        for _ in 0..count {
            change = self.equations.sweep(*reverse, &mut self.values);
            *reverse = !*reverse;
            self.backups += self.states.len() as u64;
        }
        change
    }

    /// Evaluates the policy by a solve of its equations. Returns whether this has reduced the residual; if not, the
    /// values are as before.
    fn solve_equations(&mut self, accuracy: f64) -> bool {
        let mut residual = Vec::new();
        let before = self.equations.residual(&self.values, &mut residual);
        let solved = match self.equations.solve_in_band() {
            Some(values) => values,
            None => {
                let (correction, products) = self.equations.correction(&residual, accuracy);
                self.backups += products * self.states.len() as u64;
                self.values.iter().zip(&correction).map(|(value, change)| value + change).collect()
            }
        };
        self.backups += 2 * self.states.len() as u64;
        let after = self.equations.residual(&solved, &mut residual);
        // Also false if the new residual is not a number.
        let possible = !self.undiscounted || solved.iter().all(|value| *value >= 0.0);
        let reduced = after < before && possible && largest(&solved).is_finite();
        if reduced {
            self.values = solved;
        }
        reduced
    }
}
