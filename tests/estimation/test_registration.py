from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from needleplan.errors import DataError
from needleplan.estimation import calibrate_axis, calibrate_pivot, register
from needleplan.signals import Array

TIP_MM = 9.3


def cone(random: np.random.Generator, poses: int, degrees: float) -> Rotation:
    """Rotations whose z axis lies within a cone, with any roll."""
    tilt, turn, roll = random.uniform(0, np.radians(degrees), poses), *random.uniform(-np.pi, np.pi, (2, poses))
    return Rotation.from_euler("ZYZ", np.column_stack([turn, tilt, roll]))


def pivoted(random: np.random.Generator, poses: int, tip: Array, mm: float, degrees: float) -> tuple[Array, Rotation]:
    """Poses about a fixed tip, with errors of position and direction."""
    true = cone(random, poses, 30.0)
    positions = np.array([10.0, -20.0, 30.0]) - true.apply(tip) + random.normal(0, mm, (poses, 3))
    return positions, Rotation.from_rotvec(np.radians(random.normal(0, degrees, (poses, 3)))) * true


def test_an_axis_gives_the_distance_of_the_tip() -> None:
    random, found = np.random.default_rng(0), []
    for _ in range(100):
        positions, rotations = pivoted(random, 200, np.array([0, 0, TIP_MM]), 0.3, 0.2)
        found.append(calibrate_axis(positions, rotations.apply([0, 0, 1])))
    distance = np.array([each.tip_mm[0] for each in found])
    assert distance.mean() == pytest.approx(TIP_MM, abs=0.03)
    assert distance.std() == pytest.approx(0.061, rel=0.4)
    assert np.mean([each.tip_sd_mm[0] for each in found]) == pytest.approx(distance.std(), rel=0.35)


def test_exact_poses_give_the_tip() -> None:
    tip = np.array([1.0, -2.0, 50.0])
    positions, rotations = pivoted(np.random.default_rng(1), 30, tip, 0.0, 0.0)
    found = calibrate_pivot(positions, rotations)
    np.testing.assert_allclose(found.tip_mm, tip, atol=1e-9)
    np.testing.assert_allclose(found.pivot_mm, [10, -20, 30], atol=1e-9)
    assert found.rms_mm < 1e-9


def test_poses_that_do_not_turn_are_refused() -> None:
    random = np.random.default_rng(2)
    rolled = Rotation.from_euler("Z", random.uniform(-3, 3, (50, 1)))
    positions = random.normal(0, 0.1, (50, 3))
    with pytest.raises(DataError, match="must turn in a cone"):
        calibrate_pivot(positions, rolled)
    with pytest.raises(DataError, match="must turn in a cone"):
        calibrate_axis(positions, np.tile([0, 0, 1.0], (50, 1)))
    with pytest.raises(DataError, match="not of length zero"):
        calibrate_axis(positions, np.zeros((50, 3)))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 12), st.booleans())
def test_registration_is_exact_and_never_a_reflection(seed: int, points: int, flat: bool) -> None:
    random = np.random.default_rng(seed)
    first = random.uniform(-50, 50, (points, 3)) * (1, 1, 0 if flat else 1)
    rotation, shift = Rotation.random(random_state=seed), random.uniform(-100, 100, 3)
    found = register(first, rotation.apply(first) + shift)
    assert found.fre_mm < 1e-10
    assert np.linalg.det(found.rotation.as_matrix()) == pytest.approx(1)
    np.testing.assert_allclose(found.apply(first), rotation.apply(first) + shift, atol=1e-9)
    np.testing.assert_allclose(found.translation_mm, shift, atol=1e-8)


def test_errors_at_points_and_target_are_those_of_the_formulas() -> None:
    random, fle, target = np.random.default_rng(3), 0.5, np.array([30.0, -40.0, 80.0])
    first = random.uniform(-50, 50, (8, 3))
    fre, tre = [], []
    for _ in range(2000):
        noisy = first + random.normal(0, fle / np.sqrt(3), first.shape)
        found = register(first, noisy)
        fre.append(found.fre_mm**2)
        tre.append(((found.apply(target) - target) ** 2).sum())
    assert np.mean(fre) == pytest.approx((1 - 2 / 8) * fle**2, rel=0.04)
    assert np.mean(tre) == pytest.approx(register(first, first).tre_mm(target, fle) ** 2, rel=0.05)


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.outer(np.arange(5.0), [1, 2, 3]), np.zeros((2, 3))])
def test_degenerate_points_are_refused(points: Array) -> None:
    with pytest.raises(DataError):
        register(points, points)
    with pytest.raises(DataError, match="must be that of first_mm"):
        register(np.eye(3), np.zeros((4, 3)))
