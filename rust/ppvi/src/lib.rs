//! Value iteration for Markov decision processes with costs: by prioritized partitions, and by sweeps along the structure
//! of a lattice.
//!
//! # The problem
//!
//! States `s`, actions `a`, stage costs `c(s, a) >= 0`, transition probabilities `p(s' | s, a)`, a discount `g` in (0, 1].
//! Wanted is the optimal cost-to-go V*, the least fixed point of the Bellman operator
//!
//! ```text
//! (TV)(s) = min over a of [ c(s, a) + g * sum over s' of p(s' | s, a) V(s') ],
//! ```
//!
//! and a policy that attains the minimum. With g < 1, T is a contraction and V* its only fixed point. With g = 1 and
//! positive costs it is a stochastic shortest-path problem. In both cases the *Bellman residual* B = TV - V proves a
//! bound on |V - V*| ([`termination`]), and every solver here stops on that proof and returns it.
//!
//! # Two representations
//!
//! * [`TabularMdp`]: explicit sparse rows, validated; anybody's problem.
//! * [`lattice::LatticeMdp`]: a needle in a plane. Positions on a grid, headings on a circle, two bevel sides; a step
//!   moves by a stencil that depends on heading, bevel and the curvature of the region only, and noise is a convolution
//!   along the headings. Nothing but a byte a state is stored, and a backup is a few vector operations.
//!
//! Both are an [`Mdp`], so each is the other's oracle: [`TabularMdp::from_mdp`] expands a lattice.
//!
//! # Solvers
//!
//! | solver | takes | what it is |
//! |---|---|---|
//! | [`value_iteration()`] | any [`Mdp`] | the readable reference: V <- TV |
//! | [`prioritized()`] | any [`Mdp`], any [`Partition`] | partitions in the order of a [`Priority`] (Wingate and Seppi 2005; the thesis, chapter 6) |
//! | [`tabular_sweep()`] | [`TabularMdp`] | Gauss-Seidel in waves of independent blocks |
//! | [`lattice::sweep`] | [`lattice::LatticeMdp`] | Gauss-Seidel against the direction of motion |
//!
//! The subtle part, why an accumulated change bounds a residual and why waves give the same bits on any number of
//! threads, is argued in [`priority`].
//!
//! Outcomes (converged, a limit reached, interrupted) are values: [`Status`]. Wrong input is an [`Error`] that names the
//! place. Nothing here knows Python but the binding behind the feature `python`.

mod active;
pub mod bellman;
mod block;
pub mod dependency;
pub mod error;
pub mod lattice;
pub mod mdp;
mod memory;
pub mod partition;
mod pattern;
pub mod prioritized;
pub mod priority;
pub mod proper;
pub mod queue;
pub mod solution;
pub mod tabular;
pub mod tabular_sweep;
pub mod termination;
pub mod value_iteration;
mod waves;

pub use dependency::{Dependencies, StateDependents};
pub use error::{Error, Result};
pub use mdp::Mdp;
pub use partition::Partition;
pub use prioritized::{PrioritizedOptions, prioritized};
pub use priority::Priority;
pub use proper::proper_states;
pub use solution::{Report, Solution};
pub use tabular::TabularMdp;
pub use tabular_sweep::tabular_sweep;
pub use termination::{Certificate, Observer, Progress, Status, StopRule};
pub use value_iteration::value_iteration;
