//! The target as the user gave it, beside the voxels of the lattice.
//!
//! A voxel of the lattice that lies in the target only in part is no target to the pass. Executions ask the target itself:
//! the voxels of the file, or the ball.

use ppvi::{Error, Result};

use crate::space::arc::Vec3;

/// A target: a ball, or voxels of a file at any angle to the lattice.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetBody {
    shape: Shape,
    /// Corners of the box around it, mm.
    low: Vec3,
    high: Vec3,
}

#[derive(Debug, Clone, PartialEq)]
enum Shape {
    Ball {
        center: Vec3,
        radius: f64,
    },
    /// Voxel `[a][b][c]` holds the points with `floor(rows * (x, y, z, 1)) = (a, b, c)`.
    Voxels {
        rows: [[f64; 4]; 3],
        count: [usize; 3],
        inside: Vec<bool>,
    },
}

impl TargetBody {
    /// Makes a ball from its centre and radius, mm.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a radius that is not positive or a number that is not finite.
    pub fn ball(center: Vec3, radius: f64) -> Result<Self> {
        if radius.is_nan() || radius <= 0.0 || !center.iter().chain([&radius]).all(|x| x.is_finite()) {
            return Err(Error::parameter("target", format!("{center:?}, {radius}"), "must be a centre and a radius"));
        }
        let [low, high] = [-radius, radius].map(|side| center.map(|x| x + side));
        Ok(TargetBody { shape: Shape::Ball { center, radius }, low, high })
    }

    /// Makes a target of voxels: voxel `[a][b][c]` holds the points with `floor(rows * (x, y, z, 1)) = (a, b, c)`, positions
    /// in mm.
    ///
    /// # Errors
    /// [`Error::Length`] for another number of voxels than `count` says; [`Error::Parameter`] for `rows` without an inverse.
    pub fn voxels(rows: [[f64; 4]; 3], count: [usize; 3], inside: Vec<bool>) -> Result<Self> {
        let expected = count.iter().product();
        if inside.len() != expected || expected == 0 {
            return Err(Error::Length { name: "target", expected, found: inside.len() });
        }
        let Some(columns) = inverse(&rows) else {
            return Err(Error::parameter("target", format!("{rows:?}"), "must be finite and have an inverse"));
        };
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for corner in 0..8 {
            let at =
                [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { count[axis] as f64 } else { 0.0 } - rows[axis][3]);
            let point = columns.map(|row| row[0] * at[0] + row[1] * at[1] + row[2] * at[2]);
            (low, high) =
                ([0, 1, 2].map(|axis| low[axis].min(point[axis])), [0, 1, 2].map(|axis| high[axis].max(point[axis])));
        }
        Ok(TargetBody { shape: Shape::Voxels { rows, count, inside }, low, high })
    }

    /// Whether the box around a straight way touches that around the target.
    #[inline]
    pub(crate) fn is_near(&self, from: Vec3, to: Vec3) -> bool {
        (0..3).all(|axis| from[axis].min(to[axis]) <= self.high[axis] && from[axis].max(to[axis]) >= self.low[axis])
    }

    /// Whether a point lies in the target.
    pub(crate) fn contains(&self, point: Vec3) -> bool {
        self.is_near(point, point) && self.part(point, point).is_some()
    }

    /// Shares of a straight way at which it enters the target, 0 from within it, and leaves the part that it enters, the ball or
    /// a voxel, at most 1; None if it does not enter.
    pub(crate) fn part(&self, from: Vec3, to: Vec3) -> Option<[f64; 2]> {
        match &self.shape {
            Shape::Ball { center, radius } => {
                let dot = |a: Vec3, b: Vec3| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                let [apart, way] = [[0, 1, 2].map(|k| from[k] - center[k]), [0, 1, 2].map(|k| to[k] - from[k])];
                let (beyond, ahead, length) = (dot(apart, apart) - radius * radius, dot(apart, way), dot(way, way));
                if beyond <= 0.0 {
                    return Some([0.0, 0.0]);
                }
                let root = ahead * ahead - length * beyond;
                // The two points of the line on the sphere.
                let [near, far] = [-1.0, 1.0].map(|side| (side * root.max(0.0).sqrt() - ahead) / length);
                (root >= 0.0 && (0.0..=1.0).contains(&near)).then_some([near, far.min(1.0)])
            }
            Shape::Voxels { rows, count, inside } => {
                let place = |p: Vec3| rows.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]);
                let is_inside = |cell: [i32; 3]| {
                    let within = (0..3).all(|axis| cell[axis] >= 0 && (cell[axis] as usize) < count[axis]);
                    let [a, b, c] = cell.map(|at| at as usize);
                    within && inside[(a * count[1] + b) * count[2] + c]
                };
                let (start, end) = (place(from), place(to));
                if is_inside(cell_of(start)) {
                    return Some([0.0, 0.0]);
                }
                let mut ways = crossed(start, end);
                let (enters, _) = ways.find(|(_, cell)| is_inside(*cell))?;
                Some([enters, ways.next().map_or(1.0, |(share, _)| share)])
            }
        }
    }
}

/// The cell of the unit grid that contains a point.
#[inline]
pub(crate) fn cell_of(point: Vec3) -> [i32; 3] {
    point.map(|place| {
        // The conversion rounds towards zero, and saturates.
        let cell = place as i32;
        cell.saturating_sub(i32::from(f64::from(cell) > place))
    })
}

