//! Prioritized-partitioned value iteration.

pub mod bellman;
pub mod bicycle;
pub mod dependency;
pub mod error;
pub mod lattice;
pub mod lookup;
pub mod mdp;
mod memory;
pub mod partition;
pub mod prioritized;
pub mod priority;
pub mod proper;
#[cfg(feature = "python")]
mod python;
pub mod queue;
pub mod rollout;
pub mod solution;
pub mod tabular;
pub mod termination;
pub mod value_iteration;
pub mod workspace;

pub use dependency::{Dependencies, StateDependents};
pub use error::{Error, Result};
pub use mdp::Mdp;
pub use partition::Partition;
pub use prioritized::{PrioritizedOptions, prioritized};
pub use priority::Priority;
pub use proper::proper_states;
pub use solution::{Report, Solution};
pub use tabular::TabularMdp;
pub use termination::{Certificate, Observer, Progress, Status, StopRule};
pub use value_iteration::value_iteration;
