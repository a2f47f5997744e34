//! Evaluation of a policy: probability of reaching the target, expected length, expected number of turns.
//!
//! The chain of the policy is evaluated by the sweeps of the solver, with other costs, no discount, and zero as the
//! start: the iterates grow towards the smallest solution, which is the right one even where the policy never ends.

use crate::error::{Error, Result};
use crate::lattice::engine::Engine;
use crate::lattice::kernel::{StageCosts, StepCosts};
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{Region, outcome};

/// Limit on the passes of an evaluation.
const MAX_PASSES: u64 = 2000;

/// Relative change that ends the passes: the largest change over the largest possible (or found) value.
const RELATIVE_CHANGE: f64 = 1e-6;

/// A number for every state, in table layout.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The number.
    pub values: Vec<f32>,
    /// Upper bound on the residual of the evaluation equation after the last pass.
    pub change: f64,
    /// Whether the residual was small enough before the limit on passes.
    pub converged: bool,
}

/// Probability that the policy (table layout) reaches the target.
pub fn success(lattice: &LatticeMdp, policy: &[u8]) -> Result<Evaluation> {
    let mut terminal = [0.0; outcome::CODES];
    terminal[outcome::TARGET as usize] = 1.0;
    terminal[outcome::AT_TARGET as usize] = 1.0;
    evaluate(lattice, policy, 0.0, |_| StepCosts { cost: 0.0, terminal })
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
    let costs = &StageCosts { rotation, discount: 1.0, steps: lattice.parts.regions.iter().map(step).collect() };
    let states = lattice.parts.shape.states();
    if policy.len() != states {
        return Err(Error::Length { name: "policy", expected: states, found: policy.len() });
    }
    let mut engine = Engine::<f32>::new(lattice, &lattice.terminal_masks, costs, 0.0, Some(policy));
    let terminal = costs.steps.iter().flat_map(|step| step.terminal);
    let largest = terminal.fold(costs.rotation, f64::max);
    let mut change = f64::INFINITY;
    let mut converged = false;
    let mut scale = largest;
    for pass in 1..=MAX_PASSES {
        change = engine.pass(RELATIVE_CHANGE * scale);
        // Probabilities are at most one; lengths and turns have no bound known beforehand.
        scale = if pass % 8 == 0 { engine.max().max(largest) } else { largest };
        converged = change <= RELATIVE_CHANGE * scale;
        if converged {
            break;
        }
    }
    Ok(Evaluation { values: engine.tables(0.0).values, change, converged })
}
