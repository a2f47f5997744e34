//! A grid of directions in a cone, and the distribution of a disturbed direction on it.
//!
//! A direction at the angle theta from the axis has the coordinates (u, v), rad: its distance theta and its azimuth
//! about the axis (azimuthal equidistant). The grid is regular in (u, v).
//!
//! # The stencil
//!
//! After a step the mean direction lies between grid points, and the noise has the same variance q in all directions
//! across it. In (u, v) lengths along the azimuth are stretched by theta / sin(theta), so the noise has the covariance
//!
//! ```text
//! q (e e' + (theta / sin theta)^2 (1 - e e')),    e = (u, v) / theta.
//! ```
//!
//! Along each axis take the grid point nearest to the mean, at the distance f cells, and the points r cells to both
//! sides of it. The only weights with mean f and variance S are (S + f^2 +- r f) / (2 r^2) at the sides and the rest in
//! the middle. With r = round(sqrt(3 S)), at least 1, fourth moments are nearly those of a normal distribution, and
//! no weight is negative, but for S < |f| (1 - |f|), where the variance is raised to this least possible one. The nine
//! products have the right variances; the covariance C is added to the four corners as +-C / (4 r r'), as far as no weight
//! becomes negative. Noise and interpolation are one stencil: nothing is blurred twice.
//!
//! **The share of the noise.** Where the variance was raised, or nothing is disturbed, a part of the weights interpolates
//! between directions. Of the way from the mean to a grid point, only the share of the noise in the variance is a
//! disturbance, which also moves the tip. So the covariance of direction and position is that of the noise.
//!
//! **The rim.** A direction beyond the cone ends the execution. Its probability is that of a normal distribution beyond
//! the rim, whatever grid points are near it; the weights of the grid points within the cone are scaled to the rest.

use ppvi::{Error, Result};

use crate::space::arc::Vec3;

/// A direction after a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tap {
    /// Number of the direction.
    pub direction: u32,
    /// Probability among those within the cone.
    pub weight: f64,
    /// Number, 0 to 2, of its grid point along u and v.
    pub place: [usize; 2],
}

/// The distribution of a disturbed direction on the grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Stencil {
    /// Directions within the cone; their probabilities sum to one.
    pub taps: Vec<Tap>,
    /// Probability of leaving the cone.
    pub lost: f64,
    /// Disturbances that lead to the grid points along u and v: coordinates, rad, relative to the mean.
    pub kicks: [[f64; 3]; 2],
    /// Share of the noise in the variance along u and v.
    pub shares: [f64; 2],
    /// Variance of the noise along u and v, rad^2.
    pub variances: [f64; 2],
    /// Coordinates (u, v) of the mean, rad.
    mean: [f64; 2],
}

impl Stencil {
    /// The mean direction after the disturbance that leads to a grid point.
    pub fn kicked(&self, [i, j]: [usize; 2]) -> Vec3 {
        tangent_at([self.mean[0] + self.kicks[0][i], self.mean[1] + self.kicks[1][j]])
    }
}

/// Probability below which nothing is lost at the rim.
const NEGLIGIBLE: f64 = 1e-7;

/// The directions of a cone about the axis.
#[derive(Debug, Clone, PartialEq)]
pub struct DirectionGrid {
    /// Half angle of the cone, rad.
    cone: f64,
    /// Spacing, rad.
    spacing: f64,
    /// Grid coordinates of each direction.
    cells: Vec<[i32; 2]>,
    /// Grid points from the axis to the rim.
    reach: i32,
    /// Number of the direction at grid coordinates from -reach to reach, -1 outside the cone.
    numbers: Vec<i32>,
}

impl DirectionGrid {
    /// Makes the grid of a cone with this half angle and this spacing, rad.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a half angle outside (0, 80 degrees], or a spacing that is not positive, larger than the
    /// half angle or below 0.5 degrees.
    pub fn new(cone: f64, spacing: f64) -> Result<Self> {
        if !(cone > 0.0 && cone <= 80f64.to_radians()) {
            return Err(Error::parameter("cone_deg", cone.to_degrees(), "must be above 0 and at most 80"));
        }
        if !(spacing >= 0.5f64.to_radians() - 1e-12 && spacing <= cone) {
            let rule = "must be at least 0.5 and at most the half angle of the cone";
            return Err(Error::parameter("direction_spacing_deg", spacing.to_degrees(), rule));
        }
        let reach = (cone / spacing + 1e-9).floor() as i32;
        let mut grid = DirectionGrid { cone, spacing, cells: Vec::new(), reach, numbers: Vec::new() };
        for u in -reach..=reach {
            for v in -reach..=reach {
                let within = f64::from(u).hypot(f64::from(v)) * spacing <= cone + 1e-9;
                grid.numbers.push(if within { grid.cells.len() as i32 } else { -1 });
                if within {
                    grid.cells.push([u, v]);
                }
            }
        }
        Ok(grid)
    }

    /// Number of directions.
    pub fn count(&self) -> usize {
        self.cells.len()
    }

    /// Half angle of the cone, rad.
    pub fn cone(&self) -> f64 {
        self.cone
    }

