import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from needleplan.errors import DataError
from needleplan.estimation import PivotStatus, calibrate_axis, calibrate_pivot, register, worst_pair
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


def test_least_squares_over_all_poses_finds_the_same() -> None:
    random = np.random.default_rng(8)
    positions, rotations = pivoted(random, 60, np.array([0, 0, TIP_MM]), 0.3, 0.2)
    axes = rotations.apply([0, 0, 1])
    slow = least_squares(lambda u: (positions + u[0] * axes - u[1:]).ravel(), np.array([1.0, 0, 0, 0]))
    found = calibrate_axis(positions, 7 * axes)
    assert found.tip_mm[0] == pytest.approx(slow.x[0], abs=1e-6)
    np.testing.assert_allclose(found.pivot_mm, slow.x[1:], atol=1e-6)
    whole = least_squares(lambda u: (positions + rotations.apply(u[:3]) - u[3:]).ravel(), np.ones(6))
    np.testing.assert_allclose(calibrate_pivot(positions, rotations).tip_mm, whole.x[:3], atol=1e-5)


def test_intervals_hold_the_tip_as_often_as_they_say() -> None:
    random, inside = np.random.default_rng(9), 0
    for _ in range(300):
        positions, rotations = pivoted(random, 40, np.array([0, 0, TIP_MM]), 0.3, 0.0)
        low, high = calibrate_axis(positions, rotations.apply([0, 0, 1])).interval_mm
        inside += low[0] <= TIP_MM <= high[0]
    assert 0.92 <= inside / 300 <= 0.98


def test_spread_is_the_angle_that_the_needle_turned() -> None:
    random = np.random.default_rng(10)
    turn = random.uniform(-np.pi, np.pi, 500)
    # On the edge of a cone of 20 degrees every direction is 20 degrees from the mean.
    rotations = Rotation.from_euler("ZYZ", np.column_stack([turn, np.full(500, np.radians(20)), turn * 3]))
    positions = -rotations.apply([0, 0, TIP_MM])
    found = calibrate_axis(positions, rotations.apply([0, 0, 1]))
    assert np.degrees(found.spread_rad) == pytest.approx(20, rel=0.02)
    assert found.ok
    assert found.condition == pytest.approx(1 / np.tan(np.radians(10)), rel=0.03)


def test_poses_that_do_not_turn_determine_nothing() -> None:
    random = np.random.default_rng(2)
    rolled = Rotation.from_euler("Z", random.uniform(-3, 3, (50, 1)))
    positions = random.normal(0, 0.1, (50, 3))
    still = calibrate_axis(positions, np.tile([0, 0, 1.0], (50, 1)) + random.normal(0, 0.01, (50, 3)))
    for found in (calibrate_pivot(positions, rolled), still):
        assert found.status is PivotStatus.TOO_LITTLE_ROTATION
        assert not found.ok
        assert np.isnan([*found.tip_mm, *found.tip_sd_mm, *found.pivot_mm, found.rms_mm]).all()
    few = calibrate_axis(*(each[:9] for each in (positions, cone(random, 50, 30).apply([0, 0, 1]))))
    assert few.status is PivotStatus.TOO_FEW_POSES
    assert calibrate_axis(np.zeros((0, 3)), np.zeros((0, 3))).status is PivotStatus.TOO_FEW_POSES
    with pytest.raises(DataError, match="not of length zero"):
        calibrate_axis(positions, np.zeros((50, 3)))


def test_a_pose_that_slipped_is_named() -> None:
    positions, rotations = pivoted(np.random.default_rng(11), 100, np.array([0, 0, TIP_MM]), 0.3, 0.2)
    assert calibrate_axis(positions, rotations.apply([0, 0, 1])).outliers == ()
    positions[17] += 4.0
    assert calibrate_axis(positions, rotations.apply([0, 0, 1])).outliers == (17,)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 12), st.booleans())
def test_registration_is_exact_and_never_a_reflection(seed: int, points: int, flat: bool) -> None:
    random = np.random.default_rng(seed)
    first = random.uniform(-50, 50, (points, 3)) * (1, 1, 0 if flat else 1)
    spread = np.linalg.svd(first - first.mean(axis=0), compute_uv=False)
    assume(spread[1] > 0.1 * spread[0])  # points next to a line are refused
    rotation, shift = Rotation.random(random_state=seed), random.uniform(-100, 100, 3)
    found = register(first, rotation.apply(first) + shift)
    assert found.fre_mm < 1e-10
    assert np.linalg.det(found.rotation.as_matrix()) == pytest.approx(1)
    np.testing.assert_allclose(found.apply(first), rotation.apply(first) + shift, atol=1e-9)
    np.testing.assert_allclose(found.translation_mm, shift, atol=1e-8)


@pytest.mark.slow
def test_errors_at_points_and_target_are_those_of_the_formulas() -> None:
    random, fle, target = np.random.default_rng(3), 0.5, np.array([30.0, -40.0, 80.0])
    first = random.uniform(-50, 50, (8, 3))
    fre, tre = [], []
    for _ in range(800):
        noisy = first + random.normal(0, fle / np.sqrt(3), first.shape)
        found = register(first, noisy)
        fre.append(found.fre_mm**2)
        tre.append(((found.apply(target) - target) ** 2).sum())
    assert np.mean(fre) == pytest.approx((1 - 2 / 8) * fle**2, rel=0.05)
    assert np.mean(tre) == pytest.approx(register(first, first).tre_mm(target, fle) ** 2, rel=0.1)


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.outer(np.arange(5.0), [1, 2, 3]), np.zeros((2, 3))])
def test_degenerate_points_are_refused(points: Array) -> None:
    with pytest.raises(DataError, match=r"first_mm = \d points: must (not lie|be at least 3)"):
        register(points, points)
    with pytest.raises(DataError, match="must be that of first_mm"):
        register(np.eye(3), np.zeros((4, 3)))


@pytest.mark.slow
@pytest.mark.parametrize("points", [4, 6, 12])
def test_a_bad_point_is_named_and_good_ones_are_not(points: int) -> None:
    random, blamed, found = np.random.default_rng(12), 0, 0
    for trial in range(40):
        first = random.uniform(-50, 50, (points, 3))
        rotation = Rotation.random(random_state=trial)
        second = rotation.apply(first) + random.normal(0, 0.2, first.shape)
        blamed += worst_pair(first, second) is not None
        bad = trial % points
        second[bad] += rotation.apply([0.0, 10.0, 10.0])
        worst = worst_pair(first, second)
        found += worst is not None and worst.number == bad
    assert blamed <= 3
    assert found >= (38 if points > 4 else 4)


def test_three_points_leave_nothing_to_find_a_bad_one_with() -> None:
    assert worst_pair(np.eye(3) * 50, np.eye(3) * 51) is None


def test_a_wrong_sign_shows_in_the_mirror_image() -> None:
    random = np.random.default_rng(13)
    first = random.uniform(-50, 50, (6, 3))
    second = Rotation.random(random_state=1).apply(first) * (1, 1, -1)
    found = register(first, second)
    assert found.mirrored_fre_mm < 1e-9 < 1 < found.fre_mm
