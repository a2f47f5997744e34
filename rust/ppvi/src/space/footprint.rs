//! What the branches of a step read of the layer in which they end.

use crate::space::kernel::{Column, Order, POINTS, Term, weights};
use crate::space::layer::Padded;
use crate::space::parts::{Branch, SpaceParts, SpaceStep};

/// What a branch reads of the layer in which it ends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Footprint {
    /// Number of its path.
    pub rest: u32,
    /// Place of the first point relative to the start in the plane of the first direction.
    first: i64,
    /// Weights along y and z.
    along: [[f32; POINTS]; 2],
    /// Probability, and that of reaching the landing in a direction of the grid.
    pub weight: f32,
    pub probability: f32,
}

impl Footprint {
    /// The field where the branch lands, interpolated with P points.
    #[inline(always)]
    pub(crate) fn landing<const P: usize>(&self, field: &[f32], start: usize, width: usize) -> f32 {
        let skipped = (POINTS - P) / 2;
        let first = (start as i64 + self.first) as usize + skipped * (width + 1);
        let [of_y, of_z] = &self.along;
        let mut landing = 0.0;
        for y in 0..P {
            let row = &field[first + y * width..][..P];
            let mut along_z = of_z[skipped] * row[0];
            for z in 1..P {
                along_z += of_z[skipped + z] * row[z];
            }
            landing += of_y[skipped + y] * along_z;
        }
        landing
    }
}

/// What a step reads.
#[derive(Debug)]
pub(crate) struct StepReads {
    /// For each branch.
    pub branches: Vec<Footprint>,
    /// For each column of the grid in which branches land; they share the weights along z.
    pub columns: Vec<Column>,
}

/// What all steps read, `[region][direction][action]`, for one interpolation.
pub(crate) struct Footprints {
    steps: Vec<StepReads>,
    directions: usize,
    actions: usize,
}

impl Footprints {
    /// Finds what all steps read.
    pub(crate) fn new(parts: &SpaceParts, padded: Padded, order: Order) -> Self {
        let steps = parts.regions.iter().flatten().map(|step| of_step(step, padded, order)).collect();
        Footprints { steps, directions: parts.shape.directions, actions: parts.actions() }
    }

    /// What a step reads.
    #[inline]
    pub(crate) fn of(&self, [region, direction, action]: [usize; 3]) -> &StepReads {
        &self.steps[(region * self.directions + direction) * self.actions + action]
    }
}

fn of_step(step: &SpaceStep, padded: Padded, order: Order) -> StepReads {
    let footprint = |branch: &Branch| {
        let [y, z] = padded.within(branch.cell);
        Footprint {
            rest: branch.rest as u32,
            first: i64::from(branch.direction) * padded.len() as i64 + (y - 1) * padded.width as i64 + z - 1,
            along: [0, 1].map(|axis| weights(order, branch.fraction[axis], step.spread[axis])),
            weight: branch.weight as f32,
            probability: (branch.weight * (1.0 - step.lost)) as f32,
        }
    };
    let column = |branches: &[Branch]| {
        let terms = branches.iter().map(footprint).flat_map(|each| {
            let points = each.along[0].into_iter().enumerate();
            let read = points.filter(move |(_, weight)| order == Order::Cubic || *weight != 0.0);
            read.map(move |(point, weight)| Term {
                first: each.first + (point * padded.width) as i64,
                by: weight * each.probability,
            })
        });
        Column { terms: terms.collect(), along_z: footprint(&branches[0]).along[1] }
    };
    let columns = step.branches.chunk_by(|a, b| (a.cell[1], a.fraction[1]) == (b.cell[1], b.fraction[1]));
    StepReads { branches: step.branches.iter().map(footprint).collect(), columns: columns.map(column).collect() }
}
