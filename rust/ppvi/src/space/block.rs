//! The backups of one direction of a slice, block by block of rows.
//!
//! # Layout
//!
//! A layer holds two fields, values and success, as one padded plane of single precision for each direction. A step moves all
//! points of a plane by the same offset, so nothing is gathered: what is read are rows, shifted. A block has so many
//! rows that the sums of its planes stay in the first-level cache.
//!
//! 1. For every action: the landings of its branches. Branches that land in the same column of the grid are interpolated
//!    along y and summed first; these sums are interpolated along z and summed. Both are sums of shifted arrays.
//! 2. Failures over the starts from which all branches end alike, which are runs of bits. From a start whose branches end
//!    differently, they are summed one by one: such starts are few.
//! 3. The comparison with the best action so far. This reads values only. The choice of a point is a number of 32 bits:
//!    region, action, and a code below it. Later choices are larger.
//! 4. For every choice that occurs: success in the rows of the points that made it, by the same steps, with the
//!    interpolation of success. Only the points with this choice take it.

use crate::space::kernel::{
    Order, add_prices, combine, keep_better, keep_region, mark_code, occurs, range, store, take_chosen, weights,
};
use crate::space::layer::{Layer, Padded};
use crate::space::parts::{Branch, SpaceParts, SpaceShape, SpaceStep, voxel};
use crate::space::voxels::{MOST_ROWS, Outcomes, StepOutcomes, VoxelBits};

/// Numbers in the sums of a block: a quarter of a first-level cache of 32 KiB.
const BLOCK_NUMBERS: usize = 2048;

/// Points of the interpolation along an axis.
const POINTS: usize = 4;

/// Position of the action in a choice; the code of a voxel that is not free is below it.
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

/// What landings are read from.
#[derive(Clone, Copy)]
struct Reading<'a> {
    /// Planes of the layer in which the steps end.
    field: &'a [f32],
    order: Order,
    /// Row of the first start.
    j: usize,
}

/// What a branch reads of the layer in which it ends.
struct Footprint {
    rest: usize,
    /// Place of the first point relative to the start in the plane of the first direction.
    first: i64,
    /// Weights along y and z.
    along: [[f32; POINTS]; 2],
    /// Probability, and that of reaching the landing in a direction of the grid.
    weight: f32,
    probability: f32,
}

/// Memory of a thread. Rows of a block are as wide as those of padded planes, so that a block is one array for every
/// operation on it; the last points of a row have no meaning.
pub(crate) struct Block {
    /// Rows of a block, but for the last one of a plane.
    rows: usize,
    /// Sums of the rows of each column of landings.
    sums: Vec<f32>,
    /// Costs of a step, and chances.
    costs: Vec<f32>,
    ends: StepOutcomes,
    footprints: Vec<Footprint>,
    codes: Outcomes,
    regions: Vec<u8>,
    /// First row of each region, and the row after its last one; equal where it does not occur.
    spans: Vec<[usize; 2]>,
    best: Vec<f32>,
    choices: Vec<u32>,
    success: Vec<f32>,
}

