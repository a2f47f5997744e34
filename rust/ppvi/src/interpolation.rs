//! Interpolation of success probabilities between grid points, for the plane and for 3D.
//!
//! The success of a given policy is a mean and not a minimum, so it may be interpolated with negative weights. Values
//! may not: under a minimum, a negative weight finds costs that do not exist.

/// Points of the cubic interpolation along an axis.
pub(crate) const POINTS: usize = 4;

/// Interpolation of success between grid points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// As the Markov decision process: two points along each axis.
    Linear,
    /// Four points along each axis, limited to [0, 1]. Beside points that are not free, see [`crate::lattice`] and
    /// [`crate::space`].
    Cubic,
}

/// Weights of the points from -1 on for a place at the fraction `f` after point 0: four points, or those at 0 and 1. The
/// place has the variance `spread` in squared spacings besides; to second order, it adds half of that times the second
/// derivative.
pub(crate) fn weights(order: Order, f: f64, spread: f64) -> [f64; POINTS] {
    match order {
        Order::Linear => [0.0, 1.0 - f, f, 0.0],
        Order::Cubic => {
            let [a, b, c, d] = cubic_weights(f);
            let half = 0.5 * spread;
            [a + half * (1.0 - f), b + half * (3.0 * f - 2.0), c + half * (1.0 - 3.0 * f), d + half * f]
        }
    }
}

/// Weights of the four points -1 to 2 with which a cubic polynomial through them is evaluated at `f`, from 0 to 1
/// (Lagrange).
///
/// # Examples
/// ```
/// assert_eq!(ppvi::cubic_weights(0.5), [-0.0625, 0.5625, 0.5625, -0.0625]);
/// ```
pub fn cubic_weights(f: f64) -> [f64; POINTS] {
    let near = -f * (1.0 - f) / 6.0;
    [near * (2.0 - f), (1.0 - f * f) * (2.0 - f) / 2.0, f * (1.0 + f) * (2.0 - f) / 2.0, near * (1.0 + f)]
}
