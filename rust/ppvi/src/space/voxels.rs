//! Outcomes of paths for whole blocks of rows, with one bit for each voxel.
//!
//! All steps of a direction and an action pass the same voxels relative to their start. So the outcomes of a block of rows
//! are a few operations on shifted words: for each voxel of the path, the bits of the rows that it leads to.
//! Rows are followed by a guard of words whose bits are outside, slices by guards of rows, and the volume by a slice
//! outside, so no shift needs a check. Voxels of a path at which no row of the block can end are skipped.

use multiversion::multiversion;

use crate::space::definition::NEIGHBOURS;
use crate::space::parts::{SpaceParts, SpaceShape, voxel};

/// Bits of a word.
const WORD: usize = u64::BITS as usize;

/// Rows of a block, at most: a bit each.
pub(crate) const MOST_ROWS: usize = WORD;

/// Padding of a plane of values on each side: what the interpolation with four points reads beyond the grid.
pub(crate) const PAD: usize = 2;

/// The voxels of a volume, one bit each.
pub(crate) struct VoxelBits {
    shape: SpaceShape,
    /// Words of a row, without its guard.
    words: usize,
    /// Words from row to row.
    stride: usize,
    /// Guard rows on each side of a slice.
    guard_rows: usize,
    /// Words before the first row and after the last one, so that shifts stay in the array.
    front: usize,
    /// Voxels that are not free; those of the target; those of obstacles: `[slice][guarded row][word]`.
    kinds: [Vec<u64>; 3],
    /// Rows before each one of a slice that are not free, and those with target or obstacles.
    counts: [Vec<u32>; 2],
    /// Bits of the grid points of as many rows as a block has, each with its guard.
    whole_rows: Vec<u64>,
}

/// Outcomes of a step from the rows of a block, one bit for each start.
#[derive(Default)]
pub(crate) struct Outcomes {
    stride: usize,
    /// Starts from which no voxel of the path is met that is not free.
    pub goes_on: Vec<u64>,
    /// Starts whose paths end in the target, and in obstacles; without meaning unless `is_marked`.
    ended: [Vec<u64>; 2],
    /// Whether a path may end in the target or in an obstacle.
    is_marked: bool,
    /// Rows in which a path ends, one bit each.
    ending_rows: u64,
}

impl Outcomes {
    /// Lets all paths end outside.
    pub(crate) fn end_outside(&mut self) {
        self.goes_on.fill(0);
        self.ending_rows = u64::MAX;
    }

    /// Rows in which a path ends, of the first `rows`.
    pub(crate) fn ending_rows(&self, rows: usize) -> impl Iterator<Item = usize> + use<> {
        let mut left = self.ending_rows & u64::MAX >> (MOST_ROWS - rows);
        std::iter::from_fn(move || {
            let row = left.trailing_zeros() as usize;
            left &= left.wrapping_sub(1);
            (row < MOST_ROWS).then_some(row)
        })
    }
}

