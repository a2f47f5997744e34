//! Which states of a slice are open, as sets of bits, and the window of a slice that is computed.
//!
//! [The module](crate::space) defines open states. A step moves all grid points of a slice by the same offset, so sets of states
//! are shifted as bits, 64 points at a time. [`Reach::find`] leaves out what lies on the way: this gives the window. The
//! outcomes of the steps are known only after that, and [`Reach::follow`] keeps what they let through.

use std::ops::Range;

use crate::space::collision::voxel;
use crate::space::outcomes::{StepEnds, WORD};
use crate::space::parts::{SpaceParts, SpaceShape, SpaceStep};

/// Numbers that are computed together.
pub(crate) const LANES: usize = 8;

/// A set of grid points of a slice.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PointSet {
    /// Words of a row.
    words: usize,
    nz: usize,
    bits: Vec<u64>,
    /// Rows that may have points; the others have none.
    rows: Range<usize>,
}

impl PointSet {
    /// The empty set.
    pub(crate) fn new(shape: SpaceShape) -> Self {
        let words = shape.nz.div_ceil(WORD);
        PointSet { words, nz: shape.nz, bits: vec![0; shape.ny * words], rows: 0..0 }
    }

    /// The empty set of cells, each numbered by its upper corner; the cells at the rim have corners beyond the grid.
    pub(crate) fn of_cells(shape: SpaceShape) -> Self {
        PointSet::new(SpaceShape { ny: shape.ny + 1, nz: shape.nz + 1, ..shape })
    }

    /// The points of a slice with this code.
    #[cfg(test)]
    fn with_code(shape: SpaceShape, codes: &[u8], code: u8) -> Self {
        let mut found = PointSet::new(shape);
        for (point, _) in codes.iter().enumerate().filter(|(_, at)| **at == code) {
            let (row, k) = (point / shape.nz, point % shape.nz);
            found.bits[row * found.words + k / WORD] |= 1 << (k % WORD);
            found.extend(row..row + 1);
        }
        found
    }

    pub(crate) fn clear(&mut self) {
        let used = self.rows.start * self.words..self.rows.end * self.words;
        self.bits[used].fill(0);
        self.rows = 0..0;
    }

    fn extend(&mut self, rows: Range<usize>) {
        self.rows = match self.rows.is_empty() {
            true => rows,
            false => self.rows.start.min(rows.start)..self.rows.end.max(rows.end),
        };
    }

    /// The words of a row.
    #[inline]
    pub(crate) fn row(&self, row: usize) -> &[u64] {
        &self.bits[row * self.words..][..self.words]
    }

    /// Keeps the points that are in another set too.
    pub(crate) fn keep(&mut self, other: &PointSet) {
        self.bits.iter_mut().zip(&other.bits).for_each(|(bits, other)| *bits &= other);
    }

    /// The points of a word of a row that lead to a point of the set by an offset along y and z.
    #[inline]
    fn moved_word(&self, row: usize, word: usize, [dj, dk]: [i32; 2]) -> u64 {
        let row = row as i64 + i64::from(dj);
        if row < self.rows.start as i64 || row >= self.rows.end as i64 {
            return 0;
        }
        let bits = self.row(row as usize);
        let at = |word: i64| usize::try_from(word).ok().and_then(|word| bits.get(word)).copied().unwrap_or(0);
        let (first, shift) = (i64::from(dk).div_euclid(WORD as i64), dk.rem_euclid(WORD as i32) as u32);
        let word = word as i64 + first;
        // Two shifts, since one of 64 bits is none.
        at(word) >> shift | at(word + 1) << 1 << (63 - shift)
    }

