//! What every solver returns.

use crate::termination::Status;

/// Counts and proofs that come with a solution.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// How the solve ended.
    pub status: Status,
    /// max |TV - V| of the values returned: computed exactly, by `lattice::sweep` a bound on it (never the last change).
    pub residual: f64,
    /// Proven bound on max |V - V*|; infinite where the problem gives none.
    pub error_bound: f64,
    /// Bellman backups of single states, those of the residual checks and priorities included.
    pub backups: u64,
    /// Number of partitions.
    pub partitions: usize,
    /// How many times a partition was processed.
    pub partitions_processed: u64,
    /// Partitions in the order in which they were first processed.
    pub order: Vec<u32>,
    /// Seconds spent on backups of partitions.
    pub seconds_solving: f64,
    /// Seconds spent on priorities.
    pub seconds_priorities: f64,
}

/// Values, greedy policy, report.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Cost-to-go, `[states]`; infinite where the execution cannot be made to end (discount 1).
    pub values: Vec<f64>,
    /// Greedy action with respect to `values`, `[states]`; 0 for an absorbing state.
    pub policy: Vec<u32>,
    /// Counts and proofs.
    pub report: Report,
}
