//! Problems that several tests share.
#![allow(dead_code)] // every test file is a crate of its own and uses some of these

pub mod exact;
pub mod random;

use ppvi::{Mdp, TabularMdp};
use proptest::prelude::*;

/// Rows in readable form: the actions of every state, each a cost and pairs (successor, probability).
pub type Rows = Vec<Vec<(f64, Vec<(u32, f64)>)>>;

/// Packs rows into the compressed form.
pub fn tabular(rows: &Rows, discount: f64) -> ppvi::Result<TabularMdp<'static>> {
    let (mut action_offsets, mut row_offsets) = (vec![0], vec![0]);
    let (mut successors, mut probabilities, mut costs) = (Vec::new(), Vec::new(), Vec::new());
    for state in rows {
        for (cost, row) in state {
            costs.push(*cost);
            successors.extend(row.iter().map(|entry| entry.0));
            probabilities.extend(row.iter().map(|entry| entry.1));
            row_offsets.push(successors.len());
        }
        action_offsets.push(costs.len());
    }
    TabularMdp::new(action_offsets, row_offsets, successors, probabilities, costs, discount)
}

/// A chain of unit steps to the right that ends in the absorbing last state.
pub fn chain(states: usize, discount: f64) -> TabularMdp<'static> {
    let step = |s: usize| if s + 1 < states { vec![(1.0, vec![(s as u32 + 1, 1.0)])] } else { vec![] };
    tabular(&(0..states).map(step).collect(), discount).expect("a valid chain")
}

/// A grid world. Each of four moves costs 1 and succeeds with probability `sure`, otherwise the state stays. Walls and
/// borders reflect, and the corner (0, 0) absorbs.
pub fn grid_world(columns: usize, rows: usize, wall: impl Fn(usize, usize) -> bool, sure: f64) -> Rows {
    let index = |i: usize, j: usize| (i * rows + j) as u32;
    let cells = (0..columns).flat_map(|i| (0..rows).map(move |j| (i, j)));
    let moves = |(i, j): (usize, usize)| {
        if (i, j) == (0, 0) {
            return vec![];
        }
        let steps = [(i.wrapping_sub(1), j), (i + 1, j), (i, j.wrapping_sub(1)), (i, j + 1)];
        let land =
            |(a, b): (usize, usize)| if a < columns && b < rows && !wall(a, b) { index(a, b) } else { index(i, j) };
        steps.map(|step| (1.0, vec![(land(step), sure), (index(i, j), 1.0 - sure)])).to_vec()
    };
    cells.map(moves).collect()
}

/// Random problems of 1 to 40 states, some absorbing, with repeated successors, self-loops and zero probabilities.
pub fn random_rows() -> impl Strategy<Value = Rows> {
    (1usize..40).prop_flat_map(|states| {
        let entry = (0..states as u32, 0u32..4);
        let row = (0.1f64..10.0, prop::collection::vec(entry, 1..6));
        prop::collection::vec(prop::collection::vec(row, 0..4), states).prop_map(normalized)
    })
}

/// An action with integer weights instead of probabilities.
type Weighted = (f64, Vec<(u32, u32)>);

fn normalized(raw: Vec<Vec<Weighted>>) -> Rows {
    let row = |(cost, entries): Weighted| {
        let total: u32 = entries.iter().map(|entry| entry.1).sum();
        let share = |weight: u32| if total == 0 { 0.0 } else { f64::from(weight) / f64::from(total) };
        let mut row: Vec<(u32, f64)> = entries.iter().map(|&(next, weight)| (next, share(weight))).collect();
        if total == 0 {
            row[0].1 = 1.0;
        }
        (cost, row)
    };
    raw.into_iter().map(|state| state.into_iter().map(row).collect()).collect()
}

/// V* up to rounding: value iteration with a fixed number of sweeps, which suffices for all tests.
pub fn brute_force(mdp: &impl Mdp, sweeps: usize) -> Vec<f64> {
    let mut values = vec![0.0; mdp.states()];
    for _ in 0..sweeps {
        values = (0..mdp.states()).map(|state| mdp.backup(state, &values).0).collect();
    }
    values
}
