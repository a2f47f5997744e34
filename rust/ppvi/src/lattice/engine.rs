//! Four sectors, their halos, and a pass over all of them.

use rayon::prelude::*;

use crate::bellman::larger;
use crate::lattice::backup::{self, SweepContext};
use crate::lattice::convolve;
use crate::lattice::cubic::Reading;
use crate::lattice::direction::{Arc, Direction};
use crate::lattice::halo::Halo;
use crate::lattice::kernel::{StageCosts, Vectorized};
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{LANES, Shape};
use crate::lattice::real::Real;
use crate::lattice::sector::{PassInputs, Sector};
use crate::lattice::store::{Store, TableWriter};
use crate::lattice::terminal_mask::TerminalMask;
use crate::lattice::turns::Turns;
use crate::stop::StopFlag;

/// The state of an iteration; with a policy its passes evaluate that, without they take the better action.
pub(crate) struct Engine<'a, T: Copy> {
    lattice: &'a LatticeMdp,
    terminal_masks: &'a [TerminalMask],
    sectors: Vec<Sector<T>>,
    halos: Vec<Halo<T>>,
    turns: Turns<T>,
    costs: StageCosts<T>,
    /// Largest change of a backup for a change of one of W: the discount, times the sum of the weights of a step.
    most: f64,
    /// By sector: the numbers A and H of [`crate::lattice::pending`].
    changes: Vec<Change>,
    /// Whether sweeps leave out strips.
    skips: bool,
    /// The tables that sweeps write.
    store: Option<Store>,
    /// By sector: the largest finite value that its last sweep staged; None if it did not stage values.
    kept: Vec<Option<f64>>,
    /// Number of states that were backed up so far.
    backups: u64,
}

/// The largest changes in the inputs of the strips of a sector, since they were backed up.
#[derive(Clone, Copy)]
struct Change {
    /// Within the sector.
    pending: f64,
    /// In other sectors, as it would change W.
    halo: f64,
}

/// What a sweep does.
#[derive(Clone, Copy)]
struct Sweep {
    /// Strips whose inputs have changed by no more than this are left out; None leaves out nothing.
    level: Option<f64>,
    /// Whether it writes tables.
    keep: bool,
    /// Whether it only repeats the last sweep.
    again: bool,
}

/// Part of the residual that is asked for, up to which changes of the inputs of a strip are ignored. The bound is the
/// sum of two such changes.
const SKIP: f64 = 0.4;

/// Factor on bounds, for the rounding of the changes that they are made of.
const UPWARD: f64 = 1.0 + 1e-6;

/// Values and actions in table layout.
pub(crate) struct Tables {
    pub values: Vec<f32>,
    /// Zeros for a given policy.
    pub policy: Vec<u8>,
    /// The largest finite value.
    pub largest: f64,
    /// Bound on the residual, but for rounding.
    pub seen: f64,
}

impl<'a, T: Vectorized> Engine<'a, T> {
    /// `terminal_masks` are those of the lattice, or others of the same shape. With `skips`, sweeps leave out the strips
    /// whose inputs have not changed.
    pub(crate) fn new(
        lattice: &'a LatticeMdp,
        terminal_masks: &'a [TerminalMask],
        costs: &StageCosts<f64>,
        start: f64,
        policy: Option<(&[u8], Reading)>,
        skips: bool,
    ) -> Self {
        let costs = costs.cast::<T>();
        let turns = Turns::new(&lattice.parts);
        let inputs = PassInputs { lattice, turns: &turns, costs: &costs };
        let start = T::of(start);
        let (sectors, halos): (Vec<_>, Vec<_>) = Arc::all(&lattice.directions)
            .into_par_iter()
            .map(|arc| {
                let sector = Sector::new(inputs, arc, start, policy, skips);
                let halo = Halo::new(&sector, &turns, start, costs.outside());
                (sector, halo)
            })
            .unzip();
        let changes = vec![Change { pending: f64::INFINITY, halo: 0.0 }; sectors.len()];
        let kept = vec![None; sectors.len()];
        let (store, backups) = (None, 0);
        let reading = policy.map_or(Reading::Transitions, |(_, reading)| reading);
        let shifts = sectors.iter().flat_map(|sector| sector.shifts.iter().flatten().copied());
        let most = costs.discount.widen() * reading.largest_sum(shifts);
        Engine { lattice, terminal_masks, sectors, halos, turns, costs, most, changes, skips, store, kept, backups }
    }

