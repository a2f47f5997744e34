//! The sweep of a sector: columns from the last to the first, each backed up from W and turned into W.
//!
//! A column is done in strips of [`LANES`] grid points. All headings of a strip are backed up, convolved along the
//! heading and stored as W before the next strip: everything between reading W and writing it stays in the nearest
//! cache.

use std::ops::Range;

use crate::bellman::larger;
use crate::lattice::halo::{Halo, Values};
use crate::lattice::kernel::{StepCosts, Vectorized, blend, q_values};
use crate::lattice::lanes::Lanes;
use crate::lattice::parts::LANES;
use crate::lattice::real::Real;
use crate::lattice::sector::{PassInputs, Sector};
use crate::lattice::store::{StagingBuffer, TableWriter};
use crate::lattice::terminal_mask::TerminalMask;
use crate::lattice::turns::Turns;
use crate::stop::StopFlag;

/// Inputs and outputs of the sweep of a sector.
pub(crate) struct SweepContext<'a, T: Copy> {
    pub inputs: PassInputs<'a, T>,
    pub terminal_mask: &'a TerminalMask,
    pub halo: &'a mut Halo<T>,
    /// Strips whose inputs have changed by no more than this are left out; None leaves out nothing.
    pub level: Option<f64>,
    /// If present, the sweep writes all values to it, and the better actions unless there is a policy. It needs a level
    /// of None.
    pub table: Option<TableWriter<'a>>,
    /// Whether the sweep repeats the last one, for the table: then it changes nothing.
    pub again: bool,
    /// Checked at every column.
    pub stop: &'a StopFlag,
}

/// Results of a sweep.
pub(crate) struct Swept {
    /// Bound on the changes of what strips read since they were backed up; see [`crate::lattice::pending`].
    pub pending: f64,
    /// Number of states that were backed up.
    pub backups: u64,
    /// The largest finite value written to a table.
    pub largest: f64,
}

/// Sweeps a sector once.
pub(crate) fn sweep<T: Vectorized>(sector: &mut Sector<T>, context: SweepContext<'_, T>) -> Swept {
    match (context.inputs.lattice.is_interpolated(), sector.has_policy()) {
        (false, false) => dispatch::<T, false, false>(sector, context),
        (false, true) => dispatch::<T, false, true>(sector, context),
        (true, false) => dispatch::<T, true, false>(sector, context),
        (true, true) => dispatch::<T, true, true>(sector, context),
    }
}

/// Whether tests ask for the vectors that every processor has.
#[cfg(test)]
static PORTABLE: std::sync::atomic::AtomicBool = std::sync::atomic::AtomicBool::new(false);

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn is_portable() -> bool {
    #[cfg(test)]
    return PORTABLE.load(std::sync::atomic::Ordering::Relaxed);
    #[cfg(not(test))]
    false
}

