//! The backups of one slice, direction by direction in parallel.

use rayon::prelude::*;

use crate::interpolation::Order;
use crate::space::block::{Block, BlockSolver, Plane};
use crate::space::layer::{Layer, Padded};
use crate::space::parts::{SpaceParts, SpaceShape};
use crate::stop::StopFlag;

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

/// Backs up slices.
pub(crate) struct SliceSolver<'a> {
    blocks: BlockSolver<'a>,
    stop: StopFlag,
}

impl<'a> SliceSolver<'a> {
    /// `success`: interpolation of success.
    pub(crate) fn new(parts: &'a SpaceParts, success: Order) -> Self {
        SliceSolver { blocks: BlockSolver::new(parts, success), stop: StopFlag::current() }
    }

    /// Layout of the planes of a layer.
    pub(crate) fn padded(&self) -> Padded {
        self.blocks.padded
    }

    /// Backs up all states of a slice. `ahead` is the layer in which its steps end, None beyond the volume.
    pub(crate) fn solve(&self, slice: usize, ahead: Option<&Layer>, layer: &mut Layer, tables: &mut SliceTables) {
        let parts = self.blocks.parts;
        let (plane, padded) = (parts.shape.plane(), self.blocks.padded);
        let layers = layer.values.par_chunks_mut(padded.len()).zip(layer.success.par_chunks_mut(padded.len()));
        let layers = layers.zip(&mut layer.landings);
        let SliceTables { values, policy, success } = tables;
        let tables = values.par_chunks_mut(plane).zip(policy.par_chunks_mut(plane)).zip(success.par_chunks_mut(plane));
        layers.zip(tables).enumerate().for_each_init(
            || Block::new(parts, padded),
            |block, (direction, (((layer_values, layer_success), landings), ((values, policy), success)))| {
                self.stop.check();
                let mut plane = Plane { layer_values, layer_success, values, policy, success, landings };
                self.blocks.direction([slice, direction], ahead, block, &mut plane);
            },
        );
    }
}
