//! Outcomes of paths for whole blocks of rows, with one bit for each voxel.
//!
//! All steps of a direction and an action pass the same voxels relative to their start. So the outcomes of a block of rows
//! are a few operations on shifted words: for each voxel of the path, the bits of the rows that it leads to. The branches of
//! a step go on where its common path has not ended. Where all of them end alike, so does the step.
//! Rows are followed by a guard of words whose bits are outside, slices by guards of rows, and the volume by a slice
//! outside, so no shift needs a check. Voxels of a path at which no row of the block can end are skipped.

use multiversion::multiversion;

use crate::space::definition::NEIGHBOURS;
use crate::space::layer::Padded;
use crate::space::parts::{SpaceParts, SpaceShape, SpaceStep, voxel};

/// Bits of a word.
const WORD: usize = u64::BITS as usize;

/// Rows of a block, at most: a bit each.
pub(crate) const MOST_ROWS: usize = WORD;

/// Layers of ghosts: as far as the interpolation with four points reads beyond a free voxel.
const GHOST_ROUNDS: usize = 2;

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

/// Outcomes of a path from the rows of a block, one bit for each start.
#[derive(Default, Clone)]
pub(crate) struct Outcomes {
    stride: usize,
    /// Starts from which no voxel of the path is met that is not free.
    pub goes_on: Vec<u64>,
    /// Starts whose paths end in the target, and in obstacles; without meaning unless `is_marked`.
    ended: [Vec<u64>; 2],
    /// Whether a path may end in the target or in an obstacle.
    is_marked: bool,
    /// Whether a path may have ended.
    may_end: bool,
    /// Least and largest shift along z for which starts whose paths leave the grid have ended.
    shifts: [i64; 2],
    /// Rows in which a path ends, one bit each.
    ending_rows: u64,
}

impl Outcomes {
    /// Rows in which a path ends, of the first `rows`.
    pub(crate) fn ending_rows(&self, rows: usize) -> impl Iterator<Item = usize> + use<> {
        let mut left = self.ending_rows & u64::MAX >> (MOST_ROWS - rows);
        std::iter::from_fn(move || {
            let row = left.trailing_zeros() as usize;
            left &= left.wrapping_sub(1);
            (row < MOST_ROWS).then_some(row)
        })
    }

    /// The code of the end at a bit of a word, or that of a free voxel.
    fn code(&self, at: usize, bit: u64) -> u8 {
        match () {
            () if self.goes_on[at] & bit != 0 => voxel::FREE,
            () if self.is_marked && self.ended[0][at] & bit != 0 => voxel::TARGET,
            () if self.is_marked && self.ended[1][at] & bit != 0 => voxel::OBSTACLE,
            () => voxel::OUTSIDE,
        }
    }

    fn mark(&mut self) {
        if !self.is_marked {
            self.is_marked = true;
            for ended in &mut self.ended {
                ended.clear();
                ended.resize(self.goes_on.len(), 0);
            }
        }
    }

    fn find_ending_rows(&mut self, whole_rows: &[u64]) {
        self.ending_rows = 0;
        let rows = self.goes_on.chunks_exact(self.stride).zip(whole_rows.chunks_exact(self.stride));
        for (row, (going, whole)) in rows.enumerate() {
            let differ = going.iter().zip(whole).fold(0, |differ, (a, b)| differ | (a ^ b));
            self.ending_rows |= u64::from(differ != 0) << row;
        }
    }
}

/// Outcomes of a step and of the paths of its branches from the rows of a block.
#[derive(Default)]
pub(crate) struct StepOutcomes {
    /// Starts from which all branches end alike; the others go on.
    pub certain: Outcomes,
    rests: Vec<Outcomes>,
    /// Starts from which the branches end differently.
    mixed: Vec<u64>,
    has_mixed: bool,
    /// Memory: starts from which all branches go on, end in the target, end in an obstacle.
    found_by_all: [Vec<u64>; 3],
}

impl StepOutcomes {
    /// Calls `visit([row, k], code)` for the starts from which branches end differently; `code(rest)` is the end of those
    /// with this path.
    pub(crate) fn for_each_mixed(&self, mut visit: impl FnMut([usize; 2], &dyn Fn(usize) -> u8)) {
        let words = if self.has_mixed { &self.mixed[..] } else { &[] };
        for (at, word) in words.iter().enumerate().filter(|(_, word)| **word != 0) {
            let mut left = *word;
            while left != 0 {
                let k = left.trailing_zeros() as usize;
                let bit = left & left.wrapping_neg();
                left ^= bit;
                let stride = self.certain.stride;
                visit([at / stride, at % stride * WORD + k], &|rest| self.rests[rest].code(at, bit));
            }
        }
    }

