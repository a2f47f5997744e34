//! The sweep of a sector: columns from the last to the first, each backed up from W and turned into W.
//!
//! A column is done in strips of [`LANES`] grid points. All headings of a strip are backed up, convolved along the
//! heading and stored as W before the next strip: everything between reading W and writing it stays in the nearest
//! cache.

use crate::lattice::convolve::convolve;
use crate::lattice::halo::Halo;
use crate::lattice::kernel::Vectorized;
#[cfg(target_arch = "x86_64")]
use crate::lattice::kernel::is_portable;
use crate::lattice::lanes::Lanes;
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{LANES, Motion};
use crate::lattice::sector::{PassInputs, Sector};
use crate::lattice::store::{StagingBuffer, TableWriter};
use crate::lattice::strip::{self, Steps, Work, back_up};
use crate::lattice::terminal_mask::TerminalMask;
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
    let lattice = context.inputs.lattice;
    let has_straight = !lattice.parts.straight.is_empty();
    if !sector.cubic.is_empty() {
        return match has_straight {
            false => dispatch::<T, true, true, true, false>(sector, context),
            true => dispatch::<T, true, true, true, true>(sector, context),
        };
    }
    match (lattice.is_interpolated(), sector.has_policy(), has_straight) {
        (false, false, false) => dispatch::<T, false, false, false, false>(sector, context),
        (false, true, false) => dispatch::<T, false, false, true, false>(sector, context),
        (true, false, false) => dispatch::<T, true, false, false, false>(sector, context),
        (true, true, false) => dispatch::<T, true, false, true, false>(sector, context),
        (false, false, true) => dispatch::<T, false, false, false, true>(sector, context),
        (false, true, true) => dispatch::<T, false, false, true, true>(sector, context),
        (true, false, true) => dispatch::<T, true, false, false, true>(sector, context),
        (true, true, true) => dispatch::<T, true, false, true, true>(sector, context),
    }
}

