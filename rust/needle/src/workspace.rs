//! The workspace: a rectangle `[0, width] x [0, height]`, obstacles and a round target, all closed as [`Area`] says.

use ppvi::lattice::outcome;
use ppvi::{Error, Result};

use crate::arc::Arc;
use crate::area::{Area, CLOSED_MM};

/// An event that ends an execution. The codes are those of [`ppvi::lattice::outcome`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Event {
    /// Within the target's radius.
    Target = outcome::TARGET,
    /// Inside or on an obstacle.
    Collision = outcome::COLLISION,
    /// Outside the closed rectangle.
    Exit = outcome::EXIT,
}

/// The rectangle, the obstacles, the target.
#[derive(Debug, Clone, PartialEq)]
pub struct Workspace {
    /// Extent along x and y, mm.
    pub size: [f64; 2],
    /// Obstacles.
    pub obstacles: Vec<Area>,
    /// Centre of the target, mm.
    pub target: [f64; 2],
    /// Radius of the target, mm.
    pub target_radius: f64,
}

impl Workspace {
    /// Makes a workspace: size along x and y, obstacles, centre and radius of the target, all in mm.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a size or radius that is not positive and finite, or a centre that is not finite.
    pub fn new(size: [f64; 2], obstacles: Vec<Area>, target: [f64; 2], target_radius: f64) -> Result<Self> {
        let lengths = [("width_mm", size[0]), ("height_mm", size[1]), ("target_radius_mm", target_radius)];
        for (name, value) in lengths {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::parameter(name, value, "must be positive and finite"));
            }
        }
        if !target.iter().all(|c| c.is_finite()) {
            return Err(Error::parameter("target_center_mm", format!("{target:?}"), "must be finite"));
        }
        Ok(Workspace { size, obstacles, target, target_radius })
    }

    /// The workspace with another extent along x and y, mm.
    pub(crate) fn resized(&self, size: [f64; 2]) -> Self {
        Workspace { size, ..self.clone() }
    }

    /// The event at a point, if any. Exit takes precedence over collision, and collision over target.
    pub fn event(&self, point: [f64; 2]) -> Option<Event> {
        let outside = |axis: usize| !(point[axis] >= -CLOSED_MM && point[axis] <= self.size[axis] + CLOSED_MM);
        if outside(0) || outside(1) {
            Some(Event::Exit)
        } else if self.is_blocked(point) {
            Some(Event::Collision)
        } else {
            let distance = (point[0] - self.target[0]).hypot(point[1] - self.target[1]);
            (distance <= self.target_radius + CLOSED_MM).then_some(Event::Target)
        }
    }
}

impl Workspace {
    /// The first event on an arc that starts at a point without event, and the arc length, mm, at which it happens.
    ///
    /// The whole arc is tested, not only points of it. The events are those of [`Workspace::event`], to within the
    /// rounding of the coordinates.
    #[inline]
    pub fn first_event(&self, arc: &Arc) -> Option<(Event, f64)> {
        arc.pieces().find_map(|(from, piece)| {
            let (event, s) = self.first_event_of_piece(&piece)?;
            Some((event, from + s))
        })
    }

    /// Arc length, mm, at which an arc first touches an obstacle.
    pub(crate) fn first_collision(&self, arc: &Arc) -> Option<f64> {
        arc.pieces().find_map(|(from, piece)| {
            let (bounds, path) = (piece.bounds(), piece.path());
            let near = self.obstacles.iter().filter(|area| area.is_near(bounds));
            let first = near.filter_map(|area| area.first_contact(&path, bounds)).min_by(f64::total_cmp)?;
            Some(from + path.length_at(first))
        })
    }

    /// Whether a point is in an obstacle.
    pub(crate) fn is_blocked(&self, point: [f64; 2]) -> bool {
        self.obstacles.iter().any(|area| area.contains(point))
    }

