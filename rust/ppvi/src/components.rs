//! Strongly connected components of a problem, in the order in which their values can be computed.
//!
//! Two states are in the same component if each can reach the other. The value of a state depends on its own component
//! and on components that can be reached from it. Tarjan's algorithm (1972) completes a component after all components
//! that can be reached from it, so values computed in its order are final: an acyclic problem needs one backup per state,
//! whatever the order of its indices.

use crate::stop::StopFlag;
use crate::tabular::TabularMdp;

/// Rank of a state that is in a completed component, or is left out.
const COMPLETE: u32 = u32::MAX;

/// The components of all states that are not left out: successors first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Components {
    /// States of component c: `offsets[c]..offsets[c + 1]`, ascending.
    offsets: Vec<u32>,
    states: Vec<u32>,
}

impl Components {
    /// Searches the components of the states that are not `fixed`, without recursion, in time O(entries).
    pub fn new(mdp: &TabularMdp, fixed: &[bool]) -> Self {
        let states = fixed.len();
        // 0: not seen; otherwise the number of the visit, from 1, or COMPLETE.
        let mut ranks: Vec<u32> = fixed.iter().map(|&fixed| if fixed { COMPLETE } else { 0 }).collect();
        let mut components = Components { offsets: vec![0], states: Vec::with_capacity(states) };
        // States of incomplete components, in the order of their visits; and the path: a state, its next entry and last
        // entry, and the lowest rank that it reaches.
        let mut open: Vec<u32> = Vec::new();
        let mut path: Vec<(u32, usize, usize, u32)> = Vec::new();
        let (mut visits, stop, parts) = (0, StopFlag::current(), mdp.parts());
        let all = fixed.iter().filter(|fixed| !**fixed).count() as u32;
        let frame = |state: u32, rank: u32| {
            let rows = mdp.rows(state as usize);
            (state, parts.row_offsets[rows.start], parts.row_offsets[rows.end], rank)
        };
        for root in 0..states as u32 {
            stop.check();
            if ranks[root as usize] != 0 {
                continue;
            }
            visits += 1;
            let first = visits;
            ranks[root as usize] = visits;
            open.push(root);
            path.push(frame(root, visits));
            while let Some(&mut (state, ref mut entry, end, ref mut lowest)) = path.last_mut() {
                // Further entries would change nothing if all states are found and the rank is the lowest possible.
                if *entry < end && !(visits == all && *lowest == first) {
                    let (next, probability) = (parts.successors[*entry], parts.probabilities[*entry]);
                    *entry += 1;
                    let rank = ranks[next as usize];
                    if probability == 0.0 || rank == COMPLETE {
                        continue;
                    }
                    if rank > 0 {
                        *lowest = (*lowest).min(rank);
                        continue;
                    }
                    stop.check();
                    visits += 1;
                    ranks[next as usize] = visits;
                    open.push(next);
                    path.push(frame(next, visits));
                    continue;
                }
                let lowest = *lowest;
                path.pop();
                if let Some(last) = path.last_mut() {
                    last.3 = last.3.min(lowest);
                }
                if lowest == ranks[state as usize] {
                    components.complete(&mut open, state, &mut ranks);
                }
            }
        }
        components
    }

    /// Moves the states from `first` on into a component of their own.
    fn complete(&mut self, open: &mut Vec<u32>, first: u32, ranks: &mut [u32]) {
        let begin = self.states.len();
        while let Some(state) = open.pop() {
            ranks[state as usize] = COMPLETE;
            self.states.push(state);
            if state == first {
                break;
            }
        }
        self.states[begin..].sort_unstable();
        self.offsets.push(self.states.len() as u32);
    }

    /// Number of components.
    pub fn count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The states of all components, successors first.
    pub fn states(&self) -> &[u32] {
        &self.states
    }

    /// The states of a component, ascending.
    pub fn of(&self, component: usize) -> &[u32] {
        &self.states[self.offsets[component] as usize..self.offsets[component + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Problems of up to 20 states with one action of equal probabilities.
    fn graph() -> impl Strategy<Value = Vec<Vec<u32>>> {
        (1u32..20).prop_flat_map(|n| prop::collection::vec(prop::collection::vec(0..n, 0..4), n as usize))
    }

    proptest! {
        #[test]
        fn components_are_those_of_mutual_reachability(graph in graph(), left_out in 0usize..30) {
            let n = graph.len();
            let (mut actions, mut rows, mut successors, mut probabilities) = (vec![0], vec![0], vec![], vec![]);
            for next in &graph {
                if !next.is_empty() {
                    successors.extend(next);
                    probabilities.extend(next.iter().map(|_| 1.0 / next.len() as f64));
                    rows.push(successors.len());
                }
                actions.push(rows.len() - 1);
            }
            let costs = vec![1.0; rows.len() - 1];
            let mdp = TabularMdp::new(actions, rows, successors, probabilities, costs, 0.5).unwrap();
            let fixed: Vec<bool> = (0..n).map(|state| state == left_out).collect();
            let components = Components::new(&mdp, &fixed);
            // Transitive closure by Floyd and Warshall.
            let mut reach = vec![vec![false; n]; n];
            for s in (0..n).filter(|&s| !fixed[s]) {
                reach[s][s] = true;
                graph[s].iter().filter(|&&t| !fixed[t as usize]).for_each(|&t| reach[s][t as usize] = true);
            }
            for k in 0..n {
                for i in 0..n {
                    for j in 0..n {
                        reach[i][j] |= reach[i][k] && reach[k][j];
                    }
                }
            }
            let mut label = vec![usize::MAX; n];
            for c in 0..components.count() {
                prop_assert!(components.of(c).windows(2).all(|pair| pair[0] < pair[1]));
                components.of(c).iter().for_each(|&s| label[s as usize] = c);
            }
            for s in 0..n {
                prop_assert_eq!(label[s] == usize::MAX, fixed[s]);
                for t in (0..n).filter(|&t| !fixed[s] && !fixed[t]) {
                    prop_assert_eq!(label[s] == label[t], reach[s][t] && reach[t][s]);
                    prop_assert!(!reach[s][t] || label[t] <= label[s], "successors come first");
                }
            }
        }
    }
}
