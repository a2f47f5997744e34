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
//! 2. The choice of a point has 32 bits: action, code of the end, region.
//! 3. For every choice that occurs: success in the rectangle of the points that made it, by the same steps, with the
//!    interpolation of success. Only the points with this choice take it.

use crate::space::kernel::{
    Between, Order, add_costs, combine, interpolate, interpolate_linear, keep_better, keep_better_of, keep_region,
    store, take_chosen, weights,
};
use crate::space::parts::{SpaceParts, SpaceShape, SpaceStep, voxel};
use crate::space::slice::{Layer, Padded};
use crate::space::voxels::{Outcomes, PAD, VoxelBits};

/// Numbers in the sums of a block: a quarter of a first-level cache of 32 KiB.
const BLOCK_NUMBERS: usize = 2048;

/// Position of the code of the end in a choice; the action is below it.
const CODE_BITS: u32 = 8;

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

/// Memory of a thread; arrays `[row][k]` unless said otherwise.
pub(crate) struct Block {
    /// Rows of a block, but for the last one of a plane.
    rows: usize,
    /// Sum of planes, as wide as padded ones.
    sums: Vec<f32>,
    between: Between,
    /// Costs of a step from a row, and its choices where it does not go on everywhere.
    costs: Vec<f32>,
    row_choices: Vec<u32>,
    ends: Outcomes,
    regions: Vec<u8>,
    best: Vec<f32>,
    choices: Vec<u32>,
    success: Vec<f32>,
    /// Rectangle of the points of each choice that goes on, `[region][action]`.
    used: Vec<Rectangle>,
}

/// Rows and columns from the first to before the second.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rectangle {
    rows: [usize; 2],
    columns: [usize; 2],
}

impl Rectangle {
    const EMPTY: Rectangle = Rectangle { rows: [usize::MAX, 0], columns: [usize::MAX, 0] };

    fn add(&mut self, row: usize, [from, to]: [usize; 2]) {
        self.rows = [self.rows[0].min(row), self.rows[1].max(row + 1)];
        self.columns = [self.columns[0].min(from), self.columns[1].max(to)];
    }
}

impl Block {
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let (shape, padded) = (parts.shape, Padded::of(parts.shape));
        let rows = (BLOCK_NUMBERS / padded.width).clamp(4, 64).min(shape.ny);
        let points = rows * shape.nz;
        Block {
            rows,
            sums: vec![0.0; (rows + 2 * PAD) * padded.width],
            between: Between::default(),
            costs: vec![0.0; shape.nz],
            row_choices: vec![0; shape.nz],
            ends: Outcomes::default(),
            regions: vec![0; points],
            best: vec![0.0; points],
            choices: vec![0; points],
            success: vec![0.0; points],
            used: vec![Rectangle::EMPTY; parts.regions.len() * parts.actions()],
        }
    }
}

/// Backs up blocks.
pub(crate) struct BlockSolver<'a> {
    pub parts: &'a SpaceParts,
    /// Interpolation of values and of success.
    orders: [Order; 2],
    bits: VoxelBits,
    padded: Padded,
}

