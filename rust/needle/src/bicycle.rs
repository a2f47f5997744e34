//! The planar bicycle model of a bevel-tip needle (Webster et al. 2006; section 6.2 of the thesis).
//!
//! The tip moves on a circle of radius rho, to the side of its bevel; an infinite radius is a straight line. A step is
//! an arc of a given length, so the heading changes by the length over rho. Without a given length a step is that of
//! the thesis: delta = 2 pi rho / headings, so that the heading changes by one heading step alpha = 2 pi / headings.
//! Turning the needle by 180 degrees mirrors the arc.

use std::f64::consts::{FRAC_PI_2, TAU};

use ppvi::{Error, Result};

/// Curvature radius and step of a needle, and the number of headings.
///
/// # Examples
/// ```
/// use needle::Bicycle;
///
/// let needle = Bicycle::new(40.0, 60)?;
/// assert!((needle.step_length() - 4.19).abs() < 0.01);
/// let [x, y] = needle.displacement(0.0, 1.0, 1.0);
/// assert!(x > 4.0 && y > 0.0);
/// # Ok::<(), ppvi::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bicycle {
    /// Radius of curvature rho, mm.
    pub radius: f64,
    /// Number of headings of a full turn.
    pub headings: usize,
    /// Length of a step, mm; `None`: the arc that turns by one heading step.
    pub step: Option<f64>,
}

impl Bicycle {
    /// Makes a needle from its radius of curvature, mm, and its number of headings.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a radius that is not positive and finite, or for no headings or more than a million.
    pub fn new(radius: f64, headings: usize) -> Result<Self> {
        if !(radius > 0.0 && radius.is_finite()) {
            return Err(Error::parameter("curvature_radius_mm", radius, "must be positive and finite"));
        }
        if headings == 0 || headings > 1_000_000 {
            return Err(Error::parameter("headings", headings, "must be between 1 and 1,000,000"));
        }
        Ok(Bicycle { radius, headings, step: None })
    }

    /// The needle with steps of `length` mm, whatever their curvature.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a length that is not positive and finite, or with which a step turns by more than a
    /// quarter turn.
    pub fn with_step(self, length: f64) -> Result<Self> {
        if !(length > 0.0 && length.is_finite()) {
            return Err(Error::parameter("step_mm", length, "must be positive and finite"));
        }
        let needle = Bicycle { step: Some(length), ..self };
        if needle.turn() > FRAC_PI_2 {
            let rule = "must not turn the needle by more than 90 degrees";
            return Err(Error::parameter("step_mm", length, rule));
        }
        Ok(needle)
    }

    /// Heading step alpha, rad.
    pub fn heading_step(&self) -> f64 {
        TAU / self.headings as f64
    }

    /// Arc length of a step, mm.
    pub fn step_length(&self) -> f64 {
        self.step.unwrap_or(self.radius * self.heading_step())
    }

    /// Change of the heading in a step, rad, but for its sign.
    pub fn turn(&self) -> f64 {
        self.step.map_or(self.heading_step(), |length| length / self.radius)
    }

    /// Displacement, mm, after the fraction `t` of a step that starts at `heading` (rad) with bevel -1 or +1.
    pub fn displacement(&self, heading: f64, bevel: f64, t: f64) -> [f64; 2] {
        // The chord form of rho b (sin(h + b t alpha) - sin h) is exact, and for large radii it does not subtract
        // nearly equal numbers.
        let half = 0.5 * t * self.turn();
        let chord = if half > 0.0 { 2.0 * self.radius * half.sin() } else { t * self.step_length() };
        let (sin, cos) = (heading + bevel * half).sin_cos();
        [chord * cos, chord * sin]
    }

    /// The angle of heading index `k`, rad.
    pub fn heading(&self, k: usize) -> f64 {
        k as f64 * self.heading_step()
    }

    /// The heading index nearest to an angle, rad.
    pub fn nearest_heading(&self, heading: f64) -> usize {
        let turns = heading / self.heading_step();
        (turns.round().rem_euclid(self.headings as f64) as usize) % self.headings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chord_is_the_arc_of_the_thesis() {
        let needle = Bicycle::new(40.0, 60).unwrap();
        for k in 0..60 {
            for bevel in [-1.0, 1.0] {
                let (h, a) = (needle.heading(k), needle.heading_step());
                let x = 40.0 * bevel * ((h + bevel * a).sin() - h.sin());
                let y = -40.0 * bevel * ((h + bevel * a).cos() - h.cos());
                let d = needle.displacement(h, bevel, 1.0);
                assert!((d[0] - x).abs() < 1e-12 && (d[1] - y).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_step_of_any_length_is_an_arc_and_without_curvature_a_line() {
        let thesis = Bicycle::new(40.0, 60).unwrap();
        let same = Bicycle::new(40.0, 240).unwrap().with_step(thesis.step_length()).unwrap();
        assert!((same.turn() - thesis.turn()).abs() < 1e-15);
        let (a, b) = (thesis.displacement(0.3, -1.0, 0.7), same.displacement(0.3, -1.0, 0.7));
        assert!((a[0] - b[0]).abs() < 1e-12 && (a[1] - b[1]).abs() < 1e-12);
        let straight = Bicycle { radius: f64::INFINITY, ..same };
        assert_eq!((straight.turn(), straight.displacement(0.0, 1.0, 0.5)), (0.0, [0.5 * same.step_length(), 0.0]));
        assert!(same.with_step(0.0).is_err() && same.with_step(f64::NAN).is_err() && same.with_step(63.0).is_err());
    }

    #[test]
    fn headings_wrap() {
        let needle = Bicycle::new(40.0, 60).unwrap();
        assert_eq!(needle.nearest_heading(-0.5 * TAU / 60.0 + 1e-9), 0);
        assert_eq!(needle.nearest_heading(-TAU / 60.0), 59);
        assert_eq!(needle.nearest_heading(5.0 * TAU + 0.1), 1);
    }
}
