//! The backups of one direction of a slice, block by block of rows.
//!
//! # Layout
//!
//! A layer holds two fields, values and success, as one padded plane of single precision for each direction. A step moves all
//! points of a plane by the same offset, so nothing is gathered: what is read are rows, shifted. Only the window in which states
//! are open is computed. A block is so many of its rows that the sums of its planes stay in the first-level cache.
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

use crate::space::footprint::Footprints;
use crate::space::kernel::{
    Order, SUCCESS_STEPS, add_prices, chosen, keep_better, keep_region, mark_code, occurs, range, store, take_chosen,
};
use crate::space::layer::{Layer, Padded};
use crate::space::lead::{LeadSolver, Memory, Reading};
use crate::space::outcomes::{Outcomes, StepOutcomes};
use crate::space::parts::{SpaceParts, voxel};
use crate::space::reach::{LANES, PointSet, Reach, Window};
use crate::space::voxels::{MOST_ROWS, VoxelBits};

/// Numbers in the sums of a block: a quarter of a first-level cache of 32 KiB.
const BLOCK_NUMBERS: usize = 2048;

/// Least number of rows of a block.
const LEAST_ROWS: usize = 4;

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
    pub landings: &'a mut PointSet,
}

/// A slice without open states: what every direction begins with.
pub(crate) struct Closed {
    layer_values: Vec<f32>,
    layer_success: Vec<f32>,
    values: Vec<f32>,
    success: Vec<u16>,
    free: PointSet,
}

/// Memory of a thread. Rows of a block are as wide as the window, in whole groups of [`LANES`], so that a block is one array
/// for every operation on it; the last points of a row may have no meaning.
pub(crate) struct Block {
    /// States of the direction that may be open, and those that are.
    may_be_open: PointSet,
    open: PointSet,
    window: Window,
    memory: Memory,
    /// Costs of a step, and chances.
    costs: Vec<f32>,
    /// Outcomes of all steps, `[region][action]`, from the rows of the region.
    ends: Vec<StepOutcomes>,
    codes: Outcomes,
    /// Regions of a row of the slice, and of the rows of a block.
    of_row: Vec<u8>,
    regions: Vec<u8>,
    /// Points of the window in each region.
    region_sets: Vec<PointSet>,
    /// First row of each region, and the row after its last one; equal where it does not occur.
    spans: Vec<[usize; 2]>,
    best: Vec<f32>,
    choices: Vec<u32>,
    success: Vec<f32>,
}

impl Block {
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let points = BLOCK_NUMBERS.max(LEAST_ROWS * parts.shape.nz.next_multiple_of(LANES));
        Block {
            may_be_open: PointSet::new(parts.shape),
            open: PointSet::new(parts.shape),
            window: Window::default(),
            memory: Memory::default(),
            costs: vec![0.0; points],
            ends: (0..parts.regions.len() * parts.actions()).map(|_| StepOutcomes::default()).collect(),
            codes: Outcomes::default(),
            of_row: vec![0; parts.shape.nz],
            regions: vec![0; points],
            region_sets: vec![PointSet::new(parts.shape); parts.regions.len()],
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
    reach: Reach,
    lead: LeadSolver,
    pub padded: Padded,
    /// What steps read of values, and of success.
    reads: [Footprints; 2],
}

impl<'a> BlockSolver<'a> {
    pub(crate) fn new(parts: &'a SpaceParts, order: Order) -> Self {
        let padded = Padded::of(parts);
        let reads = [Order::Linear, order].map(|order| Footprints::new(parts, padded, order));
        BlockSolver {
            parts,
            order,
            bits: VoxelBits::new(parts),
            reach: Reach::new(parts),
            lead: LeadSolver { padded, nz: parts.shape.nz },
            padded,
            reads,
        }
    }

    /// A slice with these codes without open states.
    pub(crate) fn closed(&self, codes: &[u8]) -> Closed {
        let (parts, nz, padded) = (self.parts, self.parts.shape.nz, self.padded);
        let is_success = |code: u8| code == voxel::TARGET && self.order == Order::Linear;
        let value = |code: u8| if code == voxel::FREE { parts.costs.exit as f32 } else { self.failure_cost(code) };
        let mut closed = Closed {
            layer_values: vec![parts.costs.exit as f32; padded.len()],
            layer_success: vec![0.0; padded.len()],
            values: codes.iter().map(|code| value(*code)).collect(),
            success: codes.iter().map(|code| if is_success(*code) { SUCCESS_STEPS } else { 0 }).collect(),
            free: self.reach.free(codes),
        };
        for (point, code) in codes.iter().enumerate() {
            let at = padded.at((point / nz) as i64, (point % nz) as i64);
            closed.layer_values[at] = value(*code);
            closed.layer_success[at] = f32::from(u8::from(is_success(*code)));
        }
        closed
    }