impl VoxelBits {
    /// Takes the voxels, and the reach of all paths.
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let shape = parts.shape;
        let reach = |axis: usize, count: usize| {
            let paths = parts.regions.iter().flatten().flat_map(|step| &step.path);
            paths.map(|offset| offset[axis].unsigned_abs() as usize).max().unwrap_or(0).min(count)
        };
        let (guard_rows, guard) = (reach(1, shape.ny), reach(2, shape.nz) / WORD + 1);
        let words = shape.nz.div_ceil(WORD);
        let stride = words + guard;
        let rows = shape.ny + 2 * guard_rows;
        let mut whole_row = vec![0u64; stride];
        (0..shape.nz).for_each(|k| whole_row[k / WORD] |= 1 << (k % WORD));
        let outside_of_grid: Vec<u64> = whole_row.iter().map(|word| !word).collect();
        let whole_rows = whole_row.repeat(MOST_ROWS.min(shape.ny));
        let lines = (shape.slices + 1) * rows;
        let mut bits = VoxelBits {
            shape,
            words,
            stride,
            guard_rows,
            front: guard,
            kinds: [!0, 0, 0].map(|word| vec![word; 2 * guard + lines * stride + 1]),
            counts: [vec![0], vec![0]],
            whole_rows,
        };
        for line in 0..lines {
            let (slice, j) = (line / rows, (line % rows).wrapping_sub(guard_rows));
            let (mut is_free, mut is_marked) = (false, false);
            if slice < shape.slices && j < shape.ny {
                let codes = &parts.voxels[(slice * shape.ny + j) * shape.nz..][..shape.nz];
                let first = bits.front + line * stride;
                bits.kinds[0][first..first + stride].copy_from_slice(&outside_of_grid);
                for (k, code) in codes.iter().enumerate().filter(|(_, code)| **code != voxel::FREE) {
                    let (word, bit) = (first + k / WORD, 1 << (k % WORD));
                    bits.kinds[0][word] |= bit;
                    match *code {
                        voxel::TARGET => bits.kinds[1][word] |= bit,
                        voxel::OBSTACLE => bits.kinds[2][word] |= bit,
                        _ => {}
                    }
                }
                is_free = codes.iter().all(|code| *code == voxel::FREE);
                is_marked = codes.iter().any(|code| [voxel::TARGET, voxel::OBSTACLE].contains(code));
            }
            for (counts, counted) in bits.counts.iter_mut().zip([!is_free, is_marked]) {
                counts.push(counts[line] + u32::from(counted));
            }
        }
        bits
    }

    /// Finds the outcomes of a path from all points of `rows` rows from row `j` on.
    pub(crate) fn outcomes(&self, [slice, j, rows]: [usize; 3], path: &[[i32; 3]], found: &mut Outcomes) {
        let whole_rows = &self.whole_rows[..rows * self.stride];
        found.stride = self.stride;
        found.goes_on.clear();
        found.goes_on.extend_from_slice(whole_rows);
        (found.is_marked, found.ending_rows) = (false, 0);
        let mut may_end = false;
        let (mut low, mut high) = (0, 0);
        let limit = |by: i32, count: usize| i64::from(by).clamp(-(count as i64), count as i64);
        for [ds, dj, dk] in path {
            let slice = (slice + *ds as usize).min(self.shape.slices);
            let row = (j + self.guard_rows) as i64 + limit(*dj, self.guard_rows);
            let line = slice * (self.shape.ny + 2 * self.guard_rows) + row as usize;
            let dk = limit(*dk, self.shape.nz);
            let any = |kind: usize| self.counts[kind][line + rows] > self.counts[kind][line];
            if !any(0) && low <= dk && dk <= high {
                continue;
            }
            (low, high) = (low.min(dk), high.max(dk));
            let first = (self.front + line * self.stride) as i64 + dk.div_euclid(WORD as i64);
            let (first, shift) = (first as usize, dk.rem_euclid(WORD as i64) as u32);
            let [met, target, obstacle] = self.kinds.each_ref().map(|kind| &kind[first..][..rows * self.stride + 1]);
            if any(1) {
                if !found.is_marked {
                    found.is_marked = true;
                    for ended in &mut found.ended {
                        ended.clear();
                        ended.resize(rows * self.stride, 0);
                    }
                }
                for (ended, kind) in found.ended.iter_mut().zip([target, obstacle]) {
                    add_met(&found.goes_on, kind, shift, ended);
                }
            }
            may_end = true;
            remove_met(met, shift, &mut found.goes_on);
        }
        if may_end {
            let rows = found.goes_on.chunks_exact(self.stride).zip(whole_rows.chunks_exact(self.stride));
            for (row, (going, whole)) in rows.enumerate() {
                let differ = going.iter().zip(whole).fold(0, |differ, (a, b)| differ | (a ^ b));
                found.ending_rows |= u64::from(differ != 0) << row;
            }
        }
    }

    /// Finds the codes of the rows themselves.
    pub(crate) fn codes(&self, at: [usize; 3], found: &mut Outcomes) {
        self.outcomes(at, &[[0; 3]], found);
    }

    /// Calls `visit(code, from, to)` for runs of starts in a row whose paths end.
    pub(crate) fn for_each_end(&self, found: &Outcomes, row: usize, mut visit: impl FnMut(u8, usize, usize)) {
        let first = row * self.stride;
        for word in 0..self.words {
            let at = first + word;
            let [target, obstacle] = if found.is_marked { [found.ended[0][at], found.ended[1][at]] } else { [0; 2] };
            let outside = self.whole_rows[word] & !(found.goes_on[at] | target | obstacle);
            for (code, bits) in [(voxel::TARGET, target), (voxel::OBSTACLE, obstacle), (voxel::OUTSIDE, outside)] {
                let mut bits = bits;
                while bits != 0 {
                    let from = bits.trailing_zeros();
                    let to = from + (!(bits >> from)).trailing_zeros();
                    visit(code, word * WORD + from as usize, word * WORD + to as usize);
                    bits &= u64::MAX.checked_shl(to).unwrap_or(0);
                }
            }
        }
    }
}

