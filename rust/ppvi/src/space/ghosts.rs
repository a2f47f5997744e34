//! Points of the target, which take the mean of their free neighbours.

use crate::space::definition::NEIGHBOURS;
use crate::space::layer::Padded;
use crate::space::parts::{SpaceShape, voxel};

/// Layers of ghosts: as far as the interpolation with four points reads beyond a free voxel.
const GHOST_ROUNDS: usize = 2;

/// Grid points of a padded plane that are not free, each with the points whose mean it takes.
pub(crate) struct Ghosts {
    /// First source of each ghost, and the number of all sources at the end.
    first: Vec<u32>,
    ghosts: Vec<u32>,
    sources: Vec<u32>,
}

impl Ghosts {
    /// Finds the points of a slice with one of the codes `standing` that have free neighbours, and then those beside them.
    pub(crate) fn new(shape: SpaceShape, padded: Padded, slice: &[u8], standing: &[u8]) -> Self {
        let mut known = vec![false; padded.len()];
        let mut places = Vec::new();
        for (j, codes) in slice.chunks_exact(shape.nz).enumerate() {
            for (k, code) in codes.iter().enumerate() {
                let point = padded.at(j as i64, k as i64);
                known[point] = *code == voxel::FREE;
                if standing.contains(code) {
                    places.push(point);
                }
            }
        }
        let mut found = Ghosts { first: vec![0], ghosts: Vec::new(), sources: Vec::new() };
        for _ in 0..GHOST_ROUNDS {
            let before = found.ghosts.len();
            for point in places.iter().filter(|point| !known[**point]) {
                // The padding is wide enough for all neighbours.
                let near = NEIGHBOURS
                    .iter()
                    .map(|[a, b]| (*point as i64 + i64::from(*a) * padded.width as i64 + i64::from(*b)) as u32);
                found.sources.extend(near.filter(|near| known[*near as usize]));
                if found.sources.len() > found.first[found.ghosts.len()] as usize {
                    found.ghosts.push(*point as u32);
                    found.first.push(found.sources.len() as u32);
                }
            }
            for ghost in &found.ghosts[before..] {
                known[*ghost as usize] = true;
            }
        }
        found
    }

    /// Writes the means to the ghosts of a padded plane.
    pub(crate) fn fill(&self, plane: &mut [f32]) {
        for (ghost, range) in self.ghosts.iter().zip(self.first.windows(2)) {
            let sources = &self.sources[range[0] as usize..range[1] as usize];
            let sum: f32 = sources.iter().map(|source| plane[*source as usize]).sum();
            plane[*ghost as usize] = sum / sources.len() as f32;
        }
    }
}
