//! W from values: the convolution along the headings, strip by strip.

use crate::bellman::larger;
use crate::lattice::halo::{Halo, Values};
use crate::lattice::kernel::Vectorized;
#[cfg(target_arch = "x86_64")]
use crate::lattice::kernel::is_portable;
use crate::lattice::lanes::Lanes;
use crate::lattice::parts::LANES;
use crate::lattice::real::Real;
use crate::lattice::sector::{PassInputs, Sector};
use crate::lattice::turns::Turns;
use crate::stop::StopFlag;

/// Computes W of a sector that stores it whole, from values in table layout.
pub(crate) fn convolve_all<T: Vectorized>(
    sector: &mut Sector<T>,
    halo: &Halo<T>,
    inputs: PassInputs<'_, T>,
    table: &[f32],
    stop: &StopFlag,
) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && !is_portable() {
        // SAFETY: the processor has AVX2.
        return unsafe { convolve_all_avx2(sector, halo, inputs, table, stop) };
    }
    convolve_columns::<T, [T; LANES]>(sector, halo, inputs, table, stop);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn convolve_all_avx2<T: Vectorized>(
    sector: &mut Sector<T>,
    halo: &Halo<T>,
    inputs: PassInputs<'_, T>,
    table: &[f32],
    stop: &StopFlag,
) {
    convolve_columns::<T, T::Vector>(sector, halo, inputs, table, stop);
}

#[inline(always)]
fn convolve_columns<T: Vectorized, V: Lanes<T>>(
    sector: &mut Sector<T>,
    halo: &Halo<T>,
    inputs: PassInputs<'_, T>,
    table: &[f32],
    stop: &StopFlag,
) {
    let (arc, shape) = (sector.arc, inputs.lattice.parts.shape);
    let mut values = halo.strip_buffer(arc.count);
    let read = vec![true; inputs.turns.count()];
    for u in 0..sector.extent[0] {
        stop.check();
        let place = sector.place(u);
        for first in (0..sector.extent[1]).step_by(LANES) {
            let points: [usize; LANES] = std::array::from_fn(|lane| {
                let v = (first + lane).min(sector.extent[1] - 1);
                let (i, j) = if arc.direction.is_vertical() { (v, place) } else { (place, v) };
                (i * shape.ny + j) * shape.headings * 2
            });
            for (bevel, values) in values.iter_mut().enumerate() {
                let below = halo.first(bevel);
                for (q, row) in values.iter_mut().enumerate() {
                    let heading =
                        (arc.first + q + shape.headings * (1 + below / shape.headings) - below) % shape.headings;
                    for lane in 0..LANES {
                        row[lane] = T::of(f64::from(table[points[lane] + heading * 2 + bevel]));
                    }
                    // Beyond the last point.
                    row[(sector.extent[1] - first).min(LANES)..].fill(inputs.costs.outside());
                }
            }
            let at = sector.column(u + sector.pad[0]) + sector.pad[1] + first;
            convolve::<T, V, false>(sector, at, halo, &values, (inputs.turns, &read));
        }
    }
}

/// Stores W of a strip, whose rows begin at `at`, from the values by bevel, for the turns that are read. With `COMPARE`
/// returns the largest change.
#[inline(always)]
pub(crate) fn convolve<T: Vectorized, V: Lanes<T>, const COMPARE: bool>(
    sector: &mut Sector<T>,
    at: usize,
    halo: &Halo<T>,
    values: &Values<T>,
    (turns, read): (&Turns<T>, &[bool]),
) -> f64 {
    let mut most = V::splat(T::default());
    for (turn, bevel, kernel) in turns.all() {
        if !read[turn] {
            continue;
        }
        let rows = w_rows_mut(sector, at, turn, bevel).filter_map(|row| row.first_chunk_mut());
        most = kernel.store::<V, COMPARE>(&values[bevel], halo.first(bevel), rows, most);
    }
    let mut changes = [T::default(); LANES];
    most.store(&mut changes);
    let mut largest = 0.0;
    for change in changes {
        largest = larger(largest, change.widen());
    }
    largest
}

/// The rows of W for steps with a turn that arrive with a bevel, by heading.
#[inline(always)]
fn w_rows_mut<T: Real>(sector: &mut Sector<T>, at: usize, turn: usize, bevel: usize) -> impl Iterator<Item = &mut [T]> {
    let (width, count) = (sector.width(), sector.arc.count);
    sector.convolved[at + (turn * count * 2 + bevel) * width..].chunks_mut(2 * width).take(count)
}
