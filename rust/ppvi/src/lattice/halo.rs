//! Copies of the headings next to a sector, taken from their owners after these are swept.
//!
//! A sector never reads another one during a sweep, only its halo; that is what makes the sectors of a wave independent
//! and the result the same for any number of threads.

use multiversion::multiversion;

use crate::bellman::larger;
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
    /// The present values of the owners, `[place][strip][plane][LANES]`.
    fresh: Array<T>,
    /// The values with which the W of each strip was computed.
    used: Array<T>,
    /// For each W that reads the halo: the planes that it reads, with their weights.
    rows: Vec<Vec<(usize, T)>>,
    /// `[place][strip]`: the change of the W of a strip if it were computed from the present values. Some may be too
    /// small, but not below `enough`.
    changes: Vec<f64>,
    /// Changes above this number are not computed to the end.
    enough: f64,
    /// Whether a sweep of all strips has used `fresh`, and `used` is outdated.
    all_taken: bool,
}

/// V of a strip by bevel: the halo below, the sector, the halo above.
pub(crate) type Values<T> = [Vec<[T; LANES]>; 2];

impl<T: Vectorized> Halo<T> {
    /// A halo of `start` values.
    pub(crate) fn new(sector: &Sector<T>, turns: &Turns<T>, start: T, padding: T) -> Self {
        let count = sector.arc.count as i64;
        let of_bevel = |(bevel, [below, above]): (usize, [usize; 2])| {
            (-(below as i64)..0).chain(count..count + above as i64).map(move |q| (q, bevel))
        };
        let planes: Vec<_> = turns.beyond.into_iter().enumerate().flat_map(of_bevel).collect();
        let strips = sector.strips();
        let mut fresh = Array::filled(start, sector.extent[0] * strips * planes.len() * LANES);
        // Without turns there are no planes.
        for column in fresh.chunks_exact_mut((strips * planes.len() * LANES).max(1)) {
            for plane in column[(strips - 1) * planes.len() * LANES..].chunks_exact_mut(LANES) {
                plane[sector.extent[1] - (strips - 1) * LANES..].fill(padding);
            }
        }
        let mut used = Array::any(fresh.len());
        used.copy_from_slice(&fresh);
        let rows = rows(&planes, sector.arc.count, turns);
        let changes = vec![0.0; sector.extent[0] * strips];
        Halo {
            planes,
            beyond: turns.beyond,
            strips,
            padding,
            fresh,
            used,
            rows,
            changes,
            enough: f64::INFINITY,
            all_taken: false,
        }
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

    /// Whether present values would change the W of a strip by more than `level`.
    #[inline(always)]
    pub(crate) fn is_due(&self, place: usize, strip: usize, level: f64) -> bool {
        self.changes[place * self.strips + strip] > level
    }

    /// Copies the present values of a strip to where they belong.
    #[inline(always)]
    pub(crate) fn take(&mut self, place: usize, strip: usize, values: &mut Values<T>) {
        let (number, size) = (place * self.strips + strip, self.planes.len() * LANES);
        let range = number * size..(number + 1) * size;
        self.used[range.clone()].copy_from_slice(&self.fresh[range]);
        self.changes[number] = 0.0;
        self.copy_to(&self.fresh, number, values);
    }

    /// Copies the present values of a strip to where they belong, in a sweep that takes all strips.
    #[inline(always)]
    pub(crate) fn take_one_of_all(&self, place: usize, strip: usize, values: &mut Values<T>) {
        self.copy_to(&self.fresh, place * self.strips + strip, values);
    }

    /// Ends a sweep that has taken all strips.
    pub(crate) fn end_of_all(&mut self) {
        self.changes.fill(0.0);
        self.all_taken = true;
    }

    /// Copies the values of a strip that were used last to where they belong.
    #[inline(always)]
    pub(crate) fn take_again(&self, place: usize, strip: usize, values: &mut Values<T>) {
        self.copy_to(if self.all_taken { &self.fresh } else { &self.used }, place * self.strips + strip, values);
    }

    #[inline(always)]
    fn copy_to(&self, from: &[T], number: usize, values: &mut Values<T>) {
        let size = self.planes.len() * LANES;
        let mut from = from[number * size..][..size].as_chunks::<LANES>().0;
        for (values, [below, above]) in values.iter_mut().zip(self.beyond) {
            let high = values.len() - above;
            copy_few(&mut values[..below], &from[..below]);
            copy_few(&mut values[high..], &from[below..below + above]);
            from = &from[below + above..];
        }
    }

    /// Refreshes the halo of `sectors[of]` from the strips that the last sweeps of other sectors have backed up.
    /// Returns the largest change of W that this would make; a change above `enough` may be larger.
    pub(crate) fn pull(&mut self, sectors: &[Sector<T>], of: usize, headings: usize, enough: f64) -> f64 {
        if self.planes.is_empty() {
            return 0.0;
        }
        self.enough = enough;
        let all = std::mem::take(&mut self.all_taken);
        if all {
            std::mem::swap(&mut self.fresh, &mut self.used);
        }
        let target = &sectors[of].arc;
        let mut pulled = vec![false; self.changes.len()];
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
            if pairs.is_empty() {
                continue;
            }
            let (planes, strips, padding) = (self.planes.len(), self.strips, self.padding);
            let to = To { planes, strips, padding, all, pulled: &mut pulled };
            if target.direction.is_vertical() == source.arc.direction.is_vertical() {
                copy_planes(source, &mut self.fresh, to, &pairs);
            } else {
                transpose_planes(source, &mut self.fresh, to, &pairs);
            }
        }
        if all {
            // While changes are large, those of one column will do.
            let first = self.changes.len() / self.strips / 2 * self.strips;
            let column = first..first + self.strips;
            self.changes.fill(0.0);
            let rough = self.compare(|number| column.contains(&number), enough);
            if rough > enough {
                self.changes.fill(rough);
                return rough;
            }
        }
        self.compare(|number| all || pulled[number], enough)
    }

