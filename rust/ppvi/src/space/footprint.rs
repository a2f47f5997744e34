//! What the branches of a step read of the layer in which they end.

use multiversion::multiversion;

use crate::space::kernel::{Order, weights};
use crate::space::layer::Padded;
use crate::space::parts::{SpaceParts, SpaceStep};

/// Points of the interpolation along an axis.
pub(crate) const POINTS: usize = 4;

/// What a branch reads of the layer in which it ends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Footprint {
    /// Number of its path.
    pub rest: u32,
    /// Column of the grid in which it lands; branches with the same one share the weights along z.
    pub column: u32,
    /// Place of the first point relative to the start in the plane of the first direction.
    pub first: i64,
    /// Weights along y and z.
    pub along: [[f32; POINTS]; 2],
    /// Probability, and that of reaching the landing in a direction of the grid.
    pub weight: f32,
    pub probability: f32,
}

/// What starts add whose branches reach their landing, and what the end in a voxel counts, by its code.
pub(crate) type Counts = (f32, [f32; 4]);

/// Where landings are read: the field, its interpolation, the width of its rows, and the place of the first start in a plane.
pub(crate) type Place<'a> = (&'a [f32], Order, usize, usize);

/// Neighbouring starts that are evaluated together.
pub(crate) const TOGETHER: usize = 8;

/// Sums what the branches of a step lead to from neighbouring starts, one bit each, and writes it plus `base` to the results
/// of these `starts`; the others keep theirs. `starts` are the bits of a word and the number of the first one that is
/// evaluated; `ends` has them by the code of the voxel in which a branch ends, for each branch.
pub(crate) fn mix(
    footprints: &[Footprint],
    ends: &[[u64; 4]],
    place: Place<'_>,
    base: f32,
    counts: Counts,
    starts: [u64; 2],
    results: &mut [f32; TOGETHER],
) {
    match place.1 {
        Order::Linear => mix_linear(footprints, ends, place, base, counts, starts, results),
        Order::Cubic => mix_cubic(footprints, ends, place, base, counts, starts, results),
    }
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn mix_linear(
    footprints: &[Footprint],
    ends: &[[u64; 4]],
    place: Place<'_>,
    base: f32,
    counts: Counts,
    starts: [u64; 2],
    results: &mut [f32; TOGETHER],
) {
    mix_points::<2>(footprints, ends, place, base, counts, starts, results);
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn mix_cubic(
    footprints: &[Footprint],
    ends: &[[u64; 4]],
    place: Place<'_>,
    base: f32,
    counts: Counts,
    starts: [u64; 2],
    results: &mut [f32; TOGETHER],
) {
    mix_points::<POINTS>(footprints, ends, place, base, counts, starts, results);
}

/// [`mix`] with the interpolation of P points.
#[inline(always)]
fn mix_points<const P: usize>(
    footprints: &[Footprint],
    ends: &[[u64; 4]],
    (field, _, width, start): Place<'_>,
    base: f32,
    (lost, by_code): Counts,
    [starts, first]: [u64; 2],
    results: &mut [f32; TOGETHER],
) {
    let window = |starts: u64| (starts >> first) as u32 & (u32::MAX >> (u32::BITS as usize - TOGETHER));
    let starts = window(starts);
    let skipped = (POINTS - P) / 2;
    let mut sums = [0.0; TOGETHER];
    for (footprint, ends) in footprints.iter().zip(ends) {
        let mut landings = [0.0; TOGETHER];
        let sets = ends.map(window);
        if sets[0] != 0 {
            let first = (start as i64 + footprint.first) as usize + skipped * (width + 1);
            let [of_y, of_z] = &footprint.along;
            for y in 0..P {
                let row = &field[first + y * width..][..TOGETHER + P - 1];
                for k in 0..TOGETHER {
                    let mut along_z = of_z[skipped] * row[k];
                    for z in 1..P {
                        along_z += of_z[skipped + z] * row[k + z];
                    }
                    landings[k] += of_y[skipped + y] * along_z;
                }
            }
        }
        let (lost, counts) = (footprint.weight * lost, by_code.map(|count| footprint.weight * count));
        for k in 0..TOGETHER {
            let going = pick(sets[0], k, lost + footprint.probability * landings[k]);
            let ended = pick(sets[1], k, counts[1]) | pick(sets[2], k, counts[2]) | pick(sets[3], k, counts[3]);
            sums[k] += f32::from_bits(going | ended);
        }
    }
    for k in 0..TOGETHER {
        let sum = pick(starts, k, base + sums[k]);
        results[k] = f32::from_bits(sum | pick(!starts, k, results[k]));
    }
}

/// The bits of a number where start `k` is in the set, else zeros.
#[inline(always)]
fn pick(set: u32, k: usize, number: f32) -> u32 {
    number.to_bits() & ((set >> k) & 1).wrapping_neg()
}

/// The footprints of all steps, `[region][direction][action]`, for one interpolation.
pub(crate) struct Footprints {
    steps: Vec<Vec<Footprint>>,
    directions: usize,
    actions: usize,
}

impl Footprints {
    /// Finds the footprints of all steps.
    pub(crate) fn new(parts: &SpaceParts, padded: Padded, order: Order) -> Self {
        let steps = parts.regions.iter().flatten().map(|step| of_step(step, padded, order)).collect();
        Footprints { steps, directions: parts.shape.directions, actions: parts.actions() }
    }

    /// The footprints of the branches of a step.
    #[inline]
    pub(crate) fn of(&self, [region, direction, action]: [usize; 3]) -> &[Footprint] {
        &self.steps[(region * self.directions + direction) * self.actions + action]
    }
}

fn of_step(step: &SpaceStep, padded: Padded, order: Order) -> Vec<Footprint> {
    let columns = step.branches.chunk_by(|a, b| (a.cell[1], a.fraction[1]) == (b.cell[1], b.fraction[1]));
    let of_columns = columns.enumerate().flat_map(|(column, branches)| branches.iter().map(move |each| (column, each)));
    let footprint = of_columns.map(|(column, branch)| {
        let [y, z] = padded.within(branch.cell);
        Footprint {
            rest: branch.rest as u32,
            column: column as u32,
            first: i64::from(branch.direction) * padded.len() as i64 + (y - 1) * padded.width as i64 + z - 1,
            along: [0, 1].map(|axis| weights(order, branch.fraction[axis], step.spread[axis])),
            weight: branch.weight as f32,
            probability: (branch.weight * (1.0 - step.lost)) as f32,
        }
    });
    footprint.collect()
}
