//! Closed sets of the plane: polygons with holes, discs and capsules, each with a margin around it.
//!
//! All tests are closed: a point on an edge, or within [`CLOSED_MM`] of it, is inside. This tolerance is far below the
//! accuracy of a needle and far above the rounding of coordinates of a few hundred millimetres.

use ppvi::{Error, Result};

use crate::arc::Path;

/// Tolerance of the closed tests, in mm.
pub const CLOSED_MM: f64 = 1e-9;

/// A closed set: the points inside rings of vertices, by the even-odd rule, and all points within a margin of them.
///
/// # Examples
/// ```
/// use needle::Area;
///
/// let square = |low: f64, high: f64| vec![[low, low], [high, low], [high, high], [low, high]];
/// let frame = Area::rings(vec![square(0.0, 9.0), square(2.0, 7.0)])?;
/// assert!(frame.contains([1.0, 4.0]) && !frame.contains([4.0, 4.0]));
/// assert!(frame.with_margin(3.0)?.contains([4.0, 4.0]));
/// assert!(Area::disc([4.0, 4.0], 1.0)?.contains([4.0, 5.0]));
/// assert!(Area::capsule([0.0, 0.0], [9.0, 0.0], 1.0)?.contains([10.0, 0.0]));
/// # Ok::<(), ppvi::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Area {
    /// Every vertex with the next one of its ring. A disc is a ring of one vertex, a capsule one of two.
    edges: Vec<[[f64; 2]; 2]>,
    margin: f64,
    /// Lowest and highest x and y, the margin included.
    low: [f64; 2],
    high: [f64; 2],
}

/// A part of the boundary of an area without overhang: where a path can first meet the area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Boundary {
    /// A segment.
    Segment([[f64; 2]; 2]),
    /// A circle: centre and radius.
    Circle([f64; 2], f64),
}

impl Area {
    /// Makes a polygon from its vertices, mm. The first vertex is not repeated at the end. The caller checks that the
    /// polygon is simple; for one that intersects itself the even-odd rule applies.
    ///
    /// # Errors
    /// The errors of [`Area::rings`].
    pub fn polygon(vertices: Vec<[f64; 2]>) -> Result<Self> {
        Area::rings(vec![vertices])
    }

    /// Makes a polygon with holes from its rings of vertices, mm: the outline and the holes, in any order.
    ///
    /// # Errors
    /// [`Error::Parameter`] for no ring, fewer than three vertices in a ring, or a coordinate that is not finite.
    pub fn rings(rings: Vec<Vec<[f64; 2]>>) -> Result<Self> {
        let least = rings.iter().map(Vec::len).min().unwrap_or(0);
        if least < 3 {
            return Err(Error::parameter("polygon", format!("{least} points"), "must have at least three points"));
        }
        Area::of_rings(&rings, 0.0)
    }

    /// Makes a disc from its centre and radius, mm.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a centre that is not finite, or a radius that is not positive and finite.
    pub fn disc(centre: [f64; 2], radius: f64) -> Result<Self> {
        Area::of_rings(&[vec![centre]], positive("radius", radius)?)
    }

    /// Makes a capsule: the points within `radius` of the segment from `a` to `b`, mm.
    ///
    /// # Errors
    /// [`Error::Parameter`] for ends that are not finite, or a radius that is not positive and finite.
    pub fn capsule(a: [f64; 2], b: [f64; 2], radius: f64) -> Result<Self> {
        Area::of_rings(&[vec![a, b]], positive("radius", radius)?)
    }

    /// The area with a wider margin: all points within `margin`, mm, of it.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a margin that is negative or not finite.
    pub fn with_margin(mut self, margin: f64) -> Result<Self> {
        if !(margin >= 0.0 && margin.is_finite()) {
            return Err(Error::parameter("margin", margin, "must be finite and not negative"));
        }
        self.margin += margin;
        self.low = self.low.map(|c| c - margin);
        self.high = self.high.map(|c| c + margin);
        Ok(self)
    }

    fn of_rings(rings: &[Vec<[f64; 2]>], margin: f64) -> Result<Self> {
        let vertices = || rings.iter().flatten();
        if let Some(point) = vertices().find(|point| !point.iter().all(|c| c.is_finite())) {
            return Err(Error::parameter("polygon", format!("{point:?}"), "must have finite coordinates"));
        }
        let fold = |axis: usize, pick: fn(f64, f64) -> f64| vertices().map(|p| p[axis]).reduce(pick).unwrap_or(0.0);
        let low = [fold(0, f64::min) - margin, fold(1, f64::min) - margin];
        let high = [fold(0, f64::max) + margin, fold(1, f64::max) + margin];
        let closed = |ring: &Vec<[f64; 2]>| -> Vec<[[f64; 2]; 2]> {
            let next = ring.iter().cycle().skip(1);
            ring.iter().zip(next).map(|(&a, &b)| [a, b]).collect()
        };
        Ok(Area { edges: rings.iter().flat_map(closed).collect(), margin, low, high })
    }

