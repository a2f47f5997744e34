//! Exact solutions of small problems: policy iteration with linear systems, refined until the residual is rounding.

use super::Rows;

/// A linear system x = b + A x, solved by elimination with pivots and refined with residuals in twice the precision.
pub fn fixed_point(a: &[Vec<(usize, f64)>], b: &[f64]) -> Option<Vec<f64>> {
    let n = b.len();
    let mut lu: Vec<Vec<f64>> = vec![vec![0.0; n]; n];
    for (i, row) in a.iter().enumerate() {
        lu[i][i] += 1.0;
        row.iter().for_each(|&(j, p)| lu[i][j] -= p);
    }
    let mut order: Vec<usize> = (0..n).collect();
    for k in 0..n {
        let pivot = (k..n).max_by(|x, y| lu[order[*x]][k].abs().total_cmp(&lu[order[*y]][k].abs()))?;
        order.swap(k, pivot);
        let top = std::mem::take(&mut lu[order[k]]);
        if top[k].abs() < 1e-300 {
            return None;
        }
        for &row in &order[k + 1..] {
            let factor = lu[row][k] / top[k];
            if factor != 0.0 {
                (k + 1..n).for_each(|j| lu[row][j] -= factor * top[j]);
            }
            lu[row][k] = factor;
        }
        lu[order[k]] = top;
    }
    let solve = |b: &[f64]| {
        let mut x = vec![0.0; n];
        for i in 0..n {
            x[i] = b[order[i]] - (0..i).map(|j| lu[order[i]][j] * x[j]).sum::<f64>();
        }
        for i in (0..n).rev() {
            x[i] = (x[i] - (i + 1..n).map(|j| lu[order[i]][j] * x[j]).sum::<f64>()) / lu[order[i]][i];
        }
        x
    };
    let mut x = solve(b);
    for _ in 0..8 {
        let residual: Vec<f64> = (0..n)
            .map(|i| {
                let mut sum = (b[i], 0.0);
                add(&mut sum, -x[i]);
                for &(j, p) in &a[i] {
                    let product = p * x[j];
                    add(&mut sum, product);
                    sum.1 += p.mul_add(x[j], -product);
                }
                sum.0 + sum.1
            })
            .collect();
        solve(&residual).iter().zip(&mut x).for_each(|(step, x)| *x += step);
    }
    Some(x)
}

/// Adds a number to a sum and its rounding error.
fn add(sum: &mut (f64, f64), number: f64) {
    let total = sum.0 + number;
    let part = total - sum.0;
    sum.1 += (sum.0 - (total - part)) + (number - part);
    sum.0 = total;
}

/// V* of a problem, infinite outside `proper`; None if the linear systems are singular or policies keep changing.
///
/// With `normalized` the probabilities of a row are divided by their sum if that is within 1e-9 of one.
pub fn optimum(rows: &Rows, discount: f64, proper: &[bool], normalized: bool) -> Option<Vec<f64>> {
    let sum = |row: &[(u32, f64)]| row.iter().map(|entry| entry.1).sum::<f64>();
    let scale = |row: &[(u32, f64)]| if normalized && (sum(row) - 1.0).abs() <= 1.1e-9 { sum(row) } else { 1.0 };
    let stays = |row: &[(u32, f64)]| row.iter().all(|entry| entry.1 == 0.0 || proper[entry.0 as usize]);
    let states: Vec<usize> = (0..rows.len()).filter(|s| proper[*s] && !rows[*s].is_empty()).collect();
    let mut place = vec![usize::MAX; rows.len()];
    states.iter().enumerate().for_each(|(at, s)| place[*s] = at);
    let system = |s: usize, action: usize| {
        let (cost, row) = &rows[s][action];
        let inside = row.iter().filter(|entry| entry.1 > 0.0 && place[entry.0 as usize] != usize::MAX);
        (*cost, inside.map(|entry| (place[entry.0 as usize], discount * entry.1 / scale(row))).collect::<Vec<_>>())
    };
    let q = |s: usize, action: usize, x: &[f64]| {
        let (cost, row) = system(s, action);
        cost + row.iter().map(|(next, p)| p * x[*next]).sum::<f64>()
    };
    let usable = |s: usize| (0..rows[s].len()).filter(move |a| stays(&rows[s][*a].1));
    let best = |s: usize, x: &[f64]| usable(s).min_by(|a, b| q(s, *a, x).total_cmp(&q(s, *b, x)));
    let mut x = vec![0.0; states.len()];
    for _ in 0..3000 {
        x = states.iter().map(|s| usable(*s).map(|a| q(*s, a, &x)).fold(f64::INFINITY, f64::min)).collect();
    }
    let mut policy: Vec<usize> = states.iter().map(|s| best(*s, &x)).collect::<Option<_>>()?;
    for _ in 0..100 {
        let (costs, matrix): (Vec<f64>, Vec<_>) = states.iter().zip(&policy).map(|(s, a)| system(*s, *a)).unzip();
        x = fixed_point(&matrix, &costs)?;
        let mut changed = false;
        for (s, action) in states.iter().zip(&mut policy) {
            let better = best(*s, &x)?;
            if q(*s, better, &x) < q(*s, *action, &x) - 1e-13 * q(*s, *action, &x).abs() {
                (*action, changed) = (better, true);
            }
        }
        if !changed {
            let mut values: Vec<f64> = proper.iter().map(|proper| if *proper { 0.0 } else { f64::INFINITY }).collect();
            states.iter().zip(x).for_each(|(s, x)| values[*s] = x);
            return values.iter().all(|value| discount < 1.0 || *value >= 0.0).then_some(values);
        }
    }
    None
}
