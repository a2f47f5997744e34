"""Damaged registrations are refused with their reason, sound ones pass."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from needleplan.errors import DataError
from needleplan.estimation.registration import (
    PoseNoise,
    RefusalReason,
    Registered,
    VerdictStatus,
    calibrate_needle,
    noise_at_rest,
    read_poses,
    register_tracker,
)
from needleplan.signals import Array
from tests.estimation.registrations import NOISE, SHIFT_MM, TURNED, write

SIX = np.array([[0, 0, 0], [120, 0, 0], [115, 80, 0], [0, 75, 10], [60, 40, 30], [30, 10, -20.0]])
EIGHT = np.vstack([SIX, [[90, 25, 15], [10, 50, -30.0]]])
TIP_MM = np.array([5.0, 60.0, 170.0])


@dataclass(frozen=True)
class Measured:
    """Measurements of a needle: poses about its tip (quaternions w first), and points touched with a pointer."""

    positions: Array
    quaternions: Array
    tracker: Array
    plan: Array
    touched: Array | None = None
    """Quaternions of the coil at the points, if the needle itself touched them."""

    def registered(self, folder: Path, noise: PoseNoise | None = NOISE, accepted: str = "") -> Registered:
        poses = np.column_stack([self.positions, self.quaternions]).tolist()
        pivot = write(folder / "poses.csv", "x_mm,y_mm,z_mm,qw,qx,qy,qz", poses)
        header, rows = "tracker_x_mm,tracker_y_mm,tracker_z_mm,plan_x_mm,plan_y_mm,plan_z_mm", [self.tracker, self.plan]
        if self.touched is not None:
            header, rows = f"{header},qw,qx,qy,qz", [*rows, self.touched]
        points = write(folder / "points.csv", header, np.column_stack(rows).tolist())
        return register_tracker(pivot, points, noise=noise, accepted=accepted)


def w_first(rotation: Rotation) -> Array:
    return np.asarray(rotation.as_quat(scalar_first=True))


def measured(plan: Array = SIX, seed: int = 0, offset_mm: float = 12.0, sd_mm: float = 0.2) -> Measured:
    """200 poses in a cone of 30 degrees, and points, with noise in each coordinate."""
    random = np.random.default_rng(seed)
    tilt, turn = random.uniform(0, np.radians(30), 200), random.uniform(-np.pi, np.pi, (2, 200))
    turned = Rotation.from_euler("ZYZ", np.column_stack([turn[0], tilt, turn[1]]))
    turned = Rotation.from_euler("xyz", [0.5, 0.3, -1.0]) * turned
    positions = TIP_MM - offset_mm * turned.apply([0, 0, 1]) + random.normal(0, sd_mm, (200, 3))
    tracker = (plan - SHIFT_MM) @ TURNED.as_matrix() + random.normal(0, sd_mm, plan.shape)
    return Measured(positions, w_first(turned), tracker, plan)


def touched(seed: int = 0, offset_mm: float = 12.0) -> Measured:
    """Points touched with the needle itself."""
    found = measured(seed=seed, offset_mm=offset_mm)
    turned = Rotation.random(len(SIX), random_state=seed)
    return replace(found, tracker=found.tracker - offset_mm * turned.apply([0, 0, 1]), touched=w_first(turned))


def with_rows(values: Array, rows: object, new: object) -> Array:
    changed = values.copy()
    changed[rows] = new
    return changed


def identity_poses(count: int) -> Measured:
    """PLUS writes the identity for a tool out of view."""
    found, rows = measured(), slice(40, 40 + count)
    return replace(
        found, positions=with_rows(found.positions, rows, 0.0),
        quaternions=with_rows(found.quaternions, rows, [1.0, 0, 0, 0]),
    )  # fmt: skip


def frozen_poses(count: int) -> Measured:
    found, rows = measured(), slice(50, 50 + count)
    return replace(
        found, positions=with_rows(found.positions, rows, found.positions[49]),
        quaternions=with_rows(found.quaternions, rows, found.quaternions[49]),
    )  # fmt: skip


def slipped_tip() -> Measured:
    found = measured()
    return replace(
        found, positions=with_rows(found.positions, slice(100, 200), found.positions[100:] + np.array([0, 6.0, 0]))
    )


def drifting_tip() -> Measured:
    found = measured()
    return replace(found, positions=found.positions + np.linspace(0, 15, 200)[:, None] * [0.6, 0.8, 0.0])


def reordered(plan: Array, order: list[int]) -> Measured:
    found = measured(plan)
    return replace(found, plan=plan[order])


def moved_point() -> Measured:
    found = measured()
    return replace(found, tracker=found.tracker + np.eye(6)[:, [3]] * [10.0, 0, 0])


def scaled(tracker: float = 1.0, plan: float = 1.0, poses: float = 1.0) -> Measured:
    found = measured()
    return replace(
        found, tracker=found.tracker * tracker, plan=found.plan * plan, positions=found.positions * poses
    )  # fmt: skip


QUATERNION, PAIRING, HANDEDNESS = RefusalReason.QUATERNION_ORDER, RefusalReason.PAIRING, RefusalReason.HANDEDNESS
IDENTITY, REPEATED, UNITS, RESIDUAL = (
    RefusalReason.IDENTITY_POSES, RefusalReason.REPEATED_POSES, RefusalReason.UNITS, RefusalReason.RESIDUAL,
)  # fmt: skip
SWAPPED = [0, 1, 4, 3, 2, 5]

DAMAGED: dict[str, tuple[Callable[[], Measured], RefusalReason, str]] = {
    "40 of 200 poses are the identity": (lambda: identity_poses(40), IDENTITY, "40 of 200 poses are at the origin"),
    "one pose is the identity": (lambda: identity_poses(1), IDENTITY, "line 42"),
    "the tracker froze for a second": (lambda: frozen_poses(40), REPEATED, "40 of 200 poses repeat"),
    "one frame came twice": (lambda: frozen_poses(1), REPEATED, "1 of 200 poses repeat"),
    "x, y, z, w under the names w, x, y, z": (
        lambda: replace(measured(), quaternions=measured().quaternions[:, [1, 2, 3, 0]]), QUATERNION,
        "qw, qx, qy, qz hold x, y, z, w",
    ),
    "w, x, y, z under the names x, y, z, w": (
        lambda: replace(measured(), quaternions=measured().quaternions[:, [3, 0, 1, 2]]), QUATERNION,
        "qx, qy, qz, qw hold w, x, y, z",
    ),
    "inverse rotations": (
        lambda: replace(measured(), quaternions=measured().quaternions * [1, -1, -1, -1]), QUATERNION, "are inverse",
    ),
    "x, y, z, w with a coil near the tip": (
        lambda: replace(measured(offset_mm=3.0), quaternions=measured(offset_mm=3.0).quaternions[:, [1, 2, 3, 0]]),
        QUATERNION, "hold x, y, z, w",
    ),
    "x, y, z, w in the touched points": (
        lambda: replace(touched(), touched=w_first(Rotation.random(6, random_state=0))[:, [1, 2, 3, 0]]), QUATERNION,
        "of the points: if the columns",
    ),
    "poses in metres": (lambda: scaled(poses=1e-3), UNITS, "metres?"),
    "poses in micrometres": (lambda: scaled(poses=1e3 / 2), UNITS, "micrometres?"),
    "both frames in metres": (lambda: scaled(tracker=1e-3, plan=1e-3), UNITS, "metres?"),
    "the plan in metres": (lambda: scaled(plan=1e-3), UNITS, "are 0.001 times those of the tracker"),
    "the plan in centimetres": (lambda: scaled(plan=0.1), UNITS, "are 0.1 times those of the tracker"),
    "the tracker in inches": (lambda: scaled(tracker=1 / 25.4), UNITS, "are 25 times those of the tracker"),
    "two of six points exchanged": (lambda: reordered(SIX, SWAPPED), PAIRING, "line 4 and line 6 exchanged"),
    "six points reversed": (lambda: reordered(SIX, [5, 4, 3, 2, 1, 0]), PAIRING, "reversed order"),
    "six points shifted by one": (lambda: reordered(SIX, [1, 2, 3, 4, 5, 0]), PAIRING, "paired with other points"),
    "two of eight points exchanged": (lambda: reordered(EIGHT, [0, 7, 2, 3, 4, 5, 6, 1]), PAIRING, "line 3 and line 9"),
    "eight points reversed": (lambda: reordered(EIGHT, [7, 6, 5, 4, 3, 2, 1, 0]), PAIRING, "reversed order"),
    "a mirrored axis": (
        lambda: replace(measured(), tracker=measured().tracker * [1, 1, -1]), HANDEDNESS, "axis of a frame mirrored",
    ),
    "two axes exchanged": (
        lambda: replace(measured(EIGHT), plan=EIGHT[:, [1, 0, 2]]), HANDEDNESS, "axis of a frame mirrored",
    ),
    "exchanged points and a mirrored axis": (
        lambda: replace(reordered(SIX, SWAPPED), plan=SIX[SWAPPED] * [1, -1, 1]), PAIRING, "and line 6 exchanged",
    ),
    "a point off by 10 mm": (moved_point, RESIDUAL, "times the noise of the tracker"),
    "the tip slipped": (slipped_tip, RESIDUAL, "that of the poses"),
    "the tip drifted": (drifting_tip, RESIDUAL, "that of the poses"),
    "metal nearby": (lambda: measured(sd_mm=1.6), RESIDUAL, "at most 5 times is allowed"),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_registration_is_refused_with_its_reason(damage: str, tmp_path: Path) -> None:
    make, reason, says = DAMAGED[damage]
    done = make().registered(tmp_path)
    assert done.verdict.status is VerdictStatus.REFUSED
    assert done.registration is None
    assert not done.ok
    texts = [refusal.text for refusal in done.refusals if refusal.reason is reason]
    assert any(says in text for text in texts), done.verdict.reasons
    assert done.verdict.reasons == tuple(f"{refusal}" for refusal in done.refusals)


@pytest.mark.study
def test_no_sound_registration_of_a_hundred_is_refused(tmp_path: Path) -> None:
    assert all(measured(EIGHT, seed).registered(tmp_path).ok for seed in range(100))


@pytest.mark.parametrize("points", [SIX, EIGHT, SIX[:4], SIX[[0, 1, 3]]])
def test_sound_registrations_pass(points: Array, tmp_path: Path) -> None:
    for seed in range(4):
        done = measured(points, seed).registered(tmp_path)
        assert done.verdict.status is VerdictStatus.PASSED, done.verdict.reasons
        assert done.registration
        assert done.registration.coil_offset_mm == pytest.approx(12.0, abs=0.3)
        assert touched(seed).registered(tmp_path).ok


def test_a_coil_at_the_tip_is_a_remark(tmp_path: Path) -> None:
    for seed in range(4):
        done = measured(seed=seed, offset_mm=0.0).registered(tmp_path)
        assert done.verdict.status is VerdictStatus.PASSED, done.verdict.reasons
        assert done.registration
        assert done.registration.coil_offset_mm < 0.2
    done = measured(seed=3, offset_mm=0.0).registered(tmp_path)
    assert any("the coil may be at the tip" in remark for remark in done.remarks)


def test_without_a_known_noise_nothing_passes(tmp_path: Path) -> None:
    done = measured().registered(tmp_path, noise=None)
    assert [refusal.reason for refusal in done.refusals] == [RefusalReason.NOISE_UNKNOWN]
    assert not calibrate_needle(tmp_path / "poses.csv").ok
    assert calibrate_needle(tmp_path / "poses.csv", NOISE).ok


def test_a_person_accepts_with_a_reason(tmp_path: Path) -> None:
    done = moved_point().registered(tmp_path, accepted="  a phantom  ")
    assert done.registration
    verdict = done.registration.verdict
    assert (verdict.status, verdict.accepted) == (VerdictStatus.ACCEPTED, "a phantom")
    assert verdict.reasons[0].startswith("residual: ")
    assert measured().registered(tmp_path, accepted="in vain").verdict.status is VerdictStatus.PASSED
    still = replace(measured(), quaternions=np.tile([1.0, 0, 0, 0], (200, 1)))
    assert not still.registered(tmp_path, accepted="in vain").ok


def test_a_symmetric_phantom_is_remarked_on(tmp_path: Path) -> None:
    square = np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0.0]])
    remarks = measured(square).registered(tmp_path).remarks
    assert any("an exchange would not be noticed" in remark for remark in remarks)
    assert any("lie in one plane" in remark for remark in remarks)
    assert not any("exchange" in remark for remark in measured().registered(tmp_path).remarks)


def rest_file(folder: Path, positions: Array, quaternions: Array) -> Path:
    rows = np.column_stack([positions, quaternions]).tolist()
    return write(folder / "rest.csv", "x_mm,y_mm,z_mm,qw,qx,qy,qz", rows)


def test_noise_is_measured_at_rest(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    tilted = Rotation.from_rotvec(random.normal(0, 0.01, (400, 3)))
    file = rest_file(tmp_path, TIP_MM + random.normal(0, 0.2, (400, 3)), w_first(tilted))
    noise = noise_at_rest(read_poses(file))
    assert noise.position_mm == pytest.approx(0.2 * 3**0.5, rel=0.05)
    assert noise.direction_rad == pytest.approx(0.01 * 2**0.5, rel=0.07)
    assert noise.at_tip_mm(100.0) == pytest.approx(np.hypot(0.2 * 3**0.5, 2**0.5), rel=0.07)
    assert noise.source == "measured at rest, 400 poses"


def test_poses_that_show_no_noise_are_refused(tmp_path: Path) -> None:
    random, turned = np.random.default_rng(4), np.tile([1.0, 0, 0, 0], (20, 1))
    still = np.tile(TIP_MM, (20, 1))
    for positions, says in (
        (still, "repeat another one"),
        (random.normal(0, 1, (9, 3)), "must be at least 10"),
        (with_rows(random.normal(0, 1, (20, 3)), 3, 0.0), "are at the origin"),
    ):
        with pytest.raises(DataError, match=says):
            noise_at_rest(read_poses(rest_file(tmp_path, positions, turned[: len(positions)])))
    with pytest.raises(DataError, match="positive"):
        PoseNoise(0.0)


def test_poses_of_a_needle_that_moves_are_no_noise(tmp_path: Path) -> None:
    """White noise, and that of a tracker that averages, are noise; a pivot, a drift and a turn are none."""
    random, count = np.random.default_rng(5), 400
    white, still = random.normal(0, 0.5, (count, 3)), np.tile(w_first(Rotation.identity()), (count, 1))
    smooth = white.copy()
    for row in range(1, count):
        smooth[row] += 0.7 * smooth[row - 1]
    for noise in (white, smooth):
        assert noise_at_rest(read_poses(rest_file(tmp_path, TIP_MM + noise, still))).position_mm > 0.5
    turning = np.linspace(0, 12, count)
    circle = 5.0 * np.column_stack([np.cos(turning), np.sin(turning), np.zeros(count)])
    for motion in (circle, np.linspace(0, 12, count)[:, None] * [1.0, 0, 0]):
        with pytest.raises(DataError, match=r"the needle moved: positions scatter by .* mm, from one to the next by"):
            noise_at_rest(read_poses(rest_file(tmp_path, TIP_MM + motion + 0.4 * white, still)))
    tilted = w_first(Rotation.from_rotvec(np.linspace(0, 1, count)[:, None] * [1.0, 0, 0]))
    with pytest.raises(DataError, match="the needle moved: directions scatter by"):
        noise_at_rest(read_poses(rest_file(tmp_path, TIP_MM + white, tilted)))
