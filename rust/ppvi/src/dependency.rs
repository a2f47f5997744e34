//! Dependencies between states and partitions: the maps of Table 6.1 of the thesis.
//!
//! With T(s', u, s) the probability of reaching s from s' by action u,
//!
//! ```text
//! SDS(s) = { s' : some u has T(s', u, s) != 0 }                               state dependents of a state
//! SDP(p) = union over s in p of SDS(s)                                        state dependents of a partition
//! PDS(s) = { p' : some u and s' in p' have T(s', u, s) != 0 }                 partition dependents of a state
//! PDP(p) = { p' : some u, s in p', s' in p have T(s, u, s') != 0 }            partition dependents of a partition
//! ```
//!
//! A dependent is a *predecessor*: its backup reads the value of the state or partition on which it depends. A
//! partition depends on itself if some state in it has a successor in it. Absorbing states depend on nothing.
//!
//! | structure | contents | bytes | on a needle lattice of 10^6 states |
//! |---|---|---|---|
//! | [`Dependencies`] | SDP(p), grouped by the partitions of PDP(p) | 4 for each pair of a state and a partition that it reads | 10 MB |
//! | [`StateDependents`] | SDS(s): the reverse graph | 4 for each pair of a state and a successor | 40 MB |
//!
//! The prioritized solver needs [`Dependencies`] only.

use std::ops::Range;

use crate::mdp::Mdp;
use crate::partition::{Partition, group};
use crate::stop::StopFlag;

/// The maps SDP and PDP. A *pair* (p, p') means that p' depends on p. Pairs are numbered by p, then by p'.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dependencies {
    /// Pairs of p: `offsets[p]..offsets[p + 1]`.
    offsets: Vec<usize>,
    /// p' of every pair. The pairs of p are PDP(p).
    dependents: Vec<u32>,
    /// States of every pair: `state_offsets[pair]..state_offsets[pair + 1]`.
    state_offsets: Vec<usize>,
    states: Vec<u32>,
    /// For every p', the numbers of the pairs (p, p'), by rising p: the transpose of `offsets` and `dependents`.
    incoming_offsets: Vec<usize>,
    incoming: Vec<u32>,
}

impl Dependencies {
    /// Builds the maps. Reads every row of the problem once.
    ///
    /// # Panics
    /// If `partition` does not have as many states as `mdp`.
    pub fn new(mdp: &impl Mdp, partition: &Partition) -> Self {
        let labels = partition.labels();
        let (mut sources, mut readers) = (Vec::new(), Vec::new());
        let mut last_reader = vec![u32::MAX; partition.count()];
        let stop = StopFlag::current();
        for state in (0..partition.count()).flat_map(|p| partition.members(p)) {
            stop.check();
            each_successor(mdp, *state as usize, |next| {
                let source = labels[next];
                if std::mem::replace(&mut last_reader[source as usize], *state) != *state {
                    sources.push(source);
                    readers.push(*state);
                }
            });
        }
        // The readers are in the order of their partitions. So the readers of one source form one run for each
        // dependent.
        let (read_offsets, states) = group(&sources, readers.iter().copied(), partition.count());
        let (mut offsets, mut dependents, mut state_offsets) = (vec![0], Vec::new(), Vec::new());
        for bounds in read_offsets.windows(2) {
            for at in bounds[0]..bounds[1] {
                let label = labels[states[at] as usize];
                if at == bounds[0] || labels[states[at - 1] as usize] != label {
                    dependents.push(label);
                    state_offsets.push(at);
                }
            }
            offsets.push(dependents.len());
        }
        state_offsets.push(states.len());
        let (incoming_offsets, incoming) = group(&dependents, 0..dependents.len() as u32, partition.count());
        Dependencies { offsets, dependents, state_offsets, states, incoming_offsets, incoming }
    }

    /// PDP(p), ascending.
    pub fn pdp(&self, partition: usize) -> &[u32] {
        &self.dependents[self.pairs(partition)]
    }

    /// SDP(p), grouped by partition, ascending within each.
    pub fn sdp(&self, partition: usize) -> &[u32] {
        let pairs = self.pairs(partition);
        &self.states[self.state_offsets[pairs.start]..self.state_offsets[pairs.end]]
    }

    /// Numbers of the pairs (p, p') for all p' in PDP(p).
    pub fn pairs(&self, partition: usize) -> Range<usize> {
        self.offsets[partition]..self.offsets[partition + 1]
    }

    /// Number of all pairs.
    pub fn pair_count(&self) -> usize {
        self.dependents.len()
    }

    /// p' of the pair (p, p').
    pub fn dependent(&self, pair: usize) -> usize {
        self.dependents[pair] as usize
    }

    /// The states of p' that depend on p, for the pair (p, p'): the intersection of SDP(p) and p', ascending.
    pub fn states(&self, pair: usize) -> &[u32] {
        &self.states[self.state_offsets[pair]..self.state_offsets[pair + 1]]
    }

    /// Numbers of the pairs (p, p') with the given p': the partitions on which p' depends.
    pub fn incoming(&self, dependent: usize) -> &[u32] {
        &self.incoming[self.incoming_offsets[dependent]..self.incoming_offsets[dependent + 1]]
    }
}

/// The map SDS: the predecessors of every state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateDependents {
    offsets: Vec<usize>,
    states: Vec<u32>,
}

impl StateDependents {
    /// Builds the map. Reads every row of the problem twice.
    pub fn new(mdp: &impl Mdp) -> Self {
        let mut offsets = vec![0usize; mdp.states() + 1];
        each_edge(mdp, |_, next| offsets[next + 1] += 1);
        for state in 0..mdp.states() {
            offsets[state + 1] += offsets[state];
        }
        let mut ends = offsets.clone();
        let mut states = vec![0; offsets[mdp.states()]];
        each_edge(mdp, |state, next| {
            states[ends[next]] = state as u32;
            ends[next] += 1;
        });
        StateDependents { offsets, states }
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.offsets.len() - 1
    }

    /// SDS(s), ascending.
    pub fn sds(&self, state: usize) -> &[u32] {
        &self.states[self.offsets[state]..self.offsets[state + 1]]
    }

    /// PDS(s), ascending.
    pub fn pds(&self, state: usize, partition: &Partition) -> Vec<u32> {
        let mut found: Vec<u32> = self.sds(state).iter().map(|&s| partition.labels()[s as usize]).collect();
        found.sort_unstable();
        found.dedup();
        found
    }
}

/// Calls `visit` for every successor of positive probability, action after action.
fn each_successor(mdp: &impl Mdp, state: usize, mut visit: impl FnMut(usize)) {
    for action in 0..mdp.actions(state) {
        mdp.for_each_successor(state, action, |next, probability| {
            if probability > 0.0 {
                visit(next);
            }
        });
    }
}

/// Calls `visit(state, successor)` once for every pair, even if several entries of the rows have this successor.
fn each_edge(mdp: &impl Mdp, mut visit: impl FnMut(usize, usize)) {
    let mut seen: Vec<usize> = Vec::new();
    let stop = StopFlag::current();
    for state in 0..mdp.states() {
        stop.check();
        seen.clear();
        each_successor(mdp, state, |next| seen.push(next));
        seen.sort_unstable();
        seen.dedup();
        seen.iter().for_each(|&next| visit(state, next));
    }
}
