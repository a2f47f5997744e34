//! Evaluation of a policy: probability of reaching the target, expected length, expected number of turns.
//!
//! The chain of the policy is evaluated by the sweeps of the solver, with other costs, no discount, and zero as the
//! start: the iterates grow towards the smallest solution, which is the right one even where the policy never ends.
//!
//! *Start from the optimal values.* Let V be the table of a solve with discount 1, residual B and least stage cost c > B. Where
//! V is finite it satisfies V >= c - B + PV, so the policy ends there after V / (c - B) steps on average, and never leads to a
//! state where V is infinite. So the solution is unique there, and any start converges to it: with failures of cost F and
//! a success of cheap steps, 1 - V / F is nearly right. Elsewhere the start is zero as before.
//!
//! # The error of a success probability
//!
//! Let p be the returned probabilities and p* the true ones, P the transitions of the policy between states at which the
//! execution goes on, and e an upper bound on the residual |r + Pp - p|, rounding included. If a table W >= 0 satisfies
//! W >= 1 + PW, it bounds the expected number of steps, and
//!
//! ```text
//! |p - p*| <= e + P |p - p*| <= ... <= e W.
//! ```
//!
//! *From the optimal values.* With discount 1 the table V of a solve has the residual B, and V >= c + PV - B plus the
//! costs of failures, all of which are at least F. Where the execution ends without success, 1 - p accounts for F, so
//!
//! ```text
//! V - F (1 - p) >= c - B - F e + P (V - F (1 - p)).
//! ```
//!
//! Hence W = (V - F (1 - p)) / (c - B - F e) will do, at no cost. It needs interpolated transitions, where the absorbing
//! states of obstacles have the value F or more; with nearest ones, F = 0.
//!
//! *By sweeps.* Otherwise the expected number of steps is evaluated like a cost, up to a residual b < 1, in single
//! precision. The result S satisfies S >= 1 - b + PS, so W = S / (1 - b) will do.

use crate::bellman::larger;
use crate::error::{Error, Result};
use crate::interpolation::Order;
use crate::lattice::cubic::Reading;
use crate::lattice::engine::Engine;
use crate::lattice::kernel::{StageCosts, StepCosts};
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{Region, outcome};
use crate::lattice::sweep::certificate;
use crate::mdp::Mdp;
use crate::termination::Certificate;

/// Limit on the passes of an evaluation.
const MAX_PASSES: u64 = 2000;

/// Multiple of the change that ends the passes: below it, sweeps write their values to the table.
const KEEP_BELOW: f64 = 20.0;

/// Relative change that ends the passes: the largest change over the largest possible (or found) value.
const RELATIVE_CHANGE: f64 = 1e-6;

/// The same for cubic interpolation, whose error is larger.
const CUBIC_CHANGE: f64 = 1e-5;

/// Residual of the expected number of steps at which its evaluation ends. A larger one gives a larger bound earlier.
const STEP_RESIDUAL: f64 = 0.5;

/// Change of the expected number of steps at which its evaluation gives up: times the rounding of one step in single
/// precision, such a number bounds the error of a probability by one.
const MOST_STEPS: f64 = 1e7;

/// Limit on the passes of that evaluation.
const MAX_STEP_PASSES: u64 = 200;

/// A number for every state, in table layout.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The number.
    pub values: Vec<f32>,
    /// Upper bound on the residual of the evaluation equation, but for rounding.
    pub change: f64,
    /// Whether the residual was small enough before the limit on passes.
    pub converged: bool,
}

/// Probability that the policy (table layout) reaches the target.
///
/// # Errors
/// As in all evaluations of a policy: [`Error::Length`] for a table of another size, and [`Error::Parameter`] for an
/// action that the lattice does not have.
pub fn success(lattice: &LatticeMdp, policy: &[u8], order: Order) -> Result<Evaluation> {
    success_from(lattice, policy, order, None)
}

/// [`success`] of the greedy policy of a solve, whose values give a start that is nearly right.
///
/// # Errors
/// [`Error::Length`] for a table of another size.
pub fn success_from(
    lattice: &LatticeMdp,
    policy: &[u8],
    order: Order,
    optimal: Option<OptimalValues>,
) -> Result<Evaluation> {
    let mut terminal = [0.0; outcome::CODES];
    terminal[outcome::TARGET as usize] = 1.0;
    terminal[outcome::AT_TARGET as usize] = 1.0;
    let is_proper =
        |optimal: &OptimalValues| lattice.discount() == 1.0 && optimal.residual < lattice.facts().least_stage_cost;
    let values = optimal.filter(is_proper).map(|optimal| optimal.values);
    if let Some(values) = values {
        check_length("values", lattice, values.len())?;
    }
    let failure = lattice.parts.costs.collision.min(lattice.parts.costs.exit);
    let start = values.map(|values| move |state: usize| (1.0 - f64::from(values[state]) / failure).max(0.0));
    let costs = evaluation_costs(lattice, 0.0, |_| StepCosts { cost: 0.0, terminal });
    evaluate_from(lattice, (policy, reading(lattice, order, Reading::Cubic)), &costs, start)
}

