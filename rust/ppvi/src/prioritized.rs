//! Prioritized-partitioned value iteration (section 6.3 of the thesis; Wingate and Seppi 2005).
//!
//! ```text
//! repeat  p = the partition of highest priority
//!         value iteration over the states of p alone, until it has converged
//!         for p' in PDP(p): update the priority of p', looking only at the states SDP(p) in p'
//! until   the Bellman residual of the problem is below the threshold
//! ```
//!
//! The pseudocode leaves four choices open:
//!
//! * *Inner loop.* Sweeps are in place, alternately forwards and backwards. With discount < 1 the loop ends when the
//!   span of the change, max - min, is below the inner tolerance, as printed. With discount 1 a constant shift does not
//!   decay, so the loop ends when the largest change is below the inner tolerance. The residual that remains stays in
//!   the priority entry of the partition, so a coarse inner tolerance costs no accuracy.
//! * *Start.* HP0(p) is the largest backup of V0 = 0 in p. The thesis begins with the partition of the smallest HP0 and
//!   continues with the largest. Read literally, the first one would be a partition of obstacles only, with HP0 = 0 and
//!   no work to do. Here the first one is the smallest among the eligible partitions.
//! * *Levels.* With the rank H2 alone, partitions of high value would converge to the last digit before the others are
//!   processed at all, which costs ten times as much on the problem of the thesis. Therefore a partition is eligible
//!   only if its residual reaches a *level*. When no partition is eligible, the level is halved, down to the threshold.
//! * *End.* Only partitions whose residual may reach the threshold are queued ([`crate::priority`]). When the queue is
//!   empty, the exact residual of all states is computed. With discount 1 the threshold falls as the values grow, so
//!   this check may queue partitions again. Partitions of absorbing states are never processed.

use std::time::Instant;

use crate::active::{ActiveStates, back_up_in_place};
use crate::bellman::{change, greedy, initial_values, larger};
use crate::dependency::Dependencies;
use crate::error::{Error, Result};
use crate::mdp::Mdp;
use crate::partition::Partition;
use crate::priority::{Priority, PriorityEntry, PriorityTable, h1, h2};
use crate::queue::IndexedMaxQueue;
use crate::solution::{Solution, solution};
use crate::stop::StopFlag;
use crate::termination::{Certificate, LimitMonitor, Observer, Progress, Status, StopRule};

/// Options of the prioritized solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrioritizedOptions {
    /// The metric that ranks partitions.
    pub priority: Priority,
    /// Change of the values, in units of cost, below which the inner loop ends. `None` stands for the tolerance of the
    /// stop rule, as in the thesis.
    pub inner_tolerance: Option<f64>,
    /// Largest number of inner sweeps of one processing. Unlimited in the thesis and by default; 2 is often fastest.
    pub inner_sweeps: u64,
}

impl Default for PrioritizedOptions {
    fn default() -> Self {
        PrioritizedOptions { priority: Priority::default(), inner_tolerance: None, inner_sweeps: u64::MAX }
    }
}

impl PrioritizedOptions {
    /// Checks the fields.
    ///
    /// # Errors
    /// [`Error::Parameter`] for an inner tolerance that is not positive and finite, or for zero inner sweeps.
    pub fn validate(&self) -> Result<()> {
        if let Some(tolerance) = self.inner_tolerance
            && !(tolerance > 0.0 && tolerance.is_finite())
        {
            return Err(Error::parameter("inner_tolerance", tolerance, "must be positive and finite"));
        }
        if self.inner_sweeps == 0 {
            return Err(Error::parameter("inner_sweeps", self.inner_sweeps, "must be at least 1"));
        }
        Ok(())
    }
}

