//! The backups of one slice, direction by direction in parallel.

use rayon::prelude::*;

use crate::space::block::{Block, BlockSolver, Plane};
use crate::space::kernel::Order;
use crate::space::parts::{SpaceParts, SpaceShape};
use crate::space::voxels::{Ghosts, PAD};
use crate::stop::StopFlag;

/// Tables hold the probability of success in units of one part of this number.
pub const SUCCESS_STEPS: u16 = u16::MAX;

/// Values of a slice as later slices read them: `[direction]` padded planes, with means at the points of the target.
pub(crate) struct Layer {
    pub values: Vec<f32>,
    pub success: Vec<f32>,
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

/// Layout of a padded plane. A further row before and after it lets shifted rows be read as one array.
#[derive(Clone, Copy)]
pub(crate) struct Padded {
    pub rows: usize,
    pub width: usize,
}

impl Padded {
    pub(crate) fn of(shape: SpaceShape) -> Self {
        Padded { rows: shape.ny + 2 * PAD, width: shape.nz + 2 * PAD }
    }

    pub(crate) fn len(self) -> usize {
        (self.rows + 2) * self.width
    }

    /// Index of the point `(j, k)`, which may be up to [`PAD`] points beyond the grid.
    pub(crate) fn at(self, j: i64, k: i64) -> usize {
        self.width + (j + PAD as i64) as usize * self.width + (k + PAD as i64) as usize
    }
}

/// Backs up slices.
pub(crate) struct SliceSolver<'a> {
    blocks: BlockSolver<'a>,
    stop: StopFlag,
}

impl<'a> SliceSolver<'a> {
    /// Interpolation of values and of success.
    pub(crate) fn new(parts: &'a SpaceParts, orders: [Order; 2]) -> Self {
        SliceSolver { blocks: BlockSolver::new(parts, orders), stop: StopFlag::current() }
    }

    /// Backs up all states of a slice. `ahead` is the layer in which its steps end, None beyond the volume.
    pub(crate) fn solve(&self, slice: usize, ahead: Option<&Layer>, layer: &mut Layer, tables: &mut SliceTables) {
        let parts = self.blocks.parts;
        let (shape, plane, padded) = (parts.shape, parts.shape.plane(), Padded::of(parts.shape));
        let ghosts = Ghosts::new(shape, &parts.voxels[slice * plane..][..plane]);
        let layers = layer.values.par_chunks_mut(padded.len()).zip(layer.success.par_chunks_mut(padded.len()));
        let SliceTables { values, policy, success } = tables;
        let tables = values.par_chunks_mut(plane).zip(policy.par_chunks_mut(plane)).zip(success.par_chunks_mut(plane));
        layers.zip(tables).enumerate().for_each_init(
            || Block::new(parts),
            |block, (direction, ((layer_values, layer_success), ((values, policy), success)))| {
                self.stop.check();
                let mut plane = Plane { layer_values, layer_success, values, policy, success };
                self.blocks.direction([slice, direction], ahead, block, &mut plane);
                ghosts.fill(&mut plane.layer_values[padded.width..]);
                ghosts.fill(&mut plane.layer_success[padded.width..]);
            },
        );
    }
}
