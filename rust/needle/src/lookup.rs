//! Look-ups of poses in a solved table.

use ppvi::lattice::Shape;
use ppvi::{Error, Result, StopFlag};
use rayon::prelude::*;

use crate::area::CLOSED_MM;
use crate::bicycle::Bicycle;

/// Pose of the tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position along the insertion, mm.
    pub x: f64,
    /// Lateral position, mm.
    pub y: f64,
    /// Heading, rad, counter-clockwise from +x.
    pub heading: f64,
    /// Bevel, -1 or +1: the sign of the curvature of the arc.
    pub bevel: f64,
}

impl Pose {
    /// Makes a pose from a row `[x, y, heading, bevel]`.
    pub fn of(row: [f64; 4]) -> Self {
        Pose { x: row[0], y: row[1], heading: row[2], bevel: row[3] }
    }
}

/// The grid of a table: finds the entry nearest to a pose in the workspace.
///
/// # Examples
/// ```
/// use needle::{Pose, TableGrid};
/// use ppvi::lattice::Shape;
///
/// let grid = TableGrid::new(Shape { nx: 4, ny: 3, headings: 8 }, [2.0, 1.0], [6.0, 2.0])?;
/// assert_eq!(grid.index(Pose { x: 0.9, y: 0.4, heading: 0.0, bevel: -1.0 }), Some(0));
/// assert_eq!(grid.index(Pose { x: 6.1, y: 0.0, heading: 0.0, bevel: -1.0 }), None);
/// # Ok::<(), ppvi::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableGrid {
    shape: Shape,
    per_mm: [f64; 2],
    per_rad: f64,
    /// Largest x and y of the workspace, mm, with the tolerance.
    high: [f64; 2],
}

impl TableGrid {
    /// Makes a grid from its shape, its spacing along x and y, mm, and the extent of the workspace, mm.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a spacing that is not positive and finite, a shape without states, or an extent that is
    /// not positive or that the grid does not cover.
    pub fn new(shape: Shape, spacing: [f64; 2], size: [f64; 2]) -> Result<Self> {
        if !spacing.iter().all(|s| *s > 0.0 && s.is_finite()) {
            return Err(Error::parameter("spacing_mm", format!("{spacing:?}"), "must be positive and finite"));
        }
        if shape.states() == 0 {
            return Err(Error::parameter("shape", format!("{shape:?}"), "must not be empty"));
        }
        for (extent, (points, spacing)) in size.iter().zip([shape.nx, shape.ny].iter().zip(spacing)) {
            // Less than a cell, for the rounding of large coordinates.
            let covered = (*points as f64 - 0.75) * spacing;
            if !(*extent > 0.0 && *extent <= covered) {
                return Err(Error::parameter(
                    "size_mm",
                    format!("{size:?}"),
                    "must be positive and covered by the grid",
                ));
            }
        }
        let per_rad = 1.0 / Bicycle::new(1.0, shape.headings)?.heading_step();
        let high = size.map(|extent| extent + CLOSED_MM);
        Ok(TableGrid { shape, per_mm: [1.0 / spacing[0], 1.0 / spacing[1]], per_rad, high })
    }

    /// Index of the table entry nearest to a pose. `None` if the pose is not finite, if it lies outside the closed
    /// workspace, or if its bevel is neither -1 nor +1.
    #[inline]
    pub fn index(&self, pose: Pose) -> Option<usize> {
        let Shape { nx, ny, headings } = self.shape;
        let i = nearest(pose.x, self.per_mm[0], self.high[0])?.min(nx - 1);
        let j = nearest(pose.y, self.per_mm[1], self.high[1])?.min(ny - 1);
        let bevel = if pose.bevel == 1.0 {
            1
        } else if pose.bevel == -1.0 {
            0
        } else {
            return None;
        };
        let turns = pose.heading * self.per_rad;
        // Beyond 2^53 heading steps the spacing of floating-point numbers is larger than a heading step.
        if turns.is_nan() || turns.abs() > 9e15 {
            return None;
        }
        let k = (round(turns) as i64).rem_euclid(headings as i64) as usize;
        Some(((i * ny + j) * headings + k) * 2 + bevel)
    }

