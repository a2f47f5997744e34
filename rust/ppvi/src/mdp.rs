//! The trait of all problems: a finite Markov decision process with costs.
//!
//! States are `0..states()`. State `s` has `actions(s)` actions; a state without actions is *absorbing*, and its value
//! is fixed. Action `a` in state `s` has the expected cost `stage_cost(s, a)` and moves to `s'` with probability
//! `p(s' | s, a)`. If the probabilities of a row sum to less than one, the execution ends with the remaining
//! probability, at value zero. The optimal cost-to-go is the least fixed point of
//!
//! ```text
//! V(s) = min over a of [ stage_cost(s, a) + discount * sum over s' of p(s' | s, a) V(s') ].
//! ```

use crate::stop::StopFlag;

/// Largest difference between one and the sum of the probabilities of a row.
pub(crate) const ROW_SUM_TOLERANCE: f64 = 1e-9;

/// A finite Markov decision process with costs.
pub trait Mdp: Sync {
    /// Number of states n.
    fn states(&self) -> usize;

    /// Discount factor, in (0, 1]. With 1 every stage cost must be positive (a stochastic shortest-path problem).
    fn discount(&self) -> f64;

    /// Number of actions of `state`, 0 for an absorbing state.
    fn actions(&self, state: usize) -> usize;

    /// Value of an absorbing state. Solvers do not call it for other states.
    fn absorbing_value(&self, _state: usize) -> f64 {
        0.0
    }

    /// Expected cost of the step that `action` starts in `state`.
    fn stage_cost(&self, state: usize, action: usize) -> f64;

    /// Calls `visit(successor, probability)` for every successor, in the same order at every call.
    fn for_each_successor(&self, state: usize, action: usize, visit: impl FnMut(usize, f64));

    /// Returns the Q-value `stage_cost + discount * E V(s')`. Successors of probability zero are left out, because
    /// their values may be infinite.
    fn q_value(&self, state: usize, action: usize, values: &[f64]) -> f64 {
        let mut expectation = 0.0;
        self.for_each_successor(state, action, |next, probability| {
            if probability > 0.0 {
                expectation += probability * values[next];
            }
        });
        self.stage_cost(state, action) + self.discount() * expectation
    }

    /// One Bellman backup: returns the smallest Q-value and the first action that attains it.
    fn backup(&self, state: usize, values: &[f64]) -> (f64, usize) {
        if self.actions(state) == 0 {
            return (self.absorbing_value(state), 0);
        }
        let mut best = (f64::INFINITY, 0);
        for action in 0..self.actions(state) {
            let q = self.q_value(state, action, values);
            if q < best.0 {
                best = (q, action);
            }
        }
        best
    }

    /// Start value V0 of the states that are not absorbing. With discount 1, values that start at zero grow by about
    /// one stage cost per sweep, so a start value of the right size saves sweeps.
    fn start_value(&self) -> f64 {
        0.0
    }

    /// The numbers of the problem on which error bounds rest. By default, one pass over all rows.
    fn facts(&self) -> Facts {
        let (mut facts, stop) = (Facts::default(), StopFlag::current());
        for state in 0..self.states() {
            stop.check();
            for action in 0..self.actions(state) {
                let (mut entries, mut sum) = (0, 0.0);
                self.for_each_successor(state, action, |_, probability| {
                    entries += 1;
                    sum += probability;
                });
                facts.add(entries, sum, self.stage_cost(state, action));
            }
        }
        facts
    }
}

/// The numbers of a problem on which error bounds rest; see [`crate::termination`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facts {
    /// Largest number of successors of an action.
    pub longest_row: usize,
    /// Largest deviation of the sum of a row from one, for rows that do not end the execution.
    pub excess: f64,
    /// Smallest stage cost, after the potential is added.
    pub least_stage_cost: f64,
    /// Largest |stage cost|.
    pub largest_stage_cost: f64,
    /// Largest potential that is added for steps of cost zero; 0 if there are none.
    pub potential: f64,
}

impl Default for Facts {
    /// The facts of a problem without rows.
    fn default() -> Self {
        let least_stage_cost = f64::INFINITY;
        Facts { longest_row: 0, excess: 0.0, least_stage_cost, largest_stage_cost: 0.0, potential: 0.0 }
    }
}

impl Facts {
    /// Adds a row with the sum `sum` of its probabilities.
    #[inline]
    pub fn add(&mut self, entries: usize, sum: f64, cost: f64) {
        self.longest_row = self.longest_row.max(entries);
        let deviation = (sum - 1.0).abs();
        if (sum > 1.0 || deviation <= ROW_SUM_TOLERANCE) && deviation > self.excess {
            self.excess = deviation;
        }
        self.least_stage_cost = self.least_stage_cost.min(cost);
        self.largest_stage_cost = self.largest_stage_cost.max(cost.abs());
    }

    /// The facts of two sets of rows together.
    pub fn join(self, other: Facts) -> Facts {
        Facts {
            longest_row: self.longest_row.max(other.longest_row),
            excess: self.excess.max(other.excess),
            least_stage_cost: self.least_stage_cost.min(other.least_stage_cost),
            largest_stage_cost: self.largest_stage_cost.max(other.largest_stage_cost),
            potential: self.potential.max(other.potential),
        }
    }
}
