"""From a scenario to a table."""

import math
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import ScenarioError
from needleplan.planning import Status
from needleplan.planning import _planner as planner
from needleplan.scenario import Grid, Layer, Method, Obstacle, Priority, Scenario, Tissue, Transition


def test_a_table_is_what_the_house_promises(small: Scenario, table: npl.PolicyTable) -> None:
    assert table.values.shape == table.policy.shape == table.success.shape == small.shape == (61, 41, 36, 2)
    assert (table.values.dtype, table.policy.dtype, table.success.dtype) == (np.float32, np.uint8, np.float32)
    assert set(np.unique(table.policy)) == {0, 1}
    assert table.success.min() >= 0
    assert table.success.max() <= 1
    stats = table.stats
    assert stats.status is Status.CONVERGED
    assert stats.states == small.states
    assert 0 < stats.error_bound <= small.solver.tolerance
    assert stats.success_error_bound == 1  # not asked for
    assert stats.backups >= stats.sweeps > 0
    assert stats.seconds >= stats.seconds_solving > 0
    assert sorted(stats.order) == sorted(set(stats.order))


def test_the_lattice_has_the_shape_that_the_scenario_says(small: Scenario, table: npl.PolicyTable) -> None:
    assert table.lattice.shape == small.shape
    assert table.lattice.step_mm == pytest.approx(small.step_mm)


def test_arrays_cannot_be_changed(table: npl.PolicyTable) -> None:
    with pytest.raises(ValueError, match="read-only"):
        table.values[0] = 0


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize("transition", Transition)
def test_every_method_gives_the_same_values(small: Scenario, method: Method, transition: Transition) -> None:
    scene = replace(small, grid=Grid((2, 2), transition), objective=replace(small.objective, discount=0.95))
    values = [
        npl.plan(replace(scene, solver=replace(small.solver, method=each, tolerance=1e-3))).values
        for each in (method, Method.VALUE_ITERATION)
    ]
    assert values[0] == pytest.approx(values[1], abs=2e-3, rel=1e-5)


