//! Points of the target, which take the mean of their free neighbours.

use crate::space::collision::voxel;
use crate::space::definition::NEIGHBOURS;
use crate::space::layer::Padded;
use crate::space::parts::SpaceShape;

/// Grid points of a padded plane in the target, each with the points whose mean it takes.
pub(crate) struct Ghosts {
    /// First source of each ghost, and the number of all sources at the end.
    first: Vec<u32>,
    ghosts: Vec<u32>,
    sources: Vec<u32>,
    /// Points of the target without a free neighbour.
    lone: Vec<u32>,
}

impl Ghosts {
    /// Finds the points of a slice that are in the target, and their free neighbours.
    pub(crate) fn new(shape: SpaceShape, padded: Padded, slice: &[u8]) -> Self {
        let place = |point: usize| padded.at((point / shape.nz) as i64, (point % shape.nz) as i64);
        let mut is_free = vec![false; padded.len()];
        slice.iter().enumerate().for_each(|(point, code)| is_free[place(point)] = *code == voxel::FREE);
        let mut found = Ghosts { first: vec![0], ghosts: Vec::new(), sources: Vec::new(), lone: Vec::new() };
        for (point, _) in slice.iter().enumerate().filter(|(_, code)| **code == voxel::TARGET) {
            let point = place(point) as i64;
            // The padding is wide enough for all neighbours.
            let near = NEIGHBOURS.iter().map(|[a, b]| point + i64::from(*a) * padded.width as i64 + i64::from(*b));
            found.sources.extend(near.filter(|near| is_free[*near as usize]).map(|near| near as u32));
            if found.sources.len() > found.first[found.ghosts.len()] as usize {
                found.ghosts.push(point as u32);
                found.first.push(found.sources.len() as u32);
            } else {
                found.lone.push(point as u32);
            }
        }
        found
    }

    /// Writes the means to the ghosts of a padded plane, and a number to those without a free neighbour.
    pub(crate) fn fill(&self, plane: &mut [f32], lone: f32) {
        for (ghost, range) in self.ghosts.iter().zip(self.first.windows(2)) {
            let sources = &self.sources[range[0] as usize..range[1] as usize];
            let sum: f32 = sources.iter().map(|source| plane[*source as usize]).sum();
            plane[*ghost as usize] = sum / sources.len() as f32;
        }
        self.lone.iter().for_each(|point| plane[*point as usize] = lone);
    }
}