/// Solves a problem partition by partition on one thread. The final check uses the current rayon pool.
///
/// # Errors
/// [`Error::Parameter`] for an invalid rule or option, [`Error::Length`] if `partition` does not have as many states as
/// `mdp`. Reaching a limit is a status, not an error.
///
/// # Examples
/// ```
/// use ppvi::{Partition, PrioritizedOptions, StopRule, TabularMdp, prioritized};
///
/// // Three steps of cost 1 lead from state 0 to the absorbing state 3.
/// let mdp = TabularMdp::new(vec![0, 1, 2, 3, 3], vec![0, 1, 2, 3], vec![1, 2, 3], vec![1.0; 3], vec![1.0; 3], 1.0)?;
/// let partition = Partition::from_labels(vec![0, 0, 1, 1], 2)?;
/// let solution = prioritized(&mdp, &partition, PrioritizedOptions::default(), StopRule::new(1e-6)?, None)?;
/// assert_eq!(solution.values, [3.0, 2.0, 1.0, 0.0]);
/// # Ok::<(), ppvi::Error>(())
/// ```
pub fn prioritized(
    mdp: &impl Mdp,
    partition: &Partition,
    options: PrioritizedOptions,
    rule: StopRule,
    observer: Option<Observer>,
) -> Result<Solution> {
    options.validate()?;
    partition.check_states(mdp.states())?;
    let mut monitor = LimitMonitor::start(rule, Certificate::of(mdp), observer)?;
    let mut run = Run::new(mdp, partition, options, rule.tolerance, &monitor);
    let dependencies = Dependencies::new(mdp, partition);
    let mut policy = vec![0; mdp.states()];
    run.seconds_priorities = monitor.seconds();
    let (status, check) = loop {
        let before = run.processed;
        let stopped = run.process_all(&dependencies, &mut monitor);
        let check = greedy(mdp, &run.values, &mut policy);
        run.backups += mdp.states() as u64;
        if let Some(status) = monitor.conclude(check, stopped) {
            break (status, check);
        }
        let threshold = run.threshold;
        // Values may have been larger on the way.
        run.max_value = 0.0;
        run.adapt_threshold(check.max_value, &monitor);
        if run.processed == before && run.threshold == threshold {
            break (Status::PrecisionLimit, check);
        }
    };
    let mut solution = solution(run.values, policy, status, check, &monitor);
    solution.report.backups = run.backups;
    solution.report.partitions = partition.count();
    solution.report.partitions_processed = run.processed;
    solution.report.order = run.order;
    solution.report.seconds_priorities = run.seconds_priorities;
    solution.report.seconds_solving = monitor.seconds() - run.seconds_priorities;
    Ok(solution)
}

struct Run<'m, M> {
    mdp: &'m M,
    options: PrioritizedOptions,
    tolerance: f64,
    threshold: f64,
    /// Residual from which on a partition is eligible.
    level: f64,
    max_value: f64,
    values: Vec<f64>,
    active: ActiveStates,
    stop: StopFlag,
    /// Values of the partition before its current processing.
    before: Vec<f64>,
    seen: Vec<bool>,
    order: Vec<u32>,
    processed: u64,
    backups: u64,
    seconds_priorities: f64,
}

/// Result of one processing of a partition.
struct Processed {
    /// Largest change of a state.
    change: f64,
    /// Upper bound on the residual of the partition afterwards.
    left: f64,
    stopped: Option<Status>,
}

impl<'m, M: Mdp> Run<'m, M> {
    fn new(
        mdp: &'m M,
        partition: &Partition,
        options: PrioritizedOptions,
        tolerance: f64,
        monitor: &LimitMonitor,
    ) -> Self {
        let values = initial_values(mdp);
        let active = ActiveStates::new(mdp, partition, &values);
        Run {
            mdp,
            options,
            tolerance,
            threshold: monitor.threshold(0.0),
            level: f64::INFINITY,
            max_value: 0.0,
            values,
            active,
            stop: StopFlag::current(),
            before: Vec::new(),
            seen: vec![false; partition.count()],
            order: Vec::new(),
            processed: 0,
            backups: 0,
            seconds_priorities: 0.0,
        }
    }

    /// Adapts the threshold to values up to `max_value`.
    fn adapt_threshold(&mut self, max_value: f64, monitor: &LimitMonitor) {
        self.max_value = larger(self.max_value, max_value);
        self.threshold = monitor.threshold(self.max_value);
    }

    /// Processes partitions, level after level, until no residual reaches the threshold or a limit is reached.
    fn process_all(&mut self, dependencies: &Dependencies, monitor: &mut LimitMonitor) -> Option<Status> {
        let clock = Instant::now();
        let own: Vec<PriorityEntry> = (0..self.seen.len()).map(|p| self.entry_of_partition(p)).collect();
        // The final check of all states takes no longer than this.
        monitor.needs_to_end(0, clock.elapsed());
        let mut table = PriorityTable::new(dependencies, own);
        let mut queue = IndexedMaxQueue::new(self.seen.len());
        self.seconds_priorities += clock.elapsed().as_secs_f64();
        self.level = f64::INFINITY;
        while self.lower_level(&table, &mut queue) {
            let stopped = self.process_level(&mut table, &mut queue, monitor);
            if stopped.is_some() {
                return stopped;
            }
        }
        None
    }

    /// Halves the level and queues the eligible partitions. Returns false if no residual reaches the threshold.
    fn lower_level(&mut self, table: &PriorityTable, queue: &mut IndexedMaxQueue) -> bool {
        let largest = (0..self.seen.len()).map(|p| self.entry(p, table).residual).fold(0.0, larger);
        self.level = (largest / 2.0).max(self.threshold);
        for p in 0..self.seen.len() {
            self.requeue(p, table, queue);
        }
        if let (true, Some(start)) = (self.processed == 0, queue.least()) {
            queue.set(start, f64::INFINITY);
        }
        largest >= self.threshold
    }

