//! The workspace: a rectangle `[0, width] x [0, height]`, polygonal obstacles and a round target.
//!
//! All sets are closed: a point on an edge, or within [`CLOSED_MM`] of it, is inside. This tolerance is far below the
//! accuracy of a needle and far above the rounding of coordinates of a few hundred millimetres.

use ppvi::lattice::outcome;
use ppvi::{Error, Result};

/// Tolerance of the closed tests, in mm.
pub const CLOSED_MM: f64 = 1e-9;

/// A simple polygon, convex or not. The first vertex is not repeated at the end.
#[derive(Debug, Clone, PartialEq)]
pub struct Polygon {
    /// Every vertex with the next one.
    edges: Vec<[[f64; 2]; 2]>,
    low: [f64; 2],
    high: [f64; 2],
}

impl Polygon {
    /// Makes a polygon from its vertices, mm. The caller checks that the polygon is simple; for one that intersects
    /// itself the even-odd rule applies.
    ///
    /// # Errors
    /// [`Error::Parameter`] for fewer than three vertices, or a coordinate that is not finite.
    pub fn new(vertices: Vec<[f64; 2]>) -> Result<Self> {
        if vertices.len() < 3 {
            return Err(Error::parameter(
                "polygon",
                format!("{} points", vertices.len()),
                "must have at least three points",
            ));
        }
        if let Some(point) = vertices.iter().find(|point| !point.iter().all(|c| c.is_finite())) {
            return Err(Error::parameter("polygon", format!("{point:?}"), "must have finite coordinates"));
        }
        let fold =
            |axis: usize, pick: fn(f64, f64) -> f64| vertices.iter().map(|p| p[axis]).reduce(pick).unwrap_or(0.0);
        let low = [fold(0, f64::min), fold(1, f64::min)];
        let high = [fold(0, f64::max), fold(1, f64::max)];
        let next = vertices.iter().cycle().skip(1);
        let edges = vertices.iter().zip(next).map(|(&a, &b)| [a, b]).collect();
        Ok(Polygon { edges, low, high })
    }

    /// Appends the closed intervals in which the line "coordinate `axis` = `at`" intersects the polygon.
    ///
    /// The section of a closed polygon is the union of its limits from both sides. If a vertex is within the tolerance
    /// of the line, both limits are appended, and also the vertex itself, because next to a steep edge it may lie
    /// between the two.
    fn section(&self, axis: usize, at: f64, crossings: &mut Vec<f64>, intervals: &mut Vec<[f64; 2]>) {
        if at < self.low[axis] - CLOSED_MM || at > self.high[axis] + CLOSED_MM {
            return;
        }
        let at_vertex = self.edges.iter().any(|[v, _]| (v[axis] - at).abs() <= 2.0 * CLOSED_MM);
        let sides: &[f64] = if at_vertex { &[-CLOSED_MM, 0.0, CLOSED_MM] } else { &[0.0] };
        for side in sides {
            let line = at + side;
            crossings.clear();
            for [a, b] in &self.edges {
                if (a[axis] <= line) != (b[axis] <= line) {
                    let t = (line - a[axis]) / (b[axis] - a[axis]);
                    crossings.push(a[1 - axis] + t * (b[1 - axis] - a[1 - axis]));
                }
            }
            crossings.sort_unstable_by(f64::total_cmp);
            intervals.extend(crossings.chunks_exact(2).map(|c| [c[0] - CLOSED_MM, c[1] + CLOSED_MM]));
        }
        if at_vertex {
            let vertices = self.edges.iter().map(|[vertex, _]| vertex);
            let here = vertices.filter(|vertex| (vertex[axis] - at).abs() <= CLOSED_MM);
            intervals.extend(here.map(|vertex| [vertex[1 - axis] - CLOSED_MM, vertex[1 - axis] + CLOSED_MM]));
        }
    }

    /// Whether the point is inside or on the polygon.
    pub fn contains(&self, point: [f64; 2]) -> bool {
        let outside =
            |axis: usize| point[axis] < self.low[axis] - CLOSED_MM || point[axis] > self.high[axis] + CLOSED_MM;
        if outside(0) || outside(1) {
            return false;
        }
        let mut inside = false;
        for [a, b] in &self.edges {
            if distance_to_segment(point, *a, *b) <= CLOSED_MM {
                return true;
            }
            if (a[0] <= point[0]) != (b[0] <= point[0]) {
                let crossing = a[1] + (point[0] - a[0]) / (b[0] - a[0]) * (b[1] - a[1]);
                inside ^= crossing > point[1];
            }
        }
        inside
    }
}

fn distance_to_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length2 = dx * dx + dy * dy;
    let t = if length2 > 0.0 { (((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (p[0] - a[0] - t * dx).hypot(p[1] - a[1] - t * dy)
}

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
    pub obstacles: Vec<Polygon>,
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
    pub fn new(size: [f64; 2], obstacles: Vec<Polygon>, target: [f64; 2], target_radius: f64) -> Result<Self> {
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
        } else if self.obstacles.iter().any(|polygon| polygon.contains(point)) {
            Some(Event::Collision)
        } else {
            let distance = (point[0] - self.target[0]).hypot(point[1] - self.target[1]);
            (distance <= self.target_radius + CLOSED_MM).then_some(Event::Target)
        }
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
        for polygon in &self.workspace.obstacles {
            polygon.section(0, x, &mut self.crossings, &mut self.intervals);
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
fn span(interval: [f64; 2], y0: f64, spacing: f64, count: usize) -> std::ops::Range<usize> {
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
        Workspace::new([10.0, 6.0], vec![Polygon::new(u_shape).unwrap()], [8.0, 3.0], 1.0).unwrap()
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
            let w = Workspace::new([6.0, 6.0], vec![Polygon::new(corners.to_vec()).unwrap()], [5.5, 0.5], 0.2).unwrap();
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
