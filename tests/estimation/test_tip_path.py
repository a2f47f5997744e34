"""The model of the tip filter: its arcs beside those of the plant, its covariances beside small steps, its channel."""

import math
from itertools import pairwise

import numpy as np
import pytest
from filterpy.kalman import update as kalman_update
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan import _ppvi
from needleplan.estimation import TipSettings
from needleplan.estimation.tip import _path
from needleplan.estimation.tip._path import (
    CHANGE,
    FACTOR,
    HEADING,
    ROLL,
    SIZE,
    ChannelPiece,
    CutChannel,
    moved,
    tangent,
)
from needleplan.models import TipFrame
from tests.estimation import slow_path

LEGS = st.lists(st.tuples(st.floats(0.1, 30), st.floats(-4, 4)), min_size=1, max_size=5)


def piece(length_mm: float, roll_rad: float, turned_rad: float = 0.0) -> ChannelPiece:
    """A piece of fresh tissue with one roll."""
    return ChannelPiece(length_mm, math.cos(roll_rad), math.sin(roll_rad), turned_rad, fresh=True)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(LEGS, st.floats(-1, 1), st.floats(0.5, 1.5), st.floats(-0.3, 0.3))
def test_arcs_are_those_of_a_frame_that_does_not_twist(
    legs: list[tuple[float, float]], heading: float, factor: float, off: float
) -> None:
    # The bend out of the plane is small: half a turn out of it is no needle of this planner.
    frame = TipFrame.planar(3.0, -2.0, heading)
    state = np.array([3, -2, 0, heading, 0, factor, off, 0, 0, 0, 0], float)
    for length, roll in legs:
        bend = factor / 200
        parts = 40
        for _ in range(parts):
            frame = frame.arc(bend * math.cos(roll + off), bend * math.sin(roll + off), length / parts)
            state, _ = moved(state, np.zeros((SIZE, SIZE)), piece(length / parts, roll), 1 / 200, TipSettings())
    np.testing.assert_allclose(state[:3], frame.position_mm, atol=2e-3)
    np.testing.assert_allclose(tangent(state), frame.tangent, atol=1e-4)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.5, 5), st.floats(-3, 3), st.floats(-0.2, 0.2))
def test_one_long_piece_spreads_like_many_short_ones(length: float, roll: float, elevation: float) -> None:
    allowed = TipSettings(heading_sd_rad_sqrt_mm=0.01)
    state = np.array([0, 0, 0, 0.3, elevation, 1.1, 0.02, 0, 0, 0, 0.002], float)
    start = np.diag([0.1, 0.1, 0.1, 0.01, 0.01, 0.1, 0.03, 0.2, 0.2, 0.2, 0.002]) ** 2
    whole, spread = moved(state, start, piece(length, roll), 1 / 40, allowed)
    at, by_parts = state, start
    for _ in range(30):
        at, by_parts = moved(at, by_parts, piece(length / 30, roll), 1 / 40, allowed)
    np.testing.assert_allclose(whole[:FACTOR], at[:FACTOR], atol=2e-3)
    scale = np.sqrt(np.diag(by_parts))
    np.testing.assert_allclose(spread / np.outer(scale, scale), by_parts / np.outer(scale, scale), atol=0.04)


def test_spread_is_that_of_many_needles() -> None:
    allowed = TipSettings(
        heading_sd_rad_sqrt_mm=0.01, factor_sd_sqrt_mm=0.0, slip_sd_mm_sqrt_mm=0.0, change_sd_per_mm=0.0
    )
    random = np.random.default_rng(0)
    state = np.zeros(SIZE)
    state[FACTOR] = 1.0
    start = np.zeros((SIZE, SIZE))
    start[FACTOR, FACTOR] = 0.2**2
    _, spread = moved(state, start, piece(10.0, 0.4), 1 / 40, allowed)
    many = np.tile(state, (20_000, 1))
    many[:, FACTOR] += random.normal(0, 0.2, len(many))
    for _ in range(100):
        many = slow_path.along(many, piece(0.1, 0.4), 1 / 40, 50.0)
        many[:, HEADING : HEADING + 2] += random.normal(0, 0.01 * math.sqrt(0.1), (len(many), 2))
    for row in (1, 2, 3, 4):
        assert spread[row, row] == pytest.approx(many[:, row].var(), rel=0.06)
    assert spread[1, HEADING] == pytest.approx(np.cov(many[:, 1], many[:, HEADING])[0, 1], rel=0.06)


