//! Vectors for x86 processors with AVX2: eight numbers of single precision, or twice four of double precision.
//!
//! # Safety
//!
//! These types are only used in functions that are entered where the processor has AVX2 (`backup::sweep`). That is what
//! every `unsafe` here relies on; loads and stores go through references to whole arrays.

use std::arch::x86_64::*;

use crate::lattice::lanes::{Lanes, Narrow};
use crate::lattice::parts::{LANES, outcome};

/// Eight numbers of single precision.
#[derive(Clone, Copy)]
pub(crate) struct Single(__m256);

/// Eight numbers of double precision, in two halves.
#[derive(Clone, Copy)]
pub(crate) struct Double([__m256d; 2]);

/// Bytes as integers.
#[inline(always)]
fn integers(bytes: &[u8; LANES]) -> __m256i {
    // SAFETY: see the module.
    unsafe { _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(i64::from_le_bytes(*bytes))) }
}

/// All bits set where a byte is zero.
#[inline(always)]
fn are_zero(bytes: &[u8; LANES]) -> __m256i {
    // SAFETY: see the module.
    unsafe { _mm256_cmpeq_epi32(integers(bytes), _mm256_setzero_si256()) }
}

impl Lanes<f32> for Single {
    #[inline(always)]
    fn splat(value: f32) -> Self {
        // SAFETY: see the module.
        Single(unsafe { _mm256_set1_ps(value) })
    }

