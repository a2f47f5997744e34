//! Outcomes of paths for whole blocks of rows, with one bit for each voxel.
//!
//! All steps of a direction and an action pass the same voxels relative to their start. So the outcomes of a block of rows
//! are a few operations on shifted words: for each voxel of the path, the bits of the rows that it leads to. The branches of
//! a step go on where its common path has not ended. Where all of them end alike, so does the step.
//! Rows are followed by a guard of bits that are outside, slices by guards of rows, and the volume by a slice
//! outside, so no shift needs a check. Of each voxel of a path only the rows are looked at from which it may end.

use std::ops::Range;

use crate::space::outcomes::{DirectionOutcomes, Outcomes, WORD};
use crate::space::parts::{SpaceParts, SpaceShape, voxel};
use crate::space::paths::DirectionPaths;

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
    /// Voxels that are not free; those of the target; those of obstacles: `[slice][guarded row][word]`.
    kinds: [Vec<u64>; 3],
    /// Lines that are not free, and those with target or obstacles.
    lines: [Marks; 2],
    /// Bits of the grid points of as many rows as a block has, each with its guard.
    whole_rows: Vec<u64>,
}

impl VoxelBits {
    /// Takes the voxels, and the reach of all paths.
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let shape = parts.shape;
        let reach = |axis: usize, count: usize| {
            let steps = || parts.regions.iter().flatten();
            let rests = steps().flat_map(|step| step.rests.iter().flatten());
            steps()
                .flat_map(|step| &step.path)
                .chain(rests)
                .map(|offset| offset[axis].unsigned_abs() as usize)
                .max()
                .unwrap_or(0)
                .min(count)
        };
        let (guard_rows, guard) = (reach(1, shape.ny), reach(2, shape.nz));
        // The guard of a row is also that before the next one.
        let (stride, front) = ((shape.nz + guard).div_ceil(WORD), guard / WORD + 1);
        let rows = shape.ny + 2 * guard_rows;
        let mut whole_row = vec![0u64; stride];
        (0..shape.nz).for_each(|k| whole_row[k / WORD] |= 1 << (k % WORD));
        let outside_of_grid: Vec<u64> = whole_row.iter().map(|word| !word).collect();
        let whole_rows = whole_row.repeat(MOST_ROWS.min(shape.ny));
        let lines = (shape.slices + 1) * rows;
        let mut bits = VoxelBits {
            shape,
            stride,
            guard_rows,
            front,
            kinds: [!0, 0, 0].map(|word| vec![word; 2 * front + lines * stride + 1]),
            lines: Default::default(),
            whole_rows,
        };
        let [mut is_ending, mut is_marked] = [vec![true; lines], vec![false; lines]];
        for (line, (is_ending, is_marked)) in is_ending.iter_mut().zip(&mut is_marked).enumerate() {
            let (slice, j) = (line / rows, (line % rows).wrapping_sub(guard_rows));
            if slice < shape.slices && j < shape.ny {
                let codes = &parts.voxels[(slice * shape.ny + j) * shape.nz..][..shape.nz];
                let first = bits.front + line * stride;
                bits.kinds[0][first..first + stride].copy_from_slice(&outside_of_grid);
                for (k, code) in codes.iter().enumerate().filter(|(_, code)| **code != voxel::FREE) {
                    let (word, bit) = (first + k / WORD, 1 << (k % WORD));
                    bits.kinds[0][word] |= bit;
                    match *code {
                        voxel::TARGET => bits.kinds[1][word] |= bit,
                        voxel::OBSTACLE => bits.kinds[2][word] |= bit,
                        _ => {}
                    }
                }
                *is_ending = codes.iter().any(|code| *code != voxel::FREE);
                *is_marked = codes.iter().any(|code| [voxel::TARGET, voxel::OBSTACLE].contains(code));
            }
        }
        bits.lines = [is_ending, is_marked].map(|marked| Marks::new(&marked));
        bits
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
        path: &[[i32; 3]],
        mut common: Option<&Vec<u64>>,
        found: &mut Outcomes,
    ) {
        let limit = |by: i32, count: usize| i64::from(by).clamp(-(count as i64), count as i64);
        for [ds, dj, dk] in path {
            let slice = (slice + *ds as usize).min(self.shape.slices);
            let row = (j + self.guard_rows) as i64 + limit(*dj, self.guard_rows);
            let line = slice * (self.shape.ny + 2 * self.guard_rows) + row as usize;
            let dk = limit(*dk, self.shape.nz);
            let [low, high] = &mut found.shifts;
            let met = match *low <= dk && dk <= *high {
                true => self.lines[0].within(line..line + rows),
                // Starts whose paths leave the grid here are in all rows.
                false => line..line + rows,
            };
            if met.is_empty() {
                continue;
            }
            (*low, *high) = ((*low).min(dk), (*high).max(dk));
            let first = (self.front + met.start * self.stride) as i64 + dk.div_euclid(WORD as i64);
            let (first, shift) = (first as usize, dk.rem_euclid(WORD as i64) as u32);
            if let Some(common) = common.take() {
                found.goes_on.clone_from(common);
            }
            let words = met.len() * self.stride;
            let may_mark = !self.lines[1].within(met.clone()).is_empty();
            let kinds = self.kinds.each_ref().map(|kind| &kind[first..][..words + 1]);
            found.meet(kinds, shift, (met.start - line) * self.stride..(met.end - line) * self.stride, may_mark);
        }
    }

    /// The words of a row with all its points.
    pub(crate) fn whole_row(&self) -> &[u64] {
        &self.whole_rows[..self.shape.nz.div_ceil(WORD)]
    }

    /// Finds the codes of the rows themselves.
    pub(crate) fn codes(&self, at: [usize; 3], found: &mut Outcomes) {
        self.begin(at[2], found);
        self.follow(at, &[[0; 3]], None, found);
        found.find_ending_rows(&self.whole_rows);
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
