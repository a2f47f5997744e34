//! The backups of one slice, direction by direction in parallel.

use rayon::prelude::*;

use crate::space::kernel::{Order, combine, interpolate, weights};
use crate::space::parts::{SpaceParts, SpaceShape, SpaceStep, voxel};
use crate::space::voxels::{Ghosts, PAD, VoxelBits};
use crate::stop::StopFlag;

/// Tables hold the probability of success in units of one part of this number.
pub const SUCCESS_STEPS: u16 = u16::MAX;

/// Values of a slice as later slices read them: `[direction]` padded planes, with means at the points of the target.
pub(crate) struct Layer {
    values: Vec<f32>,
    success: Vec<f32>,
}

impl Layer {
    /// A layer with failures beyond the grid.
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let padded = Padded::of(parts.shape).len() * parts.shape.directions;
        Layer { values: vec![parts.costs.exit as f32; padded], success: vec![0.0; padded] }
    }
}

/// The tables of a slice, `[direction][j][k]`.
pub(crate) struct SliceTables {
    pub values: Vec<f32>,
    pub policy: Vec<u8>,
    pub success: Vec<u16>,
}

impl SliceTables {
    pub(crate) fn new(shape: SpaceShape) -> Self {
        let states = shape.slice_states();
        SliceTables { values: vec![0.0; states], policy: vec![0; states], success: vec![0; states] }
    }
}

/// Layout of a padded plane.
#[derive(Clone, Copy)]
struct Padded {
    rows: usize,
    width: usize,
}

impl Padded {
    fn of(shape: SpaceShape) -> Self {
        Padded { rows: shape.ny + 2 * PAD, width: shape.nz + 2 * PAD }
    }

    fn len(self) -> usize {
        self.rows * self.width
    }

    /// Index of the point `(j, k)`, which may be up to [`PAD`] points beyond the grid.
    fn at(self, j: i64, k: i64) -> usize {
        (j + PAD as i64) as usize * self.width + (k + PAD as i64) as usize
    }
}

/// Backs up slices.
pub(crate) struct SliceSolver<'a> {
    parts: &'a SpaceParts,
    /// Interpolation of values and of success.
    orders: [Order; 2],
    bits: VoxelBits,
    padded: Padded,
    stop: StopFlag,
}

/// Memory of a thread.
struct Scratch {
    /// Values and success at the landings of a step, before the interpolation: padded planes.
    sums: [Vec<f32>; 2],
    /// The same for a row, after it.
    landings: [Vec<f32>; 2],
    /// Outcomes of the step from a row.
    codes: Vec<u8>,
    /// Region of the steps from the points of a slice.
    regions: Vec<u8>,
    /// Success of the best action.
    success: Vec<f32>,
}

/// A plane of the tables, which a direction writes.
struct Output<'a> {
    values: &'a mut [f32],
    policy: &'a mut [u8],
    success: &'a mut [u16],
}

impl<'a> SliceSolver<'a> {
    pub(crate) fn new(parts: &'a SpaceParts, orders: [Order; 2]) -> Self {
        let bits = VoxelBits::new(parts.shape, &parts.voxels);
        SliceSolver { parts, orders, bits, padded: Padded::of(parts.shape), stop: StopFlag::current() }
    }

    fn scratch(&self) -> Scratch {
        let shape = self.parts.shape;
        let (plane, padded) = (shape.plane(), self.padded.len());
        Scratch {
            sums: [vec![0.0; padded], vec![0.0; padded]],
            landings: [vec![0.0; shape.nz], vec![0.0; shape.nz]],
            codes: vec![0; shape.nz],
            regions: vec![0; plane],
            success: vec![0.0; plane],
        }
    }

    /// Backs up all states of a slice. `ahead` is the layer in which its steps end, None beyond the volume.
    pub(crate) fn solve(&self, slice: usize, ahead: Option<&Layer>, layer: &mut Layer, tables: &mut SliceTables) {
        let (shape, plane, padded) = (self.parts.shape, self.parts.shape.plane(), self.padded.len());
        let ghosts = Ghosts::new(shape, &self.parts.voxels[slice * plane..][..plane]);
        let layers = layer.values.par_chunks_mut(padded).zip(layer.success.par_chunks_mut(padded));
        let SliceTables { values, policy, success } = tables;
        let tables = values.par_chunks_mut(plane).zip(policy.par_chunks_mut(plane)).zip(success.par_chunks_mut(plane));
        layers.zip(tables).enumerate().for_each_init(
            || self.scratch(),
            |scratch, (direction, ((layer_values, layer_success), ((values, policy), success)))| {
                self.stop.check();
                self.direction([slice, direction], ahead, Output { values, policy, success }, scratch);
                for j in 0..shape.ny {
                    let (from, to) = (j * shape.nz, self.padded.at(j as i64, 0));
                    layer_values[to..][..shape.nz].copy_from_slice(&values[from..][..shape.nz]);
                    layer_success[to..][..shape.nz].copy_from_slice(&scratch.success[from..][..shape.nz]);
                }
                ghosts.fill(layer_values);
                ghosts.fill(layer_success);
            },
        );
    }

