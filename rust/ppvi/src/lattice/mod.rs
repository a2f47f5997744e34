//! Markov decision processes on a lattice: positions on a plane grid, headings on a circle, two bevel sides.
//!
//! A state is `(i, j, k, b)`: grid column, grid row, heading index, bevel (0: -1, 1: +1). Action 0 steps forward,
//! action 1 switches the bevel and then steps forward, so the step always *arrives* with a bevel b' = b xor action.
//! What the step does depends on (k, b') and on a region of steps, not on the action:
//!
//! ```text
//! position   moves by stencil[k][b'], which is the same all over a region  (a displacement stencil)
//! heading    k + m with probability turn[b'](m), also there               (a circular convolution)
//! outcome    continues, or ends the execution                              (one byte a step, given by the caller)
//! ```
//!
//! The region of a step is given for its grid point and the direction of its heading, one of four: the curvature of a
//! step can be that of the place ahead.
//!
//! With W(k, b') = sum over m of turn[b'](m) V(k + m, b') the Q-values are shifted reads of W, and
//! V(b) = min(Q(b), rotation + Q(1 - b)).
//!
//! States are numbered as in the tables, `((i * ny + j) * headings + k) * 2 + b`. [`LatticeParts`] describes a problem,
//! [`LatticeMdp`] is that problem as an [`Mdp`](crate::Mdp), [`sweep::solve`] solves it, and [`evaluation`] computes
//! what a policy achieves. A steered needle is the problem that this was built for; the crate `needle` makes its
//! lattices.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod backup;
mod convolve;
mod cubic;
mod definition;
mod direction;
mod engine;
pub mod evaluation;
mod greedy;
mod halo;
mod heading;
mod kernel;
mod lanes;
mod model;
mod parts;
mod pending;
mod plane;
mod real;
mod sector;
mod store;
mod strip;
pub mod sweep;
mod terminal_mask;
mod turns;

pub use direction::Direction;
pub use greedy::{greedy, refined};
pub use heading::HeadingKernel;
pub use model::LatticeMdp;
pub use parts::{Costs, LARGEST_COST, LatticeParts, Motion, Region, STRAIGHT, Shape, Shift, Transition, outcome};
