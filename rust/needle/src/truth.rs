//! Executions where the plan is wrong: the anatomy lies elsewhere, and the needle bends otherwise.
//!
//! The pose that the controller believes is exact in the frame of the plan. It decides by it, and stops by it: at an
//! obstacle, outside of the workspace, or in the target. A rigid motion takes it to the pose in the anatomy, where obstacles,
//! tissues and target are those of the plan. The needle has touched an obstacle if the pose in the anatomy has. From the
//! contact with the believed target on, the tip goes straight on to the point nearest to its believed centre, as the last
//! step of an insertion ends there. It has reached the target if it then lies in the true one.

use crate::arc::Arc;
use crate::area::CLOSED_MM;
use crate::bicycle::Bicycle;
use crate::lookup::Pose;
use crate::rollout::Executor;
use crate::workspace::Event;

/// What is true in an execution and not as planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Angle, rad, by which a believed pose turns about the origin of the plan to become that in the anatomy.
    pub turn: f64,
    /// Shift after it, mm.
    pub shift: [f64; 2],
    /// Distance of the tip from the plane of the anatomy at the target, mm.
    pub aside: f64,
    /// Curvature of the needle, relative to the planned one.
    pub curvature: f64,
}

impl Truth {
    /// Whether the anatomy is where the plan says.
    fn is_in_place(&self) -> bool {
        self.turn == 0.0 && self.shift == [0.0; 2] && self.aside == 0.0
    }

    /// The pose in the anatomy.
    fn pose(&self, Pose { x, y, heading, bevel }: Pose) -> Pose {
        let (sin, cos) = self.turn.sin_cos();
        let [dx, dy] = self.shift;
        Pose { x: cos * x - sin * y + dx, y: sin * x + cos * y + dy, heading: heading + self.turn, bevel }
    }

    /// The needle with the true curvature at a pose in the anatomy. The lengths of its steps are as planned.
    fn needle(&self, executor: &Executor<'_>, pose: Pose) -> Bicycle {
        let planned = executor.needle_at(pose);
        if self.curvature == 1.0 {
            return planned;
        }
        Bicycle { radius: planned.radius / self.curvature, step: Some(planned.step_length()), ..planned }
    }
}

/// How the needle bends, and what it meets.
pub(crate) trait Surroundings {
    /// The needle with the curvature at a pose.
    fn needle(&self, executor: &Executor<'_>, pose: Pose) -> Bicycle;
    /// The event at a point.
    fn event(&self, executor: &Executor<'_>, point: [f64; 2]) -> Option<Event>;
    /// The first event on an arc, and its arc length, mm.
    fn first_event(&self, executor: &Executor<'_>, arc: &Arc) -> Option<(Event, f64)>;
}

/// The surroundings that the plan knows.
pub(crate) struct AsPlanned;

impl Surroundings for AsPlanned {
    fn needle(&self, executor: &Executor<'_>, pose: Pose) -> Bicycle {
        executor.needle_at(pose)
    }
    fn event(&self, executor: &Executor<'_>, point: [f64; 2]) -> Option<Event> {
        executor.setup.workspace.event(point)
    }
    fn first_event(&self, executor: &Executor<'_>, arc: &Arc) -> Option<(Event, f64)> {
        executor.setup.workspace.first_event(arc)
    }
}

/// What the controller believes of a needle that bends as it truly does.
struct AsBelieved<'a>(&'a Truth);

impl Surroundings for AsBelieved<'_> {
    fn needle(&self, executor: &Executor<'_>, pose: Pose) -> Bicycle {
        self.0.needle(executor, self.0.pose(pose))
    }
    fn event(&self, executor: &Executor<'_>, point: [f64; 2]) -> Option<Event> {
        AsPlanned.event(executor, point)
    }
    fn first_event(&self, executor: &Executor<'_>, arc: &Arc) -> Option<(Event, f64)> {
        AsPlanned.first_event(executor, arc)
    }
}

/// The obstacles that the tip truly meets, for poses in the anatomy.
struct InAnatomy<'a>(&'a Truth);

impl Surroundings for InAnatomy<'_> {
    fn needle(&self, executor: &Executor<'_>, pose: Pose) -> Bicycle {
        self.0.needle(executor, pose)
    }
    fn event(&self, executor: &Executor<'_>, point: [f64; 2]) -> Option<Event> {
        executor.setup.workspace.is_blocked(point).then_some(Event::Collision)
    }
    fn first_event(&self, executor: &Executor<'_>, arc: &Arc) -> Option<(Event, f64)> {
        executor.setup.workspace.first_collision(arc).map(|s| (Event::Collision, s))
    }
}

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