/// Adds the bits of starts that still go on and are in `kind` after a shift. `kind` has one word more.
#[multiversion(targets("x86_64+avx+avx2"))]
fn add_met(goes_on: &[u64], kind: &[u64], shift: u32, ended: &mut [u64]) {
    let count = goes_on.len();
    let (here, next, ended) = (&kind[..count], &kind[1..][..count], &mut ended[..count]);
    for at in 0..count {
        // Two shifts, since one of 64 bits is none.
        ended[at] |= goes_on[at] & (here[at] >> shift | next[at] << 1 << (63 - shift));
    }
}

/// Removes the bits of starts that are in `kind` after a shift.
#[multiversion(targets("x86_64+avx+avx2"))]
fn remove_met(kind: &[u64], shift: u32, goes_on: &mut [u64]) {
    let count = goes_on.len();
    let (here, next) = (&kind[..count], &kind[1..][..count]);
    for at in 0..count {
        goes_on[at] &= !(here[at] >> shift | next[at] << 1 << (63 - shift));
    }
}

/// Grid points of a padded plane that are not free, each with the points whose mean it takes.
pub(crate) struct Ghosts {
    /// First source of each ghost, and the number of all sources at the end.
    first: Vec<u32>,
    ghosts: Vec<u32>,
    sources: Vec<u32>,
}

impl Ghosts {
    /// Finds the points of a slice with one of the codes `standing` that have free neighbours, and then those beside them.
    pub(crate) fn new(shape: SpaceShape, slice: &[u8], standing: &[u8]) -> Self {
        let (rows, width) = (shape.ny + 2 * PAD, shape.nz + 2 * PAD);
        let mut known = vec![false; rows * width];
        let mut places = Vec::new();
        for (j, codes) in slice.chunks_exact(shape.nz).enumerate() {
            for (k, code) in codes.iter().enumerate() {
                let point = (j + PAD) * width + k + PAD;
                known[point] = *code == voxel::FREE;
                if standing.contains(code) {
                    places.push(point);
                }
            }
        }
        let mut found = Ghosts { first: vec![0], ghosts: Vec::new(), sources: Vec::new() };
        for _ in 0..PAD {
            let before = found.ghosts.len();
            for point in places.iter().filter(|point| !known[**point]) {
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

    /// Writes the means to the ghosts of a plane, which starts at its first padded point.
    pub(crate) fn fill(&self, plane: &mut [f32]) {
        for (ghost, range) in self.ghosts.iter().zip(self.first.windows(2)) {
            let sources = &self.sources[range[0] as usize..range[1] as usize];
            let sum: f32 = sources.iter().map(|source| plane[*source as usize]).sum();
            plane[*ghost as usize] = sum / sources.len() as f32;
        }
    }
}
