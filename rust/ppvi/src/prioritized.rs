//! Prioritized-partitioned value iteration (the thesis, section 6.3; Wingate and Seppi 2005).
//!
//! ```text
//! repeat  p = the partition of highest priority
//!         value iteration over the states of p alone, until it has converged
//!         for p' in PDP(p): update the priority of p', looking only at the states SDP(p) in p'
//! until   the Bellman residual of the problem is below the threshold
//! ```
//!
//! Where the pseudocode leaves a choice:
//!
//! * *Inner loop.* In place, forwards and backwards in turn. It ends when the span of the change, max - min, is below the
//!   inner tolerance (discount < 1, as printed), or the largest change is (discount 1, where a constant shift does not
//!   fade). What it leaves behind remains a entry of the partition, so a coarse inner tolerance costs no accuracy.
//! * *Start.* HP0(p) is the largest backup of V0 = 0 in p, the argmin of HP0 the first partition, the argmax all later
//!   ones. Read literally the argmin is a partition of nothing but obstacles, with HP0 = 0, where there is nothing to do;
//!   it is taken over the eligible partitions.
//! * *Levels.* Ranked by H2, partitions of high value would be polished to the last digit before the others are looked at
//!   (a tenfold cost on the thesis' own problem). So a partition is eligible when its residual reaches a *level*, and the
//!   level is halved, down to the threshold, whenever no partition is eligible.
//! * *End.* Only partitions whose residual may reach the threshold are queued ([`crate::priority`]). When none is left,
//!   the exact residual is computed for all states. With discount 1 the threshold falls as the values grow, so this
//!   check may queue partitions again. Partitions of absorbing states are never processed.

use std::time::Instant;

use crate::active::{ActiveStates, back_up_in_place};
use crate::bellman::{certificate, change, greedy, initial_values, solution};
use crate::dependency::Dependencies;
use crate::error::{Error, Result};
use crate::mdp::Mdp;
use crate::partition::Partition;
use crate::priority::{Priority, PriorityEntry, PriorityTable, h1, h2};
use crate::queue::IndexedMaxQueue;
use crate::solution::Solution;
use crate::termination::{Certificate, LimitMonitor, Observer, Progress, Status, StopRule};

/// Choices of the prioritized solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrioritizedOptions {
    /// The metric that ranks partitions.
    pub priority: Priority,
    /// When the inner loop ends, in units of cost; `None`: the tolerance of the stop rule, as in the thesis.
    pub inner_tolerance: Option<f64>,
    /// Largest number of inner sweeps at a time. Unlimited in the thesis and by default; 2 is often the fastest.
    pub inner_sweeps: u64,
}

impl Default for PrioritizedOptions {
    fn default() -> Self {
        PrioritizedOptions { priority: Priority::default(), inner_tolerance: None, inner_sweeps: u64::MAX }
    }
}