    /// Backs up the states of a direction.
    fn direction(&self, at: [usize; 2], ahead: Option<&Layer>, mut output: Output<'_>, scratch: &mut Scratch) {
        let (parts, [slice, direction]) = (self.parts, at);
        output.values.fill(f32::INFINITY);
        output.policy.fill(0);
        let mut present = [false; 256];
        if parts.region_of.is_empty() {
            present[0] = true;
        } else {
            for (point, region) in scratch.regions.iter_mut().enumerate() {
                *region = parts.region(slice, direction, point / parts.shape.nz, point % parts.shape.nz) as u8;
                present[usize::from(*region)] = true;
            }
        }
        for region in (0..parts.regions.len()).filter(|region| present[*region]) {
            for action in 0..parts.actions() {
                self.step(at, [region, action], ahead, &mut output, scratch);
            }
        }
        let codes = &parts.voxels[slice * parts.shape.plane()..][..parts.shape.plane()];
        for (point, code) in codes.iter().enumerate().filter(|(_, code)| **code != voxel::FREE) {
            output.values[point] = self.failure_cost(*code);
            output.policy[point] = 0;
            scratch.success[point] = f32::from(*code == voxel::TARGET);
        }
        for (stored, success) in output.success.iter_mut().zip(&scratch.success) {
            *stored = (success * f32::from(SUCCESS_STEPS)).round() as u16;
        }
    }

    fn failure_cost(&self, code: u8) -> f32 {
        match code {
            voxel::OBSTACLE => self.parts.costs.collision as f32,
            voxel::OUTSIDE => self.parts.costs.exit as f32,
            _ => 0.0,
        }
    }

    /// Compares a step with the best one so far, wherever it starts in its region.
    fn step(
        &self,
        [slice, direction]: [usize; 2],
        [region, action]: [usize; 2],
        ahead: Option<&Layer>,
        output: &mut Output<'_>,
        scratch: &mut Scratch,
    ) {
        let (parts, SpaceShape { ny, nz, .. }) = (self.parts, self.parts.shape);
        let step = parts.step(region, direction, action);
        let Scratch { sums, landings, codes, regions, success } = scratch;
        if let Some(ahead) = ahead {
            for (sum, source) in sums.iter_mut().zip([&ahead.values, &ahead.success]) {
                let plane = |direction: u32| &source[direction as usize * self.padded.len()..][..self.padded.len()];
                let planes: Vec<_> = step.taps.iter().map(|tap| (plane(tap.direction), tap.weight as f32)).collect();
                combine(&planes, sum);
            }
        }
        let goes_on = ahead.is_some() && !step.taps.is_empty();
        let lost = (step.lost * parts.costs.exit) as f32;
        for j in 0..ny {
            let row = j * nz..(j + 1) * nz;
            let all_free = self.bits.outcomes(slice, j, &step.path, codes) && goes_on;
            if !goes_on {
                codes.iter_mut().filter(|code| **code == voxel::FREE).for_each(|code| *code = voxel::OUTSIDE);
            } else {
                self.land(step, j, sums, landings);
            }
            let [costs, chances] = &*landings;
            let price =
                |k: usize| parts.prices.get((slice * ny + j) * nz + k).map_or(0.0, |price| price * step.length as f32);
            let best = output.values[row.clone()].iter_mut().zip(&mut output.policy[row.clone()]);
            let best = best.zip(&mut success[row.clone()]).enumerate();
            if all_free && parts.prices.is_empty() && parts.region_of.is_empty() {
                let cost = step.cost as f32 + lost;
                for (k, ((value, policy), success)) in best {
                    let new = cost + costs[k];
                    let better = new < *value;
                    *value = if better { new } else { *value };
                    *policy = if better { action as u8 } else { *policy };
                    *success = if better { chances[k] } else { *success };
                }
                continue;
            }
            for (k, ((value, policy), success)) in best {
                if !parts.region_of.is_empty() && usize::from(regions[j * nz + k]) != region {
                    continue;
                }
                let (after, chance) = match codes[k] {
                    voxel::FREE => (lost + costs[k], chances[k]),
                    code => (self.failure_cost(code), f32::from(code == voxel::TARGET)),
                };
                let new = step.cost as f32 + price(k) + after;
                if new < *value {
                    (*value, *policy, *success) = (new, action as u8, chance);
                }
            }
        }
    }

    /// Interpolates at the landings of a step from row `j` which lie in the grid.
    fn land(&self, step: &SpaceStep, j: usize, sums: &[Vec<f32>; 2], landings: &mut [Vec<f32>; 2]) {
        let SpaceShape { ny, nz, .. } = self.parts.shape;
        let [row, column] = [j as i64 + i64::from(step.cell[0]), i64::from(step.cell[1])];
        let [fj, fk] = step.fraction;
        let nearest = |f: f64| i64::from(f >= 0.5);
        if !(0..ny as i64).contains(&(row + nearest(fj))) {
            return;
        }
        let first = (-column - nearest(fk)).clamp(0, nz as i64) as usize;
        let end = (nz as i64 - column - nearest(fk)).clamp(first as i64, nz as i64) as usize;
        for ((order, sum), landings) in self.orders.iter().zip(sums).zip(landings) {
            if first < end {
                let rows = [-1, 0, 1, 2].map(|by| &sum[self.padded.at(row + by, first as i64 + column - 1)..]);
                interpolate(*order, rows, [weights(*order, fj), weights(*order, fk)], &mut landings[first..end]);
            }
        }
    }
}
