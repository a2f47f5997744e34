//! The arithmetic of a sweep, for a strip of [`LANES`] neighbouring grid points at a time.
//!
//! StageCosts of a strip are vectors ([`Lanes`]).

#[cfg(target_arch = "x86_64")]
use crate::lattice::avx2;
use crate::lattice::lanes::Lanes;
use crate::lattice::parts::{LANES, outcome};
use crate::lattice::real::Real;

/// Whether tests ask for the vectors that every processor has.
#[cfg(test)]
pub(crate) static PORTABLE: std::sync::atomic::AtomicBool = std::sync::atomic::AtomicBool::new(false);

#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(crate) fn is_portable() -> bool {
    #[cfg(test)]
    return PORTABLE.load(std::sync::atomic::Ordering::Relaxed);
    #[cfg(not(test))]
    false
}

/// A floating-point type with the fastest vectors of the target: AVX2 on x86.
pub(crate) trait Vectorized: Real {
    type Vector: Lanes<Self>;
}

#[cfg(target_arch = "x86_64")]
impl Vectorized for f32 {
    type Vector = avx2::Single;
}

#[cfg(target_arch = "x86_64")]
impl Vectorized for f64 {
    type Vector = avx2::Double;
}

#[cfg(not(target_arch = "x86_64"))]
impl<T: Real> Vectorized for T {
    type Vector = [T; LANES];
}

/// The costs and the discount that a backup needs.
#[derive(Debug, Clone)]
pub(crate) struct StageCosts<T> {
    /// Cost of switching the bevel.
    pub rotation: T,
    /// Discount factor.
    pub discount: T,
    /// `[motion][region]`; there is at least one.
    pub steps: Vec<StepCosts<T>>,
}

/// The costs of a step in a region.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepCosts<T> {
    /// Cost of a step that continues.
    pub cost: T,
    /// Q-value by outcome code; the first is not used.
    pub terminal: [T; outcome::CODES],
}

impl<T: Real> StageCosts<T> {
    pub(crate) fn outside(&self) -> T {
        self.steps[0].terminal[outcome::OUTSIDE as usize]
    }

    pub(crate) fn cast<S: Real>(&self) -> StageCosts<S> {
        let cast = |value: T| S::of(value.widen());
        StageCosts {
            rotation: cast(self.rotation),
            discount: cast(self.discount),
            steps: self
                .steps
                .iter()
                .map(|step| StepCosts { cost: cast(step.cost), terminal: step.terminal.map(cast) })
                .collect(),
        }
    }
}

/// Q-values of steps, given E V(s') of those that go on.
#[inline(always)]
pub(crate) fn q_values<T: Real, V: Lanes<T>>(to: V, codes: &[u8; LANES], step: &StepCosts<T>, discount: T) -> V {
    V::splat(step.cost).add(V::splat(discount).mul(to)).or_terminal(codes, &step.terminal)
}

/// The bilinear mean of the four grid points around a displaced position.
#[inline(always)]
pub(crate) fn blend<T: Real, V: Lanes<T>>([a, b, c, d]: [V; 4], weights: [T; 4]) -> V {
    let [wa, wb, wc, wd] = weights;
    let near = V::splat(wa).mul(a).add(V::splat(wb).mul(b));
    near.add(V::splat(wc).mul(c).add(V::splat(wd).mul(d)))
}

/// `middle values[q] + sum over pairs of weight (values[q - distance] + values[q + distance])`.
#[inline(always)]
pub(crate) fn convolve_pairs<T: Real, V: Lanes<T>>(
    values: &[[T; LANES]],
    q: usize,
    middle: T,
    pairs: &[(i64, T)],
) -> V {
    let mut out = V::splat(middle).mul(V::load(&values[q]));
    for (distance, weight) in pairs {
        let distance = *distance as usize;
        let (below, above) = (V::load(&values[q - distance]), V::load(&values[q + distance]));
        out = out.add(V::splat(*weight).mul(below.add(above)));
    }
    out
}

/// `sum over taps of weight values[q + cell]`.
#[inline(always)]
pub(crate) fn convolve_taps<T: Real, V: Lanes<T>>(values: &[[T; LANES]], q: usize, taps: &[(i64, T)]) -> V {
    let mut out = V::splat(T::default());
    for (cell, weight) in taps {
        out = out.add(V::splat(*weight).mul(V::load(&values[(q as i64 + cell) as usize])));
    }
    out
}

/// The pairs of the noise of the thesis: two noise steps to each side.
#[inline(always)]
pub(crate) fn convolve_five<T: Real, V: Lanes<T>>([a, b, c, d, e]: [&[T; LANES]; 5], noise: [V; 3]) -> V {
    let [a, b, c, d, e] = [V::load(a), V::load(b), V::load(c), V::load(d), V::load(e)];
    let [p0, p1, p2] = noise;
    p0.mul(c).add(p1.mul(b.add(d)).add(p2.mul(a.add(e))))
}