    /// Adds the points that lead to a point of another set by an offset along y and z.
    fn join_moved(&mut self, other: &PointSet, [dj, dk]: [i32; 2]) {
        let count = (self.bits.len() / self.words) as i64;
        let within = |row: usize| (row as i64 - i64::from(dj)).clamp(0, count) as usize;
        let rows = within(other.rows.start)..within(other.rows.end);
        let by = dk.unsigned_abs();
        if rows.is_empty() || by as usize >= self.nz.max(other.nz) {
            return;
        }
        let from = (rows.start as i64 + i64::from(dj)) as usize;
        let last = u64::MAX >> ((WORD - self.nz % WORD) % WORD);
        if self.words == 1 && other.words == 1 {
            let into = self.bits[rows.clone()].iter_mut().zip(&other.bits[from..][..rows.len()]);
            match dk > 0 {
                true => into.for_each(|(into, of)| *into |= of >> by & last),
                false => into.for_each(|(into, of)| *into |= of << by & last),
            }
        } else {
            for row in rows.clone() {
                for word in 0..self.words {
                    self.bits[row * self.words + word] |= other.moved_word(row, word, [dj, dk]);
                }
                self.bits[(row + 1) * self.words - 1] &= last;
            }
        }
        self.extend(rows);
    }

    /// The rows and the points along z between which all points of the set lie.
    pub(crate) fn window(&self) -> Window {
        let has_any = |row: &usize| self.row(*row).iter().any(|word| *word != 0);
        let first = self.rows.clone().find(has_any).unwrap_or(self.rows.end);
        let rows = first..self.rows.clone().rfind(has_any).map_or(first, |row| row + 1);
        let (mut low, mut high) = (self.nz, 0);
        for row in rows.clone() {
            for (word, bits) in self.row(row).iter().enumerate().filter(|(_, bits)| **bits != 0) {
                low = low.min(word * WORD + bits.trailing_zeros() as usize);
                high = high.max((word + 1) * WORD - bits.leading_zeros() as usize);
            }
        }
        Window { rows, points: low.min(high)..high }
    }

    /// Adds the points `from` to `to` of a row.
    pub(crate) fn fill_row(&mut self, row: usize, points: Range<usize>) {
        for (word, bits) in self.bits[row * self.words..][..self.words].iter_mut().enumerate() {
            let [from, to] = [points.start, points.end].map(|k| k.saturating_sub(word * WORD).min(WORD) as u32);
            *bits |= (u64::MAX.checked_shl(from).unwrap_or(0)) & !(u64::MAX.checked_shl(to).unwrap_or(0));
        }
        self.extend(row..row + 1);
    }

    /// The first point of a row from `from` on that is in the set (or is not, if `is_in` is false), or `end` if that comes before.
    fn next(&self, row: usize, is_in: bool, from: usize, end: usize) -> usize {
        let (bits, mut at) = (self.row(row), from);
        while at < end {
            let word = if is_in { bits[at / WORD] } else { !bits[at / WORD] };
            let left = word >> (at % WORD);
            if left != 0 {
                return end.min(at + left.trailing_zeros() as usize);
            }
            at = (at / WORD + 1) * WORD;
        }
        end
    }

    /// Calls `visit(from, to)` for the runs of points of a window in a row that are in the set (or are not, if `is_in` is false).
    pub(crate) fn for_each_run(&self, row: usize, window: &Window, is_in: bool, mut visit: impl FnMut(usize, usize)) {
        let mut from = self.next(row, is_in, window.points.start, window.points.end);
        while from < window.points.end {
            let to = self.next(row, !is_in, from, window.points.end);
            visit(from, to);
            from = self.next(row, is_in, to, window.points.end);
        }
    }

    /// The first point of a row that is in the set, and the point after the last one.
    pub(crate) fn span(&self, row: usize) -> Option<[usize; 2]> {
        let words = || self.row(row).iter().enumerate();
        let (word, bits) = words().find(|(_, bits)| **bits != 0)?;
        let first = word * WORD + bits.trailing_zeros() as usize;
        let (word, bits) = words().rfind(|(_, bits)| **bits != 0)?;
        Some([first, (word + 1) * WORD - bits.leading_zeros() as usize])
    }

    /// Adds points of a word of a row.
    #[inline]
    pub(crate) fn join_word(&mut self, row: usize, word: usize, points: u64) {
        self.bits[row * self.words + word] |= points;
        self.extend(row..row + 1);
    }
}

/// A part of a slice: rows, and points along z.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Window {
    pub rows: Range<usize>,
    pub points: Range<usize>,
}

/// Where a branch lands: direction, and upper corner of the cell, relative to the start.
type Cell = (u32, [i32; 2]);

