//! The result of a solver.

use crate::bellman::Check;
use crate::termination::{LimitMonitor, Status};

/// Status, proven bounds and counts of a solve.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// How the solve ended.
    pub status: Status,
    /// max |TV - V| of the returned values as they are stored ([`Storage`](crate::Storage)): computed exactly but for
    /// rounding, except that `lattice::sweep` gives an upper bound.
    pub residual: f64,
    /// Proven upper bound on max |V - V*| of the returned values as they are stored, rounding included; infinite if
    /// nothing is proven.
    pub error_bound: f64,
    /// Number of Bellman backups of single states, including those for residual checks and priorities.
    pub backups: u64,
    /// Number of partitions.
    pub partitions: usize,
    /// Number of times that a partition was processed.
    pub partitions_processed: u64,
    /// Partitions in the order in which they were first processed.
    pub order: Vec<u32>,
    /// Seconds spent on backups of partitions.
    pub seconds_solving: f64,
    /// Seconds spent on priorities.
    pub seconds_priorities: f64,
}

/// Values, greedy policy and report.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Cost-to-go, `[states]`; infinite for improper states (discount 1).
    pub values: Vec<f64>,
    /// Greedy action with respect to `values`, `[states]`; 0 for an absorbing state.
    pub policy: Vec<u32>,
    /// Status, bounds and counts.
    pub report: Report,
}

/// Assembles a solution of values with this check. All its counts are zero.
pub(crate) fn solution(
    values: Vec<f64>,
    policy: Vec<u32>,
    status: Status,
    check: Check,
    monitor: &LimitMonitor,
) -> Solution {
    let (residual, error_bound) = monitor.bounds(check);
    let report = Report {
        status,
        residual,
        error_bound,
        backups: 0,
        partitions: 1,
        partitions_processed: 0,
        order: Vec::new(),
        seconds_solving: monitor.seconds(),
        seconds_priorities: 0.0,
    };
    Solution { values, policy, report }
}
