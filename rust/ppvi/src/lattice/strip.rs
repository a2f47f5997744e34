//! The backup of a strip: the values of [`LANES`] neighbouring grid points from W, all headings and both bevels.

use std::ops::Range;

use crate::interpolation::POINTS;
use crate::lattice::cubic::{CubicWeights, scale_of};
use crate::lattice::kernel::{StepCosts, blend, q_values};
use crate::lattice::lanes::Lanes;
use crate::lattice::parts::{LANES, STRAIGHT, outcome};
use crate::lattice::real::Real;
use crate::lattice::sector::Sector;
use crate::lattice::store::Staged;
use crate::lattice::turns::Turns;

/// Index and weights of the W that a step from the first grid point of a column reads.
#[derive(Clone, Copy)]
pub(crate) struct Read<T> {
    /// In the column arrived at, and in the next one.
    at: [usize; 2],
    /// Of the four grid points around, for interpolation.
    weights: [T; 4],
}

/// The read of a step that arrives with `bevel`, given by its number among the
/// [steps](crate::lattice::LatticeParts::steps).
#[inline(always)]
pub(crate) fn read<T: Real>(
    sector: &Sector<T>,
    turns: &Turns<T>,
    u: usize,
    step: usize,
    q: usize,
    bevel: usize,
) -> Read<T> {
    let shift = &sector.shifts[step * sector.arc.count + q][bevel];
    let row = (turns.of_step(step) * sector.arc.count + q) * 2 + bevel;
    let to_u = (u as i64 + sector.pad[0] as i64 + i64::from(shift.cell[0])) as usize;
    let in_column = row * sector.width() + (sector.pad[1] as i64 + i64::from(shift.cell[1])) as usize;
    let [fu, fv] = shift.fraction;
    let weights = [(1.0 - fu) * (1.0 - fv), (1.0 - fu) * fv, fu * (1.0 - fv), fu * fv];
    Read { at: [to_u, to_u + 1].map(|u| sector.column(u) + in_column), weights: weights.map(T::of) }
}

/// What cubic interpolation reads besides.
#[derive(Clone, Copy, Default)]
pub(crate) struct CubicRead {
    /// Index in the columns before and behind those of [`Read`].
    at: [usize; 2],
    /// Index of the cell in which the step ends.
    cell: usize,
}

/// The cubic read of the step of [`read`].
#[inline(always)]
pub(crate) fn read_cubic<T: Real>(
    sector: &Sector<T>,
    turns: &Turns<T>,
    u: usize,
    step: usize,
    q: usize,
    bevel: usize,
) -> CubicRead {
    let shift = &sector.shifts[step * sector.arc.count + q][bevel];
    let row = (turns.of_step(step) * sector.arc.count + q) * 2 + bevel;
    let to_u = (u as i64 + sector.pad[0] as i64 + i64::from(shift.cell[0])) as usize;
    let to_v = (sector.pad[1] as i64 + i64::from(shift.cell[1])) as usize;
    let in_column = row * sector.width() + to_v;
    CubicRead { at: [to_u - 1, to_u + 2].map(|u| sector.column(u) + in_column), cell: sector.cells.index(to_u, to_v) }
}

/// Inputs of the backup of a strip; arrays are `[heading]` or `[heading][bevel]`.
#[derive(Clone, Copy)]
pub(crate) struct Work<'a, T> {
    pub convolved: &'a [T],
    /// Codes of cells.
    pub cells: &'a [u8],
    /// Upper limit of cubic interpolation.
    pub limit: T,
    /// The first grid point of the strip.
    pub first: usize,
    pub curved: Steps<'a, T>,
    /// Those of the curved steps again where there are no straight ones.
    pub straight: Steps<'a, T>,
    /// Empty without a policy.
    pub policy_mask: &'a [[[u8; LANES]; 2]],
    pub discount: T,
    pub rotation: T,
}

/// The steps of a motion from a strip.
#[derive(Clone, Copy)]
pub(crate) struct Steps<'a, T> {
    pub reads: &'a [[Read<T>; 2]],
    /// Empty unless the reading is cubic.
    pub cubic: (&'a [[CubicRead; 2]], &'a [[CubicWeights<T>; 2]]),
    pub codes: &'a [[[u8; LANES]; 2]],
    pub costs: &'a StepCosts<T>,
}

/// Backs up the grid points `lanes` of a strip; with `KEEP` also notes the values with their actions.
#[inline(always)]
pub(crate) fn back_up<
    T: Real,
    V: Lanes<T>,
    const INTERPOLATED: bool,
    const CUBIC: bool,
    const POLICY: bool,
    const STRAIGHTS: bool,
    const KEEP: bool,
