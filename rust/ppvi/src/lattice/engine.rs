//! Four sectors, their halos, and a pass over all of them.

use rayon::prelude::*;

use crate::bellman::larger;
use crate::lattice::backup::{self, SweepContext};
use crate::lattice::direction::{Arc, Direction};
use crate::lattice::halo::Halo;
use crate::lattice::kernel::{StageCosts, Vectorized};
use crate::lattice::model::LatticeMdp;
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
    /// By sector.
    changes: Vec<Change>,
    /// The tables that sweeps write.
    store: Option<Store>,
    /// By sector: the largest finite value that its last sweep staged; None if it did not stage values.
    kept: Vec<Option<f64>>,
}

/// Largest change in the inputs of a sector.
#[derive(Clone, Copy, Default)]
struct Change {
    /// During the last sweep of the sector.
    during: f64,
    /// Since then, at the interfaces between sectors.
    since: f64,
}

/// Values and actions in table layout.
pub(crate) struct Tables {
    pub values: Vec<f32>,
    /// Zeros for a given policy.
    pub policy: Vec<u8>,
    /// The largest finite value.
    pub largest: f64,
    /// Bound on the residual, but for rounding.
    pub seen: f64,
    /// Whether every state was backed up once more for them.
    pub again: bool,
}

impl<'a, T: Vectorized> Engine<'a, T> {
    /// `terminal_masks` are those of the lattice, or others of the same shape.
    pub(crate) fn new(
        lattice: &'a LatticeMdp,
        terminal_masks: &'a [TerminalMask],
        costs: &StageCosts<f64>,
        start: f64,
        policy: Option<&[u8]>,
    ) -> Self {
        let costs = costs.cast::<T>();
        let turns = Turns::new(&lattice.parts.regions);
        let inputs = PassInputs { lattice, turns: &turns, costs: &costs };
        let start = T::of(start);
        let (sectors, halos): (Vec<_>, Vec<_>) = Arc::all(&lattice.directions)
            .into_par_iter()
            .map(|arc| {
                let sector = Sector::new(inputs, arc, start, policy);
                let halo = Halo::new(&sector, turns.beyond, start, costs.outside());
                (sector, halo)
            })
            .unzip();
        let changes = sectors.iter().map(|_| Change::default()).collect();
        let kept = vec![None; sectors.len()];
        Engine { lattice, terminal_masks, sectors, halos, turns, costs, changes, store: None, kept }
    }

    /// Number of sectors.
    pub(crate) fn sectors(&self) -> usize {
        self.sectors.len()
    }

    /// Takes over the state of an engine of another precision.
    pub(crate) fn load<S: Real>(&mut self, other: &Engine<'_, S>) {
        self.sectors.par_iter_mut().zip(&other.sectors).for_each(|(sector, other)| sector.load(other));
        let (sectors, headings) = (&self.sectors, self.lattice.parts.shape.headings);
        self.halos.par_iter_mut().enumerate().for_each(|(of, halo)| halo.pull(sectors, of, headings));
    }

    /// Backs up every state of a wave once, and returns a bound on the Bellman residual of all values, but for
    /// rounding.
    ///
    /// There are two waves: right and left (`vertical` is false), up and down. The sectors of a wave read only
    /// themselves and their halos. A value is the exact backup of what it has read; its residual is at most the
    /// discount times what that has changed since: the halos (the *interface change*, computed when they are
    /// refreshed), and W of sectors in which steps read columns that are swept later. Interface changes far above
    /// `threshold` are computed roughly. With `keep` the values are written for the tables.
    pub(crate) fn wave(&mut self, vertical: bool, threshold: f64, keep: bool) -> f64 {
        self.sweep(|sector| sector.arc.direction.is_vertical() == vertical, keep);
        // The halos of the other wave are outdated now. So are those of this wave if they read sectors of this wave:
        // beyond a short sector, or next to them where a direction has no headings.
        let reach = self.turns.reach();
        let reads_own_wave =
            self.sectors.len() < Direction::ALL.len() || self.sectors.iter().any(|sector| sector.arc.count < reach);
        self.pull(|sector| reads_own_wave || sector.arc.direction.is_vertical() != vertical, threshold)
    }

