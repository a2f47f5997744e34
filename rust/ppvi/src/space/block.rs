//! The backups of one direction of a slice, block by block of rows.
//!
//! # Layout
//!
//! A layer holds two fields, values and success, as one padded plane of single precision for each direction. A step moves all
//! points of a plane by the same offset, so nothing is gathered: what is read are rows, shifted. A block has so many
//! rows that the sums of its planes stay in the first-level cache.
//!
//! 1. For every action: the sum of up to nine planes with the weights of the stencil; the bilinear interpolation of its
//!    rows; failures over the ends of paths, which are runs of bits; the comparison with the best action so far. This
//!    reads values only.
//! 2. The choice of a point is a number of 32 bits: region, action, code of the end. Later choices are larger.
//! 3. For every choice that occurs: success in the rows of the points that made it, by the same steps, with the
//!    interpolation of success. Only the points with this choice take it.

use crate::space::kernel::{
    Order, add_prices, combine, interpolate, interpolate_linear, keep_better, keep_region, mark_code, occurs, range,
    rename, store, take_chosen, weights,
};
use crate::space::layer::{Layer, Padded};
use crate::space::parts::{SpaceParts, SpaceShape, SpaceStep, voxel};
use crate::space::voxels::{MOST_ROWS, Outcomes, PAD, VoxelBits};

/// Numbers in the sums of a block: a quarter of a first-level cache of 32 KiB.
const BLOCK_NUMBERS: usize = 2048;

/// Position of the action in a choice; the code of the end is below it.
const ACTION_BITS: u32 = 8;

/// Position of the region in a choice.
const REGION_BITS: u32 = 16;

/// The planes that a direction writes.
pub(crate) struct Plane<'a> {
    pub layer_values: &'a mut [f32],
    pub layer_success: &'a mut [f32],
    pub values: &'a mut [f32],
    pub policy: &'a mut [u8],
    pub success: &'a mut [u16],
}

/// Memory of a thread. Rows of a block are as wide as those of padded planes, so that a block is one array for every
/// operation on it; the last points of a row have no meaning.
pub(crate) struct Block {
    /// Rows of a block, but for the last one of a plane.
    rows: usize,
    /// Sum of planes, as wide as padded ones.
    sums: Vec<f32>,
    between: Vec<f32>,
    /// Costs of a step, and chances.
    costs: Vec<f32>,
    ends: Outcomes,
    regions: Vec<u8>,
    /// First row of each region, and the row after its last one; equal where it does not occur.
    spans: Vec<[usize; 2]>,
    best: Vec<f32>,
    choices: Vec<u32>,
    success: Vec<f32>,
}

impl Block {
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let (shape, padded) = (parts.shape, Padded::of(parts.shape));
        let rows = (BLOCK_NUMBERS / padded.width).clamp(4, MOST_ROWS).min(shape.ny);
        let points = rows * padded.width;
        Block {
            rows,
            sums: vec![0.0; (rows + 2 * PAD) * padded.width],
            between: Vec::new(),
            costs: vec![0.0; points],
            ends: Outcomes::default(),
            regions: vec![0; points],
            spans: vec![[0; 2]; parts.regions.len()],
            best: vec![0.0; points],
            choices: vec![0; points],
            success: vec![0.0; points],
        }
    }
}

/// Backs up blocks.
pub(crate) struct BlockSolver<'a> {
    pub parts: &'a SpaceParts,
    /// Interpolation of success.
    order: Order,
    bits: VoxelBits,
    padded: Padded,
}

impl<'a> BlockSolver<'a> {
    pub(crate) fn new(parts: &'a SpaceParts, order: Order) -> Self {
        BlockSolver { parts, order, bits: VoxelBits::new(parts), padded: Padded::of(parts.shape) }
    }

