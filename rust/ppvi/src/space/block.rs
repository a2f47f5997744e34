//! The backups of one direction of a slice, block by block of rows.
//!
//! # Layout
//!
//! A layer holds two fields, values and success, as one padded plane of single precision for each direction. A step moves all
//! points of a plane by the same offset, so nothing is gathered: what is read are planes, shifted. A block has so many rows that
//! its sums stay in the first-level cache. Its rows are as wide as those of the planes, so that one index counts in both.
//! Costs run over long runs of numbers with all states that may be open, and over the gaps between rows; success is summed in
//! groups of eight neighbours.
//!
//! 1. For every action: the landings of its branches. Branches that land in the same column of the grid are interpolated
//!    along y and summed first; these sums are interpolated along z and summed. Both are sums of shifted arrays.
//! 2. Failures over the starts from which all branches end alike, which are runs of bits. Starts whose branches end
//!    differently are few and scattered: their branches are summed one by one.
//! 3. The comparison with the best action so far. This reads values only.
//! 4. For every choice that occurs: success in the groups with points that made it, by the same steps, with the
//!    interpolation of success and the outcomes that are known from the costs. Only the points with this choice take it.

use std::ops::Range;

use crate::interpolation::Order;
use crate::space::choice::{Group, for_each_choice, for_each_group};
use crate::space::collision::voxel;
use crate::space::footprint::Footprints;
use crate::space::kernel::{Run, add_prices, keep_better, keep_better_in, range, store, take_chosen};
use crate::space::layer::{Layer, Padded};
use crate::space::lead::{LeadSolver, Memory, Reading};
use crate::space::outcomes::{DirectionOutcomes, WORD};
use crate::space::parts::SpaceParts;
use crate::space::paths::{self, DirectionPaths};
use crate::space::reach::{LANES, PointSet, Reach, Window};
use crate::space::voxels::VoxelBits;

/// The planes that a direction writes.
pub(crate) struct Plane<'a> {
    pub layer_values: &'a mut [f32],
    pub layer_success: &'a mut [f32],
    pub values: &'a mut [f32],
    pub policy: &'a mut [u8],
    pub success: &'a mut [u16],
    pub landings: &'a mut PointSet,
}

/// Memory of a thread. Numbers of points in gaps between rows and of closed states have no meaning.
pub(crate) struct Block {
    /// States of the direction that may be open, and those that are.
    may_be_open: PointSet,
    open: PointSet,
    /// States from which each step may land on open states, `[region][action]`.
    landed: Vec<PointSet>,
    window: Window,
    memory: Memory,
    /// Costs of a step, and chances.
    costs: Vec<f32>,
    /// Outcomes of the steps of each region from its rows.
    ends: Vec<DirectionOutcomes>,
    /// Regions of the rows of a block.
    regions: Vec<u8>,
    /// States of a block in each region that may be open.
    region_sets: Vec<PointSet>,
    /// First row of each region, and the row after its last one; equal where it does not occur.
    spans: Vec<[usize; 2]>,
    /// Runs of a region with all states that may be open, from the first row of the region on.
    runs: Vec<Run>,
    /// Open states of a region that chose each action, and groups of those with one action, from the first row of the region on.
    chosen: Vec<PointSet>,
    groups: Vec<Group>,
    best: Vec<f32>,
    choices: Vec<u8>,
    success: Vec<f32>,
}

impl Block {
    pub(crate) fn new(parts: &SpaceParts, padded: Padded) -> Self {
        let points = padded.block_len();
        Block {
            may_be_open: PointSet::new(parts.shape),
            open: PointSet::new(parts.shape),
            landed: vec![PointSet::new(parts.shape); parts.regions.len() * parts.actions()],
            window: Window::default(),
            memory: Memory::default(),
            costs: vec![0.0; points],
            ends: parts.regions.iter().map(|_| DirectionOutcomes::default()).collect(),
            regions: vec![0; points],
            region_sets: vec![PointSet::new(parts.shape); parts.regions.len()],
            spans: vec![[0; 2]; parts.regions.len()],
            runs: Vec::new(),
            chosen: vec![PointSet::new(parts.shape); parts.actions()],
            groups: Vec::new(),
            best: vec![0.0; points],
            choices: vec![0; points],
            success: vec![0.0; points],
        }
    }
}

