//! Shape of a needle in layered tissue: an inextensible Cosserat rod with an intrinsic curvature.
//!
//! The curvatures along the normal n and the binormal b, and the twist, w = (kn, kb, tau), obey the Euler-Poincare
//! equation of a rod with the bending stiffness EI and the torsional stiffness GJ = ratio EI:
//!
//! ```text
//! kn'  = k0' + (1 - ratio) kb tau
//! kb'  = k0 tau - (1 - ratio) kn tau
//! tau' = -k0 kb / ratio
//! ```
//!
//! The frame (t, n, b) turns by the rotation vector (tau, -kb, kn) per length, and the position moves along t. The
//! curvature is integrated by the Runge-Kutta method of fourth order, the frame by the Magnus expansion of fourth order
//! on the group of rigid motions, so that it stays orthonormal. `docs/explanation/needle-shape.md` has the equations.

use ppvi::{Error, Result};

/// Longest step of the integration, mm. The error of a needle of 200 mm and 1/100 mm of curvature is below 1e-7 mm.
const STEP_MM: f64 = 1.0;

/// Angle, rad, of a step below which the coefficients of the rotation are those of their series.
const SMALL_RAD: f64 = 1e-4;

/// A needle in tissue with layers of one intrinsic curvature each.
///
/// # Examples
/// ```
/// use needle::Rod;
///
/// let rod = Rod::new(100.0, &[0.002, 0.004], &[60.0], 1.0 / 1.3)?;
/// assert!((rod.intrinsic(80.0).0 - 0.004 * 0.2 * 0.2).abs() < 1e-12);
/// let straight = Rod::new(100.0, &[0.0], &[], 1.0 / 1.3)?.stations([0.0; 3], &[100.0])?;
/// assert_eq!(straight[0].position, [100.0, 0.0, 0.0]);
/// # Ok::<(), ppvi::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Rod<'a> {
    length: f64,
    intrinsic: &'a [f64],
    boundaries: &'a [f64],
    ratio: f64,
}

/// Position, mm, axes t, n, b, and curvatures kn, kb and twist, 1/mm, at one place of a needle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Station {
    /// Position, mm.
    pub position: [f64; 3],
    /// The axes t, n and b.
    pub axes: [[f64; 3]; 3],
    /// The curvatures along n and b, and the twist, 1/mm.
    pub curvature: [f64; 3],
}