impl<'a> BlockSolver<'a> {
    pub(crate) fn new(parts: &'a SpaceParts, orders: [Order; 2]) -> Self {
        BlockSolver { parts, orders, bits: VoxelBits::new(parts), padded: Padded::of(parts.shape) }
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
            let present = self.regions([slice, direction], [j, rows], block);
            block.best[..rows * nz].fill(f32::INFINITY);
            for region in (0..self.parts.regions.len()).filter(|region| present[*region]) {
                for action in 0..self.parts.actions() {
                    self.step([slice, direction], [j, rows], [region, action], ahead, block);
                }
            }
            self.end_in_voxels(slice, [j, rows], block);
            self.find_success(direction, [j, rows], ahead, block);
            for row in 0..rows {
                let (from, to) = (row * nz, self.padded.at((j + row) as i64, 0));
                let (values, success) = (&block.best[from..][..nz], &block.success[from..][..nz]);
                plane.layer_values[to..][..nz].copy_from_slice(values);
                plane.layer_success[to..][..nz].copy_from_slice(success);
            }
            let table = j * nz..(j + rows) * nz;
            plane.values[table.clone()].copy_from_slice(&block.best[..rows * nz]);
            let (success, policy) = (&mut plane.success[table.clone()], &mut plane.policy[table]);
            store(&block.success[..rows * nz], &block.choices[..rows * nz], success, policy);
        }
    }

    /// Finds the regions of the steps from a block, and which of them occur.
    fn regions(&self, [slice, direction]: [usize; 2], [j, rows]: [usize; 2], block: &mut Block) -> [bool; 256] {
        let (parts, nz) = (self.parts, self.parts.shape.nz);
        let mut present = [false; 256];
        if parts.region_of.is_empty() {
            present[0] = true;
            return present;
        }
        for (row, regions) in block.regions.chunks_exact_mut(nz).enumerate().take(rows) {
            for (k, region) in regions.iter_mut().enumerate() {
                *region = parts.region(slice, direction, j + row, k) as u8;
                present[usize::from(*region)] = true;
            }
        }
        present
    }

    fn failure_cost(&self, code: u8) -> f32 {
        match code {
            voxel::OBSTACLE => self.parts.costs.collision as f32,
            voxel::OUTSIDE => self.parts.costs.exit as f32,
            _ => 0.0,
        }
    }

    /// Sums the planes of a step of a field, in the rows that the interpolation of `rows` rows from `j` reads, and returns the
    /// rows whose landings are in the grid. The sums start at the point (-1, -1) of the first of these landings.
    fn sum(
        &self,
        step: &SpaceStep,
        [j, rows]: [usize; 2],
        columns: [usize; 2],
        field: &[f32],
        sums: &mut [f32],
    ) -> [usize; 2] {
        let nearest = i64::from(step.cell[0]) + i64::from(step.fraction[0] >= 0.5);
        let within = |row: i64| (row - nearest - j as i64).clamp(0, rows as i64) as usize;
        let landing = [within(0), within(self.parts.shape.ny as i64)];
        if landing[0] < landing[1] {
            let row = (j + landing[0]) as i64 + i64::from(step.cell[0]) - 1;
            let from = self.padded.at(row, columns[0] as i64 + i64::from(step.cell[1]) - 1);
            let width = columns[1] - columns[0] + 3;
            let count = (landing[1] - landing[0] + 2) * self.padded.width + width;
            let plane = |direction: u32| &field[direction as usize * self.padded.len()..][..self.padded.len()];
            let planes: Vec<_> = step.taps.iter().map(|tap| (plane(tap.direction), tap.weight as f32)).collect();
            if 4 * width > 3 * self.padded.width {
                combine(&planes, from, &mut sums[..count]);
                return landing;
            }
            for start in (0..landing[1] - landing[0] + 3).map(|row| row * self.padded.width) {
                combine(&planes, from + start, &mut sums[start..][..width]);
            }
        }
        landing
    }

    /// Columns whose landings are in the grid.
    fn landing_columns(&self, step: &SpaceStep) -> [usize; 2] {
        let nz = self.parts.shape.nz as i64;
        let nearest = i64::from(step.cell[1]) + i64::from(step.fraction[1] >= 0.5);
        [(-nearest).clamp(0, nz) as usize, (nz - nearest).clamp(0, nz) as usize]
    }

    /// Compares a step with the best one so far, wherever it starts in its region.
    fn step(
        &self,
        [slice, direction]: [usize; 2],
        [j, rows]: [usize; 2],
        [region, action]: [usize; 2],
        ahead: Option<&Layer>,
        block: &mut Block,
    ) {
        let (parts, SpaceShape { ny, nz, .. }) = (self.parts, self.parts.shape);
        let step = parts.step(region, direction, action);
        let choice = (region as u32) << REGION_BITS | action as u32;
        let Block { sums, between, costs, row_choices, ends, regions, best, choices, .. } = block;
        self.bits.outcomes([slice, j, rows], &step.path, ends);
        let ahead = ahead.filter(|_| !step.taps.is_empty());
        let columns = self.landing_columns(step);
        let count = columns[1].saturating_sub(columns[0]);
        let mut landing = [0, 0];
        match ahead {
            Some(ahead) if count > 0 => landing = self.sum(step, [j, rows], columns, &ahead.values, sums),
            Some(_) => {}
            None => ends.goes_on.fill(0),
        }
        let lost = (step.lost * parts.costs.exit) as f32;
        for row in 0..rows {
            if (landing[0]..landing[1]).contains(&row) {
                let rows = [0, 1, 2, 3].map(|by| &sums[(row - landing[0] + by) * self.padded.width..]);
                let costs = &mut costs[columns[0]..columns[1]];
                match self.orders[0] {
                    Order::Linear => {
                        let fractions = step.fraction.map(|f| f as f32);
                        interpolate_linear([&rows[1][1..], &rows[2][1..]], fractions, costs);
                    }
                    order => interpolate(rows, step.fraction.map(|f| weights(order, f)), between, costs),
                }
                if lost > 0.0 {
                    add_costs(lost, &[], 0.0, costs);
                }
            }
            let (all, from) = (self.bits.all_go_on(ends, row), row * nz);
            if !all {
                row_choices.fill(choice);
                self.bits.for_each_end(ends, row, |code, from, to| {
                    costs[from..to].fill(self.failure_cost(code));
                    row_choices[from..to].fill(choice | u32::from(code) << CODE_BITS);
                });
            }
            let prices = if parts.prices.is_empty() { &[] } else { &parts.prices[(slice * ny + j + row) * nz..][..nz] };
            add_costs(step.cost as f32, prices, step.length as f32, costs);
            if !parts.region_of.is_empty() {
                keep_region(region as u8, &regions[from..][..nz], costs);
            }
            let (best, choices) = (&mut best[from..][..nz], &mut choices[from..][..nz]);
            if all {
                keep_better(costs, choice, best, choices);
            } else {
                keep_better_of(costs, row_choices, best, choices);
            }
        }
    }

    /// Writes the ends of the points in voxels that are not free.
    fn end_in_voxels(&self, slice: usize, [j, rows]: [usize; 2], block: &mut Block) {
        let nz = self.parts.shape.nz;
        self.bits.codes([slice, j, rows], &mut block.ends);
        for row in 0..rows {
            self.bits.for_each_end(&block.ends, row, |code, from, to| {
                block.best[row * nz..][from..to].fill(self.failure_cost(code));
                block.choices[row * nz..][from..to].fill(u32::from(code) << CODE_BITS);
            });
        }
    }

    /// Finds the probability of success of the choices of a block.
    fn find_success(&self, direction: usize, [j, rows]: [usize; 2], ahead: Option<&Layer>, block: &mut Block) {
        let (parts, nz) = (self.parts, self.parts.shape.nz);
        block.used.fill(Rectangle::EMPTY);
        for row in 0..rows {
            let choices = &block.choices[row * nz..][..nz];
            let success = &mut block.success[row * nz..][..nz];
            let mut from = 0;
            for run in choices.chunk_by(|a, b| a == b) {
                let to = from + run.len();
                match (run[0] >> CODE_BITS) as u8 {
                    voxel::FREE => {
                        let number = (run[0] >> REGION_BITS) as usize * parts.actions() + (run[0] & 0xff) as usize;
                        block.used[number].add(row, [from, to]);
                    }
                    code => success[from..to].fill(f32::from(u8::from(code == voxel::TARGET))),
                }
                from = to;
            }
        }
        let Some(ahead) = ahead else { return };
        for number in 0..block.used.len() {
            let Rectangle { rows: [first, end], columns } = block.used[number];
            if first >= end {
                continue;
            }
            let (region, action) = (number / parts.actions(), number % parts.actions());
            let step = parts.step(region, direction, action);
            let choice = (region as u32) << REGION_BITS | action as u32;
            // Points of the rectangle with other choices may land outside.
            let within = self.landing_columns(step);
            let columns = [columns[0].max(within[0]), columns[1].min(within[1])];
            let landing = self.sum(step, [j + first, end - first], columns, &ahead.success, &mut block.sums);
            let along = step.fraction.map(|f| weights(self.orders[1], f));
            for row in landing[0]..landing[1] {
                let rows = [0, 1, 2, 3].map(|by| &block.sums[(row - landing[0] + by) * self.padded.width..]);
                let chances = &mut block.costs[columns[0]..columns[1]];
                interpolate(rows, along, &mut block.between, chances);
                let points = (first + row) * nz + columns[0]..(first + row) * nz + columns[1];
                take_chosen(chances, choice, &block.choices[points.clone()], &mut block.success[points]);
            }
        }
    }
}
