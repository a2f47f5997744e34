//! Cubic interpolation of success at the end of a step.
//!
//! Let the step end in the cell whose corners are the grid points (u, v) to (u + 1, v + 1), in the orientation of its
//! sector, at the fractions (f, g) of the cell. A grid point is *free* if it is on the grid and not in an obstacle.
//!
//! 1. If the points (u - 1, v - 1) to (u + 2, v + 2) are free, the success is interpolated with four points along each axis
//!    ([`weights`]), and limited to [0, 1].
//! 2. Otherwise it is the bilinear mean of the free corners, with their weights divided by their sum; if this sum is at
//!    most [`LEAST_SUM`], they are not divided.
//!
//! The grid points in obstacles and beyond the grid have the success 0, so rule 2 is the bilinear mean of all corners times
//! a number that depends on which of them are free.

use crate::interpolation::{Order, POINTS, weights};
use crate::lattice::direction::Arc;
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{Motion, Shift, outcome};
use crate::lattice::real::Real;

/// Sum of the bilinear weights of the free corners of a cell up to which they are not divided by it.
const LEAST_SUM: f64 = 0.05;

/// Which of the four corners of a cell are free: one bit each, in the order (u, v), (u, v + 1), (u + 1, v), (u + 1, v + 1).
const CORNERS: usize = 1 << 4;

/// Code of a cell with points that are not free, beside the bits of its free corners.
const MIXED: u8 = CORNERS as u8;

/// Interpolation in the passes of an evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Reading {
    /// The transitions of the lattice.
    Transitions,
    /// The rules of the module.
    Cubic,
    /// The same with the magnitudes of all weights, and without the upper limit: for bounds on errors.
    Magnitudes,
}

impl Reading {
    pub(crate) fn is_cubic(self) -> bool {
        self != Reading::Transitions
    }

    /// The largest sum of the magnitudes of the weights of a step with one of these displacements.
    pub(crate) fn largest_sum(self, shifts: impl Iterator<Item = Shift>) -> f64 {
        let magnitude = |f: f64| weights(Order::Cubic, f, 0.0).iter().map(|weight| weight.abs()).sum::<f64>();
        let sum = |shift: Shift| if self.is_cubic() { shift.fraction.map(magnitude).iter().product() } else { 1.0 };
        shifts.map(sum).fold(1.0, f64::max)
    }
}

/// Weights of a step.
#[derive(Debug, Clone)]
pub(crate) struct CubicWeights<T> {
    /// Of the points from (-1, -1) on, `[u][v]`.
    pub points: [[T; POINTS]; POINTS],
    /// Factor on the bilinear mean of the corners, by the bits of the free ones.
    pub scales: [T; CORNERS],
}

impl<T: Real> CubicWeights<T> {
    pub(crate) fn new(shift: Shift, reading: Reading) -> Self {
        let sign = |weight: f64| if reading == Reading::Magnitudes { weight.abs() } else { weight };
        let [of_u, of_v] = shift.fraction.map(|f| weights(Order::Cubic, f, 0.0).map(sign));
        let [f, g] = shift.fraction;
        let corners = [(1.0 - f) * (1.0 - g), (1.0 - f) * g, f * (1.0 - g), f * g];
        let scale = |bits: usize| {
            let free: f64 = (0..4).filter(|corner| bits >> corner & 1 == 1).map(|corner| corners[corner]).sum();
            T::of(if free > LEAST_SUM { 1.0 / free } else { 1.0 })
        };
        CubicWeights { points: of_u.map(|u| of_v.map(|v| T::of(u * v))), scales: std::array::from_fn(scale) }
    }
}

/// The cells of a sector, as rows of codes with the padding of W: 0 if the points around are free, otherwise [`MIXED`] and
/// the bits of the free corners.
#[derive(Debug, Default)]
pub(crate) struct Cells {
    codes: Vec<u8>,
    width: usize,
}

impl Cells {
    /// The cells of the columns of a sector, with `pad` columns and rows beyond its `lanes` on all sides.
    pub(crate) fn new(lattice: &LatticeMdp, arc: Arc, lanes: usize, pad: [usize; 2]) -> Self {
        let [places, length] = arc.extent(lattice.parts.shape);
        let (columns, width) = (places + 2 * pad[0], lanes + 2 * pad[1]);
        let mut free = vec![0u8; columns * width];
        for u in 0..places {
            let place = if arc.direction.is_reversed() { places - 1 - u } else { u };
            let row = &mut free[(u + pad[0]) * width + pad[1]..][..length];
            for (v, free) in row.iter_mut().enumerate() {
                let (i, j) = if arc.direction.is_vertical() { (v, place) } else { (place, v) };
                *free = u8::from(lattice.outcome(Motion::Curved, i, j, 0, 0) != outcome::AT_OBSTACLE);
            }
        }
        let mut codes = vec![MIXED; columns * width];
        for u in 1..columns.saturating_sub(2) {
            let rows: [&[u8]; POINTS] = std::array::from_fn(|row| &free[(u + row - 1) * width..][..width]);
            let codes = &mut codes[u * width..][..width];
            for v in 1..width.saturating_sub(2) {
                let all = rows.iter().all(|row| row[v - 1] & row[v] & row[v + 1] & row[v + 2] == 1);
                let corners = rows[1][v] | rows[1][v + 1] << 1 | rows[2][v] << 2 | rows[2][v + 1] << 3;
                codes[v] = if all { 0 } else { MIXED | corners };
            }
        }
        Cells { codes, width }
    }

    /// Index of a cell, by the column and the row of its first corner, both counted with the padding.
    #[inline(always)]
    pub(crate) fn index(&self, u: usize, v: usize) -> usize {
        u * self.width + v
    }

    /// All codes.
    #[inline(always)]
    pub(crate) fn codes(&self) -> &[u8] {
        &self.codes
    }
}

/// The factor of a cell with this code.
#[inline(always)]
pub(crate) fn scale_of<T: Real>(scales: &[T; CORNERS], code: u8) -> T {
    scales[usize::from(code) % CORNERS]
}
