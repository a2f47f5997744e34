"""A needle by small steps, written without the filter's model: a rotation matrix that is turned a little each time."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from needleplan.devices import Health, PoseSample, StageSample, Stamp
from needleplan.signals import Array

STEP_MM = 0.05
_BEFORE = 600


@dataclass
class Walk:
    """The frames along a path: columns of a matrix are tangent, left and up; one every 0.05 mm from -30 mm on."""

    random: np.random.Generator
    curvature_per_mm: float
    heading_noise: float
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    places: list[Array] = field(default_factory=list)
    frames: list[Rotation] = field(default_factory=list)

    def __post_init__(self) -> None:
        x, y, heading = self.pose
        start = Rotation.from_euler("z", heading)
        for step in range(-_BEFORE, 1):
            self.places.append(np.array([x, y, 0.0]) + step * STEP_MM * start.apply([1, 0, 0]))
            self.frames.append(start)

    def go(self, length_mm: float, roll_rad: float) -> None:
        """Cut so much further."""
        for _ in range(round(length_mm / STEP_MM)):
            wander = self.random.normal(0, self.heading_noise * np.sqrt(STEP_MM), 2)
            bend = self.curvature_per_mm * STEP_MM
            # Left is a turn about up, up is a turn about minus left.
            turn = (0.0, -bend * np.sin(roll_rad) - wander[1], bend * np.cos(roll_rad) + wander[0])
            frame = self.frames[-1] * Rotation.from_rotvec(turn)
            ends = self.frames[-1].apply([1, 0, 0]) + frame.apply([1, 0, 0])
            self.places.append(self.places[-1] + STEP_MM / 2 * ends)
            self.frames.append(frame)

    @property
    def length_mm(self) -> float:
        """How deep the tip is."""
        return (len(self.places) - 1 - _BEFORE) * STEP_MM

    def at(self, length_mm: float) -> tuple[Array, Array]:
        """Return place and tangent at a length."""
        row = round(length_mm / STEP_MM) + _BEFORE
        return self.places[row], self.frames[row].apply([1.0, 0.0, 0.0])

    def pose_of_coil(
        self, length_mm: float, time_ns: int, sequence: int, position_sd_mm: float, angle_sd_rad: float
    ) -> PoseSample:
        """Return what a tracker says of a coil at a length of the path."""
        place, tangent = self.at(length_mm)
        off = self.random.normal(0, angle_sd_rad, 3)
        tangent = tangent + off - (off @ tangent) * tangent
        quaternion = Rotation.align_vectors([tangent], [[0, 0, 1]])[0].as_quat()
        place = place + self.random.normal(0, position_sd_mm, 3)
        x, y, z, w = quaternion.tolist()
        return PoseSample(Stamp(time_ns, sequence), tuple(place.tolist()), (w, x, y, z), position_sd_mm)


def stage(time_ns: int, depth_mm: float, roll_rad: float, velocity_mm_s: float = 0.0) -> StageSample:
    """Return a stage sample."""
    return StageSample(Stamp(time_ns, time_ns // 1_000_000), depth_mm, velocity_mm_s, roll_rad, moving=True)


def unseen(pose: PoseSample, health: Health) -> PoseSample:
    """Return the pose as a tracker that does not trust it says it."""
    return PoseSample(pose.stamp, pose.position_mm, pose.quaternion, pose.error_mm, health)
