//! The arithmetic of the pass on rows: sums of planes, interpolation, comparison. Plain loops, which compilers vectorise.

use std::ops::Range;

use multiversion::multiversion;

use crate::interpolation::POINTS;
use crate::space::choice::Group;
use crate::space::reach::LANES;

/// Tables hold the probability of success in units of one part of this number.
pub const SUCCESS_STEPS: u16 = u16::MAX;

/// Arrays that are summed in one pass over them: so many that their places stay in registers.
const AT_ONCE: usize = 6;

/// Numbers between two runs that are computed with them. A new run takes as long as about seven groups.
const GAP: usize = 4 * LANES;

/// An array with its weight in a sum.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Term {
    /// Where it begins, relative to the place of the sum.
    pub first: i64,
    pub by: f32,
}

/// Rows that are summed and then interpolated along z, column by column.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    pub terms: Vec<Term>,
    /// End of the terms of each column, and its weights along z.
    pub columns: Vec<(usize, [f32; POINTS])>,
}

impl Rows {
    /// The columns: rows, and weights along z.
    #[inline(always)]
    pub(crate) fn columns(&self) -> impl Iterator<Item = (&[Term], &[f32; POINTS])> {
        let mut begin = 0;
        self.columns.iter().map(move |(end, of_z)| (&self.terms[std::mem::replace(&mut begin, *end)..*end], of_z))
    }
}

/// Numbers of a block that are computed, in whole groups of [`LANES`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Run {
    first: usize,
    end: usize,
}

impl Run {
    /// Adds numbers behind those of all runs, to the last run if that is near.
    pub(crate) fn add(runs: &mut Vec<Run>, first: usize, end: usize) {
        match runs.last_mut() {
            Some(last) if first <= last.end + GAP => last.end = last.first + (end - last.first).next_multiple_of(LANES),
            _ => runs.push(Run { first, end: first + (end - first).next_multiple_of(LANES) }),
        }
    }

    /// The numbers of the run.
    #[inline(always)]
    pub(crate) fn range(self) -> Range<usize> {
        self.first..self.end
    }
}

/// Sum of arrays, which are parts of a field from a place on, with weights, and a number, over runs and so many numbers `more`
/// behind each, in whole groups. Products are not rounded before they are added: faster where the processor has an instruction for it, and the
/// same bits, but slowly, elsewhere.
#[multiversion(targets("x86_64+avx+avx2+fma"))]
pub(crate) fn combine(field: (&[f32], i64), terms: &[Term], add: f32, (runs, more): (&[Run], usize), sum: &mut [f32]) {
    if terms.is_empty() {
        return runs.iter().for_each(|run| sum[run.first..run.end + more].fill(add));
    }
    for (pass, terms) in terms.chunks(AT_ONCE).enumerate() {
        if pass == 0 {
            add_all::<true>(field, terms, add, (runs, more), sum);
        } else {
            add_all::<false>(field, terms, 0.0, (runs, more), sum);
        }
    }
}

/// Sums at most [`AT_ONCE`] arrays, and the number if this is the first pass, or else the sum so far.
#[inline(always)]
fn add_all<const FIRST: bool>(field: (&[f32], i64), terms: &[Term], add: f32, runs: (&[Run], usize), sum: &mut [f32]) {
    match terms.len() {
        6 => add_arrays::<6, FIRST>(field, terms, add, runs, sum),
        5 => add_arrays::<5, FIRST>(field, terms, add, runs, sum),
        4 => add_arrays::<4, FIRST>(field, terms, add, runs, sum),
        3 => add_arrays::<3, FIRST>(field, terms, add, runs, sum),
        2 => add_arrays::<2, FIRST>(field, terms, add, runs, sum),
        _ => add_arrays::<1, FIRST>(field, terms, add, runs, sum),
    }
}

/// Sums N arrays. The loops over them and over a group are unrolled, so each sum is loaded and stored once.
#[inline(always)]
fn add_arrays<const N: usize, const FIRST: bool>(
    (field, at): (&[f32], i64),
    terms: &[Term],
    add: f32,
    (runs, more): (&[Run], usize),
    sum: &mut [f32],
) {
    // Weights stay in registers, once for all lanes.
    let by: [[f32; LANES]; N] = std::array::from_fn(|n| [terms[n].by; LANES]);
    // All arrays have the same length, so that one check for each run is enough.
    let length = runs.last().map_or(0, |run| run.end + more);
    let mut arrays: [&[f32]; N] = [&[]; N];
    for n in 0..N {
        arrays[n] = &field[(at + terms[n].first) as usize..][..length];
    }
    for run in runs {
        let run = run.first..run.end + more;
        let mut groups: [&[[f32; LANES]]; N] = [&[]; N];
        for n in 0..N {
            groups[n] = arrays[n][run.clone()].as_chunks().0;
        }
        for (at, sum) in sum[run].as_chunks_mut().0.iter_mut().enumerate() {
            let mut total: [f32; LANES] = if FIRST { [add; LANES] } else { *sum };
            for n in 0..N {
                let group = &groups[n][at];
                for lane in 0..LANES {
                    total[lane] = by[n][lane].mul_add(group[lane], total[lane]);
                }
            }
            *sum = total;
        }
    }
}

