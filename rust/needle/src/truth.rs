//! Executions where the plan is wrong: the anatomy lies elsewhere, and the needle bends otherwise.
//!
//! The pose that the controller believes is exact in the frame of the plan. It decides by it, and stops by it: at an
//! obstacle, outside of the workspace, or in the target. A rigid motion takes it to the pose in the anatomy, where obstacles,
//! tissues and target are those of the plan. The needle has touched an obstacle if the pose in the anatomy has. From the
//! contact with the believed target on, the tip goes straight on to the point nearest to its believed centre, as the last
//! step of an insertion ends there. It has reached the target if it then lies in the true one.
//!
//! The controller knows the pose at a coil behind the tip, and how the needle was rotated since. It therefore believes the
//! tip where it would be without the noise on the length up to the coil ([`Unseen`]). This noise acts all along a step.

use crate::arc::Arc;
use crate::area::CLOSED_MM;
use crate::lookup::Pose;
use crate::random::normal_pair;
use crate::rollout::Executor;
use crate::surroundings::{AsBelieved, InAnatomy, Truth};
use crate::unseen::Unseen;
use crate::workspace::Event;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Pieces of a step whose tip noise is known late: the noise turns the tip in the middle of each.
const PIECES: u32 = 4;

impl Executor<'_> {
    /// The event at the start of an execution.
    pub(crate) fn true_start(&self, truth: &Truth, start: Pose) -> Option<Event> {
        let (workspace, Pose { x, y, .. }) = (&self.setup.workspace, truth.pose(start));
        if workspace.is_blocked([x, y]) {
            return Some(Event::Collision);
        }
        self.judged(truth, workspace.event([start.x, start.y]), start)
    }

    /// Makes the step of an action from a believed pose. Returns the first event and its believed pose, or no event and the
    /// believed pose at the end.
    pub(crate) fn true_step(&self, truth: &Truth, from: Pose, action: u8, length: f64) -> (Option<Event>, Pose) {
        let (event, end, met) = self.step_in(&AsBelieved(truth), from, action, length);
        let (collision, _, contact) = self.step_in(&InAnatomy(truth), truth.pose(from), action, length);
        if collision.is_some() && contact <= met {
            return (collision, end);
        }
        (self.judged(truth, event, end), end)
    }

    /// The same with normal tip noise all along the step; believed poses are those that the controller knows at the end of
    /// each piece.
    pub(crate) fn late_step(
        &self,
        unseen: &mut Unseen,
        from: Pose,
        action: u8,
        mut random: Option<&mut Xoshiro256PlusPlus>,
    ) -> (Option<Event>, Pose) {
        let piece = self.needle_at(from).step_length() / f64::from(PIECES);
        let sd = self.setup.noise_sd() / f64::from(PIECES).sqrt();
        let (mut pose, mut action) = (from, action);
        for number in 0..=PIECES {
            let is_half = number == 0 || number == PIECES;
            let length = if is_half { 0.5 * piece } else { piece };
            let (event, end) = self.true_step(&unseen.truth, pose, action, length);
            if event.is_some() {
                return (event, end);
            }
            let turn = match &mut random {
                Some(random) if number < PIECES => sd * normal_pair(random)[0],
                _ => 0.0,
            };
            pose = unseen.turned(end, length, turn);
            // The bevel is already rotated.
            action = if action == 1 { 0 } else { action };
        }
        (None, pose)
    }

    /// The event that a believed one truly is. A tip that ends beside the target has missed it: an exit.
    fn judged(&self, truth: &Truth, event: Option<Event>, contact: Pose) -> Option<Event> {
        if event != Some(Event::Target) || truth.is_in_place() {
            return event;
        }
        let workspace = &self.setup.workspace;
        let [x, y] = workspace.target;
        let (sin, cos) = contact.heading.sin_cos();
        let ahead = (cos * (x - contact.x) + sin * (y - contact.y)).max(0.0);
        let Pose { x, y, heading, .. } = truth.pose(contact);
        let way = Arc::new([x, y], heading, 0.0, ahead);
        if ahead > 0.0 && workspace.first_collision(&way).is_some() {
            return Some(Event::Collision);
        }
        let end = way.point(ahead);
        let across = (end[0] - workspace.target[0]).hypot(end[1] - workspace.target[1]);
        let is_within = across.hypot(truth.aside) <= workspace.target_radius + CLOSED_MM;
        Some(if is_within { Event::Target } else { Event::Exit })
    }
}
