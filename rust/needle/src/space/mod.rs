//! Steering in space: arcs of any roll angle through a volume of voxels.
//!
//! The axis x points along the insertion. A pose is a position, mm, and a unit tangent within a cone about the axis. An
//! action is a roll angle of the bevel, or the straight step, and leads to the plane that is `advance` slices ahead.
//! Steps therefore differ in length, and decisions are made at slices only: along the axis nothing is interpolated.
//! After the step the tangent is disturbed by two independent normal angles across it, with a variance in proportion
//! to the length of the step.

mod arc;
mod directions;
mod execution;
mod feasibility;
mod look_ahead;
mod problem;
mod volume;

pub use arc::{SpaceArc, SpacePose, Vec3, bevel, frame};
pub use directions::DirectionGrid;
pub use execution::{SpaceExecutor, SpaceRun};
pub use feasibility::{Feasibility, SpaceVerdict};
pub use look_ahead::SpaceAnswer;
pub use problem::{SpaceCosts, SpaceProblem, SpaceSetup};
pub use volume::Volume;
