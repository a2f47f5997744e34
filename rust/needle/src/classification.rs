//! The outcome of every step: it continues, or it ends at the target, in an obstacle or outside the workspace.

use ppvi::StopFlag;
use ppvi::lattice::{Shape, Shift, Transition, outcome};

use crate::regions::TissueRegions;
use crate::setup::Setup;
use crate::workspace::{ColumnScan, Event, fill};

/// Writes the outcome codes of a setup, one heading and bevel at a time.
pub(crate) struct Classifier<'a> {
    setup: &'a Setup,
    shape: Shape,
    regions: &'a TissueRegions,
    /// Event at each grid point, or 0, `[i][j]`.
    points: Vec<u8>,
    /// Outcome code of each grid point that is absorbing, otherwise 0, `[i][j]`.
    absorbing: Vec<u8>,
    stop: StopFlag,
}

impl<'a> Classifier<'a> {
    pub(crate) fn new(setup: &'a Setup, shape: Shape, regions: &'a TissueRegions) -> Self {
        let points = classify_points(shape, setup);
        let absorbing = points.iter().map(|code| match *code {
            outcome::TARGET => outcome::AT_TARGET,
            outcome::COLLISION => outcome::AT_OBSTACLE,
            _ => 0,
        });
        let absorbing = absorbing.collect();
        Classifier { setup, shape, regions, points, absorbing, stop: StopFlag::current() }
    }

    /// Writes the codes of the steps with heading index `k` that arrive with bevel index `bevel` to
    /// `plane[i * ny + j]`.
    pub(crate) fn write_outcomes(&self, k: usize, bevel: usize, plane: &mut [u8]) {
        let ny = self.shape.ny;
        let mut scan = ColumnScan::new(&self.setup.workspace);
        let mut column = vec![0u8; ny];
        for (i, codes) in plane.chunks_exact_mut(ny).enumerate() {
            self.stop.check();
            if self.regions.region_of.is_empty() {
                self.mark_column(&mut scan, 0, (i, k, bevel), codes);
            } else {
                let here = &self.regions.region_of[i * ny..][..ny];
                for region in 0..self.regions.steps.len() {
                    if !here.contains(&(region as u8)) {
                        continue;
                    }
                    self.mark_column(&mut scan, region, (i, k, bevel), &mut column);
                    let pairs = codes.iter_mut().zip(&column).zip(here);
                    let mine = pairs.filter(|(_, number)| usize::from(**number) == region);
                    mine.for_each(|((code, marked), _)| *code = *marked);
                }
            }
            for (code, absorbing) in codes.iter_mut().zip(&self.absorbing[i * ny..]) {
                *code = if *absorbing != 0 { *absorbing } else { *code };
            }
        }
    }

    /// Writes the outcomes of the steps from grid column `i` as if the whole column were of one region.
    fn mark_column(
        &self,
        scan: &mut ColumnScan<'_>,
        region: usize,
        (i, k, bevel): (usize, usize, usize),
        codes: &mut [u8],
    ) {
        let Setup { spacing, transition, .. } = self.setup;
        codes.fill(outcome::CONTINUES);
        for [dx, dy] in &self.regions.arcs[region][k][bevel] {
            scan.mark(i as f64 * spacing[0] + dx, *dy, spacing[1], codes);
        }
        if *transition == Transition::Nearest {
            self.mark_landings(i, self.regions.steps[region].stencil[k][bevel], codes);
        }
    }

    /// For nearest transitions: gives the steps that still continue the event at the grid point where they land.
    fn mark_landings(&self, i: usize, shift: Shift, column: &mut [u8]) {
        let Shape { nx, ny, .. } = self.shape;
        let to_i = i as i64 + i64::from(shift.cell[0]);
        let move_j = i64::from(shift.cell[1]);
        let on = (0..nx as i64).contains(&to_i);
        let low = if on { (-move_j).clamp(0, ny as i64) as usize } else { ny };
        let high = if on { (ny as i64 - move_j).clamp(low as i64, ny as i64) as usize } else { ny };
        if low < high {
            let landing = &self.points[to_i as usize * ny + (low as i64 + move_j) as usize..][..high - low];
            for (code, landing) in column[low..high].iter_mut().zip(landing) {
                *code = if *code == outcome::CONTINUES { *landing } else { *code };
            }
        }
        fill(column, 0..low, Event::Exit);
        fill(column, high..ny, Event::Exit);
    }
}

/// The event at each grid point, or 0. Where an extent is not a multiple of the spacing, the last grid points lie
/// outside the workspace; they are ordinary points, so their exit is not an event.
fn classify_points(shape: Shape, setup: &Setup) -> Vec<u8> {
    let mut points = vec![0u8; shape.nx * shape.ny];
    let mut scan = ColumnScan::new(&setup.workspace);
    for (i, column) in points.chunks_exact_mut(shape.ny).enumerate() {
        scan.mark(i as f64 * setup.spacing[0], 0.0, setup.spacing[1], column);
        column.iter_mut().for_each(|code| *code = if *code == outcome::EXIT { 0 } else { *code });
    }
    points
}
