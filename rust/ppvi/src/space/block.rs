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
//! 2. Failures over the starts from which all branches end alike, which are runs of bits. From starts whose branches end
//!    differently, branches are summed with a mask for each: such starts are few, and evaluated eight at a time.
//! 3. The comparison with the best action so far. This reads values only. The choice of a point is a number of 32 bits:
//!    region, action, and a code below it. Later choices are larger.
//! 4. For every choice that occurs: success in the rows of the points that made it, by the same steps, with the
//!    interpolation of success and the outcomes that are known from the costs. Only the points with this choice take it.

use std::ops::Range;

use crate::space::footprint::{Footprint, Footprints, POINTS, TOGETHER, mix};
use crate::space::kernel::{
    Order, add_prices, chosen, combine, keep_better, keep_region, mark_code, occurs, range, store, take_chosen,
};
use crate::space::layer::{Layer, Padded};
use crate::space::outcomes::{Outcomes, StepOutcomes};
use crate::space::parts::{SpaceParts, SpaceShape, voxel};
use crate::space::voxels::{MOST_ROWS, VoxelBits};

/// Numbers in the sums of a block: a quarter of a first-level cache of 32 KiB.
const BLOCK_NUMBERS: usize = 2048;

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

/// How a step is evaluated: for its cost, or for the probability of success.
#[derive(Clone, Copy)]
struct Reading<'a> {
    /// Planes of the layer in which the step ends.
    field: &'a [f32],
    order: Order,
    /// What its branches read.
    footprints: &'a [Footprint],
    /// Row of the plane in which its outcomes begin.
    j: usize,
    /// What every start adds, and every start whose branches reach their landing.
    base: f32,
    lost: f32,
    /// What the end in a voxel counts, by its code.
    by_code: [f32; 4],
}

/// Memory of one step.
#[derive(Default)]
struct Memory {
    /// Sums of the rows of each column of landings.
    sums: Vec<f32>,
    /// Starts of a word by the ends of each branch.
    branches: Vec<[u64; 4]>,
}

/// Memory of a thread. Rows of a block are as wide as those of padded planes, so that a block is one array for every
/// operation on it; the last points of a row have no meaning.
pub(crate) struct Block {
    /// Rows of a block, but for the last one of a plane.
    rows: usize,
    memory: Memory,
    /// Costs of a step, and chances.
    costs: Vec<f32>,
    /// Outcomes of all steps, `[region][action]`, from the rows of the region.
    ends: Vec<StepOutcomes>,
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
            memory: Memory::default(),
            costs: vec![0.0; points],
            ends: (0..parts.regions.len() * parts.actions()).map(|_| StepOutcomes::default()).collect(),
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
    /// What steps read of values, and of success.
    reads: [Footprints; 2],
}

impl<'a> BlockSolver<'a> {
    pub(crate) fn new(parts: &'a SpaceParts, order: Order) -> Self {
        let padded = Padded::of(parts);
        let reads = [Order::Linear, order].map(|order| Footprints::new(parts, padded, order));
        BlockSolver { parts, order, bits: VoxelBits::new(parts), padded, reads }
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
            self.find_success(direction, j, ahead, block);
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
        let Block { memory, costs, ends, regions, best, choices, .. } = block;
        let ends = &mut ends[region * parts.actions() + action];
        let (j, rows) = (j + first, end - first);
        let of_rows = first * stride..end * stride;
        let (costs, regions) = (&mut costs[of_rows.clone()], &regions[of_rows.clone()]);
        let (best, choices) = (&mut best[of_rows.clone()], &mut choices[of_rows]);
        self.bits.outcomes([slice, j, rows], step, ends);
        let reading = Reading {
            field: ahead.map_or(&[], |ahead| &ahead.values),
            order: Order::Linear,
            footprints: self.reads[0].of([region, direction, action]),
            j,
            base: step.cost as f32,
            lost: (step.lost * parts.costs.exit) as f32,
            by_code: [0, voxel::TARGET, voxel::OBSTACLE, voxel::OUTSIDE].map(|code| self.failure_cost(code)),
        };
        self.lead(&reading, ends, 0..rows, |starts, _| starts, memory, costs);
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
        keep_better(costs, choice_of([region, action]), best, choices);
    }

