//! Outcomes of paths for whole blocks of rows, with one bit for each voxel.
//!
//! All steps of a direction and an action pass the same voxels relative to their start. Voxels at the same offset from grid
//! points are a *phase*: a volume of bits with the shape of the grid, r^3 of them. So an offset is a phase and a shift by
//! whole points, and the outcomes of a block of rows are a few operations on shifted words: for each voxel of the path, the bits
//! of the rows that it leads to. The branches of a step go on where its common path has not ended. Where all of them end
//! alike, so does the step.
//! Rows are followed by a guard of bits that are outside, slices by guards of rows, and the volume by a slice
//! outside, so no shift needs a check. Of each voxel of a path only the rows are looked at from which it may end.

use std::ops::Range;

use rayon::prelude::*;

use crate::space::collision::voxel;
use crate::space::outcomes::{DirectionOutcomes, Outcomes, WORD};
use crate::space::parts::{SpaceParts, SpaceShape};
use crate::space::paths::{DirectionPaths, PathVoxel};

/// Rows of a block, at most: a bit each.
pub(crate) const MOST_ROWS: usize = WORD;

/// The voxels of a volume, one bit each.
pub(crate) struct VoxelBits {
    shape: SpaceShape,
    /// Words from row to row.
    stride: usize,
    /// Guard rows on each side of a slice.
    guard_rows: usize,
    /// Words before the first row and after the last one, so that shifts stay in the array.
    front: usize,
    phases: Vec<Phase>,
    /// Bits of the grid points of as many rows as a block has, each with its guard.
    whole_rows: Vec<u64>,
}

/// The voxels at one offset from grid points.
struct Phase {
    /// Voxels that are not free; those of the target; those of obstacles: `[slice][guarded row][word]`.
    kinds: [Vec<u64>; 3],
    /// Lines that are not free, and those with target or obstacles.
    lines: [Marks; 2],
}

