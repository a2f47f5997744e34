//! Value iteration for Markov decision processes with costs: by prioritized partitions, and by directional sweeps.
//!
//! # The problem
//!
//! A problem has states `s`, actions `a`, stage costs `c(s, a) >= 0`, transition probabilities `p(s' | s, a)` and a
//! discount `g` in (0, 1]. A solver computes the optimal cost-to-go V*, the least fixed point of the Bellman operator
//!
//! ```text
//! (TV)(s) = min over a of [ c(s, a) + g * sum over s' of p(s' | s, a) V(s') ],
//! ```
//!
//! and a policy that attains the minimum. With g < 1, T is a contraction, and V* is its only fixed point. With g = 1
//! and positive costs the problem is a stochastic shortest-path problem. In both cases the *Bellman residual*
//! B = TV - V proves a bound on |V - V*| ([`termination`]). Every solver stops when this bound is below the tolerance,
//! and returns the bound.
//!
//! # Representations
//!
//! * [`TabularMdp`]: any problem, as explicit sparse rows, validated.
//! * [`lattice::LatticeMdp`]: positions on a plane grid, headings on a circle, two bevel sides. A step moves by a
//!   stencil that depends on heading, bevel and region only, and noise is a convolution along the headings. The lattice
//!   stores one byte per state, and a backup is a few vector operations.
//! * [`space::SpaceMdp`]: positions in a volume, directions near an axis. Every step advances, so one backward pass over
//!   the slices is exact, and no iteration is needed.
//!
//! All implement [`Mdp`], and [`TabularMdp::from_mdp`] expands the others to rows, so the solvers of each
//! representation test those of the other.
//!
//! # Solvers
//!
//! | solver | takes | what it is |
//! |---|---|---|
//! | [`value_iteration()`] | any [`Mdp`] | plain value iteration V <- TV: the reference |
//! | [`prioritized()`] | any [`Mdp`], any [`Partition`] | partitions in the order of a [`Priority`] (Wingate and Seppi 2005; the thesis, chapter 6) |
//! | [`policy_iteration()`] | [`TabularMdp`] | (modified) policy iteration by strongly connected components |
//! | [`tabular_sweep()`] | [`TabularMdp`] | Gauss-Seidel sweeps in waves of independent blocks |
//! | [`lattice::sweep`] | [`lattice::LatticeMdp`] | Gauss-Seidel sweeps against the direction of motion |
//! | [`space::solve`] | [`space::SpaceMdp`] | one backward pass over the slices |
//!
//! [`priority`] proves that an accumulated change bounds a residual, and that waves give the same bits on any number of
//! threads.
//!
//! A solve that reaches a limit or is interrupted is not an error: [`Status`] says how it ended. Invalid input is an
//! [`Error`] that names the place of the mistake. [`StopFlag`] abandons any long work from another thread.

#![cfg_attr(doctest, doc = include_str!("../README.md"))]

mod active;
pub mod bellman;
mod block;
mod component;
mod component_order;
mod components;
pub mod dependency;
pub mod error;
mod interpolation;
pub mod lattice;
pub mod mdp;
mod memory;
pub mod partition;
mod pattern;
mod policy_equations;
pub mod policy_iteration;
pub mod prioritized;
pub mod priority;
pub mod proper;
pub mod queue;
pub mod solution;
pub mod space;
pub mod stop;
pub mod tabular;
pub mod tabular_sweep;
pub mod termination;
pub mod value_iteration;
mod waves;

pub use dependency::{Dependencies, StateDependents};
pub use error::{Error, Result};
pub use interpolation::{Order, cubic_weights};
pub use mdp::{Facts, Mdp};
pub use partition::Partition;
pub use policy_iteration::{Evaluation, is_small, policy_iteration};
pub use prioritized::{PrioritizedOptions, prioritized};
pub use priority::Priority;
pub use proper::proper_states;
pub use solution::{Report, Solution};
pub use stop::StopFlag;
pub use tabular::TabularMdp;
pub use tabular_sweep::tabular_sweep;
pub use termination::{Certificate, Observer, Progress, Status, StopRule, Storage};
pub use value_iteration::value_iteration;
