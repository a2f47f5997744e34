//! How the needle bends and what it meets: as planned, as the controller believes, and in the anatomy.

use crate::arc::Arc;
use crate::bicycle::Bicycle;
use crate::lookup::Pose;
use crate::setup::Setup;
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
    /// Length behind the tip, mm, whose tip noise the controller does not know yet.
    pub behind: f64,
}

impl Truth {
    /// Whether the anatomy is where the plan says.
    pub(crate) fn is_in_place(&self) -> bool {
        self.turn == 0.0 && self.shift == [0.0; 2] && self.aside == 0.0
    }

    /// The truth where a believed pose is this one in the anatomy, and the others move rigidly with it.
    pub(crate) fn between(self, believed: Pose, real: Pose) -> Truth {
        let turn = real.heading - believed.heading;
        let (sin, cos) = turn.sin_cos();
        let shift = [real.x - (cos * believed.x - sin * believed.y), real.y - (sin * believed.x + cos * believed.y)];
        Truth { turn, shift, ..self }
    }

    /// The pose in the anatomy.
    pub(crate) fn pose(&self, Pose { x, y, heading, bevel }: Pose) -> Pose {
        let (sin, cos) = self.turn.sin_cos();
        let [dx, dy] = self.shift;
        Pose { x: cos * x - sin * y + dx, y: sin * x + cos * y + dy, heading: heading + self.turn, bevel }
    }

    /// The needle with the true curvature at a pose in the anatomy. The lengths of its steps are as planned.
    fn needle(&self, setup: &Setup, pose: Pose) -> Bicycle {
        let planned = setup.needle_at([pose.x, pose.y]);
        if self.curvature == 1.0 {
            return planned;
        }
        Bicycle { radius: planned.radius / self.curvature, step: Some(planned.step_length()), ..planned }
    }
}

/// How the needle bends, and what it meets.
pub(crate) trait Surroundings {
    /// The needle with the curvature at a pose.
    fn needle(&self, setup: &Setup, pose: Pose) -> Bicycle;
    /// The event at a point.
    fn event(&self, setup: &Setup, point: [f64; 2]) -> Option<Event>;
    /// The first event on an arc, and its arc length, mm.
    fn first_event(&self, setup: &Setup, arc: &Arc) -> Option<(Event, f64)>;
}

/// The surroundings that the plan knows.
pub(crate) struct AsPlanned;

impl Surroundings for AsPlanned {
    fn needle(&self, setup: &Setup, pose: Pose) -> Bicycle {
        setup.needle_at([pose.x, pose.y])
    }
    fn event(&self, setup: &Setup, point: [f64; 2]) -> Option<Event> {
        setup.workspace.event(point)
    }
    fn first_event(&self, setup: &Setup, arc: &Arc) -> Option<(Event, f64)> {
        setup.workspace.first_event(arc)
    }
}

/// What the controller believes of a needle that bends as it truly does.
pub(crate) struct AsBelieved<'a>(pub &'a Truth);

impl Surroundings for AsBelieved<'_> {
    fn needle(&self, setup: &Setup, pose: Pose) -> Bicycle {
        self.0.needle(setup, self.0.pose(pose))
    }
    fn event(&self, setup: &Setup, point: [f64; 2]) -> Option<Event> {
        AsPlanned.event(setup, point)
    }
    fn first_event(&self, setup: &Setup, arc: &Arc) -> Option<(Event, f64)> {
        AsPlanned.first_event(setup, arc)
    }
}

/// The obstacles that the tip truly meets, for poses in the anatomy.
pub(crate) struct InAnatomy<'a>(pub &'a Truth);

impl Surroundings for InAnatomy<'_> {
    fn needle(&self, setup: &Setup, pose: Pose) -> Bicycle {
        self.0.needle(setup, pose)
    }
    fn event(&self, setup: &Setup, point: [f64; 2]) -> Option<Event> {
        setup.workspace.is_blocked(point).then_some(Event::Collision)
    }
    fn first_event(&self, setup: &Setup, arc: &Arc) -> Option<(Event, f64)> {
        setup.workspace.first_collision(arc).map(|s| (Event::Collision, s))
    }
}