>(
    work: Work<'_, T>,
    lanes: Range<usize>,
    values: [&mut [[T; LANES]]; 2],
    staged: Staged<'_>,
) {
    let rotation = V::splat(work.rotation);
    for (q, _) in work.curved.reads.iter().enumerate() {
        let on: [V; 2] = [
            q_row::<T, V, INTERPOLATED, CUBIC>(work, work.curved, q, 0),
            q_row::<T, V, INTERPOLATED, CUBIC>(work, work.curved, q, 1),
        ];
        let rotated = [on[1].add(rotation), on[0].add(rotation)];
        for bevel in 0..2 {
            let (mut value, note) = match (POLICY, KEEP) {
                (true, _) => {
                    let actions = &work.policy_mask[q][bevel];
                    let turns = if STRAIGHTS { actions.map(|action| u8::from(action == 1)) } else { *actions };
                    let value = on[bevel].or_rotated(rotated[bevel], &turns);
                    (value, value)
                }
                (false, true) => (rotated[bevel].minimum(on[bevel]), rotated[bevel].min_with_argmin(on[bevel])),
                (false, false) => {
                    let value = rotated[bevel].minimum(on[bevel]);
                    (value, value)
                }
            };
            if STRAIGHTS {
                let straight = q_row::<T, V, INTERPOLATED, CUBIC>(work, work.straight, q, bevel);
                let (better, mark) = if POLICY {
                    let chosen = work.policy_mask[q][bevel].map(|action| u8::from(action == STRAIGHT));
                    let value = value.or_rotated(straight, &chosen);
                    (value, value)
                } else {
                    (straight.minimum(value), straight.min_with_argmin(value))
                };
                value = better;
                if KEEP {
                    put(mark.narrow(), &lanes, &mut staged.straight[q][bevel]);
                }
            }
            put(value, &lanes, &mut values[bevel][q]);
            if KEEP {
                put(note.narrow(), &lanes, &mut staged.turned[q][bevel]);
            }
        }
    }
}

/// Stores the lanes of a vector.
#[inline(always)]
fn put<T: Real, V: Lanes<T>>(vector: V, lanes: &Range<usize>, to: &mut [T; LANES]) {
    if lanes.len() == LANES {
        return vector.store(to);
    }
    let mut all = [T::default(); LANES];
    vector.store(&mut all);
    to[lanes.clone()].copy_from_slice(&all[lanes.clone()]);
}

/// Q-values of the steps of a motion and heading `q` that arrive with `bevel`.
#[inline(always)]
fn q_row<T: Real, V: Lanes<T>, const INTERPOLATED: bool, const CUBIC: bool>(
    work: Work<'_, T>,
    steps: Steps<'_, T>,
    q: usize,
    bevel: usize,
) -> V {
    let Read { at: [near, far], weights } = steps.reads[q][bevel];
    let (near, far) = (near + work.first, far + work.first);
    let to = if CUBIC {
        cubic::<T, V>(work, steps, (q, bevel), [near, far], weights)
    } else if INTERPOLATED {
        let (a, b) = (lanes_at(work.convolved, near), lanes_at(work.convolved, near + 1));
        let (c, d) = (lanes_at(work.convolved, far), lanes_at(work.convolved, far + 1));
        blend([V::load(a), V::load(b), V::load(c), V::load(d)], weights)
    } else {
        V::load(lanes_at(work.convolved, near))
    };
    q_values(to, &steps.codes[q][bevel], steps.costs, work.discount)
}

/// The cubic interpolation of the success at the ends of the steps of [`q_row`]; [`crate::lattice::cubic`] has the rules.
#[inline(always)]
fn cubic<T: Real, V: Lanes<T>>(
    work: Work<'_, T>,
    steps: Steps<'_, T>,
    (q, bevel): (usize, usize),
    [near, far]: [usize; 2],
    weights: [T; 4],
) -> V {
    let (read, CubicWeights { points, scales }) = (steps.cubic.0[q][bevel], &steps.cubic.1[q][bevel]);
    let [before, behind] = [read.at[0] + work.first, read.at[1] + work.first];
    let inner = along::<T, V>(work.convolved, near, &points[1]).add(along::<T, V>(work.convolved, far, &points[2]));
    let outer =
        along::<T, V>(work.convolved, before, &points[0]).add(along::<T, V>(work.convolved, behind, &points[3]));
    let all = inner.add(outer).limited(work.limit);
    let (cells, codes) = (lanes_at(work.cells, read.cell + work.first), &steps.codes[q][bevel]);
    let mut mixed = 0;
    for l in 0..LANES {
        mixed |= if codes[l] == outcome::CONTINUES { cells[l] } else { 0 };
    }
    if mixed == 0 {
        return all;
    }
    let (a, b) = (lanes_at(work.convolved, near), lanes_at(work.convolved, near + 1));
    let (c, d) = (lanes_at(work.convolved, far), lanes_at(work.convolved, far + 1));
    let corners = blend([V::load(a), V::load(b), V::load(c), V::load(d)], weights);
    let mut scale = [T::default(); LANES];
    for l in 0..LANES {
        scale[l] = scale_of(scales, cells[l]);
    }
    corners.mul(V::load(&scale)).or_rotated(all, &cells.map(|code| u8::from(code == 0)))
}

/// The weighted sum of four rows of a column, one point before `at` to two points behind it.
#[inline(always)]
fn along<T: Real, V: Lanes<T>>(convolved: &[T], at: usize, weights: &[T; POINTS]) -> V {
    let (a, b) = (V::load(lanes_at(convolved, at - 1)), V::load(lanes_at(convolved, at)));
    let (c, d) = (V::load(lanes_at(convolved, at + 1)), V::load(lanes_at(convolved, at + 2)));
    blend([a, b, c, d], *weights)
}

#[inline(always)]
fn lanes_at<T>(array: &[T], at: usize) -> &[T; LANES] {
    let Some(lanes) = array[at..].first_chunk() else { unreachable!("rows are padded") };
    lanes
}
