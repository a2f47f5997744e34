//! The convolution of values over headings with the kernels of the regions.

use crate::lattice::heading::HeadingKernel;
use crate::lattice::kernel::{convolve_five, convolve_pairs, convolve_taps};
use crate::lattice::lanes::Lanes;
use crate::lattice::parts::{LANES, LatticeParts};
use crate::lattice::real::Real;

/// The kernels of all regions, for the convolutions of a solve.
#[derive(Debug, Clone)]
pub(crate) struct Turns<T> {
    /// Different kernels, by arriving bevel.
    kernels: Vec<[Convolution<T>; 2]>,
    /// The kernel of each motion and region, in the order of [`LatticeParts::steps`].
    of_step: Vec<usize>,
    /// By arriving bevel: how many headings below and above are read.
    pub beyond: [[usize; 2]; 2],
}

impl<T: Real> Turns<T> {
    pub(crate) fn new(parts: &LatticeParts) -> Self {
        let mut different: Vec<&[HeadingKernel; 2]> = Vec::new();
        let mut number = |turn| {
            different.iter().position(|known| *known == turn).unwrap_or_else(|| {
                different.push(turn);
                different.len() - 1
            })
        };
        let of_step = parts.steps().map(|region| number(&region.turn)).collect();
        let beyond = [0, 1].map(|bevel| {
            let reach = different.iter().map(|turn| turn[bevel].reach());
            reach.fold([0, 0], |most, reach| [most[0].max(reach[0]), most[1].max(reach[1])])
        });
        let kernels = different.into_iter().map(|turn| turn.each_ref().map(Convolution::new)).collect();
        Turns { kernels, of_step, beyond }
    }

    /// Number of different kernels.
    pub(crate) fn count(&self) -> usize {
        self.kernels.len()
    }

    /// The number of the kernel of a motion in a region, by their number among [`LatticeParts::steps`].
    #[inline(always)]
    pub(crate) fn of_step(&self, step: usize) -> usize {
        self.of_step[step]
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
        let taps: Vec<(i64, T)> = kernel.taps().iter().map(|(cell, p)| (i64::from(*cell), T::of(*p))).collect();
        Convolution { form: Form::of(kernel), taps }
    }

    /// How many roundings a value passes through in the convolution: one product, and at most so many sums.
    pub(crate) fn operations(&self) -> usize {
        match &self.form {
            Form::Five { .. } => 4,
            Form::Pairs { pairs, .. } => 2 + pairs.len(),
            // The first sum adds to zero.
            Form::Taps => self.taps.len(),
        }
    }

    /// Stores in each of `rows` the sum over the taps of weight times value; `at` is the index in `values` of the
    /// heading of the first row. With `COMPARE` returns the larger of `most` and the largest change of a row.
    #[inline(always)]
    pub(crate) fn store<'a, V: Lanes<T>, const COMPARE: bool>(
        &self,
        values: &[[T; LANES]],
        at: usize,
        rows: impl Iterator<Item = &'a mut [T; LANES]>,
        mut most: V,
    ) -> V
    where
        T: 'a,
    {
        let from = |cell: i64| &values[(at as i64 + cell) as usize..];
        match &self.form {
            Form::Five { centre, distance, noise } => {
                let noise = noise.map(V::splat);
                if *distance == 1 {
                    // The noise of the thesis. Windows compile to a third fewer instructions than five slices.
                    for (row, taps) in rows.zip(from(centre - 2).windows(5)) {
                        if let [a, b, c, d, e] = taps {
                            most = put::<T, V, COMPARE>(row, convolve_five::<T, V>([a, b, c, d, e], noise), most);
                        }
                    }
                    return most;
                }
                let [a, b, c, d, e] = [-2, -1, 0, 1, 2].map(|side| from(centre + side * distance));
                let taps = a.iter().zip(b).zip(c).zip(d).zip(e);
                for (row, ((((a, b), c), d), e)) in rows.zip(taps) {
                    most = put::<T, V, COMPARE>(row, convolve_five::<T, V>([a, b, c, d, e], noise), most);
                }
            }
            Form::Pairs { centre, middle, pairs } => {
                // Not `for_each`: what is inside of a closure is compiled without the vectors of the processor.
                for (row, q) in rows.zip((at as i64 + centre) as usize..) {
                    most = put::<T, V, COMPARE>(row, convolve_pairs::<T, V>(values, q, *middle, pairs), most);
                }
            }
            Form::Taps => {
                for (row, q) in rows.zip(at..) {
                    most = put::<T, V, COMPARE>(row, convolve_taps::<T, V>(values, q, &self.taps), most);
                }
            }
        }
        most
    }
}

/// Stores a row. With `COMPARE` returns the larger of `most` and its change.
#[inline(always)]
fn put<T: Real, V: Lanes<T>, const COMPARE: bool>(row: &mut [T; LANES], new: V, most: V) -> V {
    let most = if COMPARE { new.larger_change(V::load(row), most) } else { most };
    new.store(row);
    most
}

impl<T: Real> Form<T> {
    fn of(kernel: &HeadingKernel) -> Self {
        let (Some((low, _)), Some((high, _))) = (kernel.taps().first(), kernel.taps().last()) else {
            return Form::Taps;
        };
        let mirrored = || kernel.taps().iter().rev().map(|(cell, p)| (low + high - cell, *p));
        if (low + high) % 2 != 0 || !kernel.taps().iter().copied().eq(mirrored()) {
            return Form::Taps;
        }
        let centre = (low + high) / 2;
        let upper: Vec<(i64, T)> = kernel
            .taps()
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
