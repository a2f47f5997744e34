//! The grid points grouped by the curvature of the needle and the price of a step there, and the steps of each group.

use ppvi::lattice::{HeadingKernel, Region, Shape, Shift};
use ppvi::{Error, Result, StopFlag};

use crate::bicycle::Bicycle;
use crate::setup::Setup;

/// Displacements, mm, of the tested points of the arc of every step: `[heading][arriving bevel][sample]`.
pub(crate) type ArcSamples = Vec<[Vec<[f64; 2]>; 2]>;

/// The regions of equal curvature and price of a setup.
pub(crate) struct TissueRegions {
    /// Steps, by region.
    pub steps: Vec<Region>,
    /// Needles, by region.
    pub needles: Vec<Bicycle>,
    /// Tested points, by region.
    pub arcs: Vec<ArcSamples>,
    /// Region of each grid point, `[i][j]`; empty if there is only one.
    pub region_of: Vec<u8>,
}

impl TissueRegions {
    /// # Errors
    /// [`Error::Parameter`] for more than 256 pairs of a radius of curvature and a price.
    pub(crate) fn new(setup: &Setup, shape: Shape) -> Result<Self> {
        let mut regions =
            TissueRegions { steps: Vec::new(), needles: Vec::new(), arcs: Vec::new(), region_of: Vec::new() };
        if setup.tissues.is_uniform() && setup.clearance.is_free() {
            regions.push(setup.needle, setup.step_cost(setup.needle, [0.0; 2]), setup, shape)?;
            return Ok(regions);
        }
        let mut kinds: Vec<(f64, f64)> = Vec::new();
        regions.region_of.reserve(shape.nx * shape.ny);
        let stop = StopFlag::current();
        for (i, j) in (0..shape.nx).flat_map(|i| (0..shape.ny).map(move |j| (i, j))) {
            stop.check();
            let place = [i as f64 * setup.spacing[0], j as f64 * setup.spacing[1]];
            let needle = setup.tissues.needle_at(setup.needle, place);
            let kind = (needle.radius, setup.step_cost(needle, place));
            let known = kinds.iter().position(|known| *known == kind);
            let number = match known {
                Some(number) => number,
                None => {
                    kinds.push(kind);
                    regions.push(needle, kind.1, setup, shape)?;
                    kinds.len() - 1
                }
            };
            if number > usize::from(u8::MAX) {
                let rule = "must be at most 256 different ones, and 128 with a price of clearance";
                return Err(Error::parameter("curvature_radius_mm", "too many radii", rule));
            }
            regions.region_of.push(number as u8);
        }
        Ok(regions)
    }

    /// Adds the region of a needle with another radius, or of steps with another cost.
    fn push(&mut self, needle: Bicycle, step_cost: f64, setup: &Setup, shape: Shape) -> Result<()> {
        let cells = |angle: f64| angle / needle.heading_step();
        let turn =
            |side: f64| HeadingKernel::matched(side * cells(needle.turn()), &setup.noise, cells(setup.noise_step()));
        let shift = |k: usize, bevel: f64| {
            let displacement = needle.displacement(needle.heading(k), bevel, 1.0);
            Shift::new(displacement, setup.spacing, setup.transition, [shape.nx, shape.ny])
        };
        let sample = |k: usize, bevel: f64, sample: usize| {
            needle.displacement(needle.heading(k), bevel, sample as f64 / setup.arc_samples as f64)
        };
        let arc = |k: usize, bevel: f64| (1..=setup.arc_samples).map(|number| sample(k, bevel, number)).collect();
        self.needles.push(needle);
        self.arcs.push((0..shape.headings).map(|k| [-1.0, 1.0].map(|bevel| arc(k, bevel))).collect());
        self.steps.push(Region {
            step_length: needle.step_length(),
            step_cost,
            stencil: (0..shape.headings).map(|k| [-1.0, 1.0].map(|bevel| shift(k, bevel))).collect(),
            turn: [turn(-1.0)?, turn(1.0)?],
        });
        Ok(())
    }
}
