"""The error of a registration as a covariance, against its formula and against simulated registrations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from needleplan.errors import DataError
from needleplan.estimation.registration import Registration, register
from needleplan.signals import RigidError
from tests.estimation.registrations import PLAN, SHIFT_MM, TURNED, tracker_points

TARGET = np.array([80.0, 35.0, 60.0])


def test_the_tre_is_that_of_the_file() -> None:
    tracker = tracker_points(noise_mm=0.5)
    made = register(tracker, PLAN)
    back = made.rotation.inv().apply(TARGET - made.translation_mm)
    assert made.error.tre_mm(TARGET) == pytest.approx(made.tre_mm(back), rel=1e-9)
    file = Registration(
        quaternion=tuple(made.rotation.as_quat(scalar_first=True)), translation_mm=tuple(made.translation_mm),
        points=tuple((tuple(a), tuple(b)) for a, b in zip(tracker.tolist(), PLAN.tolist(), strict=True)),
    )  # fmt: skip
    assert file.error is not None
    assert file.error.tre_mm(TARGET) == pytest.approx(file.tre_mm(tuple(TARGET.tolist())), rel=1e-6)


def test_the_covariance_is_that_of_repeated_registrations() -> None:
    noise, true = 0.3, (PLAN - SHIFT_MM) @ TURNED.as_matrix()
    found = []
    for seed in range(1500):
        made = register(true + np.random.default_rng(seed).normal(0, noise, true.shape), PLAN)
        found.append(made.apply(TURNED.inv().apply(TARGET - SHIFT_MM)) - TARGET)
    made = register(true + np.random.default_rng(0).normal(0, noise, true.shape), PLAN)
    size = np.sqrt(3) * noise / made.fle_mm  # the true error of the points for the estimated one
    error = RigidError(made.error.centre_mm, size**2 * made.error.covariance)
    drawn = error.motions(np.random.default_rng(1).standard_normal((20_000, 6))) @ np.append(TARGET, 1) - TARGET
    # A standard deviation of 1,500 numbers is off by 1.8 % (one standard deviation).
    assert np.cov(np.array(found).T) == pytest.approx(np.cov(drawn.T), abs=0.12 * np.cov(drawn.T).max())
    assert np.sqrt((drawn**2).sum(1).mean()) == pytest.approx(error.tre_mm(TARGET), rel=0.02)


def test_another_frame_moves_the_error_with_it() -> None:
    turn, origin = Rotation.from_euler("ZYX", [0.5, 0.2, -1.0]).as_matrix(), np.array([5.0, -3.0, 8.0])
    root = np.random.default_rng(2).normal(size=(6, 6)) * 0.01
    error = RigidError((1.0, 2.0, 3.0), root @ root.T)
    moved = error.moved(turn, origin)
    assert moved.tre_mm(turn @ (TARGET - origin)) == pytest.approx(error.tre_mm(TARGET))


def test_wrong_covariances_are_errors() -> None:
    for centre, covariance in (
        ((0, 0), np.eye(6)), ((0, 0, 0), np.eye(5)), ((0, 0, 0), -np.eye(6)), ((0, 0, np.nan), np.eye(6)),
        ((0, 0, 0), np.triu(np.ones((6, 6)))),
    ):  # fmt: skip
        with pytest.raises(DataError):
            RigidError(centre, covariance)