impl PrioritizedOptions {
    /// Checks the fields, which are public.
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

/// Solves a problem partition by partition, on one thread (the last check uses the current rayon pool).
///
/// # Errors
/// For an invalid rule or option, or a partition of another number of states. Reaching a limit is a status.
pub fn prioritized(
    mdp: &impl Mdp,
    partition: &Partition,
    options: PrioritizedOptions,
    rule: StopRule,
    observer: Option<Observer>,
) -> Result<Solution> {
    rule.validate()?;
    options.validate()?;
    partition.check_states(mdp.states())?;
    let mut monitor = LimitMonitor::start(rule, observer);
    let mut run = Run::new(mdp, partition, options, rule.tolerance);
    let dependencies = Dependencies::new(mdp, partition);
    let mut policy = vec![0; mdp.states()];
    run.seconds_priorities = monitor.seconds();
    let (status, check) = loop {
        let stopped = run.process_all(&dependencies, &mut monitor);
        let check = greedy(mdp, &run.values, &mut policy);
        run.backups += mdp.states() as u64;
        run.lower_threshold(check.max_value);
        match stopped {
            _ if check.residual < run.threshold => break (Status::Converged, check),
            Some(status) => break (status, check),
            None => {}
        }
    };
    let mut solution = solution(run.values, policy, status, check, &run.certificate);
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
    certificate: Certificate,
    threshold: f64,
    /// Residual at which a partition is eligible now.
    level: f64,
    max_value: f64,
    values: Vec<f64>,
    active: ActiveStates,
    /// Values of a partition before it was processed.
    before: Vec<f64>,
    seen: Vec<bool>,
    order: Vec<u32>,
    processed: u64,
    backups: u64,
    seconds_priorities: f64,
}

/// What one processing of a partition did.
struct Processed {
    /// Largest change of a state.
    change: f64,
    /// Bound on the residual left in the partition.
    left: f64,
    stopped: Option<Status>,
}

impl<'m, M: Mdp> Run<'m, M> {
    fn new(mdp: &'m M, partition: &Partition, options: PrioritizedOptions, tolerance: f64) -> Self {
        let (values, certificate) = (initial_values(mdp), certificate(mdp));
        let active = ActiveStates::new(mdp, partition, &values);
        Run {
            mdp,
            options,
            tolerance,
            certificate,
            threshold: certificate.threshold(tolerance, 0.0),
            level: f64::INFINITY,
            max_value: 0.0,
            values,
            active,
            before: Vec::new(),
            seen: vec![false; partition.count()],
            order: Vec::new(),
            processed: 0,
            backups: 0,
            seconds_priorities: 0.0,
        }
    }

    /// With discount 1 the threshold falls as the values grow; otherwise it is fixed.
    fn lower_threshold(&mut self, max_value: f64) {
        self.max_value = self.max_value.max(max_value);
        self.threshold = self.certificate.threshold(self.tolerance, self.max_value);
    }

    /// Processes partitions, level after level, until none reaches the threshold, or a limit is reached.
    fn process_all(&mut self, dependencies: &Dependencies, monitor: &mut LimitMonitor) -> Option<Status> {
        let clock = Instant::now();
        let own: Vec<PriorityEntry> = (0..self.seen.len()).map(|p| self.entry_of_partition(p)).collect();
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

    /// Halves the residual that makes a partition eligible and fills the queue; false if no partition is left.
    fn lower_level(&mut self, table: &PriorityTable, queue: &mut IndexedMaxQueue) -> bool {
        let largest = (0..self.seen.len()).map(|p| self.entry(p, table).residual).fold(0.0, f64::max);
        self.level = (largest / 2.0).max(self.threshold);
        for p in 0..self.seen.len() {
            self.requeue(p, table, queue);
        }
        if let (true, Some(start)) = (self.processed == 0, queue.least()) {
            queue.set(start, f64::INFINITY);
        }
        largest >= self.threshold
    }

    /// Processes partitions until none reaches the level, or a limit is reached.
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

    /// HP of a partition.
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

    /// HP0 of a partition, or what it is to begin again with: the largest residual of its states.
    fn entry_of_partition(&mut self, p: usize) -> PriorityEntry {
        let states = self.active.of(p);
        self.backups += states.len() as u64;
        let residual = |&s: &u32| h1(self.mdp.backup(s as usize, &self.values).0, self.values[s as usize]);
        let residual = states.iter().map(residual).fold(0.0, f64::max);
        PriorityEntry { rank: residual, residual }
    }

    /// HPP of some states of a partition.
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
        let inner_tolerance = self.options.inner_tolerance.unwrap_or(self.tolerance);
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
            largest = largest.max(change(self.values[state as usize], old));
            max_value = max_value.max(self.values[state as usize].abs());
        }
        result.change = largest;
        self.processed += 1;
        if !std::mem::replace(&mut self.seen[p], true) {
            self.order.push(p as u32);
        }
        self.lower_threshold(max_value);
        result
    }
}
