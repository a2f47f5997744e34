"""Predictions at exact poses: against the slow oracle, on the grid, and at edges of what the table knows."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from oracle_arc import (
    FREE,
    GOAL,
    GOES_ON,
    OBSTACLE,
    TARGET,
    Floats,
    Problem,
    edge_distance,
    length_at,
    stations_of,
    tangent_corners,
)
from oracle_mdp import Mdp, build
from oracle_rollout import corner_values, follow_action, greedy_q
from oracle_success import LEAST_SUM, lagrange

import needleplan as npl
from tests.planning import test_against_oracle as plain


@pytest.mark.slow
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
    poses = list(zip(x, y, theta, bevel, strict=True))[:2]
    expected = [followed(mdp, cells, reached, pose, int(found.action[n])) for n, pose in enumerate(poses)]
    np.testing.assert_allclose(found.success[: len(poses)], expected, atol=1e-5)


POSES, DOUBT = 200, 0.003
RESOLVED_CELLS, UNRESOLVED_STEPS = 3.0, 8.0
ALIKE_RADII, ALIKE_NOISE, ALIKE_HEADING = 0.1, 0.3, 0.1


def followed(mdp: Mdp, cells: Floats, success: Floats, pose: tuple[float, ...], action: int) -> float:
    """The success of executions from a pose; the poses that the table leaves in doubt the most are followed."""
    problem, total = mdp.problem, 0.0
    pending: list[Pending] = [Pending(pose, 1.0, 0.0, 1.0)]
    for number in range(POSES):
        if not pending:
            break
        at = max(range(len(pending)), key=lambda k: pending[k].doubt)
        this = pending[at]
        if this.doubt <= DOUBT:
            break
        pending[at], pending[-1] = pending[-1], pending[at]
        pending.pop()
        arrays = [np.array([each]) for each in this.pose]
        chosen = action if number == 0 else int(np.argmin(greedy_q(problem, cells, *arrays)))
        (ending, x, y, turned), new, _ = follow_action(problem, np.array([chosen]), *arrays)
        if ending[0] != GOES_ON:
            total += this.weight * (ending[0] == TARGET)
            continue
        for m, p in sorted(problem.noise.items(), key=lambda item: (abs(item[0]), item[0])):
            if p == 0.0:
                continue
            after = float(x[0]), float(y[0]), float(turned[0] + m * problem.eta), int(new[0])
            value, spread = read(mdp, success, after)
            weight = this.weight * p
            following = Pending(after, weight, value, weight * (1.0 if is_unresolved(problem, after) else spread))
            alike = (k for k, other in enumerate(pending) if are_alike(problem, other.pose, after))
            if (k := next(alike, None)) is not None:
                pending[k] = pending[k].joined(following)
            elif following.doubt > DOUBT:
                pending.append(following)
            else:
                total += weight * value
    return total + sum(each.weight * each.success for each in pending)


class Pending(NamedTuple):
    """A pose that an execution may reach."""

    pose: tuple[float, ...]
    weight: float
    success: float
    doubt: float

    def joined(self, other: Pending) -> Pending:
        """Both as one pose between them."""
        weight = self.weight + other.weight
        x, y, theta, success = (
            (self.weight * mine + other.weight * yours) / weight
            for mine, yours in zip((*self.pose[:3], self.success), (*other.pose[:3], other.success), strict=True)
        )
        return Pending((x, y, theta, self.pose[3]), weight, success, self.doubt + other.doubt)


def is_unresolved(problem: Problem, pose: tuple[float, ...]) -> bool:
    """Whether the target is narrower than the cells across the motion, or nothing blurs the success."""
    x, y, theta, _ = pose
    along_x, along_y = abs(math.cos(theta)), abs(math.sin(theta))
    across = problem.dx * along_y if along_y > along_x else problem.dy * along_x
    near = problem.target_radius + UNRESOLVED_STEPS * float(length_at(problem, np.array([x]), np.array([y]))[0])
    narrow = 2 * problem.target_radius < RESOLVED_CELLS * across and math.dist((x, y), problem.target) < near
    return narrow or all(p == 0.0 for m, p in problem.noise.items() if m)


def are_alike(problem: Problem, one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Whether two poses are followed as one."""
    of_noise = ALIKE_NOISE * problem.eta * float(length_at(problem, np.array([one[0]]), np.array([one[1]]))[0])
    near = math.dist(one[:2], other[:2]) < min(of_noise, ALIKE_RADII * problem.target_radius)
    return near and abs(one[2] - other[2]) < ALIKE_HEADING * problem.eta and one[3] == other[3]


