//! Outcomes of paths from the rows of a block, one bit for each start.

use std::ops::Range;

use multiversion::multiversion;

use crate::space::collision::voxel;
use crate::space::paths::{DirectionPaths, StepPaths};

/// Bits of a word.
pub(crate) const WORD: usize = u64::BITS as usize;

/// Outcomes of a path from the rows of a block, one bit for each start.
#[derive(Default)]
pub(crate) struct Outcomes {
    stride: usize,
    /// Starts from which no voxel of the path is met that is not free. Of the rest of a step, without meaning unless `may_end`.
    pub goes_on: Vec<u64>,
    /// Starts whose paths end in the target, and in obstacles; without meaning unless `is_marked`.
    ended: [Vec<u64>; 2],
    /// Whether a path may end in the target or in an obstacle.
    is_marked: bool,
    /// Whether a path may have ended.
    pub may_end: bool,
    /// Least and largest shift along z for which starts whose paths leave the grid have ended.
    pub shifts: [i64; 2],
    /// Rows in which a path ends, one bit each.
    ending_rows: u64,
    /// Memory: starts whose paths do not end in a voxel.
    spared: Vec<u64>,
}

impl Outcomes {
    /// Begins a path.
    pub(crate) fn begin(&mut self, stride: usize, shifts: [i64; 2]) {
        (self.stride, self.shifts) = (stride, shifts);
        (self.is_marked, self.may_end, self.ending_rows) = (false, false, 0);
    }

    /// Ends the paths of starts in these words at voxels that are not free. The bits are those of all such voxels, of the
    /// target, and of obstacles, with a shift. `spared`: starts whose paths do not end here. `may_mark`: whether there are any
    /// of the last two.
    pub(crate) fn meet(
        &mut self,
        ([met, target, obstacle], shift): ([&[u64]; 3], u32),
        spared: Option<&[u64]>,
        words: Range<usize>,
        may_mark: bool,
    ) {
        self.may_end = true;
        let goes_on = &mut self.goes_on[words.clone()];
        if let Some(spared) = spared {
            self.spared.clear();
            self.spared.extend(goes_on.iter().zip(spared).map(|(goes_on, spared)| goes_on & spared));
            goes_on.iter_mut().zip(&self.spared).for_each(|(goes_on, spared)| *goes_on &= !spared);
        }
        if may_mark {
            self.mark();
            let [in_target, in_obstacle] = self.ended.each_mut().map(|ended| &mut ended[words.clone()]);
            end_met([met, target, obstacle], shift, &mut self.goes_on[words.clone()], in_target, in_obstacle);
        } else {
            remove_met(met, shift, goes_on);
        }
        if spared.is_some() {
            self.goes_on[words].iter_mut().zip(&self.spared).for_each(|(goes_on, spared)| *goes_on |= spared);
        }
    }

