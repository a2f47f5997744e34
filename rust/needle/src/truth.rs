//! Executions where the plan is wrong: the anatomy lies elsewhere, and the needle bends otherwise.
//!
//! The pose that the controller believes is exact in the frame of the plan. It decides by it, and stops by it: at an
//! obstacle, outside of the workspace, or in the target. A rigid motion takes it to the pose in the anatomy, where obstacles,
//! tissues and target are those of the plan. The needle has touched an obstacle if the pose in the anatomy has. From the
//! contact with the believed target on, the tip goes straight on to the point nearest to its believed centre, as the last
//! step of an insertion ends there. It has reached the target if it then lies in the true one.

use crate::arc::Arc;
use crate::area::CLOSED_MM;
use crate::lookup::Pose;
use crate::rollout::Executor;
use crate::surroundings::{AsBelieved, InAnatomy, Truth};
use crate::workspace::Event;

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
    pub(crate) fn true_step(&self, truth: &Truth, from: Pose, action: u8) -> (Option<Event>, Pose) {
        let length = self.needle_at(from).step_length();
        let (event, end, met) = self.step_in(&AsBelieved(truth), from, action, length);
        let (collision, _, contact) = self.step_in(&InAnatomy(truth), truth.pose(from), action, length);
        if collision.is_some() && contact <= met {
            return (collision, end);
        }
        (self.judged(truth, event, end), end)
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
