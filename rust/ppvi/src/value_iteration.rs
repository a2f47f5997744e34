//! Plain value iteration: the reference for all other solvers.
//!
//! V(k+1) = T V(k) for all states at once (Jacobi). The sweep that computes T V(k) also yields the exact residual of
//! V(k). The solver returns V(k), because its residual is known.

use crate::bellman::{bellman_operator, initial_values};
use crate::error::Result;
use crate::mdp::Mdp;
use crate::solution::{Solution, solution};
use crate::termination::{Certificate, LimitMonitor, Observer, Progress, StopRule};

/// Solves a problem by sweeps over all states on the current rayon pool. The values are the same, bit for bit, for any
/// number of threads.
///
/// # Errors
/// [`Error::Parameter`](crate::Error::Parameter) for an invalid rule. Reaching a limit is a status, not an error.
///
/// # Examples
/// ```
/// use std::ops::ControlFlow;
///
/// use ppvi::{Status, StopRule, TabularMdp, value_iteration};
///
/// // Every step costs 2, and the execution never ends: the value is 2 / (1 - 0.5).
/// let mdp = TabularMdp::new(vec![0, 1], vec![0, 1], vec![0], vec![1.0], vec![2.0], 0.5)?;
/// let solution = value_iteration(&mdp, StopRule::new(1e-9)?, None)?;
/// assert!((solution.values[0] - 4.0).abs() <= 1e-9);
///
/// let mut stop = |_: &ppvi::Progress| ControlFlow::Break(());
/// let solution = value_iteration(&mdp, StopRule::new(1e-9)?, Some(&mut stop))?;
/// assert_eq!(solution.report.status, Status::Interrupted);
/// # Ok::<(), ppvi::Error>(())
/// ```
pub fn value_iteration(mdp: &impl Mdp, rule: StopRule, observer: Option<Observer>) -> Result<Solution> {
    let mut monitor = LimitMonitor::start(rule, Certificate::of(mdp), observer)?;
    let mut values = initial_values(mdp);
    let mut next = values.clone();
    let mut policy = vec![0; mdp.states()];
    let mut sweeps = 0;
    loop {
        let check = bellman_operator(mdp, &values, &mut next, &mut policy);
        sweeps += 1;
        let ended = monitor.conclude(check, None).or_else(|| {
            let threshold = monitor.threshold(check.max_value);
            monitor.check(&Progress { sweeps: sweeps as f64, residual: check.residual, threshold })
        });
        if let Some(status) = ended {
            let mut solution = solution(values, policy, status, check, &monitor);
            solution.report.backups = sweeps * mdp.states() as u64;
            solution.report.partitions_processed = sweeps;
            solution.report.order = vec![0];
            return Ok(solution);
        }
        std::mem::swap(&mut values, &mut next);
    }
}
