//! What later slices read of a slice: padded planes, one for each direction.

use crate::space::parts::{SpaceParts, SpaceShape};
use crate::space::voxels::PAD;

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
