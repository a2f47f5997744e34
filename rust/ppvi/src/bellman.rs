//! The Bellman operator, the exact Bellman residual, and the arithmetic of infinite values.
//!
//! The value of an improper state is infinite ([`crate::proper_states`]). V = TV holds there trivially, so a change
//! from infinity to infinity counts as zero.

use rayon::prelude::*;

use crate::mdp::Mdp;
use crate::proper::proper_states;
use crate::stop::StopFlag;

/// States that one task of a parallel pass backs up.
pub(crate) const CHUNK: usize = 4096;

/// Returns |new - old|, and 0 for equal infinities.
#[inline]
pub fn change(new: f64, old: f64) -> f64 {
    if new == old { 0.0 } else { (new - old).abs() }
}

/// Returns the larger number, or NaN if one of them is: unlike `f64::max`, which would drop it.
#[inline]
pub fn larger(a: f64, b: f64) -> f64 {
    if a >= b || a.is_nan() { a } else { b }
}

/// Exact Bellman residual and size of a value function V.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// max |TV - V|.
    pub residual: f64,
    /// Largest finite |V|.
    pub max_value: f64,
}

impl Check {
    /// Combines the checks of two sets of states.
    pub fn join(self, other: Check) -> Check {
        Check { residual: larger(self.residual, other.residual), max_value: larger(self.max_value, other.max_value) }
    }
}

/// Writes TV to `next` and the greedy policy to `policy`, and returns the check of V (not of TV).
///
/// Runs on the current rayon pool. A maximum does not depend on the order of its arguments, so the result is the same
/// for any number of threads.
///
/// # Panics
/// If `values`, `next` and `policy` do not have one element per state.
pub fn bellman_operator(mdp: &impl Mdp, values: &[f64], next: &mut [f64], policy: &mut [u32]) -> Check {
    let stop = StopFlag::current();
    let chunks = next.par_chunks_mut(CHUNK).zip(policy.par_chunks_mut(CHUNK)).enumerate();
    chunks
        .map(|(chunk, (next, policy))| {
            stop.check();
            check_chunk(mdp, values, chunk * CHUNK, policy, |i, v| next[i] = v)
        })
        .reduce(|| Check { residual: 0.0, max_value: 0.0 }, Check::join)
}

/// Writes the greedy policy with respect to `values` to `policy`, and returns the check of `values`.
///
/// # Panics
/// If `values` and `policy` do not have one element per state.
pub fn greedy(mdp: &impl Mdp, values: &[f64], policy: &mut [u32]) -> Check {
    let stop = StopFlag::current();
    if policy.len() <= CHUNK {
        // On the calling thread, which may belong to no pool.
        return check_chunk(mdp, values, 0, policy, |_, _| ());
    }
    let chunks = policy.par_chunks_mut(CHUNK).enumerate();
    chunks
        .map(|(chunk, policy)| {
            stop.check();
            check_chunk(mdp, values, chunk * CHUNK, policy, |_, _| ())
        })
        .reduce(|| Check { residual: 0.0, max_value: 0.0 }, Check::join)
}

fn check_chunk(
    mdp: &impl Mdp,
    values: &[f64],
    begin: usize,
    policy: &mut [u32],
    mut store: impl FnMut(usize, f64),
) -> Check {
    let mut check = Check { residual: 0.0, max_value: 0.0 };
    // Numbers that are not negative are ordered as their bits, and NaN is above infinity.
    let mut residual = 0;
    for (index, best) in policy.iter_mut().enumerate() {
        let old = values[begin + index];
        let (new, action) = mdp.backup(begin + index, values);
        *best = action as u32;
        store(index, new);
        residual = change(new, old).to_bits().max(residual);
        if old.is_finite() {
            check.max_value = check.max_value.max(old.abs());
        }
    }
    check.residual = f64::from_bits(residual);
    check
}

/// Returns the start values V0: [`Mdp::absorbing_value`] for absorbing states, infinity for improper states (searched
/// for with discount 1 only), and [`Mdp::start_value`] for all others.
pub fn initial_values(mdp: &impl Mdp) -> Vec<f64> {
    let (start, stop) = (mdp.start_value(), StopFlag::current());
    let value = |state| {
        stop.check();
        if mdp.actions(state) == 0 { mdp.absorbing_value(state) } else { start }
    };
    let mut values: Vec<f64> = (0..mdp.states()).map(value).collect();
    if mdp.discount() == 1.0 {
        for (value, proper) in values.iter_mut().zip(proper_states(mdp)) {
            if !proper {
                *value = f64::INFINITY;
            }
        }
    }
    values
}
