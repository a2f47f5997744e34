"""The planner, through its public surface, against the slow independent oracle of tests/reference.

The common ground is the text of the scenario file: the planner reads it, and the oracle reads what tomllib returns.
Scenarios in which a rounding error decides an event or the nearest grid point are left out: there the definition
is silent. `NEEDLEPLAN_EXAMPLES` sets the number of random scenarios (default 12 a test).
"""

import math
import os
import tempfile
import tomllib
from functools import cache
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, Phase, assume, given, reject, settings
from hypothesis import strategies as st
from oracle_arc import FREE, Problem, arc_point, edge_distance, problem_from
from oracle_cases import NPZ_NAME, VARIANTS, case, four_obstacles, mirrored, npz_path, toml_text
from oracle_mdp import Mdp, NotConverged, Solution, build, solve, success_of
from oracle_rollout import rollout

npl = pytest.importorskip("needleplan")

METHODS = ("sweep", "ppvi", "vi")
MARGIN_MM = 1e-6
SWEEPS = 1000  # of the oracle: a random scenario whose policy hardly ends would take it many minutes
HARDLY_ENDS = 0.02  # success may differ by this where the planner says that it proves nothing
random_cases = settings(
    max_examples=int(os.environ.get("NEEDLEPLAN_EXAMPLES", "12")),
    deadline=None,
    suppress_health_check=list(HealthCheck),
    derandomize="NEEDLEPLAN_EXAMPLES" not in os.environ,
    phases=set(Phase) - {Phase.shrink, Phase.explain},  # a smaller example takes the oracle many minutes to find
)


