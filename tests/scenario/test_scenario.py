"""A scenario survives its file, and its numbers follow from it."""

import copy
import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings

from needleplan.errors import OutputError, ScenarioError
from needleplan.scenario import (
    Grid,
    Needle,
    Obstacle,
    Scenario,
    ShippedScenario,
    Solver,
    Target,
    Transition,
    Workspace,
    shipped,
    template,
)
from tests.scenario.scenes import scenarios

SQUARE = [(10, 10), (20, 10), (20, 20), (10, 20)]


def plain() -> Scenario:
    return Scenario(Workspace(120, 80), Target((100, 50), 2), Needle(40))


@settings(deadline=None)
@given(scenarios())
def test_text_reads_back_as_the_same_scenario(scenario: Scenario) -> None:
    again = Scenario.from_toml(scenario.to_toml())
    assert again == scenario
    assert again.to_toml() == scenario.to_toml()
    assert again.digest == scenario.digest


def test_file_reads_back_as_the_same_scenario(tmp_path: Path) -> None:
    scenario = replace(plain(), obstacles=(Obstacle(SQUARE, 'a "quoted"\n\x7f\\ name, µ 🎯'),))
    scenario.write(tmp_path / "scenario.toml")
    assert Scenario.read(tmp_path / "scenario.toml") == scenario
    assert [file.name for file in tmp_path.iterdir()] == ["scenario.toml"]


def test_unwritable_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written: No such file or directory"):
        plain().write(tmp_path / "missing" / "scenario.toml")


def test_layout_and_comments_do_not_change_the_digest() -> None:
    text = plain().to_toml()
    assert Scenario.from_toml(text.replace("\n", "  # remark\n")).digest == plain().digest
    assert Scenario.from_toml(text.replace("radius_mm = 2.0", "radius_mm = 2.5")).digest != plain().digest


def test_numbers_of_the_thesis() -> None:
    scenario = plain()
    assert scenario.shape == (121, 81, 60, 2)
    assert scenario.states == 1_176_120
    assert scenario.step_mm == pytest.approx(2 * math.pi * 40 / 60)
    assert scenario.x_mm[[0, -1]].tolist() == [0, 120]
    assert scenario.y_mm[[0, -1]].tolist() == [0, 80]
    assert scenario.headings_rad[15] == pytest.approx(math.pi / 2)


def test_partitions_fit_the_grid() -> None:
    assert plain().partitions == (12, 8)
    assert replace(plain(), grid=Grid((20, 20), Transition.INTERPOLATED)).partitions == (7, 5)
    assert replace(plain(), solver=Solver(partitions=(3, 2))).partitions == (3, 2)


def test_defaults_are_those_of_the_house() -> None:
    scenario = plain()
    assert scenario.motion.tip_noise == (0.466, 0.24, 0.027)
    assert scenario.grid.transition is Transition.INTERPOLATED
    assert (scenario.objective.collision, scenario.objective.discount) == (10_000, 1)


def test_arrays_and_numpy_numbers_are_taken() -> None:
    obstacle = Obstacle(np.array(SQUARE), "box")
    assert obstacle.polygon_mm == tuple((float(x), float(y)) for x, y in SQUARE)
    assert Workspace(np.float32(120), np.int64(80)) == Workspace(120.0, 80.0)
    assert Grid(np.array([1, 2])).spacing_mm == (1.0, 2.0)


def test_repeated_corners_are_dropped() -> None:
    assert Obstacle([*SQUARE, SQUARE[-1], SQUARE[0]]) == Obstacle(SQUARE)


def test_replacing_a_part_checks_again() -> None:
    with pytest.raises(ScenarioError, match=r"target\.center_mm"):
        replace(plain(), workspace=Workspace(50, 50))


@pytest.mark.parametrize("name", shipped())
def test_shipped_scenarios_read_by_name_and_by_path(name: str) -> None:
    scenario = Scenario.read(name)
    assert scenario.title
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert scenario.states > 100_000


def test_shipped_scenarios_are_all_there() -> None:
    assert list(get_args(ShippedScenario)) == shipped()
    assert {"four_obstacles", "four_obstacles_thesis", "phantom"} < set(shipped())


def test_a_file_beats_a_shipped_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    plain().write("four_obstacles")
    assert Scenario.read("four_obstacles") == plain()


@settings(deadline=None)
@given(scenarios())
def test_copies_are_the_same_scenario(scenario: Scenario) -> None:
    for again in (pickle.loads(pickle.dumps(scenario)), copy.deepcopy(scenario), copy.copy(scenario)):
        assert again == scenario
        assert again.digest == scenario.digest
        assert hash(again) == hash(scenario)
        assert again.grid.transition is scenario.grid.transition


@pytest.mark.parametrize("name", shipped())
def test_a_template_reads_back_and_explains_every_value(name: str) -> None:
    text = template(name)
    assert Scenario.from_toml(text) == Scenario.read(name)
    values = [line for line in text.splitlines() if " = " in line and not line.startswith(("#", "schema", "title"))]
    assert values
    assert all("  # " in line for line in values)


def test_a_template_of_a_file_of_ones_own(tmp_path: Path) -> None:
    plain().write(tmp_path / "mine.toml")
    assert Scenario.from_toml(template(tmp_path / "mine.toml")) == plain()
    with pytest.raises(ScenarioError, match="no shipped scenario of that name"):
        template("four_obstacle")
