//! The outcome of every step: it continues, or it ends at the target, in an obstacle or outside the workspace.

use ppvi::StopFlag;
use ppvi::lattice::{Direction, Motion, Shape, Shift, Transition, outcome};

use crate::arc_columns::{ArcScan, ArcShape, mask};
use crate::area::CLOSED_MM;
use crate::bicycle::Bicycle;
use crate::regions::{MotionSteps, TissueRegions};
use crate::setup::Setup;
use crate::workspace::{ColumnScan, Event, Workspace, fill};

/// Writes the outcome codes of a setup, one heading and bevel at a time.
pub(crate) struct Classifier<'a> {
    setup: &'a Setup,
    shape: Shape,
    regions: &'a TissueRegions,
    /// The direction of each heading.
    directions: Vec<Direction>,
    /// The workspace for steps from ordinary points and from points beyond the border, `[beyond in x][beyond in y]`.
    ///
    /// The last row and the last column of grid points lie beyond the border if the extent is no multiple of the
    /// spacing. Positions in the last cell are interpolated between these points and the last ones inside. For steps
    /// from a point beyond the border the border therefore passes through this point: it has the value of a point on
    /// the border, and not that of a point outside.
    workspaces: [[Workspace; 2]; 2],
    /// Events of whole arcs; None if points of them are tested.
    whole_arcs: Option<ArcScan>,
    /// Number of grid points inside the workspace along x and y.
    inside: [usize; 2],
    /// Event at each grid point, or 0, `[i][j]`.
    points: Vec<u8>,
    /// Outcome code of each grid point that is absorbing, otherwise 0, `[i][j]`.
    absorbing: Vec<u8>,
    stop: StopFlag,
}

/// A collision within the border, and an exit.
const FIRST_OF_BOTH: u8 = mask::COLLISION | mask::EXIT;

impl<'a> Classifier<'a> {
    pub(crate) fn new(setup: &'a Setup, shape: Shape, regions: &'a TissueRegions) -> Self {
        let size = setup.workspace.size;
        let ends = [(shape.nx - 1) as f64 * setup.spacing[0], (shape.ny - 1) as f64 * setup.spacing[1]];
        let beyond = [0, 1].map(|axis| ends[axis] > size[axis] + CLOSED_MM);
        let extent = |axis: usize, beyond: usize| if beyond == 1 { ends[axis] } else { size[axis] };
        let workspaces = [0, 1].map(|x| [0, 1].map(|y| setup.workspace.resized([extent(0, x), extent(1, y)])));
        let inside = [shape.nx - usize::from(beyond[0]), shape.ny - usize::from(beyond[1])];
        let covering = &workspaces[usize::from(beyond[0])][usize::from(beyond[1])];
        let points = classify_points(shape, setup, covering);
        let absorbing = points.iter().map(|code| match *code {
            outcome::TARGET => outcome::AT_TARGET,
            outcome::COLLISION => outcome::AT_OBSTACLE,
            _ => 0,
        });
        let absorbing = absorbing.collect();
        let stop = StopFlag::current();
        let reach = regions.curved.needles.iter().map(|needle| needle.step_length()).fold(0.0, f64::max);
        let whole_arcs = (setup.arc_samples == 0).then(|| ArcScan::new(covering, setup.spacing, shape.nx, reach));
        let directions = Direction::of_headings(shape.headings, setup.spacing);
        Classifier { setup, shape, regions, directions, workspaces, whole_arcs, inside, points, absorbing, stop }
    }