    /// Backs up the states of a direction. `ahead` is the layer in which the steps end, None beyond the volume.
    pub(crate) fn direction(
        &self,
        [slice, direction]: [usize; 2],
        ahead: Option<&Layer>,
        closed: &Closed,
        block: &mut Block,
        plane: &mut Plane<'_>,
    ) {
        plane.layer_values.copy_from_slice(&closed.layer_values);
        plane.layer_success.copy_from_slice(&closed.layer_success);
        plane.values.copy_from_slice(&closed.values);
        plane.success.copy_from_slice(&closed.success);
        plane.policy.fill(0);
        self.reach.find([slice, direction], ahead.map(|ahead| &ahead.landings[..]), &mut block.may_be_open);
        block.open.clear();
        let window = block.may_be_open.window();
        block.window = window.clone();
        let most = (BLOCK_NUMBERS / window.width().max(1)).clamp(LEAST_ROWS, MOST_ROWS);
        for j in window.rows.clone().step_by(most) {
            let rows = most.min(window.rows.end - j);
            self.find_regions([slice, direction], [j, rows], block);
            block.best[..rows * window.width()].fill(f32::INFINITY);
            block.choices[..rows * window.width()].fill(0);
            for region in 0..self.parts.regions.len() {
                let [first, end] = block.spans[region];
                for action in (0..self.parts.actions()).filter(|_| first < end) {
                    self.step([slice, direction], [j, first, end], [region, action], ahead, block);
                }
            }
            if self.order == Order::Linear {
                self.end_in_voxels(slice, [j, rows], block);
            }
            self.find_success(direction, [j, rows], ahead, block);
            if self.order == Order::Cubic {
                self.end_in_voxels(slice, [j, rows], block);
            }
            for row in 0..rows {
                self.write(j + row, row * window.width(), closed, block, plane);
            }
        }
        self.reach.find_landings(slice, &closed.free, &block.open, plane.landings);
    }

    /// Writes a row of the slice, which begins at a place in the block.
    fn write(&self, j: usize, place: usize, closed: &Closed, block: &mut Block, plane: &mut Plane<'_>) {
        let (nz, &Window { first, count, .. }) = (self.parts.shape.nz, &block.window);
        let to = self.padded.at(j as i64, first as i64);
        let (values, chances) = (&mut block.best[place..][..count], &mut block.success[place..][..count]);
        let choices = &mut block.choices[place..][..count];
        block.open.for_each_gap(j, &block.window, |from, end| {
            values[from..end].copy_from_slice(&closed.layer_values[to..][from..end]);
            chances[from..end].copy_from_slice(&closed.layer_success[to..][from..end]);
            choices[from..end].fill(0);
        });
        plane.layer_values[to..][..count].copy_from_slice(values);
        plane.layer_success[to..][..count].copy_from_slice(chances);
        let table = j * nz + first..j * nz + first + count;
        plane.values[table.clone()].copy_from_slice(values);
        store(chances, choices, ACTION_BITS, &mut plane.success[table.clone()], &mut plane.policy[table]);
    }

