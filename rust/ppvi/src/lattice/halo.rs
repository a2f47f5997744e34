//! Copies of the headings next to a sector, taken from their owners before the sector is swept.
//!
//! A sector never reads another one during a sweep, only its halo; that is what makes the sectors of a wave independent
//! and the result the same for any number of threads.

use multiversion::multiversion;

use crate::lattice::kernel::Vectorized;
use crate::lattice::lanes::Lanes;
use crate::lattice::parts::LANES;
use crate::lattice::plane::copy_few;
use crate::lattice::real::Real;
use crate::lattice::sector::Sector;
use crate::lattice::turns::Turns;
use crate::memory::Array;

/// The headings beyond the ends of a sector that it reads.
pub(crate) struct Halo<T: Copy> {
    /// By plane: the heading in the sector's own numbers (negative, or from its count on), and the bevel.
    planes: Vec<(i64, usize)>,
    /// By bevel: planes below and above the sector.
    beyond: [[usize; 2]; 2],
    strips: usize,
    /// The value of the padding.
    padding: T,
    /// `[place][strip][plane][LANES]`.
    values: Array<T>,
    /// The values before the last refresh.
    before: Array<T>,
}

/// V of a strip by bevel: the halo below, the sector, the halo above.
pub(crate) type Values<T> = [Vec<[T; LANES]>; 2];

impl<T: Vectorized> Halo<T> {
    /// A halo of `start` values; `beyond` are the headings that the sector reads below and above its own, by bevel.
    pub(crate) fn new(sector: &Sector<T>, beyond: [[usize; 2]; 2], start: T, padding: T) -> Self {
        let count = sector.arc.count as i64;
        let of_bevel = |(bevel, [below, above]): (usize, [usize; 2])| {
            (-(below as i64)..0).chain(count..count + above as i64).map(move |q| (q, bevel))
        };
        let planes: Vec<_> = beyond.into_iter().enumerate().flat_map(of_bevel).collect();
        let strips = sector.strips();
        let mut values = Array::filled(start, sector.extent[0] * strips * planes.len() * LANES);
        // Without turns there are no planes.
        for column in values.chunks_exact_mut((strips * planes.len() * LANES).max(1)) {
            for plane in column[(strips - 1) * planes.len() * LANES..].chunks_exact_mut(LANES) {
                plane[sector.extent[1] - (strips - 1) * LANES..].fill(padding);
            }
        }
        // The first pull writes all of it.
        let before = Array::any(values.len());
        Halo { planes, beyond, strips, padding, values, before }
    }

    /// Room for the values of a strip.
    pub(crate) fn strip_buffer(&self, count: usize) -> Values<T> {
        self.beyond.map(|[below, above]| vec![[T::default(); LANES]; below + count + above])
    }

    /// The sector's own values.
    #[inline(always)]
    pub(crate) fn own<'a>(&self, values: &'a mut Values<T>, count: usize) -> [&'a mut [[T; LANES]]; 2] {
        let [minus, plus] = values;
        [&mut minus[self.beyond[0][0]..][..count], &mut plus[self.beyond[1][0]..][..count]]
    }

    /// The index, in the values of a bevel, of the first heading of the sector.
    #[inline(always)]
    pub(crate) fn first(&self, bevel: usize) -> usize {
        self.beyond[bevel][0]
    }

    /// Copies a strip to where it belongs.
    #[inline(always)]
    pub(crate) fn copy_to(&self, place: usize, strip: usize, values: &mut Values<T>) {
        let size = self.planes.len() * LANES;
        let mut from = self.values[(place * self.strips + strip) * size..][..size].as_chunks::<LANES>().0;
        for (values, [below, above]) in values.iter_mut().zip(self.beyond) {
            let high = values.len() - above;
            copy_few(&mut values[..below], &from[..below]);
            copy_few(&mut values[high..], &from[below..below + above]);
            from = &from[below + above..];
        }
    }

    /// Refreshes the halo of `sectors[of]` from the owners of its headings.
    pub(crate) fn pull(&mut self, sectors: &[Sector<T>], of: usize, headings: usize) {
        if self.planes.is_empty() {
            return;
        }
        std::mem::swap(&mut self.values, &mut self.before);
        let target = &sectors[of].arc;
        for source in sectors {
            let plane = |(plane, (q, bevel)): (usize, &(i64, usize))| {
                let heading = (target.first as i64 + q).rem_euclid(headings as i64) as usize;
                let q = (heading + headings - source.arc.first) % headings;
                (q < source.arc.count).then(|| {
                    let Some(edge) = source.ends.plane(q, *bevel) else { unreachable!("halos reach as far as edges") };
                    (edge, plane)
                })
            };
            let pairs: Vec<(usize, usize)> = self.planes.iter().enumerate().filter_map(plane).collect();
            let to = To { planes: self.planes.len(), strips: self.strips, padding: self.padding };
            if target.direction.is_vertical() == source.arc.direction.is_vertical() {
                copy_planes(source, &mut self.values, to, &pairs);
            } else {
                transpose_planes(source, &mut self.values, to, &pairs);
            }
        }
    }

    /// Largest change that the last refresh made to the W that a sector with `count` headings reads. A change above
    /// `threshold` is computed from one column only, as a lower bound.
    pub(crate) fn interface_change(&self, count: usize, turns: &Turns<T>, threshold: f64) -> f64 {
        let mut rows = Vec::new();
        for (_, bevel, kernel) in turns.all() {
            for row in 0..count as i64 {
                let planes = self.planes.iter().enumerate().filter(|(_, (_, of))| *of == bevel);
                let weight = |q: i64| kernel.taps.iter().find(|(cell, _)| row + cell == q).map(|(_, weight)| *weight);
                let taps: Vec<(usize, T)> = planes.filter_map(|(plane, (q, _))| Some((plane, weight(*q)?))).collect();
                if !taps.is_empty() {
                    rows.push(taps);
                }
            }
        }
        if rows.is_empty() {
            return 0.0;
        }
        let planes = self.planes.len();
        let column = self.strips * planes * LANES;
        let sample = self.values.len() / column / 2 * column;
        let sample = sample..sample + column;
        let rough = largest_change(&self.values[sample.clone()], &self.before[sample], planes, &rows);
        if rough > threshold { rough } else { largest_change(&self.values, &self.before, planes, &rows) }
    }
}

