//! Outcomes of paths for whole rows of starting points, with one bit for each voxel.
//!
//! All steps of a direction and an action pass the same voxels relative to their start. So for 64 starts in a row, one
//! word of a shifted row says which of them are in the target, in an obstacle or outside.

use crate::space::definition::NEIGHBOURS;
use crate::space::parts::{SpaceShape, voxel};

/// Bits of a word.
const WORD: usize = u64::BITS as usize;

/// Padding of a plane of values on each side: what the interpolation with four points reads beyond the grid.
pub(crate) const PAD: usize = 2;

/// The voxels of a volume, one bit each.
pub(crate) struct VoxelBits {
    shape: SpaceShape,
    /// Words of a row.
    words: usize,
    /// Rows of the voxels of target, obstacles and outside, `[slice][j]`.
    kinds: [Vec<u64>; 3],
    /// Whether all voxels of a row are free.
    clear: Vec<bool>,
}

impl VoxelBits {
    /// Takes the codes `[slice][j][k]`.
    pub(crate) fn new(shape: SpaceShape, voxels: &[u8]) -> Self {
        let words = shape.nz.div_ceil(WORD);
        let rows = shape.slices * shape.ny;
        let mut kinds = [voxel::TARGET, voxel::OBSTACLE, voxel::OUTSIDE].map(|kind| {
            let mut bits = vec![0u64; rows * words];
            for (row, codes) in voxels.chunks_exact(shape.nz).enumerate() {
                for (k, _) in codes.iter().enumerate().filter(|(_, code)| **code == kind) {
                    bits[row * words + k / WORD] |= 1 << (k % WORD);
                }
            }
            bits
        });
        if !shape.nz.is_multiple_of(WORD) {
            kinds[2].chunks_exact_mut(words).for_each(|row| row[words - 1] |= !0 << (shape.nz % WORD));
        }
        let clear = voxels.chunks_exact(shape.nz).map(|codes| codes.iter().all(|code| *code == voxel::FREE)).collect();
        VoxelBits { shape, words, kinds, clear }
    }

    /// Writes the codes of the outcomes of a path from all points of a row, and returns whether all of them are free.
    pub(crate) fn outcomes(&self, slice: usize, j: usize, path: &[[i32; 3]], codes: &mut [u8]) -> bool {
        let SpaceShape { slices, ny, nz, .. } = self.shape;
        let row = |[ds, dj, _]: [i32; 3]| {
            let (slice, j) = (slice as i64 + i64::from(ds), j as i64 + i64::from(dj));
            let within = (0..slices as i64).contains(&slice) && (0..ny as i64).contains(&j);
            within.then(|| slice as usize * ny + j as usize)
        };
        let mut all_free = true;
        codes.fill(voxel::FREE);
        let (mut low, mut high, mut clear) = (0, 0, true);
        for offset in path {
            (low, high) = (low.min(offset[2]), high.max(offset[2]));
            clear &= row(*offset).is_some_and(|row| self.clear[row]);
        }
        if clear {
            // Only the ends of the row can be left.
            let (low, high) = (low.unsigned_abs() as usize, high.unsigned_abs() as usize);
            codes[..low.min(nz)].fill(voxel::OUTSIDE);
            codes[nz.saturating_sub(high)..].fill(voxel::OUTSIDE);
            return low == 0 && high == 0;
        }
        for (word, codes) in codes.chunks_mut(WORD).enumerate() {
            let mut alive = if codes.len() == WORD { !0 } else { (1u64 << codes.len()) - 1 };
            let mut ended = [0u64; 3];
            for offset in path {
                let [target, obstacle, outside] = match row(*offset) {
                    Some(row) => self.read(row, word, offset[2]),
                    None => [0, 0, !0],
                };
                for (ended, now) in ended.iter_mut().zip([target, obstacle, outside]) {
                    *ended |= alive & now;
                }
                alive &= !(target | obstacle | outside);
                if alive == 0 {
                    break;
                }
            }
            for (bits, code) in ended.into_iter().zip([voxel::TARGET, voxel::OBSTACLE, voxel::OUTSIDE]) {
                let mut bits = bits;
                while bits != 0 {
                    codes[bits.trailing_zeros() as usize] = code;
                    all_free = false;
                    bits &= bits - 1;
                }
            }
        }
        all_free
    }

    /// A word of the three kinds of a row, shifted by `by` bits.
    #[inline]
    fn read(&self, row: usize, word: usize, by: i32) -> [u64; 3] {
        let first = word as i64 * WORD as i64 + i64::from(by);
        let (index, shift) = (first.div_euclid(WORD as i64), first.rem_euclid(WORD as i64) as u32);
        let mut kinds = [0; 3];
        for (kind, (bits, beyond)) in kinds.iter_mut().zip(self.kinds.iter().zip([0, 0, !0u64])) {
            let row = &bits[row * self.words..][..self.words];
            let at =
                |index: i64| usize::try_from(index).ok().and_then(|index| row.get(index)).copied().unwrap_or(beyond);
            *kind = if shift == 0 { at(index) } else { at(index) >> shift | at(index + 1) << (u64::BITS - shift) };
        }
        kinds
    }
}

/// Grid points of a padded plane in the target, each with the points whose mean it takes.
pub(crate) struct Ghosts {
    /// First source of each ghost, and the number of all sources at the end.
    first: Vec<u32>,
    ghosts: Vec<u32>,
    sources: Vec<u32>,
}

impl Ghosts {
    /// Finds the target points of a slice that have free neighbours, and then those beside them.
    pub(crate) fn new(shape: SpaceShape, slice: &[u8]) -> Self {
        let (rows, width) = (shape.ny + 2 * PAD, shape.nz + 2 * PAD);
        let mut known = vec![false; rows * width];
        let mut targets = Vec::new();
        for (j, codes) in slice.chunks_exact(shape.nz).enumerate() {
            for (k, code) in codes.iter().enumerate() {
                let point = (j + PAD) * width + k + PAD;
                known[point] = *code == voxel::FREE;
                if *code == voxel::TARGET {
                    targets.push(point);
                }
            }
        }
        let mut found = Ghosts { first: vec![0], ghosts: Vec::new(), sources: Vec::new() };
        for _ in 0..PAD {
            let before = found.ghosts.len();
            for point in targets.iter().filter(|point| !known[**point]) {
                // The padding is wide enough for all neighbours.
                let near = NEIGHBOURS
                    .iter()
                    .map(|[a, b]| (*point as i64 + i64::from(*a) * width as i64 + i64::from(*b)) as u32);
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

    /// Writes the means to the ghosts of a plane.
    pub(crate) fn fill(&self, plane: &mut [f32]) {
        for (ghost, range) in self.ghosts.iter().zip(self.first.windows(2)) {
            let sources = &self.sources[range[0] as usize..range[1] as usize];
            let sum: f32 = sources.iter().map(|source| plane[*source as usize]).sum();
            plane[*ghost as usize] = sum / sources.len() as f32;
        }
    }
}
