//! Policy iteration in one strongly connected component, with the values of all other states fixed.
//!
//! One round is a Gauss-Seidel sweep over the actions, which also chooses the policy, and an evaluation of this policy:
//! by Gauss-Seidel sweeps, and if they converge slowly by a direct or iterative solve of its equations
//! (`policy_equations.rs`). An evaluation that does not reduce its residual is taken back. The sweeps alone converge, so
//! the rounds do.
//!
//! *Self-loops.* With the probability p of staying, an action of the value k + g p V(s) + rest is replaced by
//! (k + rest) / (1 - g p), which has the same fixed points. Changes are measured in units of the original rows, by the
//! factor 1 - g p.
//!
//! *Actions that cannot be best* are left out of a sweep (MacQueen 1967). Let no value of the component have fallen by
//! more than d since the value q of a row was computed. The weights of a row sum to at most 1, so its value is now at
//! least q - d. A sweep computes the present action of a state first, and another one only if its bound is lower.

use crate::component_order::{OUTSIDE, better_order};
use crate::mdp::Mdp;
use crate::policy_equations::{Equations, LONG_ROW, dot_at, largest};
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

/// Largest number of rounds without a solve of the equations after solves that did not reduce the residual.
const LONGEST_PAUSE: u32 = 64;

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

/// A component and the state of its solve. Its rows stay where they are in the problem.
#[derive(Debug, Default)]
pub(crate) struct Component {
    /// The states in the order of a sweep.
    states: Vec<u32>,
    /// Bounds and scales of the rows of state i: `offsets[i]..offsets[i + 1]`.
    offsets: Vec<u32>,
    /// Lower bound of the value of a row, less `drift`; infinite for a row that does not leave its state.
    bounds: Vec<f64>,
    /// 1 / (1 - g p) of a row, with its probability p of staying: the change of the row without self-loop for one of the row.
    scales: Vec<f64>,
    /// Row of the present action of every state, and its scale.
    choices: Vec<(u32, f64)>,
    /// Lower bound of the change of the value of any row since the start.
    drift: f64,
    /// Least sum of the weights of a row, as far as is known.
    least_weight: f64,
    /// The equations of the policy, the values of its evaluation, and their residual.
    equations: Equations,
    values: Vec<f64>,
    residual: Vec<f64>,
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
    /// Prepares the solve of a component. `places` must hold [`OUTSIDE`] for all states; it holds the places of those of the
    /// component until [`Component::leave`].
    pub fn enter(&mut self, mdp: &TabularMdp, states: &[u32], places: &mut [u32]) {
        let number = |states: &[u32], places: &mut [u32]| {
            states.iter().enumerate().for_each(|(place, &state)| places[state as usize] = place as u32);
        };
        number(states, places);
        self.states.clear();
        self.states.extend_from_slice(states);
        if let Some(order) = better_order(mdp, states, places) {
            self.states = order;
            number(&self.states, places);
        }
        let discount = mdp.discount();
        self.offsets.clear();
        self.offsets.push(0);
        self.bounds.clear();
        self.scales.clear();
        for &state in &self.states {
            for row in mdp.rows(state as usize) {
                let leaving = 1.0 - discount * staying(mdp, state, row);
                self.scales.push(1.0 / leaving);
                // An action that never leaves the state costs infinitely much without discount.
                self.bounds.push(if leaving > 0.0 { f64::NEG_INFINITY } else { f64::INFINITY });
            }
            self.offsets.push(self.scales.len() as u32);
        }
        self.least_weight = match discount < 1.0 && states.len() == mdp.states() {
            // No row leads out. g (1 - p) / (1 - g p) = 1 - (1 - g) / (1 - g p).
            true => 1.0 - (1.0 - discount) * self.scales.iter().copied().fold(1.0, f64::max),
            false => 0.0,
        };
        self.choices.clear();
        self.choices.resize(self.states.len(), (OUTSIDE, 1.0));
        self.drift = 0.0;
    }