/// The cells of the unit grid that a straight way enters after that of its start, in order, and the share of the way at which
/// it enters each (Amanatides and Woo 1987). A way through an edge passes one of the cells beside it.
pub(crate) fn crossed(from: Vec3, to: Vec3) -> impl Iterator<Item = (f64, [i32; 3])> {
    let [mut at, end] = [from, to].map(cell_of);
    std::iter::from_fn(move || {
        // The share of the way at which it leaves the cell along an axis.
        let leaves = |axis: usize| {
            let side = if end[axis] > at[axis] { 1.0 } else { 0.0 };
            (f64::from(at[axis]) + side - from[axis]) / (to[axis] - from[axis])
        };
        let ahead = (0..3).filter(|axis| at[*axis] != end[*axis]);
        let next = ahead.min_by(|a, b| leaves(*a).total_cmp(&leaves(*b)))?;
        let share = leaves(next);
        at[next] += (end[next] - at[next]).signum();
        Some((share, at))
    })
}

/// The inverse of the left three columns, by rows; None if there is none.
fn inverse(rows: &[[f64; 4]; 3]) -> Option<[Vec3; 3]> {
    let cofactor = |i: usize, j: usize| {
        let ([a, b], [c, d]) = ([(i + 1) % 3, (i + 2) % 3], [(j + 1) % 3, (j + 2) % 3]);
        rows[a][c] * rows[b][d] - rows[a][d] * rows[b][c]
    };
    let determinant: f64 = (0..3).map(|j| rows[0][j] * cofactor(0, j)).sum();
    let found = [0, 1, 2].map(|j| [0, 1, 2].map(|i| cofactor(i, j) / determinant));
    let is_finite = found.iter().flatten().chain(rows.iter().flatten()).all(|x| x.is_finite());
    is_finite.then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers() -> impl FnMut() -> f64 {
        let mut state = 11u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    /// Compares shares with the first of many samples that lies in the target.
    fn agrees_with_samples(body: &TargetBody, contains: impl Fn(Vec3) -> bool) {
        let (mut random, mut entered) = (numbers(), 0);
        for _ in 0..3000 {
            let from = [0; 3].map(|_| 12.0 * random() - 6.0);
            let to = from.map(|x| x + 4.0 * (random() - 0.5));
            let at = |share: f64| [0, 1, 2].map(|axis| from[axis] + share * (to[axis] - from[axis]));
            let sampled = (0..=2000).map(|k| f64::from(k) / 2000.0).find(|share| contains(at(*share)));
            assert_eq!(body.contains(from), contains(from));
            let part = body.part(from, to);
            if let Some([enters, leaves]) = part {
                assert!(enters == 0.0 || contains(at(0.5 * (enters + leaves))), "{enters} {leaves}");
            }
            match (part.map(|[enters, _]| enters), sampled) {
                (Some(share), Some(sample)) => {
                    assert!(share <= sample + 1e-9 && sample - share < 1e-3, "{share} {sample}")
                }
                // A corner between two samples.
                (Some(share), None) => assert!(!contains(at(share + 1e-3))),
                (None, found) => assert_eq!(found, None),
            }
            assert!(body.is_near(from, to) || part.is_none());
            entered += usize::from(sampled.is_some_and(|share| share > 0.0));
        }
        assert!(entered > 50, "{entered}");
    }

    #[test]
    fn a_way_enters_a_ball_where_its_samples_do() {
        let (center, radius) = ([0.3, -0.4, 0.2], 2.5);
        let body = TargetBody::ball(center, radius).unwrap();
        agrees_with_samples(&body, |p| (0..3).map(|k| (p[k] - center[k]).powi(2)).sum::<f64>() <= radius * radius);
    }

    #[test]
    fn a_way_enters_oblique_voxels_where_its_samples_do() {
        let rows = [[0.9, 0.5, 0.0, 2.0], [-0.4, 0.8, 0.3, 2.2], [0.1, -0.3, 0.7, 1.9]];
        let mut random = numbers();
        let inside: Vec<bool> = (0..120).map(|_| random() < 0.5).collect();
        let body = TargetBody::voxels(rows, [4, 5, 6], inside.clone()).unwrap();
        agrees_with_samples(&body, |p| {
            let at = rows.map(|row| (row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]).floor());
            let within = (0..3).all(|axis| at[axis] >= 0.0 && at[axis] < [4.0, 5.0, 6.0][axis]);
            within && inside[(at[0] as usize * 5 + at[1] as usize) * 6 + at[2] as usize]
        });
    }

    #[test]
    fn impossible_targets_are_refused() {
        assert!(TargetBody::ball([0.0; 3], 0.0).is_err());
        assert!(TargetBody::ball([f64::NAN, 0.0, 0.0], 1.0).is_err());
        assert!(TargetBody::voxels([[1.0, 0.0, 0.0, 0.0]; 3], [1; 3], vec![true]).is_err());
        let rows = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        assert!(TargetBody::voxels(rows, [2, 1, 1], vec![true]).is_err());
        assert!(TargetBody::voxels(rows, [0, 1, 1], vec![]).is_err());
    }
}
