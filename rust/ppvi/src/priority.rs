//! Priorities of partitions: the metrics of the thesis, and an upper bound on the residual that needs no backups.
//!
//! # The metrics of the thesis (section 6.3)
//!
//! * H1(s) = |B(s)| with B(s) = (TV)(s) - V(s). Equation (6.7) prints a maximum over the actions. For costs it must be
//!   the minimum, as in the value iteration (6.3), and the minimum is used here.
//! * H2(s) = B(s) + V(s) if V(s) > 0, else 0 (6.8): the new value itself. It does not tend to zero, so it ranks
//!   partitions but cannot decide when to stop.
//! * HPP(p', p) = max of H over the states of p' that depend on p (6.9), HP(p') = max over p of HPP(p', p) (6.10).
//!
//! HPP(p', p) is computed after each processing of p, from the states of p' in SDP(p), and kept until p' is processed.
//!
//! *With H1, HP(p') is an upper bound on the residual of p'.* The residual of a state in p' changes only when a
//! partition that it reads is processed. The solver then computes the residual, which enters HPP(p', p). The residual
//! that the processing of p' itself leaves enters HPP(p', p') (below). Every HPP therefore holds max |B| besides its
//! rank. A partition is *eligible* if the maximum of these residuals reaches a level, which falls to the threshold. If
//! no partition is eligible at the threshold, the residual of the problem is below the threshold.
//!
//! # The accumulated-change bound
//!
//! Computing H takes backups; this bound takes additions only. Let c(p) be the largest change that one processing of p
//! makes to a state of p, and let A(p', p) be the sum of the c(p) since p' was last processed. Then
//!
//! ```text
//! max over s in p' of |B(s)|  <=  L(p') + discount * max over p of A(p', p),
//! ```
//!
//! where L(p') is the residual of p' at the end of its own processing.
//!
//! *Proof.* Let V0 be the values at the end of that processing, and V the present values. They agree on p'. For s in
//! p',
//! |B(s)| <= |(TV0)(s) - V0(s)| + |(TV)(s) - (TV0)(s)|. The first term is at most L(p'). T is a minimum over actions, and
//! two minima differ by at most the largest difference of their arguments. So the second term is at most the maximum
//! over actions of discount * sum of p(s' | s, a) |V(s') - V0(s')|. For s' in p, |V(s') - V0(s')| is at most A(p', p),
//! and it is 0 for s' in p'. The probabilities sum to at most one, hence the maximum over p and not a sum. []
//!
//! *L(p') needs no backups.* If the last inner sweep changed no state by more than d, then L(p') <= discount * d. A
//! sweep changes each state once, so no value that a backup read was changed by more than d afterwards.
//!
//! # Why waves are bitwise deterministic
//!
//! An in-place sweep over blocks 1, 2, ... is a sequence of tasks. Two tasks are in conflict if one writes a state that
//! the other reads or writes. Give every task a level: 1 + the largest level of the earlier tasks with which it is in
//! conflict. No task then reads or writes a state that another task of its level writes. So the tasks of one level may
//! run in parallel and in any order. Level after level, every state undergoes the same floating-point operations with
//! the same operands as in the sequence, for any number of threads. [`crate::tabular_sweep()`] works in this way.

use crate::bellman::larger;
use crate::dependency::Dependencies;
use crate::error::Error;

/// How partitions are ranked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Priority {
    /// By the largest Bellman residual.
    H1,
    /// By the largest new value among the states that depend on a processed partition.
    #[default]
    H2,
    /// By the accumulated-change bound, which needs no backups.
    Bound,
}

impl Priority {
    /// The name in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Priority::H1 => "H1",
            Priority::H2 => "H2",
            Priority::Bound => "bound",
        }
    }
}

impl std::str::FromStr for Priority {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        match name {
            "H1" => Ok(Priority::H1),
            "H2" => Ok(Priority::H2),
            "bound" => Ok(Priority::Bound),
            _ => Err(Error::parameter("priority", format!("{name:?}"), "must be \"H1\", \"H2\" or \"bound\"")),
        }
    }
}

/// The metric H1 (6.7) of a state.
pub fn h1(backup: f64, value: f64) -> f64 {
    crate::bellman::change(backup, value)
}

/// The metric H2 (6.8) of a state.
pub fn h2(backup: f64, value: f64) -> f64 {
    if value > 0.0 { (backup - value) + value } else { 0.0 }
}

/// The priority of some states: a rank, and an upper bound on their residual.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PriorityEntry {
    /// The key in the queue.
    pub rank: f64,
    /// Upper bound on |B| of the states.
    pub residual: f64,
}

impl PriorityEntry {
    /// Returns the larger rank and the larger residual of two entries.
    pub fn join(self, other: PriorityEntry) -> PriorityEntry {
        PriorityEntry { rank: larger(self.rank, other.rank), residual: larger(self.residual, other.residual) }
    }
}

/// The table HPP: a priority entry for every pair of dependent partitions, and one of its own for every partition.
#[derive(Debug, Clone)]
pub struct PriorityTable<'a> {
    dependencies: &'a Dependencies,
    pairs: Vec<PriorityEntry>,
    own: Vec<PriorityEntry>,
}

impl<'a> PriorityTable<'a> {
    /// Makes a table with the entries `own` of the partitions (HP0 of the thesis). All HPP are zero.
    pub fn new(dependencies: &'a Dependencies, own: Vec<PriorityEntry>) -> Self {
        PriorityTable { dependencies, pairs: vec![PriorityEntry::default(); dependencies.pair_count()], own }
    }

    /// The pairs that the table has entries for.
    pub fn dependencies(&self) -> &'a Dependencies {
        self.dependencies
    }

    /// The entry HPP of a pair (p, p'), by its number in [`Dependencies`].
    pub fn pair_mut(&mut self, pair: usize) -> &mut PriorityEntry {
        &mut self.pairs[pair]
    }

    /// Resets the entries of `partition` after its processing: all its HPP become zero, and its own entry becomes
    /// `own`.
    pub fn reset(&mut self, partition: usize, own: PriorityEntry) {
        self.own[partition] = own;
        for &pair in self.dependencies.incoming(partition) {
            self.pairs[pair as usize] = PriorityEntry::default();
        }
    }

    /// HP of a partition with exact entries (H1, H2): the maximum over its entries.
    pub fn largest(&self, partition: usize) -> PriorityEntry {
        let incoming = self.dependencies.incoming(partition).iter().map(|&pair| self.pairs[pair as usize]);
        incoming.fold(self.own[partition], PriorityEntry::join)
    }

    /// HP of a partition with accumulated changes: L + discount * max A. The entries of the pairs hold discount * A.
    pub fn bound(&self, partition: usize) -> PriorityEntry {
        let incoming = self.dependencies.incoming(partition).iter().map(|&pair| self.pairs[pair as usize].residual);
        let bound = self.own[partition].residual + incoming.fold(0.0, larger);
        PriorityEntry { rank: bound, residual: bound }
    }
}
