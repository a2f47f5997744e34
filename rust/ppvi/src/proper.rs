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
//! solution. It is found from above: start with every state, compute Y, drop what is not in Y, repeat until nothing is
//! dropped. Almost every problem needs one or two rounds. Y is computed by sweeps forwards and backwards in turn, which
//! need no memory and are few where neighbours have near indices; should they be many, the rest is done by a backward
//! search in the reverse graph, in time O(entries).

use crate::dependency::StateDependents;
use crate::mdp::Mdp;
use crate::tabular::ROW_SUM_TOLERANCE;

/// Sweeps to try before the reverse graph is built.
const SWEEPS: usize = 16;

/// For every state, whether some policy ends the execution from there with probability one. A row that sums to less
/// than one (by more than 1e-9) may end, too.
pub fn proper_states(mdp: &impl Mdp) -> Vec<bool> {
    let mut allowed = vec![true; mdp.states()];
    let mut dependents = None;
    loop {
        let reached = ending_states(mdp, &mut dependents, &allowed);
        if reached == allowed {
            return reached;
        }
        allowed = reached;
    }
}

/// The least Y for a given X.
fn ending_states(mdp: &impl Mdp, dependents: &mut Option<StateDependents>, allowed: &[bool]) -> Vec<bool> {
    let mut reached: Vec<bool> = (0..mdp.states()).map(|state| allowed[state] && mdp.actions(state) == 0).collect();
    let mut missing: Vec<u32> = (0..mdp.states()).filter(|&s| allowed[s] && !reached[s]).map(|s| s as u32).collect();
    for _ in 0..SWEEPS {
        let before = missing.len();
        missing.retain(|&state| {
            let enters = may_enter(mdp, state as usize, allowed, &reached);
            reached[state as usize] = enters;
            !enters
        });
        if missing.is_empty() || missing.len() == before {
            return reached;
        }
        missing.reverse();
    }
    let dependents = dependents.get_or_insert_with(|| StateDependents::new(mdp));
    let mut frontier: Vec<u32> = (0..mdp.states()).filter(|&state| reached[state]).map(|state| state as u32).collect();
    while let Some(next) = frontier.pop() {
        for &state in dependents.sds(next as usize) {
            let at = state as usize;
            if !reached[at] && allowed[at] && may_enter(mdp, at, allowed, &reached) {
                reached[at] = true;
                frontier.push(state);
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
