"""Layers and tissues: the radius by place, through the public surface, against the slow oracle and by hand."""

import copy
import math
import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracle_arc import follow_pieces, problem_from, radius_at
from oracle_cases import case, mirrored
from oracle_mdp import build, solve
from oracle_rollout import rollout

import needleplan as npl
from needleplan.scenario import Layer, Method, Needle, Tissue, Transition
from tests.planning import test_against_oracle as uniform

METHODS = st.sampled_from(uniform.METHODS)


@st.composite
def shapes(draw: st.DrawFn, width: float, height: float) -> dict[str, Any]:
    """A polygon, with or without a hole, a disc or a capsule."""
    kind = draw(st.sampled_from(["polygon", "hole", "disc", "capsule"]))
    if kind in ("polygon", "hole"):
        outline = draw(uniform.polygons(width, height))
        whole = shapely.Polygon(outline)
        inside = whole.buffer(-0.3)
        if kind == "polygon" or inside.geom_type != "Polygon" or inside.is_empty:
            return {"polygon_mm": outline}
        return {"polygon_mm": outline, "holes_mm": [[list(point) for point in inside.exterior.coords]]}
    quarters = st.tuples(st.integers(0, int(4 * width)), st.integers(0, int(4 * height)))
    one, other = ([number / 4 for number in draw(quarters)] for _ in range(2))
    radius = draw(st.integers(1, 12)) / 4 + 0.000731
    if kind == "disc" or one == other:
        return {"center_mm": one, "radius_mm": radius}
    return {"ends_mm": [one, other], "radius_mm": radius}


@st.composite
def layered(draw: st.DrawFn, transition: str | None = None) -> dict[str, Any]:
    """A small scenario of the uniform tests with layers, which may begin on grid points, and overlapping tissues."""
    scenario = draw(uniform.scenarios(transition))
    width, height = (scenario["workspace"][key] for key in ("width_mm", "height_mm"))
    radius = st.integers(1200, 7000).map(lambda number: number / 1000 + 0.000377)
    starts = sorted(draw(st.lists(st.integers(0, int(4 * width)), max_size=3, unique=True)))
    layers = [{"from_mm": start / 4, "curvature_radius_mm": draw(radius)} for start in starts]
    fewest = 0 if layers else 1
    regions = draw(st.lists(shapes(width, height), min_size=fewest, max_size=2))
    tissues = [region | {"curvature_radius_mm": draw(radius)} for region in regions]
    return scenario | {"needle": scenario["needle"] | {"layer": layers}, "tissue": tissues}


@pytest.mark.slow
@given(scenario=layered(), method=METHODS, partitions=uniform.PARTITIONS)
@settings(uniform.random_cases, max_examples=8)
def test_tables_are_those_of_the_oracle(scenario: dict[str, Any], method: str, partitions: list[int]) -> None:
    mdp, solution = uniform.oracle_of(scenario)
    uniform.assert_agrees(uniform.planned(scenario, method=method, partitions=partitions), mdp, solution)


@given(scenario=layered(), method=METHODS, threads=st.sampled_from([2, 3]))
@settings(uniform.random_cases, max_examples=6)
def test_the_number_of_threads_changes_nothing(scenario: dict[str, Any], method: str, threads: int) -> None:
    one, other = (uniform.planned(scenario, method=method, threads=each) for each in (1, threads))
    uniform.assert_identical(one, other)


@pytest.mark.slow
@given(scenario=layered(), method=METHODS)
@settings(uniform.random_cases, max_examples=6)
def test_a_mirrored_scenario_has_the_mirrored_table(scenario: dict[str, Any], method: str) -> None:
    assume(uniform.clearance(build(uniform.problem_of(scenario))) > uniform.MARGIN_MM)
    one, other = uniform.planned(scenario, method=method), uniform.planned(mirrored(scenario), method=method)
    assume(np.isfinite(one.values).all())
    back = np.roll(other.values[:, ::-1, ::-1, ::-1], 1, axis=2)
    allowed = one.stats.error_bound + other.stats.error_bound + uniform.float32_allowance(one)
    assert np.max(np.abs(one.values - back)) <= allowed


@pytest.mark.slow
@given(scenario=layered(transition="interpolated"), seed=st.integers(0, 2**31))
@settings(uniform.random_cases, max_examples=6)
def test_executions_go_as_the_oracles(scenario: dict[str, Any], seed: int) -> None:
    """Success, cost and length of look-up executions through the tissues: the same table, independent randomness."""
    mdp, solution = uniform.oracle_of(scenario)
    table, runs = uniform.planned(scenario), 2_000
    i, j, k, b = np.unravel_index(np.argmax(np.where(solution.success < 1, solution.success, 0)), solution.gap.shape)
    start = (i * mdp.problem.dx, j * mdp.problem.dy, k * mdp.problem.alpha, 2 * int(b) - 1)
    ours = rollout(mdp, start, runs, seed, policy=table.policy)
    theirs = table.rollout(start, runs=runs, seed=seed, nearest=True)
    share = max(ours.success * (1 - ours.success), 1e-3)
    assert theirs.success == pytest.approx(ours.success, abs=5 * math.sqrt(2 * share / runs))
    means = ((ours.cost, theirs.mean_cost), (ours.length, theirs.mean_length_mm), (ours.turns, theirs.mean_turns))
    for mine, its in means:
        assert its == pytest.approx(mine.mean(), rel=1e-6, abs=5 * mine.std() * math.sqrt(2 / runs))


