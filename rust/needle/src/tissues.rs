//! The curvature of the needle by position: layers by depth, and regions.

use ppvi::{Error, Result};

use crate::area::{Area, CLOSED_MM};
use crate::bicycle::Bicycle;

/// The radius of curvature by position. Outside all layers and regions it is the needle's nominal radius.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tissues {
    /// (first x, mm; radius, mm), by increasing x.
    layers: Vec<(f64, f64)>,
    /// (region; radius, mm). Of overlapping regions the last one applies.
    regions: Vec<(Area, f64)>,
}

impl Tissues {
    /// Makes tissues from layers (first x, mm; radius, mm) and regions (area; radius, mm).
    ///
    /// A layer extends from its first x (to within [`CLOSED_MM`]) to that of the next layer. A region contains its
    /// border and takes precedence over layers; of overlapping regions the last one applies.
    ///
    /// # Errors
    /// [`Error::Parameter`] for layers that do not begin at increasing finite x, or a radius that is not positive. An
    /// infinite radius is a straight path, for which steps must have a length of their own.
    pub fn new(layers: Vec<(f64, f64)>, regions: Vec<(Area, f64)>) -> Result<Self> {
        if layers.iter().any(|(from, _)| !from.is_finite()) || !layers.is_sorted_by(|a, b| a.0 < b.0) {
            return Err(Error::parameter("layers", format!("{layers:?}"), "must begin at increasing finite depths"));
        }
        let radii = layers.iter().map(|layer| layer.1).chain(regions.iter().map(|region| region.1));
        if let Some(radius) = radii.into_iter().find(|radius| radius.is_nan() || *radius <= 0.0) {
            return Err(Error::parameter("curvature_radius_mm", radius, "must be positive"));
        }
        Ok(Tissues { layers, regions })
    }

    /// Whether the curvature is the same everywhere.
    pub fn is_uniform(&self) -> bool {
        self.layers.is_empty() && self.regions.is_empty()
    }

    /// Whether the path is straight somewhere.
    pub(crate) fn is_straight_somewhere(&self) -> bool {
        self.radii().any(f64::is_infinite)
    }

    /// The radii of all layers and regions, mm.
    pub(crate) fn radii(&self) -> impl Iterator<Item = f64> {
        self.layers.iter().map(|layer| layer.1).chain(self.regions.iter().map(|region| region.1))
    }

    /// `needle` with the radius of curvature at a position, mm.
    #[inline]
    pub fn needle_at(&self, needle: Bicycle, place: [f64; 2]) -> Bicycle {
        if self.is_uniform() {
            return needle;
        }
        let region = self.regions.iter().rev().find(|(area, _)| area.contains(place)).map(|region| region.1);
        let layer = || self.layers.iter().rev().find(|(from, _)| *from <= place[0] + CLOSED_MM).map(|layer| layer.1);
        Bicycle { radius: region.or_else(layer).unwrap_or(needle.radius), ..needle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_region_counts_before_layers_before_the_needle() {
        let square =
            |low: f64, high: f64| Area::polygon(vec![[low, low], [high, low], [high, high], [low, high]]).unwrap();
        let tissues =
            Tissues::new(vec![(10.0, 50.0), (20.0, 60.0)], vec![(square(5.0, 15.0), 70.0), (square(12.0, 30.0), 80.0)])
                .unwrap();
        let needle = Bicycle::new(40.0, 60).unwrap();
        let radius = |x, y| tissues.needle_at(needle, [x, y]).radius;
        assert_eq!(
            [radius(0.0, 0.0), radius(10.0, 0.0), radius(19.9, 0.0), radius(25.0, 0.0)],
            [40.0, 50.0, 50.0, 60.0]
        );
        assert_eq!(
            [radius(6.0, 6.0), radius(13.0, 13.0), radius(30.0, 30.0), radius(15.0, 5.0)],
            [70.0, 80.0, 80.0, 70.0]
        );
        assert!(Tissues::default().is_uniform() && !tissues.is_uniform());
        assert!(Tissues::new(vec![(5.0, 1.0), (5.0, 2.0)], vec![]).is_err());
        assert!(Tissues::new(vec![(5.0, f64::NAN)], vec![]).is_err());
    }
}