    /// Processes partitions until no residual reaches the level or a limit is reached.
    fn process_level(
        &mut self,
        table: &mut PriorityTable,
        queue: &mut IndexedMaxQueue,
        monitor: &mut LimitMonitor,
    ) -> Option<Status> {
        while let Some((p, _)) = queue.pop() {
            let result = self.process(p, monitor);
            if result.stopped.is_some() {
                return result.stopped;
            }
            let clock = Instant::now();
            table.reset(p, PriorityEntry { rank: result.left, residual: result.left });
            self.requeue(p, table, queue);
            let dependencies = table.dependencies();
            for pair in dependencies.pairs(p).filter(|&pair| dependencies.dependent(pair) != p) {
                match self.options.priority {
                    Priority::Bound => table.pair_mut(pair).residual += self.mdp.discount() * result.change,
                    _ => *table.pair_mut(pair) = self.entry_of_states(dependencies.states(pair)),
                }
                self.requeue(dependencies.dependent(pair), table, queue);
            }
            self.seconds_priorities += clock.elapsed().as_secs_f64();
        }
        None
    }

    /// The priority HP of a partition.
    fn entry(&self, p: usize, table: &PriorityTable) -> PriorityEntry {
        match self.options.priority {
            Priority::Bound => table.bound(p),
            _ => table.largest(p),
        }
    }

    fn requeue(&self, p: usize, table: &PriorityTable, queue: &mut IndexedMaxQueue) {
        let entry = self.entry(p, table);
        if entry.residual >= self.level {
            queue.set(p, entry.rank);
        } else {
            queue.remove(p);
        }
    }

    /// The initial priority HP0 of a partition: the largest residual of its states, as rank and residual.
    fn entry_of_partition(&mut self, p: usize) -> PriorityEntry {
        self.stop.check();
        let states = self.active.of(p);
        self.backups += states.len() as u64;
        let residual = |&s: &u32| h1(self.mdp.backup(s as usize, &self.values).0, self.values[s as usize]);
        let residual = states.iter().map(residual).fold(0.0, larger);
        PriorityEntry { rank: residual, residual }
    }

    /// The priority HPP of the given states of a partition.
    fn entry_of_states(&mut self, states: &[u32]) -> PriorityEntry {
        let mut entry = PriorityEntry::default();
        for &state in states {
            let value = self.values[state as usize];
            if value == f64::INFINITY {
                continue;
            }
            let backup = self.mdp.backup(state as usize, &self.values).0;
            self.backups += 1;
            let residual = h1(backup, value);
            let rank = match self.options.priority {
                Priority::H2 => h2(backup, value),
                _ => residual,
            };
            entry = entry.join(PriorityEntry { rank, residual });
        }
        entry
    }

    /// The inner loop: value iteration over the states of one partition.
    fn process(&mut self, p: usize, monitor: &mut LimitMonitor) -> Processed {
        let states = self.active.of(p);
        self.before.clear();
        self.before.extend(states.iter().map(|&s| self.values[s as usize]));
        let discount = self.mdp.discount();
        // A tolerance below the rounding would keep the inner loop from ending.
        let rounding = monitor.certificate().floor(self.max_value);
        let inner_tolerance = self.options.inner_tolerance.unwrap_or(self.tolerance).max(rounding);
        let mut result = Processed { change: 0.0, left: f64::INFINITY, stopped: None };
        for sweep in 0..self.options.inner_sweeps {
            let (least, most) = back_up_in_place(self.mdp, states, sweep % 2 == 1, &mut self.values);
            self.backups += states.len() as u64;
            let largest = most.max(-least);
            result.left = discount * largest;
            let sweeps = self.backups as f64 / self.values.len() as f64;
            result.stopped = monitor.check(&Progress { sweeps, residual: largest, threshold: self.threshold });
            let spread = if discount < 1.0 { most - least } else { largest };
            if spread < inner_tolerance || result.stopped.is_some() {
                break;
            }
        }
        let (mut largest, mut max_value) = (0.0f64, 0.0f64);
        for (&state, &old) in states.iter().zip(&self.before) {
            largest = larger(largest, change(self.values[state as usize], old));
            max_value = larger(max_value, self.values[state as usize].abs());
        }
        result.change = largest;
        self.processed += 1;
        if !std::mem::replace(&mut self.seen[p], true) {
            self.order.push(p as u32);
        }
        self.adapt_threshold(max_value, monitor);
        result
    }
}
