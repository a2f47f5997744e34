//! The arithmetic of the pass: sums of planes, and the interpolation of rows. Plain loops, which compilers vectorise.

use multiversion::multiversion;

/// Interpolation between the grid points of a slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Two points along each axis: the Markov decision process.
    Linear,
    /// Four points along each axis, limited to the range of the two in the middle.
    Cubic,
}

/// Weights of the four points at -1, 0, 1 and 2 for a landing at the fraction `f` after point 0.
pub(crate) fn weights(order: Order, f: f64) -> [f32; 4] {
    let exact = match order {
        Order::Linear => [0.0, 1.0 - f, f, 0.0],
        Order::Cubic => [
            -f * (1.0 - f) * (2.0 - f) / 6.0,
            (1.0 - f * f) * (2.0 - f) / 2.0,
            f * (1.0 + f) * (2.0 - f) / 2.0,
            -f * (1.0 - f * f) / 6.0,
        ],
    };
    exact.map(|weight| weight as f32)
}

/// Sum of planes with weights.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn combine(planes: &[(&[f32], f32)], sum: &mut [f32]) {
    let Some(((first, weight), rest)) = planes.split_first() else { return sum.fill(0.0) };
    for (sum, value) in sum.iter_mut().zip(*first) {
        *sum = weight * value;
    }
    let (pairs, last) = rest.as_chunks::<2>();
    for [(a, wa), (b, wb)] in pairs {
        for ((sum, a), b) in sum.iter_mut().zip(*a).zip(*b) {
            *sum += wa * a + wb * b;
        }
    }
    for (plane, weight) in last {
        for (sum, value) in sum.iter_mut().zip(*plane) {
            *sum += weight * value;
        }
    }
}

/// Interpolates a row between four rows. Each of them starts at the point -1 of the first landing.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn interpolate(order: Order, rows: [&[f32]; 4], along: [[f32; 4]; 2], landings: &mut [f32]) {
    let count = landings.len();
    let [a, b, c, d] = rows.map(|row| &row[..count + 3]);
    let [[ya, yb, yc, yd], [za, zb, zc, zd]] = along;
    if order == Order::Linear {
        for (k, landing) in landings.iter_mut().enumerate() {
            *landing = yb * (zb * b[k + 1] + zc * b[k + 2]) + yc * (zb * c[k + 1] + zc * c[k + 2]);
        }
        return;
    }
    for (k, landing) in landings.iter_mut().enumerate() {
        let row = |row: &[f32]| za * row[k] + zb * row[k + 1] + zc * row[k + 2] + zd * row[k + 3];
        let value = ya * row(a) + yb * row(b) + yc * row(c) + yd * row(d);
        let low = b[k + 1].min(b[k + 2]).min(c[k + 1].min(c[k + 2]));
        let high = b[k + 1].max(b[k + 2]).max(c[k + 1].max(c[k + 2]));
        *landing = value.max(low).min(high);
    }
}
