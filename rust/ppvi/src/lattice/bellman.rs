//! The exact residual and the greedy policy of a field of values, in double precision whatever the values are in.

use multiversion::multiversion;
use rayon::prelude::*;

use crate::lattice::field::{Field, column_to_table};
use crate::lattice::real::Real;
use crate::lattice::{LatticeMdp, Shape, outcome};
use crate::memory::filled;

/// What one Bellman backup of every state says.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Greedy {
    /// Greedy action, in table layout: 0 insert, 1 rotate then insert.
    pub policy: Vec<u8>,
    /// The values in single precision, in table layout.
    pub values: Vec<f32>,
    /// max |TV - V|.
    pub residual: f64,
}

/// Backs up every state once without storing the result.
pub(crate) fn greedy<T: Real>(lattice: &LatticeMdp, field: &Field<T>) -> Greedy {
    let column = lattice.shape.ny * lattice.shape.headings * 2;
    let mut policy = filled(0u8, lattice.shape.states());
    let mut values = filled(0f32, lattice.shape.states());
    let columns = policy.par_chunks_mut(column).zip(values.par_chunks_mut(column)).enumerate();
    let residuals = columns.map(|(i, (policy, values))| greedy_column(lattice, field, i, policy, values));
    let residual = residuals.reduce(|| 0.0, f64::max);
    Greedy { policy, values, residual }
}

/// One grid column.
#[multiversion(targets("x86_64+avx+avx2"))]
fn greedy_column<T: Real>(
    lattice: &LatticeMdp,
    field: &Field<T>,
    i: usize,
    policy: &mut [u8],
    values: &mut [f32],
) -> f64 {
    let Shape { nx, ny, headings } = lattice.shape;
    let mut actions = vec![0u8; policy.len()];
    let (mut minus, mut plus, mut errors) = (vec![0f64; ny], vec![0f64; ny], vec![0f64; ny]);
    for k in 0..headings {
        q_row(lattice, field, i, k, 0, &mut minus);
        q_row(lattice, field, i, k, 1, &mut plus);
        for bevel in 0..2 {
            let (insert, turn) = if bevel == 0 { (&minus, &plus) } else { (&plus, &minus) };
            let codes = &lattice.outcomes[((k * 2 + bevel) * nx + i) * ny..][..ny];
            let row = &field.values[((i * headings + k) * 2 + bevel) * ny..][..ny];
            let actions = &mut actions[(k * 2 + bevel) * ny..][..ny];
            choose_row(actions, &mut errors, insert, turn, codes, row, lattice.setup.costs.rotation);
        }
    }
    column_to_table(lattice.shape, &actions, policy, |action| action);
    let column = &field.values[i * policy.len()..][..policy.len()];
    column_to_table(lattice.shape, column, values, |value| value.widen() as f32);
    errors.iter().fold(0.0, |max, error| f64::max(max, *error))
}

/// The better action and the residual of one row; `errors[j]` grows to the largest residual seen at j.
#[inline(always)]
fn choose_row<T: Real>(
    actions: &mut [u8],
    errors: &mut [f64],
    insert: &[f64],
    turn: &[f64],
    codes: &[u8],
    values: &[T],
    rotation: f64,
) {
    let n = actions.len();
    let (errors, insert, turn, codes, values) = (&mut errors[..n], &insert[..n], &turn[..n], &codes[..n], &values[..n]);
    for j in 0..n {
        let turned = turn[j] + rotation;
        let rotate = turned < insert[j];
        let absorbing = codes[j] >= outcome::AT_OBSTACLE;
        let error = ((if rotate { turned } else { insert[j] }) - values[j].widen()).abs();
        let error = if absorbing { 0.0 } else { error };
        errors[j] = if error > errors[j] { error } else { errors[j] };
        actions[j] = u8::from(rotate & !absorbing);
    }
}

/// Q-values of the steps from column `i` and heading `k` that arrive with `bevel`.
#[inline(always)]
fn q_row<T: Real>(lattice: &LatticeMdp, field: &Field<T>, i: usize, k: usize, bevel: usize, q: &mut [f64]) {
    let Shape { nx, ny, headings } = lattice.shape;
    let costs = &lattice.setup.costs;
    let turned = k as i64 + if bevel == 1 { 1 } else { -1 };
    let shift = lattice.stencil[k][bevel];
    q.fill(costs.step);
    for (du, wu) in [(0, 1.0 - shift.fraction[0]), (1, shift.fraction[0])] {
        for (dv, wv) in [(0, 1.0 - shift.fraction[1]), (1, shift.fraction[1])] {
            let factor = costs.discount * wu * wv;
            if factor == 0.0 {
                continue;
            }
            let to_i = i as i64 + i64::from(shift.cell[0]) + du;
            let move_j = i64::from(shift.cell[1]) + dv;
            // The rows whose read j + move_j is on the grid.
            let on = (0..nx as i64).contains(&to_i);
            let low = if on { (-move_j).clamp(0, ny as i64) as usize } else { ny };
            let high = if on { (ny as i64 - move_j).clamp(low as i64, ny as i64) as usize } else { ny };
            let outside = factor * lattice.value_outside();
            q[..low].iter_mut().for_each(|q| *q += outside);
            q[high..].iter_mut().for_each(|q| *q += outside);
            if low < high {
                let from = (low as i64 + move_j) as usize;
                let row = |m: i64| {
                    let heading = (turned + m).rem_euclid(headings as i64) as usize;
                    &field.values[((to_i as usize * headings + heading) * 2 + bevel) * ny + from..][..high - low]
                };
                add_expectation(&mut q[low..high], factor, &lattice.setup.noise, row);
            }
        }
    }
    let codes = &lattice.outcomes[((k * 2 + bevel) * nx + i) * ny..][..ny];
    let (target, collision, exit) = (costs.step, costs.step + costs.collision, costs.step + costs.exit);
    for (q, &code) in q.iter_mut().zip(codes) {
        *q = if code == outcome::TARGET { target } else { *q };
        *q = if code == outcome::COLLISION { collision } else { *q };
        *q = if code == outcome::EXIT { exit } else { *q };
    }
}

/// `q += factor * sum over m of noise[|m|] row(m)`.
#[inline(always)]
fn add_expectation<'a, T: Real>(q: &mut [f64], factor: f64, noise: &[f64], row: impl Fn(i64) -> &'a [T]) {
    if let &[p0, p1, p2] = noise {
        return add_five(q, row(-2), row(-1), row(0), row(1), row(2), [p0, p1, p2].map(|p| factor * p));
    }
    for (m, p) in noise.iter().enumerate() {
        let sides: &[i64] = if m == 0 { &[0] } else { &[-1, 1] };
        for side in sides {
            for (q, value) in q.iter_mut().zip(row(side * m as i64)) {
                *q += factor * p * value.widen();
            }
        }
    }
}

#[inline(always)]
fn add_five<T: Real>(q: &mut [f64], a: &[T], b: &[T], c: &[T], d: &[T], e: &[T], p: [f64; 3]) {
    let n = q.len();
    let (a, b, c, d, e) = (&a[..n], &b[..n], &c[..n], &d[..n], &e[..n]);
    for v in 0..n {
        let sides = p[1] * (b[v].widen() + d[v].widen()) + p[2] * (a[v].widen() + e[v].widen());
        q[v] += p[0] * c[v].widen() + sides;
    }
}
