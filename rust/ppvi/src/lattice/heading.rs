//! How a step changes the heading: a distribution on whole heading cells, and its convolution with values.

use crate::error::{Error, Result};
use crate::lattice::kernel::{convolve_five, convolve_pairs, convolve_taps};
use crate::lattice::lanes::Lanes;
use crate::lattice::parts::{LANES, Region};
use crate::lattice::real::Real;

/// Largest change of the heading in a step, in cells.
const MOST_CELLS: i32 = 1 << 20;

/// A fraction of a cell below which a change of the heading counts as whole, so that rounding does not split it.
const WHOLE: f64 = 1e-9;

/// Change of the heading in a step, in heading cells: a distribution on whole cells.
#[derive(Debug, Clone, PartialEq)]
pub struct HeadingKernel {
    /// Cells, increasing, with their probabilities, which are positive.
    taps: Vec<(i32, f64)>,
}

impl HeadingKernel {
    /// Makes a kernel from cells and their probabilities, in any order; cells of probability zero are left out.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a probability that is negative or not finite, probabilities whose sum is not one, and
    /// a cell that is repeated or more than a million cells away.
    pub fn new(taps: Vec<(i32, f64)>) -> Result<Self> {
        if let Some((_, p)) = taps.iter().find(|(_, p)| !(*p >= 0.0 && p.is_finite())) {
            return Err(Error::parameter("turn", p, "must be finite and not negative"));
        }
        let mut taps: Vec<(i32, f64)> = taps.into_iter().filter(|(_, p)| *p > 0.0).collect();
        taps.sort_by_key(|(cell, _)| *cell);
        let sum = taps.iter().map(|(_, p)| p).sum::<f64>();
        if (sum - 1.0).abs() > 1e-9 {
            return Err(Error::parameter("turn", sum, "must be probabilities with the sum one"));
        }
        if let Some(pair) = taps.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(Error::parameter("turn", pair[0].0, "must have each cell once"));
        }
        if let Some((cell, _)) = taps.iter().find(|(cell, _)| cell.unsigned_abs() > MOST_CELLS.unsigned_abs()) {
            return Err(Error::parameter("turn", cell, "must be at most 2^20 cells"));
        }
        Ok(HeadingKernel { taps })
    }

    /// The distribution on whole cells of a turn by `mean` cells plus symmetric noise: `noise` has P(0), P(+-s),
    /// P(+-2s), ... for a noise step of s = `noise_step` cells.
    ///
    /// Mean and variance are those of the turn with its noise wherever that is possible with whole cells. A value
    /// between two cells is split between them linearly, which keeps the mean and adds a variance of f (1 - f) cells^2
    /// for a fraction f. To undo this, a part of the noise is taken back: with the variance S of the noise, the added
    /// variance E, and e of the turn alone, the noise is used with the weight (S - e) / (S + E - e) and the turn
    /// without noise with the rest. Where S < e, the two cells around the mean have the least variance that whole
    /// cells allow.
    ///
    /// # Errors
    /// The errors of [`HeadingKernel::new`], and [`Error::Parameter`] for numbers that are not finite.
    ///
    /// # Examples
    /// ```
    /// use ppvi::lattice::HeadingKernel;
    ///
    /// let kernel = HeadingKernel::matched(2.5, &[0.5, 0.25], 1.0)?;
    /// let mean: f64 = kernel.taps().iter().map(|(cell, p)| f64::from(*cell) * p).sum();
    /// let variance: f64 = kernel.taps().iter().map(|(cell, p)| (f64::from(*cell) - mean).powi(2) * p).sum();
    /// assert!((mean - 2.5).abs() < 1e-12 && (variance - 0.5).abs() < 1e-12);
    /// # Ok::<(), ppvi::Error>(())
    /// ```
    pub fn matched(mean: f64, noise: &[f64], noise_step: f64) -> Result<Self> {
        let reach = mean.abs() + noise.len() as f64 * noise_step.abs();
        if reach.is_nan() || reach >= f64::from(MOST_CELLS) {
            return Err(Error::parameter("turn", reach, "must be at most 2^20 cells"));
        }
        let sides = |m: usize| if m == 0 { vec![0.0] } else { vec![-(m as f64), m as f64] };
        let noisy = |(m, p): (usize, f64)| sides(m).into_iter().map(move |side| (mean + side * noise_step, p));
        let positions: Vec<(f64, f64)> = noise.iter().copied().enumerate().flat_map(noisy).collect();
        let variance: f64 = positions.iter().map(|(at, p)| p * (at - mean).powi(2)).sum();
        let split: f64 = positions.iter().map(|(at, p)| p * split_variance(*at)).sum();
        let least = split_variance(mean);
        let share = match split {
            0.0 => 1.0,
            _ if variance <= least => 0.0,
            _ => (variance - least) / (variance + split - least),
        };
        let mut taps: Vec<(i32, f64)> = Vec::new();
        let mut put = |at: f64, p: f64| {
            let whole = if (at - at.round()).abs() < WHOLE { at.round() } else { at.floor() };
            let fraction = (at - whole).max(0.0);
            for (cell, p) in [(whole as i32, p * (1.0 - fraction)), (whole as i32 + 1, p * fraction)] {
                match taps.iter_mut().find(|tap| tap.0 == cell) {
                    _ if p == 0.0 => {}
                    Some(tap) => tap.1 += p,
                    None => taps.push((cell, p)),
                }
            }
        };
        positions.iter().for_each(|(at, p)| put(*at, share * p));
        put(mean, 1.0 - share);
        HeadingKernel::new(taps)
    }

    /// Cells, increasing, with their probabilities.
    pub fn taps(&self) -> &[(i32, f64)] {
        &self.taps
    }

    /// How many cells it reaches to either side: downwards, upwards.
    fn reach(&self) -> [usize; 2] {
        let cells = || self.taps.iter().map(|(cell, _)| *cell);
        let [low, high] = [cells().min().unwrap_or(0), cells().max().unwrap_or(0)];
        [low.min(0).unsigned_abs() as usize, high.max(0).unsigned_abs() as usize]
    }
}

