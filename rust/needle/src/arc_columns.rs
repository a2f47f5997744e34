//! Events of the whole arcs of one shape that start at equally spaced points of a grid column.
//!
//! All arcs of a heading and a bevel have one shape, which is only shifted from grid point to grid point. The shifts
//! along y at which an arc meets a segment or a circle are the values of a continuous function on an interval of x, the
//! height of the segment or circle above the arc, so they are an interval themselves. Its ends are values at the ends
//! of the interval of x, or where arc and boundary have the same direction. A boundary is therefore compared with a
//! column of grid points, and not with each of its points.

use std::f64::consts::PI;

use crate::arc::Arc;
use crate::area::{Boundary, CLOSED_MM};
use crate::workspace::{Workspace, span};

/// The width, mm, below which a piece of an arc counts as vertical.
const VERTICAL_MM: f64 = 1e-7;

/// The kinds of events that an arc meets, in any order.
pub(crate) mod mask {
    /// The target; the code of the event.
    pub(crate) const TARGET: u8 = 1;
    /// An obstacle.
    pub(crate) const COLLISION: u8 = 2;
    /// The border.
    pub(crate) const EXIT: u8 = 4;
    /// An obstacle, perhaps beyond the border.
    pub(crate) const BEYOND: u8 = 8;
}

/// A part of an arc, relative to its start, on which x increases or decreases all the time.
#[derive(Debug, Clone, Copy)]
struct Monotone {
    /// Where the part begins.
    start: [f64; 2],
    /// Sine and cosine of the heading there, and the sign of the cosine on the part.
    sin: f64,
    cos: f64,
    sign: f64,
    curvature: f64,
    /// Lowest and highest x and y.
    x: [f64; 2],
    y: [f64; 2],
}

impl Monotone {
    /// y of the part at `x`, which is in the range of the part.
    #[inline]
    fn height(&self, x: f64) -> f64 {
        let dx = x - self.start[0];
        if dx == 0.0 {
            return self.start[1];
        }
        // Sine and cosine of the heading there; the direction of the chord is the mean of both headings.
        let bend = self.curvature * dx;
        let sin = self.sin + bend;
        let cos = self.sign * (self.cos * self.cos - bend * (self.sin + sin)).max(0.0).sqrt();
        let slope = (self.sin + sin) / (self.cos + cos);
        (self.start[1] + dx * slope).clamp(self.y[0], self.y[1])
    }
}

/// The shape of the arcs of a heading and a bevel.
pub(crate) struct ArcShape {
    heading: f64,
    curvature: f64,
    length: f64,
    parts: Vec<Monotone>,
    monotone: bool,
    /// Lowest and highest x and y relative to the start.
    x: [f64; 2],
    y: [f64; 2],
}

impl ArcShape {
    /// The shape of arcs with this heading, rad, signed curvature, 1/mm, and length, mm.
    pub(crate) fn new(heading: f64, curvature: f64, length: f64) -> Self {
        let arc = Arc::new([0.0, 0.0], heading, curvature, length);
        // Where the heading is a multiple of a quarter turn, x or y may turn back.
        let turns = |axis: f64| crossings(heading - axis * PI / 2.0, curvature, length);
        let mut cuts = vec![0.0];
        cuts.extend(turns(1.0));
        cuts.push(length);
        let horizontal: Vec<f64> = turns(0.0).collect();
        let part = |from: f64, to: f64| {
            let (start, end) = (arc.point(from), arc.point(to));
            let mut y = [start[1].min(end[1]), start[1].max(end[1])];
            for s in horizontal.iter().filter(|s| (from..=to).contains(s)) {
                let at = arc.point(*s)[1];
                y = [y[0].min(at), y[1].max(at)];
            }
            let (sin, cos) = arc.heading(from).sin_cos();
            let sign = if arc.heading(0.5 * (from + to)).cos() < 0.0 { -1.0 } else { 1.0 };
            let x = [start[0].min(end[0]), start[0].max(end[0])];
            Monotone { start, sin, cos: sign * cos.abs(), sign, curvature, x, y }
        };
        let parts: Vec<Monotone> = cuts.windows(2).map(|cut| part(cut[0], cut[1])).collect();
        let over = |range: fn(&Monotone) -> [f64; 2]| {
            let ranges = || parts.iter().map(range);
            [ranges().map(|r| r[0]).fold(0.0, f64::min), ranges().map(|r| r[1]).fold(0.0, f64::max)]
        };
        let (x, y) = (over(|part| part.x), over(|part| part.y));
        let monotone = horizontal.is_empty() && parts.len() == 1;
        ArcShape { heading, curvature, length, parts, monotone, x, y }
    }

