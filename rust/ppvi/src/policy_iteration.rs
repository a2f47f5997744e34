//! Policy iteration, modified policy iteration, and their combination with value iteration, by components.
//!
//! 0. *Lattices.* With `Auto`, a large problem whose rows repeat gets up to 16 directional sweeps first
//!    ([`crate::tabular_sweep()`]): on lattices their compressed rows are several times faster. If they prove the
//!    tolerance, their solution is returned, with a [`Report::order`](crate::Report); if not, it is the start.
//! 1. *Order.* The strongly connected components are solved one after another, successors first (`components.rs`). A
//!    component of one state is solved in closed form: V = min over a of (k + rest) / (1 - g p), with the probability p
//!    of staying. An acyclic problem therefore takes one backup per state, in any order of its indices.
//! 2. *Component.* Rounds of a sweep over all actions and an evaluation of the policy chosen (`component.rs`).
//! 3. *Check.* The exact residual of all states proves the error bound ([`crate::termination`]). If it does not suffice,
//!    the components are solved again, from the present values.
//!
//! | [`Evaluation`] | how a policy is evaluated |
//! |---|---|
//! | `Auto` | by 4 sweeps; if they reduce the change less than tenfold, by a solve of the equations to 5 % |
//! | `Sweeps` | by 20 sweeps: modified policy iteration (Puterman and Shin 1978) |
//! | `Solve` | by a solve of the equations to rounding: policy iteration (Howard 1960) |
//!
//! The equations are solved directly if the policy's matrix has a narrow band (long chains and small components), else
//! by a preconditioned iteration. The result does not depend on the number of threads: only the check is parallel.

use std::collections::HashSet;
use std::time::Duration;

use crate::bellman::{CHUNK, greedy};
pub use crate::component::Evaluation;
use crate::component::{Component, Goal};
use crate::component_order::OUTSIDE;
use crate::components::Components;
use crate::error::{Error, Result};
use crate::mdp::Mdp;
use crate::proper::proper_states_in;
use crate::solution::{Solution, solution};
use crate::stop::StopFlag;
use crate::tabular::TabularMdp;
use crate::tabular_sweep::{check_size, tabular_sweep};
use crate::termination::{Certificate, LimitMonitor, Observer, Progress, Status, StopRule};

/// Backups between two checks of the limits while small components are solved.
const BACKUPS_PER_CHECK: u64 = 1 << 16;

/// Passes over the components without a smaller residual after which rounding is taken as the reason.
const MOST_FRUITLESS_PASSES: u32 = 3;

/// Largest number of rows and entries of a small problem.
const SMALL: usize = 1 << 14;

/// Smallest number of states for which the rows are searched for repetitions.
const LEAST_LATTICE: usize = 1 << 14;

/// Sweeps over a lattice before its components are solved.
const LATTICE_SWEEPS: u64 = 16;

/// States that are compared in the search for repetitions.
const SAMPLED_STATES: usize = 1 << 10;