    /// Backs up the states of a direction. `ahead` is the layer in which the steps end, None beyond the volume.
    pub(crate) fn direction(
        &self,
        [slice, direction]: [usize; 2],
        ahead: Option<&Layer>,
        block: &mut Block,
        plane: &mut Plane<'_>,
    ) {
        let SpaceShape { ny, nz, .. } = self.parts.shape;
        for j in (0..ny).step_by(block.rows) {
            let rows = block.rows.min(ny - j);
            self.find_regions([slice, direction], [j, rows], block);
            block.best[..rows * self.padded.width].fill(f32::INFINITY);
            block.choices.fill(0);
            for region in 0..self.parts.regions.len() {
                let [first, end] = block.spans[region];
                for action in (0..self.parts.actions()).filter(|_| first < end) {
                    self.step([slice, direction], [j, first, end], [region, action], ahead, block);
                }
            }
            self.end_in_voxels(slice, [j, rows], block);
            self.find_success(direction, j, ahead, block);
            for row in 0..rows {
                let (from, to) = (row * self.padded.width, self.padded.at((j + row) as i64, 0));
                let (values, chances) = (&block.best[from..][..nz], &block.success[from..][..nz]);
                plane.layer_values[to..][..nz].copy_from_slice(values);
                plane.layer_success[to..][..nz].copy_from_slice(chances);
                let table = (j + row) * nz..(j + row + 1) * nz;
                plane.values[table.clone()].copy_from_slice(values);
                let (success, policy) = (&mut plane.success[table.clone()], &mut plane.policy[table]);
                store(chances, &block.choices[from..][..nz], ACTION_BITS, success, policy);
            }
        }
    }

    /// Finds the regions of the steps from a block, and the rows in which each occurs.
    fn find_regions(&self, [slice, direction]: [usize; 2], [j, rows]: [usize; 2], block: &mut Block) {
        let (parts, nz) = (self.parts, self.parts.shape.nz);
        if parts.region_of.is_empty() {
            block.spans[0] = [0, rows];
            return;
        }
        block.spans.fill([rows, 0]);
        for (row, regions) in block.regions.chunks_exact_mut(self.padded.width).enumerate().take(rows) {
            parts.regions_of_row(slice, direction, j + row, &mut regions[..nz]);
            let mut add = |region: u8| {
                let [first, end] = &mut block.spans[usize::from(region)];
                (*first, *end) = ((*first).min(row), row + 1);
            };
            match range(&regions[..nz]) {
                [low, high] if low == high => add(low),
                _ => regions[..nz].iter().for_each(|region| add(*region)),
            }
        }
    }

    fn failure_cost(&self, code: u8) -> f32 {
        match code {
            voxel::OBSTACLE => self.parts.costs.collision as f32,
            voxel::OUTSIDE => self.parts.costs.exit as f32,
            _ => 0.0,
        }
    }

    /// Rows from `j` on whose landings are in the grid.
    fn landing_rows(&self, step: &SpaceStep, [j, rows]: [usize; 2]) -> [usize; 2] {
        let nearest = i64::from(step.cell[0]) + i64::from(step.fraction[0] >= 0.5);
        [0, self.parts.shape.ny as i64].map(|row| (row - nearest - j as i64).clamp(0, rows as i64) as usize)
    }

    /// Sums the planes of a step for landings from `rows`, with `around` points more on each side. The sums are as wide as
    /// padded planes and start with the first point that the interpolation at the first landing reads.
    fn sum(&self, step: &SpaceStep, rows: [usize; 2], around: usize, field: &[f32], sums: &mut [f32]) {
        let (around, stride) = (around as i64, self.padded.width);
        let first = rows[0] as i64 + i64::from(step.cell[0]) - around;
        let from = self.padded.at(first, -(PAD as i64)) as i64 + i64::from(step.cell[1]) - around + PAD as i64;
        // The last landing of a row has no meaning, and neither have the points after it.
        let count = (rows[1] - rows[0] + 1 + 2 * around as usize) * stride;
        let plane = |direction: u32| &field[direction as usize * self.padded.len()..][..self.padded.len()];
        let planes: Vec<_> = step.taps.iter().map(|tap| (plane(tap.direction), tap.weight as f32)).collect();
        combine(&planes, from as usize, &mut sums[..count]);
    }