/// The layout of a halo.
#[derive(Clone, Copy)]
struct To<T> {
    planes: usize,
    strips: usize,
    padding: T,
}

/// Copies edges of a sector to a halo of the same orientation; `pairs` are planes from and to.
fn copy_planes<T: Real>(source: &Sector<T>, to: &mut [T], To { planes, .. }: To<T>, pairs: &[(usize, usize)]) {
    let from = source.edges.chunks_exact(source.ends.planes() * LANES);
    for (from, to) in from.zip(to.chunks_exact_mut(planes * LANES)) {
        for (edge, plane) in pairs {
            to[plane * LANES..][..LANES].copy_from_slice(&from[edge * LANES..][..LANES]);
        }
    }
}

/// Copies edges of a sector to a halo in which its places are the grid points of strips; `pairs` are planes from and
/// to.
fn transpose_planes<T: Vectorized>(source: &Sector<T>, to: &mut [T], layout: To<T>, pairs: &[(usize, usize)]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { transpose_avx2(source, to, layout, pairs) };
    }
    transpose_squares::<T, [T; LANES]>(source, to, layout, pairs);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn transpose_avx2<T: Vectorized>(source: &Sector<T>, to: &mut [T], layout: To<T>, pairs: &[(usize, usize)]) {
    transpose_squares::<T, T::Vector>(source, to, layout, pairs);
}

/// A square of grid points at a time.
#[inline(always)]
fn transpose_squares<T: Real, V: Lanes<T>>(
    source: &Sector<T>,
    to: &mut [T],
    To { planes, strips, padding }: To<T>,
    pairs: &[(usize, usize)],
) {
    let [places, length] = source.extent;
    let edges = source.edges.as_chunks::<LANES>().0;
    let from_planes = source.ends.planes();
    let from_stride = source.strips() * from_planes;
    let to = to.as_chunks_mut::<LANES>().0;
    for place in 0..strips {
        for strip in 0..source.strips() {
            for (edge, plane) in pairs {
                let (row, column) = (place * LANES, strip * LANES);
                let mut rows = [V::splat(padding); LANES];
                for l in 0..LANES {
                    if row + l < places {
                        rows[l] = V::load(&edges[(row + l) * from_stride + strip * from_planes + edge]);
                    }
                }
                let columns = V::transpose(rows);
                for l in 0..LANES {
                    if column + l < length {
                        columns[l].store(&mut to[((column + l) * strips + place) * planes + plane]);
                    }
                }
            }
        }
    }
}

/// The largest change, over `rows`, of sums of weighted planes in `[strip][planes][LANES]` arrays.
#[multiversion(targets("x86_64+avx+avx2"))]
fn largest_change<T: Real>(new: &[T], old: &[T], planes: usize, rows: &[Vec<(usize, T)>]) -> f64 {
    let mut largest = [T::default(); LANES];
    let (new, old) = (new.as_chunks::<LANES>().0, old.as_chunks::<LANES>().0);
    for (new, old) in new.chunks_exact(planes).zip(old.chunks_exact(planes)) {
        for taps in rows {
            let mut sum = [T::default(); LANES];
            for (plane, weight) in taps {
                for l in 0..LANES {
                    sum[l] = sum[l] + *weight * (new[*plane][l] - old[*plane][l]);
                }
            }
            for l in 0..LANES {
                let change = sum[l].magnitude();
                largest[l] = if change > largest[l] { change } else { largest[l] };
            }
        }
    }
    largest.iter().fold(0.0, |max, change| f64::max(max, change.widen()))
}