    /// Whether neither x nor y turns back, so that an arc that has left the workspace does not return.
    pub(crate) fn is_monotone(&self) -> bool {
        self.monotone
    }

    /// The arc of this shape from a point.
    pub(crate) fn from(&self, start: [f64; 2]) -> Arc {
        Arc::new(start, self.heading, self.curvature, self.length)
    }

    /// The interval of y such that a part of the arc from `(x, y)` meets the boundary.
    #[inline]
    fn contacts(&self, part: &Monotone, x: f64, boundary: &Boundary) -> Option<[f64; 2]> {
        let [low, high] = match boundary {
            Boundary::Segment(segment) => self.contacts_of_segment(part, x, segment)?,
            Boundary::Circle(centre, radius) => contacts_of_circle(part, x, *centre, *radius)?,
        };
        Some([low - CLOSED_MM, high + CLOSED_MM])
    }

    #[inline]
    fn contacts_of_segment(&self, part: &Monotone, x: f64, [a, b]: &[[f64; 2]; 2]) -> Option<[f64; 2]> {
        let (left, right) = if a[0] <= b[0] { (a, b) } else { (b, a) };
        // In coordinates relative to the start of the arc.
        let low = (left[0] - x).max(part.x[0]);
        let high = (right[0] - x).min(part.x[1]);
        if low > high + CLOSED_MM {
            return None;
        }
        let width = right[0] - left[0];
        if width < VERTICAL_MM || part.x[1] - part.x[0] < VERTICAL_MM {
            let at = |dx: f64| {
                let share = if width > 0.0 { ((x + dx - left[0]) / width).clamp(0.0, 1.0) } else { 0.0 };
                left[1] + share * (right[1] - left[1])
            };
            let segment = if width < VERTICAL_MM { [left[1], right[1]] } else { [at(low), at(high)] };
            let arc = if part.x[1] - part.x[0] < VERTICAL_MM {
                part.y
            } else {
                [part.height(low.min(high)), part.height(high.max(low))]
            };
            let range = |pair: [f64; 2]| [pair[0].min(pair[1]), pair[0].max(pair[1])];
            let (segment, arc) = (range(segment), range(arc));
            return Some([segment[0] - arc[1], segment[1] - arc[0]]);
        }
        let high = high.max(low);
        let slope = (right[1] - left[1]) / width;
        let above = |dx: f64| left[1] + slope * (x + dx - left[0]) - part.height(dx);
        let (first, last) = (above(low), above(high));
        let mut found = [first.min(last), first.max(last)];
        // Sine of the heading of the arc where it is parallel to the segment.
        let sin = part.sign * (right[1] - left[1]) / width.hypot(right[1] - left[1]);
        let bend = sin - part.sin;
        if self.curvature != 0.0 {
            let dx = part.start[0] + bend / self.curvature;
            if dx > low && dx < high {
                let at = above(dx);
                found = [found[0].min(at), found[1].max(at)];
            }
        }
        Some(found)
    }
}

#[inline]
fn contacts_of_circle(part: &Monotone, x: f64, centre: [f64; 2], radius: f64) -> Option<[f64; 2]> {
    let across = centre[0] - x;
    let low = (across - radius).max(part.x[0]);
    let high = (across + radius).min(part.x[1]);
    if low > high + CLOSED_MM {
        return None;
    }
    let high = high.max(low);
    let mut found = [f64::INFINITY, f64::NEG_INFINITY];
    let mut take = |low: f64, high: f64| found = [found[0].min(low), found[1].max(high)];
    for dx in [low, high] {
        let half = (radius * radius - (dx - across) * (dx - across)).max(0.0).sqrt();
        if part.x[1] - part.x[0] < VERTICAL_MM {
            take(centre[1] - half - part.y[1], centre[1] + half - part.y[0]);
        } else {
            let height = centre[1] - part.height(dx);
            take(height - half, height + half);
        }
    }
    // Where the arc and the circle have the same direction.
    for side in [-radius, radius] {
        let sin = (part.curvature * (across - part.start[0]) + part.sin) / (1.0 + part.curvature * side);
        let dx = across - side * sin;
        if sin.abs() <= 1.0 && dx > low && dx < high {
            let at = centre[1] + side * part.sign * (1.0 - sin * sin).sqrt() - part.height(dx);
            take(at, at);
        }
    }
    Some(found)
}

