//! The order of the updates of a pass, and the bounds that make updates unnecessary.
//!
//! A task updates one list of one block. A pass is the sequence of tasks F(1), B(m), F(2), B(m - 1), ..., F(m), B(1):
//! the forward lists of blocks 1 to m, and in turn with them the backward lists of blocks m to 1. [`waves`] cuts this
//! sequence into waves of tasks without conflicts. The tasks of a wave may run in parallel, and the result is the same,
//! bit for bit, as that of the sequence ([`crate::priority`] has the proof). [`ResidualBoundTracker`] computes the
//! accumulated-change bound, which [`crate::priority`] defines, for every list.

use crate::bellman::larger;
use crate::block::Block;

/// The update of list `side` (0 forward, 1 backward) of a block.
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
        // The wave after the last one that has an earlier task in conflict with this one.
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

/// Upper bounds on the residuals of the lists, computed without backups.
///
/// The tracker sums the largest changes of all updates of each block. For every list it stores these totals at the last
/// update of the list. The residual of a list is at most the residual after that update, plus discount * the largest
/// growth of the total of a block that the list reads. The residual after an update is zero if no member reads itself
/// or a later member, otherwise at most discount * the largest change of the update. (The other list of the block may
/// have updated a mixed state since. The residual of this state was then zero at the later time, so the bound holds for
/// it too.)
#[derive(Debug)]
pub(crate) struct ResidualBoundTracker<'b> {
    blocks: &'b [Block],
    discount: f64,
    /// Sum of the largest changes of all updates, by block.
    totals: Vec<f64>,
    /// The totals at the last update of each list, `[lists][blocks]`.
    seen: Vec<f64>,
    /// Upper bound on the residual of each list after its last update.
    left: Vec<f64>,
}

impl<'b> ResidualBoundTracker<'b> {
    /// Makes a tracker with infinite bounds for all lists.
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
            growth = larger(growth, self.totals[block] - seen[block]);
            reads &= reads - 1;
        }
        self.left[task.index()] + self.discount * growth
    }

    /// Records the updates of a wave, with the largest change of each.
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
