//! The arithmetic of a sweep, for a strip of [`LANES`] neighbouring grid points at a time.
//!
//! Numbers of a strip are vectors ([`Lanes`]).

use crate::lattice::lanes::Lanes;
use crate::lattice::real::Real;
use crate::lattice::{LANES, outcome};

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

/// Q-values of steps, given E V(s') of those that go on.
#[inline(always)]
pub(crate) fn q_values<T: Real, V: Lanes<T>>(to: V, codes: &[u8; LANES], step: &Step<T>, discount: T) -> V {
    V::splat(step.cost).add(V::splat(discount).mul(to)).or_ended(codes, &step.ended)
}

/// The bilinear mean of the four grid points around a displaced position.
#[inline(always)]
pub(crate) fn blend<T: Real, V: Lanes<T>>([a, b, c, d]: [V; 4], weights: [T; 4]) -> V {
    let [wa, wb, wc, wd] = weights;
    let near = V::splat(wa).mul(a).add(V::splat(wb).mul(b));
    near.add(V::splat(wc).mul(c).add(V::splat(wd).mul(d)))
}

/// `noise[0] taps[h] + sum over m of noise[m] (taps[h - m] + taps[h + m])`, where h = noise.len() - 1.
#[inline(always)]
pub(crate) fn convolve<T: Real, V: Lanes<T>>(taps: &[[T; LANES]], noise: &[T]) -> V {
    let centre = noise.len() - 1;
    let mut out = V::splat(noise[0]).mul(V::load(&taps[centre]));
    for (m, p) in noise.iter().enumerate().skip(1) {
        let (below, above) = (V::load(&taps[centre - m]), V::load(&taps[centre + m]));
        out = out.add(V::splat(*p).mul(below.add(above)));
    }
    out
}

/// The same for the noise of the thesis: two heading steps to each side.
#[inline(always)]
pub(crate) fn convolve_five<T: Real, V: Lanes<T>>([a, b, c, d, e]: &[[T; LANES]; 5], noise: [V; 3]) -> V {
    let [a, b, c, d, e] = [V::load(a), V::load(b), V::load(c), V::load(d), V::load(e)];
    let [p0, p1, p2] = noise;
    p0.mul(c).add(p1.mul(b.add(d)).add(p2.mul(a.add(e))))
}
