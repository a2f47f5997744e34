//! Proper states: states from which some policy ends the execution with probability one.
//!
//! With discount 1 and positive stage costs, V*(s) is finite if and only if s is proper. A policy that may fail to end
//! pays at least the smallest stage cost infinitely often, with positive probability. A policy that ends with
//! probability one can be chosen stationary, and its expected number of steps is finite. The proper states are the
//! largest set X with the property
//!
//! ```text
//! X = least Y that holds the absorbing states and every s in X with an action that stays within X and may enter Y
//! ```
//!
//! (de Alfaro 1997, "prob1E").
//!
//! *Proof.* Let Y grow from the absorbing states, and let the rank of a state be the step in which it enters Y. In
//! every state of X take the action that put it into Y. This action never leaves X, and it lowers the rank with a
//! probability that is bounded from below, so rank zero is reached with probability one. Conversely, the proper states
//! satisfy the equation, hence they lie in its largest solution. []
//!
//! *Algorithm.* Start with all states as X, compute Y, replace X by Y, and repeat until they are equal. Almost every
//! problem needs one or two rounds. Y is computed by alternating forward and backward sweeps, which need no memory, and
//! few of them if neighbours have near indices. After 16 sweeps a backward search in the reverse graph computes the
//! rest, in time O(entries).

use crate::dependency::StateDependents;
use crate::mdp::{Mdp, ROW_SUM_TOLERANCE};
use crate::stop::StopFlag;

/// Number of sweeps before the reverse graph is built.
const SWEEPS: usize = 16;

/// Returns for every state whether it is proper: whether some policy ends the execution from there with probability
/// one. The execution may end in an absorbing state, or in a row whose probabilities sum to less than one (by more than
/// 1e-9).
pub fn proper_states(mdp: &impl Mdp) -> Vec<bool> {
    let order: Vec<u32> = (0..mdp.states() as u32).collect();
    proper_states_in(mdp, &order)
}

/// [`proper_states`] with sweeps in this order of all states that are not absorbing. An order in which successors come
/// first saves sweeps.
pub(crate) fn proper_states_in(mdp: &impl Mdp, order: &[u32]) -> Vec<bool> {
    let mut allowed = vec![true; mdp.states()];
    let mut dependents = None;
    loop {
        let reached = ending_states(mdp, &mut dependents, &allowed, order);
        if reached == allowed {
            return reached;
        }
        allowed = reached;
    }
}

/// The least Y for the X given by `allowed`.
fn ending_states(
    mdp: &impl Mdp,
    dependents: &mut Option<StateDependents>,
    allowed: &[bool],
    order: &[u32],
) -> Vec<bool> {
    let stop = StopFlag::current();
    let mut reached: Vec<bool> = (0..mdp.states()).map(|state| allowed[state] && mdp.actions(state) == 0).collect();
    let mut missing: Vec<u32> =
        order.iter().copied().filter(|&s| allowed[s as usize] && !reached[s as usize]).collect();
    for _ in 0..SWEEPS {
        let before = missing.len();
        missing.retain(|&state| {
            stop.check();
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
        stop.check();
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

/// Whether some action stays within `allowed` and, with positive probability, ends the execution or enters `reached`.
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