/// Numbers of a group and of the next one, which the interpolation along z reads.
pub(crate) type Wide = [f32; 2 * LANES];

/// Terms of a column that are summed in one pass: so many that their weights stay in registers.
const WIDE_AT_ONCE: usize = 3 * POINTS;

/// Sums and interpolates rows, which are parts of a field from a place on, as [`combine`] does, for single groups. `sums`
/// is memory.
#[multiversion(targets("x86_64+avx+avx2+fma"))]
pub(crate) fn combine_groups(
    field: (&[f32], i64),
    rows: &Rows,
    groups: &[Group],
    sums: &mut Vec<Wide>,
    results: &mut [f32],
) {
    sums.clear();
    sums.resize(rows.columns.len() * groups.len(), [0.0; 2 * LANES]);
    for ((terms, _), sums) in rows.columns().zip(sums.chunks_exact_mut(groups.len())) {
        for terms in terms.chunks(WIDE_AT_ONCE) {
            match terms.len() {
                WIDE_AT_ONCE => add_wide::<WIDE_AT_ONCE>(field, terms, groups, sums),
                _ => terms.iter().for_each(|term| add_wide::<1>(field, &[*term], groups, sums)),
            }
        }
    }
    for (at, group) in groups.iter().enumerate() {
        let mut total = [0.0; LANES];
        for ((_, of_z), sums) in rows.columns.iter().zip(sums.chunks_exact(groups.len())) {
            for z in 0..POINTS {
                for k in 0..LANES {
                    total[k] = of_z[z].mul_add(sums[at][k + z], total[k]);
                }
            }
        }
        results[group.place..][..LANES].copy_from_slice(&total);
    }
}

/// Adds N terms for single groups.
#[inline(always)]
fn add_wide<const N: usize>((field, start): (&[f32], i64), terms: &[Term], groups: &[Group], sums: &mut [Wide]) {
    let terms: [(usize, f32); N] = std::array::from_fn(|n| ((start + terms[n].first) as usize, terms[n].by));
    for (group, sum) in groups.iter().zip(sums) {
        let mut total = *sum;
        for (first, by) in terms {
            let array = &field[first + group.place..][..2 * LANES];
            for k in 0..2 * LANES {
                total[k] = by.mul_add(array[k], total[k]);
            }
        }
        *sum = total;
    }
}

/// Adds prices times a length to costs.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn add_prices(prices: &[f32], length: f32, costs: &mut [f32]) {
    for (cost, price) in costs.iter_mut().zip(prices) {
        *cost += price * length;
    }
}

/// Keeps the lesser cost at each point, and its choice, which is a larger number than all choices before it. Maximum
/// instead of a condition, for which compilers store point by point.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn keep_better(costs: &[f32], choice: u8, best: &mut [f32], choices: &mut [u8]) {
    let count = best.len();
    let (costs, choices) = (&costs[..count], &mut choices[..count]);
    for k in 0..count {
        let is_better = costs[k] < best[k];
        choices[k] = choices[k].max(choice & u8::from(is_better).wrapping_neg());
        best[k] = if is_better { costs[k] } else { best[k] };
    }
}

/// As [`keep_better`] at the points of a region.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn keep_better_in(
    (region, regions): (u8, &[u8]),
    costs: &[f32],
    choice: u8,
    best: &mut [f32],
    choices: &mut [u8],
) {
    let count = best.len();
    let (regions, costs, choices) = (&regions[..count], &costs[..count], &mut choices[..count]);
    for k in 0..count {
        let is_better = (costs[k] < best[k]) & (regions[k] == region);
        choices[k] = choices[k].max(choice & u8::from(is_better).wrapping_neg());
        best[k] = if is_better { costs[k] } else { best[k] };
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

/// Takes the chances, limited to [0, 1], at the points of groups, where success is still zero.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn take_chosen(chances: &[f32], groups: &[Group], success: &mut [f32]) {
    for Group { place, set } in groups {
        let (chances, success) = (&chances[*place..][..LANES], &mut success[*place..][..LANES]);
        for k in 0..LANES {
            let mask = (u32::from(*set) >> k & 1).wrapping_neg();
            let chance = if chances[k] < 0.0 { 0.0 } else { chances[k] };
            let chance = if chance < 1.0 { chance } else { 1.0 };
            success[k] = f32::from_bits(success[k].to_bits() | (chance.to_bits() & mask));
        }
    }
}

/// Writes probabilities in units of 1 / 65535, rounded to nearest.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn store(probabilities: &[f32], success: &mut [u16]) {
    /// Numbers from this one on have a spacing of 1, so adding it rounds.
    const ROUNDS: f32 = 8_388_608.0;
    for (stored, probability) in success.iter_mut().zip(probabilities) {
        *stored = (probability * 65535.0 + ROUNDS).to_bits() as u16;
    }
}