    /// Clears the places of the component.
    pub fn leave(&self, places: &mut [u32]) {
        self.states.iter().for_each(|&state| places[state as usize] = OUTSIDE);
    }

    /// Improves the values until a sweep changes none by more than the goal allows. `check` is called after every round
    /// with the change, and may end the solve with a status.
    pub fn solve(
        &mut self,
        (mdp, places): (&TabularMdp, &[u32]),
        values: &mut [f64],
        evaluation: Evaluation,
        goal: Goal,
        mut check: impl FnMut(&mut Self, f64) -> Option<Status>,
    ) -> Option<Status> {
        let (mut reverse, mut least, mut stalled) = (false, f64::INFINITY, 0);
        // Rounds to pass without a solve of the equations, and their number after the next failure.
        let (mut pause, mut penalty) = (0u32, 1u32);
        loop {
            let (change, switches) = self.sweep(mdp, values, reverse);
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
            let accuracy = match (evaluation, switches) {
                (Evaluation::Solve, _) => EXACT,
                (_, 0) => (0.1 * goal.threshold / change).clamp(EXACT, INEXACT),
                _ => INEXACT,
            };
            self.collect(mdp, places, values);
            let evaluated = match evaluation {
                Evaluation::Solve => false,
                Evaluation::Sweeps => {
                    self.policy_sweeps(MODIFIED_SWEEPS, &mut reverse);
                    true
                }
                Evaluation::Auto => self.policy_sweeps(PROBE_SWEEPS, &mut reverse) <= PROBE_REDUCTION * change,
            };
            if !evaluated {
                if pause > 0 {
                    pause -= 1;
                } else if self.solve_equations(mdp.discount() < 1.0, accuracy) {
                    penalty = 1;
                } else {
                    pause = penalty;
                    penalty = (2 * penalty).min(LONGEST_PAUSE);
                }
            }
            self.write(values);
        }
    }

    /// Writes the values of the evaluation to those of all states.
    fn write(&mut self, values: &mut [f64]) {
        let mut least = f64::INFINITY;
        for (&state, &new) in self.states.iter().zip(&self.values) {
            least = least.min(new - values[state as usize]);
            values[state as usize] = new;
        }
        self.note_change(least);
    }

    /// Notes that every value has changed by `least` or more.
    fn note_change(&mut self, least: f64) {
        self.drift += if least < 0.0 { 1.0 } else { self.least_weight } * least;
    }

    /// A Gauss-Seidel sweep over the actions. Returns the largest change, in units of the original rows, and the number
    /// of states whose choice has changed.
    fn sweep(&mut self, mdp: &TabularMdp, values: &mut [f64], reverse: bool) -> (f64, usize) {
        let (n, mut largest, mut switches, mut least) = (self.states.len(), 0.0f64, 0, 0.0f64);
        for index in 0..n {
            let place = if reverse { n - 1 - index } else { index };
            let state = self.states[place] as usize;
            let value = values[state];
            let present = self.choices[place];
            // Of equal actions the present one stays.
            let (mut best, mut choice) = match present.0 {
                OUTSIDE => (f64::INFINITY, present),
                row => (row_value(mdp, state, row as usize, present.1, values), present),
            };
            let drift = self.drift + least;
            let (rows, local) = (mdp.rows(state), self.offsets[place] as usize..self.offsets[place + 1] as usize);
            let (bounds, scales) = (&mut self.bounds[local.clone()], &self.scales[local]);
            for ((row, bound), &scale) in rows.zip(bounds).zip(scales) {
                if *bound + drift >= best || row as u32 == present.0 {
                    continue;
                }
                let q = row_value(mdp, state, row, scale, values);
                *bound = q - self.drift;
                if q < best {
                    (best, choice) = (q, (row as u32, scale));
                }
            }
            if choice.0 == OUTSIDE {
                values[state] = f64::INFINITY;
                continue;
            }
            switches += usize::from(choice.0 != present.0);
            self.choices[place] = choice;
            let change = best - value;
            least = least.min(change);
            let size = change.abs() / choice.1;
            largest = if size <= largest { largest } else { size };
            values[state] = best;
        }
        self.note_change(least);
        self.backups += n as u64;
        (largest, switches)
    }

