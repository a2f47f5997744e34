"""When the plan is left, what is planned instead, and when the new table is taken."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.control import Options, ThreadReplanner
from needleplan.control._replanning import curvature_mismatch, rescaled
from needleplan.errors import ScenarioError
from needleplan.scenario import Scenario
from tests.control.scenes import small_table


@given(st.floats(0.001, 0.1), st.floats(0.5, 2), st.floats(0.001, 0.3))
def test_the_plan_is_left_where_the_estimate_is_sure_and_far(planned: float, factor: float, share: float) -> None:
    cause = curvature_mismatch(
        planned * factor, planned * share, planned, Options(replan_deviations=3.0, replan_share=0.04)
    )
    off = abs(factor - 1)
    assert (
        bool(cause) == (off > 3 * share and off > 0.04) or off == pytest.approx(3 * share) or off == pytest.approx(0.04)
    )
    if cause:
        assert "standard deviations" in cause


def test_an_estimate_without_any_deviation_is_sure() -> None:
    cause = curvature_mismatch(0.03, 0.0, 0.025, Options())
    assert cause.endswith("a difference of +20.0%")
    assert curvature_mismatch(0.025, 0.0, 0.025, Options()) == ""


@pytest.mark.parametrize("name", ["four_obstacles", "layered", "brain"])
@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_all_curvatures_are_scaled_alike(name: str, factor: float) -> None:
    scenario = Scenario.read(name)
    made = rescaled(scenario, factor)
    x, y = np.meshgrid(
        np.linspace(0, scenario.workspace.width_mm, 40), np.linspace(0, scenario.workspace.height_mm, 30)
    )
    np.testing.assert_allclose(made.radius_mm(x, y) * factor, scenario.radius_mm(x, y))
    assert replace(made, needle=scenario.needle, tissues=scenario.tissues) == scenario


def test_on_simulated_time_a_table_is_taken_at_the_next_decision() -> None:
    with ThreadReplanner(wait=True) as replanner:
        assert replanner.take(0) is None
        replanner.ask(rescaled(small_table().scenario, 1.1))
        assert replanner.busy
        table = replanner.take(1)
        assert table is not None
        assert table.scenario.needle.curvature_radius_mm == pytest.approx(40 / 1.1)
        assert not replanner.busy
        assert replanner.take(2) is None


def test_in_a_replay_it_is_taken_when_it_was() -> None:
    with ThreadReplanner(wait=True, at=[4]) as replanner:
        replanner.ask(small_table().scenario)
        assert [replanner.take(step) is not None for step in range(6)] == [False] * 4 + [True, False]


def test_a_plan_that_fails_says_so_once() -> None:
    impossible = replace(small_table().scenario, grid=replace(small_table().scenario.grid, spacing_mm=(1e-3, 1e-3)))
    with ThreadReplanner(wait=True) as replanner:
        replanner.ask(impossible)
        with pytest.raises(ScenarioError):
            replanner.take(1)
        assert not replanner.busy
        assert replanner.take(2) is None