@pytest.mark.parametrize("transition", Transition)
def test_a_grid_line_on_the_edge_of_a_layer_is_in_it_whatever_rounding_says(transition: Transition) -> None:
    assert 3 * 0.7 < 2.1
    scenario = case(
        (7.0, 5.6),
        target=(5.63, 2.81, 0.71),
        rho=3.000377,
        headings=12,
        noise=(0.6, 0.2),
        samples=2,
        spacing=(0.7, 0.7),
        transition=transition.value,
        objective=(1.0, 4.0, 100.0, 80.0, 1.0),
        layers=((2.1, 1.5003),),
    )
    mdp = build(uniform.problem_of(scenario))
    assert uniform.clearance(mdp) > uniform.MARGIN_MM
    uniform.assert_agrees(uniform.planned(scenario), mdp, solve(mdp, 1e-9))


@given(scenario=layered())
@settings(uniform.random_cases, max_examples=6)
def test_the_scenario_knows_the_radius_of_every_place(scenario: dict[str, Any]) -> None:
    read = npl.Scenario.from_toml(uniform.toml_text(scenario))
    x, y = np.meshgrid(np.linspace(0, read.workspace.width_mm, 33), np.linspace(0, read.workspace.height_mm, 33))
    np.testing.assert_array_equal(read.radius_mm(x, y), radius_at(uniform.problem_of(scenario), x, y))


@given(scenario=uniform.scenarios(), method=METHODS)
@settings(uniform.random_cases, max_examples=6)
def test_layers_of_the_same_radius_change_nothing(scenario: dict[str, Any], method: str) -> None:
    layers = copy.deepcopy(scenario)
    rho = scenario["needle"]["curvature_radius_mm"]
    layers["needle"]["layer"] = [{"from_mm": 2.0, "curvature_radius_mm": rho}]
    layers["tissue"] = [{"polygon_mm": [[0, 0], [3, 0], [3, 3]], "curvature_radius_mm": rho}]
    uniform.assert_identical(uniform.planned(scenario, method=method), uniform.planned(layers, method=method))


def layers_of(small: npl.Scenario) -> npl.Scenario:
    inclusion = Tissue([(40, 18), (48, 18), (48, 30), (40, 30)], 70.0, "inclusion")
    return replace(small, needle=Needle(40.0, (Layer(30.0, 55.0),)), tissues=(inclusion,))


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize("transition", Transition)
def test_every_method_gives_the_same_values(small: npl.Scenario, method: Method, transition: Transition) -> None:
    scene = replace(
        layers_of(small),
        grid=replace(small.grid, spacing_mm=(2, 2), transition=transition),
        objective=replace(small.objective, discount=0.95),
    )
    values = [
        npl.plan(replace(scene, solver=replace(small.solver, method=each, tolerance=1e-3))).values
        for each in (method, Method.VALUE_ITERATION)
    ]
    assert values[0] == pytest.approx(values[1], abs=2e-3, rel=1e-5)


def test_steps_of_a_path_are_as_long_as_their_tissue_says(small: npl.Scenario) -> None:
    scenario = layers_of(small)
    table = npl.plan(scenario)
    path = table.path(table.best_entry().pose)
    steps = scenario.radius_mm(*path.poses[:-1, :2].T) * 2 * math.pi / scenario.motion.headings
    assert path.outcome.name == "TARGET"
    assert len({*np.round(steps, 9)}) > 1
    assert steps.sum() - steps[-1] < path.length_mm <= steps.sum() + 1e-9
    assert path.cost == pytest.approx(steps.sum() + 4 * len(path.turns))
    x, y, heading, _ = path.poses[:-1].T
    raw = tomllib.loads(scenario.to_toml())
    raw["motion"]["arc_samples"] = 4  # the number of pieces of a whole arc
    _, *reached = follow_pieces(problem_from(raw), x, y, heading, path.poses[1:, 3].astype(int), ahead=0.5)
    np.testing.assert_allclose(np.stack(reached, axis=1)[:-1], path.poses[1:-1, :3], rtol=1e-9, atol=1e-9)


def test_expected_length_is_what_executions_have(small: npl.Scenario) -> None:
    table = npl.plan(replace(layers_of(small), grid=replace(small.grid, transition=Transition.INTERPOLATED)))
    start = table.best_entry().pose
    i, j, k, b = round(start[0]), round(start[1]), round(start[2] / (2 * math.pi / 36)) % 36, (int(start[3]) + 1) // 2
    found = table.rollout(start, runs=20_000, seed=1)
    assert table.expectations().length_mm[i, j, k, b] == pytest.approx(found.mean_length_mm, rel=0.03)


@pytest.mark.study
def test_the_shipped_layered_scenario_has_a_good_entry_that_executions_realise() -> None:
    scenario = npl.Scenario.read("layered")
    assert (
        len({scenario.needle.curvature_radius_mm, *(layer.curvature_radius_mm for layer in scenario.needle.layers)})
        == 3
    )
    assert scenario.tissues[0].name == "tumour"
    table = npl.plan(scenario)
    best = table.best_entry()
    found = table.rollout(best.pose, runs=20_000, seed=0)
    assert best.success > 0.95
    assert found.success == pytest.approx(best.success, abs=0.03)
    # The decisions for one radius everywhere do not know where the needle bends more.
    blind = npl.plan(replace(scenario, needle=Needle(scenario.needle.curvature_radius_mm), tissues=()))
    unaware = npl.PolicyTable(blind.values, blind.policy, blind.success, blind.stats, scenario)
    assert found.mean_cost < unaware.rollout(best.pose, runs=20_000, seed=0, nearest=True).mean_cost
