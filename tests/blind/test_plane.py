"""The judge of plans in the plane against points sampled densely, and against arithmetic by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.blind.plane import (
    COLLISION,
    EXIT,
    INSERT,
    ON,
    ROTATE,
    STRAIGHT,
    TARGET,
    Array,
    Scene,
    execute,
    forward,
    march,
    met,
    polygon_mm,
    shape_mm,
    step,
)

FILE: dict[str, Any] = {
    "workspace": {"width_mm": 60.0, "height_mm": 40.0},
    "target": {"center_mm": [50.0, 25.0], "radius_mm": 2.0},
    "needle": {"curvature_radius_mm": 40.0, "layer": [{"from_mm": 30.0, "curvature_radius_mm": 20.0}]},
    "obstacle": [
        {
            "polygon_mm": [[20, 10], [30, 10], [30, 20], [20, 20]],
            "holes_mm": [[[23, 13], [27, 13], [27, 17], [23, 17]]],
        },
        {"ends_mm": [[10, 30], [20, 34]], "radius_mm": 1.5, "margin_mm": 0.5},
        {"center_mm": [40, 8], "radius_mm": 3.0},
    ],
    "motion": {"headings": 60, "step_mm": 4.0, "tip_noise": [0.5, 0.25], "straight_curvature_share": 0.1},
}
SCENE = Scene(FILE)


def test_distances_of_a_notched_polygon() -> None:
    notched = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]])
    points = np.array([[2.0, 0.5], [2.0, 2.0], [-1.0, -1.0], [5.0, 2.0], [0.5, 0.25]])
    expected = [-0.5, 1.0 / math.hypot(1.0, 1.5), math.sqrt(2.0), 1.0, -0.25]
    np.testing.assert_allclose(polygon_mm(points, notched), expected)
    np.testing.assert_allclose(polygon_mm(points, notched[::-1]), expected)


def test_a_hole_is_free_and_a_margin_is_not() -> None:
    ring, capsule, disc = FILE["obstacle"]
    points = np.array([[25.0, 15.0], [21.0, 15.0], [31.0, 15.0]])
    assert (shape_mm(points, ring) > 0.0).tolist() == [True, False, True]
    np.testing.assert_allclose(shape_mm(np.array([[8.0, 30.0]]), capsule, 0.5), 0.0)
    np.testing.assert_allclose(shape_mm(np.array([[44.0, 8.0]]), disc), 1.0)


def test_marched_arcs_meet_what_their_points_meet() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, [60.0, 40.0], (80, 2))
    points = points[met(SCENE.distances_mm(points)) == ON]
    heading, curvature = rng.uniform(0.0, 2 * math.pi, len(points)), rng.choice([-0.05, 0.0, 0.05], len(points))
    length = np.full(len(points), 20.0)
    events = march(SCENE, points, heading, curvature, length)
    first = np.full(len(points), ON)
    for share in np.linspace(0.0, 1.0, 2001):
        on = first == ON
        first[on] = met(SCENE.distances_mm(forward(points, heading, curvature, share * length)[on]))
    assert set(events) == {ON, TARGET, COLLISION, EXIT}
    assert (events == first).mean() > 0.98  # an arc may graze a corner between two points


def test_pieces_of_a_step_bend_as_the_tissue_near_their_middle() -> None:
    # Of four pieces of 1 mm from x = 28, the first two bend with 40 mm and the last two with 20 mm.
    _, after = step(SCENE, np.array([[28.0, 30.0, 0.0, -1.0]]), np.array([ROTATE]))
    assert after[0, 2] == pytest.approx(2.0 / 40.0 + 2.0 / 20.0)
    assert after[0, 3] == 1.0
    _, after = step(SCENE, np.array([[4.0, 20.0, 0.0, -1.0]] * 2), np.array([INSERT, STRAIGHT]))
    np.testing.assert_allclose(after[:, 2], [-0.1, -0.01])
    np.testing.assert_allclose(after[0, :2], [4.0 + 40.0 * math.sin(0.1), 20.0 - 40.0 * (1.0 - math.cos(0.1))])


def test_noise_turns_the_tip_between_steps() -> None:
    file = FILE | {"obstacle": [], "target": {"center_mm": [50.0, 20.0], "radius_mm": 9.0}}
    seen: list[Array] = []

    def act(poses: Array) -> np.ndarray:
        seen.append(poses.copy())
        return np.full(len(poses), STRAIGHT)

    poses = np.tile([1.0, 20.0, 0.0, 1.0], (4000, 1))
    outcome = execute(Scene(file), act, poses, np.random.default_rng(0))
    turned = (seen[1][:, 2] - seen[0][:, 2] - 0.01 + math.pi) % (2 * math.pi) - math.pi
    steps = turned / (2 * math.pi / 60)
    assert (steps.mean(), steps.var()) == pytest.approx((0.0, 0.5), abs=0.05)
    assert set(np.round(steps, 6)) == {-1.0, 0.0, 1.0}
    assert 0.5 < (outcome == TARGET).mean() < 1.0
    assert set(outcome) == {TARGET, EXIT}


def test_an_arc_of_samples_sees_only_them() -> None:
    thin = {"polygon_mm": [[12.0, 0.0], [12.4, 0.0], [12.4, 40.0], [12.0, 40.0]]}
    file = FILE | {"obstacle": [thin], "motion": {"step_mm": 4.0, "arc_samples": 1}}
    poses, straight = np.array([[10.0, 20.0, 0.0, 1.0]]), np.array([INSERT])
    assert step(Scene(file), poses, straight)[0] == ON
    assert step(Scene(FILE | {"obstacle": [thin]}), poses, straight)[0] == COLLISION
