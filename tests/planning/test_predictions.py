"""Predictions at exact poses: against the slow oracle, on the grid, and at edges of what the table knows."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from oracle_arc import (
    FREE,
    GOAL,
    GOES_ON,
    TARGET,
    Floats,
    Ints,
    Problem,
    bilinear_corners,
    edge_distance,
)
from oracle_mdp import build
from oracle_rollout import at_heading, corner_values, follow_action, greedy_q

import needleplan as npl
from needleplan.errors import ScenarioError
from tests.planning import test_against_oracle as plain


@given(scenario=plain.scenarios())
@settings(plain.random_cases)
def test_it_is_the_look_ahead_of_the_oracle(scenario: dict[str, Any]) -> None:
    assert_look_ahead(scenario)


def assert_look_ahead(scenario: dict[str, Any]) -> None:
    table = plain.planned(scenario)
    mdp = build(plain.problem_of(scenario))
    problem = mdp.problem
    random = np.random.default_rng(7)
    width, height = table.scenario.workspace.width_mm, table.scenario.workspace.height_mm
    n = 200
    x, y = random.uniform(0, width, n), random.uniform(0, height, n)
    theta, bevel = random.uniform(-3, 3, n), random.choice([-1, 1], n)
    far = edge_distance(problem, x, y) > plain.MARGIN_MM
    x, y, theta, bevel = x[far], y[far], theta[far], bevel[far]
    target = shapely.Point(scenario["target"]["center_mm"]).buffer(scenario["target"]["radius_mm"], 64)
    taken = shapely.union_all([target, *(shapely.Polygon(each["polygon_mm"]) for each in scenario["obstacle"])])
    free = ~shapely.contains_xy(taken.buffer(0.01), x, y)
    x, y, theta, bevel = x[free], y[free], theta[free], bevel[free]
    assume(len(x) > 0 and np.all(np.isfinite(table.values)))
    cells = corner_values(mdp, table.values.astype(np.float64))
    q = greedy_q(problem, cells, x, y, theta, bevel)
    found = table.lookup_many(np.stack([x, y, theta, bevel], axis=1))
    np.testing.assert_allclose(found.value, q.min(axis=1), rtol=1e-5)
    least, second = np.sort(q, axis=1)[:, :2].T
    clear = second - least > 1e-6 * (1 + np.abs(q).max())
    np.testing.assert_array_equal(found.action[clear], np.argmin(q[clear], axis=1))
    reached = np.where(mdp.kind == FREE, 1.0, 0.0)[:, :, None, None] * table.success
    reached = np.where((mdp.kind == GOAL)[:, :, None, None], 1.0, reached)
    rows = reached.reshape(problem.nx * problem.ny, problem.headings, 2)
    rows = np.concatenate([rows, np.zeros((1, problem.headings, 2))])
    expected = followed(problem, (cells, rows), (x, y, theta, bevel), np.asarray(found.action).astype(int))
    np.testing.assert_allclose(found.success, expected, atol=1e-5)


STEPS, DOUBT = 8, 0.005


def followed(problem: Problem, tables: tuple[Floats, Floats], poses: tuple[Floats, ...], actions: Ints) -> Floats:
    """The success of executions, all at once; poses that an interpolation leaves in doubt are followed."""
    cells, rows = tables
    x, y, theta, bevel = poses
    root, likely, total = np.arange(len(x)), np.ones(len(x)), np.zeros(len(x))
    for step in range(STEPS):
        (ending, x_end, y_end, turned), new, _ = follow_action(problem, actions, x, y, theta, bevel)
        np.add.at(total, root, likely * (ending == TARGET))
        on = ending == GOES_ON
        branches = [
            np.broadcast_arrays(root[on], likely[on] * p, x_end[on], y_end[on], turned[on] + m * problem.eta, new[on])
            for m, p in problem.noise.items()
        ]
        root, likely, x, y, theta, bevel = (np.concatenate(parts) for parts in zip(*branches, strict=True))
        corner, weight = bilinear_corners(problem, x, y)
        success = at_heading(problem, rows, corner, weight, theta, bevel)
        low = np.floor(theta / problem.alpha).astype(int)
        side = (bevel[:, None] + 1) // 2
        read = np.stack([rows[corner, (low + k)[:, None] % problem.headings, side] for k in (0, 1)])
        share = np.stack([1 - (theta / problem.alpha - low), theta / problem.alpha - low])[:, :, None] * weight
        spread = np.where(share > 1e-9, read, 0).max(axis=(0, 2)) - np.where(share > 1e-9, read, 1).min(axis=(0, 2))
        doubtful = (likely * spread > DOUBT) & (step < STEPS - 1)
        np.add.at(total, root[~doubtful], (likely * success)[~doubtful])
        root, likely, x, y, theta, bevel = (each[doubtful] for each in (root, likely, x, y, theta, bevel))
        if not len(root):
            break
        actions = np.argmin(greedy_q(problem, cells, x, y, theta, bevel), axis=1)
    return total


def test_on_the_grid_of_an_interpolated_table_values_are_those_of_the_table(small: npl.Scenario) -> None:
    grid = replace(small.grid, transition="interpolated")
    table = npl.plan(replace(small, grid=grid, solver=replace(small.solver, tolerance=1e-6)))
    poses = np.array(
        [(x, y, h, b) for x in (5, 12) for y in (8, 20) for h in table.scenario.headings_rad[:5] for b in (-1, 1)]
    )
    exact, nearest = table.lookup_many(poses), table.lookup_many(poses, nearest=True)
    np.testing.assert_allclose(exact.value, nearest.value, rtol=1e-5)
    # The success of executions, which look ahead from the exact pose, and not of the actions at grid points.
    assert np.abs(exact.success - nearest.success).mean() < 0.05


def test_inside_an_obstacle_and_inside_the_target_nothing_is_left_to_do(table: npl.PolicyTable) -> None:
    inside = table.lookup(25.0, 5.0, 0.0, 1)
    assert (inside.success, inside.value) == (0, table.scenario.objective.collision)
    there = table.lookup(50.0, 25.0, 0.0, 1)
    assert (there.success, there.value) == (1, 0)


def test_between_headings_the_prediction_holds(small: npl.Scenario) -> None:
    scenario = replace(small, grid=replace(small.grid, transition="interpolated", refinement=3))
    table = npl.plan(scenario)
    step = 2 * math.pi / scenario.motion.headings
    for y in (12.0, 20.3, 27.7):
        found = table.rollout((0, y, 0.5 * step), runs=4000)
        low, high = found.interval
        assert low - 0.03 < found.predicted_success < high + 0.03


def test_a_refined_table_is_every_point_of_the_finer_one(small: npl.Scenario) -> None:
    coarse = npl.plan(replace(small, grid=replace(small.grid, spacing_mm=(2.0, 2.0), refinement=2)))
    fine = npl.plan(small)
    for name in ("values", "policy", "success"):
        np.testing.assert_array_equal(getattr(coarse, name), getattr(fine, name)[::2, ::2])
    assert coarse.stats.states == fine.stats.states
    with pytest.raises(ScenarioError, match="success_refinement = 3: must be 1 beside a refinement"):
        replace(small.grid, refinement=2, success_refinement=3)