impl VoxelBits {
    /// Takes the voxels, and the reach of all paths.
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let shape = parts.shape;
        let steps = || parts.regions.iter().flatten();
        let rests = steps().flat_map(|step| step.rests.iter().flatten());
        let offsets = steps().flat_map(|step| &step.path).chain(rests);
        let farthest = offsets.map(|offset| parts.voxels.place(*offset).1.map(i32::unsigned_abs));
        let farthest = farthest.fold([0; 3], |most, at| [0, 1, 2].map(|axis| at[axis].max(most[axis])));
        let reach = |axis: usize, count: usize| (farthest[axis] as usize).min(count);
        let (guard_rows, guard) = (reach(1, shape.ny), reach(2, shape.nz));
        // The guard of a row is also that before the next one.
        let (stride, front) = ((shape.nz + guard).div_ceil(WORD), guard / WORD + 1);
        let mut whole_row = vec![0u64; stride];
        (0..shape.nz).for_each(|k| whole_row[k / WORD] |= 1 << (k % WORD));
        let whole_rows = whole_row.repeat(MOST_ROWS.min(shape.ny));
        let mut bits = VoxelBits { shape, stride, guard_rows, front, phases: Vec::new(), whole_rows };
        let r = parts.voxels.refinement();
        // The voxels of a row along z belong to r phases.
        let of_rows = (0..r * r).into_par_iter().map(|phase| bits.phases_of_rows(parts, [phase / r, phase % r]));
        let phases: Vec<Vec<Phase>> = of_rows.collect();
        bits.phases = phases.into_iter().flatten().collect();
        bits
    }

    /// The phases of the rows of voxels at an offset from grid points along the axis and y.
    fn phases_of_rows(&self, parts: &SpaceParts, [of_slice, of_row]: [usize; 2]) -> Vec<Phase> {
        let (shape, stride, r) = (self.shape, self.stride, parts.voxels.refinement());
        let rows = shape.ny + 2 * self.guard_rows;
        let lines = (shape.slices + 1) * rows;
        let outside_of_grid: Vec<u64> = self.whole_rows[..stride].iter().map(|word| !word).collect();
        let outside = || [!0, 0, 0].map(|word| vec![word; 2 * self.front + lines * stride + 1]);
        let mut kinds: Vec<[Vec<u64>; 3]> = (0..r).map(|_| outside()).collect();
        let mut marked = vec![[vec![true; lines], vec![false; lines]]; r];
        for (slice, j) in (0..shape.slices).flat_map(|slice| (0..shape.ny).map(move |j| (slice, j))) {
            let line = slice * rows + self.guard_rows + j;
            let first = self.front + line * stride;
            for (kinds, [is_ending, _]) in kinds.iter_mut().zip(&mut marked) {
                kinds[0][first..first + stride].copy_from_slice(&outside_of_grid);
                is_ending[line] = false;
            }
            parts.voxels.for_each_code(slice * r + of_slice, j * r + of_row, |z, code| {
                let (k, kinds, [is_ending, is_marked]) = (z / r, &mut kinds[z % r], &mut marked[z % r]);
                let (word, bit) = (first + k / WORD, 1 << (k % WORD));
                kinds[0][word] |= bit;
                is_ending[line] = true;
                if let Some(kind) = [voxel::TARGET, voxel::OBSTACLE].iter().position(|kind| *kind == code) {
                    kinds[kind + 1][word] |= bit;
                    is_marked[line] = true;
                }
            });
        }
        let phase = |(kinds, marked): ([Vec<u64>; 3], [Vec<bool>; 2])| Phase {
            kinds,
            lines: marked.map(|marked| Marks::new(&marked)),
        };
        kinds.into_iter().zip(marked).map(phase).collect()
    }

    /// Finds the outcomes of the steps of a direction from all points of `rows` rows of a slice from row `j` on.
    pub(crate) fn outcomes(&self, at: [usize; 3], paths: &DirectionPaths, found: &mut DirectionOutcomes) {
        found.begin(paths);
        let DirectionOutcomes { commons, rests, steps } = found;
        for (path, outcomes) in paths.commons.iter().zip(&mut *commons) {
            self.begin(at[2], outcomes);
            self.follow(at, path, None, outcomes);
        }
        for ((common, path), outcomes) in paths.rests.iter().zip(&mut *rests) {
            outcomes.begin(self.stride, commons[*common].shifts);
            self.follow(at, path, Some(&commons[*common].goes_on), outcomes);
        }
        for (paths, step) in paths.steps.iter().zip(steps) {
            step.compare(paths, commons, rests);
            if step.certain.may_end {
                step.certain.find_ending_rows(&self.whole_rows);
            }
        }
    }

    /// Begins paths from all points of `rows` rows.
    fn begin(&self, rows: usize, found: &mut Outcomes) {
        found.begin(self.stride, [0; 2]);
        found.goes_on.clear();
        found.goes_on.extend_from_slice(&self.whole_rows[..rows * self.stride]);
    }

    /// Follows a path from the starts that still go on; `common`, those that go on at its beginning, if they are not in
    /// `found`: they are copied when the path may end.
    fn follow(
        &self,
        [slice, j, rows]: [usize; 3],
        path: &[PathVoxel],
        mut common: Option<&Vec<u64>>,
        found: &mut Outcomes,
    ) {
        let limit = |by: i32, count: usize| i64::from(by).clamp(-(count as i64), count as i64);
        let spared = self.spared([slice, j, rows]);
        for PathVoxel { phase, point: [ds, dj, dk], is_near } in path {
            let phase = &self.phases[*phase as usize];
            let slice = (slice + *ds as usize).min(self.shape.slices);
            let row = (j + self.guard_rows) as i64 + limit(*dj, self.guard_rows);
            let line = slice * (self.shape.ny + 2 * self.guard_rows) + row as usize;
            let dk = limit(*dk, self.shape.nz);
            let [low, high] = &mut found.shifts;
            let met = match *low <= dk && dk <= *high {
                true => phase.lines[0].within(line..line + rows),
                // Starts whose paths leave the grid here are in all rows.
                false => line..line + rows,
            };
            if met.is_empty() {
                continue;
            }
            let spared = spared.filter(|_| *is_near);
            if spared.is_none() {
                (*low, *high) = ((*low).min(dk), (*high).max(dk));
            }
            let first = (self.front + met.start * self.stride) as i64 + dk.div_euclid(WORD as i64);
            let (first, shift) = (first as usize, dk.rem_euclid(WORD as i64) as u32);
            if let Some(common) = common.take() {
                found.goes_on.clone_from(common);
            }
            let words = met.len() * self.stride;
            let may_mark = !phase.lines[1].within(met.clone()).is_empty();
            let spared = spared.map(|spared| &spared[(met.start - line) * self.stride..]);
            let kinds = phase.kinds.each_ref().map(|kind| &kind[first..][..words + 1]);
            let words = (met.start - line) * self.stride..(met.end - line) * self.stride;
            found.meet((kinds, shift), spared, words, may_mark);
        }
    }

    /// Starts that are not free, if there are any in these rows: executions from there leave their place without a test.
    fn spared(&self, [slice, j, rows]: [usize; 3]) -> Option<&[u64]> {
        let line = slice * (self.shape.ny + 2 * self.guard_rows) + j + self.guard_rows;
        let words = (self.phases.len() > 1 && !self.phases[0].lines[0].within(line..line + rows).is_empty())
            .then(|| self.front + line * self.stride..self.front + (line + rows) * self.stride);
        words.map(|words| &self.phases[0].kinds[0][words])
    }
}

/// Lines with a property.
#[derive(Default)]
struct Marks {
    /// The first such line from each line on, and the end of the last one before it.
    next: Vec<u32>,
    end: Vec<u32>,
}

impl Marks {
    fn new(marked: &[bool]) -> Self {
        let count = marked.len();
        let (mut next, mut end) = (vec![count as u32; count + 1], vec![0; count + 1]);
        for line in 0..count {
            end[line + 1] = if marked[line] { line as u32 + 1 } else { end[line] };
            let line = count - 1 - line;
            next[line] = if marked[line] { line as u32 } else { next[line + 1] };
        }
        Marks { next, end }
    }

    /// The lines from the first to the last with the property.
    #[inline]
    fn within(&self, lines: Range<usize>) -> Range<usize> {
        self.next[lines.start] as usize..self.end[lines.end] as usize
    }
}