impl Block {
    pub(crate) fn new(parts: &SpaceParts, padded: Padded) -> Self {
        let shape = parts.shape;
        let rows = (BLOCK_NUMBERS / padded.width).clamp(4, MOST_ROWS).min(shape.ny);
        let points = rows * padded.width;
        Block {
            rows,
            sums: Vec::new(),
            costs: vec![0.0; points],
            ends: StepOutcomes::default(),
            footprints: Vec::new(),
            codes: Outcomes::default(),
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
    pub padded: Padded,
}

impl<'a> BlockSolver<'a> {
    pub(crate) fn new(parts: &'a SpaceParts, order: Order) -> Self {
        BlockSolver { parts, order, bits: VoxelBits::new(parts), padded: Padded::of(parts) }
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
            if self.order == Order::Linear {
                self.end_in_voxels(slice, [j, rows], block);
            }
            self.find_success([slice, direction], j, ahead, block);
            if self.order == Order::Cubic {
                self.end_in_voxels(slice, [j, rows], block);
            }
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

    /// Probability of a branch that reaches its landing in a direction of the grid.
    fn probability(step: &SpaceStep, branch: &Branch) -> f32 {
        (branch.weight * (1.0 - step.lost)) as f32
    }

    /// Sums the landings of all branches from the rows `j` on, and a number. The last points of a row have no meaning.
    fn land(&self, step: &SpaceStep, reading: Reading<'_>, add: f32, sums: &mut Vec<f32>, landings: &mut [f32]) {
        let Reading { field, order, j } = reading;
        let columns = || step.branches.chunk_by(|a, b| (a.cell[1], a.fraction[1]) == (b.cell[1], b.fraction[1]));
        let length = landings.len() + POINTS - 1;
        sums.resize(columns().count() * length, 0.0);
        let mut rows = Vec::with_capacity(POINTS * step.branches.len());
        let mut shifted = Vec::with_capacity(POINTS * step.branches.len());
        for (column, sum) in columns().zip(sums.chunks_exact_mut(length)) {
            rows.clear();
            for branch in column {
                let (weight, [y, z]) = (Self::probability(step, branch), self.padded.within(branch.cell));
                let plane = self.plane(field, branch.direction);
                for (by, point) in weights(order, branch.fraction[0], step.spread[0]).into_iter().zip(-1..) {
                    rows.push((&plane[self.padded.at(j as i64 + y + point, z - 1)..], by * weight));
                }
            }
            rows.retain(|(_, by)| *by != 0.0);
            combine(&rows, 0.0, sum);
        }
        for (column, sum) in columns().zip(sums.chunks_exact(length)) {
            let along = weights(order, column[0].fraction[1], step.spread[1]);
            shifted.extend(along.into_iter().enumerate().map(|(point, by)| (&sum[point..], by)));
        }
        shifted.retain(|(_, by)| *by != 0.0);
        combine(&shifted, add, landings);
    }

    fn plane<'b>(&self, field: &'b [f32], direction: u32) -> &'b [f32] {
        &field[direction as usize * self.padded.len()..][..self.padded.len()]
    }

    /// What a start reads for each branch of a step.
    fn footprints(&self, step: &SpaceStep, order: Order, found: &mut Vec<Footprint>) {
        found.clear();
        found.extend(step.branches.iter().map(|branch| {
            let [y, z] = self.padded.within(branch.cell);
            let first = (y - 1) * self.padded.width as i64 + z - 1;
            Footprint {
                rest: branch.rest,
                first: branch.direction as i64 * self.padded.len() as i64 + first,
                along: [0, 1].map(|axis| weights(order, branch.fraction[axis], step.spread[axis])),
                weight: branch.weight as f32,
                probability: Self::probability(step, branch),
            }
        }));
    }

    /// The landing from one start; `start` is its index in a plane.
    #[inline]
    fn landing(&self, footprint: &Footprint, reading: Reading<'_>, start: usize) -> f32 {
        let first = (start as i64 + footprint.first) as usize;
        let points = if reading.order == Order::Linear { 1..3 } else { 0..POINTS };
        let [of_y, of_z] = &footprint.along;
        let mut sum = 0.0;
        for y in points.clone() {
            let row = &reading.field[first + y * self.padded.width..][..POINTS];
            sum += of_y[y] * points.clone().map(|z| of_z[z] * row[z]).sum::<f32>();
        }
        sum
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
        let Block { sums, costs, ends, footprints, regions, best, choices, .. } = block;
        let (j, rows) = (j + first, end - first);
        let of_rows = first * stride..end * stride;
        let (costs, regions) = (&mut costs[of_rows.clone()], &regions[of_rows.clone()]);
        let (best, choices) = (&mut best[of_rows.clone()], &mut choices[of_rows]);
        self.bits.outcomes([slice, j, rows], step, ends);
        let (cost, lost) = (step.cost as f32, (step.lost * parts.costs.exit) as f32);
        // Beyond the volume there is no layer, and all branches end before it.
        let reading = Reading { field: ahead.map_or(&[], |ahead| &ahead.values), order: Order::Linear, j };
        if ahead.is_some() {
            self.land(step, reading, cost + lost, sums, costs);
        }
        self.footprints(step, Order::Linear, footprints);
        ends.for_each_mixed(|[row, k], code| {
            let start = self.padded.at((j + row) as i64, k as i64);
            let after = |branch: &Footprint| match code(branch.rest) {
                voxel::FREE => branch.weight * lost + branch.probability * self.landing(branch, reading, start),
                code => branch.weight * self.failure_cost(code),
            };
            costs[row * stride + k] = cost + footprints.iter().map(after).sum::<f32>();
        });
        for row in ends.certain.ending_rows(rows) {
            let costs = &mut costs[row * stride..row * stride + nz];
            let fill = |code: u8, from: usize, to: usize| costs[from..to].fill(cost + self.failure_cost(code));
            self.bits.for_each_end(&ends.certain, row, fill);
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
    }

    /// Writes the ends of the points in voxels that are not free.
    fn end_in_voxels(&self, slice: usize, [j, rows]: [usize; 2], block: &mut Block) {
        self.bits.codes([slice, j, rows], &mut block.codes);
        for row in block.codes.ending_rows(rows) {
            self.bits.for_each_end(&block.codes, row, |code, from, to| {
                block.best[row * self.padded.width..][from..to].fill(self.failure_cost(code));
                block.choices[row * self.padded.width..][from..to].fill(u32::from(code));
            });
        }
    }

    /// Finds the probability of success of the choices of a block.
    fn find_success(&self, [slice, direction]: [usize; 2], j: usize, ahead: Option<&Layer>, block: &mut Block) {
        let (parts, nz, stride) = (self.parts, self.parts.shape.nz, self.padded.width);
        mark_code(voxel::TARGET, &block.choices, &mut block.success);
        let numbers = 0..parts.regions.len();
        for (region, action) in numbers.flat_map(|region| (0..parts.actions()).map(move |action| (region, action))) {
            let choice = (region as u32) << REGION_BITS | (action as u32) << ACTION_BITS;
            let occurs = |row: &usize| occurs(choice, &block.choices[row * stride..][..nz]);
            let [first, end] = block.spans[region];
            let Some(first) = (first..end).find(occurs) else { continue };
            let end = (first..end).rfind(occurs).unwrap_or(first) + 1;
            let (j, rows, step) = (j + first, end - first, parts.step(region, direction, action));
            let Block { sums, costs, ends, footprints, choices, success, .. } = block;
            let chances = &mut costs[first * stride..end * stride];
            self.bits.outcomes([slice, j, rows], step, ends);
            let reading = Reading { field: ahead.map_or(&[], |ahead| &ahead.success), order: self.order, j };
            if ahead.is_some() {
                self.land(step, reading, 0.0, sums, chances);
            }
            self.footprints(step, self.order, footprints);
            ends.for_each_mixed(|[row, k], code| {
                let at = row * stride + k;
                if choices[first * stride + at] != choice {
                    return;
                }
                let start = self.padded.at((j + row) as i64, k as i64);
                let chance = |branch: &Footprint| match code(branch.rest) {
                    voxel::FREE => branch.probability * self.landing(branch, reading, start),
                    code => branch.weight * f32::from(u8::from(code == voxel::TARGET)),
                };
                chances[at] = footprints.iter().map(chance).sum::<f32>();
            });
            for row in ends.certain.ending_rows(rows) {
                let chances = &mut chances[row * stride..row * stride + nz];
                self.bits.for_each_end(&ends.certain, row, |code, from, to| {
                    chances[from..to].fill(f32::from(u8::from(code == voxel::TARGET)));
                });
            }
            let points = first * stride..end * stride;
            take_chosen(chances, choice, &choices[points.clone()], &mut success[points]);
        }
    }
}