/// Chooses the vectors that the processor has.
fn dispatch<T: Vectorized, const INTERPOLATED: bool, const POLICY: bool>(
    sector: &mut Sector<T>,
    context: SweepContext<'_, T>,
) -> Swept {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && !is_portable() {
        // SAFETY: the processor has AVX2.
        return unsafe { sweep_avx2::<T, INTERPOLATED, POLICY>(sector, context) };
    }
    sweep_columns::<T, [T; LANES], INTERPOLATED, POLICY>(sector, context)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn sweep_avx2<T: Vectorized, const INTERPOLATED: bool, const POLICY: bool>(
    sector: &mut Sector<T>,
    context: SweepContext<'_, T>,
) -> Swept {
    sweep_columns::<T, T::Vector, INTERPOLATED, POLICY>(sector, context)
}

/// All of this file is inlined into the function that knows the processor.
#[inline(always)]
fn sweep_columns<T: Vectorized, V: Lanes<T>, const INTERPOLATED: bool, const POLICY: bool>(
    sector: &mut Sector<T>,
    context: SweepContext<'_, T>,
) -> Swept {
    let SweepContext { inputs: PassInputs { turns, costs, .. }, terminal_mask, halo, level, mut table, again, stop } =
        context;
    let count = sector.arc.count;
    let mut values = halo.strip_buffer(count);
    let mut staging = StagingBuffer::new(count);
    let mut reads = Vec::new();
    let mut backups = 0;
    if INTERPOLATED && !sector.whole {
        // Beyond the last column.
        sector.convolved.fill(costs.outside());
    }
    let read_turns = sector.read_turns(terminal_mask, turns);
    sector.pending.begin();
    for u in (0..sector.extent[0]).rev() {
        stop.check();
        let place = sector.place(u);
        let pieces = terminal_mask.pieces(place);
        reads.clear();
        for strip in 0..sector.strips() {
            match level {
                Some(level) => {
                    let due = sector.pending.is_due(u, strip, level) || halo.is_due(place, strip, level);
                    let number = place * sector.strips() + strip;
                    sector.swept[number] = due;
                    if !due {
                        continue;
                    }
                    halo.take(place, strip, &mut values);
                }
                // The W of the strip is there.
                None if again && sector.whole => {}
                None if again => halo.take_again(place, strip, &mut values),
                None => halo.take_one_of_all(place, strip, &mut values),
            }
            if reads.is_empty() {
                for piece in pieces {
                    reads
                        .extend((0..count).map(|q| [0, 1].map(|bevel| read(sector, turns, u, piece.region, q, bevel))));
                }
            }
            let first = strip * LANES;
            backups += (sector.extent[1] - first).min(LANES) * count * 2;
            for (piece, reads) in pieces.iter().zip(reads.chunks_exact(count)) {
                let lanes = piece.first.max(first)..piece.end.min(first + LANES);
                if lanes.is_empty() {
                    continue;
                }
                let work = Work {
                    convolved: &sector.convolved,
                    reads,
                    first,
                    codes: terminal_mask.strip(place, strip),
                    policy_mask: sector.policy_mask(place, strip),
                    step: &costs.steps[piece.region],
                    discount: costs.discount,
                    rotation: costs.rotation,
                };
                let lanes = lanes.start - first..lanes.end - first;
                let (own, staging) = (halo.own(&mut values, count), staging.rows(count));
                if table.is_some() {
                    back_up::<T, V, INTERPOLATED, POLICY, true>(work, lanes, own, staging);
                } else {
                    back_up::<T, V, INTERPOLATED, POLICY, false>(work, lanes, own, staging);
                }
            }
            let at = sector.column(u + sector.pad[0]) + sector.pad[1] + first;
            if let Some(table) = &mut table {
                staging.write::<V::Narrow>(table, place, first);
            }
            if again && sector.whole {
                continue;
            }
            if !again {
                sector.put_edges(place, strip, halo.own(&mut values, count));
            }
            let turns = (turns, &read_turns[u * turns.count()..][..turns.count()]);
            if sector.whole {
                let change = convolve::<T, V, true>(sector, at, halo, &values, turns);
                sector.pending.record(u, strip, change);
            } else {
                convolve::<T, V, false>(sector, at, halo, &values, turns);
            }
        }
    }
    if !again && level.is_none() {
        sector.swept.fill(true);
        halo.end_of_all();
    }
    let pending = if sector.whole && !again { sector.pending.end() } else { 0.0 };
    Swept { pending, backups: backups as u64, largest: staging.largest() }
}

/// Index and weights of the W that a step from the first grid point of a column reads.
#[derive(Clone, Copy)]
struct Read<T> {
    /// In the column arrived at, and in the next one.
    at: [usize; 2],
    /// Of the four grid points around, for interpolation.
    weights: [T; 4],
}

/// The read of a step that arrives with `bevel`.
#[inline(always)]
fn read<T: Real>(sector: &Sector<T>, turns: &Turns<T>, u: usize, region: usize, q: usize, bevel: usize) -> Read<T> {
    let shift = &sector.shifts[region * sector.arc.count + q][bevel];
    let row = (turns.of_region(region) * sector.arc.count + q) * 2 + bevel;
    let to_u = (u as i64 + sector.pad[0] as i64 + i64::from(shift.cell[0])) as usize;
    let in_column = row * sector.width() + (sector.pad[1] as i64 + i64::from(shift.cell[1])) as usize;
    let [fu, fv] = shift.fraction;
    let weights = [(1.0 - fu) * (1.0 - fv), (1.0 - fu) * fv, fu * (1.0 - fv), fu * fv];
    Read { at: [to_u, to_u + 1].map(|u| sector.column(u) + in_column), weights: weights.map(T::of) }
}

/// Inputs of the backup of a strip; arrays are `[heading]` or `[heading][bevel]`.
#[derive(Clone, Copy)]
struct Work<'a, T> {
    convolved: &'a [T],
    reads: &'a [[Read<T>; 2]],
    /// The first grid point of the strip.
    first: usize,
    codes: &'a [[[u8; LANES]; 2]],
    /// Empty without a policy.
    policy_mask: &'a [[[u8; LANES]; 2]],
    step: &'a StepCosts<T>,
    discount: T,
    rotation: T,
}

/// Backs up the grid points `lanes` of a strip; with `KEEP` also notes the values with their actions.
#[inline(always)]
fn back_up<T: Real, V: Lanes<T>, const INTERPOLATED: bool, const POLICY: bool, const KEEP: bool>(
    work: Work<'_, T>,
    lanes: Range<usize>,
    values: [&mut [[T; LANES]]; 2],
    staging: &mut [[[f32; LANES]; 2]],
) {
    let whole = lanes.len() == LANES;
    let rotation = V::splat(work.rotation);
    for q in 0..staging.len() {
        let on: [V; 2] = [q_row::<T, V, INTERPOLATED>(work, q, 0), q_row::<T, V, INTERPOLATED>(work, q, 1)];
        let rotated = [on[1].add(rotation), on[0].add(rotation)];
        for bevel in 0..2 {
            let (value, note) = match (POLICY, KEEP) {
                (true, _) => {
                    let value = on[bevel].or_rotated(rotated[bevel], &work.policy_mask[q][bevel]);
                    (value, value)
                }
                (false, true) => (rotated[bevel].minimum(on[bevel]), rotated[bevel].min_with_argmin(on[bevel])),
                (false, false) => {
                    let value = rotated[bevel].minimum(on[bevel]);
                    (value, value)
                }
            };
            if whole {
                value.store(&mut values[bevel][q]);
                if KEEP {
                    note.narrow().store(&mut staging[q][bevel]);
                }
            } else {
                let mut all = [T::default(); LANES];
                value.store(&mut all);
                values[bevel][q][lanes.clone()].copy_from_slice(&all[lanes.clone()]);
                if KEEP {
                    let mut all = [0.0; LANES];
                    note.narrow().store(&mut all);
                    staging[q][bevel][lanes.clone()].copy_from_slice(&all[lanes.clone()]);
                }
            }
        }
    }
}

