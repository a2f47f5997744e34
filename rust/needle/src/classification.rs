//! What every step does: goes on, or ends at the target, in an obstacle, outside.

use rayon::prelude::*;

use crate::lattice::plane::{Plane, copy};
use crate::lattice::region::Region;
use crate::lattice::{LatticeMdp, Setup, Shape, Shift, Transition, outcome};
use crate::memory::filled;
use crate::workspace::{ColumnScan, Event, fill};

impl LatticeMdp {
    /// Outcome codes, laid out as `LatticeMdp::outcomes` says.
    pub(super) fn classify(&self) -> Vec<u8> {
        let Shape { nx, ny, headings } = self.shape;
        let points = classify_points(self.shape, &self.setup);
        let absorbing = points.iter().map(|code| match *code {
            outcome::TARGET => outcome::AT_TARGET,
            outcome::COLLISION => outcome::AT_OBSTACLE,
            _ => 0,
        });
        let absorbing: Vec<u8> = absorbing.collect();
        let mut outcomes = filled(0u8, headings * 2 * nx * ny);
        outcomes.par_chunks_mut(nx * ny).enumerate().for_each_init(
            || (ColumnScan::new(&self.setup.workspace), vec![0u8; nx * ny], vec![0u8; ny]),
            |(scan, plane, column), (row, to)| {
                let (k, bevel) = (row / 2, row % 2);
                for (i, codes) in plane.chunks_exact_mut(ny).enumerate() {
                    if self.region_of.is_empty() {
                        self.mark_column(scan, &self.regions[0], (i, k, bevel), &points, codes);
                    } else {
                        let here = &self.region_of[i * ny..][..ny];
                        for (number, region) in self.regions.iter().enumerate() {
                            if !here.contains(&(number as u8)) {
                                continue;
                            }
                            self.mark_column(scan, region, (i, k, bevel), &points, column);
                            let pairs = codes.iter_mut().zip(&*column).zip(here);
                            let mine = pairs.filter(|(_, region)| usize::from(**region) == number);
                            mine.for_each(|((code, marked), _)| *code = *marked);
                        }
                    }
                    for (code, absorbing) in codes.iter_mut().zip(&absorbing[i * ny..]) {
                        *code = if *absorbing != 0 { *absorbing } else { *code };
                    }
                }
                let vertical = self.directions[k].is_vertical();
                let from = Plane { start: 0, stride: ny };
                let into = Plane { start: 0, stride: if vertical { nx } else { ny } };
                copy((plane, from), (to, into), [nx, ny], vertical, |code| code);
            },
        );
        outcomes
    }

    /// The outcomes of the steps from grid column `i`, as if it were all of one region.
    fn mark_column(
        &self,
        scan: &mut ColumnScan<'_>,
        region: &Region,
        (i, k, bevel): (usize, usize, usize),
        points: &[u8],
        codes: &mut [u8],
    ) {
        let Setup { spacing, transition, .. } = &self.setup;
        codes.fill(outcome::CONTINUES);
        for [dx, dy] in &region.arcs[k][bevel] {
            scan.mark(i as f64 * spacing[0] + dx, *dy, spacing[1], codes);
        }
        if *transition == Transition::Nearest {
            self.mark_landings(i, region.stencil[k][bevel], points, codes);
        }
    }

    /// For nearest transitions, what the point landed on does to steps that go on so far.
    fn mark_landings(&self, i: usize, shift: Shift, points: &[u8], column: &mut [u8]) {
        let Shape { nx, ny, .. } = self.shape;
        let to_i = i as i64 + i64::from(shift.cell[0]);
        let move_j = i64::from(shift.cell[1]);
        let on = (0..nx as i64).contains(&to_i);
        let low = if on { (-move_j).clamp(0, ny as i64) as usize } else { ny };
        let high = if on { (ny as i64 - move_j).clamp(low as i64, ny as i64) as usize } else { ny };
        if low < high {
            let landing = &points[to_i as usize * ny + (low as i64 + move_j) as usize..][..high - low];
            for (code, landing) in column[low..high].iter_mut().zip(landing) {
                *code = if *code == outcome::CONTINUES { *landing } else { *code };
            }
        }
        fill(column, 0..low, Event::Exit);
        fill(column, high..ny, Event::Exit);
    }
}

/// What the grid points are: 0, or the event there. A point beyond the border (where an extent is no multiple of the
/// spacing) is a point still, so its exit does not count.
fn classify_points(shape: Shape, setup: &Setup) -> Vec<u8> {
    let mut points = vec![0u8; shape.nx * shape.ny];
    let mut scan = ColumnScan::new(&setup.workspace);
    for (i, column) in points.chunks_exact_mut(shape.ny).enumerate() {
        scan.mark(i as f64 * setup.spacing[0], 0.0, setup.spacing[1], column);
        column.iter_mut().for_each(|code| *code = if *code == outcome::EXIT { 0 } else { *code });
    }
    points
}
