"""Files that a needle is registered from, of a coil 9.3 mm behind the tip."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from needleplan.estimation.registration import PoseNoise, Registration, RegistrationVerdict, VerdictStatus
from needleplan.signals import Array

OFFSET_MM = 9.3
TURNED = Rotation.from_euler("ZYX", [0.3, -1.2, 2.0])
SHIFT_MM = np.array([-40.0, 12.0, 300.0])
NOISE = PoseNoise(0.35)  # 0.2 mm in each coordinate
PLAN = np.array([[0, 0, 0], [120, 0, 0], [120, 80, 0], [0, 80, 0], [60, 40, 30], [30, 10, -20.0]])


def write(file: Path, header: str, rows: Sequence[Sequence[object]]) -> Path:
    """Write a CSV file."""
    file.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return file


def write_poses(file: Path, degrees: float = 30.0, poses: int = 200, seed: int = 0, sign: float = 1.0) -> Path:
    """Write poses about a fixed tip, with 0.2 mm of noise; with `sign` -1 the axis of the coil points backwards."""
    random = np.random.default_rng(seed)
    tilt, turn = random.uniform(0, np.radians(degrees), poses), random.uniform(-np.pi, np.pi, poses)
    turned = Rotation.from_euler("ZYZ", np.column_stack([turn, tilt, -turn]))
    places = [5, 6, 7] - OFFSET_MM * turned.apply([0, 0, 1]) + random.normal(0, 0.2, (poses, 3))
    if sign < 0:
        turned = turned * Rotation.from_euler("X", np.pi)
    return write(file, "x_mm,y_mm,z_mm,qx,qy,qz,qw", np.column_stack([places, turned.as_quat()]).round(6).tolist())


def tracker_points(plan: Array = PLAN, seed: int = 0, noise_mm: float = 0.2) -> Array:
    """Where the tracker sees the points of the plan."""
    return (plan - SHIFT_MM) @ TURNED.as_matrix() + np.random.default_rng(seed).normal(0, noise_mm, plan.shape)


def write_points(file: Path, tracker: Array | None = None, plan: Array = PLAN) -> Path:
    """Write pairs of points, named P1, P2 and so on."""
    tracker = tracker_points(plan) if tracker is None else tracker
    header = "name,tracker_x_mm,tracker_y_mm,tracker_z_mm,plan_x_mm,plan_y_mm,plan_z_mm"
    rows = [
        [f"P{number}", *a, *b] for number, (a, b) in enumerate(zip(tracker.tolist(), plan.tolist(), strict=True), 1)
    ]
    return write(file, header, rows)


def known(coil_offset_mm: float = 0.0) -> Registration:
    """Return a registration to the frame of the tracker that a person accepts."""
    verdict = RegistrationVerdict(VerdictStatus.ACCEPTED, accepted="a simulated tracker")
    return Registration(coil_offset_mm=coil_offset_mm, verdict=verdict)