    /// Both waves.
    pub(crate) fn pass(&mut self, threshold: f64) -> f64 {
        self.wave(false, threshold, false);
        self.wave(true, threshold, false)
    }

    /// Sweeps some sectors, side by side.
    fn sweep(&mut self, chosen: impl Fn(&Sector<T>) -> bool + Sync, keep: bool) {
        let Engine { lattice, terminal_masks, sectors, halos, turns, costs, changes, store, kept } = self;
        let inputs = PassInputs { lattice, turns, costs };
        let arcs = sectors.iter().map(|sector| sector.arc);
        let tables: Vec<Option<TableWriter<'_>>> = if keep {
            store.get_or_insert_with(|| Store::new(lattice.parts.shape)).parts(arcs).into_iter().map(Some).collect()
        } else {
            arcs.map(|_| None).collect()
        };
        let results = changes.par_iter_mut().zip(kept);
        let stop = &StopFlag::current();
        let all = sectors.par_iter_mut().zip(&*halos).zip(*terminal_masks).zip(tables).zip(results);
        let chosen = all.filter(|((((sector, _), _), _), _)| chosen(sector));
        chosen.for_each(|((((sector, halo), terminal_mask), table), (change, kept))| {
            let swept = backup::sweep(sector, SweepContext { inputs, terminal_mask, halo, table, stop });
            *change = Change { during: swept.change, since: 0.0 };
            *kept = keep.then_some(swept.largest);
        });
    }

    /// Pulls the halos of some sectors; returns the bound of [`Engine::wave`].
    fn pull(&mut self, stale: impl Fn(&Sector<T>) -> bool + Sync, threshold: f64) -> f64 {
        let Engine { lattice, sectors, halos, turns, changes, .. } = self;
        let stale = halos.par_iter_mut().zip(&mut *changes).enumerate().filter(|(of, _)| stale(&sectors[*of]));
        stale.for_each(|(of, (halo, change))| {
            halo.pull(sectors, of, lattice.parts.shape.headings);
            change.since += halo.interface_change(sectors[of].arc.count, turns, threshold);
        });
        self.bound()
    }

    /// The bound of [`Engine::wave`].
    fn bound(&self) -> f64 {
        let largest = self.changes.iter().fold(0.0, |max, change| larger(max, change.during + change.since));
        largest * self.costs.discount.widen()
    }

    /// Approximate largest finite value.
    pub(crate) fn max(&self) -> f64 {
        self.sectors.iter().map(Sector::max).fold(0.0, f64::max)
    }

    /// Returns values, better actions, and the bound of [`Engine::wave`] on their residual.
    ///
    /// Where the last sweep of a sector did not keep its values, every state is backed up once more, each sector with
    /// the halos that it has. For the wave that was swept last they are those of its last sweep, so that nothing
    /// changes; the other wave has new ones, and so the last wave finds another interface change. With an infinite
    /// threshold this is always done, so that no change in the bound is computed roughly.
    pub(crate) fn tables(&mut self, threshold: f64) -> Tables {
        let again = threshold == f64::INFINITY || self.kept.iter().any(Option::is_none);
        if again {
            self.sweep(|_| true, true);
            self.pull(|_| true, threshold);
        }
        let seen = self.bound();
        let largest = self.kept.iter_mut().filter_map(Option::take).fold(0.0, f64::max);
        let Some(store) = self.store.take() else { unreachable!("every sector has kept its values") };
        // SAFETY: the last sweep of every sector has written all its headings at all grid points.
        let (values, policy) = unsafe { store.finish() };
        Tables { values, policy, largest, seen, again }
    }
}