/// The table of a solve with discount 1 whose greedy policy is evaluated.
#[derive(Debug, Clone, Copy)]
pub struct OptimalValues<'a> {
    /// Cost-to-go, in table layout.
    pub values: &'a [f32],
    /// The residual that the solve reported.
    pub residual: f64,
}

/// Upper bound on the error of the probabilities that [`success`] returned for a policy: they differ by at most this
/// from the exact ones. It is 1 if nothing better can be proven. Without `optimal` it takes sweeps; see the
/// [module](self).
///
/// # Errors
/// [`Error::Length`] for a table of another size.
pub fn success_error(
    lattice: &LatticeMdp,
    policy: &[u8],
    order: Order,
    success: &Evaluation,
    optimal: Option<OptimalValues>,
) -> Result<f64> {
    let reading = reading(lattice, order, Reading::Magnitudes);
    let certificate = evaluation_certificate(lattice, reading);
    let residual = success.change * (1.0 + certificate.rounding) + certificate.rounding + certificate.excess;
    let from_values = match optimal {
        Some(optimal) if lattice.parts.costs.discount == 1.0 && !reading.is_cubic() => {
            for (name, found) in [("values", optimal.values.len()), ("success", success.values.len())] {
                check_length(name, lattice, found)?;
            }
            steps_from_values(lattice, success, optimal, residual)
        }
        _ => f64::INFINITY,
    };
    let steps = if from_values.is_finite() { from_values } else { expected_steps(lattice, (policy, reading))? };
    Ok((residual * steps * (1.0 + 1e-9)).min(1.0))
}

/// Upper bound on the expected number of steps, from optimal values; infinite if they prove none.
fn steps_from_values(lattice: &LatticeMdp, success: &Evaluation, optimal: OptimalValues, residual: f64) -> f64 {
    let costs = &lattice.parts.costs;
    let failure = if lattice.is_interpolated() { costs.collision.min(costs.exit) } else { 0.0 };
    let least = lattice.facts().least_stage_cost - optimal.residual - failure * residual;
    // Obstacles have values that are rounded to single precision.
    let rounded = failure * f64::from(f32::EPSILON);
    let shares = optimal.values.iter().zip(&success.values);
    let most = shares.fold(0.0, |most, (value, p)| larger(most, f64::from(*value) - failure * (1.0 - f64::from(*p))));
    if least > 0.0 { (most + rounded) / least } else { f64::INFINITY }
}

/// Upper bound on the expected number of steps under a policy, by sweeps; infinite if they do not converge soon.
fn expected_steps(lattice: &LatticeMdp, (policy, reading): (&[u8], Reading)) -> Result<f64> {
    let mut terminal = [0.0; outcome::CODES];
    terminal[outcome::TARGET as usize..=outcome::EXIT as usize].fill(1.0);
    let costs = evaluation_costs(lattice, 0.0, |_| StepCosts { cost: 1.0, terminal });
    check_policy(lattice, policy)?;
    let mut engine = Engine::<f32>::new(lattice, &lattice.terminal_masks, &costs, 0.0, Some((policy, reading)), false);
    // With the magnitudes of cubic weights, steps much shorter than a cell make the numbers grow without end. Infinite ones
    // would change no more.
    let mut changes = (0..MAX_STEP_PASSES).map(|_| engine.pass(STEP_RESIDUAL));
    let last = changes.by_ref().skip(1).find(|change| !(STEP_RESIDUAL..=MOST_STEPS).contains(change));
    if !last.is_some_and(|change| change <= STEP_RESIDUAL) {
        return Ok(f64::INFINITY);
    }
    let certificate = Certificate { discount: 1.0, ..evaluation_certificate(lattice, reading) };
    let tables = engine.tables();
    let hidden = certificate.hidden(tables.largest) + tables.seen * (1.0 + certificate.rounding);
    Ok(if hidden < 1.0 { tables.largest / (1.0 - hidden) } else { f64::INFINITY })
}

/// Probability that the execution ends.
pub fn termination(lattice: &LatticeMdp, policy: &[u8]) -> Result<Evaluation> {
    evaluate(lattice, policy, 0.0, |_| StepCosts { cost: 0.0, terminal: [1.0; outcome::CODES] })
}

/// Expected inserted length until the execution ends, mm; meaningful where [`termination`] is one.
pub fn length(lattice: &LatticeMdp, policy: &[u8]) -> Result<Evaluation> {
    evaluate(lattice, policy, 0.0, |region| {
        let cost = region.step_length;
        let mut terminal = [0.0; outcome::CODES];
        terminal[1..4].fill(cost);
        StepCosts { cost, terminal }
    })
}

/// Expected number of turns until the execution ends; meaningful where [`termination`] is one.
pub fn turns(lattice: &LatticeMdp, policy: &[u8]) -> Result<Evaluation> {
    evaluate(lattice, policy, 1.0, |_| StepCosts { cost: 0.0, terminal: [0.0; outcome::CODES] })
}

