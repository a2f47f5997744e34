//! The fastest solver for explicit rows: directional sweeps over compressed blocks, in deterministic waves.
//!
//! 1. *Compile.* The states are cut into at most 128 blocks of consecutive indices. A block stores repeated rows once
//!    (`pattern.rs`) and has a forward and a backward list of its states (`block.rs`).
//! 2. *Sweep.* A pass updates all lists in place (Gauss-Seidel), wave after wave. It skips a list if the
//!    accumulated-change bound proves that its residual is below the threshold (`waves.rs`).
//! 3. *Check.* When all bounds are below the threshold, the exact residual of all states is computed.
//!
//! Blocks, waves and skipped lists do not depend on the number of threads. Neighbouring states of the problem should
//! have near indices. With indices in random order the results are still correct, but the solver is no faster than
//! Gauss-Seidel on the plain rows.
//!
//! Values are stored in relaxed atomics, which cost nothing on common machines. The waves already prevent one thread
//! from reading a value that another thread writes; with atomics, memory safety does not depend on the waves.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use rayon::prelude::*;

use crate::bellman::{Check, change, larger};
use crate::block::{Block, MOST_BLOCKS, SharedValues};
use crate::error::{Error, Result};
use crate::mdp::Mdp;
use crate::pattern::{Class, Source, Values};
use crate::proper::proper_states;
use crate::solution::{Solution, solution};
use crate::stop::StopFlag;
use crate::tabular::TabularMdp;
use crate::termination::{Certificate, LimitMonitor, Observer, Progress, StopRule};
use crate::waves::{ResidualBoundTracker, Task, waves};

/// Base-2 logarithm of the smallest number of states of a block. The update of a smaller block takes less time than
/// another thread needs to start.
const LEAST_LOG_SIZE: u32 = 12;

/// Values as bits in atomics.
struct Shared(Vec<AtomicU64>);

impl Values for Shared {
    #[inline]
    fn get(&self, state: usize) -> f64 {
        f64::from_bits(self.0[state].load(Ordering::Relaxed))
    }
}

impl SharedValues for Shared {
    #[inline]
    fn set(&self, state: usize, value: f64) {
        self.0[state].store(value.to_bits(), Ordering::Relaxed);
    }
}

/// Solves an explicit problem on the current rayon pool. The result is the same, bit for bit, for any number of
/// threads.
///
/// # Errors
/// [`Error::Parameter`] for an invalid rule; [`Error::TooLarge`] for 2^31 states or more, or for 2^32 or more rows and
/// entries. Reaching a limit is a status, not an error.
///
/// # Examples
/// ```
/// use ppvi::{StopRule, TabularMdp, tabular_sweep};
///
/// // State 0 stays with probability 3/4 and ends with probability 1/4; every step costs 2.
/// let mdp = TabularMdp::new(vec![0, 1, 1], vec![0, 2], vec![0, 1], vec![0.75, 0.25], vec![2.0], 1.0)?;
/// let solution = tabular_sweep(&mdp, StopRule::new(1e-6)?, None)?;
/// assert!((solution.values[0] - 8.0).abs() <= solution.report.error_bound);
/// # Ok::<(), ppvi::Error>(())
/// ```
pub fn tabular_sweep(mdp: &TabularMdp, rule: StopRule, observer: Option<Observer>) -> Result<Solution> {
    let states = mdp.states();
    check_size(mdp)?;
    let mut monitor = LimitMonitor::start(rule, Certificate::of(mdp), observer)?;
    // The exact check of all states.
    monitor.needs_to_end(1, Duration::ZERO);
    let discount = mdp.discount();
    let classes = classify(mdp);
    let log_size = (LEAST_LOG_SIZE..).find(|&log| states.div_ceil(1 << log) <= MOST_BLOCKS).unwrap_or(LEAST_LOG_SIZE);
    let source = Source { mdp, classes: &classes };
    let stop = StopFlag::current();
    let blocks: Vec<Block> = (0..states.div_ceil(1 << log_size))
        .into_par_iter()
        .map(|number| Block::new(source, number, log_size, &stop))
        .collect();
    let values = initial_values(&classes);
    let mut sweeps = Sweeps::new(&blocks, discount, states);
    sweeps.backups = blocks.par_iter().map(|block| block.solve_constants(discount, &values)).sum();
    let mut policy = vec![0; states];
    let (status, check) = loop {
        // With a discount the threshold depends on the values only if it is near the rounding.
        let most = mdp.facts().largest_stage_cost / (1.0 - discount);
        let threshold = match monitor.threshold(most) == monitor.threshold(0.0) {
            true => monitor.threshold(0.0),
            false => monitor.threshold(largest(&values)),
        };
        let stopped = match sweeps.is_below(threshold) {
            true => None,
            false => {
                let residual = sweeps.pass(&values, threshold);
                let stopped = monitor.check(&Progress { sweeps: sweeps.count(), residual, threshold });
                if stopped.is_none() {
                    continue;
                }
                stopped
            }
        };
        let check = check(&blocks, discount, &values, &mut policy, log_size);
        sweeps.backups += states as u64;
        if let Some(status) = monitor.conclude(check, stopped) {
            break (status, check);
        }
        // Rounding has exceeded the bounds, or the threshold has fallen: start the bounds afresh.
        sweeps.tracker = ResidualBoundTracker::new(&blocks, discount);
    };
    let values = values.0.into_iter().map(|value| f64::from_bits(value.into_inner())).collect();
    let mut solution = solution(values, policy, status, check, &monitor);
    solution.report.backups = sweeps.backups;
    solution.report.partitions = blocks.len();
    solution.report.partitions_processed = sweeps.updates;
    solution.report.order = sweeps.order;
    Ok(solution)
}