    /// Takes the starts and the outcomes of another path.
    fn copy(&mut self, other: &Outcomes) {
        self.stride = other.stride;
        (self.is_marked, self.may_end, self.ending_rows) = (other.is_marked, other.may_end, other.ending_rows);
        self.goes_on.clone_from(&other.goes_on);
        if other.is_marked {
            self.ended.iter_mut().zip(&other.ended).for_each(|(ended, other)| ended.clone_from(other));
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

    /// Rows in which a path ends, of the rows `rows`.
    pub(crate) fn ending_rows(&self, rows: Range<usize>) -> impl Iterator<Item = usize> + use<> {
        let mut left = self.ending_rows & (u64::MAX << rows.start) & (u64::MAX >> (WORD - rows.end));
        std::iter::from_fn(move || {
            let row = left.trailing_zeros() as usize;
            left &= left.wrapping_sub(1);
            (row < WORD).then_some(row)
        })
    }

    /// Finds the rows in which a path ends.
    pub(crate) fn find_ending_rows(&mut self, whole_rows: &[u64]) {
        self.ending_rows = 0;
        let rows = self.goes_on.chunks_exact(self.stride).zip(whole_rows.chunks_exact(self.stride));
        for (row, (going, whole)) in rows.enumerate() {
            let differ = going.iter().zip(whole).fold(0, |differ, (a, b)| differ | (a ^ b));
            self.ending_rows |= u64::from(differ != 0) << row;
        }
    }

    /// Calls `visit(code, from, to)` for runs of starts in a row, among those in these words, whose paths end.
    pub(crate) fn for_each_end(&self, row: usize, among: &[u64], mut visit: impl FnMut(u8, usize, usize)) {
        for (word, among) in among.iter().enumerate() {
            let at = row * self.stride + word;
            let ended = among & !self.goes_on[at];
            if ended == 0 {
                continue;
            }
            let [target, obstacle] =
                if self.is_marked { [0, 1].map(|kind| self.ended[kind][at] & ended) } else { [0; 2] };
            let outside = ended & !(target | obstacle);
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

/// Starts in a word from which the branches of a step end differently.
pub(crate) struct MixedWord {
    /// Number of the word.
    at: usize,
    /// Row, and point of the first bit.
    pub first: [usize; 2],
    /// The starts.
    pub starts: u64,
}

/// Outcomes of the paths of a direction and of its steps from the rows of a block, in the order of [`DirectionPaths`].
#[derive(Default)]
pub(crate) struct DirectionOutcomes {
    pub commons: Vec<Outcomes>,
    /// Those of paths that cannot end have no starts of their own: theirs are those of the path before.
    pub rests: Vec<Outcomes>,
    pub steps: Vec<StepOutcomes>,
}

impl DirectionOutcomes {
    /// Makes room for the paths of a direction.
    pub(crate) fn begin(&mut self, paths: &DirectionPaths) {
        self.commons.resize_with(self.commons.len().max(paths.commons.len()), Outcomes::default);
        self.rests.resize_with(self.rests.len().max(paths.rests.len()), Outcomes::default);
        self.steps.resize_with(paths.steps.len(), StepOutcomes::default);
    }

    /// The outcomes of a step.
    pub(crate) fn of<'a>(&'a self, paths: &'a DirectionPaths, action: usize) -> StepEnds<'a> {
        StepEnds { step: &self.steps[action], paths: &paths.steps[action], rests: &self.rests }
    }
}

/// Outcomes of a step from the rows of a block.
#[derive(Default)]
pub(crate) struct StepOutcomes {
    /// Starts from which all branches end alike; the others go on.
    pub certain: Outcomes,
    /// Starts from which the branches end differently.
    mixed: Vec<u64>,
    has_mixed: bool,
    /// Memory: starts from which all branches go on, end in the target, end in an obstacle.
    found_by_all: [Vec<u64>; 3],
}

impl StepOutcomes {
    /// Finds the starts from which all branches end alike, and those from which they differ, from the outcomes of the paths of
    /// a step.
    pub(crate) fn compare(&mut self, paths: &StepPaths, commons: &[Outcomes], rests: &[Outcomes]) {
        let StepOutcomes { certain, mixed, has_mixed, found_by_all: [going, target, obstacle] } = self;
        certain.copy(&commons[paths.common]);
        let found = || paths.rests.iter().map(|path| &rests[*path]);
        *has_mixed = found().any(|rest| rest.may_end);
        if paths.rests.is_empty() {
            // The step cannot go on.
            certain.goes_on.fill(0);
            certain.may_end = true;
            return;
        }
        if !*has_mixed {
            return;
        }
        // All starts from which a branch goes on or ends in a mark. The branches from the others end outside.
        going.clone_from(&certain.goes_on);
        mixed.clear();
        if found().all(|rest| rest.may_end) {
            mixed.resize(going.len(), 0);
        } else {
            mixed.extend_from_slice(going);
        }
        for rest in found().filter(|rest| rest.may_end) {
            match &rest.ended {
                [target, obstacle] if rest.is_marked => join_marked([&rest.goes_on, target, obstacle], mixed, going),
                _ => join(&rest.goes_on, mixed, going),
            }
        }
        certain.may_end = true;
        if found().all(|rest| rest.is_marked) {
            certain.mark();
            for (kind, all) in [target, obstacle].into_iter().enumerate() {
                all.clone_from(&certain.goes_on);
                found().for_each(|rest| intersect(&rest.ended[kind], all));
                mixed.iter_mut().zip(&*all).for_each(|(mixed, all)| *mixed &= !all);
                certain.ended[kind].iter_mut().zip(&*all).for_each(|(ended, all)| *ended |= all);
            }
        }
        certain.goes_on.clone_from(mixed);
        mixed.iter_mut().zip(&*going).for_each(|(mixed, going)| *mixed &= !going);
    }
}

/// Outcomes of a step, with those of the paths of its branches.
#[derive(Clone, Copy)]
pub(crate) struct StepEnds<'a> {
    pub step: &'a StepOutcomes,
    paths: &'a StepPaths,
    rests: &'a [Outcomes],
}

impl<'a> StepEnds<'a> {
    /// The words of `rows` with starts from which branches end differently.
    pub(crate) fn mixed_words(self, rows: Range<usize>) -> impl Iterator<Item = MixedWord> + use<'a> {
        let (step, stride) = (self.step, self.step.certain.stride);
        let words = if step.has_mixed { rows.start * stride..rows.end * stride } else { 0..0 };
        words.filter(|at| step.mixed[*at] != 0).map(move |at| MixedWord {
            at,
            first: [at / stride, at % stride * WORD],
            starts: step.mixed[at],
        })
    }

    /// The starts of a word from which the branches with this path go on.
    #[inline]
    pub(crate) fn going(self, [row, word]: [usize; 2], rest: usize) -> u64 {
        let (rest, certain) = (&self.rests[self.paths.rests[rest]], &self.step.certain);
        let at = row * certain.stride + word;
        if rest.may_end { rest.goes_on[at] } else { certain.goes_on[at] }
    }

    /// The starts of a word from which the branches with this path end in the target.
    #[inline]
    pub(crate) fn in_target(self, [row, word]: [usize; 2], rest: usize) -> u64 {
        let rest = &self.rests[self.paths.rests[rest]];
        if rest.is_marked { rest.ended[0][row * self.step.certain.stride + word] } else { 0 }
    }

    /// The starts of a word of a row from which all branches go on, all end in the target, and from which they differ.
    #[inline]
    pub(crate) fn of_all(self, [row, word]: [usize; 2]) -> [u64; 3] {
        let StepOutcomes { certain, mixed, has_mixed, .. } = self.step;
        let at = row * certain.stride + word;
        let mixed = if *has_mixed { mixed[at] } else { 0 };
        [certain.goes_on[at] & !mixed, if certain.is_marked { certain.ended[0][at] } else { 0 }, mixed]
    }

    /// Finds, for each path of the branches, the starts of a word from which it goes on, ends in the target, and in an
    /// obstacle.
    pub(crate) fn ends(self, word: &MixedWord, found: &mut Vec<[u64; 3]>) {
        found.clear();
        found.extend(self.paths.rests.iter().map(|path| {
            let (rest, at) = (&self.rests[*path], word.at);
            if !rest.may_end {
                return [u64::MAX, 0, 0];
            }
            let [target, obstacle] = if rest.is_marked { [rest.ended[0][at], rest.ended[1][at]] } else { [0; 2] };
            [rest.goes_on[at], target, obstacle]
        }));
    }
}

/// Keeps bits.
fn intersect(bits: &[u64], of: &mut [u64]) {
    of.iter_mut().zip(bits).for_each(|(of, bits)| *of &= bits);
}

/// Counts a path in: `any` gets the starts from which it goes on, `all` keeps only those.
#[multiversion(targets("x86_64+avx+avx2"))]
fn join(goes_on: &[u64], any: &mut [u64], all: &mut [u64]) {
    let count = goes_on.len();
    let (any, all) = (&mut any[..count], &mut all[..count]);
    for at in 0..count {
        any[at] |= goes_on[at];
        all[at] &= goes_on[at];
    }
}

/// As [`join`], for a path that also ends in the target or in an obstacle; these bits count for any path.
#[multiversion(targets("x86_64+avx+avx2"))]
fn join_marked(bits: [&[u64]; 3], any: &mut [u64], all: &mut [u64]) {
    let count = bits[0].len();
    let (goes_on, target, obstacle) = (bits[0], &bits[1][..count], &bits[2][..count]);
    let (any, all) = (&mut any[..count], &mut all[..count]);
    for at in 0..count {
        any[at] |= goes_on[at] | target[at] | obstacle[at];
        all[at] &= goes_on[at];
    }
}

/// Removes the bits of starts that are in `kind` after a shift. `kind` has one word more.
#[multiversion(targets("x86_64+avx+avx2"))]
fn remove_met(kind: &[u64], shift: u32, goes_on: &mut [u64]) {
    let count = goes_on.len();
    let (here, next) = (&kind[..count], &kind[1..][..count]);
    for at in 0..count {
        // Two shifts, since one of 64 bits is none.
        goes_on[at] &= !(here[at] >> shift | next[at] << 1 << (63 - shift));
    }
}

/// As [`remove_met`] for the first kind, and adds the starts that still go on and are in the second and the third kind.
#[multiversion(targets("x86_64+avx+avx2"))]
fn end_met(kinds: [&[u64]; 3], shift: u32, goes_on: &mut [u64], in_target: &mut [u64], in_obstacle: &mut [u64]) {
    let count = goes_on.len();
    let [met, target, obstacle] = kinds.map(|kind| (&kind[..count], &kind[1..][..count]));
    let (in_target, in_obstacle) = (&mut in_target[..count], &mut in_obstacle[..count]);
    for at in 0..count {
        let going = goes_on[at];
        in_target[at] |= going & (target.0[at] >> shift | target.1[at] << 1 << (63 - shift));
        in_obstacle[at] |= going & (obstacle.0[at] >> shift | obstacle.1[at] << 1 << (63 - shift));
        goes_on[at] = going & !(met.0[at] >> shift | met.1[at] << 1 << (63 - shift));
    }
}
