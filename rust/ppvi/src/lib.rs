//! Prioritized-partitioned value iteration.

pub mod error;
pub mod mdp;
pub mod solution;
pub mod termination;

pub use error::{Error, Result};
pub use mdp::Mdp;
pub use solution::{Report, Solution};
pub use termination::{Certificate, Observer, Progress, Status, StopRule};
