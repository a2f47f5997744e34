//! The two floating-point types a lattice is solved in.

use std::ops::{Add, Mul, Sub};

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
}

macro_rules! real {
    ($type:ty) => {
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
        }
    };
}
real!(f32);
real!(f64);
