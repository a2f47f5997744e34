//! Vectors of [`LANES`] numbers, one for each grid point of a strip.
//!
//! The loops of a sweep are written with these, once for all processors: arrays are the vectors that every processor
//! has, [`avx2`](crate::lattice::avx2) has those of x86. Both compute the same bits: there are no fused multiply-adds.

use crate::lattice::parts::{LANES, outcome};
use crate::lattice::real::Real;

/// A vector of numbers; operations are element by element.
pub(crate) trait Lanes<T>: Copy {
    fn splat(value: T) -> Self;
    fn load(from: &[T; LANES]) -> Self;
    fn store(self, to: &mut [T; LANES]);
    fn add(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    /// The minimum of `self` and `other`; `other` where neither is smaller.
    fn minimum(self, other: Self) -> Self;
    /// [`Lanes::minimum`] with the argument that attains it in the sign: minus for `self`, plus for `other`. For
    /// numbers that are not negative.
    fn min_with_argmin(self, other: Self) -> Self;
    /// `self` for steps that continue, otherwise the entry of `terminal` for the code of the step.
    fn or_terminal(self, codes: &[u8; LANES], terminal: &[T; outcome::CODES]) -> Self;
    /// `rotated` where `mask` is not zero, otherwise `self`.
    fn or_rotated(self, rotated: Self, mask: &[u8; LANES]) -> Self;
    /// The larger of |self - old| and `most`.
    fn larger_change(self, old: Self, most: Self) -> Self;
    /// At least zero and at most this.
    fn limited(self, most: T) -> Self;
    /// In single precision.
    fn narrow(self) -> Self::Narrow;
    type Narrow: Narrow;
    /// `self` where it is finite and larger, else `other`.
    fn larger_finite(self, other: Self) -> Self;
    /// Rows become columns.
    fn transpose(rows: [Self; LANES]) -> [Self; LANES];
}

/// A vector of single precision.
pub(crate) trait Narrow: Lanes<f32> {
    /// The numbers without their signs, and 1 where there was one.
    fn split(self) -> (Self, [u8; LANES]);
}

impl Narrow for [f32; LANES] {
    #[inline(always)]
    fn split(self) -> (Self, [u8; LANES]) {
        (self.map(f32::abs), self.map(|number| u8::from(number.is_sign_negative())))
    }
}

impl<T: Real> Lanes<T> for [T; LANES] {
    #[inline(always)]
    fn splat(value: T) -> Self {
        [value; LANES]
    }

    #[inline(always)]
    fn load(from: &[T; LANES]) -> Self {
        *from
    }

    #[inline(always)]
    fn store(self, to: &mut [T; LANES]) {
        *to = self;
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        std::array::from_fn(|l| self[l] + other[l])
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        std::array::from_fn(|l| self[l] * other[l])
    }

    #[inline(always)]
    fn minimum(self, other: Self) -> Self {
        std::array::from_fn(|l| if self[l] < other[l] { self[l] } else { other[l] })
    }

    #[inline(always)]
    fn min_with_argmin(self, other: Self) -> Self {
        std::array::from_fn(|l| if self[l] < other[l] { self[l].negative() } else { other[l] })
    }

    #[inline(always)]
    fn or_terminal(self, codes: &[u8; LANES], terminal: &[T; outcome::CODES]) -> Self {
        std::array::from_fn(|l| match usize::from(codes[l]) % outcome::CODES {
            0 => self[l],
            code => terminal[code],
        })
    }

    #[inline(always)]
    fn or_rotated(self, rotated: Self, mask: &[u8; LANES]) -> Self {
        std::array::from_fn(|l| if mask[l] != 0 { rotated[l] } else { self[l] })
    }

    #[inline(always)]
    fn larger_change(self, old: Self, most: Self) -> Self {
        std::array::from_fn(|l| {
            let change = (self[l] - old[l]).magnitude();
            if change > most[l] { change } else { most[l] }
        })
    }

    #[inline(always)]
    fn limited(self, most: T) -> Self {
        let zero = T::default();
        self.map(|value| if value > zero { if value < most { value } else { most } } else { zero })
    }

    #[inline(always)]
    fn narrow(self) -> [f32; LANES] {
        self.map(|value| value.widen() as f32)
    }

    type Narrow = [f32; LANES];

    #[inline(always)]
    fn larger_finite(self, other: Self) -> Self {
        let finite = |value: T| value < T::of(f64::INFINITY);
        std::array::from_fn(|l| if self[l] > other[l] && finite(self[l]) { self[l] } else { other[l] })
    }

    #[inline(always)]
    fn transpose(rows: [Self; LANES]) -> [Self; LANES] {
        std::array::from_fn(|column| std::array::from_fn(|row| rows[row][column]))
    }
}
