//! The backward pass over the slices.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use crate::error::{Error, Result};
use crate::interpolation::Order;
use crate::memory::is_granted;
use crate::space::definition::SpaceMdp;
use crate::space::layer::Layer;
use crate::space::slice::{SliceSolver, SliceTables};
use crate::termination::{Observer, Progress, Status};

/// Bytes for each state of a solve that keeps all tables: value, success, policy.
const STATE_BYTES: u128 = 7;

/// How the pass is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassOptions {
    /// Interpolation of the probability of success. That of the costs, which decide, is linear.
    pub success: Order,
    /// Time after which no further slice is begun.
    pub time_limit: Option<Duration>,
}

impl Default for PassOptions {
    /// Cubic success, no limit.
    fn default() -> Self {
        PassOptions { success: Order::Cubic, time_limit: None }
    }
}

/// A finished slice: its tables, each `[direction][j][k]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolvedSlice<'a> {
    /// Number of the slice.
    pub slice: usize,
    /// Cost-to-go.
    pub values: &'a [f32],
    /// Best action; 0 where the voxel is not free, and where the state is closed.
    pub policy: &'a [u8],
    /// Probability of success, in units of 1 / 65535. With [`Order::Cubic`], points that are not free have that of an execution
    /// which starts there and leaves its voxel.
    pub success: &'a [u16],
}

/// How a pass ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassReport {
    /// Converged, or why the pass ended before the first slice.
    pub status: Status,
    /// First slice whose tables are computed; 0 if converged.
    pub first_slice: usize,
    /// Number of states that were backed up.
    pub backups: u64,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// All tables, `[slice][direction][j][k]`. Slices before [`PassReport::first_slice`] hold zeros.
#[derive(Debug, Clone, PartialEq)]
pub struct SpaceTables {
    /// Cost-to-go.
    pub values: Vec<f32>,
    /// Best action.
    pub policy: Vec<u8>,
    /// Probability of success, in units of 1 / 65535.
    pub success: Vec<u16>,
    /// How the pass ended.
    pub report: PassReport,
}

/// All tables, wherever their memory is: in [`SpaceTables`], or in a file that is mapped into memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceView<'a> {
    /// As [`SpaceTables::values`].
    pub values: &'a [f32],
    /// As [`SpaceTables::policy`].
    pub policy: &'a [u8],
    /// As [`SpaceTables::success`].
    pub success: &'a [u16],
}

impl<'a> From<&'a SpaceTables> for SpaceView<'a> {
    fn from(tables: &'a SpaceTables) -> Self {
        SpaceView { values: &tables.values, policy: &tables.policy, success: &tables.success }
    }
}

/// Makes the pass and keeps all tables.
///
/// # Errors
/// [`Error::TooLarge`] if the memory does not hold the tables, and [`Error::Stopped`] of a guard.
pub fn solve(mdp: &SpaceMdp, options: &PassOptions, observer: Option<Observer<'_>>) -> Result<SpaceTables> {
    let (states, of_slice) = (mdp.shape().states(), mdp.shape().slice_states());
    let needed_bytes = states as u128 * STATE_BYTES;
    if !is_granted(needed_bytes) {
        let rule = "more than the memory; keep the slices elsewhere, or use a coarser grid or fewer directions";
        return Err(Error::TooLarge { states: states as u128, needed_bytes, rule });
    }
    let mut tables = SpaceTables {
        values: vec![0.0; states],
        policy: vec![0; states],
        success: vec![0; states],
        report: PassReport { status: Status::Interrupted, first_slice: 0, backups: 0, seconds: 0.0 },
    };
    let report = solve_into(mdp, options, observer, |solved| {
        let range = solved.slice * of_slice..(solved.slice + 1) * of_slice;
        tables.values[range.clone()].copy_from_slice(solved.values);
        tables.policy[range.clone()].copy_from_slice(solved.policy);
        tables.success[range].copy_from_slice(solved.success);
        Ok(())
    })?;
    tables.report = report;
    Ok(tables)
}

/// Makes the pass and hands over each slice when it is finished, the deepest one first. The observer is called after
/// every slice, with the share of finished slices as the number of sweeps.
///
/// # Errors
/// Those of `take`, which end the pass, and [`Error::Stopped`] of a guard.
pub fn solve_into(
    mdp: &SpaceMdp,
    options: &PassOptions,
    mut observer: Option<Observer<'_>>,
    mut take: impl FnMut(SolvedSlice<'_>) -> Result<()>,
) -> Result<PassReport> {
    let started = Instant::now();
    let (parts, shape) = (mdp.parts(), mdp.shape());
    let solver = SliceSolver::new(parts, options.success);
    let mut ring: Vec<Layer> = (0..=parts.advance).map(|_| Layer::new(parts, solver.padded())).collect();
    let mut tables = SliceTables::new(shape);
    let mut report = PassReport { status: Status::Converged, first_slice: shape.slices, backups: 0, seconds: 0.0 };
    for slice in (0..shape.slices).rev() {
        // The slice that is read moves to the end, the one that is written to the front.
        ring.rotate_right(1);
        let Some((layer, ahead)) = ring.split_first_mut() else { unreachable!("a ring has two layers or more") };
        let ahead = if slice + parts.advance < shape.slices { ahead.last() } else { None };
        solver.solve(slice, ahead, layer, &mut tables);
        let SliceTables { values, policy, success } = &tables;
        take(SolvedSlice { slice, values, policy, success })?;
        report.first_slice = slice;
        report.backups += shape.slice_states() as u64;
        let sweeps = (shape.slices - slice) as f64 / shape.slices as f64;
        let progress = Progress { sweeps, residual: 0.0, threshold: 0.0 };
        if observer.as_mut().is_some_and(|observer| observer(&progress) == ControlFlow::Break(())) && slice > 0 {
            report.status = Status::Interrupted;
            break;
        }
        if options.time_limit.is_some_and(|limit| started.elapsed() > limit) && slice > 0 {
            report.status = Status::TimeLimit;
            break;
        }
    }
    report.seconds = started.elapsed().as_secs_f64();
    Ok(report)
}