def test_only_partitions_without_free_points_are_left_out(small: Scenario) -> None:
    columns, rows = 12, 8
    solver = replace(small.solver, method=Method.PPVI, partitions=(columns, rows), priority=Priority.H2, tolerance=0.1)
    table = npl.plan(replace(small, solver=solver, objective=replace(small.objective, discount=0.9)))
    in_obstacle = table.lattice.outcomes()[:, :, 0, 0] == 4
    left_out = set(range(columns * rows)) - set(table.stats.order)
    assert left_out
    for partition in left_out:
        column, row = divmod(partition, rows)
        x = slice(math.ceil(column * 61 / columns), (column + 1) * 61 // columns)
        y = slice(math.ceil(row * 41 / rows), (row + 1) * 41 // rows)
        assert in_obstacle[x, y].all()


def test_the_order_of_obstacles_changes_nothing(small: Scenario) -> None:
    more = (*small.obstacles, Obstacle([(5, 30), (10, 30), (8, 35)]), Obstacle([(35, 5), (40, 5), (38, 9)]))
    forward, backward = (npl.plan(replace(small, obstacles=order)) for order in (more, more[::-1]))
    np.testing.assert_array_equal(forward.values, backward.values)
    np.testing.assert_array_equal(forward.policy, backward.policy)


def test_a_limit_of_sweeps_is_told(small: Scenario) -> None:
    table = npl.plan(replace(small, solver=replace(small.solver, max_sweeps=1)))
    assert table.stats.status is Status.ITERATION_LIMIT
    assert table.stats.error_bound > small.solver.tolerance


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize("discount", [1.0, 0.95])
def test_a_tolerance_below_single_precision_is_told(small: Scenario, method: Method, discount: float) -> None:
    scene = replace(small, grid=Grid((2, 2)), objective=replace(small.objective, discount=discount))
    solver = replace(small.solver, method=method)
    table, reference = (
        npl.plan(replace(scene, solver=replace(solver, tolerance=tolerance))) for tolerance in (1e-9, 0.01)
    )
    assert reference.stats.status is Status.CONVERGED
    assert table.stats.status is Status.PRECISION_LIMIT
    # Half a unit in the last place of the largest value, and little more.
    assert 1 <= table.stats.error_bound / (table.values.max() * 2.0**-24) < 3
    difference = np.abs(table.values.astype(float) - reference.values).max()
    assert difference <= table.stats.error_bound + reference.stats.error_bound


def test_progress_is_called_and_may_stop_the_solve(small: Scenario) -> None:
    calls: list[tuple[float, float, float]] = []
    npl.plan(
        replace(small, solver=replace(small.solver, method=Method.VALUE_ITERATION)), lambda *call: calls.append(call)
    )
    assert calls
    assert all(sweeps >= 0 and residual >= 0 and threshold > 0 for sweeps, residual, threshold in calls)

    def stop(*_: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        npl.plan(small, stop)


@pytest.mark.parametrize("threads", [None, 1, 3])
def test_progress_is_called_on_the_thread_of_the_caller(small: Scenario, threads: int | None) -> None:
    seen: set[int] = set()
    npl.plan(replace(small, solver=replace(small.solver, threads=threads)), lambda *_: seen.add(threading.get_ident()))
    assert seen == {threading.get_ident()}


@pytest.mark.parametrize("threads", [None, 2])
def test_ctrl_c_stops_a_solve(small: Scenario, threads: int | None) -> None:
    solver = replace(small.solver, method=Method.VALUE_ITERATION, tolerance=1e-14, threads=threads, time_limit_s=60)
    # Seconds of work on any machine: the signal must not come after the solve.
    scenario = replace(small, grid=replace(small.grid, spacing_mm=(0.2, 0.2)), solver=solver)
    timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        npl.plan(scenario)
    assert time.monotonic() - began < 30


def test_an_unreachable_target_ends_with_no_success() -> None:
    scenario = Scenario.read("unreachable")
    table = npl.plan(replace(scenario, grid=replace(scenario.grid, spacing_mm=(2, 2))))
    assert table.stats.status is Status.CONVERGED
    assert table.best_entry().success == 0


@pytest.mark.parametrize(("spacing", "amount"), [(1e-4, "GB"), (1e-6, "TB"), (1e-7, "TB")])
def test_a_grid_too_large_says_how_much_it_needs(small: Scenario, spacing: float, amount: str) -> None:
    scenario = replace(small, grid=Grid((spacing, 1)))
    with pytest.raises(ScenarioError) as caught:
        npl.plan(scenario)
    # Twice the points along x and y, since a step is shorter than eight cells of the table.
    most = 4 * scenario.states
    says = f"the grid has {scenario.states:,} states, at most {most:,} with success_refinement = 2, and needs about"
    assert says in str(caught.value)
    assert amount in str(caught.value)


def questioned(scenario: Scenario) -> list[tuple[str, str]]:
    """The keys and values that `plan` questions, all in one error."""
    with pytest.raises(ScenarioError, match=r"questionably .* Convert it, or accept the units as they are") as caught:
        npl.plan(scenario)
    return [(mistake.key, mistake.value) for mistake in caught.value.mistakes]


def test_sizes_in_metres_are_questioned(small: Scenario) -> None:
    needle = replace(small.needle, curvature_radius_mm=0.18, layers=(Layer(10.0, 0.2), Layer(20.0, 50.0)))
    scenario = replace(small, needle=needle, tissues=(Tissue([(1, 1), (9, 1), (5, 9)], 0.1),))
    assert questioned(scenario) == [
        ("needle.curvature_radius_mm", "0.18 mm"),
        ("needle.layer 1.curvature_radius_mm", "0.2 mm"),
        ("tissue 1.curvature_radius_mm", "0.1 mm"),
    ]
    target = replace(small.target, radius_mm=0.002)
    assert questioned(replace(small, target=target)) == [("target.radius_mm", "0.002 mm")]


def test_a_grid_far_finer_or_coarser_than_a_step_is_questioned(small: Scenario) -> None:
    assert small.step_mm == pytest.approx(6.98, abs=0.01)
    assert questioned(replace(small, grid=Grid((1.0, 0.01)))) == [("grid.spacing_mm", "0.01 mm")]
    turning = replace(small, motion=replace(small.motion, headings=20_000), grid=Grid((2.0, 2.0)))
    assert questioned(turning) == [("grid.spacing_mm", "2 mm")]


def test_a_step_whose_inverse_is_infinite_is_questioned(small: Scenario) -> None:
    with pytest.raises(ScenarioError, match="questionably large beside a step"):
        npl.plan(replace(small, motion=replace(small.motion, step_mm=5e-324)))


def test_questionable_sizes_can_be_accepted(small: Scenario) -> None:
    limits = replace(small.solver, max_sweeps=2)
    grid = replace(small.grid, spacing_mm=(10.0, 10.0), success_refinement=1)
    metres = replace(small, needle=replace(small.needle, curvature_radius_mm=0.18), grid=grid, solver=limits)
    assert npl.plan(metres, accept_units=True).stats.status is Status.ITERATION_LIMIT


def test_shipped_sizes_are_not_questioned() -> None:
    names = [each.stem for each in (Path(npl.__file__).parent / "scenarios").glob("*.toml")]
    assert len(names) > 5
    for name in names:
        assert planner.questionable_sizes(Scenario.read(name)) == []


def test_memory_is_compared_with_what_is_available(small: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    small = replace(small, grid=replace(small.grid, success_refinement=1))
    needed = small.states * planner.BYTES_PER_STATE[small.solver.method]
    monkeypatch.setattr(planner, "available_bytes", lambda: needed)
    planner.require_memory(small)
    monkeypatch.setattr(planner, "available_bytes", lambda: needed - 1)
    with pytest.raises(ScenarioError, match=r"needs about 3\.6 MB of memory; 3\.6 MB are available"):
        planner.require_memory(small)
