//! The price of insertion close to obstacles.

use ppvi::{Error, Result};

use crate::area::Area;

/// A price per mm of insertion for steps that begin within a distance of an obstacle. The default has no price.
///
/// # Examples
/// ```
/// use needle::{Area, Clearance};
///
/// let clearance = Clearance::new(&[Area::disc([5.0, 5.0], 1.0)?], 2.0, 0.5)?;
/// assert_eq!((clearance.cost_per_mm([5.0, 8.0]), clearance.cost_per_mm([5.0, 8.1])), (0.5, 0.0));
/// # Ok::<(), ppvi::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Clearance {
    /// The obstacles, wider by the distance.
    areas: Vec<Area>,
    cost_per_mm: f64,
}

impl Clearance {
    /// Makes the price: obstacles, distance in mm, and cost per mm.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a distance or cost that is negative or not finite.
    pub fn new(obstacles: &[Area], distance: f64, cost_per_mm: f64) -> Result<Self> {
        for (name, value) in [("clearance_mm", distance), ("clearance_per_mm", cost_per_mm)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(Error::parameter(name, value, "must be finite and not negative"));
            }
        }
        let priced = if cost_per_mm > 0.0 { obstacles } else { &[] };
        let areas = priced.iter().cloned().map(|area| area.with_margin(distance)).collect::<Result<_>>()?;
        Ok(Clearance { areas, cost_per_mm })
    }

    /// Whether no place has a price.
    pub fn is_free(&self) -> bool {
        self.areas.is_empty()
    }

    /// The price per mm of a step that begins at a position, mm.
    #[inline]
    pub fn cost_per_mm(&self, place: [f64; 2]) -> f64 {
        if self.areas.iter().any(|area| area.contains(place)) { self.cost_per_mm } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_numbers_are_refused_and_no_price_is_no_price() {
        let disc = [Area::disc([0.0, 0.0], 1.0).unwrap()];
        for (distance, cost) in [(-1.0, 1.0), (f64::NAN, 1.0), (1.0, f64::INFINITY), (1.0, -0.1)] {
            assert!(Clearance::new(&disc, distance, cost).is_err());
        }
        assert!(Clearance::new(&disc, 1.0, 0.0).unwrap().is_free() && Clearance::default().is_free());
        assert!(!Clearance::new(&disc, 0.0, 1.0).unwrap().is_free());
    }
}
