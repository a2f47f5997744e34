//! Arcs of constant curvature, and the arc length at which they first meet a line, a disc or a segment.
//!
//! At the arc length s an arc that starts at p with the unit tangent t and the left normal n is at
//!
//! ```text
//! p + (u t + k u^2 / 2 n) / (1 + k^2 u^2 / 4)    with u = 2 / k tan(k s / 2),
//! ```
//!
//! where k is the signed curvature. Lines and circles are quadratic equations in u. Their coefficients stay finite for
//! a curvature of zero, where u = s, so straight and nearly straight arcs need no special case.

use std::f64::consts::FRAC_PI_2;

/// A circular arc, or a straight piece, of the tip's path.
///
/// # Examples
/// ```
/// use needle::Arc;
///
/// let quarter = Arc::new([0.0, 0.0], 0.0, 1.0 / 40.0, 20.0 * std::f64::consts::PI);
/// let [x, y] = quarter.point(quarter.length());
/// assert!((x - 40.0).abs() < 1e-12 && (y - 40.0).abs() < 1e-12);
/// assert_eq!(Arc::new([1.0, 2.0], 0.0, 0.0, 5.0).point(3.0), [4.0, 2.0]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    start: [f64; 2],
    heading: f64,
    /// Unit tangent at the start.
    tangent: [f64; 2],
    curvature: f64,
    length: f64,
}

/// Largest angle, rad, that an arc of [`Arc::pieces`] turns through.
const LARGEST_TURN: f64 = FRAC_PI_2;

impl Arc {
    /// Makes an arc from its start, mm, its heading there, rad, its signed curvature, 1/mm (positive to the left; 0 is
    /// straight), and its length, mm.
    #[inline]
    pub fn new(start: [f64; 2], heading: f64, curvature: f64, length: f64) -> Self {
        let (sin, cos) = heading.sin_cos();
        Arc { start, heading, tangent: [cos, sin], curvature, length }
    }

    /// Arc length, mm.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Signed curvature, 1/mm.
    pub fn curvature(&self) -> f64 {
        self.curvature
    }

    /// The heading, rad, at the arc length `s`, mm.
    #[inline]
    pub fn heading(&self, s: f64) -> f64 {
        self.heading + self.curvature * s
    }

    /// The point, mm, at the arc length `s`, mm.
    #[inline]
    pub fn point(&self, s: f64) -> [f64; 2] {
        let half = 0.5 * self.curvature * s;
        let chord = if half.abs() > 1e-9 { s * half.sin() / half } else { s };
        let (sin, cos) = (self.heading + half).sin_cos();
        [self.start[0] + chord * cos, self.start[1] + chord * sin]
    }

    /// The part of the arc between two arc lengths, mm.
    fn part(&self, from: f64, to: f64) -> Arc {
        Arc::new(self.point(from), self.heading(from), self.curvature, to - from)
    }

    /// The arc in pieces that turn by at most a quarter, each with the arc length at which it begins.
    #[inline]
    pub(crate) fn pieces(&self) -> impl Iterator<Item = (f64, Arc)> {
        let count = (self.curvature.abs() * self.length / LARGEST_TURN).ceil().max(1.0);
        let (arc, length) = (*self, self.length / count);
        (0..count as usize).map(move |n| {
            if count == 1.0 {
                return (0.0, arc);
            }
            let from = n as f64 * length;
            (from, arc.part(from, from + length))
        })
    }

    /// Lowest and highest x and y, mm, of a box around an arc of at most half a turn.
    #[inline]
    pub(crate) fn bounds(&self) -> [[f64; 2]; 2] {
        let end = self.point(self.length);
        // An upper bound of the height of the arc above its chord.
        let height = 0.125 * self.curvature.abs() * self.length * self.length;
        let axis = |a: usize| (self.start[a].min(end[a]) - height, self.start[a].max(end[a]) + height);
        let ((x0, x1), (y0, y1)) = (axis(0), axis(1));
        [[x0, y0], [x1, y1]]
    }

    /// The arc in the form that [`Path`] says.
    #[inline]
    pub(crate) fn path(&self) -> Path {
        let half = 0.5 * self.curvature * self.length;
        let end = if half.abs() > 1e-9 { self.length * half.tan() / half } else { self.length };
        Path { start: self.start, tangent: self.tangent, curvature: self.curvature, end }
    }
}

