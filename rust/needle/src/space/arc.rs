//! Vectors, poses, and arcs of constant curvature in 3D.

/// A vector: along the axis, y, z.
pub type Vec3 = [f64; 3];

/// Position and unit tangent of the tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpacePose {
    /// Position, mm.
    pub position: Vec3,
    /// Unit tangent.
    pub tangent: Vec3,
}

/// `a + t * b`.
#[inline]
pub(crate) fn along(a: Vec3, t: f64, b: Vec3) -> Vec3 {
    [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]]
}

/// `a * v + b * w`.
#[inline]
pub(crate) fn blend(a: f64, v: Vec3, b: f64, w: Vec3) -> Vec3 {
    [a * v[0] + b * w[0], a * v[1] + b * w[1], a * v[2] + b * w[2]]
}

/// The vector of length one in the same direction.
pub(crate) fn unit(v: Vec3) -> Vec3 {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|x| x / length)
}

/// Two unit vectors across a tangent, which the rotation of the axis to the tangent on the shortest way makes of those of
/// y and z (parallel transport). The tangent is not opposite to the axis.
#[inline]
pub fn frame([x, y, z]: Vec3) -> [Vec3; 2] {
    let share = 1.0 / (1.0 + x);
    [[-y, 1.0 - y * y * share, -y * z * share], [-z, -y * z * share, 1.0 - z * z * share]]
}

/// The unit vector across a tangent at a roll angle, rad, from the first vector of its [`frame`] to the second.
#[inline]
pub fn bevel(tangent: Vec3, roll: f64) -> Vec3 {
    let [first, second] = frame(tangent);
    blend(roll.cos(), first, roll.sin(), second)
}

/// A tangent turned by two angles, rad, towards the vectors of its [`frame`].
pub(crate) fn turned(tangent: Vec3, [a, b]: [f64; 2]) -> Vec3 {
    let angle = a.hypot(b);
    if angle == 0.0 {
        return tangent;
    }
    let [first, second] = frame(tangent);
    let (sin, cos) = angle.sin_cos();
    unit(blend(cos, tangent, sin / angle, blend(a, first, b, second)))
}

/// A vector carried along when a tangent turns: rotated by the rotation of the first unit vector to the second on the
/// shortest way. They are not opposite.
#[inline]
pub(crate) fn carried(v: Vec3, from: Vec3, to: Vec3) -> Vec3 {
    let dot = |a: Vec3, b: Vec3| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let sum = along(from, 1.0, to);
    along(along(v, -dot(sum, v) / (1.0 + dot(from, to)), sum), 2.0 * dot(from, v), to)
}

/// An arc that starts at a pose and bends towards a normal.
///
/// # Examples
/// ```
/// use needle::space::{SpaceArc, SpacePose};
///
/// let start = SpacePose { position: [0.0; 3], tangent: [1.0, 0.0, 0.0] };
/// let arc = SpaceArc { start, normal: [0.0, 0.0, 1.0], curvature: 1.0 / 50.0 };
/// let length = arc.length_to(30.0).unwrap();
/// let end = arc.at(length);
/// assert!((end.position[0] - 30.0).abs() < 1e-12 && (end.position[2] - 10.0).abs() < 1e-12);
/// assert!((end.tangent[2] - 0.6).abs() < 1e-12);
/// assert_eq!(arc.length_to(51.0), None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceArc {
    /// Where it starts.
    pub start: SpacePose,
    /// Unit vector across the tangent of the start, towards the centre.
    pub normal: Vec3,
    /// Curvature, 1/mm; 0 is straight.
    pub curvature: f64,
}

impl SpaceArc {
    /// The pose at an arc length, mm.
    #[inline]
    pub fn at(&self, s: f64) -> SpacePose {
        let half = 0.5 * self.curvature * s;
        let (sin, cos) = half.sin_cos();
        let chord = if half.abs() > 1e-9 { s * sin / half } else { s };
        let SpacePose { position, tangent } = self.start;
        let middle = blend(cos, tangent, sin, self.normal);
        let (sin, cos) = (2.0 * half).sin_cos();
        SpacePose { position: along(position, chord, middle), tangent: blend(cos, tangent, sin, self.normal) }
    }