    /// Number of sectors.
    pub(crate) fn sectors(&self) -> usize {
        self.sectors.len()
    }

    /// Takes over the state of an engine of another precision.
    pub(crate) fn load<S: Real>(&mut self, other: &Engine<'_, S>) {
        self.sectors.par_iter_mut().zip(&other.sectors).for_each(|(sector, other)| sector.load(other));
        self.pull_all();
    }

    /// Starts with `value(state)` where sectors read each other; to be called before the first wave.
    pub(crate) fn start_from(&mut self, value: impl Fn(usize) -> f64 + Sync) {
        let shape = self.lattice.parts.shape;
        self.sectors.par_iter_mut().for_each(|sector| {
            sector.start_from(shape, |state| T::of(value(state)));
            sector.swept.fill(true);
        });
        self.pull_all();
    }

    /// Refreshes all halos.
    fn pull_all(&mut self) {
        let (sectors, headings) = (&self.sectors, self.lattice.parts.shape.headings);
        self.halos.par_iter_mut().enumerate().for_each(|(of, halo)| {
            halo.pull(sectors, of, headings, 0.0);
        });
    }

    /// Number of states that were backed up so far.
    pub(crate) fn backups(&self) -> u64 {
        self.backups
    }

    /// Number of visits of the last wave to the partitions of a regular grid over the grid points: one for each
    /// direction in which strips of the partition were backed up. A strip belongs to the partition of its first point.
    pub(crate) fn visits(&self, [columns, rows]: [usize; 2]) -> u64 {
        let Shape { nx, ny, .. } = self.lattice.parts.shape;
        let of_sector = |sector: &Sector<T>| {
            let mut visited = vec![false; columns * rows];
            for number in (0..sector.swept.len()).filter(|number| sector.swept[*number]) {
                let (place, first) = (number / sector.strips(), number % sector.strips() * LANES);
                let (i, j) = if sector.arc.direction.is_vertical() { (first, place) } else { (place, first) };
                visited[i * columns / nx * rows + j * rows / ny] = true;
            }
            visited.into_iter().filter(|visited| *visited).count() as u64
        };
        self.sectors.iter().map(of_sector).sum()
    }

    /// Backs up the strips of a wave whose inputs have changed, and returns a bound on the Bellman residual of all
    /// values, but for rounding; [`crate::lattice::pending`] has the proof.
    ///
    /// There are two waves: right and left (`vertical` is false), up and down. The sectors of a wave read only
    /// themselves and their halos. If nothing is left to do, the bound is below `threshold`. A bound above it may be an
    /// estimate: large changes between sectors are not computed to the end. With `keep` the values are written for the
    /// tables, if no strip is left out.
    pub(crate) fn wave(&mut self, vertical: bool, threshold: f64, keep: bool) -> f64 {
        let of_wave = |sector: &Sector<T>| sector.arc.direction.is_vertical() == vertical;
        let level = self.skips.then_some(SKIP * threshold);
        self.sweep(of_wave, Sweep { level, keep: keep && !self.skips, again: false });
        // The halos of the other wave are outdated now. So are those of this wave if they read sectors of this wave:
        // beyond a short sector, or next to them where a direction has no headings.
        let reach = self.turns.reach();
        let reads_own_wave =
            self.sectors.len() < Direction::ALL.len() || self.sectors.iter().any(|sector| sector.arc.count < reach);
        let Engine { lattice, sectors, halos, most, changes, .. } = self;
        let stale = |of: usize| reads_own_wave || sectors[of].arc.direction.is_vertical() != vertical;
        let enough = UPWARD * threshold / *most;
        let stale = halos.par_iter_mut().zip(changes).enumerate().filter(|(of, _)| stale(*of));
        stale.for_each(|(of, (halo, change))| {
            change.halo = halo.pull(sectors, of, lattice.parts.shape.headings, enough);
        });
        self.bound()
    }