    /// Whether the point is inside or on the area.
    pub fn contains(&self, point: [f64; 2]) -> bool {
        let outside =
            |axis: usize| point[axis] < self.low[axis] - CLOSED_MM || point[axis] > self.high[axis] + CLOSED_MM;
        if outside(0) || outside(1) {
            return false;
        }
        let near = self.margin + CLOSED_MM;
        let mut inside = false;
        for [a, b] in &self.edges {
            if distance_to_segment(point, *a, *b) <= near {
                return true;
            }
            if (a[0] <= point[0]) != (b[0] <= point[0]) {
                let crossing = a[1] + (point[0] - a[0]) / (b[0] - a[0]) * (b[1] - a[1]);
                inside ^= crossing > point[1];
            }
        }
        inside
    }

    /// Whether the area and a box given by its lowest and highest x and y may have a point in common.
    #[inline]
    pub(crate) fn is_near(&self, [low, high]: [[f64; 2]; 2]) -> bool {
        let apart = |axis: usize| high[axis] < self.low[axis] - CLOSED_MM || low[axis] > self.high[axis] + CLOSED_MM;
        !(apart(0) || apart(1))
    }

    /// The parameter at which a path that starts outside the area first meets it; `bounds` is a box around the path.
    pub(crate) fn first_contact(&self, path: &Path, bounds: [[f64; 2]; 2]) -> Option<f64> {
        let near = self.margin + CLOSED_MM;
        let mut first: Option<f64> = None;
        let mut take = |met: Option<f64>| {
            if let Some(u) = met {
                first = Some(first.map_or(u, |first| first.min(u)));
            }
        };
        for edge @ [a, b] in &self.edges {
            let apart = |axis: usize| {
                bounds[1][axis] < a[axis].min(b[axis]) - near || bounds[0][axis] > a[axis].max(b[axis]) + near
            };
            if apart(0) || apart(1) {
                continue;
            }
            if self.margin == 0.0 {
                take(path.enters_strip(*edge, near, near));
            } else {
                take(path.enters_strip(*edge, near, 0.0));
                take(path.enters_disc(*a, near));
            }
        }
        first
    }

    /// The parts of the boundary. Some of them may lie inside the area.
    pub(crate) fn boundary(&self) -> impl Iterator<Item = Boundary> {
        let margin = self.margin;
        self.edges.iter().flat_map(move |&[a, b]| {
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            let length = dx.hypot(dy);
            let shifted = |side: f64| {
                let (x, y) = (-side * dy / length, side * dx / length);
                Boundary::Segment([[a[0] + x, a[1] + y], [b[0] + x, b[1] + y]])
            };
            let plain = (margin == 0.0).then_some(Boundary::Segment([a, b]));
            let sides = [-margin, margin].into_iter().filter(move |_| margin > 0.0 && length > 0.0).map(shifted);
            let corner = (margin > 0.0).then_some(Boundary::Circle(a, margin));
            plain.into_iter().chain(sides.collect::<Vec<_>>()).chain(corner)
        })
    }

    /// Appends the closed intervals in which the line "coordinate `axis` = `at`" intersects the area.
    ///
    /// The section of a closed polygon is the union of its limits from both sides. If a vertex is within the tolerance
    /// of the line, both limits are appended, and also the vertex itself, because next to a steep edge it may lie
    /// between the two.
    pub(crate) fn section(&self, axis: usize, at: f64, crossings: &mut Vec<f64>, intervals: &mut Vec<[f64; 2]>) {
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
        if self.margin > 0.0 {
            let near = self.margin + CLOSED_MM;
            intervals.extend(self.edges.iter().filter_map(|edge| section_of_capsule(*edge, near, axis, at)));
        }
    }
}

/// The interval in which the line "coordinate `axis` = `at`" intersects the points within `radius` of a segment.
fn section_of_capsule([a, b]: [[f64; 2]; 2], radius: f64, axis: usize, at: f64) -> Option<[f64; 2]> {
    let other = 1 - axis;
    let mut found: Option<[f64; 2]> = None;
    let mut take = |low: f64, high: f64| {
        found = Some(found.map_or([low, high], |[least, most]: [f64; 2]| [least.min(low), most.max(high)]));
    };
    for end in [a, b] {
        let half = radius * radius - (at - end[axis]) * (at - end[axis]);
        if half >= 0.0 {
            take(end[other] - half.sqrt(), end[other] + half.sqrt());
        }
    }
    let (du, dv) = (b[axis] - a[axis], b[other] - a[other]);
    let length = du.hypot(dv);
    if du != 0.0 {
        for side in [-radius, radius] {
            // The segment, shifted along its normal.
            let t = (at - a[axis] + side * dv / length) / du;
            if (0.0..=1.0).contains(&t) {
                let v = a[other] + t * dv + side * du / length;
                take(v, v);
            }
        }
    }
    found
}

fn distance_to_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length2 = dx * dx + dy * dy;
    let t = if length2 > 0.0 { (((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (p[0] - a[0] - t * dx).hypot(p[1] - a[1] - t * dy)
}

fn positive(name: &'static str, value: f64) -> Result<f64> {
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err(Error::parameter(name, value, "must be positive and finite"))
    }
}