    /// The largest change of W that present values would make.
    pub(crate) fn change(&mut self) -> f64 {
        let rough: Vec<bool> = self.changes.iter().map(|change| *change > self.enough).collect();
        self.compare(|number| rough[number], f64::INFINITY)
    }

    /// Computes the changes of chosen strips, up to `enough`, and returns the largest of all.
    fn compare(&mut self, chosen: impl Fn(usize) -> bool, enough: f64) -> f64 {
        let size = (self.planes.len() * LANES).max(1);
        let strips = self.fresh.chunks_exact(size).zip(self.used.chunks_exact(size));
        for (number, ((fresh, used), change)) in strips.zip(&mut self.changes).enumerate() {
            if chosen(number) {
                *change = largest_change(fresh, used, &self.rows, enough);
            }
        }
        self.changes.iter().copied().fold(0.0, larger)
    }
}

/// For each W of a sector with `count` headings that reads its halo: the planes that it reads, with their weights.
fn rows<T: Real>(planes: &[(i64, usize)], count: usize, turns: &Turns<T>) -> Vec<Vec<(usize, T)>> {
    let mut rows = Vec::new();
    for (_, bevel, kernel) in turns.all() {
        for row in 0..count as i64 {
            let planes = planes.iter().enumerate().filter(|(_, (_, of))| *of == bevel);
            let weight = |q: i64| kernel.taps.iter().find(|(cell, _)| row + cell == q).map(|(_, weight)| *weight);
            let taps: Vec<(usize, T)> = planes.filter_map(|(plane, (q, _))| Some((plane, weight(*q)?))).collect();
            if !taps.is_empty() {
                rows.push(taps);
            }
        }
    }
    rows
}

/// The layout of a halo.
struct To<'a, T> {
    planes: usize,
    strips: usize,
    padding: T,
    /// Whether all strips are copied, also those that the last sweep of the source has left out.
    all: bool,
    /// `[place][strip]`: whether something was copied to the strip.
    pulled: &'a mut [bool],
}

/// Copies edges of a sector to a halo of the same orientation; `pairs` are planes from and to.
fn copy_planes<T: Real>(
    source: &Sector<T>,
    to: &mut [T],
    To { planes, all, pulled, .. }: To<'_, T>,
    pairs: &[(usize, usize)],
) {
    let from = source.edges.chunks_exact(source.ends.planes() * LANES);
    let flags = source.swept.iter().zip(pulled);
    for ((from, to), (swept, pulled)) in from.zip(to.chunks_exact_mut(planes * LANES)).zip(flags) {
        if all || *swept {
            *pulled = true;
            for (edge, plane) in pairs {
                to[plane * LANES..][..LANES].copy_from_slice(&from[edge * LANES..][..LANES]);
            }
        }
    }
}

/// Copies edges of a sector to a halo in which its places are the grid points of strips; `pairs` are planes from and
/// to.
fn transpose_planes<T: Vectorized>(source: &Sector<T>, to: &mut [T], layout: To<'_, T>, pairs: &[(usize, usize)]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { transpose_avx2(source, to, layout, pairs) };
    }
    transpose_squares::<T, [T; LANES]>(source, to, layout, pairs);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn transpose_avx2<T: Vectorized>(source: &Sector<T>, to: &mut [T], layout: To<'_, T>, pairs: &[(usize, usize)]) {
    transpose_squares::<T, T::Vector>(source, to, layout, pairs);
}

/// A square of grid points at a time.
#[inline(always)]
fn transpose_squares<T: Real, V: Lanes<T>>(
    source: &Sector<T>,
    to: &mut [T],
    To { planes, strips, padding, all, pulled }: To<'_, T>,
    pairs: &[(usize, usize)],
) {
    let [places, length] = source.extent;
    let edges = source.edges.as_chunks::<LANES>().0;
    let from_planes = source.ends.planes();
    let from_stride = source.strips() * from_planes;
    let to = to.as_chunks_mut::<LANES>().0;
    for place in 0..strips {
        for strip in 0..source.strips() {
            let (row, column) = (place * LANES, strip * LANES);
            let swept = |place: usize| source.swept[place * source.strips() + strip];
            if !all && !(row..places.min(row + LANES)).any(swept) {
                continue;
            }
            (column..length.min(column + LANES)).for_each(|column| pulled[column * strips + place] = true);
            for (edge, plane) in pairs {
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

/// The largest change, over `rows`, of sums of weighted planes of a strip. A change above `enough` may be larger.
#[multiversion(targets("x86_64+avx+avx2"))]
fn largest_change<T: Real>(new: &[T], old: &[T], rows: &[Vec<(usize, T)>], enough: f64) -> f64 {
    let (new, old) = (new.as_chunks::<LANES>().0, old.as_chunks::<LANES>().0);
    let mut most = 0.0;
    for taps in rows {
        let mut sum = [T::default(); LANES];
        for (plane, weight) in taps {
            for l in 0..LANES {
                sum[l] = sum[l] + *weight * (new[*plane][l] - old[*plane][l]);
            }
        }
        let mut largest = T::default();
        for change in sum {
            let change = change.magnitude();
            largest = if change > largest { change } else { largest };
        }
        most = larger(most, largest.widen());
        if most > enough {
            break;
        }
    }
    most
}
