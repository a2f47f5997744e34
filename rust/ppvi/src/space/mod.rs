//! Markov decision processes in a volume: positions on a regular grid, directions near an axis, one backward pass.
//!
//! # State and step
//!
//! A state is `(s, d, j, k)`: slice along the axis, direction, grid point in the slice. Every action of a state
//! makes a step from slice s to slice s + m, where m is the *advance*, the same for all steps. What a step does
//! depends on the direction d, the action a and the region at its start, not on the position:
//!
//! ```text
//! path       the voxels that the step passes, relative to its start, in order   (outcome: the first that is not free)
//! branches   the ways in which it goes on, each with a probability:
//!   path       the voxels that it passes after those                            (outcome: the first that is not free)
//!   landing    (j, k) + cell + fraction                                         (a bilinear stencil)
//!   direction  d'
//! lost       the part of the mass that lands which has left the directions of the grid
//! cost       of the step, plus the price of its starting point times its length
//! ```
//!
//! Values live at grid points; what a path meets is found in voxels, which are finer ([`CollisionGrid`]). A voxel is free,
//! target, obstacle or outside, and whatever is not in the volume is outside. The execution ends in the first voxel that is not free: in the target at no further cost, in an obstacle
//! at the cost `collision`, outside at the cost `exit`. The part `lost` of a branch that ends in a free voxel has left
//! the directions of the grid, which costs `exit`.
//!
//! # Why one pass is exact
//!
//! Every step leads from slice s to slice s + m > s. So the graph of transitions has no cycle, and
//!
//! ```text
//! V(s, .) = min over a of [ c(a) + E V(s + m, .) ]
//! ```
//!
//! is the solution of the Bellman equation once it has been computed for s = S - 1, S - 2, ... 0: no iteration, no
//! residual, and no error but rounding. The probability of success follows in the same pass, from the action that was
//! chosen. Only the values of m + 1 slices are kept: [`solve_into`] hands over each slice when it is finished, so tables may
//! be larger than the memory.
//!
//! # Open states
//!
//! In most of a volume no policy reaches the target any more. A state is *open* if a step leads from it into the target, or on to a
//! landing with an open state among the four grid points around it. The execution
//! ends in the others, *closed*, at the cost `exit`: no policy has a probability of success there, so nothing but the way to fail is
//! left to choose. Their tables hold this cost, action 0 and no success. Openness is a set of bits which the pass finds with the
//! values, slice by slice, and only the window of a slice between the first and the last state that may be open is computed. In the
//! phantoms, a sixth to a tenth of the states have a success that the tables can hold.
//!
//! # Grid points that are not free
//!
//! A step that goes on ends in a free voxel, but some of the four grid points around its end may be in obstacles, in the target or
//! outside. Such a grid point has the value and the success of an execution that starts there and leaves its voxel: voxels within
//! half a spacing of it do not end this execution. It succeeds in directions that lead away from an obstacle, and fails
//! in those that lead along it. Corners beyond the grid cost `exit`. All weights are non-negative, and the problem is a Markov
//! decision process.
//!
//! An execution itself never starts in such a place: whoever asks for a pose in an obstacle or in the target looks at its voxel first.
//!
//! # Success
//!
//! Linear interpolation blurs: it adds f (1 - f) of a squared spacing to the variance of every landing, f the
//! fraction. Higher orders blur less, but have negative weights, and a minimum over actions finds the costs that such
//! weights invent. So decisions are made with linear interpolation. For the probability of success there is no
//! minimum, since the action is already chosen: [`Order::Cubic`](crate::Order::Cubic) interpolates it with four points along each axis, limited
//! to [0, 1]. A limit to the range of the four corners would cut off every peak, and peaks are where the policy leads.
//! Closed states have none.
//!
//! [`SpaceParts`] describes a problem, [`SpaceMdp`] is that problem as an [`Mdp`](crate::Mdp), and [`solve`] makes the
//! pass.

mod block;
mod choice;
mod collision;
mod definition;
mod footprint;
mod kernel;
mod layer;
mod lead;
mod outcomes;
mod parts;
mod pass;
mod paths;
mod reach;
mod slice;
mod voxels;

pub use collision::{CollisionGrid, voxel};
pub use definition::SpaceMdp;
pub use kernel::SUCCESS_STEPS;
pub use parts::{Branch, FailureCosts, SpaceParts, SpaceShape, SpaceStep};
pub use pass::{PassOptions, PassReport, SolvedSlice, SpaceTables, SpaceView, solve, solve_into};