    /// Finds the regions of the steps from a block, and the rows in which each occurs.
    fn find_regions(&self, [slice, direction]: [usize; 2], [j, rows]: [usize; 2], block: &mut Block) {
        let (parts, &Window { first, count, .. }) = (self.parts, &block.window);
        block.region_sets.iter_mut().for_each(PointSet::clear);
        if parts.region_of.is_empty() {
            block.spans[0] = [0, rows];
            (j..j + rows).for_each(|row| block.region_sets[0].fill_row(row, first..first + count));
            return;
        }
        block.spans.fill([rows, 0]);
        for (row, regions) in block.regions.chunks_exact_mut(block.window.width()).enumerate().take(rows) {
            parts.regions_of_row(slice, direction, j + row, &mut block.of_row);
            let regions = &mut regions[..count];
            regions.copy_from_slice(&block.of_row[first..][..count]);
            let mut add = |region: u8, points: Range<usize>| {
                let [first, end] = &mut block.spans[usize::from(region)];
                (*first, *end) = ((*first).min(row), row + 1);
                block.region_sets[usize::from(region)].fill_row(j + row, points);
            };
            match range(regions) {
                [low, high] if low == high => add(low, first..first + count),
                _ => (first..).zip(&*regions).for_each(|(k, region)| add(*region, k..k + 1)),
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
        let (parts, shape) = (self.parts, self.parts.shape);
        let step = parts.step(region, direction, action);
        let Block { may_be_open, open, window, memory, costs, ends, regions, region_sets, best, choices, .. } = block;
        let stride = window.width();
        let ends = &mut ends[region * parts.actions() + action];
        let (j, rows) = (j + first, end - first);
        let of_rows = first * stride..end * stride;
        let (costs, regions) = (&mut costs[of_rows.clone()], &regions[of_rows.clone()]);
        let (best, choices) = (&mut best[of_rows.clone()], &mut choices[of_rows]);
        self.bits.outcomes([slice, j, rows], step, ends);
        let landings = ahead.map(|ahead| &ahead.landings[..]);
        self.reach.follow((step, ends), [j, rows], landings, [may_be_open, &region_sets[region]], open);
        let reading = Reading {
            open: may_be_open,
            window,
            field: ahead.map_or(&[], |ahead| &ahead.values),
            order: Order::Linear,
            footprints: self.reads[0].of([region, direction, action]),
            from: [j, window.first],
            base: step.cost as f32,
            lost: (step.lost * parts.costs.exit) as f32,
            by_code: [0, voxel::TARGET, voxel::OBSTACLE, voxel::OUTSIDE].map(|code| self.failure_cost(code)),
        };
        self.lead.find(&reading, ends, 0..rows, |starts, _| starts, memory, costs);
        for row in (0..rows).filter(|_| !(parts.prices.is_empty() && parts.region_of.is_empty())) {
            let of_row = row * stride..row * stride + window.count;
            let costs = &mut costs[of_row.clone()];
            if !parts.prices.is_empty() {
                let from = (slice * shape.ny + j + row) * shape.nz + window.first;
                add_prices(&parts.prices[from..][..window.count], step.length as f32, costs);
            }
            if !parts.region_of.is_empty() {
                keep_region(region as u8, &regions[of_row], costs);
            }
        }
        keep_better(costs, choice_of([region, action]), best, choices);
    }

    /// Writes the ends of the points in voxels that are not free.
    fn end_in_voxels(&self, slice: usize, [j, rows]: [usize; 2], block: &mut Block) {
        self.bits.codes([slice, j, rows], &mut block.codes);
        for row in block.codes.ending_rows(0..rows) {
            let of_row = row * block.window.width();
            block.codes.for_each_end(row, self.parts.shape.nz, |code, from, to| {
                let points = of_row + block.window.within(from)..of_row + block.window.within(to);
                block.best[points.clone()].fill(self.failure_cost(code));
                block.choices[points].fill(u32::from(code));
            });
        }
    }

    /// Finds the probability of success of the choices of a block.
    fn find_success(&self, direction: usize, [j, rows]: [usize; 2], ahead: Option<&Layer>, block: &mut Block) {
        let (parts, stride, count) = (self.parts, block.window.width(), block.window.count);
        mark_code(voxel::TARGET, &block.choices[..rows * stride], &mut block.success);
        let numbers = 0..parts.regions.len();
        for (region, action) in numbers.flat_map(|region| (0..parts.actions()).map(move |action| (region, action))) {
            let choice = choice_of([region, action]);
            let occurs = |row: &usize| occurs(choice, &block.choices[row * stride..][..count]);
            let [of_region, end] = block.spans[region];
            let Some(first) = (of_region..end).find(occurs) else { continue };
            let end = (first..end).rfind(occurs).unwrap_or(first) + 1;
            let Block { open, window, memory, costs, ends, choices, success, .. } = block;
            let points = first * stride..end * stride;
            let (chances, choices) = (&mut costs[points.clone()], &choices[points.clone()]);
            let reading = Reading {
                open,
                window,
                field: ahead.map_or(&[], |ahead| &ahead.success),
                order: self.order,
                footprints: self.reads[1].of([region, direction, action]),
                from: [j + of_region, window.first],
                base: 0.0,
                lost: 0.0,
                by_code: [0, voxel::TARGET, voxel::OBSTACLE, voxel::OUTSIDE]
                    .map(|code| f32::from(u8::from(code == voxel::TARGET))),
            };
            let ends = &ends[region * parts.actions() + action];
            let rows = first - of_region..end - of_region;
            let chosen = |starts, from| chosen(starts, choice, choices, from);
            self.lead.find(&reading, ends, rows, chosen, memory, chances);
            take_chosen(chances, choice, choices, &mut success[points]);
        }
    }
}

/// The number of a choice.
fn choice_of([region, action]: [usize; 2]) -> u32 {
    (region as u32) << REGION_BITS | (action as u32) << ACTION_BITS
}
