//! Which strips of a sector have to be backed up: bounds on the changes of what they read.
//!
//! A *strip* is [`LANES`] neighbouring grid points of a column, with all headings of its sector and both bevels. Its
//! values V are backups of W, the values convolved along the headings, in a few columns downstream; its own W is the
//! convolution of its V and of a few headings of other sectors, its halo. For each strip s two numbers are known:
//!
//! * A(s), how much the W that s reads has changed since s was backed up, at most. It grows, in every sweep, by the
//!   largest change that the sweep makes to the W of a strip that s reads;
//! * H(s), how much its own W would change if it were computed from the present values of other sectors, and not from
//!   the halo that was used.
//!
//! *Bound.* Let g be the discount, A and H the largest of these numbers, and V' the backup of all W as stored. V' differs
//! from V by at most g A, so the W of V' and of the present halos differs from the stored W by at most g A + H, and the
//! Bellman residual of V' is at most g (g A + H) <= g (A + H). No backup is needed to know it.
//!
//! *Priority.* g (A(s) + H(s)) is the priority of a strip. A sweep leaves out the strips with A <= level and H <= level.
//! With a level of two fifths of the residual that is asked for, the solve ends when no strip is left. The others are
//! backed up in the order of the sweep, not of their priorities: a higher level for the first sweeps, so that large
//! changes come first, took more backups, because most changes are then made twice.
//!
//! *Threads.* Which strips are left out depends on values only, never on times or threads, and the sectors of a wave do
//! not read each other: the result has the same bits on any number of threads.
//!
//! *Cost.* A strip may only be left out if its W is still there, so W is stored whole and compared with its old values.
//! Sweeps over all states need neither, keep a few columns of W in the cache, and are about twice as fast for each
//! backup. Therefore they are the default of a sweep, and strips are left out on request only.

use crate::bellman::larger;
use crate::lattice::parts::{LANES, Shift};

/// A(s) of all strips of a sector, and the changes of a sweep.
pub(crate) struct Pending {
    /// Columns, and strips of a column.
    extent: [usize; 2],
    /// The columns that a strip reads, relative to its own: first and last.
    columns: [i64; 2],
    /// How many strips to either side a strip reads.
    aside: usize,
    /// A(s), `[u][strip]`.
    bounds: Vec<f64>,
    /// Largest change of the W of a strip in the present sweep.
    changes: Vec<f64>,
}

impl Pending {
    /// For `extent` columns and strips, and steps with these displacements along (u, v), which read `beyond` points beside
    /// the cell in which they end.
    pub(crate) fn new(extent: [usize; 2], shifts: &[[Shift; 2]], beyond: usize) -> Self {
        let cells = |axis: usize| shifts.iter().flatten().map(move |shift| i64::from(shift.cell[axis]));
        let more = beyond as i64;
        let columns = [cells(0).min().unwrap_or(0) - more, cells(0).max().unwrap_or(0) + 1 + more];
        // The first grid point of a strip may read the last one of the strip before, the last one the one after.
        let reach = cells(1).map(|cell| cell.unsigned_abs() as usize + 1 + beyond).max().unwrap_or(1);
        let (aside, strips) = (reach.div_ceil(LANES), extent[0] * extent[1]);
        Pending { extent, columns, aside, bounds: vec![f64::INFINITY; strips], changes: vec![0.0; strips] }
    }

    /// Begins a sweep.
    pub(crate) fn begin(&mut self) {
        self.changes.fill(0.0);
    }

    /// Whether a strip has to be backed up, as its inputs have changed by more than `level`. Columns are swept in
    /// falling order.
    #[inline(always)]
    pub(crate) fn is_due(&mut self, u: usize, strip: usize, level: f64) -> bool {
        let at = u * self.extent[1] + strip;
        if self.bounds[at] <= level {
            self.bounds[at] += self.change_of_inputs(u, strip, u as i64 + 1, i64::MAX);
        }
        self.bounds[at] > level
    }

    /// Records that a strip was backed up, and how much that changed its W.
    #[inline(always)]
    pub(crate) fn record(&mut self, u: usize, strip: usize, change: f64) {
        let at = u * self.extent[1] + strip;
        self.bounds[at] = 0.0;
        self.changes[at] = change;
    }

    /// Ends a sweep. Returns the largest A.
    pub(crate) fn end(&mut self) -> f64 {
        if self.columns[0] <= 0 {
            // Some strips read columns that were swept after them, or together with them.
            for u in 0..self.extent[0] {
                for strip in 0..self.extent[1] {
                    self.bounds[u * self.extent[1] + strip] += self.change_of_inputs(u, strip, 0, u as i64);
                }
            }
        }
        self.bounds.iter().copied().fold(0.0, larger)
    }

    /// The largest change in this sweep of the W of a strip that a strip reads, in columns `first ..= last`.
    #[inline(always)]
    fn change_of_inputs(&self, u: usize, strip: usize, first: i64, last: i64) -> f64 {
        let [columns, strips] = self.extent;
        let first = (u as i64 + self.columns[0]).max(first).max(0);
        let last = (u as i64 + self.columns[1]).min(last).min(columns as i64 - 1);
        let aside = strip.saturating_sub(self.aside)..(strip + self.aside + 1).min(strips);
        let mut most = 0.0;
        for column in first..=last {
            for change in &self.changes[column as usize * strips..][aside.clone()] {
                most = if *change > most { *change } else { most };
            }
        }
        most
    }
}