impl<'a> Rod<'a> {
    /// Makes a rod from its inserted length, mm, the intrinsic curvature of each layer, 1/mm, the places of the
    /// boundaries between the layers, mm from the entry, and the ratio GJ/EI.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a length or a ratio that is not positive and finite, a curvature that is not finite,
    /// another number of boundaries than layers less one, or boundaries that do not increase from zero.
    pub fn new(length: f64, intrinsic: &'a [f64], boundaries: &'a [f64], ratio: f64) -> Result<Self> {
        for (name, value) in [("length_mm", length), ("torsion_ratio", ratio)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::parameter(name, value, "must be positive and finite"));
            }
        }
        if let Some(wrong) = intrinsic.iter().find(|value| !value.is_finite()) {
            return Err(Error::parameter("intrinsic_per_mm", wrong, "must be finite"));
        }
        if intrinsic.len() != boundaries.len() + 1 {
            return Err(Error::parameter("boundaries_mm", boundaries.len(), "must be one fewer than the layers"));
        }
        let mut before = 0.0;
        for &place in boundaries {
            if place <= before || place.is_nan() {
                return Err(Error::parameter("boundaries_mm", place, "must increase from the entry on"));
            }
            before = place;
        }
        Ok(Rod { length, intrinsic, boundaries, ratio })
    }

    /// The intrinsic curvature k0, 1/mm, and its derivative, 1/mm^2, at a place from the entry, mm: the solution of
    /// k0'' = 2 c / L^2, with the constant c of each layer, and k0 = k0' = 0 at the tip.
    pub fn intrinsic(&self, place: f64) -> (f64, f64) {
        let (mut curvature, mut slope) = (0.0, 0.0);
        let mut low = 0.0;
        for (number, constant) in self.intrinsic.iter().enumerate() {
            let high = self.boundaries.get(number).map_or(self.length, |boundary| boundary.min(self.length));
            let from = place.max(low);
            if high > from {
                curvature += constant * ((high - place).powi(2) - (from - place).powi(2));
                slope -= 2.0 * constant * (high - from);
            }
            low = high;
        }
        let scale = self.length * self.length;
        (curvature / scale, slope / scale)
    }

    /// The needle at places from the entry, mm, in increasing order, with the curvatures and the twist at the entry.
    ///
    /// # Errors
    /// [`Error::Parameter`] for places that decrease or are not on the needle, and for curvatures that are not finite.
    pub fn stations(&self, start: [f64; 3], places: &[f64]) -> Result<Vec<Station>> {
        if let Some(wrong) = start.iter().find(|value| !value.is_finite()) {
            return Err(Error::parameter("start_per_mm", wrong, "must be finite"));
        }
        let mut now = Station { position: [0.0; 3], axes: IDENTITY, curvature: start };
        let mut stations = Vec::with_capacity(places.len());
        let mut at = 0.0;
        for &place in places {
            if !(place >= at && place <= self.length * (1.0 + 1e-12)) {
                return Err(Error::parameter("places_mm", place, "must increase from 0 to the inserted length"));
            }
            while at < place {
                // A step ends at a boundary, where the second derivative of the intrinsic curvature jumps.
                let boundary = self.boundaries.iter().copied().find(|&boundary| boundary > at).unwrap_or(place);
                let end = place.min(boundary);
                let count = ((end - at) / STEP_MM).ceil().max(1.0);
                let step = (end - at) / count;
                for number in 0..count as usize {
                    now = self.step(&now, at + step * number as f64, step);
                }
                at = end;
            }
            stations.push(now);
        }
        Ok(stations)
    }

    /// The rates of kn, kb and tau, 1/mm^2.
    fn rates(&self, (intrinsic, slope): (f64, f64), [kn, kb, tau]: [f64; 3]) -> [f64; 3] {
        let ratio = self.ratio;
        [slope + (1.0 - ratio) * kb * tau, intrinsic * tau - (1.0 - ratio) * kn * tau, -intrinsic * kb / ratio]
    }

    fn step(&self, now: &Station, at: f64, step: f64) -> Station {
        let (first, last) = (now.curvature, at + step);
        let (begin, middle, end) = (self.intrinsic(at), self.intrinsic(at + step / 2.0), self.intrinsic(last));
        let a = self.rates(begin, first);
        let b = self.rates(middle, moved(first, step / 2.0, a));
        let c = self.rates(middle, moved(first, step / 2.0, b));
        let d = self.rates(end, moved(first, step, c));
        let mut next = first;
        for k in 0..3 {
            next[k] += step / 6.0 * (a[k] + 2.0 * (b[k] + c[k]) + d[k]);
        }
        // The curvature at half of the step, by Hermite's polynomial.
        let slope = self.rates(end, next);
        let mut half = [0.0; 3];
        for k in 0..3 {
            half[k] = (first[k] + next[k]) / 2.0 + step / 8.0 * (a[k] - slope[k]);
        }
        let (u, v, w) = (turn(first), turn(half), turn(next));
        // Magnus' expansion: the mean twist of the step, and its commutator.
        let square = step * step / 12.0;
        let mixed = cross(u, w);
        let mut rotation = [0.0; 3];
        for k in 0..3 {
            rotation[k] = step / 6.0 * (u[k] + 4.0 * v[k] + w[k]) + square * mixed[k];
        }
        // The commutator of the translations along t: (u - w) x t.
        let shift = [step, square * (u[2] - w[2]), -square * (u[1] - w[1])];
        let (turned, moved_by) = rigid(rotation, shift);
        let mut axes = [[0.0; 3]; 3];
        let mut position = now.position;
        for k in 0..3 {
            for (number, axis) in now.axes.iter().enumerate() {
                position[k] += moved_by[number] * axis[k];
                for (column, new) in axes.iter_mut().enumerate() {
                    new[k] += turned[column][number] * axis[k];
                }
            }
        }
        Station { position, axes, curvature: next }
    }
}