    /// Number of the direction at grid coordinates.
    fn number(&self, [u, v]: [i32; 2]) -> Option<u32> {
        let within = |at: i32| (-self.reach..=self.reach).contains(&at);
        let number = |u: i32, v: i32| self.numbers[((u + self.reach) * (2 * self.reach + 1) + v + self.reach) as usize];
        (within(u) && within(v)).then(|| number(u, v)).and_then(|number| u32::try_from(number).ok())
    }

    /// The unit vector of a direction.
    pub fn tangent(&self, direction: usize) -> Vec3 {
        tangent_at(self.cells[direction].map(|cell| f64::from(cell) * self.spacing))
    }

    /// Coordinates (u, v), rad, of a unit vector.
    pub fn coordinates([x, y, z]: Vec3) -> [f64; 2] {
        let across = y.hypot(z);
        let scale = if across > 1e-12 { across.atan2(x) / across } else { 1.0 };
        [y * scale, z * scale]
    }

    /// Whether a unit vector lies in the cone.
    pub fn contains(&self, tangent: Vec3) -> bool {
        let [u, v] = Self::coordinates(tangent);
        u.hypot(v) <= self.cone + 1e-9
    }

    /// The direction nearest to a unit vector, in the coordinates of the grid.
    pub fn nearest(&self, tangent: Vec3) -> Option<u32> {
        self.number(Self::coordinates(tangent).map(|x| (x / self.spacing).round() as i32))
    }

    /// The distribution of a direction with this mean after noise of this variance, rad^2, on the grid.
    /// [The module](self) has the mathematics.
    pub fn stencil(&self, mean: Vec3, variance: f64) -> Stencil {
        let [u, v] = Self::coordinates(mean);
        let angle = u.hypot(v);
        let lost = normal_beyond((self.cone - angle) / variance.sqrt().max(1e-12));
        let lost = if lost < NEGLIGIBLE { 0.0 } else { lost };
        let stretch = if angle > 1e-6 { (angle / angle.sin()).powi(2) } else { 1.0 };
        let [eu, ev] = if angle > 1e-6 { [u / angle, v / angle] } else { [1.0, 0.0] };
        let cells = variance / (self.spacing * self.spacing);
        let across = |e: f64| cells * (e * e + stretch * (1.0 - e * e));
        let (at_u, at_v) = (Marginal::new(u / self.spacing, across(eu)), Marginal::new(v / self.spacing, across(ev)));
        let corner = cells * (1.0 - stretch) * eu * ev / f64::from(4 * at_u.stride * at_v.stride);
        let least = |pairs: [[usize; 2]; 2]| {
            pairs.map(|[i, j]| at_u.weights[i] * at_v.weights[j]).into_iter().fold(1.0, f64::min)
        };
        let corner = corner.min(least([[0, 2], [2, 0]])).max(-least([[0, 0], [2, 2]]));
        let mut taps = Vec::with_capacity(9);
        // Those of equal v together: their landings have a column of the grid in common.
        for j in 0..3 {
            for i in 0..3 {
                let side = (i as f64 - 1.0) * (j as f64 - 1.0);
                let weight = at_u.weights[i] * at_v.weights[j] + side * corner;
                let cell = [at_u.cell(i), at_v.cell(j)];
                if let Some(direction) = self.number(cell).filter(|_| weight > 0.0) {
                    taps.push(Tap { direction, weight, place: [i, j] });
                }
            }
        }
        let sum: f64 = taps.iter().map(|tap| tap.weight).sum();
        let kicks =
            [at_u.kicks(u / self.spacing), at_v.kicks(v / self.spacing)].map(|axis| axis.map(|x| x * self.spacing));
        let shares = [at_u.share, at_v.share];
        let variances = [eu, ev].map(|e| across(e) * self.spacing * self.spacing);
        if sum < NEGLIGIBLE || lost > 1.0 - NEGLIGIBLE {
            return Stencil { taps: Vec::new(), lost: 1.0, kicks, shares, variances, mean: [u, v] };
        }
        taps.iter_mut().for_each(|tap| tap.weight /= sum);
        Stencil { taps, lost, kicks, shares, variances, mean: [u, v] }
    }
}

/// The unit vector with the coordinates (u, v), rad.
fn tangent_at([u, v]: [f64; 2]) -> Vec3 {
    let angle = u.hypot(v);
    let scale = if angle > 0.0 { angle.sin() / angle } else { 1.0 };
    [angle.cos(), u * scale, v * scale]
}

/// The weights of three grid points along an axis.
struct Marginal {
    centre: i32,
    stride: i32,
    weights: [f64; 3],
    /// Share of the noise in the variance.
    share: f64,
}

impl Marginal {
    /// Mean and variance in cells.
    fn new(mean: f64, variance: f64) -> Self {
        let centre = mean.round();
        let f = mean - centre;
        let stride = (3.0 * variance).sqrt().round().max(1.0);
        let noise = variance;
        let variance = noise.max(f.abs() * (stride - f.abs()));
        let share = if variance > 0.0 { noise / variance } else { 0.0 };
        let side = |sign: f64| ((variance + f * f + sign * stride * f) / (2.0 * stride * stride)).max(0.0);
        let (low, high) = (side(-1.0), side(1.0));
        let weights = [low, (1.0 - low - high).max(0.0), high];
        Marginal { centre: centre as i32, stride: stride as i32, weights, share }
    }