    /// Compares a step with the best one so far, wherever it starts in its region. Rows `first` to `end` of a block
    /// from row `j` on hold this region.
    fn step(
        &self,
        [slice, direction]: [usize; 2],
        [j, first, end]: [usize; 3],
        [region, action]: [usize; 2],
        ahead: Option<&Layer>,
        block: &mut Block,
    ) {
        let (parts, SpaceShape { ny, nz, .. }, stride) = (self.parts, self.parts.shape, self.padded.width);
        let step = parts.step(region, direction, action);
        let choice = (region as u32) << REGION_BITS | (action as u32) << ACTION_BITS;
        let Block { sums, costs, ends, regions, best, choices, .. } = block;
        let (j, rows) = (j + first, end - first);
        let of_rows = first * stride..end * stride;
        let (costs, regions) = (&mut costs[of_rows.clone()], &regions[of_rows.clone()]);
        let (best, choices) = (&mut best[of_rows.clone()], &mut choices[of_rows]);
        self.bits.outcomes([slice, j, rows], &step.path, ends);
        let (cost, lost) = (step.cost as f32, (step.lost * parts.costs.exit) as f32);
        let landing = self.landing_rows(step, [j, rows]);
        match ahead.filter(|_| !step.taps.is_empty()) {
            Some(ahead) if landing[0] < landing[1] && self.lands(step) => {
                let costs = &mut costs[landing[0] * stride..landing[1] * stride - PAD];
                self.sum(step, landing.map(|row| j + row), 0, &ahead.values, sums);
                interpolate_linear(sums, stride, step.fraction.map(|f| f as f32), cost + lost, costs);
            }
            Some(_) => {}
            None => ends.end_outside(),
        }
        // What has landed outside is overwritten, since its path ends there.
        for row in ends.ending_rows(rows) {
            let costs = &mut costs[row * stride..row * stride + nz];
            let fill = |code: u8, from: usize, to: usize| costs[from..to].fill(cost + self.failure_cost(code));
            self.bits.for_each_end(ends, row, fill);
        }
        for row in (0..rows).filter(|_| !(parts.prices.is_empty() && parts.region_of.is_empty())) {
            let of_row = row * stride..row * stride + nz;
            let costs = &mut costs[of_row.clone()];
            if !parts.prices.is_empty() {
                add_prices(&parts.prices[(slice * ny + j + row) * nz..][..nz], step.length as f32, costs);
            }
            if !parts.region_of.is_empty() {
                keep_region(region as u8, &regions[of_row], costs);
            }
        }
        keep_better(costs, choice, best, choices);
        for row in ends.ending_rows(rows) {
            self.bits.for_each_end(ends, row, |code, from, to| {
                let choices = &mut choices[row * stride..][from..to];
                rename(choice, choice | u32::from(code), choices);
            });
        }
    }

    /// Whether any point of a row lands in the grid.
    fn lands(&self, step: &SpaceStep) -> bool {
        let nz = self.parts.shape.nz as i64;
        (i64::from(step.cell[1]) + i64::from(step.fraction[1] >= 0.5)).abs() < nz
    }

    /// Writes the ends of the points in voxels that are not free.
    fn end_in_voxels(&self, slice: usize, [j, rows]: [usize; 2], block: &mut Block) {
        self.bits.codes([slice, j, rows], &mut block.ends);
        for row in block.ends.ending_rows(rows) {
            self.bits.for_each_end(&block.ends, row, |code, from, to| {
                block.best[row * self.padded.width..][from..to].fill(self.failure_cost(code));
                block.choices[row * self.padded.width..][from..to].fill(u32::from(code));
            });
        }
    }

    /// Finds the probability of success of the choices of a block.
    fn find_success(&self, direction: usize, j: usize, ahead: Option<&Layer>, block: &mut Block) {
        let (parts, nz, stride) = (self.parts, self.parts.shape.nz, self.padded.width);
        mark_code(voxel::TARGET, &block.choices, &mut block.success);
        let Some(ahead) = ahead else { return };
        let numbers = 0..parts.regions.len();
        for (region, action) in numbers.flat_map(|region| (0..parts.actions()).map(move |action| (region, action))) {
            let choice = (region as u32) << REGION_BITS | (action as u32) << ACTION_BITS;
            let occurs = |row: &usize| occurs(choice, &block.choices[row * stride..][..nz]);
            let [first, end] = block.spans[region];
            let Some(first) = (first..end).find(occurs) else { continue };
            let end = (first..end).rfind(occurs).unwrap_or(first) + 1;
            let step = parts.step(region, direction, action);
            // Points that land outside have made other choices.
            let [above, below] = self.landing_rows(step, [j + first, end - first]);
            let (first, end) = (first + above, first + below);
            self.sum(step, [j + first, j + end], 1, &ahead.success, &mut block.sums);
            let along = step.fraction.map(|f| weights(self.order, f));
            let points = first * stride..end * stride - PAD;
            let chances = &mut block.costs[points.clone()];
            interpolate(&block.sums, stride, along, &mut block.between, chances);
            take_chosen(chances, choice, &block.choices[points.clone()], &mut block.success[points]);
        }
    }
}
