//! What a step leads to from the rows of a block: sums over its landings, and what its ends count.

use std::ops::Range;

use crate::space::footprint::{Footprint, POINTS, TOGETHER, mix};
use crate::space::kernel::{Order, Run, Term, combine};
use crate::space::layer::Padded;
use crate::space::outcomes::{StepOutcomes, WORD};
use crate::space::reach::{LANES, PointSet};

/// How a step is evaluated: for its cost, or for the probability of success.
#[derive(Clone, Copy)]
pub(crate) struct Reading<'a> {
    /// Planes of the layer in which the step ends.
    pub field: &'a [f32],
    pub order: Order,
    /// What its branches read.
    pub footprints: &'a [Footprint],
    /// States that are looked at, and runs of the results with all of them.
    pub open: &'a PointSet,
    pub runs: &'a [Run],
    /// Row of the slice at which its outcomes and the results begin.
    pub from: usize,
    /// What every start adds, and every start whose branches reach their landing.
    pub base: f32,
    pub lost: f32,
    /// What the end in a voxel counts, by its code.
    pub by_code: [f32; 4],
}

/// Memory of one step.
#[derive(Default)]
pub(crate) struct Memory {
    /// Sums of each column of landings, of all columns.
    sums: Vec<f32>,
    terms: Vec<Term>,
    /// Starts of a word by the ends of each branch.
    branches: Vec<[u64; 4]>,
}

/// Finds what steps lead to.
pub(crate) struct LeadSolver {
    pub padded: Padded,
    /// Points of a row of the slice.
    pub nz: usize,
}

impl LeadSolver {
    /// Finds what a step leads to: the mean over the field where it lands, or what an end counts. Rows of the results are as
    /// wide as those of a padded plane; `rows` are those with runs. Of the open starts in a word from which branches end
    /// differently, and whose first bit has this place in the results, those are left out that are not `wanted`.
    pub(crate) fn find(
        &self,
        reading: &Reading<'_>,
        ends: &StepOutcomes,
        rows: Range<usize>,
        wanted: impl Fn(u64, usize) -> u64,
        memory: &mut Memory,
        results: &mut [f32],
    ) {
        let Reading { field, order, footprints, open, from, base, lost, by_code, .. } = *reading;
        let width = self.padded.width;
        // Beyond the volume there is no layer, and all branches end before it.
        if !field.is_empty() {
            self.land(reading, memory, results);
        }
        let branches = &mut memory.branches;
        for mut word in ends.mixed_words(rows.clone()) {
            let [row, k] = word.first;
            let to = row * width + k;
            word.starts = wanted(word.starts & open.row(from + row)[k / WORD], to);
            if word.starts == 0 {
                continue;
            }
            branches.clear();
            branches.extend(footprints.iter().map(|each| ends.ends(&word, each.rest as usize)));
            while word.starts != 0 {
                let first = word.starts.trailing_zeros() as usize;
                let place = (field, order, width, self.padded.at((from + row) as i64, (k + first) as i64));
                let Some(results) = results[to + first..].first_chunk_mut() else {
                    unreachable!("there are numbers behind the last row")
                };
                mix(footprints, branches, place, base, (lost, by_code), [word.starts, first as u64], results);
                word.starts &= u64::MAX.checked_shl((first + TOGETHER) as u32).unwrap_or(0);
            }
        }
        for row in ends.certain.ending_rows(rows) {
            ends.certain.for_each_end(row, self.nz, |code, from, to| {
                results[row * width + from..row * width + to].fill(base + by_code[usize::from(code)]);
            });
        }
    }

    /// Sums the landings of all branches from the starts of the runs.
    fn land(&self, reading: &Reading<'_>, Memory { sums, terms, .. }: &mut Memory, landings: &mut [f32]) {
        let Reading { field, footprints, runs, from, base, lost, .. } = *reading;
        let columns = || footprints.chunk_by(|a, b| a.column == b.column);
        // What is read beyond a sum, in whole groups.
        let length = landings.len() + POINTS.next_multiple_of(LANES);
        sums.resize(sums.len().max(columns().count() * length), 0.0);
        let start = self.padded.at(from as i64, 0) as i64;
        let of_axis = |weights: [f32; POINTS], first: i64, by: f32, stride: usize| {
            let read = weights.into_iter().enumerate().filter(|(_, weight)| *weight != 0.0);
            read.map(move |(point, weight)| Term { first: first + (point * stride) as i64, by: weight * by })
        };
        for (column, sum) in columns().zip(sums.chunks_exact_mut(length)) {
            terms.clear();
            for each in column {
                terms.extend(of_axis(each.along[0], each.first, each.probability, self.padded.width));
            }
            combine((field, start), terms, 0.0, (runs, POINTS - 1), sum);
        }
        terms.clear();
        for (number, column) in columns().enumerate() {
            terms.extend(of_axis(column[0].along[1], (number * length) as i64, 1.0, 1));
        }
        combine((sums, 0), terms, base + lost, (runs, 0), landings);
    }
}
