//! States from which the execution can be made to end.
//!
//! With discount 1 and positive stage costs, V*(s) is finite exactly if some policy reaches an absorbing state from s
//! with probability one: a policy that fails to do so with positive probability pays at least the least stage cost
//! infinitely often with that probability, while one that succeeds can be chosen stationary, hence ends within a
//! geometric time. The set of these states is the largest X with the property
//!
//! ```text
//! X = least Y that holds the absorbing states and every s in X with an action that stays within X and may enter Y
//! ```
//!
//! (de Alfaro 1997, "prob1E"). *Why:* within such an X, taking in every state the action that put it into Y lowers the
//! rank at which a state entered Y with a probability bounded below, and never leaves X; so rank zero is reached with
//! probability one. Conversely the states that can end almost surely satisfy the equation, hence lie in the largest
//! solution. It is found from above: start with every state, compute Y by a backward search, drop what is not in Y,
//! repeat until nothing is dropped. Almost every problem needs one or two rounds of time O(entries) each.

use crate::dependency::StateDependents;
use crate::mdp::Mdp;
use crate::tabular::ROW_SUM_TOLERANCE;

/// For every state, whether some policy ends the execution from there with probability one. A row that sums to less
/// than one (by more than 1e-9) may end, too. Needs the reverse graph: 4 bytes for every (state, successor).
pub fn proper_states(mdp: &impl Mdp) -> Vec<bool> {
    let dependents = StateDependents::new(mdp);
    let mut allowed = vec![true; mdp.states()];
    loop {
        let reached = ending_states(mdp, &dependents, &allowed);
        if reached == allowed {
            return reached;
        }
        allowed = reached;
    }
}

/// The least Y for a given X.
fn ending_states(mdp: &impl Mdp, dependents: &StateDependents, allowed: &[bool]) -> Vec<bool> {
    let mut reached = vec![false; mdp.states()];
    let mut frontier: Vec<u32> = Vec::new();
    for state in 0..mdp.states() {
        if allowed[state] && (mdp.actions(state) == 0 || may_enter(mdp, state, allowed, &reached)) {
            reached[state] = true;
            frontier.push(state as u32);
        }
    }
    while let Some(next) = frontier.pop() {
        for &state in dependents.sds(next as usize) {
            let state = state as usize;
            if !reached[state] && allowed[state] && may_enter(mdp, state, allowed, &reached) {
                reached[state] = true;
                frontier.push(state as u32);
            }
        }
    }
    reached
}

/// Whether some action stays within `allowed` and, with positive probability, ends or enters `reached`.
fn may_enter(mdp: &impl Mdp, state: usize, allowed: &[bool], reached: &[bool]) -> bool {
    (0..mdp.actions(state)).any(|action| {
        let (mut stays, mut enters, mut total) = (true, false, 0.0);
        mdp.for_each_successor(state, action, |next, probability| {
            if probability > 0.0 {
                stays &= allowed[next];
                enters |= reached[next];
                total += probability;
            }
        });
        stays && (enters || total < 1.0 - ROW_SUM_TOLERANCE)
    })
}