    fn first_event_of_piece(&self, arc: &Arc) -> Option<(Event, f64)> {
        let bounds @ [low, high] = arc.bounds();
        let [width, height] = self.size;
        let leaves =
            low[0] < -CLOSED_MM || low[1] < -CLOSED_MM || high[0] > width + CLOSED_MM || high[1] > height + CLOSED_MM;
        let reach = self.target_radius + CLOSED_MM;
        let at_target = (0..2).all(|a| low[a] <= self.target[a] + reach && high[a] >= self.target[a] - reach);
        let mut near = self.obstacles.iter().filter(|area| area.is_near(bounds)).peekable();
        if !leaves && !at_target && near.peek().is_none() {
            return None;
        }
        let path = arc.path();
        let mut first: Option<(Event, f64)> = None;
        let mut take = |event: Event, met: Option<f64>| {
            if let Some(u) = met.filter(|u| first.is_none_or(|(_, least)| *u < least)) {
                first = Some((event, u));
            }
        };
        if leaves {
            for (normal, offset) in [([-1.0, 0.0], 0.0), ([0.0, -1.0], 0.0), ([1.0, 0.0], width), ([0.0, 1.0], height)]
            {
                take(Event::Exit, path.enters_half_plane(normal, offset + CLOSED_MM));
            }
        }
        for area in near {
            take(Event::Collision, area.first_contact(&path, bounds));
        }
        if at_target {
            take(Event::Target, path.enters_disc(self.target, reach));
        }
        first.map(|(event, u)| (event, path.length_at(u)))
    }
}

/// Finds the events of equally spaced points along y at one x. The section of a polygon is computed once for all points
/// of a column, so a million arcs are classified in milliseconds.
pub(crate) struct ColumnScan<'a> {
    workspace: &'a Workspace,
    crossings: Vec<f64>,
    intervals: Vec<[f64; 2]>,
}

impl<'a> ColumnScan<'a> {
    pub(crate) fn new(workspace: &'a Workspace) -> Self {
        ColumnScan { workspace, crossings: Vec::new(), intervals: Vec::new() }
    }

    /// Writes the events at the points `(x, y0 + j * spacing)` to `codes[j]`, where no earlier event is (code 0).
    pub(crate) fn mark(&mut self, x: f64, y0: f64, spacing: f64, codes: &mut [u8]) {
        let [width, height] = self.workspace.size;
        if !(x >= -CLOSED_MM && x <= width + CLOSED_MM) {
            fill(codes, 0..codes.len(), Event::Exit);
            return;
        }
        let inside = span([-CLOSED_MM, height + CLOSED_MM], y0, spacing, codes.len());
        fill(codes, 0..inside.start, Event::Exit);
        fill(codes, inside.end..codes.len(), Event::Exit);
        self.intervals.clear();
        for area in &self.workspace.obstacles {
            area.section(0, x, &mut self.crossings, &mut self.intervals);
        }
        for &interval in &self.intervals {
            fill(codes, span(interval, y0, spacing, codes.len()), Event::Collision);
        }
        let radius = self.workspace.target_radius + CLOSED_MM;
        let across = x - self.workspace.target[0];
        if across.abs() <= radius {
            let half = (radius * radius - across * across).sqrt();
            let chord = [self.workspace.target[1] - half, self.workspace.target[1] + half];
            fill(codes, span(chord, y0, spacing, codes.len()), Event::Target);
        }
    }
}

/// Indices j with `interval[0] <= y0 + j * spacing <= interval[1]`.
pub(crate) fn span(interval: [f64; 2], y0: f64, spacing: f64, count: usize) -> std::ops::Range<usize> {
    let first = ((interval[0] - y0) / spacing).ceil().clamp(0.0, count as f64) as usize;
    let last = ((interval[1] - y0) / spacing).floor().clamp(-1.0, count as f64 - 1.0);
    let end = (last + 1.0) as usize;
    first..end.max(first)
}

/// Writes an event to the points of a range that have none (code 0).
pub(crate) fn fill(codes: &mut [u8], range: std::ops::Range<usize>, event: Event) {
    for code in &mut codes[range] {
        *code = if *code == 0 { event as u8 } else { *code };
    }
}

