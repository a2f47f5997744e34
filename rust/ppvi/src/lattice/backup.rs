//! The sweep of a sector: columns from the last to the first, each backed up from W and turned into W.

use multiversion::multiversion;

use crate::lattice::endings::{Column, Piece};
use crate::lattice::halo::Halo;
use crate::lattice::kernel::{Numbers, better_row, blend_row, convolve_row, follow_row, go_on_row};
use crate::lattice::real::Real;
use crate::lattice::sector::{Sector, Task};
use crate::lattice::store::Store;

/// Sweeps a sector once; writes all values, and the better actions unless there is a policy, where there is a `store`.
/// Returns how much what was read has changed meanwhile: zero where all reads are downstream.
pub(crate) fn sweep<T: Real>(
    sector: &mut Sector<T>,
    task: Task<'_, T>,
    endings: &[Column],
    halo: &Halo<T>,
    store: Option<&mut Store<T>>,
) -> f64 {
    match (task.lattice.is_interpolated(), sector.turns.is_empty()) {
        (false, true) => sweep_columns::<T, false, false>(sector, task, endings, halo, store),
        (false, false) => sweep_columns::<T, false, true>(sector, task, endings, halo, store),
        (true, true) => sweep_columns::<T, true, false>(sector, task, endings, halo, store),
        (true, false) => sweep_columns::<T, true, true>(sector, task, endings, halo, store),
    }
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn sweep_columns<T: Real, const INTERPOLATED: bool, const POLICY: bool>(
    sector: &mut Sector<T>,
    task: Task<'_, T>,
    endings: &[Column],
    halo: &Halo<T>,
    mut store: Option<&mut Store<T>>,
) -> f64 {
    let mut values = vec![T::default(); sector.arc.count * 2 * sector.lanes];
    let mut room = vec![T::default(); 2 * sector.lanes];
    let mut change = T::default();
    if sector.downstream {
        // Beyond the last column.
        sector.convolved.fill(task.numbers.outside());
    }
    for u in (0..sector.extent[0]).rev() {
        let column = &endings[u];
        if let Some(store) = &mut store {
            let (values, actions) = store.column(u);
            back_up_column::<T, INTERPOLATED, POLICY>(sector, task, column, u, (values, actions), &mut room);
            change = larger(change, store_column(sector, u, values, halo, task.noise, &mut room));
        } else {
            let values = &mut values[..];
            back_up_column::<T, INTERPOLATED, POLICY>(sector, task, column, u, (values, &mut []), &mut room);
            change = larger(change, store_column(sector, u, values, halo, task.noise, &mut room));
        }
    }
    change.widen()
}

/// Backs up column `u` into `values` (`[count][bevel][lanes]`), and notes the better actions unless `actions` is empty.
/// `room` is for two rows.
#[inline(always)]
fn back_up_column<T: Real, const INTERPOLATED: bool, const POLICY: bool>(
    sector: &Sector<T>,
    task: Task<'_, T>,
    endings: &Column,
    u: usize,
    (values, actions): (&mut [T], &mut [u8]),
    room: &mut [T],
) {
    let n = sector.lanes;
    let rotation = task.numbers.rotation;
    let (q_minus, q_plus) = room.split_at_mut(n);
    for (q, values) in values.chunks_exact_mut(2 * n).enumerate() {
        q_row::<T, INTERPOLATED>(sector, task, endings, (u, q, 0), q_minus);
        q_row::<T, INTERPOLATED>(sector, task, endings, (u, q, 1), q_plus);
        let (minus, plus) = values.split_at_mut(n);
        if POLICY {
            let row = (u * sector.arc.count + q) * 2 * n;
            let turns = [row, row + n].map(|start| &sector.turns[start..][..n]);
            follow_row([minus, plus], turns, [q_minus, q_plus], rotation);
        } else if actions.is_empty() {
            better_row::<T, false>([minus, plus], [&mut [], &mut []], [q_minus, q_plus], rotation);
        } else {
            let (act_minus, act_plus) = actions[q * 2 * n..][..2 * n].split_at_mut(n);
            better_row::<T, true>([minus, plus], [act_minus, act_plus], [q_minus, q_plus], rotation);
        }
    }
}

/// Q-values of the row of heading `q` at column `u`, of the steps that arrive with `bevel`.
#[inline(always)]
fn q_row<T: Real, const INTERPOLATED: bool>(
    sector: &Sector<T>,
    task: Task<'_, T>,
    endings: &Column,
    (u, q, bevel): (usize, usize, usize),
    out: &mut [T],
) {
    let Numbers { discount, steps, .. } = task.numbers;
    let turned = if bevel == 1 { q + 2 } else { q };
    for &Piece { first, end, region } in &endings.pieces {
        let shift = &sector.shifts[region * sector.arc.count + q][bevel];
        let read = |[du, dv]: [i64; 2]| {
            let to_u = (u as i64 + sector.pad[0] as i64 + i64::from(shift.cell[0]) + du) as usize;
            let to_v = ((sector.pad[1] + first) as i64 + i64::from(shift.cell[1]) + dv) as usize;
            &sector.convolved[sector.column(to_u) + (turned * 2 + bevel) * sector.width() + to_v..][..end - first]
        };
        let (out, cost) = (&mut out[first..end], steps[region].cost);
        if INTERPOLATED {
            let [fu, fv] = shift.fraction;
            let weights = [(1.0 - fu) * (1.0 - fv), (1.0 - fu) * fv, fu * (1.0 - fv), fu * fv];
            let [a, b, c, d] = [[0, 0], [0, 1], [1, 0], [1, 1]].map(read);
            blend_row(out, [a, b, c, d], weights.map(T::of), cost, *discount);
        } else {
            go_on_row(out, read([0, 0]), cost, *discount);
        }
    }
    for run in endings.row(q, bevel) {
        let ended = &steps[usize::from(run.region)].ended;
        out[run.first as usize..run.end as usize].fill(ended[usize::from(run.code)]);
    }
}

/// Stores the values of a column: the edges, and W of it. Returns the largest change of W, where W is kept whole.
#[inline(always)]
fn store_column<T: Real>(
    sector: &mut Sector<T>,
    u: usize,
    values: &[T],
    halo: &Halo<T>,
    noise: &[T],
    room: &mut [T],
) -> T {
    let (count, lanes) = (sector.arc.count, sector.lanes);
    for q in 0..count {
        let Some(slot) = sector.slot(q) else { continue };
        for bevel in 0..2 {
            let to = ((slot * 2 + bevel) * sector.extent[0] + u) * lanes;
            sector.edges[to..to + lanes].copy_from_slice(&values[(q * 2 + bevel) * lanes..][..lanes]);
        }
    }
    let own = values.chunks_exact(lanes);
    let rows: Vec<&[T]> =
        halo.rows(u, 0..noise.len()).chain(own).chain(halo.rows(u, noise.len()..2 * noise.len())).collect();
    let (start, size, width, pad) =
        (sector.column(u + sector.pad[0]), sector.column_size(), sector.width(), sector.pad[1]);
    let whole = !sector.downstream;
    let mut change = T::default();
    for (r, pair) in sector.convolved[start..start + size].chunks_exact_mut(2 * width).enumerate() {
        for (bevel, row) in pair.chunks_exact_mut(width).enumerate() {
            // Steps that arrive with bevel -1 read rows 0 .. count, those with bevel +1 rows 2 .. count + 2.
            if !(2 * bevel..count + 2 * bevel).contains(&r) {
                continue;
            }
            let out = &mut row[pad..][..lanes];
            // Row r of W is centred on heading r - 1 of the sector; taps reach noise.len() - 1 to each side.
            let tap = |tap: usize| rows[(r + tap) * 2 + bevel];
            if whole {
                room[..lanes].copy_from_slice(out);
            }
            convolve_row(out, noise, tap);
            if whole {
                let changes = out.iter().zip(&*room).map(|(new, old)| (*new - *old).magnitude());
                change = changes.fold(change, larger);
            }
        }
    }
    change
}

fn larger<T: Real>(a: T, b: T) -> T {
    if b > a { b } else { a }
}