    /// The rest of the arc from an arc length, mm, on, after a disturbance that would turn its end from one unit vector to
    /// another.
    #[inline]
    pub(crate) fn disturbed(&self, s: f64, [from, to]: [Vec3; 2]) -> SpaceArc {
        let SpacePose { position, tangent } = self.at(s);
        let start = SpacePose { position, tangent: carried(tangent, from, to) };
        SpaceArc { start, normal: carried(self.normal_at(s), from, to), curvature: self.curvature }
    }

    /// The normal at an arc length, mm.
    #[inline]
    pub fn normal_at(&self, s: f64) -> Vec3 {
        let (sin, cos) = (self.curvature * s).sin_cos();
        blend(-sin, self.start.tangent, cos, self.normal)
    }

    /// Arc length, mm, at which the arc has first advanced by `advance` mm along the axis; None if it turns back before.
    ///
    /// With u = tan(curvature s / 2) the advance is a quotient of quadratic polynomials; this is its smaller root, in the form
    /// that is exact without curvature.
    #[inline]
    pub fn length_to(&self, advance: f64) -> Option<f64> {
        let (ahead, turned) = (self.start.tangent[0], self.normal[0]);
        let bent = advance * self.curvature;
        let square = ahead * ahead + bent * (2.0 * turned - bent);
        if square < 0.0 || ahead <= 0.0 {
            return None;
        }
        let half = bent / (ahead + square.sqrt());
        Some(if half.abs() > 1e-9 {
            2.0 * half.atan() / self.curvature
        } else {
            2.0 * advance / (ahead + square.sqrt())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dot(a: Vec3, b: Vec3) -> f64 {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }

    #[test]
    fn frames_are_orthonormal_and_those_of_the_axis_are_y_and_z() {
        assert_eq!(frame([1.0, 0.0, 0.0]), [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        for tangent in [[0.8, 0.6, 0.0], [0.6, 0.0, -0.8], unit([1.0, -0.7, 0.4])] {
            let [a, b] = frame(tangent);
            for (product, expected) in
                [(dot(a, a), 1.0), (dot(b, b), 1.0), (dot(a, b), 0.0), (dot(a, tangent), 0.0), (dot(b, tangent), 0.0)]
            {
                assert!((product - expected).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn what_is_carried_along_keeps_its_angles() {
        let (from, to) = (unit([1.0, 0.2, -0.3]), unit([0.7, 0.4, 0.1]));
        let normal = bevel(from, 1.1);
        let (tangent, normal) = (carried(from, from, to), carried(normal, from, to));
        assert!((0..3).all(|axis| (tangent[axis] - to[axis]).abs() < 1e-12));
        assert!(dot(normal, to).abs() < 1e-12 && (dot(normal, normal) - 1.0).abs() < 1e-12);
        // From the axis on, this is the parallel transport of the frames.
        let [first, _] = frame(to);
        assert!((dot(carried([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], to), first) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_arc_ends_at_its_plane() {
        for (tangent, roll, curvature) in
            [([0.8, 0.6, 0.0], 0.3, 0.02), ([0.8, 0.6, 0.0], 3.0, 0.02), ([1.0, 0.0, 0.0], 1.0, 0.0)]
        {
            let start = SpacePose { position: [1.0, 2.0, 3.0], tangent };
            let arc = SpaceArc { start, normal: bevel(tangent, roll), curvature };
            let length = arc.length_to(8.0).unwrap();
            assert!((arc.at(length).position[0] - 9.0).abs() < 1e-12);
            assert!((dot(arc.at(length).tangent, arc.normal_at(length))).abs() < 1e-12);
            let steps = (0..100).map(|n| arc.at(length * f64::from(n) / 100.0).position[0]);
            assert!(steps.into_iter().all(|x| x < 9.0));
        }
    }
}
