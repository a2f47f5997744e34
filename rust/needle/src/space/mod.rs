//! Steering in 3D: arcs of any roll angle through a volume of voxels.
//!
//! The axis x points along the insertion. A pose is a position, mm, and a unit tangent within a cone about the axis. An
//! action is a roll angle of the bevel, or the straight step, and leads to the plane that is `advance` slices ahead.
//! Steps therefore differ in length, and decisions are made at slices only: along the axis nothing is interpolated.
//!
//! # Noise
//!
//! The tangent is disturbed all along by two independent normal angles across it, with a variance in proportion to the
//! length. To first order, after a step of the length L and with the variance s of each angle, the lateral position has
//! the variance s L^2 / 3, and the covariance s L / 2 with the tangent. The plan turns the tangent once, L / sqrt(3) before the
//! end: so both variances are right, and the covariance is too large by 15 %. Nine turns, those of the stencil of directions,
//! are the branches of a step: each has a path of its own from there on. Executions turn the tangent in every short piece. [`SpaceExecutor::estimate`] combines both into a success without the errors of the grid.

mod arc;
mod directions;
mod estimate;
mod execution;
mod feasibility;
mod look_ahead;
mod open_space;
mod problem;
mod rollout;
mod segmentation;
mod target;
mod volume;

pub use arc::{SpaceArc, SpacePose, Vec3, bevel, frame};
pub use directions::DirectionGrid;
pub use execution::SpaceExecutor;
pub use feasibility::{Feasibility, SpaceVerdict};
pub use look_ahead::SpaceAnswer;
pub use problem::{SpaceCosts, SpaceProblem, SpaceSetup};
pub use rollout::{SpacePath, SpaceRun};
pub use segmentation::Segmentation;
pub use target::TargetBody;
pub use volume::Volume;