/// Finds open states.
pub(crate) struct Reach {
    /// Where each step may land, `[region][direction][action]`.
    landings: Vec<Vec<Vec<Cell>>>,
    /// For each direction, the grid points whose voxels its steps pass, relative to the start.
    passed: Vec<Vec<[i32; 3]>>,
    /// The grid points of each slice with a voxel of the target.
    touching: Vec<PointSet>,
}

impl Reach {
    pub(crate) fn new(parts: &SpaceParts) -> Self {
        let (shape, actions) = (parts.shape, parts.actions());
        let of_direction = |direction: usize| {
            parts.regions.iter().flat_map(move |steps| &steps[direction * actions..(direction + 1) * actions])
        };
        let landings = |step: &SpaceStep| {
            sorted(step.branches.iter().map(|branch| (branch.direction, branch.upper_corner())).collect())
        };
        let passed = |direction: usize| {
            let voxels = of_direction(direction).flat_map(|step| step.path.iter().chain(step.rests.iter().flatten()));
            sorted(voxels.map(|offset| parts.voxels.place(*offset).1).collect())
        };
        let touching = |slice: usize| {
            let mut found = PointSet::new(shape);
            parts.voxels.for_each_point(slice, voxel::TARGET, |j, k| found.fill_row(j, k..k + 1));
            found
        };
        Reach {
            landings: parts.regions.iter().map(|steps| steps.iter().map(landings).collect()).collect(),
            passed: (0..shape.directions).map(passed).collect(),
            touching: (0..shape.slices).map(touching).collect(),
        }
    }

    /// Finds the states of a direction that may be open, whatever lies on the way, and those from which each step may land
    /// on open states, `[region][action]`. `ahead`: the landings that are read from open states, for each direction, in the
    /// slice in which the steps end.
    pub(crate) fn find(
        &self,
        [slice, direction]: [usize; 2],
        ahead: Option<&[PointSet]>,
        found: &mut PointSet,
        landed: &mut [PointSet],
    ) {
        found.clear();
        for [ds, dj, dk] in &self.passed[direction] {
            if let Some(target) = self.touching.get(slice + *ds as usize) {
                found.join_moved(target, [*dj, *dk]);
            }
        }
        let actions = landed.len() / self.landings.len();
        for (steps, landed) in self.landings.iter().zip(landed.chunks_exact_mut(actions)) {
            for (cells, landed) in steps[direction * actions..].iter().zip(landed) {
                landed.clear();
                for (direction, cell) in cells.iter().filter(|_| ahead.is_some()) {
                    landed.join_moved(&ahead.unwrap_or_default()[*direction as usize], *cell);
                }
                found.join_moved(landed, [0; 2]);
            }
        }
    }