/// Q-values of the steps of heading `q` that arrive with `bevel`.
#[inline(always)]
fn q_row<T: Real, V: Lanes<T>, const INTERPOLATED: bool>(work: Work<'_, T>, q: usize, bevel: usize) -> V {
    let Read { at: [near, far], weights } = work.reads[q][bevel];
    let (near, far) = (near + work.first, far + work.first);
    let to = if INTERPOLATED {
        let (a, b) = (lanes_at(work.convolved, near), lanes_at(work.convolved, near + 1));
        let (c, d) = (lanes_at(work.convolved, far), lanes_at(work.convolved, far + 1));
        blend([V::load(a), V::load(b), V::load(c), V::load(d)], weights)
    } else {
        V::load(lanes_at(work.convolved, near))
    };
    q_values(to, &work.codes[q][bevel], work.step, work.discount)
}

#[inline(always)]
fn lanes_at<T>(array: &[T], at: usize) -> &[T; LANES] {
    let Some(lanes) = array[at..].first_chunk() else { unreachable!("rows are padded") };
    lanes
}

/// Stores W of a strip, whose rows begin at `at`, from the values by bevel, for the turns that are read. With `COMPARE`
/// returns the largest change.
#[inline(always)]
fn convolve<T: Vectorized, V: Lanes<T>, const COMPARE: bool>(
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

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::PORTABLE;
    use crate::StopRule;
    use crate::lattice::{
        Costs, HeadingKernel, LatticeMdp, LatticeParts, Region, Shape, Shift, Transition, evaluation, outcome, sweep,
    };

    /// Steps of two and a half cells in the direction of the heading, with the target in the middle.
    fn lattice(transition: Transition, headings: usize, noise: &[f64]) -> LatticeMdp {
        let shape = Shape { nx: 21, ny: 18, headings };
        let step = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / headings as f64).sin_cos();
            [Shift::new([2.5 * cos, 2.5 * sin], [1.0; 2], transition, [shape.nx, shape.ny]); 2]
        };
        let turn = [-1.0, 1.0].map(|side| HeadingKernel::matched(side, noise, 1.0).unwrap());
        let parts = LatticeParts {
            shape,
            spacing: [1.0; 2],
            transition,
            costs: Costs { step: 2.5, rotation: 1.0, collision: 100.0, exit: 90.0, discount: 0.97 },
            regions: vec![Region {
                step_length: 2.5,
                step_cost: 2.5,
                stencil: (0..headings).map(step).collect(),
                turn,
            }],
            region_of: Vec::new(),
        };
        let code = |i: usize, j: usize| match (i, j) {
            (9..12, 7..10) => outcome::AT_TARGET,
            (3..6, 4..15) => outcome::AT_OBSTACLE,
            (0..=2 | 18..=20, _) | (_, 0..=2 | 15..=17) => outcome::EXIT, // nearest steps of up to three cells
            (6, _) => outcome::COLLISION,
            (12, _) => outcome::TARGET,
            _ => outcome::CONTINUES,
        };
        let write = |_, _, codes: &mut [u8]| {
            codes.iter_mut().enumerate().for_each(|(at, to)| *to = code(at / shape.ny, at % shape.ny));
        };
        LatticeMdp::new(parts, write).unwrap()
    }

    #[test]
    fn every_processor_computes_the_same_bits() {
        for (headings, noise) in [(12, vec![0.466, 0.24, 0.027]), (10, vec![0.5, 0.25])] {
            for transition in [Transition::Nearest, Transition::Interpolated] {
                let lattice = lattice(transition, headings, &noise);
                // The second tolerance needs double precision.
                for tolerance in [1e-2, 1e-8] {
                    let [portable, own] = [true, false].map(|portable| {
                        PORTABLE.store(portable, Ordering::Relaxed);
                        let solved = sweep::solve(&lattice, StopRule::new(tolerance).unwrap(), None).unwrap();
                        let success = evaluation::success(&lattice, &solved.policy).unwrap();
                        (solved.values, solved.policy, solved.report.residual, success)
                    });
                    assert!(own.0.iter().any(|value| *value > 0.0) && own.1.contains(&1));
                    assert_eq!(portable, own);
                }
            }
        }
    }
}