    /// Compiles the equations of the policy, without self-loops, and reads the values of the component.
    fn collect(&mut self, mdp: &TabularMdp, places: &[u32], values: &[f64]) {
        self.equations.clear();
        self.values.clear();
        let mut upper = Vec::new();
        for (place, (&state, &(row, scale))) in self.states.iter().zip(&self.choices).enumerate() {
            let (successors, probabilities, cost) = mdp.row(row as usize);
            let (factor, mut outside) = (mdp.discount() * scale, 0.0);
            for (&next, &probability) in successors.iter().zip(probabilities) {
                let column = places[next as usize];
                if column < place as u32 {
                    self.equations.columns.push(column);
                    self.equations.weights.push(factor * probability);
                } else if column == OUTSIDE {
                    // Zero times infinity is not a number.
                    outside += if probability > 0.0 { probability * values[next as usize] } else { 0.0 };
                } else if column > place as u32 {
                    upper.push((column, factor * probability));
                }
            }
            self.equations.end_row(cost * scale + factor * outside, &mut upper);
            self.values.push(values[state as usize]);
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
    fn solve_equations(&mut self, discounted: bool, accuracy: f64) -> bool {
        let before = self.equations.residual(&self.values, &mut self.residual);
        let solved = match self.equations.solve_in_band() {
            Some(values) => values,
            None => {
                let (correction, products) = self.equations.correction(&self.residual, accuracy);
                self.backups += products * self.states.len() as u64;
                self.values.iter().zip(&correction).map(|(value, change)| value + change).collect()
            }
        };
        self.backups += 2 * self.states.len() as u64;
        let after = self.equations.residual(&solved, &mut self.residual);
        // Also false if the new residual is not a number. Without discount no value is negative, and the equations of a
        // policy that may not end are singular.
        let possible = discounted || solved.iter().all(|value| *value >= 0.0);
        let reduced = after < before && possible && largest(&solved).is_finite();
        if reduced {
            self.values = solved;
        }
        reduced
    }
}

/// The value (k + rest) / (1 - g p) of a row of a state, without self-loop. The loop is left out of the sum: a subtraction
/// afterwards would leave rounding that the scale makes large.
#[inline(always)]
fn row_value(mdp: &TabularMdp, state: usize, row: usize, scale: f64, values: &[f64]) -> f64 {
    let (mut successors, mut probabilities, cost) = mdp.row(row);
    if mdp.discount() < 1.0 && (scale == 1.0 || successors.len() >= LONG_ROW) {
        let mut rest = 0.0;
        if scale != 1.0 {
            while let Some(at) = successors.iter().position(|&next| next as usize == state) {
                rest += dot_at(&successors[..at], &probabilities[..at], values);
                (successors, probabilities) = (&successors[at + 1..], &probabilities[at + 1..]);
            }
        }
        return (cost + mdp.discount() * (rest + dot_at(successors, probabilities, values))) * scale;
    }
    let rest = successors.iter().zip(probabilities).fold(0.0, |sum, (&next, &probability)| {
        // Without discount, a successor of probability zero may have an infinite value.
        if next as usize == state || probability == 0.0 { sum } else { sum + probability * values[next as usize] }
    });
    (cost + mdp.discount() * rest) * scale
}

/// Probability with which a row stays in its state.
fn staying(mdp: &TabularMdp, state: u32, row: usize) -> f64 {
    let (successors, probabilities, _) = mdp.row(row);
    // The search alone reads few bytes of a long row.
    match successors.contains(&state) {
        true => successors.iter().zip(probabilities).filter(|entry| *entry.0 == state).map(|entry| entry.1).sum(),
        false => 0.0,
    }
}