def read(mdp: Mdp, success: Floats, pose: tuple[float, float, float, int]) -> tuple[float, float]:
    """The success at a pose, and the range at the corners of its cell; of one order over headings and points."""
    problem, (x, y, theta, bevel) = mdp.problem, pose
    low = math.floor(theta / problem.alpha)
    share = theta / problem.alpha - low
    k, side = np.array([low, low + 1]) % problem.headings, np.full(2, (bevel + 1) // 2)
    place = np.full(2, x), np.full(2, y)
    corner, weight = tangent_corners(problem, *place, np.full(2, theta))
    flat = np.concatenate([success.reshape(-1, problem.headings, 2), np.zeros((1, problem.headings, 2))])
    corners = flat[corner, k[:, None], side[:, None]]
    used = np.array([1 - share, share])[:, None] * weight > 1e-9
    spread = float(corners[used].max() - corners[used].min())
    if problem.interpolated:
        free = (mdp.kind != OBSTACLE).astype(float)
        headings = np.arange(low - 1, low + 3) % problem.headings
        if (cubic := at_stations(problem, free, success[:, :, headings, side[0]] @ nodes_at(share), pose)) is not None:
            return float(np.clip(cubic, 0, 1)), spread
        is_free = np.append(free, 0.0)[corner]
        total = (weight * is_free).sum(axis=1)
        weight = weight * is_free / np.where(total > LEAST_SUM, total, 1.0)[:, None]
    values = (weight * corners).sum(axis=1)
    return float((1 - share) * values[0] + share * values[1]), spread


def at_stations(problem: Problem, free: Floats, table: Floats, pose: tuple[float, float, float, int]) -> float | None:
    """A table [x, y] by cubic polynomials along four lines that the tangent crosses, and from line to line."""
    steep, along, across, slope = stations_of(problem, pose[:2], pose[2])
    if steep:
        free, table = free.T, table.T
    first, values = math.floor(along) - 1, []
    for line in range(first, first + 4):
        place = float(across + (line - along) * slope)
        point = math.floor(place) - 1
        if min(line, point) < 0 or free[line : line + 1, point : point + 4].sum() != 4:
            return None
        values.append(table[line, point : point + 4] @ nodes_at(place - point - 1))
    return float(np.array(values) @ nodes_at(along - first - 1))


def nodes_at(f: float) -> Floats:
    """The weights of four points for a place at f behind the second."""
    return np.array(lagrange(np.array(f)))


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
    for name in ("values", "policy"):
        np.testing.assert_array_equal(getattr(coarse, name), getattr(fine, name)[::2, ::2])
    assert coarse.stats.states == fine.stats.states


def test_without_noise_the_prediction_is_what_happens(small: npl.Scenario) -> None:
    grid = replace(small.grid, transition="interpolated", success_refinement=1)
    table = npl.plan(replace(small, grid=grid, motion=replace(small.motion, tip_noise=(1.0,))))
    random = np.random.default_rng(3)
    starts = [npl.Pose(0.0, y, heading, 1) for y, heading in random.uniform((2, -0.7), (38, 0.7), (40, 2))]
    predicted = np.array([table.lookup(start).success for start in starts])
    realised = np.array([float(table.path(start).outcome is npl.Outcome.TARGET) for start in starts])
    assert 0.2 < realised.mean() < 1
    assert np.abs(predicted - realised).max() < 0.02
