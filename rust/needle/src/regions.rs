//! The steps grouped by the curvature of the needle and their price.
//!
//! A step of the thesis turns by one heading step, and its radius, which sets its length, is that of the place where it
//! starts. A step of a given length has the mean curvature along it, since the needle changes its radius where it crosses
//! into another tissue. The way of the step is for this the mean one over the headings of its direction: all of them
//! share the turn of the region.

use ppvi::lattice::{Direction, HeadingKernel, Motion, Region, Shape, Shift};
use ppvi::{Error, Result, StopFlag};

use crate::bicycle::Bicycle;
use crate::setup::Setup;

/// Displacements, mm, of the tested points of the arc of every step: `[heading][arriving bevel][sample]`.
pub(crate) type ArcSamples = Vec<[Vec<[f64; 2]>; 2]>;

/// The steps of a motion.
#[derive(Default)]
pub(crate) struct MotionSteps {
    /// Steps, by region.
    pub steps: Vec<Region>,
    /// Needles, by region.
    pub needles: Vec<Bicycle>,
    /// Tested points, by region.
    pub arcs: Vec<ArcSamples>,
}

/// The regions of equal curvature and price of a setup.
pub(crate) struct TissueRegions {
    pub curved: MotionSteps,
    /// Empty without a straight action.
    pub straight: MotionSteps,
    /// Region of the steps from each grid point, `[direction][i][j]`; empty if there is only one.
    pub region_of: Vec<u8>,
}