    /// Looks up many poses, rows of x, y, heading and bevel, on the current rayon pool.
    ///
    /// # Errors
    /// [`Error::Length`] if an array of the table does not have the size of the grid; [`Error::Parameter`] names the
    /// first pose without a table entry.
    pub fn look_up_many(&self, poses: &[[f64; 4]], table: &Table<'_>) -> Result<Answers> {
        let states = self.shape.states();
        for (name, length) in
            [("values", table.values.len()), ("policy", table.policy.len()), ("success", table.success.len())]
        {
            if length != states {
                return Err(Error::Length { name, expected: states, found: length });
            }
        }
        let n = poses.len();
        let mut answers = Answers { actions: vec![0; n], values: vec![0.0; n], success: vec![0.0; n] };
        const BLOCK: usize = 4096;
        let stop = StopFlag::current();
        let outputs = answers.actions.par_chunks_mut(BLOCK).zip(answers.values.par_chunks_mut(BLOCK));
        let outputs = outputs.zip(answers.success.par_chunks_mut(BLOCK)).zip(poses.par_chunks(BLOCK)).enumerate();
        let first_bad = outputs.filter_map(|(block, (((actions, values), success), poses))| {
            stop.check();
            for (row, pose) in poses.iter().enumerate() {
                let Some(index) = self.index(Pose::of(*pose)) else {
                    return Some(block * BLOCK + row);
                };
                actions[row] = table.policy[index];
                values[row] = table.values[index];
                success[row] = table.success[index];
            }
            None
        });
        match first_bad.min() {
            None => Ok(answers),
            Some(row) => {
                let rule = "must be finite, in the workspace, with bevel -1 or +1";
                Err(Error::parameter("pose", format!("{:?} (row {row})", poses[row]), rule))
            }
        }
    }
}

/// The three arrays of a table, each in the order `[i][j][heading][bevel]`.
#[derive(Debug, Clone, Copy)]
pub struct Table<'a> {
    /// Cost-to-go.
    pub values: &'a [f32],
    /// 0 insert, 1 rotate then insert.
    pub policy: &'a [u8],
    /// Probability of reaching the target.
    pub success: &'a [f32],
}

/// Results of a look-up, one element per pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Answers {
    /// 0 insert, 1 rotate then insert.
    pub actions: Vec<u8>,
    /// Cost-to-go.
    pub values: Vec<f32>,
    /// Probability of reaching the target.
    pub success: Vec<f32>,
}

/// Rounds half away from zero, without the library call that `f64::round` needs on baseline processors.
#[inline]
fn round(x: f64) -> f64 {
    (x + 0.5f64.copysign(x)).trunc()
}

#[inline]
fn nearest(at: f64, per_mm: f64, high: f64) -> Option<usize> {
    // NaN fails both comparisons.
    (at >= -CLOSED_MM && at <= high).then_some((at * per_mm + 0.5) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_entry_or_none() {
        let shape = Shape { nx: 4, ny: 3, headings: 8 };
        let grid = TableGrid::new(shape, [2.0, 1.0], [5.2, 2.0]).unwrap();
        let at = |x, y, heading, bevel| grid.index(Pose { x, y, heading, bevel });
        let step = std::f64::consts::TAU / 8.0;
        assert_eq!(at(0.9, 0.4, 0.0, -1.0), Some(0));
        assert_eq!(at(5.2, 2.0, 7.4 * step, 1.0), Some(((3 * 3 + 2) * 8 + 7) * 2 + 1));
        assert_eq!(at(2.0, 1.0, -step, 1.0), Some(((3 + 1) * 8 + 7) * 2 + 1));
        for bad in [
            (5.3, 0.0, 0.0, 1.0),
            (0.0, 2.1, 0.0, 1.0),
            (-0.1, 0.0, 0.0, 1.0),
            (f64::NAN, 0.0, 0.0, 1.0),
            (0.0, 0.0, f64::INFINITY, 1.0),
            (0.0, 0.0, 0.0, 0.0),
        ] {
            assert_eq!(at(bad.0, bad.1, bad.2, bad.3), None, "{bad:?}");
        }
        for size in [[6.6, 2.0], [6.0, 2.9], [0.0, 2.0], [f64::NAN, 2.0]] {
            assert!(TableGrid::new(shape, [2.0, 1.0], size).is_err(), "{size:?}");
        }
    }
}
