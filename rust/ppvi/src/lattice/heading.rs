//! How a step changes the heading: a distribution on whole heading cells.

use crate::error::{Error, Result};

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
    pub(crate) fn reach(&self) -> [usize; 2] {
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
