//! Which partition next: the flow metrics of the thesis and a bound that need not look at a state.
//!
//! # The metrics of the thesis (section 6.3)
//!
//! * H1(s) = |B(s)| with B(s) = (TV)(s) - V(s). Equation (6.7) prints a maximum over the actions; for a problem of costs
//!   it has to be the minimum, as in the value iteration (6.3) whose residual it is, and the minimum is used here.
//! * H2(s) = B(s) + V(s) if V(s) > 0, else 0 (6.8): the new value itself. It does not tend to zero, so it can rank but
//!   not stop.
//! * HPP(p', p) = max of H over the states of p' that depend on p (6.9), HP(p') = max over p of HPP(p', p) (6.10).
//!
//! HPP(p', p) is computed when p has been processed, from the states SDP(p) in p', and kept until p' is processed.
//! *With H1, HP(p') then bounds the residual of p':* the residual of a state changes only when a partition it reads is
//! processed; at that moment the state is looked at and the result enters some HPP(p', p); what its own partition left
//! behind enters HPP(p', p') (below). So besides its rank every HPP carries max |B|, and a partition is *eligible* when
//! the maximum of those reaches a level, in the end the threshold. When none is eligible, the residual of the problem is below the threshold.
//!
//! # The accumulated-change bound
//!
//! Recomputing H costs backups. The bound replaces them by additions. Let c(p) be the largest change, over the states of
//! p, that one processing of p has made, and let A(p', p) be the sum of the c(p) since p' was last processed. Then
//!
//! ```text
//! max over s in p' of |B(s)|  <=  L(p') + discount * max over p of A(p', p),
//! ```
//!
//! L(p') being the residual that p' had when its own processing ended. *Proof.* Let V0 be the values at that moment and
//! V those now; on p' they agree. For s in p', |B(s)| <= |(TV0)(s) - V0(s)| + |(TV)(s) - (TV0)(s)|. The first term is at
//! most L(p'). T is a minimum over actions, and minima of pairwise close numbers are close, so the second term is at most
//! the largest, over actions, of discount * sum of p(s' | s, a) |V(s') - V0(s')|. For s' in p each |V(s') - V0(s')| is a
//! sum of changes, at most A(p', p), and it is 0 on p'. The probabilities sum to at most one; hence the maximum over p,
//! not a sum over neighbours. []
//!
//! *L(p') for free.* If the last inner sweep changed no state by more than d, then L(p') <= discount * d: a state was set
//! to the backup of values of which none was changed by more than d after it had been read, for a sweep changes each
//! state once.
//!
//! # Why waves are bitwise deterministic
//!
//! A sweep in place over blocks 1, 2, ... is a sequence of tasks. Give every task the level 1 + the largest level of the
//! earlier tasks that read a state it writes or write a state it reads or writes. Tasks of a level then commute exactly:
//! none sees what another one writes. So running level after level, the tasks of one level in parallel in any order,
//! performs on every state the same floating-point operations with the same operands as the sequence itself, for any
//! number of threads. (This is what [`crate::tabular_sweep()`] does.)

use crate::dependency::Dependencies;
use crate::error::Error;

/// How partitions are ranked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Priority {
    /// By the largest Bellman residual.
    H1,
    /// By the largest new value among the states that are not settled.
    #[default]
    H2,
    /// By the accumulated-change bound, which costs no backups.
    Bound,
}

impl Priority {
    /// The name used in files and in Python.
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

/// H1 of a state with value `value` and backup `backup` (6.7).
pub fn h1(backup: f64, value: f64) -> f64 {
    crate::bellman::change(backup, value)
}

/// H2 of a state with value `value` and backup `backup` (6.8).
pub fn h2(backup: f64, value: f64) -> f64 {
    if value > 0.0 { (backup - value) + value } else { 0.0 }
}

/// A rank and the residual it stands for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PriorityEntry {
    /// What the queue sorts by.
    pub rank: f64,
    /// Upper bound on |B| of the states meant.
    pub residual: f64,
}

impl PriorityEntry {
    /// The larger rank and the larger residual.
    pub fn join(self, other: PriorityEntry) -> PriorityEntry {
        PriorityEntry { rank: self.rank.max(other.rank), residual: self.residual.max(other.residual) }
    }
}

/// The table HPP: one claim for every pair of `dependencies`, and what every partition claims by itself.
#[derive(Debug, Clone)]
pub struct PriorityTable<'a> {
    dependencies: &'a Dependencies,
    pairs: Vec<PriorityEntry>,
    own: Vec<PriorityEntry>,
}

impl<'a> PriorityTable<'a> {
    /// `own` holds the initial claims, HP0 of the thesis; all HPP are zero.
    pub fn new(dependencies: &'a Dependencies, own: Vec<PriorityEntry>) -> Self {
        PriorityTable { dependencies, pairs: vec![PriorityEntry::default(); dependencies.pair_count()], own }
    }

    /// The pairs that the table is about.
    pub fn dependencies(&self) -> &'a Dependencies {
        self.dependencies
    }

    /// HPP of a pair (p, p'), by the number that [`Dependencies`] gives it.
    pub fn pair_mut(&mut self, pair: usize) -> &mut PriorityEntry {
        &mut self.pairs[pair]
    }

    /// Forgets what others claim for `partition`, which has just been processed and left `own`.
    pub fn reset(&mut self, partition: usize, own: PriorityEntry) {
        self.own[partition] = own;
        for &pair in self.dependencies.incoming(partition) {
            self.pairs[pair as usize] = PriorityEntry::default();
        }
    }

    /// HP of a partition that keeps exact claims (H1, H2): the maximum.
    pub fn largest(&self, partition: usize) -> PriorityEntry {
        let incoming = self.dependencies.incoming(partition).iter().map(|&pair| self.pairs[pair as usize]);
        incoming.fold(self.own[partition], PriorityEntry::join)
    }

    /// HP of a partition that keeps accumulated changes: L + discount * max A; the pairs hold discount * A.
    pub fn bound(&self, partition: usize) -> PriorityEntry {
        let incoming = self.dependencies.incoming(partition).iter().map(|&pair| self.pairs[pair as usize].residual);
        let bound = self.own[partition].residual + incoming.fold(0.0, f64::max);
        PriorityEntry { rank: bound, residual: bound }
    }
}