/// Chooses the vectors that the processor has.
fn dispatch<T: Vectorized, const INTERPOLATED: bool, const CUBIC: bool, const POLICY: bool, const STRAIGHTS: bool>(
    sector: &mut Sector<T>,
    context: SweepContext<'_, T>,
) -> Swept {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && !is_portable() {
        // SAFETY: the processor has AVX2.
        return unsafe { sweep_avx2::<T, INTERPOLATED, CUBIC, POLICY, STRAIGHTS>(sector, context) };
    }
    sweep_columns::<T, [T; LANES], INTERPOLATED, CUBIC, POLICY, STRAIGHTS>(sector, context)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn sweep_avx2<T: Vectorized, const INTERPOLATED: bool, const CUBIC: bool, const POLICY: bool, const STRAIGHTS: bool>(
    sector: &mut Sector<T>,
    context: SweepContext<'_, T>,
) -> Swept {
    sweep_columns::<T, T::Vector, INTERPOLATED, CUBIC, POLICY, STRAIGHTS>(sector, context)
}

/// All of this file and of [`strip`] is inlined into the function that knows the processor.
#[inline(always)]
fn sweep_columns<
    T: Vectorized,
    V: Lanes<T>,
    const INTERPOLATED: bool,
    const CUBIC: bool,
    const POLICY: bool,
    const STRAIGHTS: bool,
>(
    sector: &mut Sector<T>,
    context: SweepContext<'_, T>,
) -> Swept {
    let SweepContext { inputs, terminal_mask, halo, level, mut table, again, stop } = context;
    let PassInputs { lattice: LatticeMdp { parts, .. }, turns, costs } = inputs;
    let count = sector.arc.count;
    let mut values = halo.strip_buffer(count);
    let mut staging = StagingBuffer::new(count, STRAIGHTS);
    let motions = if STRAIGHTS { [Motion::Curved, Motion::Straight] } else { [Motion::Curved; 2] };
    let (mut reads, mut cubic_reads) = (Vec::new(), Vec::new());
    let mut backups = 0;
    if INTERPOLATED && !sector.whole {
        // Beyond the last column.
        sector.convolved.fill(costs.outside());
    }
    let read_turns = sector.read_turns(parts, terminal_mask, turns);
    sector.pending.begin();
    for u in (0..sector.extent[0]).rev() {
        stop.check();
        let place = sector.place(u);
        let pieces = terminal_mask.pieces(place);
        reads.clear();
        cubic_reads.clear();
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
                    for motion in &motions[..1 + usize::from(STRAIGHTS)] {
                        let step = parts.step_number(*motion, piece.region);
                        let read = |q: usize| [0, 1].map(|bevel| strip::read(sector, turns, u, step, q, bevel));
                        reads.extend((0..count).map(read));
                        if CUBIC {
                            let read = |q: usize| [0, 1].map(|b| strip::read_cubic(sector, turns, u, step, q, b));
                            cubic_reads.extend((0..count).map(read));
                        }
                    }
                }
            }
            let first = strip * LANES;
            backups += (sector.extent[1] - first).min(LANES) * count * 2;
            let of_piece = (1 + usize::from(STRAIGHTS)) * count;
            for (number, (piece, reads)) in pieces.iter().zip(reads.chunks_exact(of_piece)).enumerate() {
                let lanes = piece.first.max(first)..piece.end.min(first + LANES);
                if lanes.is_empty() {
                    continue;
                }
                let cubic = |motion| {
                    if !CUBIC {
                        return (&[][..], &[][..]);
                    }
                    let (at, step) = (motion as usize * count, parts.step_number(motion, piece.region));
                    (&cubic_reads[number * of_piece + at..][..count], &sector.cubic[step * count..][..count])
                };
                let steps = |motion| Steps {
                    cubic: cubic(motion),
                    reads: if STRAIGHTS { &reads[motion as usize * count..][..count] } else { reads },
                    codes: terminal_mask.strip(motion, place, strip),
                    costs: &costs.steps[parts.step_number(motion, piece.region)],
                };
                let [curved, straight] = motions.map(steps);
                let work = Work {
                    convolved: &sector.convolved,
                    cells: sector.cells.codes(),
                    limit: sector.limit,
                    first,
                    curved,
                    straight,
                    policy_mask: sector.policy_mask(place, strip),
                    discount: costs.discount,
                    rotation: costs.rotation,
                };
                let lanes = lanes.start - first..lanes.end - first;
                let (own, staged) = (halo.own(&mut values, count), staging.staged());
                if table.is_some() {
                    back_up::<T, V, INTERPOLATED, CUBIC, POLICY, STRAIGHTS, true>(work, lanes, own, staged);
                } else {
                    back_up::<T, V, INTERPOLATED, CUBIC, POLICY, STRAIGHTS, false>(work, lanes, own, staged);
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

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use crate::lattice::kernel::PORTABLE;
    use crate::lattice::{
        Costs, HeadingKernel, LatticeMdp, LatticeParts, Region, STRAIGHT, Shape, Shift, Transition, evaluation,
        outcome, sweep,
    };
    use crate::{Order, StopRule};

    /// Steps of two and a half cells in the direction of the heading, with the target in the middle.
    fn lattice(transition: Transition, headings: usize, noise: &[f64], has_straight: bool) -> LatticeMdp {
        let shape = Shape { nx: 21, ny: 18, headings };
        let step = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / headings as f64).sin_cos();
            [Shift::new([2.5 * cos, 2.5 * sin], [1.0; 2], transition, [shape.nx, shape.ny]); 2]
        };
        let turn = |cells: f64| [-1.0, 1.0].map(|side| HeadingKernel::matched(side * cells, noise, 1.0).unwrap());
        let steps = |cells: f64, step_cost: f64| Region {
            step_length: 2.5,
            step_cost,
            stencil: (0..headings).map(step).collect(),
            turn: turn(cells),
        };
        let parts = LatticeParts {
            shape,
            spacing: [1.0; 2],
            transition,
            costs: Costs { step: 2.5, rotation: 1.0, collision: 100.0, exit: 90.0, discount: 0.97 },
            regions: vec![steps(1.0, 2.5)],
            straight: if has_straight { vec![steps(0.1, 3.0)] } else { Vec::new() },
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
        let write = |_, _, _, codes: &mut [u8]| {
            codes.iter_mut().enumerate().for_each(|(at, to)| *to = code(at / shape.ny, at % shape.ny));
        };
        LatticeMdp::new(parts, write).unwrap()
    }

    #[test]
    fn every_processor_computes_the_same_bits() {
        for (headings, noise) in [(12, vec![0.466, 0.24, 0.027]), (10, vec![0.5, 0.25])] {
            for (transition, has_straight) in [
                (Transition::Nearest, false),
                (Transition::Interpolated, false),
                (Transition::Nearest, true),
                (Transition::Interpolated, true),
            ] {
                let lattice = lattice(transition, headings, &noise, has_straight);
                // The second tolerance needs double precision.
                for tolerance in [1e-2, 1e-8] {
                    let [portable, own] = [true, false].map(|portable| {
                        PORTABLE.store(portable, Ordering::Relaxed);
                        let solved = sweep::solve(&lattice, StopRule::new(tolerance).unwrap(), None).unwrap();
                        let success = [Order::Linear, Order::Cubic]
                            .map(|order| evaluation::success(&lattice, &solved.policy, order).unwrap());
                        (solved.values, solved.policy, solved.report.residual, success)
                    });
                    assert!(own.0.iter().any(|value| *value > 0.0) && own.1.contains(&1));
                    assert_eq!(own.1.contains(&STRAIGHT), has_straight);
                    assert_eq!(portable, own);
                }
            }
        }
    }
}
