//! Who depends on whom: the maps of Table 6.1 of the thesis.
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
//! A dependent is therefore a *predecessor*: its value rests on the state or partition named. A partition whose states
//! reach each other depends on itself. Absorbing states depend on nothing.
//!
//! Memory: [`Dependencies`] is what a prioritized solver needs, SDP(p) cut into pieces by PDP(p). It stores 4 bytes for
//! every (state, partition it reads): at most 3 of them for a state of the needle lattice with the partitions of the
//! thesis, about 10 MB for a million states. [`StateDependents`], the full reverse graph, takes 4 bytes for every
//! (state, successor), some 40 MB there, and is built only by those who ask for it.

use std::ops::Range;

use crate::mdp::Mdp;
use crate::partition::{Partition, group};

/// SDP and PDP. A *pair* (p, p') stands for "p' depends on p"; pairs are numbered by p, then p'.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dependencies {
    /// Pairs of p: `offsets[p]..offsets[p + 1]`.
    offsets: Vec<usize>,
    /// p' of every pair: PDP(p) is the slice of p.
    dependents: Vec<u32>,
    /// States of every pair: `state_offsets[pair]..state_offsets[pair + 1]`.
    state_offsets: Vec<usize>,
    states: Vec<u32>,
    /// Pairs with a given p', by rising p: the transpose of `offsets` and `dependents`.
    incoming_offsets: Vec<usize>,
    incoming: Vec<u32>,
}

impl Dependencies {
    /// Reads every row of the problem once.
    pub fn new(mdp: &impl Mdp, partition: &Partition) -> Self {
        let labels = partition.labels();
        let (mut sources, mut readers) = (Vec::new(), Vec::new());
        let mut last_reader = vec![u32::MAX; partition.count()];
        for state in (0..partition.count()).flat_map(|p| partition.members(p)) {
            each_successor(mdp, *state as usize, |next| {
                let source = labels[next];
                if std::mem::replace(&mut last_reader[source as usize], *state) != *state {
                    sources.push(source);
                    readers.push(*state);
                }
            });
        }
        // The readers come ordered by their partition, so within a source they fall into one run for each dependent.
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

    /// Numbers of the pairs (p, p'), p' running through PDP(p).
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

    /// The states of p' that depend on p, for the pair (p, p'): SDP(p) cut with p', ascending.
    pub fn states(&self, pair: usize) -> &[u32] {
        &self.states[self.state_offsets[pair]..self.state_offsets[pair + 1]]
    }

    /// Numbers of the pairs (p, p') with the given p': what p' depends on.
    pub fn incoming(&self, dependent: usize) -> &[u32] {
        &self.incoming[self.incoming_offsets[dependent]..self.incoming_offsets[dependent + 1]]
    }
}

/// SDS: the predecessors of every state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateDependents {
    offsets: Vec<usize>,
    states: Vec<u32>,
}

impl StateDependents {
    /// Reads every row of the problem twice.
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

/// Calls `visit` for the successors, of all actions, that have a positive probability.
fn each_successor(mdp: &impl Mdp, state: usize, mut visit: impl FnMut(usize)) {
    for action in 0..mdp.actions(state) {
        mdp.for_each_successor(state, action, |next, probability| {
            if probability > 0.0 {
                visit(next);
            }
        });
    }
}

/// Calls `visit(state, successor)` once for every edge: repeated successors of a state count once.
fn each_edge(mdp: &impl Mdp, mut visit: impl FnMut(usize, usize)) {
    let mut seen: Vec<usize> = Vec::new();
    for state in 0..mdp.states() {
        seen.clear();
        each_successor(mdp, state, |next| seen.push(next));
        seen.sort_unstable();
        seen.dedup();
        seen.iter().for_each(|&next| visit(state, next));
    }
}