/// Number of grid points 0, spacing, 2 spacing ... that cover an extent: the smallest number whose last point is at or
/// beyond the end, to within [`CLOSED_MM`]. If the extent is no multiple of the spacing, the last point lies beyond it.
///
/// # Errors
/// [`Error::TooLarge`] for 2^32 points or more.
pub fn grid_points(extent: f64, spacing: f64) -> Result<usize> {
    let cells = extent / spacing;
    let whole = cells.round();
    // A quotient is rounded to one part in 2^53; without the second term large multiples would get one point too many.
    let rounding = (CLOSED_MM / spacing).max(1e-12 * whole);
    let count = if (cells - whole).abs() <= rounding { whole } else { cells.ceil() } + 1.0;
    if count.is_finite() && count < f64::from(u32::MAX) {
        Ok(count as usize)
    } else {
        Err(Error::TooLarge { states: count as u128, needed_bytes: count as u128, rule: "too many grid points" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn workspace() -> Workspace {
        let u_shape =
            vec![[2.0, 1.0], [6.0, 1.0], [6.0, 5.0], [5.0, 5.0], [5.0, 2.0], [3.0, 2.0], [3.0, 5.0], [2.0, 5.0]];
        Workspace::new([10.0, 6.0], vec![Area::polygon(u_shape).unwrap()], [8.0, 3.0], 1.0).unwrap()
    }

    #[test]
    fn points_on_edges_corners_and_the_border_are_inside() {
        let w = workspace();
        for (point, event) in [
            ([2.0, 1.0], Some(Event::Collision)),
            ([4.0, 2.0], Some(Event::Collision)),
            ([4.0, 2.1], None),
            ([3.0, 4.0], Some(Event::Collision)),
            ([7.0, 3.0], Some(Event::Target)),
            ([10.0, 6.0], None),
            ([10.1, 3.0], Some(Event::Exit)),
            ([f64::NAN, 3.0], Some(Event::Exit)),
        ] {
            assert_eq!(w.event(point), event, "{point:?}");
        }
    }

    #[test]
    fn grid_points_cover_the_extent() {
        for (extent, spacing, points) in [
            (120.0, 1.0, 121),
            (60.5, 1.0, 62),
            (60.2, 1.0, 62),
            (0.3, 0.1, 4),
            (4.5, 0.15, 31),
            (100.0, 0.5 / 3.0, 601),
            (1e6, 0.1, 10_000_001),
            (1.0, 1.0 + 1e-8, 2),
        ] {
            assert_eq!(grid_points(extent, spacing).unwrap(), points, "{extent} {spacing}");
        }
        assert!(grid_points(1e6, 1e-9).is_err() && grid_points(1.0, f64::NAN).is_err());
    }

    #[test]
    fn corners_on_the_grid_are_inside_however_sharp() {
        for corners in [
            [[2.0, 2.0], [4.0, 3.0], [3.0, 5.0]],
            [[2.5, 4.25], [5.0, 4.5], [4.0, 2.0]],
            [[0.75, 4.0], [0.5, 4.0], [0.0, 3.0]],
        ] {
            let w =
                Workspace::new([6.0, 6.0], vec![Area::polygon(corners.to_vec()).unwrap()], [5.5, 0.5], 0.2).unwrap();
            let mut scan = ColumnScan::new(&w);
            for corner in corners {
                let mut codes = vec![0; 25];
                scan.mark(corner[0], 0.0, 0.25, &mut codes);
                assert_eq!(codes[(corner[1] * 4.0) as usize], Event::Collision as u8, "{corner:?}");
                assert_eq!(w.event(corner), Some(Event::Collision));
            }
        }
    }

    #[test]
    fn a_column_scan_says_what_the_point_test_says() {
        let w = workspace();
        let mut scan = ColumnScan::new(&w);
        for step in 0..=125 {
            let x = f64::from(step) * 0.1 - 1.0;
            let mut codes = vec![0; 81];
            scan.mark(x, -1.0, 0.1, &mut codes);
            for (j, &code) in codes.iter().enumerate() {
                let point = [x, -1.0 + j as f64 * 0.1];
                assert_eq!(code, w.event(point).map_or(0, |e| e as u8), "{point:?}");
            }
        }
    }
}