def planned(scenario: dict[str, Any], **solver: Any) -> Any:
    """Plan from a scenario file."""
    solver = {
        "method": "ppvi",
        "partitions": [3, 2],
        "priority": "H2",
        "tolerance": 1e-3,
        "success_bound": True,
    } | solver
    scenario = scenario | {"grid": {"success_refinement": 1, "heading_refinement": 1} | scenario["grid"]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.toml"
        path.write_text(toml_text(scenario, **solver))
        return npl.plan(npl.Scenario.read(path))


def problem_of(scenario: dict[str, Any]) -> Problem:
    return problem_from(tomllib.loads(toml_text(scenario)))


def clearance(mdp: Mdp) -> float:
    """Smallest distance by which a collision, the target or a nearest grid point is decided.

    The edges of the workspace are not looked at: arcs that return to one exactly are common, and count as inside.
    """
    problem = mdp.problem
    axes = [np.arange(n) * d for n, d in ((problem.nx, problem.dx), (problem.ny, problem.dy))]
    starts = np.meshgrid(*axes, np.arange(problem.headings) * problem.alpha, np.array((-1, 1)), indexing="ij")
    edges = [
        edge_distance(problem, *arc_point(problem, *starts, sample / problem.samples)).min()
        for sample in range(1, problem.samples + 1)
    ]
    if mdp.straight is not None:
        edges.append(clearance(mdp.straight))
    return float(min(edges if problem.interpolated else [mdp.tie_mm, *edges]))


@st.composite
def polygons(draw: st.DrawFn, width: float, height: float) -> list[list[float]]:
    """A simple polygon, star-shaped about its centre; its edges meet grid points and so do its corners."""
    x, y = draw(st.floats(0, width)), draw(st.floats(0, height))
    angles = sorted(draw(st.lists(st.integers(0, 71), min_size=3, max_size=7, unique=True)))
    radii = draw(st.lists(st.floats(0.4, 0.35 * width), min_size=len(angles), max_size=len(angles)))
    corners = [
        [
            round(min(max(x + r * math.cos(a * math.pi / 36), 0.0), width - 0.25) * 4) / 4,
            round(min(max(y + r * math.sin(a * math.pi / 36), 0.0), height - 0.25) * 4) / 4,
        ]
        for a, r in zip(angles, radii, strict=True)
    ]
    polygon = shapely.Polygon(corners)
    assume(len({tuple(corner) for corner in corners}) == len(corners) and polygon.is_valid and polygon.area > 0.1)
    return corners


@st.composite
def scenarios(draw: st.DrawFn, transition: str | None = None) -> dict[str, Any]:
    spacing = (draw(st.sampled_from([1.0, 0.5])), draw(st.sampled_from([1.0, 0.5])))
    width, height = float(draw(st.integers(4, 10))), float(draw(st.integers(4, 8)))
    p1, p2 = draw(st.integers(0, 60)) / 250, draw(st.integers(0, 30)) / 250
    noise = draw(st.sampled_from([(1.0,), (1 - 2 * p1, p1), (1 - 2 * p1 - 2 * p2, p1, p2)]))
    discount = draw(st.sampled_from([1.0, 0.95, 0.8]))
    collision, leave = (float(draw(st.integers(20, 300))) for _ in range(2))
    at = draw(st.integers(1, int(width) - 1)), draw(st.integers(1, int(height) - 1))
    scenario = case(
        (width, height),
        target=(at[0] + draw(st.integers(-30, 30)) / 100, at[1] + draw(st.integers(-30, 30)) / 100, 0.503),
        rho=draw(st.integers(1200, 7000)) / 1000 + 0.000377,
        headings=draw(st.integers(5, 20)),
        obstacles=tuple(draw(st.lists(polygons(width, height), max_size=3))),
        noise=noise,
        samples=draw(st.integers(1, 4)),
        spacing=spacing,
        transition=transition or draw(st.sampled_from(["nearest", "interpolated"])),
        objective=(1.0, float(draw(st.integers(0, 40))), collision, leave, discount),
    )
    target = shapely.Point(scenario["target"]["center_mm"]).buffer(0.6)
    assume(not any(target.intersects(shapely.Polygon(o["polygon_mm"])) for o in scenario["obstacle"]))
    return scenario


def oracle_of(scenario: dict[str, Any]) -> tuple[Mdp, Solution]:
    mdp = build(problem_of(scenario))
    assume(clearance(mdp) > MARGIN_MM)
    try:
        solution = solve(mdp, 1e-9, SWEEPS)
    except NotConverged:
        reject()
    assume(np.all(np.isfinite(solution.values)))
    return mdp, solution


def float32_allowance(solution: Any) -> float:
    return 4e-6 * float(solution.values.max()) + 1e-5


def assert_agrees(table: Any, mdp: Mdp, solution: Solution) -> None:
    bound = float(table.stats.error_bound)
    assert 0.0 <= bound < 0.1, table.stats
    free = (mdp.kind == FREE)[:, :, None, None]
    allowed = bound + float32_allowance(solution)
    wrong = np.argwhere(np.abs(table.values - solution.values) > allowed)
    where = [(tuple(map(int, s)), float(table.values[tuple(s)]), float(solution.values[tuple(s)])) for s in wrong[:5]]
    assert not where, f"{len(wrong)} values beyond {allowed:.3g}: (state, planner, oracle) {where}"
    policy = np.where(free, table.policy, 0).astype(np.uint8)
    chosen = np.take_along_axis(solution.q, policy[..., None].astype(int), axis=-1)[..., 0]
    wrong = np.argwhere(free & (chosen > solution.values + 2 * allowed))  # also each whose gap is larger
    assert len(wrong) == 0, f"policy at {wrong[:5].tolist()}"
    proven = float(table.stats.success_error_bound)
    try:
        difference = np.abs(table.success - success_of(mdp, policy, max_sweeps=SWEEPS)).max()
    except NotConverged:
        reject()
    assert difference <= proven + 1e-6
    # A policy that hardly ends from some state has the bound 1 there: then the sweeps may end early.
    assert difference <= (1e-4 if proven < 1.0 else HARDLY_ENDS)


@pytest.mark.parametrize("method", METHODS)
def test_states_that_cannot_end_cost_infinitely_much(method: str) -> None:
    """Steps shorter than half a cell never leave it; the other states have their values all the same."""
    scenario = case(
        (4.0, 4.0), target=(2.1, 2.05, 0.25), rho=0.5003, headings=12, objective=(1.0, 4.0, 50.0, 50.0, 1.0)
    )
    mdp = build(problem_of(scenario))
    assert clearance(mdp) > MARGIN_MM
    solution = solve(mdp)
    finite = np.isfinite(solution.values)
    assert 0 < np.count_nonzero(finite) < finite.size
    table = planned(scenario, method=method)
    assert np.array_equal(np.isfinite(table.values), finite)
    np.testing.assert_allclose(table.values[finite], solution.values[finite], rtol=1e-5)


def test_a_grid_point_on_any_corner_of_a_polygon_is_an_obstacle() -> None:
    """Also at the tip of a sharp corner; "inside or on a polygon" has no exceptions."""
    for corner, other, another in permutations([(2, 2), (4, 3), (3, 5)]):
        scenario = case(
            (8.0, 8.0),
            target=(7.0, 7.0, 0.5),
            rho=3.000377,
            headings=8,
            obstacles=([list(corner), list(other), list(another)],),
        )
        table = planned(scenario)
        absorbing = {(int(i), int(j)) for i, j in np.argwhere(np.all(table.values == 0.0, axis=(2, 3)))}
        assert absorbing == {(2, 2), (4, 3), (3, 5), (3, 3), (3, 4), (7, 7)}


@pytest.mark.parametrize(("headings", "rho"), [(12, 5.0), (6, 3.0), (4, 1.5)])
def test_exact_ties_between_two_grid_points_do_not_break_the_mirror(headings: int, rho: float) -> None:
    """The definition names no winner; whatever the rule is, rounding errors must not be the judge."""
    scenario = case(
        (12.0, 10.0),
        target=(9.0, 5.0, 0.6),
        rho=rho,
        headings=headings,
        noise=(0.5, 0.25),
        objective=(1.0, 4.0, 100.0, 80.0, 1.0),
    )
    values = planned(scenario).values  # the scenario is its own mirror image
    np.testing.assert_allclose(values, np.roll(values[:, ::-1, ::-1, ::-1], 1, axis=2), atol=5e-3)


def assert_identical(one: Any, other: Any) -> None:
    for name in ("values", "policy", "success"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


PRIORITIES = st.sampled_from(["H1", "H2", "bound"])
PARTITIONS = st.sampled_from([[1, 1], [2, 2], [3, 2], [4, 1], [1, 4], [4, 4]])


@pytest.mark.slow
@given(scenario=scenarios(), method=st.sampled_from(METHODS), partitions=PARTITIONS, priority=PRIORITIES)
@random_cases
def test_random_scenarios(scenario: dict[str, Any], method: str, partitions: list[int], priority: str) -> None:
    mdp, solution = oracle_of(scenario)
    table = planned(scenario, method=method, partitions=partitions, priority=priority)
    assert table.values.dtype == np.float32
    assert table.policy.dtype == np.uint8
    assert table.success.dtype == np.float32
    assert_agrees(table, mdp, solution)


@pytest.mark.slow
@given(scenario=scenarios(), method=st.sampled_from(METHODS), data=st.data())
@random_cases
def test_the_order_of_obstacles_changes_nothing(scenario: dict[str, Any], method: str, data: st.DataObject) -> None:
    assume(len(scenario["obstacle"]) > 1)
    shuffled = scenario | {"obstacle": data.draw(st.permutations(scenario["obstacle"]))}
    assert_identical(planned(scenario, method=method), planned(shuffled, method=method))


@given(scenario=scenarios(), method=st.sampled_from(METHODS), priority=PRIORITIES, threads=st.sampled_from([2, 3, 7]))
@random_cases
def test_the_number_of_threads_changes_nothing(
    scenario: dict[str, Any], method: str, priority: str, threads: int
) -> None:
    one, many = (planned(scenario, method=method, priority=priority, threads=number) for number in (1, threads))
    assert_identical(one, many)


@pytest.mark.study
@given(scenario=scenarios(), method=st.sampled_from(METHODS))
@random_cases
def test_a_mirrored_scenario_has_the_mirrored_table(scenario: dict[str, Any], method: str) -> None:
    mdp, solution = oracle_of(scenario)
    one, other = planned(scenario, method=method), planned(mirrored(scenario), method=method)
    back = np.roll(other.values[:, ::-1, ::-1, ::-1], 1, axis=2)  # heading k -> -k, bevel -> -bevel
    allowed = one.stats.error_bound + other.stats.error_bound + float32_allowance(solution)
    assert np.max(np.abs(one.values - back)) <= allowed
    policy = np.roll(other.policy[:, ::-1, ::-1, ::-1], 1, axis=2)
    sure = (mdp.kind == FREE)[:, :, None, None] & (solution.gap > 2 * allowed)
    assert np.array_equal(one.policy[sure], policy[sure])


@pytest.mark.study
@given(scenario=scenarios(transition="interpolated"), seed=st.integers(0, 2**31))
@settings(random_cases, max_examples=5)
def test_executions_succeed_as_often_as_the_oracles(scenario: dict[str, Any], seed: int) -> None:
    """Look-up in both: the same policy table, the same continuous model, independent random numbers."""
    mdp, solution = oracle_of(scenario)
    table, runs = planned(scenario), 20_000
    i, j, k, b = np.unravel_index(np.argmax(np.where(solution.success < 1, solution.success, 0)), solution.gap.shape)
    start = (i * mdp.problem.dx, j * mdp.problem.dy, k * mdp.problem.alpha, 2 * int(b) - 1)
    ours = rollout(mdp, start, runs, seed, policy=table.policy).success
    theirs = table.rollout(start, runs=runs, seed=seed, nearest=True).success
    assert theirs == pytest.approx(ours, abs=5 * math.sqrt(2 * max(ours * (1 - ours), 1e-3) / runs))


@cache
def reference(variant: str) -> dict[str, Any]:
    path = npz_path()
    if path is None:
        pytest.skip(f"{NPZ_NAME} is not here: set NEEDLEPLAN_SHARED to the folder that holds it")
    data = np.load(path)
    return {name: data[f"{variant}_{name}"] for name in ("state", "value", "policy", "success", "action_gap")}


@pytest.mark.study
@pytest.mark.parametrize("method", ["sweep", *(pytest.param(each, marks=pytest.mark.slow) for each in ("ppvi", "vi"))])
@pytest.mark.parametrize("variant", VARIANTS)
def test_the_sampled_reference_solutions(variant: str, method: str) -> None:
    data = reference(variant)
    table = planned(four_obstacles(variant), method=method, partitions=[12, 8], tolerance=0.01)
    at = tuple(data["state"].T.astype(int))
    allowed = table.stats.error_bound + 4e-6 * float(data["value"].max())
    assert table.stats.error_bound < 0.1
    assert np.max(np.abs(table.values[at] - data["value"])) <= allowed
    sure = data["action_gap"] > 2 * allowed
    assert np.array_equal(table.policy[at][sure], data["policy"][sure])
    # Elsewhere near-ties may be decided differently, which moves the success of a discounted policy a little.
    assert np.max(np.abs(table.success[at] - data["success"])) <= (1e-3 if variant == "success_arc4" else 2e-2)