/// The variance, cells^2, that splitting a position between two cells adds.
fn split_variance(at: f64) -> f64 {
    let fraction = at - at.floor();
    if (at - at.round()).abs() < WHOLE { 0.0 } else { fraction * (1.0 - fraction) }
}

/// The kernels of all regions, for the convolutions of a solve.
#[derive(Debug, Clone)]
pub(crate) struct Turns<T> {
    /// Different kernels, by arriving bevel.
    kernels: Vec<[Convolution<T>; 2]>,
    /// The kernel of each region.
    of_region: Vec<usize>,
    /// By arriving bevel: how many headings below and above are read.
    pub beyond: [[usize; 2]; 2],
}

impl<T: Real> Turns<T> {
    pub(crate) fn new(regions: &[Region]) -> Self {
        let mut different: Vec<&[HeadingKernel; 2]> = Vec::new();
        let mut number = |turn| {
            different.iter().position(|known| *known == turn).unwrap_or_else(|| {
                different.push(turn);
                different.len() - 1
            })
        };
        let of_region = regions.iter().map(|region| number(&region.turn)).collect();
        let beyond = [0, 1].map(|bevel| {
            let reach = different.iter().map(|turn| turn[bevel].reach());
            reach.fold([0, 0], |most, reach| [most[0].max(reach[0]), most[1].max(reach[1])])
        });
        let kernels = different.into_iter().map(|turn| turn.each_ref().map(Convolution::new)).collect();
        Turns { kernels, of_region, beyond }
    }

    /// Number of different kernels.
    pub(crate) fn count(&self) -> usize {
        self.kernels.len()
    }

    /// The number of the kernel of a region.
    #[inline(always)]
    pub(crate) fn of_region(&self, region: usize) -> usize {
        self.of_region[region]
    }

    /// All kernels: number, arriving bevel, kernel.
    pub(crate) fn all(&self) -> impl Iterator<Item = (usize, usize, &Convolution<T>)> {
        let pairs = self.kernels.iter().enumerate();
        pairs.flat_map(|(number, pair)| pair.iter().enumerate().map(move |(bevel, kernel)| (number, bevel, kernel)))
    }

    /// How many headings are read beyond the ends of a sector, at most.
    pub(crate) fn reach(&self) -> usize {
        self.beyond.into_iter().flatten().max().unwrap_or(0)
    }
}

/// A kernel in the form that is computed fastest.
#[derive(Debug, Clone)]
pub(crate) struct Convolution<T> {
    /// Cells, increasing, with their weights.
    pub taps: Vec<(i64, T)>,
    form: Form<T>,
}

#[derive(Debug, Clone)]
enum Form<T> {
    /// P(0), P(+-d), P(+-2d) around a centre: the noise of the thesis.
    Five { centre: i64, distance: i64, noise: [T; 3] },
    /// Equal weights on both sides of a centre: distances with their weights.
    Pairs { centre: i64, middle: T, pairs: Vec<(i64, T)> },
    /// Any weights.
    Taps,
}

impl<T: Real> Convolution<T> {
    fn new(kernel: &HeadingKernel) -> Self {
        let taps: Vec<(i64, T)> = kernel.taps.iter().map(|(cell, p)| (i64::from(*cell), T::of(*p))).collect();
        Convolution { form: Form::of(kernel), taps }
    }

