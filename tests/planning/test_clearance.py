"""The price of insertion close to obstacles: against the slow oracle, against executions, and what it does to paths."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_rollout import rollout

import needleplan as npl
from needleplan.errors import ScenarioError
from needleplan.scenario import Grid, Layer, Method, Needle, Objective, Obstacle, Scenario, Target, TipMotion, Workspace
from tests.planning import test_against_oracle as uniform
from tests.planning.test_tissues import METHODS, layered


@st.composite
def priced(draw: st.DrawFn, transition: str | None = None) -> dict[str, Any]:
    """A small scenario, in every second case with layers and tissues, with at least one obstacle and a price."""
    scenario = draw(st.one_of(uniform.scenarios(transition), layered(transition)).filter(lambda each: each["obstacle"]))
    # No grid point is so far from an obstacle that rounding decides.
    price = {"clearance_mm": draw(st.integers(1, 25)) / 10 + 0.000531, "clearance_per_mm": draw(st.integers(1, 80)) / 8}
    return scenario | {"objective": scenario["objective"] | price}


@given(scenario=priced(), method=METHODS, partitions=uniform.PARTITIONS)
@settings(uniform.random_cases, max_examples=8)
@pytest.mark.study
def test_tables_are_those_of_the_oracle(scenario: dict[str, Any], method: str, partitions: list[int]) -> None:
    mdp, solution = uniform.oracle_of(scenario)
    uniform.assert_agrees(uniform.planned(scenario, method=method, partitions=partitions), mdp, solution)


@pytest.mark.slow
@given(scenario=priced(transition="interpolated"), seed=st.integers(0, 2**31))
@settings(uniform.random_cases, max_examples=4)
def test_executions_cost_what_the_oracles_cost(scenario: dict[str, Any], seed: int) -> None:
    mdp, solution = uniform.oracle_of(scenario)
    table, runs = uniform.planned(scenario), 2_000
    i, j, k, b = np.unravel_index(np.argmax(np.where(solution.success < 1, solution.success, 0)), solution.gap.shape)
    start = (i * mdp.problem.dx, j * mdp.problem.dy, k * mdp.problem.alpha, 2 * int(b) - 1)
    ours = rollout(mdp, start, runs, seed, policy=table.policy)
    theirs = table.rollout(start, runs=runs, seed=seed, nearest=True)
    deviation = 5 * ours.cost.std() * math.sqrt(2 / runs)
    assert theirs.mean_cost == pytest.approx(ours.cost.mean(), rel=1e-6, abs=deviation)


def passage(**price: float) -> Scenario:
    """A direct way past an obstacle, and free space on its other side."""
    return Scenario(
        Workspace(80, 60), Target((70, 30), 2), Needle(40), [Obstacle(center_mm=(40, 22), radius_mm=6)],
        TipMotion(90, (0.6, 0.2)), Grid((1.0, 1.0), "interpolated"), Objective(**price),
    )  # fmt: skip


START = (0.0, 30.0, 0.0, 1)


@pytest.mark.slow
def test_a_price_moves_paths_away_from_obstacles() -> None:
    """Length of noisy executions within 6 mm of the obstacle, measured by shapely."""
    obstacle = shapely.Point(40, 22).buffer(6, quad_segs=256)
    near = {}
    for price in (0.0, 3.0):
        table = npl.plan(passage(clearance_mm=6, clearance_per_mm=price))
        lengths = []
        for seed in range(40):
            points = table.path(START, noise_seed=seed).poses[:, :2]
            steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
            lengths.append(steps[shapely.distance(obstacle, shapely.points(points[:-1])) <= 6].sum())
        near[price] = np.mean(lengths)
    assert near[0.0] > 5
    assert near[3.0] < 0.3 * near[0.0]


@pytest.mark.parametrize("layers", [(), (Layer(30, 55.0),)])
def test_the_cost_of_a_path_is_the_price_of_its_places(layers: tuple[Layer, ...]) -> None:
    scenario = replace(passage(clearance_mm=8, clearance_per_mm=0.5), needle=Needle(40, layers))
    path = npl.plan(scenario).path(START)
    from_mm = path.poses[:-1, :2]
    steps = scenario.radius_mm(*from_mm.T) * 2 * math.pi / 90
    near = np.hypot(*(from_mm - (40, 22)).T) <= 14
    assert near.any()
    assert path.outcome.name == "TARGET"
    assert path.cost == pytest.approx(np.sum(steps * (1 + 0.5 * near)) + 4 * len(path.turns))


@pytest.mark.study
@pytest.mark.parametrize("step_mm", [None, 3.3])
def test_predicted_costs_are_those_of_executions(step_mm: float | None) -> None:
    """Failures are cheap here: their small probabilities would be most of the cost otherwise."""
    base = passage(collision=300, exit=300)
    base = replace(base, motion=replace(base.motion, step_mm=step_mm), grid=Grid((0.5, 0.5), "interpolated"))
    price = Objective(collision=300, exit=300, clearance_mm=8, clearance_per_mm=2)
    table = npl.plan(replace(base, objective=price))
    for start in ((0.0, 30.0, 0.0, 1), (0.0, 25.3, 0.11, -1), (21.4, 27.7, 0.2, 1)):
        found = table.rollout(start, runs=20_000, seed=3)
        assert table.lookup(*start).value == pytest.approx(found.mean_cost, rel=0.03)
    # The price is more than this tolerance.
    assert found.mean_cost > 1.2 * npl.plan(base).rollout(start, runs=20_000, seed=3).mean_cost


@pytest.mark.slow
@pytest.mark.parametrize("method", Method)
def test_no_price_changes_nothing(method: Method) -> None:
    coarse = Grid((4.0, 3.0), "interpolated")
    plain = replace(passage(), grid=coarse, solver=replace(passage().solver, method=method))
    free = replace(plain, objective=Objective(clearance_mm=9, clearance_per_mm=0))
    assert "clearance" not in plain.to_toml()
    uniform.assert_identical(npl.plan(plain), npl.plan(free))


@pytest.mark.parametrize(
    ("price", "message"),
    [
        ({"clearance_mm": 2.0}, r"objective\.clearance_per_mm: is missing beside clearance_mm"),
        ({"clearance_per_mm": 2.0}, r"objective\.clearance_mm: is missing beside clearance_per_mm"),
        ({"clearance_mm": 0.0, "clearance_per_mm": 1.0}, r"clearance_mm = 0.0: must be"),
        ({"clearance_mm": 1.0, "clearance_per_mm": -1.0}, r"clearance_per_mm = -1.0: must be"),
        ({"clearance_mm": 1.0, "clearance_per_mm": math.nan}, r"clearance_per_mm = nan: must be"),
    ],
)
def test_mistakes_are_named(price: dict[str, float], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        passage(**price)


def test_with_a_price_there_are_half_as_many_radii() -> None:
    layers = tuple(Layer(number / 2, 40 + number) for number in range(1, 100))
    scenario = replace(passage(clearance_mm=6, clearance_per_mm=1), needle=Needle(40, layers))
    assert npl.plan(scenario).stats.status == "converged"
    with pytest.raises(
        ScenarioError, match=r"at most 100 different values in .* with objective.clearance_per_mm, not 101"
    ):
        replace(scenario, needle=Needle(39, (Layer(0, 40), *layers)))