/// The part of a boundary within the border, and the kind of event there; None if it lies beyond the border.
fn within_border(boundary: Boundary, size: [f64; 2]) -> Option<(Boundary, u8)> {
    let Boundary::Segment([a, b]) = boundary else {
        let Boundary::Circle(centre, radius) = boundary else { return None };
        let inside = (0..2).all(|axis| centre[axis] >= radius && centre[axis] <= size[axis] - radius);
        return Some((boundary, if inside { mask::COLLISION } else { mask::BEYOND }));
    };
    // The segment between the shares at which it crosses the lines of the border (Liang and Barsky).
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for axis in 0..2 {
        let (low, high) = (-CLOSED_MM - a[axis], size[axis] + CLOSED_MM - a[axis]);
        let along = b[axis] - a[axis];
        if along == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (first, last) = (low / along, high / along);
        from = from.max(first.min(last));
        to = to.min(first.max(last));
    }
    if from > to {
        return None;
    }
    let at = |share: f64| [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    let end = |share: f64, whole: f64, vertex: [f64; 2]| if share == whole { vertex } else { at(share) };
    Some((Boundary::Segment([end(from, 0.0, a), end(to, 1.0, b)]), mask::COLLISION))
}

/// Arc lengths inside an arc at which the heading, measured from an axis, is a multiple of half a turn.
fn crossings(heading: f64, curvature: f64, length: f64) -> impl Iterator<Item = f64> {
    let (from, to) = (heading / PI, (heading + curvature * length) / PI);
    let (low, high) = (from.min(to), from.max(to));
    let count = if curvature == 0.0 { 0 } else { (high.floor() - low.ceil()).max(-1.0) as i64 + 1 };
    let first = if curvature > 0.0 { low.ceil() } else { high.floor() };
    let crossing = move |n: i64| (first + n as f64 * curvature.signum() - from) * PI / curvature;
    (0..count).map(crossing).filter(move |s| *s > 0.0 && *s < length)
}

/// The boundaries of a workspace, by the grid columns from which an arc can meet them.
pub(crate) struct ArcScan {
    boundaries: Vec<(Boundary, u8)>,
    target: Boundary,
    /// Indices of boundaries, by column.
    near: Vec<Vec<u32>>,
    spacing: [f64; 2],
}

impl ArcScan {
    /// Takes the workspace that contains all grid points, the spacing along x and y, mm, the number of columns, and the length of the longest arc, mm.
    pub(crate) fn new(workspace: &Workspace, spacing: [f64; 2], columns: usize, longest: f64) -> Self {
        let parts = workspace.obstacles.iter().flat_map(|area| area.boundary());
        let boundaries: Vec<_> = parts.filter_map(|part| within_border(part, workspace.size)).collect();
        let mut near = vec![Vec::new(); columns];
        for (index, (boundary, _)) in boundaries.iter().enumerate() {
            let [low, high] = match boundary {
                Boundary::Segment([a, b]) => [a[0].min(b[0]), a[0].max(b[0])],
                Boundary::Circle(centre, radius) => [centre[0] - radius, centre[0] + radius],
            };
            let reach = longest + 2.0 * CLOSED_MM;
            near[span([low - reach, high + reach], 0.0, spacing[0], columns)]
                .iter_mut()
                .for_each(|column| column.push(index as u32));
        }
        let target = Boundary::Circle(workspace.target, workspace.target_radius);
        ArcScan { boundaries, target, near, spacing }
    }

    /// Adds the kinds of events of the arcs from the points of column `i` to their masks. The border is that of the
    /// first size for the points before row `inside`, otherwise that of the second size.
    pub(crate) fn mark(&self, shape: &ArcShape, i: usize, sizes: [[f64; 2]; 2], inside: usize, masks: &mut [u8]) {
        let (x, dy, count) = (i as f64 * self.spacing[0], self.spacing[1], masks.len());
        let add = |masks: &mut [u8], kind: u8| masks.iter_mut().for_each(|mask| *mask |= kind);
        if x + shape.x[0] < -CLOSED_MM || x + shape.x[1] > sizes[0][0] + CLOSED_MM {
            add(masks, mask::EXIT);
        } else {
            for ([_, height], rows) in sizes.into_iter().zip([0..inside, inside..count]) {
                let within = span([-CLOSED_MM - shape.y[0], height + CLOSED_MM - shape.y[1]], 0.0, dy, count);
                add(&mut masks[rows.start..within.start.clamp(rows.start, rows.end)], mask::EXIT);
                add(&mut masks[within.end.clamp(rows.start, rows.end)..rows.end], mask::EXIT);
            }
        }
        let mut mark = |boundary: &Boundary, kind: u8| {
            for part in &shape.parts {
                if let Some(interval) = shape.contacts(part, x, boundary) {
                    add(&mut masks[span(interval, 0.0, dy, count)], kind);
                }
            }
        };
        for index in &self.near[i] {
            let (boundary, kind) = &self.boundaries[*index as usize];
            mark(boundary, *kind);
        }
        mark(&self.target, mask::TARGET);
    }
}