impl TissueRegions {
    /// # Errors
    /// [`Error::Parameter`] for more than 256 pairs of a radius of curvature and a price.
    pub(crate) fn new(setup: &Setup, shape: Shape) -> Result<Self> {
        let (curved, straight) = Default::default();
        let mut regions = TissueRegions { curved, straight, region_of: Vec::new() };
        if setup.tissues.is_uniform() && setup.clearance.is_free() {
            regions.push(setup.needle, [0.0; 2], setup, shape)?;
            return Ok(regions);
        }
        let mut kinds: Vec<(f64, f64)> = Vec::new();
        let points = shape.nx * shape.ny;
        regions.region_of.reserve(Direction::ALL.len() * points);
        let stop = StopFlag::current();
        let ahead = Direction::ALL.map(|direction| Ahead::new(setup, direction));
        for (direction, point) in (0..Direction::ALL.len()).flat_map(|d| (0..points).map(move |point| (d, point))) {
            stop.check();
            let (i, j) = (point / shape.ny, point % shape.ny);
            let place = [i as f64 * setup.spacing[0], j as f64 * setup.spacing[1]];
            let needle = ahead[direction].needle(setup, place);
            let kind = (needle.radius, setup.step_cost(Motion::Curved, needle, place));
            let known = kinds.iter().position(|known| *known == kind);
            let number = match known {
                Some(number) => number,
                None => {
                    kinds.push(kind);
                    regions.push(needle, place, setup, shape)?;
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

    /// The steps of a motion.
    pub(crate) fn of(&self, motion: Motion) -> &MotionSteps {
        match motion {
            Motion::Curved => &self.curved,
            Motion::Straight => &self.straight,
        }
    }

    /// Adds the region of a needle with another radius, or of steps with another cost, which are those from `place`.
    fn push(&mut self, needle: Bicycle, place: [f64; 2], setup: &Setup, shape: Shape) -> Result<()> {
        self.curved.push(needle, setup.step_cost(Motion::Curved, needle, place), setup, shape)?;
        if setup.straight.is_some() {
            let cost = setup.step_cost(Motion::Straight, needle, place);
            self.straight.push(setup.moving(Motion::Straight, needle), cost, setup, shape)?;
        }
        Ok(())
    }
}

impl MotionSteps {
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

/// Points along a step at which its curvature is taken. With eight the mean is off by a sixteenth of the difference of two
/// tissues at most.
const POINTS: usize = 8;

/// Mean curvatures between those of two tissues are rounded to a multiple of this share of the difference of the largest
/// and the smallest curvature: the number of regions is limited, and each needs its own steps.
const LEVELS: f64 = 64.0;

/// The way of the steps of a direction.
struct Ahead {
    /// From the start, mm: the middles of equal pieces of the step. Empty for the start itself.
    points: Vec<[f64; 2]>,
    /// Smallest curvature, and what mean curvatures are rounded to, 1/mm.
    lowest: f64,
    level: f64,
}

impl Ahead {
    fn new(setup: &Setup, direction: Direction) -> Self {
        let needle = setup.needle;
        let directions = Direction::of_headings(needle.headings, setup.spacing);
        let headings: Vec<f64> =
            (0..needle.headings).filter(|k| directions[*k] == direction).map(|k| needle.heading(k)).collect();
        let mean = |along: fn(f64) -> f64| headings.iter().map(|h| along(*h)).sum::<f64>() / headings.len() as f64;
        let [dx, dy] = [mean(f64::cos), mean(f64::sin)];
        let way = |piece: usize| needle.step_length() * (piece as f64 + 0.5) / POINTS as f64;
        let of_its_own = needle.step.is_some() && !headings.is_empty();
        let points =
            if of_its_own { (0..POINTS).map(|piece| [way(piece) * dx, way(piece) * dy]).collect() } else { Vec::new() };
        let curvatures = || setup.tissues.radii().chain([needle.radius]).map(f64::recip);
        let lowest = curvatures().fold(f64::INFINITY, f64::min);
        Ahead { points, lowest, level: (curvatures().fold(0.0, f64::max) - lowest) / LEVELS }
    }

    /// The needle with the mean curvature of a step from `place`, mm.
    fn needle(&self, setup: &Setup, place: [f64; 2]) -> Bicycle {
        let at = |[dx, dy]: [f64; 2]| setup.tissues.needle_at(setup.needle, [place[0] + dx, place[1] + dy]);
        let Some(first) = self.points.first() else { return at([0.0; 2]) };
        let first = at(*first);
        let radii = || self.points.iter().map(|point| at(*point).radius);
        if radii().all(|radius| radius == first.radius) {
            return first;
        }
        let mean = radii().map(f64::recip).sum::<f64>() / POINTS as f64;
        let rounded = self.lowest + ((mean - self.lowest) / self.level).round() * self.level;
        Bicycle { radius: rounded.recip(), ..first }
    }
}

#[cfg(test)]
mod tests {
    use ppvi::lattice::{Costs, Transition};

    use super::*;
    use crate::clearance::Clearance;
    use crate::tissues::Tissues;
    use crate::workspace::Workspace;

    #[test]
    fn a_step_across_a_border_turns_by_its_mean_curvature() {
        let needle = Bicycle::new(40.0, 360).unwrap().with_step(4.0).unwrap();
        let setup = Setup {
            workspace: Workspace::new([30.0, 20.0], Vec::new(), [25.0, 10.0], 2.0).unwrap(),
            needle,
            spacing: [1.0; 2],
            noise: vec![1.0],
            noise_step: None,
            arc_samples: 0,
            transition: Transition::Interpolated,
            costs: Costs { step: 4.0, rotation: 1.0, collision: 100.0, exit: 100.0, discount: 1.0 },
            tissues: Tissues::new(vec![(12.0, 20.0)], vec![]).unwrap(),
            clearance: Clearance::default(),
            straight: None,
        };
        let shape = setup.shape().unwrap();
        let regions = TissueRegions::new(&setup, shape).unwrap();
        let curvature = |direction: Direction, i: usize| {
            let region = regions.region_of[(direction as usize * shape.nx + i) * shape.ny + 5];
            regions.curved.needles[usize::from(region)].radius.recip()
        };
        // Steps to the right go 3.6 mm along x on average, those up or down none; the border itself is left out.
        for i in (0..30).filter(|i| *i != 12) {
            let share = ((i as f64 + 3.6 - 12.0) / 3.6).clamp(0.0, 1.0);
            assert!((curvature(Direction::Right, i) - (1.0 + share) / 40.0).abs() < 0.08 / 40.0, "{i}");
            let up = if i >= 12 { 20.0 } else { 40.0 };
            assert_eq!(curvature(Direction::Up, i), f64::recip(up));
        }
        assert_eq!(curvature(Direction::Left, 16), f64::recip(20.0));
        assert!(curvature(Direction::Left, 13) < 0.045 && curvature(Direction::Right, 11) > 0.035);
    }
}