    /// Writes the codes of the steps of a motion with heading index `k` that arrive with bevel index `bevel` to
    /// `plane[i * ny + j]`.
    pub(crate) fn write_outcomes(&self, motion: Motion, k: usize, bevel: usize, plane: &mut [u8]) {
        let steps = self.regions.of(motion);
        let (ny, direction) = (self.shape.ny, self.directions[k] as usize);
        let mut scans = self.workspaces.each_ref().map(|pair| pair.each_ref().map(ColumnScan::new));
        let shape = |needle: &Bicycle| {
            let curvature = if bevel == 1 { 1.0 } else { -1.0 } / needle.radius;
            ArcShape::new(needle.heading(k), curvature, needle.step_length())
        };
        let shapes: Vec<ArcShape> = match self.whole_arcs {
            Some(_) => steps.needles.iter().map(shape).collect(),
            None => Vec::new(),
        };
        let mut column = vec![0u8; ny];
        for (i, codes) in plane.chunks_exact_mut(ny).enumerate() {
            self.stop.check();
            let scan = &mut scans[usize::from(i >= self.inside[0])];
            if self.regions.region_of.is_empty() {
                self.mark_column((scan, shapes.first()), (steps, 0), (i, k, bevel), codes);
            } else {
                let here = &self.regions.region_of[(direction * self.shape.nx + i) * ny..][..ny];
                for region in 0..steps.needles.len() {
                    if !here.contains(&(region as u8)) {
                        continue;
                    }
                    self.mark_column((scan, shapes.get(region)), (steps, region), (i, k, bevel), &mut column);
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
        ([scan, beyond], shape): (&mut [ColumnScan<'_>; 2], Option<&ArcShape>),
        (steps, region): (&MotionSteps, usize),
        (i, k, bevel): (usize, usize, usize),
        codes: &mut [u8],
    ) {
        let Setup { spacing, transition, .. } = self.setup;
        codes.fill(outcome::CONTINUES);
        if let (Some(scan), Some(shape)) = (&self.whole_arcs, shape) {
            self.mark_whole_arcs(scan, shape, i, codes);
        }
        for [dx, dy] in &steps.arcs[region][k][bevel] {
            let x = i as f64 * spacing[0] + dx;
            let (inner, last) = codes.split_at_mut(self.inside[1]);
            scan.mark(x, *dy, spacing[1], inner);
            if !last.is_empty() {
                beyond.mark(x, self.inside[1] as f64 * spacing[1] + dy, spacing[1], last);
            }
        }
        if *transition == Transition::Nearest {
            self.mark_landings(i, steps.steps[region].stencil[k][bevel], codes);
        }
    }

    /// Writes the first events of whole arcs from grid column `i`.
    fn mark_whole_arcs(&self, scan: &ArcScan, shape: &ArcShape, i: usize, codes: &mut [u8]) {
        let ([inside_x, inside_y], [_, dy]) = (self.inside, self.setup.spacing);
        let workspaces = &self.workspaces[usize::from(i >= inside_x)];
        scan.mark(shape, i, workspaces.each_ref().map(|workspace| workspace.size), inside_y, codes);
        let absorbing = &self.absorbing[i * codes.len()..][..codes.len()];
        // Without points beyond the border all boundaries lie within it; an arc that meets one has not left before,
        // unless it has left and returned.
        let covered = self.inside == [self.shape.nx, self.shape.ny];
        let collides_first = covered && shape.is_monotone();
        for (j, (code, absorbing)) in codes.iter_mut().zip(absorbing).enumerate() {
            *code = match *code {
                0 | mask::TARGET => *code,
                _ if *code & (mask::EXIT | mask::TARGET) == 0 => Event::Collision as u8,
                mask::EXIT => Event::Exit as u8,
                FIRST_OF_BOTH if collides_first => Event::Collision as u8,
                _ if *absorbing != 0 => 0,
                // More than one kind of event: the order decides.
                _ => {
                    let arc = shape.from([i as f64 * self.setup.spacing[0], j as f64 * dy]);
                    let first = workspaces[usize::from(j >= inside_y)].first_event(&arc);
                    first.map_or(0, |(event, _)| event as u8)
                }
            };
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

/// The event at each grid point, or 0. `workspace` contains all grid points.
fn classify_points(shape: Shape, setup: &Setup, workspace: &Workspace) -> Vec<u8> {
    let mut points = vec![0u8; shape.nx * shape.ny];
    let mut scan = ColumnScan::new(workspace);
    for (i, column) in points.chunks_exact_mut(shape.ny).enumerate() {
        scan.mark(i as f64 * setup.spacing[0], 0.0, setup.spacing[1], column);
        // Rounding can put the last point beyond the border by more than the tolerance of a large workspace.
        column.iter_mut().for_each(|code| *code = if *code == outcome::EXIT { 0 } else { *code });
    }
    points
}
