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

    /// The smallest stage cost of the problem, on which the error bound rests if the discount is 1.
    fn least_stage_cost(&self) -> f64 {
        let costs = (0..self.states())
            .flat_map(|state| (0..self.actions(state)).map(move |action| self.stage_cost(state, action)));
        costs.fold(f64::INFINITY, f64::min)
    }
}