    /// Both waves.
    pub(crate) fn pass(&mut self, threshold: f64) -> f64 {
        self.wave(false, threshold, false);
        self.wave(true, threshold, false)
    }

    /// Sweeps some sectors, side by side.
    fn sweep(&mut self, chosen: impl Fn(&Sector<T>) -> bool + Sync, Sweep { level, keep, again }: Sweep) {
        let Engine { lattice, terminal_masks, sectors, halos, turns, costs, changes, store, kept, backups, .. } = self;
        let inputs = PassInputs { lattice, turns, costs };
        let arcs = sectors.iter().map(|sector| sector.arc);
        let tables: Vec<Option<TableWriter<'_>>> = if keep {
            store.get_or_insert_with(|| Store::new(lattice.parts.shape)).parts(arcs).into_iter().map(Some).collect()
        } else {
            arcs.map(|_| None).collect()
        };
        let results = changes.par_iter_mut().zip(kept);
        let stop = &StopFlag::current();
        let all = sectors.par_iter_mut().zip(halos).zip(*terminal_masks).zip(tables).zip(results);
        let swept = all.map(|((((sector, halo), terminal_mask), table), (change, kept))| {
            if !chosen(sector) {
                sector.swept.fill(false);
                return 0;
            }
            let context = SweepContext { inputs, terminal_mask, halo, level, table, again, stop };
            let swept = backup::sweep(sector, context);
            if !again {
                *change = Change { pending: swept.pending, halo: 0.0 };
            }
            *kept = keep.then_some(swept.largest);
            swept.backups
        });
        *backups += swept.sum::<u64>();
    }

    /// The bound of [`Engine::wave`].
    fn bound(&self) -> f64 {
        let most = |change: fn(&Change) -> f64| self.changes.iter().map(change).fold(0.0, larger);
        UPWARD * self.most * (self.most.max(1.0) * most(|change| change.pending) + most(|change| change.halo))
    }

    /// The bound of [`Engine::wave`], with no change in it estimated.
    pub(crate) fn exact_bound(&mut self) -> f64 {
        let all = self.halos.par_iter_mut().zip(&mut self.changes);
        all.for_each(|(halo, change)| change.halo = halo.change());
        self.bound()
    }

    /// Approximate largest finite value.
    pub(crate) fn max(&self) -> f64 {
        self.sectors.iter().map(Sector::max).fold(0.0, f64::max)
    }

    /// The better actions if all values are `values`, in table layout. It needs W of all columns, as with `skips`.
    pub(crate) fn greedy(&mut self, values: &[f32]) -> Vec<u8> {
        let Engine { lattice, sectors, halos, turns, costs, .. } = self;
        let (inputs, stop) = (PassInputs { lattice, turns, costs }, &StopFlag::current());
        sectors.par_iter_mut().zip(&*halos).for_each(|(sector, halo)| {
            convolve::convolve_all(sector, halo, inputs, values, stop);
        });
        self.sweep(|_| true, Sweep { level: None, keep: true, again: true });
        let Some(store) = self.store.take() else { unreachable!("the sweep has kept its values") };
        // SAFETY: the sweep of every sector has written all its headings at all grid points.
        unsafe { store.finish() }.1
    }

    /// Returns values, better actions, and the bound of [`Engine::wave`] on their residual. Both waves must have been
    /// swept.
    ///
    /// Where the last sweep of a sector did not keep its values, every state is backed up once more, each from what its
    /// last backup has read or from what has replaced it since.
    pub(crate) fn tables(&mut self) -> Tables {
        let seen = self.exact_bound();
        if self.kept.iter().any(Option::is_none) {
            self.sweep(|_| true, Sweep { level: None, keep: true, again: true });
        }
        let largest = self.kept.iter_mut().filter_map(Option::take).fold(0.0, f64::max);
        let Some(store) = self.store.take() else { unreachable!("every sector has kept its values") };
        // SAFETY: the last sweep of every sector has written all its headings at all grid points.
        let (values, policy) = unsafe { store.finish() };
        Tables { values, policy, largest, seen }
    }
}
