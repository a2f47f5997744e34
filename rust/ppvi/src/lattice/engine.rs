//! Four sectors, their halos, and a pass over all of them.

use rayon::prelude::*;

use crate::lattice::field::Field;
use crate::lattice::halo::Halo;
use crate::lattice::kernel::Numbers;
use crate::lattice::real::Real;
use crate::lattice::sector::{Arc, Direction, Sector};
use crate::lattice::{LatticeMdp, Transition};

/// The state of an iteration; with a policy its passes evaluate that, without they take the better action.
pub(crate) struct Engine<T: Copy> {
    sectors: Vec<Sector<T>>,
    halos: Vec<Halo<T>>,
    noise: Vec<T>,
    numbers: Numbers<T>,
    headings: usize,
    interpolated: bool,
    /// No pass was made and nothing loaded yet: sectors and halos hold the start.
    fresh: bool,
}

impl<T: Real> Engine<T> {
    pub(crate) fn new(lattice: &LatticeMdp, numbers: &Numbers<f64>, start: f64, policy: Option<&Field<u8>>) -> Self {
        let numbers = numbers.cast::<T>();
        let headings = lattice.shape.headings;
        let sectors: Vec<Sector<T>> = arcs(lattice)
            .into_par_iter()
            .map(|arc| Sector::new(lattice, arc, &numbers, T::of(start), policy))
            .collect();
        let reach = lattice.setup.noise.len();
        let halos = sectors.iter().map(|sector| Halo::new(sector, reach, T::of(start), numbers.outside())).collect();
        let noise = lattice.setup.noise.iter().map(|p| T::of(*p)).collect();
        let interpolated = lattice.setup.transition == Transition::Interpolated;
        Engine { sectors, halos, noise, numbers, headings, interpolated, fresh: true }
    }

    /// Number of sectors.
    pub(crate) fn sectors(&self) -> usize {
        self.sectors.len()
    }

    /// Replaces all values.
    pub(crate) fn load<S: Real>(&mut self, field: &Field<S>) {
        self.sectors.par_iter_mut().for_each(|sector| sector.load(field));
        self.refresh();
    }

    /// Gives infinite values to the states marked in a field; they are left alone from then on.
    pub(crate) fn exclude(&mut self, endless: &Field<u8>) {
        self.sectors.par_iter_mut().for_each(|sector| sector.exclude(endless));
        self.refresh();
    }

    /// Pulls all halos and recomputes all convolved values.
    fn refresh(&mut self) {
        self.fresh = false;
        let Engine { sectors, halos, noise, headings, .. } = self;
        halos.par_iter_mut().enumerate().for_each(|(of, halo)| halo.pull(sectors, of, *headings));
        sectors.par_iter_mut().zip(halos).for_each(|(sector, halo)| sector.convolve_all(halo, noise));
    }

    /// Backs up every state once; returns the largest change.
    ///
    /// Two waves: right and left, then up and down. The sectors of a wave read only themselves and their halos.
    pub(crate) fn pass(&mut self) -> f64 {
        let Engine { sectors, halos, noise, numbers, headings, interpolated, fresh } = self;
        let mut change = 0f64;
        for vertical in [false, true] {
            let in_wave = |sector: &Sector<T>| sector.arc.direction.is_vertical() == vertical;
            if !*fresh || vertical {
                let wave = halos.par_iter_mut().enumerate().filter(|(of, _)| in_wave(&sectors[*of]));
                wave.for_each(|(of, halo)| halo.pull(sectors, of, *headings));
            }
            let wave = sectors.par_iter_mut().zip(&*halos).filter(|(sector, _)| in_wave(sector));
            let changes = wave.map(|(sector, halo)| sector.sweep(halo, noise, numbers, *interpolated));
            change = change.max(changes.reduce(|| 0.0, f64::max));
        }
        *fresh = false;
        change
    }

    /// All values.
    pub(crate) fn field(&self, lattice: &LatticeMdp) -> Field<T> {
        let mut field = Field::new(lattice.shape);
        self.sectors.iter().for_each(|sector| sector.export(&mut field));
        field
    }
}

/// The headings of each direction: they are consecutive on the circle. Directions without a heading are left out.
fn arcs(lattice: &LatticeMdp) -> Vec<Arc> {
    let needle = &lattice.setup.needle;
    let n = needle.headings;
    let directions: Vec<Direction> = (0..n).map(|k| Direction::of(needle.heading(k), lattice.setup.spacing)).collect();
    let arc = |direction: Direction| {
        let count = directions.iter().filter(|d| **d == direction).count();
        let begins = |k: &usize| directions[*k] == direction && directions[(k + n - 1) % n] != direction;
        (count > 0).then(|| Arc { direction, first: (0..n).find(begins).unwrap_or(0), count })
    };
    Direction::ALL.into_iter().filter_map(arc).collect()
}