const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn moved(from: [f64; 3], length: f64, rate: [f64; 3]) -> [f64; 3] {
    [from[0] + length * rate[0], from[1] + length * rate[1], from[2] + length * rate[2]]
}

/// Rotation vector per length in the axes t, n, b.
fn turn([kn, kb, tau]: [f64; 3]) -> [f64; 3] {
    [tau, -kb, kn]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The columns of the rotation by a vector, and the translation of the rigid motion with this vector and `shift`.
fn rigid(rotation: [f64; 3], shift: [f64; 3]) -> ([[f64; 3]; 3], [f64; 3]) {
    let square = rotation.iter().map(|value| value * value).sum::<f64>();
    let angle = square.sqrt();
    let (sine, versine, rest) = if angle < SMALL_RAD {
        (1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        let (sin, cos) = angle.sin_cos();
        (sin / angle, (1.0 - cos) / square, (angle - sin) / (square * angle))
    };
    let apply = |vector: [f64; 3], first: f64, second: f64| {
        let once = cross(rotation, vector);
        let twice = cross(rotation, once);
        [0, 1, 2].map(|k| vector[k] + first * once[k] + second * twice[k])
    };
    (IDENTITY.map(|axis| apply(axis, sine, versine)), apply(shift, versine, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_curvature_is_a_circle() {
        // Without intrinsic curvature, a rod without twist keeps its curvature.
        let rod = Rod::new(100.0, &[0.0], &[], 0.8).unwrap();
        let end = rod.stations([0.01, 0.0, 0.0], &[30.0, 100.0]).unwrap()[1];
        assert!((end.position[0] - 100.0 * 1f64.sin()).abs() < 1e-11);
        assert!((end.position[1] - 100.0 * (1.0 - 1f64.cos())).abs() < 1e-11);
        assert_eq!(end.position[2], 0.0);
        assert_eq!(end.curvature, [0.01, 0.0, 0.0]);
    }

    #[test]
    fn a_layer_that_is_cut_in_two_is_the_same_layer() {
        let one = Rod::new(100.0, &[0.003], &[], 0.8).unwrap();
        let two = Rod::new(100.0, &[0.003, 0.003], &[41.7], 0.8).unwrap();
        let (a, b) = (one.stations([0.003, 1e-3, 2e-3], &[100.0]), two.stations([0.003, 1e-3, 2e-3], &[100.0]));
        let (a, b) = (a.unwrap()[0], b.unwrap()[0]);
        for k in 0..3 {
            assert!((a.position[k] - b.position[k]).abs() < 1e-9);
        }
    }

    #[test]
    fn wrong_rods_are_refused() {
        assert!(Rod::new(0.0, &[0.0], &[], 0.8).is_err());
        assert!(Rod::new(10.0, &[f64::NAN], &[], 0.8).is_err());
        assert!(Rod::new(10.0, &[0.0, 0.0], &[], 0.8).is_err());
        assert!(Rod::new(10.0, &[0.0; 3], &[5.0, 5.0], 0.8).is_err());
        let rod = Rod::new(10.0, &[0.0], &[], 0.8).unwrap();
        assert!(rod.stations([f64::NAN, 0.0, 0.0], &[1.0]).is_err());
        assert!(rod.stations([0.0; 3], &[5.0, 4.0]).is_err());
        assert!(rod.stations([0.0; 3], &[11.0]).is_err());
    }
}