    /// The part of the way from the mean to the grid points that is noise.
    fn kicks(&self, mean: f64) -> [f64; 3] {
        [0, 1, 2].map(|at| self.share * (f64::from(self.cell(at)) - mean))
    }

    fn cell(&self, at: usize) -> i32 {
        self.centre + (at as i32 - 1) * self.stride
    }
}

/// Probability that a standard normal variable is larger than `x`, to 1e-7 (Abramowitz and Stegun, 26.2.17).
fn normal_beyond(x: f64) -> f64 {
    if x < 0.0 {
        return 1.0 - normal_beyond(-x);
    }
    if x > 40.0 {
        return 0.0;
    }
    let t = 1.0 / (1.0 + 0.231_641_9 * x);
    let polynomial =
        t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt() * polynomial
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::arc::unit;

    #[test]
    fn a_stencil_has_the_mean_and_the_covariance_of_the_noise() {
        let grid = DirectionGrid::new(0.9, 0.07).unwrap();
        for (tangent, sigma) in
            [([1.0, 0.1, 0.05], 0.04), ([1.0, -0.3, 0.33], 0.05), ([1.0, 0.0, 0.0], 0.15), ([1.0, 0.4, 0.1], 0.09)]
        {
            let stencil = grid.stencil(unit(tangent), sigma * sigma);
            let Stencil { taps, lost, .. } = &stencil;
            let mean = DirectionGrid::coordinates(unit(tangent));
            assert!(*lost < 1e-3 && taps.iter().all(|tap| tap.weight > 0.0));
            let at = |tap: &Tap| grid.cells[tap.direction as usize].map(|cell| f64::from(cell) * grid.spacing);
            assert!((taps.iter().map(|tap| tap.weight).sum::<f64>() - 1.0).abs() < 1e-12);
            // All of the variance is noise, so disturbances lead to the grid points themselves.
            assert!(stencil.shares.iter().all(|share| (share - 1.0).abs() < 1e-12));
            for tap in taps {
                let (kicked, point) = (stencil.kicked(tap.place), grid.tangent(tap.direction as usize));
                assert!((0..3).all(|axis| (kicked[axis] - point[axis]).abs() < 1e-12));
            }
            let moment = |f: &dyn Fn([f64; 2]) -> f64| taps.iter().map(|tap| tap.weight * f(at(tap))).sum::<f64>();
            for axis in 0..2 {
                assert!((moment(&|x| x[axis]) - mean[axis]).abs() < 1e-9);
            }
            let angle = mean[0].hypot(mean[1]);
            let stretch = if angle > 0.0 { (angle / angle.sin()).powi(2) } else { 1.0 };
            let e = if angle > 0.0 { mean.map(|x| x / angle) } else { [1.0, 0.0] };
            for axis in 0..2 {
                let expected = sigma * sigma * (e[axis] * e[axis] + stretch * (1.0 - e[axis] * e[axis]));
                let variance = moment(&|x| (x[axis] - mean[axis]).powi(2));
                assert!((variance / expected - 1.0).abs() < 1e-6, "{variance} {expected}");
            }
        }
    }

    #[test]
    fn between_directions_that_are_far_apart_little_of_the_way_is_noise() {
        let grid = DirectionGrid::new(0.9, 0.1).unwrap();
        let mean = tangent_at([0.23, -0.1]);
        let stencil = grid.stencil(mean, 0.02 * 0.02);
        assert!(stencil.shares[0] < 0.3 && stencil.shares[1] == 1.0);
        assert!((stencil.kicks[0][2] - stencil.shares[0] * 0.07).abs() < 1e-12);
        let still = grid.stencil(mean, 0.0);
        assert!(still.taps.iter().all(|tap| (still.kicked(tap.place)[1] - mean[1]).abs() < 1e-12));
    }

    #[test]
    fn coordinates_and_tangents_are_inverse() {
        let grid = DirectionGrid::new(0.8, 0.1).unwrap();
        for number in 0..grid.count() {
            assert_eq!(grid.nearest(grid.tangent(number)), Some(number as u32));
        }
        assert!(!grid.contains(unit([1.0, 1.1, 0.0])) && grid.contains(unit([1.0, 0.9, 0.0])));
        assert!((normal_beyond(1.959_964) - 0.025).abs() < 1e-6 && (normal_beyond(-1.0) - 0.841_345).abs() < 1e-6);
    }

    #[test]
    fn beyond_the_rim_everything_is_lost() {
        let grid = DirectionGrid::new(0.5, 0.1).unwrap();
        let at = |angle: f64| grid.stencil([angle.cos(), angle.sin(), 0.0], 0.03 * 0.03).lost;
        assert!(at(0.3) < 1e-6 && (at(0.5) - 0.5).abs() < 1e-6 && at(0.7) > 1.0 - 1e-6);
    }
}
