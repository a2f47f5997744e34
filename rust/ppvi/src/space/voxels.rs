//! Outcomes of paths for whole blocks of rows, with one bit for each voxel.
//!
//! All steps of a direction and an action pass the same voxels relative to their start. So the outcomes of a block of rows
//! are a few operations on shifted words: for each voxel of the path, the bits of the rows that it leads to. The branches of
//! a step go on where its common path has not ended. Where all of them end alike, so does the step.
//! Rows are followed by a guard of words whose bits are outside, slices by guards of rows, and the volume by a slice
//! outside, so no shift needs a check. Voxels of a path at which no row of the block can end are skipped.

use crate::space::outcomes::{Outcomes, StepOutcomes, WORD};
use crate::space::parts::{SpaceParts, SpaceShape, SpaceStep, voxel};

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
    /// Rows before each one of a slice that are not free, and those with target or obstacles.
    counts: [Vec<u32>; 2],
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
        let (guard_rows, guard) = (reach(1, shape.ny), reach(2, shape.nz) / WORD + 1);
        let words = shape.nz.div_ceil(WORD);
        let stride = words + guard;
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
            front: guard,
            kinds: [!0, 0, 0].map(|word| vec![word; 2 * guard + lines * stride + 1]),
            counts: [vec![0], vec![0]],
            whole_rows,
        };
        for line in 0..lines {
            let (slice, j) = (line / rows, (line % rows).wrapping_sub(guard_rows));
            let (mut is_free, mut is_marked) = (false, false);
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
                is_free = codes.iter().all(|code| *code == voxel::FREE);
                is_marked = codes.iter().any(|code| [voxel::TARGET, voxel::OBSTACLE].contains(code));
            }
            for (counts, counted) in bits.counts.iter_mut().zip([!is_free, is_marked]) {
                counts.push(counts[line] + u32::from(counted));
            }
        }
        bits
    }

    /// Finds the outcomes of a step and its branches from all points of `rows` rows from row `j` on.
    pub(crate) fn outcomes(&self, at: [usize; 3], step: &SpaceStep, found: &mut StepOutcomes) {
        self.begin(at[2], &mut found.certain);
        self.follow(at, &step.path, None, &mut found.certain);
        let rests = step.rests.len();
        found.rests.resize(rests.max(found.rests.len()), Outcomes::default());
        for (path, outcomes) in step.rests.iter().zip(&mut found.rests) {
            outcomes.begin(self.stride, found.certain.shifts);
            self.follow(at, path, Some(&found.certain.goes_on), outcomes);
        }
        found.compare(rests);
        if found.certain.may_end {
            found.certain.find_ending_rows(&self.whole_rows);
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
            let any = |kind: usize| self.counts[kind][line + rows] > self.counts[kind][line];
            let [low, high] = &mut found.shifts;
            if !any(0) && *low <= dk && dk <= *high {
                continue;
            }
            (*low, *high) = ((*low).min(dk), (*high).max(dk));
            let first = (self.front + line * self.stride) as i64 + dk.div_euclid(WORD as i64);
            let (first, shift) = (first as usize, dk.rem_euclid(WORD as i64) as u32);
            if let Some(common) = common.take() {
                found.goes_on.clone_from(common);
            }
            found.meet(self.kinds.each_ref().map(|kind| &kind[first..][..rows * self.stride + 1]), shift, any(1));
        }
    }

    /// Finds the codes of the rows themselves.
    pub(crate) fn codes(&self, at: [usize; 3], found: &mut Outcomes) {
        self.begin(at[2], found);
        self.follow(at, &[[0; 3]], None, found);
        found.find_ending_rows(&self.whole_rows);
    }
}