@pytest.mark.parametrize("columns", [SIZE, SIZE + 3, 58])
@pytest.mark.parametrize("fresh", [True, False])
def test_steps_and_corrections_are_those_of_numpy_and_filterpy(columns: int, fresh: bool) -> None:
    random = np.random.default_rng(columns)
    settings = TipSettings(factor_sd_sqrt_mm=0.02, change_sd_per_mm=0.01)
    for _ in range(10):
        root = random.normal(0, 0.1, (columns, columns))
        state, covariance = random.normal(0, 0.3, columns), root @ root.T
        state[FACTOR], state[CHANGE] = 1.1, 0.01
        step = ChannelPiece(random.uniform(0.1, 5.0), *random.uniform(-0.7, 0.7, 2), 0.2, fresh=fresh)
        fast, slow = (each.moved(state, covariance, step, 1 / 40, settings) for each in (_path, slow_path))
        for one, other in zip(fast, slow, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10)  # rounding by the steps of 1e-5
        model = np.zeros((2, columns))
        model[:, (0, 4, columns - 1)], innovation = random.normal(size=(2, 3)), random.normal(0, 0.1, 2)
        nis, corrected = _ppvi.path_corrected(
            state, covariance, (0, 4, columns - 1), model[:, (0, 4, columns - 1)].T.tolist(), innovation,
            variance=0.04, gate=math.inf,
        )  # fmt: skip
        expected = kalman_update(state, covariance, model @ state + innovation, 0.04 * np.eye(2), model)
        for one, other in zip(corrected, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
        spread = model @ covariance @ model.T + 0.04 * np.eye(2)
        assert nis == pytest.approx(innovation @ np.linalg.solve(spread, innovation))


def test_wrong_sizes_are_refused() -> None:
    state, step = np.zeros(SIZE + 1), piece(1.0, 0.0)
    with pytest.raises(ValueError, match="state: expected 11 or at least 14 columns"):
        moved(state, np.zeros((SIZE + 1, SIZE + 1)), step, 1 / 40, TipSettings())
    with pytest.raises(ValueError, match="columns: expected one column of the state"):
        _ppvi.path_corrected(
            np.zeros(SIZE), np.zeros((SIZE, SIZE)), (11,), ((1, 0),), (0, 0), variance=1.0, gate=math.inf
        )


def test_turning_the_base_makes_the_roll_uncertain() -> None:
    allowed = TipSettings(roll_sd_sqrt_rad=0.1)
    _, spread = moved(np.zeros(SIZE), np.zeros((SIZE, SIZE)), piece(1.0, math.pi, math.pi), 1 / 40, allowed)
    assert spread[ROLL, ROLL] == pytest.approx(0.01 * math.pi)


@settings(max_examples=100, deadline=None)
@given(LEGS, st.floats(-10, 100), st.floats(0, 100, allow_subnormal=False))  # 1e-310 * cos(2) / 1e-310 is not cos(2)
def test_pieces_are_the_whole_way(legs: list[tuple[float, float]], begin: float, length: float) -> None:
    channel = CutChannel(-5.0, 0.0)
    depth = 0.0
    for step, roll in legs:
        depth += step
        channel.move(depth, roll)
    found = list(channel.pieces(begin, begin + length))
    assert sum(each.length_mm for each in found) == pytest.approx(length, abs=1e-9)
    assert all(each.fresh == (number > 0 or begin >= 0) for number, each in enumerate(found))
    assert all(math.hypot(each.cos, each.sin) <= 1 + 1e-12 for each in found)
    turned = sum(each.turned_rad for each in channel.pieces(-10.0, 1000.0))
    rolls = [roll for _, roll in legs]
    assert turned == pytest.approx(sum(abs(b - a) for a, b in pairwise(rolls)), abs=0.01)


def test_a_bevel_that_spins_bends_nothing() -> None:
    channel = CutChannel(0.0, 0.0)
    for step in range(1, 2001):
        channel.move(step * 0.01, step * 0.01 * 30)
    pieces = list(channel.pieces(0.0, 20.0))
    assert len(pieces) < 60
    assert abs(sum(each.length_mm * each.cos for each in pieces)) < 0.1


def test_a_turned_needle_leaves_its_channel_and_another_follows_it() -> None:
    for roll, leaves in ((math.pi, True), (0.2, False), (2 * math.pi, False)):
        channel = CutChannel(0.0, 0.0)
        channel.move(20.0, 0.0)
        assert channel.move(10.0, 0.0) is None
        assert channel.move(10.5, roll) == (10.0 if leaves else None)
        assert channel.cut_mm == (10.5 if leaves else 20.0)
