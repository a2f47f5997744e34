//! The arithmetic of the pass on rows: sums of planes, interpolation, comparison. Plain loops, which compilers vectorise.

use multiversion::multiversion;

/// Interpolation between the grid points of a slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Two points along each axis: the Markov decision process.
    Linear,
    /// Four points along each axis, limited to [0, 1]; points that are not free take the mean of their free neighbours.
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

/// Planes that are summed in one pass over them: those of a stencil of nine directions.
const AT_ONCE: usize = 9;

/// Sum of planes with weights, from the number `from` of each plane on.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn combine(planes: &[(&[f32], f32)], from: usize, sum: &mut [f32]) {
    for (pass, planes) in planes.chunks(AT_ONCE).enumerate() {
        match planes.len() {
            9 => add_planes::<9>(planes, from, pass > 0, sum),
            8 => add_planes::<8>(planes, from, pass > 0, sum),
            7 => add_planes::<7>(planes, from, pass > 0, sum),
            6 => add_planes::<6>(planes, from, pass > 0, sum),
            5 => add_planes::<5>(planes, from, pass > 0, sum),
            4 => add_planes::<4>(planes, from, pass > 0, sum),
            3 => add_planes::<3>(planes, from, pass > 0, sum),
            2 => add_planes::<2>(planes, from, pass > 0, sum),
            _ => add_planes::<1>(planes, from, pass > 0, sum),
        }
    }
}

/// Sums N planes, or adds them. The loop over them is unrolled, so each sum is loaded and stored once.
#[inline(always)]
fn add_planes<const N: usize>(planes: &[(&[f32], f32)], from: usize, adds: bool, sum: &mut [f32]) {
    let count = sum.len();
    let mut rows: [&[f32]; N] = [&[]; N];
    let mut by = [0.0; N];
    for n in 0..N {
        (rows[n], by[n]) = (&planes[n].0[from..][..count], planes[n].1);
    }
    for (k, sum) in sum.iter_mut().enumerate() {
        let mut total = if adds { *sum } else { 0.0 };
        for n in 0..N {
            total += by[n] * rows[n][k];
        }
        *sum = total;
    }
}

/// Interpolates between two rows of a block whose rows are `stride` numbers apart, and adds a number. `sums` starts at the
/// point 0 of the first landing.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn interpolate_linear(sums: &[f32], stride: usize, [fy, fz]: [f32; 2], add: f32, landings: &mut [f32]) {
    let count = landings.len();
    let (b0, b1, c0, c1) =
        (&sums[..count], &sums[1..][..count], &sums[stride..][..count], &sums[stride + 1..][..count]);
    let [wb0, wb1, wc0, wc1] = [(1.0 - fy) * (1.0 - fz), (1.0 - fy) * fz, fy * (1.0 - fz), fy * fz];
    for k in 0..count {
        landings[k] = ((wb0 * b0[k] + wb1 * b1[k]) + (wc0 * c0[k] + wc1 * c1[k])) + add;
    }
}

/// Interpolates probabilities between four rows of a block whose rows are `stride` numbers apart, and limits them to [0, 1].
/// `sums` starts at the point (-1, -1) of the first landing. `between` is memory: a block after the interpolation along y.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn interpolate(
    sums: &[f32],
    stride: usize,
    [[ya, yb, yc, yd], [za, zb, zc, zd]]: [[f32; 4]; 2],
    between: &mut Vec<f32>,
    landings: &mut [f32],
) {
    let (count, wide) = (landings.len(), landings.len() + 3);
    if between.len() < wide {
        between.resize(wide, 0.0);
    }
    let between = &mut between[..wide];
    let (a, b) = (&sums[..wide], &sums[stride..][..wide]);
    let (c, d) = (&sums[2 * stride..][..wide], &sums[3 * stride..][..wide]);
    for k in 0..wide {
        between[k] = (ya * a[k] + yb * b[k]) + (yc * c[k] + yd * d[k]);
    }
    let (m0, m1) = (&between[..count], &between[1..][..count]);
    let (m2, m3) = (&between[2..][..count], &between[3..][..count]);
    for k in 0..count {
        let value = (za * m0[k] + zb * m1[k]) + (zc * m2[k] + zd * m3[k]);
        let value = if value < 0.0 { 0.0 } else { value };
        landings[k] = if value < 1.0 { value } else { 1.0 };
    }
}

/// Adds prices times a length to costs.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn add_prices(prices: &[f32], length: f32, costs: &mut [f32]) {
    for (cost, price) in costs.iter_mut().zip(prices) {
        *cost += price * length;
    }
}

/// Keeps the lesser cost at each point, and its choice, which is a larger number than all choices before it. Minimum and
/// maximum instead of conditions, for which compilers store with masks, slowly.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn keep_better(costs: &[f32], choice: u32, best: &mut [f32], choices: &mut [u32]) {
    let count = best.len();
    let (costs, choices) = (&costs[..count], &mut choices[..count]);
    for k in 0..count {
        let mask = u32::from(costs[k] < best[k]).wrapping_neg();
        best[k] = costs[k].min(best[k]);
        choices[k] = choices[k].max(choice & mask);
    }
}

/// Replaces a choice.
pub(crate) fn rename(choice: u32, by: u32, choices: &mut [u32]) {
    for at in choices {
        *at = if *at == choice { by } else { *at };
    }
}

/// Makes the costs infinite where the region is another one.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn keep_region(region: u8, regions: &[u8], costs: &mut [f32]) {
    for (cost, at) in costs.iter_mut().zip(regions) {
        *cost = if *at == region { *cost } else { f32::INFINITY };
    }
}

/// The least and the largest number of a row.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn range(row: &[u8]) -> [u8; 2] {
    let mut found = [u8::MAX, 0];
    for at in row {
        found = [found[0].min(*at), found[1].max(*at)];
    }
    found
}

/// Takes the chances at the points with this choice, where success is still zero.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn take_chosen(chances: &[f32], choice: u32, choices: &[u32], success: &mut [f32]) {
    let count = success.len();
    let (chances, choices) = (&chances[..count], &choices[..count]);
    for k in 0..count {
        let mask = u32::from(choices[k] == choice).wrapping_neg();
        success[k] = f32::from_bits(success[k].to_bits() | (chances[k].to_bits() & mask));
    }
}

/// Whether a choice occurs.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn occurs(choice: u32, choices: &[u32]) -> bool {
    let mut found = 0;
    for at in choices {
        found |= u32::from(*at == choice);
    }
    found != 0
}

/// Writes one where the code of the end, the low byte of a choice, is this one, else zero.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn mark_code(code: u8, choices: &[u32], success: &mut [f32]) {
    for (success, choice) in success.iter_mut().zip(choices) {
        *success = if choice & 0xff == u32::from(code) { 1.0 } else { 0.0 };
    }
}

/// Writes probabilities in units of 1 / 65535, rounded to nearest, and the actions of choices from bit `shift` on.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn store(probabilities: &[f32], choices: &[u32], shift: u32, success: &mut [u16], policy: &mut [u8]) {
    /// Numbers from this one on have a spacing of 1, so adding it rounds.
    const ROUNDS: f32 = 8_388_608.0;
    for (stored, probability) in success.iter_mut().zip(probabilities) {
        *stored = (probability * 65535.0 + ROUNDS).to_bits() as u16;
    }
    for (stored, choice) in policy.iter_mut().zip(choices) {
        *stored = (choice >> shift) as u8;
    }
}