    /// Finds what a step leads to from `rows` of its outcomes: the mean over the field where it lands, or what an end counts.
    /// Of the starts in a word from which branches end differently, and whose first one has this place in the results, those
    /// are left out that are not `wanted`.
    fn lead(
        &self,
        reading: &Reading<'_>,
        ends: &StepOutcomes,
        rows: Range<usize>,
        wanted: impl Fn(u64, usize) -> u64,
        Memory { sums, branches }: &mut Memory,
        results: &mut [f32],
    ) {
        let Reading { field, order, footprints, j, base, lost, by_code } = *reading;
        let (nz, stride) = (self.parts.shape.nz, self.padded.width);
        let place = |row: usize| (row - rows.start) * stride;
        // Beyond the volume there is no layer, and all branches end before it.
        let going = ends.certain.going_rows(if field.is_empty() { 0..0 } else { rows.clone() });
        if !going.is_empty() {
            self.land(reading, j + going.start, sums, &mut results[place(going.start)..place(going.end)]);
        }
        for mut word in ends.mixed_words(rows.clone()) {
            let [row, k] = word.first;
            let to = place(row) + k;
            word.starts = wanted(word.starts, to);
            let room = nz - k;
            let together = if room < TOGETHER { 1 } else { TOGETHER };
            branches.clear();
            branches.extend(footprints.iter().map(|each| ends.ends(&word, each.rest)));
            while word.starts != 0 {
                let first = (word.starts.trailing_zeros() as usize).min(room - together);
                let place = (field, order, stride, self.padded.at((j + row) as i64, (k + first) as i64));
                let results = &mut results[to + first..][..together];
                mix(footprints, branches, place, base, (lost, by_code), [word.starts, first as u64], results);
                word.starts &= u64::MAX.checked_shl((first + together) as u32).unwrap_or(0);
            }
        }
        for row in ends.certain.ending_rows(rows.clone()) {
            let of_row = &mut results[place(row)..][..nz];
            let fill = |code: u8, from: usize, to: usize| of_row[from..to].fill(base + by_code[usize::from(code)]);
            ends.certain.for_each_end(row, nz, fill);
        }
    }

    /// Sums the landings of all branches from the rows `j` on. The last points of a row have no meaning.
    fn land(&self, reading: &Reading<'_>, j: usize, sums: &mut Vec<f32>, landings: &mut [f32]) {
        let Reading { field, footprints, base, lost, .. } = *reading;
        let columns = || footprints.chunk_by(|a, b| a.column == b.column);
        let length = landings.len() + POINTS - 1;
        let start = self.padded.at(j as i64, 0) as i64;
        sums.resize(columns().count() * length, 0.0);
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
            combine(&rows, 0.0, sum);
        }
        for (column, sum) in columns().zip(sums.chunks_exact(length)) {
            let along = column[0].along[1].into_iter().enumerate().filter(|(_, by)| *by != 0.0);
            shifted.extend(along.map(|(point, by)| (&sum[point..], by)));
        }
        combine(&shifted, base + lost, landings);
    }

    /// Writes the ends of the points in voxels that are not free.
    fn end_in_voxels(&self, slice: usize, [j, rows]: [usize; 2], block: &mut Block) {
        self.bits.codes([slice, j, rows], &mut block.codes);
        for row in block.codes.ending_rows(0..rows) {
            let of_row = row * self.padded.width;
            block.codes.for_each_end(row, self.parts.shape.nz, |code, from, to| {
                block.best[of_row..][from..to].fill(self.failure_cost(code));
                block.choices[of_row..][from..to].fill(u32::from(code));
            });
        }
    }

    /// Finds the probability of success of the choices of a block.
    fn find_success(&self, direction: usize, j: usize, ahead: Option<&Layer>, block: &mut Block) {
        let (parts, nz, stride) = (self.parts, self.parts.shape.nz, self.padded.width);
        mark_code(voxel::TARGET, &block.choices, &mut block.success);
        let numbers = 0..parts.regions.len();
        for (region, action) in numbers.flat_map(|region| (0..parts.actions()).map(move |action| (region, action))) {
            let choice = choice_of([region, action]);
            let occurs = |row: &usize| occurs(choice, &block.choices[row * stride..][..nz]);
            let [of_region, end] = block.spans[region];
            let Some(first) = (of_region..end).find(occurs) else { continue };
            let end = (first..end).rfind(occurs).unwrap_or(first) + 1;
            let Block { memory, costs, ends, choices, success, .. } = block;
            let points = first * stride..end * stride;
            let (chances, choices) = (&mut costs[points.clone()], &choices[points.clone()]);
            let reading = Reading {
                field: ahead.map_or(&[], |ahead| &ahead.success),
                order: self.order,
                footprints: self.reads[1].of([region, direction, action]),
                j: j + of_region,
                base: 0.0,
                lost: 0.0,
                by_code: [0, voxel::TARGET, voxel::OBSTACLE, voxel::OUTSIDE]
                    .map(|code| f32::from(u8::from(code == voxel::TARGET))),
            };
            let ends = &ends[region * parts.actions() + action];
            let rows = first - of_region..end - of_region;
            self.lead(&reading, ends, rows, |starts, at| chosen(starts, choice, &choices[at..]), memory, chances);
            take_chosen(chances, choice, choices, &mut success[points]);
        }
    }
}

/// The number of a choice.
fn choice_of([region, action]: [usize; 2]) -> u32 {
    (region as u32) << REGION_BITS | (action as u32) << ACTION_BITS
}
