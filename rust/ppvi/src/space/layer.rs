//! What later slices read of a slice: padded planes, one for each direction.

use crate::space::parts::SpaceParts;
use crate::space::reach::{LANES, PointSet};
use crate::space::voxels::MOST_ROWS;

/// Points around a landing that the interpolation reads, along each axis and to each side.
const AROUND: usize = 2;

/// Numbers in the sums of a block: a quarter of a first-level cache of 32 KiB.
const BLOCK_NUMBERS: usize = 2048;

/// Least number of rows of a block.
const LEAST_ROWS: usize = 4;

/// Values of a slice as later slices read them: `[direction]` padded planes, with means at the points of the target.
pub(crate) struct Layer {
    pub values: Vec<f32>,
    pub success: Vec<f32>,
    /// Cells in which landings are read from open states, for each direction.
    pub landings: Vec<PointSet>,
}

impl Layer {
    /// A layer with failures beyond the grid.
    pub(crate) fn new(parts: &SpaceParts, padded: Padded) -> Self {
        let numbers = padded.len() * parts.shape.directions;
        Layer {
            values: vec![parts.costs.exit as f32; numbers],
            success: vec![0.0; numbers],
            landings: vec![PointSet::of_cells(parts.shape); parts.shape.directions],
        }
    }
}

/// Layout of a padded plane: rows around the grid and a gap after each row, as wide as steps reach, so that all landings
/// are read from it. The points before a row are those of the gap after the row before.
#[derive(Clone, Copy)]
pub(crate) struct Padded {
    /// Rows before the first one of the grid, and after the last one.
    rows: usize,
    /// Points of a gap.
    gap: usize,
    ny: usize,
    /// Points from row to row.
    pub width: usize,
}

impl Padded {
    pub(crate) fn of(parts: &SpaceParts) -> Self {
        let branches = || parts.regions.iter().flatten().flat_map(|step| &step.branches);
        let reach = |axis: usize, count: usize| {
            let farthest = branches().map(|branch| branch.cell[axis].unsigned_abs() as usize).max().unwrap_or(0);
            farthest.min(count + 1) + AROUND
        };
        let (ny, nz) = (parts.shape.ny, parts.shape.nz);
        let (rows, gap) = (reach(0, ny), reach(1, nz));
        Padded { rows, gap, ny, width: nz + gap }
    }

    pub(crate) fn len(self) -> usize {
        // Sums of rows read a gap before the first one, and to the end of the row after the last one and of a group.
        (self.ny + 2 * self.rows + 1) * self.width + 2 * self.gap + 2 * LANES
    }

    /// Rows of a block, at most.
    pub(crate) fn block_rows(self) -> usize {
        (BLOCK_NUMBERS / self.width).clamp(LEAST_ROWS, MOST_ROWS)
    }

    /// Numbers of a block, at most, with those behind them that are computed in the last group.
    pub(crate) fn block_len(self) -> usize {
        self.block_rows() * self.width + LANES
    }

    /// Numbers of a sum over a block, with the group behind it, which the interpolation along z reads too.
    pub(crate) fn sum_len(self) -> usize {
        self.block_len() + LANES
    }

    /// A landing relative to its start, along an axis, within the padding: whatever is beyond it reads failures only.
    pub(crate) fn within(self, [y, z]: [i32; 2]) -> [i64; 2] {
        let limit = |by: i32, reach: usize| i64::from(by).clamp(-(reach as i64), reach as i64);
        [limit(y, self.rows - AROUND), limit(z, self.gap - AROUND)]
    }

    /// Index of the point `(j, k)`, which may be in the padding.
    #[inline]
    pub(crate) fn at(self, j: i64, k: i64) -> usize {
        ((j + self.rows as i64) * self.width as i64 + k) as usize + self.gap
    }
}
