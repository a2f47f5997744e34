//! What a step leads to from the rows of a block: sums over its landings, and what its ends count.

use std::ops::Range;

use crate::interpolation::{Order, POINTS};
use crate::space::choice::Group;
use crate::space::collision::voxel;
use crate::space::footprint::StepReads;
use crate::space::kernel::{Rows, Run, Term, Wide, combine, combine_groups};
use crate::space::layer::Padded;
use crate::space::outcomes::{StepEnds, WORD};
use crate::space::reach::{LANES, PointSet};

/// How a step is evaluated: for its cost, or for the probability of success.
#[derive(Clone, Copy)]
pub(crate) struct Reading<'a> {
    /// Planes of the layer in which the step ends.
    pub field: &'a [f32],
    pub order: Order,
    /// What its branches read.
    pub reads: StepReads<'a>,
    /// Starts that are looked at.
    pub starts: &'a PointSet,
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
    rows: Rows,
    along_z: Vec<Term>,
    wide: Vec<Wide>,
    /// Starts of a word from which each path of the branches goes on, ends in the target, and in an obstacle.
    ends: Vec<[u64; 3]>,
}

/// Finds what steps lead to. Rows of the results are as wide as those of a padded plane.
pub(crate) struct LeadSolver {
    pub padded: Padded,
}

impl LeadSolver {
    /// Sums the landings of all branches from the starts of the runs.
    pub(crate) fn land(&self, reading: &Reading<'_>, runs: &[Run], memory: &mut Memory, results: &mut [f32]) {
        let Reading { field, from, base, lost, .. } = *reading;
        // Beyond the volume there is no layer, and all branches end before it.
        if field.is_empty() {
            return;
        }
        let Memory { sums, rows: read, along_z, .. } = memory;
        reading.reads.list_rows(self.padded.width, read);
        let length = self.padded.sum_len();
        sums.resize(sums.len().max(read.columns.len() * length), 0.0);
        let start = self.padded.at(from as i64, 0) as i64;
        along_z.clear();
        for (number, ((terms, of_z), sum)) in read.columns().zip(sums.chunks_exact_mut(length)).enumerate() {
            combine((field, start), terms, 0.0, (runs, LANES), sum);
            let points = of_z.iter().enumerate().filter(|(_, by)| **by != 0.0);
            along_z.extend(points.map(|(point, by)| Term { first: (number * length + point) as i64, by: *by }));
        }
        combine((sums, 0), along_z, base + lost, (runs, 0), results);
    }

    /// As [`LeadSolver::land`] for single groups and a reading without `base` and `lost`.
    pub(crate) fn land_groups(
        &self,
        reading: &Reading<'_>,
        groups: &[Group],
        memory: &mut Memory,
        results: &mut [f32],
    ) {
        if !reading.field.is_empty() {
            let start = self.padded.at(reading.from as i64, 0) as i64;
            reading.reads.list_rows(self.padded.width, &mut memory.rows);
            combine_groups((reading.field, start), &memory.rows, groups, &mut memory.wide, results);
        }
    }

    /// Writes the results of starts from which branches do not reach their landing: those from which branches end
    /// differently, one by one, and those from which all end alike.
    pub(crate) fn end(
        &self,
        reading: &Reading<'_>,
        ends: StepEnds<'_>,
        rows: Range<usize>,
        memory: &mut Memory,
        results: &mut [f32],
    ) {
        let Reading { starts, from, base, by_code, .. } = *reading;
        let width = self.padded.width;
        for mut word in ends.mixed_words(rows.clone()) {
            let [row, k] = word.first;
            word.starts &= starts.row(from + row)[k / WORD];
            if word.starts == 0 {
                continue;
            }
            ends.ends(&word, &mut memory.ends);
            while word.starts != 0 {
                let bit = word.starts.trailing_zeros() as usize;
                word.starts &= word.starts - 1;
                let place = self.padded.at((from + row) as i64, (k + bit) as i64);
                results[row * width + k + bit] = base
                    + match reading.order {
                        Order::Linear => self.mix::<2>(reading, &memory.ends, place, bit),
                        Order::Cubic => self.mix::<POINTS>(reading, &memory.ends, place, bit),
                    };
            }
        }
        for row in ends.step.certain.ending_rows(rows) {
            ends.step.certain.for_each_end(row, starts.row(from + row), |code, from, to| {
                results[row * width + from..row * width + to].fill(base + by_code[usize::from(code)]);
            });
        }
    }

    /// Sums what the branches of a step lead to from a start, with P points along each axis. `ends`: for each path of the
    /// branches, the starts of a word that go on, end in the target, and in an obstacle; `bit`: the start.
    #[inline(always)]
    fn mix<const P: usize>(&self, reading: &Reading<'_>, ends: &[[u64; 3]], start: usize, bit: usize) -> f32 {
        let Reading { field, reads, lost, by_code, .. } = *reading;
        let mut sum = 0.0;
        for (branches, of_z) in reads.columns() {
            for branch in branches {
                let [going, target, obstacle] = ends[branch.rest as usize].map(|ends| (ends >> bit & 1) as usize);
                sum += if going != 0 {
                    branch.weight * lost + branch.landing::<P>(of_z, field, start, self.padded.width)
                } else {
                    let code = usize::from(voxel::OUTSIDE) - 2 * target - obstacle;
                    branch.weight * by_code[code]
                };
            }
        }
        sum
    }
}