/// Expected length and number of turns, in table layout.
#[derive(Debug, Clone, PartialEq)]
pub struct Expectations {
    /// Inserted length until the execution ends, mm.
    pub length: Vec<f32>,
    /// Number of turns until the execution ends.
    pub turns: Vec<f32>,
    /// Whether both evaluations converged.
    pub converged: bool,
}

/// Probability of termination below which expected length and number of turns are reported as infinite.
const SURELY: f32 = 1.0 - 1e-4;

/// [`length`] and [`turns`], infinite where the policy need not end.
pub fn expectations(lattice: &LatticeMdp, policy: &[u8]) -> Result<Expectations> {
    let ends = termination(lattice, policy)?;
    let (mut length, mut turns) = (length(lattice, policy)?, turns(lattice, policy)?);
    let converged = ends.converged && length.converged && turns.converged;
    for (ends, (length, turns)) in ends.values.iter().zip(length.values.iter_mut().zip(&mut turns.values)) {
        if *ends < SURELY {
            (*length, *turns) = (f32::INFINITY, f32::INFINITY);
        }
    }
    Ok(Expectations { length: length.values, turns: turns.values, converged })
}

fn evaluate(
    lattice: &LatticeMdp,
    policy: &[u8],
    rotation: f64,
    step: impl Fn(&Region) -> StepCosts<f64>,
) -> Result<Evaluation> {
    let costs = evaluation_costs(lattice, rotation, step);
    evaluate_from(lattice, (policy, Reading::Transitions), &costs, None::<fn(usize) -> f64>)
}

/// The reading of an order, or the transitions of the lattice where it is linear or they are nearest.
fn reading(lattice: &LatticeMdp, order: Order, cubic: Reading) -> Reading {
    if order == Order::Cubic && lattice.is_interpolated() { cubic } else { Reading::Transitions }
}

/// The certificate of the passes of an evaluation. The terms of cubic interpolation have both signs, so the rounding is
/// relative to the sum of their magnitudes. It has sixteen products and four sums one after the other instead of four
/// products and two sums, or the factor of a cell that is not free all around.
fn evaluation_certificate(lattice: &LatticeMdp, reading: Reading) -> Certificate {
    let certificate = certificate::<f32>(lattice);
    if !reading.is_cubic() {
        return certificate;
    }
    let shifts = lattice.parts.steps().flat_map(|region| region.stencil.iter().flatten().copied());
    let further = 4.0 * f64::from(f32::EPSILON / 2.0);
    let rounding = (certificate.rounding + further) * reading.largest_sum(shifts);
    Certificate { rounding, underflow: 4.0 * certificate.underflow, ..certificate }
}

/// Evaluates a policy from a start by state, or from zero.
fn evaluate_from(
    lattice: &LatticeMdp,
    (policy, reading): (&[u8], Reading),
    costs: &StageCosts<f64>,
    start: Option<impl Fn(usize) -> f64 + Sync>,
) -> Result<Evaluation> {
    check_policy(lattice, policy)?;
    let mut engine = Engine::<f32>::new(lattice, &lattice.terminal_masks, costs, 0.0, Some((policy, reading)), false);
    if let Some(start) = start {
        engine.start_from(start);
    }
    let terminal = costs.steps.iter().flat_map(|step| step.terminal);
    let largest = terminal.fold(costs.rotation, f64::max);
    let (mut converged, mut scale) = (false, largest);
    let relative_change = if reading.is_cubic() { CUBIC_CHANGE } else { RELATIVE_CHANGE };
    // Changes of the last two waves.
    let mut last = [f64::INFINITY; 2];
    for wave in 0..2 * MAX_PASSES {
        let enough = relative_change * scale;
        last = [last[1], engine.wave(wave % 2 == 1, enough, last[1] < KEEP_BELOW * enough)];
        // Probabilities are at most one; lengths and turns have no bound known beforehand.
        if wave % 16 == 15 {
            scale = engine.max().max(largest);
        }
        converged = wave > 0 && last[1] <= relative_change * scale;
        if converged {
            break;
        }
    }
    let tables = engine.tables();
    Ok(Evaluation { values: tables.values, change: tables.seen, converged })
}

fn evaluation_costs(lattice: &LatticeMdp, rotation: f64, step: impl Fn(&Region) -> StepCosts<f64>) -> StageCosts<f64> {
    StageCosts { rotation, discount: 1.0, steps: lattice.parts.steps().map(step).collect() }
}

/// Checks the size of a policy table, and that the lattice has all its actions.
fn check_policy(lattice: &LatticeMdp, policy: &[u8]) -> Result<()> {
    check_length("policy", lattice, policy.len())?;
    // Not `Iterator::max`, which the compiler does not vectorise.
    let largest = policy.iter().fold(0, |largest, action| if *action > largest { *action } else { largest });
    let most = lattice.parts.motions().len() as u8;
    if largest <= most { Ok(()) } else { Err(Error::parameter("policy", largest, "must be an action of the lattice")) }
}

fn check_length(name: &'static str, lattice: &LatticeMdp, found: usize) -> Result<()> {
    let expected = lattice.parts.shape.states();
    if found == expected { Ok(()) } else { Err(Error::Length { name, expected, found }) }
}