/// The state of the solve, except for the values.
struct Sweeps<'b> {
    blocks: &'b [Block],
    waves: Vec<Vec<Task>>,
    tracker: ResidualBoundTracker<'b>,
    discount: f64,
    states: usize,
    backups: u64,
    updates: u64,
    order: Vec<u32>,
}

impl<'b> Sweeps<'b> {
    fn new(blocks: &'b [Block], discount: f64, states: usize) -> Self {
        let (waves, tracker) = (waves(blocks), ResidualBoundTracker::new(blocks, discount));
        Sweeps { blocks, waves, tracker, discount, states, backups: 0, updates: 0, order: Vec::new() }
    }

    /// Whether the residuals of all lists are below the threshold.
    fn is_below(&self, threshold: f64) -> bool {
        self.waves.iter().flatten().all(|&task| self.tracker.bound(task) < threshold)
    }

    /// Backups so far, in sweeps of n backups.
    fn count(&self) -> f64 {
        self.backups as f64 / self.states.max(1) as f64
    }

    /// Updates every list whose residual may reach the threshold. Returns the largest change.
    fn pass(&mut self, values: &Shared, threshold: f64) -> f64 {
        let mut largest = 0.0f64;
        let stop = StopFlag::current();
        for wave in &self.waves {
            let due: Vec<Task> = wave.iter().copied().filter(|&task| self.tracker.bound(task) >= threshold).collect();
            let update = |task: &Task| {
                stop.check();
                self.blocks[task.block].update(task.side, self.discount, values)
            };
            let changes: Vec<f64> = match due.len() {
                0 | 1 => due.iter().map(update).collect(),
                _ => due.par_iter().map(update).collect(),
            };
            self.tracker.record(&due, &changes);
            for task in &due {
                self.backups += self.blocks[task.block].list_len(task.side) as u64;
                self.updates += 1;
                if !self.order.contains(&(task.block as u32)) {
                    self.order.push(task.block as u32);
                }
            }
            largest = changes.into_iter().fold(largest, larger);
        }
        largest
    }
}

/// Checks that the problem fits the index types: successors relative to the state, and rows and entries, in 32 bits.
pub(crate) fn check_size(mdp: &TabularMdp) -> Result<()> {
    let (states, cells) = (mdp.states(), mdp.cells());
    if states < i32::MAX as usize && cells < u32::MAX as usize {
        return Ok(());
    }
    let rule = "this solver takes less than 2^31 states and 2^32 rows and entries";
    Err(Error::TooLarge { states: states as u128, needed_bytes: 12 * cells as u128 + 24 * states as u128, rule })
}

fn classify(mdp: &TabularMdp) -> Vec<Class> {
    let class = |state| if mdp.actions(state) == 0 { Class::Absorbing } else { Class::Active };
    let mut classes: Vec<Class> = (0..mdp.states()).into_par_iter().with_min_len(4096).map(class).collect();
    if mdp.discount() == 1.0 {
        for (class, proper) in classes.iter_mut().zip(proper_states(mdp)) {
            if !proper {
                *class = Class::Improper;
            }
        }
    }
    classes
}

fn initial_values(classes: &[Class]) -> Shared {
    let value = |class: &Class| if *class == Class::Improper { f64::INFINITY } else { 0.0 };
    Shared(classes.par_iter().with_min_len(4096).map(|class| AtomicU64::new(value(class).to_bits())).collect())
}

/// Largest finite |V|.
fn largest(values: &Shared) -> f64 {
    let sizes = (0..values.0.len()).into_par_iter().with_min_len(4096).map(|state| values.get(state).abs());
    sizes.filter(|size| size.is_finite()).reduce(|| 0.0, larger)
}

/// Writes the greedy policy, and returns the exact check of all states.
fn check(blocks: &[Block], discount: f64, values: &Shared, policy: &mut [u32], log_size: u32) -> Check {
    let none = Check { residual: 0.0, max_value: 0.0 };
    let stop = StopFlag::current();
    let checks = blocks.par_iter().zip(policy.par_chunks_mut(1 << log_size)).map(|(block, policy)| {
        stop.check();
        let mut check = none;
        block.each_backup(discount, values, |state, backup, action| {
            let value = values.get(state);
            policy[state & ((1 << log_size) - 1)] = action as u32;
            check = check.join(Check { residual: change(backup, value), max_value: value.abs() });
        });
        check
    });
    checks.reduce(|| none, Check::join)
}