    /// Finds the starts from which all branches end alike, and those from which they differ.
    fn compare(&mut self, rests: usize) {
        let StepOutcomes { certain, rests: found, mixed, has_mixed, found_by_all: [going, target, obstacle] } = self;
        let found = &found[..rests];
        *has_mixed = found.iter().any(|rest| rest.may_end);
        let Some(first) = found.first() else {
            // The step cannot go on.
            certain.goes_on.fill(0);
            certain.may_end = true;
            return;
        };
        if !*has_mixed {
            return;
        }
        // All starts from which a branch goes on or ends in a mark. The branches from the others end outside.
        mixed.clone_from(&first.goes_on);
        going.clone_from(&first.goes_on);
        for rest in found {
            unite(&rest.goes_on, mixed);
            intersect(&rest.goes_on, going);
            rest.ended.iter().filter(|_| rest.is_marked).for_each(|ended| unite(ended, mixed));
        }
        certain.may_end = true;
        if found.iter().all(|rest| rest.is_marked) {
            certain.mark();
            for (kind, all) in [target, obstacle].into_iter().enumerate() {
                all.clone_from(&first.ended[kind]);
                found.iter().for_each(|rest| intersect(&rest.ended[kind], all));
                remove(all, mixed);
                unite(all, &mut certain.ended[kind]);
            }
        }
        certain.goes_on.clone_from(mixed);
        remove(going, mixed);
    }
}

/// Adds bits.
fn unite(bits: &[u64], to: &mut [u64]) {
    to.iter_mut().zip(bits).for_each(|(to, bits)| *to |= bits);
}

/// Keeps bits.
fn intersect(bits: &[u64], of: &mut [u64]) {
    of.iter_mut().zip(bits).for_each(|(of, bits)| *of &= bits);
}

/// Removes bits.
fn remove(bits: &[u64], from: &mut [u64]) {
    from.iter_mut().zip(bits).for_each(|(from, bits)| *from &= !bits);
}

impl VoxelBits {
    /// Takes the voxels, and the reach of all paths.
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let shape = parts.shape;
        let reach = |axis: usize, count: usize| {
            let steps = || parts.regions.iter().flatten();
            let rests = steps().flat_map(|step| step.rests.iter().flatten());
            steps()
                .flat_map(|step| &step.path)
                .chain(rests)
                .map(|offset| offset[axis].unsigned_abs() as usize)
                .max()
                .unwrap_or(0)
                .min(count)
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

    /// Finds the outcomes of a step and its branches from all points of `rows` rows from row `j` on.
    pub(crate) fn outcomes(&self, at: [usize; 3], step: &SpaceStep, found: &mut StepOutcomes) {
        self.begin(at[2], &mut found.certain);
        self.follow(at, &step.path, &mut found.certain);
        let rests = step.rests.len();
        if found.rests.len() < rests {
            found.rests.resize(rests, Outcomes::default());
        }
        for (path, outcomes) in step.rests.iter().zip(&mut found.rests) {
            let common = &found.certain;
            outcomes.goes_on.clone_from(&common.goes_on);
            (outcomes.stride, outcomes.shifts) = (common.stride, common.shifts);
            (outcomes.is_marked, outcomes.may_end) = (false, false);
            self.follow(at, path, outcomes);
        }
        found.compare(rests);
        if found.certain.may_end {
            found.certain.find_ending_rows(&self.whole_rows);
        }
    }

    /// Begins paths from all points of `rows` rows.
    fn begin(&self, rows: usize, found: &mut Outcomes) {
        found.stride = self.stride;
        found.goes_on.clear();
        found.goes_on.extend_from_slice(&self.whole_rows[..rows * self.stride]);
        (found.is_marked, found.may_end, found.ending_rows, found.shifts) = (false, false, 0, [0; 2]);
    }

    /// Follows a path from the starts that still go on.
    fn follow(&self, [slice, j, rows]: [usize; 3], path: &[[i32; 3]], found: &mut Outcomes) {
        let limit = |by: i32, count: usize| i64::from(by).clamp(-(count as i64), count as i64);
        for [ds, dj, dk] in path {
            let slice = (slice + *ds as usize).min(self.shape.slices);
            let row = (j + self.guard_rows) as i64 + limit(*dj, self.guard_rows);
            let line = slice * (self.shape.ny + 2 * self.guard_rows) + row as usize;
            let dk = limit(*dk, self.shape.nz);
            let any = |kind: usize| self.counts[kind][line + rows] > self.counts[kind][line];
            let [low, high] = &mut found.shifts;
            if !any(0) && *low <= dk && dk <= *high {
                continue;
            }
            (*low, *high) = ((*low).min(dk), (*high).max(dk));
            let first = (self.front + line * self.stride) as i64 + dk.div_euclid(WORD as i64);
            let (first, shift) = (first as usize, dk.rem_euclid(WORD as i64) as u32);
            let [met, target, obstacle] = self.kinds.each_ref().map(|kind| &kind[first..][..rows * self.stride + 1]);
            if any(1) {
                found.mark();
                for (ended, kind) in found.ended.iter_mut().zip([target, obstacle]) {
                    add_met(&found.goes_on, kind, shift, ended);
                }
            }
            found.may_end = true;
            remove_met(met, shift, &mut found.goes_on);
        }
    }

    /// Finds the codes of the rows themselves.
    pub(crate) fn codes(&self, at: [usize; 3], found: &mut Outcomes) {
        self.begin(at[2], found);
        self.follow(at, &[[0; 3]], found);
        found.find_ending_rows(&self.whole_rows);
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
