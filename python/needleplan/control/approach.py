"""The last steps: where on its arc the tip comes closest to the centre of the target, and whether that is the end."""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.control.scene import Scene
from needleplan.planning import Pose

__all__ = ["NEARLY_MM", "Approach"]

NEARLY_MM = 0.05
"""An arc whose closest point is nearer than twice that has been followed to its end."""

_GAIN_MM = 0.1
"""A last step beside the target must bring the tip nearer by so much."""


@dataclass(frozen=True)
class Approach:
    """Towards the target of a scene, with a needle that bends by an estimated curvature."""

    scene: Scene
    curvature_per_mm: float

    def inside(self, pose: Pose) -> bool:
        """Whether the tip is in the target."""
        distance = self.scene.target_distance_mm(pose.x_mm, pose.y_mm)
        return distance <= self.scene.scenario.target.radius_mm

    def done(self, pose: Pose) -> bool:
        """Whether the tip is in the target, and going on would not bring it nearer to its centre."""
        return self.inside(pose) and self.closest(pose)[0] < 2 * NEARLY_MM

    def closest(self, pose: Pose) -> tuple[float, float]:
        """Return where on the next step the tip is closest to the centre of the target, and how close: mm, mm."""
        step = self.scene.step_mm(pose.x_mm, pose.y_mm)
        bend = pose.bevel * self.curvature_per_mm
        return self.scene.closest(pose.x_mm, pose.y_mm, pose.heading_rad, bend, step)

    def length_mm(self, pose: Pose, room_mm: float) -> tuple[float, bool]:
        """Return how far to insert, at most `room_mm`, and whether that is where the needle is to end."""
        step = self.scene.step_mm(pose.x_mm, pose.y_mm)
        along, distance = self.closest(pose)
        if room_mm < step:
            return room_mm, True
        if NEARLY_MM <= along < step and distance <= self.scene.scenario.target.radius_mm:
            return along, True
        return step, False

    def near(self, pose: Pose) -> bool:
        """Whether the target is less than two steps away."""
        scene = self.scene
        reach = scene.scenario.target.radius_mm + 2 * scene.step_mm(pose.x_mm, pose.y_mm)
        return scene.target_distance_mm(pose.x_mm, pose.y_mm) <= reach

    def beside(self, pose: Pose) -> tuple[Pose, float] | None:
        """Return the bevel and the length of a last step that ends as near to the target as it still can.

        None where the target is not near, or nothing would be gained, or an obstacle is there.
        """
        if not self.near(pose):
            return None
        best = min((pose, pose._replace(bevel=-pose.bevel)), key=lambda each: self.closest(each)[1])
        along, distance = self.closest(best)
        gain = self.scene.target_distance_mm(pose.x_mm, pose.y_mm) - distance
        bend = best.bevel * self.curvature_per_mm
        if gain < _GAIN_MM or self.scene.blocked(best.x_mm, best.y_mm, best.heading_rad, bend, along):
            return None
        return best, along
