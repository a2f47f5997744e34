//! Steering of bevel-tip needles in a plane, on top of the general solvers of [`ppvi`].
//!
//! A bevel tip makes an inserted needle follow a circular arc; turning the needle by 180 degrees mirrors the arc. This
//! crate holds the geometry ([`Bicycle`], [`Workspace`], [`Area`], [`Arc`], [`Tissues`], [`Clearance`]), turns a [`Setup`] into a
//! [`LatticeMdp`](ppvi::lattice::LatticeMdp) ([`SteeringProblem`]), looks poses up in a solved table ([`TableGrid`]),
//! and executes a policy in the continuous model ([`Executor`]). [`Rod`] is the shape of a needle in layered tissue,
//! [`bristle`] follows the friction along a motion, [`path_state`] an uncertain path.
//!
//! Units are millimetres and radians. x points along the insertion, y is lateral, headings are measured
//! counter-clockwise from +x. Errors are those of `ppvi`.
//!
//! # Examples
//!
//! ```
//! use needle::{Bicycle, Clearance, Executor, Execution, Setup, SteeringProblem, Tissues, Workspace};
//! use ppvi::StopRule;
//! use ppvi::lattice::{Costs, Transition, sweep};
//!
//! # fn main() -> ppvi::Result<()> {
//! let needle = Bicycle::new(40.0, 60)?;
//! let problem = SteeringProblem::new(Setup {
//!     workspace: Workspace::new([60.0, 40.0], Vec::new(), [50.0, 20.0], 3.0)?,
//!     needle,
//!     spacing: [2.0, 2.0],
//!     noise: vec![1.0],
//!     noise_step: None,
//!     arc_samples: 4,
//!     transition: Transition::Interpolated,
//!     costs: Costs { step: needle.step_length(), rotation: 4.0, collision: 1e4, exit: 1e4, discount: 1.0 },
//!     tissues: Tissues::default(),
//!     clearance: Clearance::default(),
//!     straight: None,
//! })?;
//! let table = sweep::solve(problem.lattice(), StopRule::new(0.01)?, None)?;
//! let executor = Executor::new(&problem, &table.policy, &table.values, Execution::Greedy, None)?;
//! let run = executor.trace([0.0, 20.0, 0.0, 1.0], None, 100)?.run;
//! assert_eq!(run.event, Some(needle::Event::Target));
//! # Ok(())
//! # }
//! ```

mod arc;
mod arc_columns;
mod area;
mod bicycle;
pub mod bristle;
mod classification;
mod clearance;
mod look_ahead;
mod lookup;
pub mod path_state;
mod problem;
mod random;
mod regions;
mod rod;
mod rollout;
mod setup;
pub mod space;
mod surroundings;
mod tissues;
mod truth;
mod unseen;
mod workspace;

pub use arc::Arc;
pub use area::{Area, CLOSED_MM};
pub use bicycle::Bicycle;
pub use clearance::Clearance;
pub use lookup::{Answers, Pose, Table, TableGrid};
pub use problem::SteeringProblem;
pub use rod::{Rod, Station};
pub use rollout::{Execution, Executor, Run, Trace};
pub use setup::{Setup, Straight};
pub use surroundings::Truth;
pub use tissues::Tissues;
pub use workspace::{Event, Workspace, grid_points};