    #[inline(always)]
    fn load(from: &[f32; LANES]) -> Self {
        // SAFETY: see the module.
        Single(unsafe { _mm256_loadu_ps(from.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, to: &mut [f32; LANES]) {
        // SAFETY: see the module.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) };
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: see the module.
        Single(unsafe { _mm256_add_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: see the module.
        Single(unsafe { _mm256_mul_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn minimum(self, other: Self) -> Self {
        // SAFETY: see the module.
        Single(unsafe { _mm256_min_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn min_with_argmin(self, other: Self) -> Self {
        // SAFETY: see the module.
        Single(unsafe {
            let less = _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0);
            _mm256_or_ps(_mm256_min_ps(self.0, other.0), _mm256_and_ps(less, _mm256_set1_ps(-0.0)))
        })
    }

    #[inline(always)]
    fn or_terminal(self, codes: &[u8; LANES], terminal: &[f32; outcome::CODES]) -> Self {
        // SAFETY: see the module.
        Single(unsafe {
            let terminal = _mm256_permutevar8x32_ps(Self::load(terminal).0, integers(codes));
            _mm256_blendv_ps(terminal, self.0, _mm256_castsi256_ps(are_zero(codes)))
        })
    }

    #[inline(always)]
    fn or_rotated(self, rotated: Self, mask: &[u8; LANES]) -> Self {
        // SAFETY: see the module.
        Single(unsafe { _mm256_blendv_ps(rotated.0, self.0, _mm256_castsi256_ps(are_zero(mask))) })
    }

    #[inline(always)]
    fn larger_change(self, old: Self, most: Self) -> Self {
        // SAFETY: see the module.
        Single(unsafe {
            let change = _mm256_andnot_ps(_mm256_set1_ps(-0.0), _mm256_sub_ps(self.0, old.0));
            _mm256_max_ps(change, most.0)
        })
    }

    #[inline(always)]
    fn limited(self, most: f32) -> Self {
        // SAFETY: see the module.
        Single(unsafe { _mm256_min_ps(_mm256_max_ps(self.0, _mm256_setzero_ps()), _mm256_set1_ps(most)) })
    }

    #[inline(always)]
    fn narrow(self) -> Single {
        self
    }

    type Narrow = Single;

    #[inline(always)]
    fn larger_finite(self, other: Self) -> Self {
        // SAFETY: see the module.
        Single(unsafe {
            let finite = _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, _mm256_set1_ps(f32::INFINITY));
            _mm256_max_ps(_mm256_and_ps(self.0, finite), other.0)
        })
    }

    #[inline(always)]
    fn transpose([a, b, c, d, e, f, g, h]: [Self; LANES]) -> [Self; LANES] {
        // SAFETY: see the module.
        unsafe {
            // Pairs of rows, then fours, then eights.
            let (ab, ab_high) = (_mm256_unpacklo_ps(a.0, b.0), _mm256_unpackhi_ps(a.0, b.0));
            let (cd, cd_high) = (_mm256_unpacklo_ps(c.0, d.0), _mm256_unpackhi_ps(c.0, d.0));
            let (ef, ef_high) = (_mm256_unpacklo_ps(e.0, f.0), _mm256_unpackhi_ps(e.0, f.0));
            let (gh, gh_high) = (_mm256_unpacklo_ps(g.0, h.0), _mm256_unpackhi_ps(g.0, h.0));
            let (a0, e0) = (_mm256_shuffle_ps::<0x44>(ab, cd), _mm256_shuffle_ps::<0x44>(ef, gh));
            let (a1, e1) = (_mm256_shuffle_ps::<0xEE>(ab, cd), _mm256_shuffle_ps::<0xEE>(ef, gh));
            let (a2, e2) = (_mm256_shuffle_ps::<0x44>(ab_high, cd_high), _mm256_shuffle_ps::<0x44>(ef_high, gh_high));
            let (a3, e3) = (_mm256_shuffle_ps::<0xEE>(ab_high, cd_high), _mm256_shuffle_ps::<0xEE>(ef_high, gh_high));
            [
                Single(_mm256_permute2f128_ps::<0x20>(a0, e0)),
                Single(_mm256_permute2f128_ps::<0x20>(a1, e1)),
                Single(_mm256_permute2f128_ps::<0x20>(a2, e2)),
                Single(_mm256_permute2f128_ps::<0x20>(a3, e3)),
                Single(_mm256_permute2f128_ps::<0x31>(a0, e0)),
                Single(_mm256_permute2f128_ps::<0x31>(a1, e1)),
                Single(_mm256_permute2f128_ps::<0x31>(a2, e2)),
                Single(_mm256_permute2f128_ps::<0x31>(a3, e3)),
            ]
        }
    }
}

impl Narrow for Single {
    #[inline(always)]
    fn split(self) -> (Self, [u8; LANES]) {
        // SAFETY: see the module.
        unsafe {
            let signs = _mm256_srli_epi32::<31>(_mm256_castps_si256(self.0));
            let words = _mm_packus_epi32(_mm256_castsi256_si128(signs), _mm256_extracti128_si256::<1>(signs));
            let bytes = _mm_cvtsi128_si64(_mm_packus_epi16(words, words)).to_le_bytes();
            (Single(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)), bytes)
        }
    }
}

impl Double {
    /// An operation on both halves.
    #[inline(always)]
    fn halves(self, other: Self, operation: impl Fn(__m256d, __m256d) -> __m256d) -> Self {
        Double([operation(self.0[0], other.0[0]), operation(self.0[1], other.0[1])])
    }

    /// `self` where a byte is zero, else `other`.
    #[inline(always)]
    fn where_zero(self, bytes: &[u8; LANES], other: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            let zero = are_zero(bytes);
            let low = _mm256_castsi256_pd(_mm256_cvtepi32_epi64(_mm256_castsi256_si128(zero)));
            let high = _mm256_castsi256_pd(_mm256_cvtepi32_epi64(_mm256_extracti128_si256::<1>(zero)));
            let [a, b] = other.0;
            Double([_mm256_blendv_pd(a, self.0[0], low), _mm256_blendv_pd(b, self.0[1], high)])
        }
    }
}

impl Lanes<f64> for Double {
    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: see the module.
        Double([unsafe { _mm256_set1_pd(value) }; 2])
    }

    #[inline(always)]
    fn load(from: &[f64; LANES]) -> Self {
        // SAFETY: see the module.
        Double(unsafe { [_mm256_loadu_pd(from.as_ptr()), _mm256_loadu_pd(from[LANES / 2..].as_ptr())] })
    }

    #[inline(always)]
    fn store(self, to: &mut [f64; LANES]) {
        // SAFETY: see the module.
        unsafe {
            _mm256_storeu_pd(to.as_mut_ptr(), self.0[0]);
            _mm256_storeu_pd(to[LANES / 2..].as_mut_ptr(), self.0[1]);
        }
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: see the module.
        self.halves(other, |a, b| unsafe { _mm256_add_pd(a, b) })
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: see the module.
        self.halves(other, |a, b| unsafe { _mm256_mul_pd(a, b) })
    }

    #[inline(always)]
    fn minimum(self, other: Self) -> Self {
        // SAFETY: see the module.
        self.halves(other, |a, b| unsafe { _mm256_min_pd(a, b) })
    }

    #[inline(always)]
    fn min_with_argmin(self, other: Self) -> Self {
        // SAFETY: see the module.
        self.halves(other, |a, b| unsafe {
            let less = _mm256_cmp_pd::<_CMP_LT_OQ>(a, b);
            _mm256_or_pd(_mm256_min_pd(a, b), _mm256_and_pd(less, _mm256_set1_pd(-0.0)))
        })
    }

    #[inline(always)]
    fn or_terminal(self, codes: &[u8; LANES], terminal: &[f64; outcome::CODES]) -> Self {
        self.where_zero(codes, Self::load(&codes.map(|code| terminal[usize::from(code) % outcome::CODES])))
    }

    #[inline(always)]
    fn or_rotated(self, rotated: Self, mask: &[u8; LANES]) -> Self {
        self.where_zero(mask, rotated)
    }

    #[inline(always)]
    fn larger_change(self, old: Self, most: Self) -> Self {
        // SAFETY: see the module.
        let change = self.halves(old, |a, b| unsafe { _mm256_andnot_pd(_mm256_set1_pd(-0.0), _mm256_sub_pd(a, b)) });
        // SAFETY: see the module.
        change.halves(most, |a, b| unsafe { _mm256_max_pd(a, b) })
    }

    #[inline(always)]
    fn limited(self, most: f64) -> Self {
        // SAFETY: see the module.
        let positive = self.halves(Self::splat(0.0), |a, b| unsafe { _mm256_max_pd(a, b) });
        positive.minimum(Self::splat(most))
    }

    #[inline(always)]
    fn narrow(self) -> Single {
        // SAFETY: see the module.
        Single(unsafe { _mm256_set_m128(_mm256_cvtpd_ps(self.0[1]), _mm256_cvtpd_ps(self.0[0])) })
    }

    type Narrow = Single;

    #[inline(always)]
    fn larger_finite(self, other: Self) -> Self {
        // SAFETY: see the module.
        self.halves(other, |a, b| unsafe {
            let finite = _mm256_cmp_pd::<_CMP_LT_OQ>(a, _mm256_set1_pd(f64::INFINITY));
            _mm256_max_pd(_mm256_and_pd(a, finite), b)
        })
    }

    #[inline(always)]
    fn transpose(rows: [Self; LANES]) -> [Self; LANES] {
        let mut numbers = [[0.0; LANES]; LANES];
        for (row, numbers) in rows.into_iter().zip(&mut numbers) {
            row.store(numbers);
        }
        let mut columns = rows;
        for (column, numbers) in columns.iter_mut().zip(<[f64; LANES]>::transpose(numbers)) {
            *column = Self::load(&numbers);
        }
        columns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::real::Real;

    /// Every operation of a vector against that of arrays, on numbers that are not negative.
    #[target_feature(enable = "avx2")]
    fn agrees<T: Real, V: Lanes<T>>(seed: u32) {
        let mut state = seed;
        let mut next = |n: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) % n
        };
        let codes: [u8; LANES] = std::array::from_fn(|_| next(8) as u8);
        let mut numbers = || -> [T; LANES] {
            std::array::from_fn(|_| if next(9) == 0 { T::of(f64::INFINITY) } else { T::of(f64::from(next(7)) / 3.0) })
        };
        let (a, b, terminal) = (numbers(), numbers(), numbers());
        let mask = codes.map(|code| code % 2);
        let (u, v) = (V::load(&a), V::load(&b));
        let array = |vector: V| {
            let mut array = [T::default(); LANES];
            vector.store(&mut array);
            array.map(|value| (value.widen().to_bits(), value.widen().is_nan()))
        };
        let same = |vector: V, expected: [T; LANES]| {
            let expected = expected.map(|value| (value.widen().to_bits(), value.widen().is_nan()));
            assert!(array(vector).iter().zip(&expected).all(|(x, y)| x == y || x.1 && y.1));
        };
        same(u, a);
        same(V::splat(b[0]), [b[0]; LANES]);
        same(u.add(v), a.add(b));
        same(u.mul(v), a.mul(b));
        same(u.minimum(v), a.minimum(b));
        same(u.min_with_argmin(v), a.min_with_argmin(b));
        let (low, high) = (T::of(0.25), T::of(0.5));
        let signed = a.map(|x| x - high);
        same(V::load(&signed).limited(low), signed.limited(low));
        same(u.or_terminal(&codes, &terminal), a.or_terminal(&codes, &terminal));
        same(u.or_rotated(v, &mask), a.or_rotated(b, &mask));
        // The difference of infinities is no number, which no sweep has.
        let finite = |x: T| if x.widen() < f64::INFINITY { x } else { high };
        let (p, q, most) = (a.map(finite), b.map(finite), [low; LANES]);
        same(V::load(&p).larger_change(V::load(&q), V::load(&most)), p.larger_change(q, most));
        let mut narrow = [0.0; LANES];
        u.narrow().store(&mut narrow);
        assert_eq!(narrow, a.narrow());
        same(u.larger_finite(v), a.larger_finite(b));
        let marked = u.min_with_argmin(v).narrow().split();
        marked.0.store(&mut narrow);
        assert_eq!((narrow, marked.1), a.min_with_argmin(b).narrow().split());
        let rows: [[T; LANES]; LANES] = std::array::from_fn(|_| numbers());
        let columns = V::transpose(rows.each_ref().map(|row| V::load(row)));
        columns.into_iter().zip(<[T; LANES]>::transpose(rows)).for_each(|(column, expected)| same(column, expected));
    }

    #[test]
    fn vectors_compute_the_bits_of_arrays() {
        if !is_x86_feature_detected!("avx2") {
            return;
        }
        for seed in 0..1000 {
            // SAFETY: AVX2 has been detected.
            unsafe {
                agrees::<f32, Single>(seed);
                agrees::<f64, Double>(seed);
            }
        }
    }
}
