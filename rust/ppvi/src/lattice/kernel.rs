//! The inner loops of a sweep, over one row of grid points each.
//!
//! Written so that the compiler turns them into vector code. Rows are separate arguments, not fields: so the compiler
//! knows that they do not overlap. There are no fused multiply-adds: so every processor gives the same bits.

use crate::lattice::real::Real;

/// Rows are padded to a multiple of this many grid points.
pub(crate) const LANES: usize = 16;

/// In a row of ended steps: the step goes on. Every cost of a step that ends is zero or more.
pub(crate) const GOES_ON: f64 = -1.0;

/// The numbers a backup needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Numbers<T> {
    /// Cost of a step that goes on.
    pub step: T,
    /// Cost of turning.
    pub rotation: T,
    /// Discount factor.
    pub discount: T,
    /// Q-value by outcome code 1..=5; what a read of a place outside the grid gives is at 6.
    pub ended: [T; 7],
}

impl<T: Real> Numbers<T> {
    pub(crate) fn outside(&self) -> T {
        self.ended[6]
    }

    pub(crate) fn cast<S: Real>(&self) -> Numbers<S> {
        let cast = |value: T| S::of(value.widen());
        Numbers {
            step: cast(self.step),
            rotation: cast(self.rotation),
            discount: cast(self.discount),
            ended: self.ended.map(cast),
        }
    }
}

/// Backs up one row of states for both bevels in place, taking the better action.
///
/// `to_*` are E V(s') of the steps that arrive with either bevel, `ended_*` their Q-values where they end.
#[allow(clippy::too_many_arguments)]
#[inline(always)]
pub(crate) fn back_up_row<T: Real>(
    minus: &mut [T],
    plus: &mut [T],
    change: &mut [T],
    ended_minus: &[T],
    ended_plus: &[T],
    to_minus: &[T],
    to_plus: &[T],
    numbers: &Numbers<T>,
) {
    let n = change.len();
    let (minus, plus, ended_minus, ended_plus) = (&mut minus[..n], &mut plus[..n], &ended_minus[..n], &ended_plus[..n]);
    let (to_minus, to_plus) = (&to_minus[..n], &to_plus[..n]);
    let Numbers { step, rotation, discount, .. } = *numbers;
    let zero = T::default();
    for v in 0..n {
        let (a, b) = (ended_minus[v], ended_plus[v]);
        let q_minus = if a < zero { step + discount * to_minus[v] } else { a };
        let q_plus = if b < zero { step + discount * to_plus[v] } else { b };
        let (turn_to_plus, turn_to_minus) = (q_plus + rotation, q_minus + rotation);
        let new_minus = if turn_to_plus < q_minus { turn_to_plus } else { q_minus };
        let new_plus = if turn_to_minus < q_plus { turn_to_minus } else { q_plus };
        let (a, b) = ((new_minus - minus[v]).magnitude(), (new_plus - plus[v]).magnitude());
        let larger = if a > b { a } else { b };
        change[v] = if larger > change[v] { larger } else { change[v] };
        minus[v] = new_minus;
        plus[v] = new_plus;
    }
}

/// The same for a given policy; `turns_*` says in which states the needle is turned.
#[allow(clippy::too_many_arguments)]
#[inline(always)]
pub(crate) fn follow_row<T: Real>(
    minus: &mut [T],
    plus: &mut [T],
    change: &mut [T],
    ended_minus: &[T],
    ended_plus: &[T],
    to_minus: &[T],
    to_plus: &[T],
    turns_minus: &[u8],
    turns_plus: &[u8],
    numbers: &Numbers<T>,
) {
    let n = change.len();
    let (minus, plus, ended_minus, ended_plus) = (&mut minus[..n], &mut plus[..n], &ended_minus[..n], &ended_plus[..n]);
    let (to_minus, to_plus, turns_minus, turns_plus) =
        (&to_minus[..n], &to_plus[..n], &turns_minus[..n], &turns_plus[..n]);
    let Numbers { step, rotation, discount, .. } = *numbers;
    let zero = T::default();
    for v in 0..n {
        let (a, b) = (ended_minus[v], ended_plus[v]);
        let q_minus = if a < zero { step + discount * to_minus[v] } else { a };
        let q_plus = if b < zero { step + discount * to_plus[v] } else { b };
        let new_minus = if turns_minus[v] != 0 { q_plus + rotation } else { q_minus };
        let new_plus = if turns_plus[v] != 0 { q_minus + rotation } else { q_plus };
        let (a, b) = ((new_minus - minus[v]).magnitude(), (new_plus - plus[v]).magnitude());
        let larger = if a > b { a } else { b };
        change[v] = if larger > change[v] { larger } else { change[v] };
        minus[v] = new_minus;
        plus[v] = new_plus;
    }
}

/// The bilinear mean over the four grid points around a displaced position.
#[inline(always)]
pub(crate) fn blend_row<T: Real>(out: &mut [T], a: &[T], b: &[T], c: &[T], d: &[T], weights: [T; 4]) {
    let n = out.len();
    let (a, b, c, d) = (&a[..n], &b[..n], &c[..n], &d[..n]);
    for v in 0..n {
        out[v] = (weights[0] * a[v] + weights[1] * b[v]) + (weights[2] * c[v] + weights[3] * d[v]);
    }
}

/// `out = noise[0] taps[h] + sum over m of noise[m] (taps[h - m] + taps[h + m])`, where h = noise.len() - 1.
#[inline(always)]
pub(crate) fn convolve_row<'a, T: Real>(out: &mut [T], noise: &[T], tap: impl Fn(usize) -> &'a [T]) {
    if let &[p0, p1, p2] = noise {
        return convolve_five(out, tap(0), tap(1), tap(2), tap(3), tap(4), [p0, p1, p2]);
    }
    let centre = noise.len() - 1;
    for (out, value) in out.iter_mut().zip(tap(centre)) {
        *out = noise[0] * *value;
    }
    for (m, &p) in noise.iter().enumerate().skip(1) {
        for ((out, below), above) in out.iter_mut().zip(tap(centre - m)).zip(tap(centre + m)) {
            *out = *out + p * (*below + *above);
        }
    }
}

/// The noise of the thesis: two heading steps to each side.
#[inline(always)]
fn convolve_five<T: Real>(out: &mut [T], a: &[T], b: &[T], c: &[T], d: &[T], e: &[T], noise: [T; 3]) {
    let n = out.len();
    let (a, b, c, d, e) = (&a[..n], &b[..n], &c[..n], &d[..n], &e[..n]);
    for v in 0..n {
        out[v] = noise[0] * c[v] + (noise[1] * (b[v] + d[v]) + noise[2] * (a[v] + e[v]));
    }
}
