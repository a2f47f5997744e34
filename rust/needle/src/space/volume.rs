//! A volume of voxels: what the tip meets, and how strongly the needle bends.

use ppvi::space::voxel;
use ppvi::{Error, Result};

use crate::space::arc::Vec3;

/// Voxels of equal size. The centre of voxel `(i, j, k)` is at `(i, j, k) * spacing` mm: slice along the axis, y, z.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    shape: [usize; 3],
    spacing: Vec3,
    codes: Vec<u8>,
    /// Number of the tissue of each voxel; empty if there is only one.
    tissues: Vec<u8>,
    /// Curvature of the needle in each tissue, 1/mm.
    curvatures: Vec<f64>,
}

impl Volume {
    /// Makes a volume from its shape, its spacing, mm, the codes of [`voxel`] `[i][j][k]`, the number of the tissue of
    /// each voxel (empty if there is only one), and the radius of the needle in each tissue, mm (infinite: straight).
    ///
    /// # Errors
    /// [`Error::Parameter`] for a spacing or radius that is not positive, codes above 3, or tissues without a radius;
    /// [`Error::Length`] for arrays of another shape.
    pub fn new(shape: [usize; 3], spacing: Vec3, codes: Vec<u8>, tissues: Vec<u8>, radii: &[f64]) -> Result<Self> {
        let expected = shape.iter().product();
        for (name, found) in [("voxels", codes.len()), ("tissues", tissues.len())] {
            if found != expected && !(name == "tissues" && found == 0) {
                return Err(Error::Length { name, expected, found });
            }
        }
        if !spacing.iter().all(|s| *s > 0.0 && s.is_finite()) {
            return Err(Error::parameter("spacing_mm", format!("{spacing:?}"), "must be positive and finite"));
        }
        if let Some(code) = codes.iter().find(|code| **code > voxel::OUTSIDE) {
            return Err(Error::parameter("voxels", code, "must be codes of voxels, 0 to 3"));
        }
        if let Some(radius) = radii.iter().find(|radius| radius.is_nan() || **radius <= 0.0) {
            return Err(Error::parameter("curvature_radius_mm", radius, "must be positive"));
        }
        let highest = tissues.iter().copied().max().unwrap_or(0);
        if usize::from(highest) >= radii.len() {
            return Err(Error::parameter("tissues", highest, "must have a radius of curvature"));
        }
        let curvatures = radii.iter().map(|radius| radius.recip()).collect();
        Ok(Volume { shape, spacing, codes, tissues, curvatures })
    }

    /// Voxels along the axis, y and z.
    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Size of a voxel, mm.
    pub fn spacing(&self) -> Vec3 {
        self.spacing
    }

    /// Codes `[i][j][k]`.
    pub fn codes(&self) -> &[u8] {
        &self.codes
    }

    /// Numbers of tissues `[i][j][k]`; empty if there is only one.
    pub fn tissues(&self) -> &[u8] {
        &self.tissues
    }

    /// Curvature in each tissue, 1/mm.
    pub fn curvatures(&self) -> &[f64] {
        &self.curvatures
    }

    /// Index of the voxel that contains a point, None outside the volume. A point between two voxels belongs to the
    /// one with the higher number.
    #[inline]
    pub fn index(&self, point: Vec3) -> Option<usize> {
        let at = |axis: usize| {
            let place = point[axis] / self.spacing[axis] + 0.5;
            // NaN fails both comparisons. The conversion rounds towards zero.
            (place >= 0.0 && place < self.shape[axis] as f64).then_some(place as usize)
        };
        Some((at(0)? * self.shape[1] + at(1)?) * self.shape[2] + at(2)?)
    }

    /// Code of the voxel that contains a point.
    #[inline]
    pub fn code(&self, point: Vec3) -> u8 {
        self.index(point).map_or(voxel::OUTSIDE, |index| self.codes[index])
    }

    /// Curvature, 1/mm, at a point; outside the volume that of the first tissue.
    #[inline]
    pub fn curvature(&self, point: Vec3) -> f64 {
        self.found(point).1
    }

    /// Code and curvature at a point.
    #[inline]
    pub(crate) fn found(&self, point: Vec3) -> (u8, f64) {
        let index = self.index(point);
        let tissue = index.and_then(|index| self.tissues.get(index)).copied().unwrap_or(0);
        (index.map_or(voxel::OUTSIDE, |index| self.codes[index]), self.curvatures[usize::from(tissue)])
    }
}
