//! What a step leads to from the rows of a block: sums over its landings, and what its ends count.

use std::ops::Range;

use crate::space::footprint::{Footprint, POINTS, TOGETHER, mix};
use crate::space::kernel::{Order, Rows, combine};
use crate::space::layer::Padded;
use crate::space::outcomes::{StepOutcomes, WORD};
use crate::space::reach::{LANES, PointSet, Window};

/// How a step is evaluated: for its cost, or for the probability of success.
#[derive(Clone, Copy)]
pub(crate) struct Reading<'a> {
    /// Planes of the layer in which the step ends.
    pub field: &'a [f32],
    pub order: Order,
    /// What its branches read.
    pub footprints: &'a [Footprint],
    /// States that are looked at, and their window.
    pub open: &'a PointSet,
    pub window: &'a Window,
    /// Point of the slice at which its outcomes begin.
    pub from: [usize; 2],
    /// What every start adds, and every start whose branches reach their landing.
    pub base: f32,
    pub lost: f32,
    /// What the end in a voxel counts, by its code.
    pub by_code: [f32; 4],
}

/// Memory of one step.
#[derive(Default)]
pub(crate) struct Memory {
    /// Sums of the rows of each column of landings, of all columns.
    sums: Vec<f32>,
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
    /// Finds what a step leads to from `rows` of its outcomes: the mean over the field where it lands, or what an end counts.
    /// Of the open starts in a word from which branches end differently, and whose first bit has this place in the results, those
    /// are left out that are not `wanted`.
    pub(crate) fn find(
        &self,
        reading: &Reading<'_>,
        ends: &StepOutcomes,
        rows: Range<usize>,
        wanted: impl Fn(u64, i64) -> u64,
        Memory { sums, branches }: &mut Memory,
        results: &mut [f32],
    ) {
        let Reading { field, order, footprints, open, window, from: [j, _], base, lost, by_code } = *reading;
        let place = |row: usize| (row - rows.start) * window.width();
        // Beyond the volume there is no layer, and all branches end before it.
        let going = ends.certain.going_rows(if field.is_empty() { 0..0 } else { rows.clone() });
        if !going.is_empty() {
            self.land(reading, going.clone(), sums, &mut results[place(going.start)..place(going.end)]);
        }
        for mut word in ends.mixed_words(rows.clone()) {
            let [row, k] = word.first;
            let to = (place(row) + k) as i64 - window.first as i64;
            word.starts = wanted(word.starts & open.row(j + row)[k / WORD], to);
            if word.starts == 0 {
                continue;
            }
            let room = window.first + window.width() - k;
            let together = if room < TOGETHER { 1 } else { TOGETHER };
            branches.clear();
            branches.extend(footprints.iter().map(|each| ends.ends(&word, each.rest)));
            while word.starts != 0 {
                let first = (word.starts.trailing_zeros() as usize).min(room - together);
                let place = (field, order, self.padded.width, self.padded.at((j + row) as i64, (k + first) as i64));
                let results = &mut results[(to + first as i64) as usize..][..together];
                mix(footprints, branches, place, base, (lost, by_code), [word.starts, first as u64], results);
                word.starts &= u64::MAX.checked_shl((first + together) as u32).unwrap_or(0);
            }
        }
        for row in ends.certain.ending_rows(rows.clone()) {
            let of_row = &mut results[place(row)..][..window.count];
            ends.certain.for_each_end(row, self.nz, |code, from, to| {
                of_row[window.within(from)..window.within(to)].fill(base + by_code[usize::from(code)]);
            });
        }
    }

    /// Sums the landings of all branches from rows of the outcomes. The last points of a row may have no meaning.
    fn land(&self, reading: &Reading<'_>, of_outcomes: Range<usize>, sums: &mut Vec<f32>, landings: &mut [f32]) {
        let Reading { field, footprints, window, from: [j, k], base, lost, .. } = *reading;
        let columns = || footprints.chunk_by(|a, b| a.column == b.column);
        let (count, width) = (of_outcomes.len(), window.width());
        let summed = (window.count + POINTS - 1).next_multiple_of(LANES);
        let length = count * summed;
        let start = self.padded.at((j + of_outcomes.start) as i64, k as i64) as i64;
        // The last group of the last row may be read beyond its sums.
        sums.resize(columns().count() * length + LANES, 0.0);
        let of_columns = Rows { count, width: summed, strides: [self.padded.width, summed] };
        let mut rows = Vec::with_capacity(POINTS * footprints.len());
        let mut shifted = Vec::with_capacity(POINTS * footprints.len());
        for (column, sum) in columns().zip(sums.chunks_exact_mut(length)) {
            rows.clear();
            for footprint in column {
                let first = (start + footprint.first) as usize;
                let along = footprint.along[0].into_iter().enumerate().filter(|(_, by)| *by != 0.0);
                rows.extend(
                    along.map(|(point, by)| (&field[first + point * self.padded.width..], by * footprint.probability)),
                );
            }
            combine(&rows, 0.0, of_columns, sum);
        }
        for (number, column) in columns().enumerate() {
            let along = column[0].along[1].into_iter().enumerate().filter(|(_, by)| *by != 0.0);
            shifted.extend(along.map(|(point, by)| (&sums[number * length + point..], by)));
        }
        combine(&shifted, base + lost, Rows { count, width, strides: [summed, width] }, landings);
    }
}