/// Backs up blocks.
pub(crate) struct BlockSolver<'a> {
    pub parts: &'a SpaceParts,
    actions: usize,
    /// Interpolation of success.
    order: Order,
    bits: VoxelBits,
    /// Paths of all steps, `[region][direction]`.
    paths: Vec<Vec<DirectionPaths>>,
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
            actions: parts.actions(),
            order,
            bits: VoxelBits::new(parts),
            paths: paths::of_parts(parts),
            reach: Reach::new(parts),
            lead: LeadSolver { padded },
            padded,
            reads,
        }
    }

    /// Backs up the states of a direction. `ahead` is the layer in which the steps end, None beyond the volume.
    pub(crate) fn direction(
        &self,
        [slice, direction]: [usize; 2],
        ahead: Option<&Layer>,
        block: &mut Block,
        plane: &mut Plane<'_>,
    ) {
        let exit = self.parts.costs.exit as f32;
        plane.layer_values.fill(exit);
        plane.layer_success.fill(0.0);
        plane.values.fill(exit);
        plane.success.fill(0);
        plane.policy.fill(0);
        let landings = ahead.map(|ahead| &ahead.landings[..]);
        self.reach.find([slice, direction], landings, &mut block.may_be_open, &mut block.landed);
        block.open.clear();
        block.window = block.may_be_open.window();
        let (window, width) = (block.window.clone(), self.padded.width);
        let most = self.padded.block_rows();
        for j in window.rows.clone().step_by(most) {
            let rows = most.min(window.rows.end - j);
            self.find_regions([slice, direction], [j, rows], block);
            block.best[..rows * width].fill(f32::INFINITY);
            block.choices[..rows * width].fill(0);
            block.success[..rows * width].fill(0.0);
            for region in 0..self.parts.regions.len() {
                self.find_runs(j, region, block);
                if block.runs.is_empty() {
                    continue;
                }
                let [first, end] = block.spans[region];
                let of_region = [slice, j + first, end - first];
                self.bits.outcomes(of_region, &self.paths[region][direction], &mut block.ends[region]);
                for action in 0..self.actions {
                    self.step([slice, direction], j, [region, action], ahead, block);
                }
            }
            for region in 0..self.parts.regions.len() {
                self.find_success(direction, j, region, ahead, block);
            }
            for row in 0..rows {
                self.write(j + row, row * width, block, plane);
            }
        }
        self.reach.find_landings(&block.open, plane.landings);
    }

    /// Writes a row of the slice, which begins at a place in the block.
    fn write(&self, j: usize, place: usize, block: &mut Block, plane: &mut Plane<'_>) {
        let Block { window, open, best, choices, success, .. } = block;
        let points = window.points.clone();
        let of_block = place + points.start..place + points.end;
        let to = self.padded.at(j as i64, points.start as i64);
        let to = to..to + points.len();
        let (values, chances, choices) =
            (&mut best[of_block.clone()], &mut success[of_block.clone()], &mut choices[of_block]);
        open.for_each_run(j, window, false, |from, end| {
            let gap = from - points.start..end - points.start;
            values[gap.clone()].fill(self.parts.costs.exit as f32);
            chances[gap.clone()].fill(0.0);
            choices[gap].fill(0);
        });
        plane.layer_values[to.clone()].copy_from_slice(values);
        plane.layer_success[to].copy_from_slice(chances);
        let table = j * self.parts.shape.nz + points.start..j * self.parts.shape.nz + points.end;
        plane.values[table.clone()].copy_from_slice(values);
        store(chances, &mut plane.success[table.clone()]);
        plane.policy[table].copy_from_slice(choices);
    }

    /// Finds the regions of the steps from a block, and the rows in which each occurs.
    fn find_regions(&self, [slice, direction]: [usize; 2], [j, rows]: [usize; 2], block: &mut Block) {
        let (parts, points) = (self.parts, block.window.points.clone());
        block.region_sets.iter_mut().for_each(PointSet::clear);
        if parts.region_of.is_empty() {
            block.spans[0] = [0, rows];
            (j..j + rows).for_each(|row| block.region_sets[0].fill_row(row, points.clone()));
            block.region_sets[0].keep(&block.may_be_open);
            return;
        }
        block.spans.fill([rows, 0]);
        for (row, regions) in block.regions.chunks_exact_mut(self.padded.width).enumerate().take(rows) {
            parts.regions_of_row(slice, direction, j + row, &mut regions[..parts.shape.nz]);
            let regions = &regions[points.clone()];
            let mut add = |region: u8, points: Range<usize>| {
                let [first, end] = &mut block.spans[usize::from(region)];
                (*first, *end) = ((*first).min(row), row + 1);
                block.region_sets[usize::from(region)].fill_row(j + row, points);
            };
            match range(regions) {
                [low, high] if low == high => add(low, points.clone()),
                _ => points.clone().zip(regions).for_each(|(k, region)| add(*region, k..k + 1)),
            }
        }
        block.region_sets.iter_mut().for_each(|set| set.keep(&block.may_be_open));
    }

    /// Finds the runs with the states of a region that may be open.
    fn find_runs(&self, j: usize, region: usize, Block { region_sets, spans, runs, .. }: &mut Block) {
        runs.clear();
        let [first, end] = spans[region];
        for row in first..end {
            if let Some([low, high]) = region_sets[region].span(j + row) {
                let place = (row - first) * self.padded.width;
                Run::add(runs, place + low, place + high);
            }
        }
    }

    /// Compares a step with the best one so far, wherever it starts in its region, in a block from row `j` on.
    fn step(
        &self,
        [slice, direction]: [usize; 2],
        j: usize,
        [region, action]: [usize; 2],
        ahead: Option<&Layer>,
        block: &mut Block,
    ) {
        let (parts, shape, width) = (self.parts, self.parts.shape, self.padded.width);
        let step = parts.step(region, direction, action);
        let Block { open, landed, memory, costs, regions, region_sets, runs, best, choices, .. } = block;
        let number = region * self.actions + action;
        let ends = block.ends[region].of(&self.paths[region][direction], action);
        let [first, end] = block.spans[region];
        let (j, rows) = (j + first, end - first);
        let of_rows = first * width..;
        let landings = ahead.map(|ahead| &ahead.landings[..]);
        self.reach.follow((step, ends), [j, rows], landings, [&region_sets[region], &landed[number]], open);
        let reading = Reading {
            starts: &region_sets[region],
            field: ahead.map_or(&[], |ahead| &ahead.values),
            order: Order::Linear,
            reads: self.reads[0].of([region, direction, action]),
            from: j,
            base: step.cost as f32,
            lost: (step.lost * parts.costs.exit) as f32,
            by_code: [0, voxel::TARGET, voxel::OBSTACLE, voxel::OUTSIDE].map(|code| self.parts.costs.of(code) as f32),
        };
        self.lead.land(&reading, runs, memory, costs);
        let (best, choices) = (&mut best[of_rows.clone()], &mut choices[of_rows.clone()]);
        self.lead.end(&reading, ends, 0..rows, memory, costs);
        if !parts.prices.is_empty() {
            for row in 0..rows {
                let from = (slice * shape.ny + j + row) * shape.nz;
                let prices = &parts.prices[from + block.window.points.start..from + block.window.points.end];
                add_prices(prices, step.length as f32, &mut costs[row * width + block.window.points.start..]);
            }
        }
        let regions = if parts.region_of.is_empty() { None } else { Some(&regions[of_rows]) };
        for points in runs.iter().map(|run| run.range()) {
            let (best, choices) = (&mut best[points.clone()], &mut choices[points.clone()]);
            match regions {
                None => keep_better(&costs[points], action as u8, best, choices),
                Some(regions) => {
                    let of_region = (region as u8, &regions[points.clone()]);
                    keep_better_in(of_region, &costs[points], action as u8, best, choices);
                }
            }
        }
    }

    /// Finds the probability of success of the choices in a region of a block from row `j` on.
    fn find_success(&self, direction: usize, j: usize, region: usize, ahead: Option<&Layer>, block: &mut Block) {
        let width = self.padded.width;
        let Block { open, memory, costs, ends, region_sets, spans, chosen, groups, choices, success, .. } = block;
        let [first, end] = spans[region];
        if first >= end {
            return;
        }
        let j = j + first;
        let (choices, success) = (&choices[first * width..], &mut success[first * width..]);
        chosen.iter_mut().for_each(PointSet::clear);
        for row in 0..end - first {
            let words = region_sets[region].row(j + row).iter().zip(open.row(j + row)).enumerate();
            for (word, (of_region, open)) in words {
                let mut left = of_region & open;
                while left != 0 {
                    let bit = left.trailing_zeros() as usize / LANES * LANES;
                    let place = row * width + word * WORD + bit;
                    let Some(of_group) = choices[place..].first_chunk() else {
                        unreachable!("there are numbers behind the last row")
                    };
                    for_each_choice(*of_group, (left >> bit) as u8, |action, set| {
                        chosen[usize::from(action)].join_word(j + row, word, u64::from(set) << bit);
                    });
                    left &= !(0xff << bit);
                }
            }
        }
        for (action, set) in chosen.iter().enumerate() {
            groups.clear();
            for row in 0..end - first {
                for_each_group(set.row(j + row), |k, set| groups.push(Group { place: row * width + k, set }));
            }
            let ([first, .., last] | [first @ last]) = &groups[..] else { continue };
            let rows = first.place / width..last.place / width + 1;
            let reading = Reading {
                starts: set,
                field: ahead.map_or(&[], |ahead| &ahead.success),
                order: self.order,
                reads: self.reads[1].of([region, direction, action]),
                from: j,
                base: 0.0,
                lost: 0.0,
                by_code: [0, voxel::TARGET, voxel::OBSTACLE, voxel::OUTSIDE].map(success_of),
            };
            self.lead.land_groups(&reading, groups, memory, costs);
            let ends = ends[region].of(&self.paths[region][direction], action);
            self.lead.end(&reading, ends, rows, memory, costs);
            take_chosen(costs, groups, success);
        }
    }
}

/// Probability of success of an execution that has ended in a voxel with this code.
fn success_of(code: u8) -> f32 {
    f32::from(u8::from(code == voxel::TARGET))
}
