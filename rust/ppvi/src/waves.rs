//! Which lists of which blocks may be updated at the same time, and which need not be updated at all.
//!
//! A pass is the sequence of tasks F(1), B(m), F(2), B(m - 1), ..., F(m), B(1): one front walks up through the blocks with
//! the forward lists, another one down with the backward lists. [`waves`] cuts this sequence into waves whose tasks do
//! not touch each other, so that the outcome is that of the sequence, bit for bit, on any number of threads (the proof is
//! in [`crate::priority`]). Where blocks read only their neighbours both fronts move at once, until they cross.
//! [`ResidualBoundTracker`] keeps the accumulated-change bound of the same page for every list.

use crate::block::Block;

/// The list `side` (0 forward, 1 backward) of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Task {
    pub block: usize,
    pub side: usize,
}

impl Task {
    fn index(self) -> usize {
        2 * self.block + self.side
    }

    fn reads(self, blocks: &[Block]) -> u128 {
        blocks[self.block].lists[self.side].reads
    }
}

/// The tasks of a pass, wave after wave.
pub(crate) fn waves(blocks: &[Block]) -> Vec<Vec<Task>> {
    let last = blocks.len().wrapping_sub(1);
    let pairs = (0..blocks.len()).map(|at| [Task { block: at, side: 0 }, Task { block: last - at, side: 1 }]);
    let tasks: Vec<Task> = pairs.flatten().filter(|task| blocks[task.block].list_len(task.side) > 0).collect();
    let mut waves: Vec<Vec<Task>> = Vec::new();
    for &task in &tasks {
        // After the last wave that holds an earlier task in conflict with this one.
        let touches = |other: &Task| {
            task.block == other.block
                || task.reads(blocks) >> other.block & 1 == 1
                || other.reads(blocks) >> task.block & 1 == 1
        };
        let level = waves.iter().rposition(|wave| wave.iter().any(touches)).map_or(0, |level| level + 1);
        if level == waves.len() {
            waves.push(Vec::new());
        }
        waves[level].push(task);
    }
    waves
}

/// Upper bounds on the residuals of the lists, without looking at states.
///
/// For every block the largest change of each update is added up; a list remembers these totals as they were when it was
/// updated. Its residual is at most what that update left plus discount * the largest growth, since then, of the total of
/// a block that it reads. A list that reads none of its own members late leaves nothing; any other leaves at most
/// discount * its own largest change. (A mixed state may since have been updated by the other list of its block: then its
/// residual was zero at that later moment, and the growth bounds all the more what has come after.)
#[derive(Debug)]
pub(crate) struct ResidualBoundTracker<'b> {
    blocks: &'b [Block],
    discount: f64,
    /// Changes of every block, summed over all updates.
    totals: Vec<f64>,
    /// The totals when a list was last updated, `[lists][blocks]`.
    seen: Vec<f64>,
    /// The residual left by the last update of a list.
    left: Vec<f64>,
}

impl<'b> ResidualBoundTracker<'b> {
    /// Nothing is known of any list: its bound is infinite.
    pub fn new(blocks: &'b [Block], discount: f64) -> Self {
        let count = blocks.len();
        let (totals, seen) = (vec![0.0; count], vec![0.0; 2 * count * count]);
        ResidualBoundTracker { blocks, discount, totals, seen, left: vec![f64::INFINITY; 2 * count] }
    }

    /// Upper bound on the residuals of the members of a list.
    pub fn bound(&self, task: Task) -> f64 {
        let seen = &self.seen[task.index() * self.blocks.len()..];
        let mut reads = task.reads(self.blocks);
        let mut growth = 0.0f64;
        while reads != 0 {
            let block = reads.trailing_zeros() as usize;
            growth = growth.max(self.totals[block] - seen[block]);
            reads &= reads - 1;
        }
        self.left[task.index()] + self.discount * growth
    }

    /// Notes that the lists of a wave have been updated, with the largest change of each.
    pub fn record(&mut self, wave: &[Task], changes: &[f64]) {
        for (task, change) in wave.iter().zip(changes) {
            self.totals[task.block] += change;
            let late = self.blocks[task.block].lists[task.side].late;
            self.left[task.index()] = if late { self.discount * change } else { 0.0 };
        }
        let count = self.blocks.len();
        for task in wave {
            self.seen[task.index() * count..][..count].copy_from_slice(&self.totals);
        }
    }
}
