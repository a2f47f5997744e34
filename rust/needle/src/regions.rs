//! How a step moves the tip: in grid cells, and by region of equal curvature.

use crate::bicycle::Bicycle;
use crate::error::{Result, parameter};
use crate::lattice::{Setup, Shape, Transition};

/// A displacement in grid cells: whole cells, and the fraction of a cell beyond them (zero for nearest transitions).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shift {
    /// Whole cells along x and y.
    pub cell: [i32; 2],
    /// Fractions in [0, 1).
    pub fraction: [f64; 2],
}

impl Shift {
    pub(crate) fn new(displacement: [f64; 2], spacing: [f64; 2], transition: Transition, points: [usize; 2]) -> Self {
        let mut shift = Shift { cell: [0; 2], fraction: [0.0; 2] };
        for axis in 0..2 {
            let cells = displacement[axis] / spacing[axis];
            let whole = match transition {
                Transition::Nearest => nearest_cell(cells),
                // A fraction that is zero but for rounding must not ask for the point one cell further.
                Transition::Interpolated if (cells - cells.round()).abs() < 1e-9 => cells.round(),
                Transition::Interpolated => cells.floor(),
            };
            // Anything beyond the grid is as far as anything else there.
            let beyond = points[axis] as f64 + 1.0;
            shift.cell[axis] = whole.clamp(-beyond, beyond) as i32;
            if transition == Transition::Interpolated {
                shift.fraction[axis] = (cells - whole).max(0.0);
                if shift.fraction[axis] < 1e-9 {
                    shift.fraction[axis] = 0.0;
                }
            }
        }
        shift
    }
}

/// The nearest whole number; halves, to within rounding, away from zero, so that mirrored steps land on mirrored points.
fn nearest_cell(cells: f64) -> f64 {
    (cells.abs() + 0.5 + 1e-9).floor().copysign(cells)
}

/// Grid points at which the needle bends with one radius.
#[derive(Debug, Clone)]
pub(crate) struct Region {
    pub needle: Bicycle,
    /// Cost of a step.
    pub step: f64,
    /// `[heading][arriving bevel]`.
    pub stencil: Vec<[Shift; 2]>,
    /// Displacements of the points of each arc that are tested, mm.
    pub arcs: Vec<[Vec<[f64; 2]>; 2]>,
}

impl Region {
    fn new(needle: Bicycle, setup: &Setup, shape: Shape) -> Self {
        let shift = |k: usize, bevel: f64| {
            let displacement = needle.displacement(needle.heading(k), bevel, 1.0);
            Shift::new(displacement, setup.spacing, setup.transition, [shape.nx, shape.ny])
        };
        let stencil = (0..shape.headings).map(|k| [-1.0, 1.0].map(|bevel| shift(k, bevel))).collect();
        let sample = |k: usize, bevel: f64, sample: usize| {
            needle.displacement(needle.heading(k), bevel, sample as f64 / setup.arc_samples as f64)
        };
        let arc = |k: usize, bevel: f64| (1..=setup.arc_samples).map(|number| sample(k, bevel, number)).collect();
        let arcs = (0..shape.headings).map(|k| [-1.0, 1.0].map(|bevel| arc(k, bevel))).collect();
        Region { needle, arcs, step: setup.costs.step * (needle.radius / setup.needle.radius), stencil }
    }
}

/// The regions, and which of them each grid point is in; nothing for a single one.
pub(crate) fn regions(setup: &Setup, shape: Shape) -> Result<(Vec<Region>, Vec<u8>)> {
    if setup.tissues.is_uniform() {
        return Ok((vec![Region::new(setup.needle, setup, shape)], Vec::new()));
    }
    let mut regions: Vec<Region> = Vec::new();
    let mut region_of = Vec::with_capacity(shape.nx * shape.ny);
    for (i, j) in (0..shape.nx).flat_map(|i| (0..shape.ny).map(move |j| (i, j))) {
        let place = [i as f64 * setup.spacing[0], j as f64 * setup.spacing[1]];
        let needle = setup.tissues.needle_at(setup.needle, place);
        let known = regions.iter().position(|region| region.needle.radius == needle.radius);
        let number = known.unwrap_or_else(|| {
            regions.push(Region::new(needle, setup, shape));
            regions.len() - 1
        });
        if number > usize::from(u8::MAX) {
            return Err(parameter("curvature_radius_mm", "more than 256 radii", "must be at most 256 different ones"));
        }
        region_of.push(number as u8);
    }
    Ok((regions, region_of))
}
