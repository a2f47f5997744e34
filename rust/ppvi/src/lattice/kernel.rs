//! The inner loops of a sweep, over one row of grid points each.
//!
//! Written so that the compiler turns them into vector code. Rows are separate arguments, not fields: so the compiler
//! knows that they do not overlap. There are no fused multiply-adds: so every processor gives the same bits.

use crate::lattice::outcome;
use crate::lattice::real::Real;

/// The numbers a backup needs.
#[derive(Debug, Clone)]
pub(crate) struct Numbers<T> {
    /// Cost of turning.
    pub rotation: T,
    /// Discount factor.
    pub discount: T,
    /// By region; there is at least one.
    pub steps: Vec<Step<T>>,
}

/// The numbers of a step in a region.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step<T> {
    /// Cost of a step that goes on.
    pub cost: T,
    /// Q-value by outcome code; the first is not used.
    pub ended: [T; outcome::CODES],
}

impl<T: Real> Numbers<T> {
    pub(crate) fn outside(&self) -> T {
        self.steps[0].ended[outcome::OUTSIDE as usize]
    }

    pub(crate) fn cast<S: Real>(&self) -> Numbers<S> {
        let cast = |value: T| S::of(value.widen());
        Numbers {
            rotation: cast(self.rotation),
            discount: cast(self.discount),
            steps: self.steps.iter().map(|step| Step { cost: cast(step.cost), ended: step.ended.map(cast) }).collect(),
        }
    }
}

/// Q-values of a row of steps that go on; `to` is E V(s').
#[inline(always)]
pub(crate) fn go_on_row<T: Real>(q: &mut [T], to: &[T], step: T, discount: T) {
    let to = &to[..q.len()];
    for v in 0..q.len() {
        q[v] = step + discount * to[v];
    }
}

/// Values of a row of states for both bevels by the better action; with `NOTE` the action is noted.
#[inline(always)]
pub(crate) fn better_row<T: Real, const NOTE: bool>(
    [minus, plus]: [&mut [T]; 2],
    [act_minus, act_plus]: [&mut [u8]; 2],
    [q_minus, q_plus]: [&[T]; 2],
    rotation: T,
) {
    let n = minus.len();
    let (plus, q_minus, q_plus) = (&mut plus[..n], &q_minus[..n], &q_plus[..n]);
    let noted = if NOTE { n } else { 0 };
    let (act_minus, act_plus) = (&mut act_minus[..noted], &mut act_plus[..noted]);
    for v in 0..n {
        let (turn_to_plus, turn_to_minus) = (q_plus[v] + rotation, q_minus[v] + rotation);
        minus[v] = if turn_to_plus < q_minus[v] { turn_to_plus } else { q_minus[v] };
        plus[v] = if turn_to_minus < q_plus[v] { turn_to_minus } else { q_plus[v] };
        if NOTE {
            act_minus[v] = u8::from(turn_to_plus < q_minus[v]);
            act_plus[v] = u8::from(turn_to_minus < q_plus[v]);
        }
    }
}

/// Values of a row of states by a given policy, which says in which of them the needle is turned.
#[inline(always)]
pub(crate) fn follow_row<T: Real>(
    [minus, plus]: [&mut [T]; 2],
    [turns_minus, turns_plus]: [&[u8]; 2],
    [q_minus, q_plus]: [&[T]; 2],
    rotation: T,
) {
    let n = minus.len();
    let (plus, q_minus, q_plus) = (&mut plus[..n], &q_minus[..n], &q_plus[..n]);
    let (turns_minus, turns_plus) = (&turns_minus[..n], &turns_plus[..n]);
    for v in 0..n {
        minus[v] = if turns_minus[v] != 0 { q_plus[v] + rotation } else { q_minus[v] };
        plus[v] = if turns_plus[v] != 0 { q_minus[v] + rotation } else { q_plus[v] };
    }
}

/// Q-values of a row of steps that go on to the bilinear mean of the four grid points around a displaced position.
#[inline(always)]
pub(crate) fn blend_row<T: Real>(q: &mut [T], [a, b, c, d]: [&[T]; 4], weights: [T; 4], step: T, discount: T) {
    let n = q.len();
    let (a, b, c, d) = (&a[..n], &b[..n], &c[..n], &d[..n]);
    for v in 0..n {
        let mean = (weights[0] * a[v] + weights[1] * b[v]) + (weights[2] * c[v] + weights[3] * d[v]);
        q[v] = step + discount * mean;
    }
}

/// `largest[v]` grows to `row[v]`.
#[inline(always)]
pub(crate) fn larger_row<T: Real>(largest: &mut [T], row: &[T]) {
    let row = &row[..largest.len()];
    for v in 0..row.len() {
        largest[v] = if row[v] > largest[v] { row[v] } else { largest[v] };
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
