//! What follows an execution in 3D.

use crate::space::arc::{SpacePose, Vec3};
use crate::space::volume::Volume;
use crate::workspace::Event;

/// Who watches an execution, and says what differs from the plan.
pub(crate) trait Watch {
    /// The tip passes a pose. Returns the believed position.
    #[inline]
    fn passes(&mut self, pose: SpacePose) -> Vec3 {
        pose.position
    }
    /// Tip noise turns the tip at a pose to another tangent.
    #[inline]
    fn turns(&mut self, _pose: SpacePose, _tangent: Vec3) {}
    /// The pose that the controller believes, if the tip is at this one.
    #[inline]
    fn believed(&self, pose: SpacePose) -> SpacePose {
        pose
    }
    /// Whether the controller learns the tip noise late.
    #[inline]
    fn is_late(&self) -> bool {
        false
    }
    /// The needle is turned to another roll angle.
    fn rotates(&mut self) {}
    /// Curvature, 1/mm, at a position.
    #[inline]
    fn curvature(&self, volume: &Volume, position: Vec3) -> f64 {
        volume.curvature(position)
    }
    /// Whether the curvature is not that at the position in the plan.
    #[inline]
    fn is_elsewhere(&self) -> bool {
        false
    }
    /// What has ended the execution before the end that the plan knows.
    #[inline]
    fn event(&self) -> Option<Event> {
        None
    }
    /// The event that the one at the end truly is.
    #[inline]
    fn judged(&mut self, event: Event) -> Event {
        event
    }
}

impl Watch for () {}