    /// Stores in each of `rows` the sum over the taps of weight times value; `at` is the index in `values` of the
    /// heading of the first row.
    #[inline(always)]
    pub(crate) fn store<'a, V: Lanes<T>>(
        &self,
        values: &[[T; LANES]],
        at: usize,
        rows: impl Iterator<Item = &'a mut [T; LANES]>,
    ) where
        T: 'a,
    {
        let from = |cell: i64| &values[(at as i64 + cell) as usize..];
        match &self.form {
            Form::Five { centre, distance, noise } => {
                let noise = noise.map(V::splat);
                let [a, b, c, d, e] = [-2, -1, 0, 1, 2].map(|side| from(centre + side * distance));
                let taps = a.iter().zip(b).zip(c).zip(d).zip(e);
                for (row, ((((a, b), c), d), e)) in rows.zip(taps) {
                    convolve_five::<T, V>([a, b, c, d, e], noise).store(row);
                }
            }
            Form::Pairs { centre, middle, pairs } => {
                let mut q = (at as i64 + centre) as usize;
                rows.for_each(|row| {
                    convolve_pairs::<T, V>(values, q, *middle, pairs).store(row);
                    q += 1;
                });
            }
            Form::Taps => {
                let mut q = at;
                rows.for_each(|row| {
                    convolve_taps::<T, V>(values, q, &self.taps).store(row);
                    q += 1;
                });
            }
        }
    }
}

impl<T: Real> Form<T> {
    fn of(kernel: &HeadingKernel) -> Self {
        let (Some((low, _)), Some((high, _))) = (kernel.taps.first(), kernel.taps.last()) else { return Form::Taps };
        let mirrored = || kernel.taps.iter().rev().map(|(cell, p)| (low + high - cell, *p));
        if (low + high) % 2 != 0 || !kernel.taps.iter().copied().eq(mirrored()) {
            return Form::Taps;
        }
        let centre = (low + high) / 2;
        let upper: Vec<(i64, T)> = kernel
            .taps
            .iter()
            .filter(|(cell, _)| *cell >= centre)
            .map(|(cell, p)| (i64::from(cell - centre), T::of(*p)))
            .collect();
        let centre = i64::from(centre);
        match &upper[..] {
            [(0, p0), (one, p1), (two, p2)] if *two == 2 * one => {
                Form::Five { centre, distance: *one, noise: [*p0, *p1, *p2] }
            }
            [(0, middle), pairs @ ..] => Form::Pairs { centre, middle: *middle, pairs: pairs.to_vec() },
            // Zero times the infinite value of an improper state would not be a number.
            _ => Form::Taps,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(kernel: &HeadingKernel) -> [f64; 2] {
        let mean: f64 = kernel.taps().iter().map(|(cell, p)| f64::from(*cell) * p).sum();
        [mean, kernel.taps().iter().map(|(cell, p)| (f64::from(*cell) - mean).powi(2) * p).sum()]
    }

    #[test]
    fn whole_turns_keep_the_noise_as_it_is() {
        let kernel = HeadingKernel::matched(-1.0, &[0.466, 0.24, 0.027], 1.0).unwrap();
        assert_eq!(kernel.taps(), [(-3, 0.027), (-2, 0.24), (-1, 0.466), (0, 0.24), (1, 0.027)]);
        let kernel = HeadingKernel::matched(4.0, &[0.5, 0.0, 0.25], 4.0).unwrap();
        assert_eq!(kernel.taps(), [(-4, 0.25), (4, 0.5), (12, 0.25)]);
    }

    #[test]
    fn mean_and_variance_are_those_of_the_turn_with_its_noise() {
        for mean in [0.0, 0.3, -1.7, 12.5] {
            for (noise, step) in [(vec![0.466, 0.24, 0.027], 1.3), (vec![0.6, 0.2], 2.5), (vec![0.1, 0.45], 0.9)] {
                let variance: f64 =
                    noise.iter().enumerate().map(|(m, p)| 2.0 * p * (m as f64 * step).powi(2)).sum::<f64>();
                let found = moments(&HeadingKernel::matched(mean, &noise, step).unwrap());
                assert!((found[0] - mean).abs() < 1e-12 && (found[1] - variance).abs() < 1e-12, "{mean} {noise:?}");
            }
        }
    }

    #[test]
    fn too_little_noise_leaves_the_two_cells_around_the_mean() {
        let kernel = HeadingKernel::matched(2.25, &[1.0], 1.0).unwrap();
        assert_eq!(kernel.taps(), [(2, 0.75), (3, 0.25)]);
        let kernel = HeadingKernel::matched(2.5, &[0.9, 0.05], 0.1).unwrap();
        assert!((moments(&kernel)[0] - 2.5).abs() < 1e-12 && kernel.taps().len() == 2);
    }

    #[test]
    fn impossible_kernels_are_refused() {
        assert!(HeadingKernel::new(vec![(0, 0.5), (1, 0.6)]).is_err());
        assert!(HeadingKernel::new(vec![(0, 1.5), (1, -0.5)]).is_err());
        assert!(HeadingKernel::new(vec![(0, 0.5), (0, 0.5)]).is_err());
        assert!(HeadingKernel::new(vec![(i32::MAX, 1.0)]).is_err());
        assert!(HeadingKernel::matched(f64::NAN, &[1.0], 1.0).is_err());
        assert!(HeadingKernel::matched(1e300, &[1.0], 1.0).is_err());
    }
}
