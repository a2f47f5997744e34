//! The two floating-point types a lattice is solved in.

use std::ops::{Add, Mul, Sub};

use crate::lattice::lanes::Lanes;
use crate::memory::Plain;

/// Single or double precision.
pub(crate) trait Real:
    Plain + Send + Sync + PartialOrd + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + 'static
{
    /// Distance from 1 to the next number.
    const EPSILON: f64;
    fn of(value: f64) -> Self;
    fn widen(self) -> f64;
    fn magnitude(self) -> Self;
    fn negative(self) -> Self;
    /// The fastest vectors, where they can be had: AVX2 on x86.
    type Vector: Lanes<Self>;
}

macro_rules! real {
    ($type:ty, $vector:ty) => {
        impl Real for $type {
            const EPSILON: f64 = <$type>::EPSILON as f64;
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $type
            }
            #[inline(always)]
            fn widen(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn magnitude(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn negative(self) -> Self {
                -self
            }
            #[cfg(target_arch = "x86_64")]
            type Vector = $vector;
            #[cfg(not(target_arch = "x86_64"))]
            type Vector = [$type; crate::lattice::LANES];
        }
    };
}
real!(f32, crate::lattice::avx2::Single);
real!(f64, crate::lattice::avx2::Double);