    /// Adds the starts from which a step leads on to open states, or into the target. `ends`: its outcomes from `rows` rows from
    /// row `j` on; `landed`: where it may land on open states. Only points of `looked_at` are looked at.
    pub(crate) fn follow(
        &self,
        (step, ends): (&SpaceStep, StepEnds<'_>),
        [j, rows]: [usize; 2],
        ahead: Option<&[PointSet]>,
        [looked_at, landed]: [&PointSet; 2],
        open: &mut PointSet,
    ) {
        for (row, word) in (0..rows).flat_map(|row| (0..looked_at.words).map(move |word| (row, word))) {
            let at = (j + row) * looked_at.words + word;
            let left = looked_at.bits[at] & !open.bits[at];
            if left == 0 {
                continue;
            }
            let [going, in_target, mixed] = ends.of_all([row, word]);
            let mut found = in_target | going & landed.bits[at];
            if left & mixed & !found != 0 {
                found |= step.branches.iter().fold(0, |found, branch| found | ends.in_target([row, word], branch.rest));
            }
            // Branches go on to open states only where some branch would, whatever lies on the way.
            for branch in &step.branches {
                if left & mixed & landed.bits[at] & !found == 0 {
                    break;
                }
                let cells = ahead.map(|ahead| &ahead[branch.direction as usize]);
                let landed = cells.map_or(0, |cells| cells.moved_word(j + row, word, branch.upper_corner()));
                found |= ends.going([row, word], branch.rest) & landed;
            }
            open.bits[at] |= found & left;
        }
        open.extend(j..j + rows);
    }

    /// Finds the cells of a slice in which landings are read from open states: one is among the corners.
    pub(crate) fn find_landings(&self, open: &PointSet, landings: &mut PointSet) {
        landings.clear();
        for corner in [[0, 0], [0, -1], [-1, 0], [-1, -1]] {
            landings.join_moved(open, corner);
        }
    }
}

/// Sorts, and leaves out what is there twice.
fn sorted<T: Ord>(mut all: Vec<T>) -> Vec<T> {
    all.sort_unstable();
    all.dedup();
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The points of a set, one by one.
    fn points(set: &PointSet) -> Vec<[usize; 2]> {
        let rows = 0..set.bits.len() / set.words;
        let all = rows.flat_map(|row| (0..set.nz).map(move |k| [row, k]));
        all.filter(|[row, k]| set.row(*row)[k / WORD] >> (k % WORD) & 1 != 0).collect()
    }

    #[test]
    fn moved_sets_gaps_and_windows_are_those_of_single_points() {
        let mut state = 1u64;
        let mut random = |count: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % count
        };
        for (ny, nz) in [(1, 1), (5, 9), (4, 63), (4, 64), (3, 65), (6, 130)] {
            let shape = SpaceShape { slices: 1, ny, nz, directions: 1 };
            for _ in 0..60 {
                let codes: Vec<u8> = (0..ny * nz).map(|_| u8::from(random(9) > 0)).collect();
                let set = PointSet::with_code(shape, &codes, 0);
                let expected = |by: [i32; 2]| {
                    let leads = |at: &[usize; 2]| {
                        let to = [0, 1].map(|axis| at[axis] as i64 + i64::from(by[axis]));
                        points(&set).iter().any(|point| point.map(|x| x as i64) == to)
                    };
                    let all = (0..ny).flat_map(|row| (0..nz).map(move |k| [row, k]));
                    all.filter(leads).collect::<Vec<_>>()
                };
                let by = [random(9) as i32 - 4, random(2 * nz + 3) as i32 - nz as i32 - 1];
                let mut moved = PointSet::new(shape);
                moved.join_moved(&set, by);
                assert_eq!(points(&moved), expected(by), "{ny} {nz} {by:?}");
                for row in 0..ny {
                    let other = PointSet::with_code(shape, &codes, 1);
                    let ends = [random(nz + 1), random(nz + 1)];
                    let run = ends[0].min(ends[1])..ends[0].max(ends[1]);
                    let mut filled = other.clone();
                    filled.fill_row(row, run.clone());
                    let both = points(&moved).into_iter().filter(|at| at[0] == row && points(&filled).contains(at));
                    let both: Vec<usize> = both.map(|at| at[1]).collect();
                    let span = both.first().zip(both.last()).map(|(first, last)| [*first, last + 1]);
                    let mut kept = moved.clone();
                    kept.keep(&filled);
                    assert_eq!(kept.span(row), span);
                    let expected = |at: &[usize; 2]| at[0] == row && run.contains(&at[1]);
                    assert!(points(&filled).iter().all(|at| expected(at) || points(&other).contains(at)));
                    assert!(run.clone().all(|k| points(&filled).contains(&[row, k])));
                }
                let window = moved.window();
                let of_axis = |axis: usize| points(&moved).into_iter().map(move |point| point[axis]);
                if let (Some(low), Some(high)) = (of_axis(1).min(), of_axis(1).max()) {
                    let rows = of_axis(0).min().unwrap()..of_axis(0).max().unwrap() + 1;
                    assert_eq!(window, Window { rows, points: low..high + 1 });
                } else {
                    assert!(window.rows.is_empty() && window.points.is_empty());
                }
                for row in window.rows.clone() {
                    for is_in in [false, true] {
                        let mut found = vec![!is_in; nz];
                        moved.for_each_run(row, &window, is_in, |from, to| found[from..to].fill(is_in));
                        let all = points(&moved);
                        assert!(window.points.clone().all(|k| found[k] == all.contains(&[row, k])));
                    }
                }
                moved.clear();
                assert_eq!(moved, PointSet::new(shape));
            }
        }
    }
}