/// Solves an explicit problem by components. `start` holds values from which to start, one per state; without it, the
/// solve starts from 0.
///
/// # Errors
/// [`Error::Parameter`] for an invalid rule or a start that is not finite, [`Error::Length`] for a start of another length,
/// [`Error::TooLarge`] for 2^31 states or more, or for 2^32 or more rows and entries. Reaching a limit is a status, not an error.
///
/// # Examples
/// ```
/// use ppvi::{Evaluation, StopRule, TabularMdp, policy_iteration};
///
/// // State 0 stays with probability 3/4 and ends with probability 1/4; every step costs 2.
/// let mdp = TabularMdp::new(vec![0, 1, 1], vec![0, 2], vec![0, 1], vec![0.75, 0.25], vec![2.0], 1.0)?;
/// let solution = policy_iteration(&mdp, Evaluation::Auto, None, StopRule::new(1e-6)?, None)?;
/// assert!((solution.values[0] - 8.0).abs() <= solution.report.error_bound);
/// # Ok::<(), ppvi::Error>(())
/// ```
pub fn policy_iteration(
    mdp: &TabularMdp,
    evaluation: Evaluation,
    start: Option<&[f64]>,
    rule: StopRule,
    mut observer: Option<Observer>,
) -> Result<Solution> {
    let states = mdp.states();
    check_size(mdp)?;
    if let Some(start) = start {
        if start.len() != states {
            return Err(Error::Length { name: "start", expected: states, found: start.len() });
        }
        if let Some(value) = start.iter().find(|value| !value.is_finite()) {
            return Err(Error::parameter("start", value, "must hold finite numbers"));
        }
    }
    let mut swept = None;
    if evaluation == Evaluation::Auto && start.is_none() && states >= LEAST_LATTICE && repeats(mdp) {
        let rule = StopRule { max_sweeps: rule.max_sweeps.min(LATTICE_SWEEPS), ..rule };
        // Reborrowed, so that the rounds can report too.
        let observer = observer.as_mut().map(|observer| &mut **observer as Observer);
        let solution = tabular_sweep(mdp, rule, observer)?;
        if solution.report.status != Status::IterationLimit || rule.max_sweeps < LATTICE_SWEEPS {
            return Ok(solution);
        }
        swept = Some(solution);
    }
    let start = swept.as_ref().map(|solution| solution.values.as_slice()).or(start);
    let rule = match (rule.time_limit, &swept) {
        (Some(limit), Some(swept)) => {
            let left = limit.saturating_sub(Duration::from_secs_f64(swept.report.seconds_solving));
            StopRule { time_limit: Some(left), ..rule }
        }
        _ => rule,
    };
    let mut monitor = LimitMonitor::start(rule, Certificate::of(mdp), observer)?;
    let absorbing: Vec<bool> = (0..states).map(|state| mdp.actions(state) == 0).collect();
    let components = Components::new(mdp, &absorbing);
    let mut values = initial_values(mdp, &components, start);
    let mut policy = vec![0; states];
    let (backups, seconds) = swept.map_or((0, 0.0), |swept| (swept.report.backups, swept.report.seconds_solving));
    let mut pass = Pass { mdp, components: &components, evaluation, backups, places: vec![OUTSIDE; states] };
    let (mut least, mut fruitless) = (f64::INFINITY, 0);
    let (status, check) = loop {
        let stopped = pass.run(&mut values, &mut monitor);
        let check = greedy(mdp, &values, &mut policy);
        pass.backups += states as u64;
        fruitless = if check.residual < least { 0 } else { fruitless + 1 };
        least = least.min(check.residual);
        let stopped = stopped.or_else(|| (fruitless >= MOST_FRUITLESS_PASSES).then_some(Status::PrecisionLimit));
        if let Some(status) = monitor.conclude(check, stopped) {
            break (status, check);
        }
    };
    let mut solution = solution(values, policy, status, check, &monitor);
    solution.report.backups = pass.backups;
    solution.report.seconds_solving += seconds;
    solution.report.partitions = components.count();
    solution.report.partitions_processed = components.count() as u64;
    Ok(solution)
}

/// Whether [`policy_iteration()`] solves the problem on the calling thread alone, in steps of less than about 10 ms.
pub fn is_small(mdp: &TabularMdp) -> bool {
    mdp.states() <= CHUNK && mdp.cells() <= SMALL
}

/// Whether at least half of some states, evenly spread, have rows that differ from those of another one only by a shift
/// of the indices.
fn repeats(mdp: &TabularMdp) -> bool {
    let mut patterns: HashSet<Vec<u64>> = HashSet::new();
    let sampled = (0..SAMPLED_STATES).map(|number| number * (mdp.states() / SAMPLED_STATES));
    let (mut compared, mut repeated) = (0, 0);
    for state in sampled.filter(|&state| mdp.actions(state) > 0) {
        let mut pattern = Vec::new();
        for row in mdp.rows(state) {
            let (successors, probabilities, cost) = mdp.row(row);
            pattern.push(cost.to_bits());
            for (&next, probability) in successors.iter().zip(probabilities) {
                pattern.extend([u64::from(next).wrapping_sub(state as u64), probability.to_bits()]);
            }
        }
        compared += 1;
        repeated += usize::from(!patterns.insert(pattern));
    }
    compared > 0 && 2 * repeated >= compared
}

