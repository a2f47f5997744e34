//! An order of the states of a component in which successors are near.
//!
//! The equations of a policy are solved fastest if successors are near: in a narrow band, or with few cache misses. A
//! breadth-first search puts all successors of a level into the levels up to the next one (Cuthill and McKee 1969).

use crate::tabular::TabularMdp;

/// Mark of a state outside the component in the table of places.
pub(crate) const OUTSIDE: u32 = u32::MAX;

/// Mean distance of successors, as a multiple of the square root of the number of states, up to which an order is good:
/// a problem on a square grid has a mean distance of about one root.
const GOOD: f64 = 4.0;

/// Mean size of a level of the search, as a part of the present mean distance, from which on the new order is not worth it.
const WORTH: f64 = 0.5;

/// Returns the states in a better order than the given one, or None if there is none. `places` holds the place of every
/// state of the component, and [`OUTSIDE`] for all others.
pub(crate) fn better_order(mdp: &TabularMdp, states: &[u32], places: &[u32]) -> Option<Vec<u32>> {
    let n = states.len();
    let present = distance(mdp, states, places);
    if present <= GOOD * (n as f64).sqrt() {
        return None;
    }
    let (order, width) = search(mdp, states, places)?;
    (width < WORTH * present).then_some(order)
}

/// Mean distance between a state and a successor by its first action.
fn distance(mdp: &TabularMdp, states: &[u32], places: &[u32]) -> f64 {
    let (mut sum, mut count) = (0u64, 0u64);
    for (place, &state) in states.iter().enumerate() {
        let (successors, ..) = mdp.row(mdp.rows(state as usize).start);
        for next in successors.iter().map(|&next| places[next as usize]).filter(|&next| next != OUTSIDE) {
            sum += u64::from(next.abs_diff(place as u32));
            count += 1;
        }
    }
    sum as f64 / count.max(1) as f64
}

/// Breadth-first search from the first state: the states in the order of the search, and the mean size of the level of a
/// state. None if some state is not reached: an action of probability zero, or one that is not allowed.
fn search(mdp: &TabularMdp, states: &[u32], places: &[u32]) -> Option<(Vec<u32>, f64)> {
    let n = states.len();
    let (mut order, mut seen) = (Vec::with_capacity(n), vec![false; n]);
    order.push(states[0]);
    seen[0] = true;
    let (mut next, mut level, mut squares) = (0, 0, 0.0);
    while next < order.len() && order.len() < n {
        if next == level {
            squares += ((order.len() - level) as f64).powi(2);
            level = order.len();
        }
        let rows = mdp.rows(order[next] as usize);
        next += 1;
        let (successors, ..) = mdp.consecutive_rows(rows);
        for &state in successors {
            let place = places[state as usize];
            if place != OUTSIDE && !std::mem::replace(&mut seen[place as usize], true) {
                order.push(state);
            }
        }
    }
    squares += ((order.len() - level) as f64).powi(2);
    (order.len() == n).then_some((order, squares / n as f64))
}
