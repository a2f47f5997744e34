//! The Markov decision process that every solver of this crate takes.
//!
//! States are `0..states()`; a state has `actions(s)` actions, or none: then it is *absorbing* and its value is fixed.
//! Taking action `a` in `s` costs `stage_cost(s, a)` (an expectation, everything that happens in the step included) and
//! moves to `s'` with probability `p(s' | s, a)`. The probabilities of a row may sum to less than one: the rest ends
//! the execution with value zero. The optimal cost-to-go is the least fixed point of
//!
//! ```text
//! V(s) = min over a of [ stage_cost(s, a) + discount * sum over s' of p(s' | s, a) V(s') ].
//! ```

/// A finite Markov decision process with costs.
pub trait Mdp: Sync {
    /// Number of states n.
    fn states(&self) -> usize;

    /// Discount factor, in (0, 1]. With 1 every stage cost must be positive (a stochastic shortest-path problem).
    fn discount(&self) -> f64;

    /// Number of actions of `state`; 0 for an absorbing state.
    fn actions(&self, state: usize) -> usize;

    /// Value of an absorbing state; not asked for any other.
    fn absorbing_value(&self, _state: usize) -> f64 {
        0.0
    }

    /// Expected cost of the step.
    fn stage_cost(&self, state: usize, action: usize) -> f64;

    /// Calls `visit(successor, probability)` for every successor, always in the same order.
    fn for_each_successor(&self, state: usize, action: usize, visit: impl FnMut(usize, f64));

    /// `stage_cost + discount * E V(s')`; a successor of probability zero does not count, even if its value is infinite.
    fn q_value(&self, state: usize, action: usize, values: &[f64]) -> f64 {
        let mut expectation = 0.0;
        self.for_each_successor(state, action, |next, probability| {
            if probability > 0.0 {
                expectation += probability * values[next];
            }
        });
        self.stage_cost(state, action) + self.discount() * expectation
    }

    /// One Bellman backup: the least Q-value and the first action that attains it.
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

    /// V0 of the states in which something can be done. Without a discount values creep up from zero by a stage cost a
    /// sweep; a guess of their size saves that.
    fn start_value(&self) -> f64 {
        0.0
    }

    /// The smallest stage cost of the problem: what the error bound of an undiscounted problem rests on.
    fn least_stage_cost(&self) -> f64 {
        let costs = (0..self.states())
            .flat_map(|state| (0..self.actions(state)).map(move |action| self.stage_cost(state, action)));
        costs.fold(f64::INFINITY, f64::min)
    }
}