/// Start values: 0 for absorbing states, infinity for improper ones, and `start` or 0 for all others.
fn initial_values(mdp: &TabularMdp, components: &Components, start: Option<&[f64]>) -> Vec<f64> {
    let mut values = vec![0.0; mdp.states()];
    for &state in components.states() {
        let first = start.map_or(0.0, |start| start[state as usize]);
        values[state as usize] = if first.is_finite() { first } else { 0.0 };
    }
    if mdp.discount() == 1.0 {
        for (value, proper) in values.iter_mut().zip(proper_states_in(mdp, components.states())) {
            if !proper {
                *value = f64::INFINITY;
            }
        }
    }
    values
}

struct Pass<'p> {
    mdp: &'p TabularMdp<'p>,
    components: &'p Components,
    evaluation: Evaluation,
    backups: u64,
    places: Vec<u32>,
}

impl Pass<'_> {
    /// Solves all components, successors first. Returns the status with which a limit has ended the solve.
    fn run(&mut self, values: &mut [f64], monitor: &mut LimitMonitor) -> Option<Status> {
        let stop = StopFlag::current();
        let mut most =
            values.iter().copied().filter(|value| value.is_finite()).fold(0.0, |most, value| value.abs().max(most));
        let (mut component, mut proper) = (Component::default(), Vec::new());
        let (mut checked, per_sweep) = (self.backups, 1.0 / values.len().max(1) as f64);
        for number in 0..self.components.count() {
            let threshold = monitor.threshold(most);
            // Improper states keep their value, and no other state of a component depends on them.
            proper.clear();
            proper.extend(self.components.of(number).iter().filter(|&&state| values[state as usize] < f64::INFINITY));
            match proper.as_slice() {
                [] => (),
                &[state] => {
                    values[state as usize] = self.single(state as usize, values);
                    most = size(values[state as usize]).max(most);
                    self.backups += 1;
                }
                members => {
                    component.enter(self.mdp, members, &mut self.places);
                    component.backups = self.backups;
                    let goal = Goal { threshold, floor: 4.0 * monitor.certificate().floor(most) };
                    let problem = (self.mdp, self.places.as_slice());
                    let ended = component.solve(problem, values, self.evaluation, goal, |component, residual| {
                        stop.check();
                        if component.backups < checked + BACKUPS_PER_CHECK {
                            return None;
                        }
                        checked = component.backups;
                        monitor.check(&Progress { sweeps: checked as f64 * per_sweep, residual, threshold })
                    });
                    self.backups = component.backups;
                    component.leave(&mut self.places);
                    if ended.is_some() {
                        return ended;
                    }
                    most = members.iter().fold(most, |most, &state| size(values[state as usize]).max(most));
                }
            }
            if self.backups >= checked + BACKUPS_PER_CHECK || number + 1 == self.components.count() {
                checked = self.backups;
                let ended =
                    monitor.check(&Progress { sweeps: checked as f64 * per_sweep, residual: threshold, threshold });
                // The last component is solved: only an exhausted limit on passes matters.
                if ended.is_some() {
                    return ended;
                }
            }
        }
        None
    }

    /// The value of a state whose only cycle is a self-loop, from those of its successors.
    fn single(&self, state: usize, values: &[f64]) -> f64 {
        let discount = self.mdp.discount();
        let mut best = f64::INFINITY;
        for row in self.mdp.rows(state) {
            let (successors, probabilities, cost) = self.mdp.row(row);
            let (mut expectation, mut stays) = (0.0, 0.0);
            for (&next, &probability) in successors.iter().zip(probabilities) {
                if next as usize == state {
                    stays += probability;
                } else if probability > 0.0 {
                    expectation += probability * values[next as usize];
                }
            }
            let scale = 1.0 - discount * stays;
            // An action that never leaves the state costs infinitely much without discount.
            if scale > 0.0 {
                best = best.min((cost + discount * expectation) / scale);
            }
        }
        best
    }
}

/// |V|, and 0 for an infinite value.
fn size(value: f64) -> f64 {
    if value.is_finite() { value.abs() } else { 0.0 }
}