/// An arc of at most a quarter turn by the parameter u of the module.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Path {
    start: [f64; 2],
    tangent: [f64; 2],
    curvature: f64,
    /// u at the end.
    end: f64,
}

impl Path {
    /// Arc length, mm, at the parameter u.
    pub(crate) fn length_at(&self, u: f64) -> f64 {
        let half = 0.5 * self.curvature * u;
        if half.abs() > 1e-9 { u * half.atan() / half } else { u }
    }

    fn point(&self, u: f64) -> [f64; 2] {
        let Path { start, tangent: [cos, sin], curvature, .. } = *self;
        let bend = 0.5 * curvature * u;
        let scale = u / (1.0 + bend * bend);
        [start[0] + scale * (cos - bend * sin), start[1] + scale * (sin + bend * cos)]
    }

    /// The parameters, in ascending order, at which the path meets the line of the points q with
    /// `normal . q = offset`; `normal` is a unit vector.
    fn crossings_of_line(&self, normal: [f64; 2], offset: f64) -> impl Iterator<Item = f64> {
        let [cos, sin] = self.tangent;
        let distance = dot(normal, self.start) - offset;
        let half = 0.5 * self.curvature;
        let across = normal[1] * cos - normal[0] * sin;
        self.roots(half * (half * distance + across), dot(normal, self.tangent), distance)
    }

    /// The parameter at which the path first enters the half-plane `normal . q > offset`, or 0 if it starts there.
    #[inline]
    pub(crate) fn enters_half_plane(&self, normal: [f64; 2], offset: f64) -> Option<f64> {
        if dot(normal, self.start) > offset {
            return Some(0.0);
        }
        self.crossings_of_line(normal, offset).next()
    }

    /// The parameter at which the path first meets a disc, or 0 if it starts in the disc.
    #[inline]
    pub(crate) fn enters_disc(&self, centre: [f64; 2], radius: f64) -> Option<f64> {
        let [cos, sin] = self.tangent;
        let from = [self.start[0] - centre[0], self.start[1] - centre[1]];
        let outside = dot(from, from) - radius * radius;
        if outside <= 0.0 {
            return Some(0.0);
        }
        let half = 0.5 * self.curvature;
        let a = half * half * outside + 2.0 * half * (from[1] * cos - from[0] * sin) + 1.0;
        self.roots(a, 2.0 * dot(from, self.tangent), outside).next()
    }

    /// The parameter at which the path first meets the rectangle of the points closer than `half_width` to a segment,
    /// which is extended by `beyond` at both ends, but does not begin at an end; 0 if it starts in the rectangle.
    #[inline]
    pub(crate) fn enters_strip(&self, [a, b]: [[f64; 2]; 2], half_width: f64, beyond: f64) -> Option<f64> {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = dx.hypot(dy);
        if length == 0.0 {
            return None;
        }
        let (along, normal) = ([dx / length, dy / length], [-dy / length, dx / length]);
        let offset = dot(normal, a);
        let is_beside = |u: &f64| {
            let point = if *u == 0.0 { self.start } else { self.point(*u) };
            let at = (point[0] - a[0]) * along[0] + (point[1] - a[1]) * along[1];
            (-beyond..=length + beyond).contains(&at)
        };
        let distance = dot(normal, self.start) - offset;
        if distance.abs() <= half_width && is_beside(&0.0) {
            return Some(0.0);
        }
        let side = |sign: f64| self.crossings_of_line(normal, offset + sign * half_width).find(is_beside);
        match (side(1.0), side(-1.0)) {
            (Some(u), Some(v)) => Some(u.min(v)),
            (u, v) => u.or(v),
        }
    }

    /// The roots of a u^2 + b u + c on the path, in ascending order.
    #[inline]
    fn roots(&self, a: f64, b: f64, c: f64) -> impl Iterator<Item = f64> {
        let discriminant = b * b - 4.0 * a * c;
        let q = -0.5 * (b + discriminant.max(0.0).sqrt().copysign(b));
        // Neither quotient subtracts nearly equal numbers. A vanishing divisor gives no root on the path.
        let (u, v) = if discriminant < 0.0 { (f64::NAN, f64::NAN) } else { (c / q, q / a) };
        let roots = if v < u { [v, u] } else { [u, v] };
        let end = self.end;
        roots.into_iter().filter(move |u| (0.0..=end).contains(u))
    }
}

#[inline]
fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}
