"""Sweep files: designs, keys, and every mistake reported."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from needleplan.config import parse_toml
from needleplan.errors import SweepError
from needleplan.scenario import Scenario
from needleplan.sweep import Design, Sweep, SweptParameter, shipped_sweeps
from needleplan.sweep._points import points_of
from needleplan.sweep._problems import PlaneProblem, SweptProblems
from tests.sweep.sweeps import SCENARIO, write_sweep

SMALL = SweptProblems.one(PlaneProblem(Scenario.from_toml(SCENARIO)))
HEAD = 'schema = "needleplan.sweep/1"\nscenario = "small.toml"\n'


def parameter(key: str, **more: object) -> SweptParameter:
    return SweptParameter(key, **more)  # type: ignore[arg-type]


def scenarios(*parameters: SweptParameter, **more: object) -> list[Scenario | None]:
    return [point.scenario for point in points_of(Sweep("small.toml", parameters, **more), SMALL)]  # type: ignore[arg-type]


def test_a_product_has_every_combination_and_the_last_parameter_varies_fastest() -> None:
    radius = parameter("needle.curvature_radius_mm", values=[30.0, 50.0])
    rotation = parameter("objective.rotation", low=1.0, high=5.0, count=3)
    sweep = Sweep("small.toml", (radius, rotation))
    points = list(points_of(sweep, SMALL))
    assert sweep.tables == len(points) == 6
    wanted = list(itertools.product([30.0, 50.0], [1.0, 3.0, 5.0]))
    assert [tuple(point.values.values()) for point in points] == wanted
    found = [
        (each.scenario.needle.curvature_radius_mm, each.scenario.objective.rotation) for each in points if each.scenario
    ]
    assert found == wanted


def test_a_list_takes_the_values_together() -> None:
    found = scenarios(
        parameter("needle.curvature_radius_mm", values=[30.0, 50.0]),
        parameter("target.center_mm", values=[[40.0, 20.0], [45.0, 30.0]]),
        design="list",
    )
    assert [(each.needle.curvature_radius_mm, each.target.center_mm) for each in found if each] == [
        (30.0, (40.0, 20.0)),
        (50.0, (45.0, 30.0)),
    ]


def test_a_sample_fills_every_stratum_once_and_follows_its_seed() -> None:
    radius = parameter("needle.curvature_radius_mm", low=20.0, high=80.0, scale="log")
    noise = parameter("motion.tip_noise_step_deg", low=1.0, high=9.0)
    sweep = Sweep("small.toml", (radius, noise), design="sampled", samples=40, seed=5)
    values = np.array([list(point.values.values()) for point in points_of(sweep, SMALL)])
    shares = np.column_stack([np.log(values[:, 0] / 20) / np.log(4), (values[:, 1] - 1) / 8])
    strata = np.sort(np.floor(40 * shares), axis=0)
    assert strata.T.tolist() == [list(range(40))] * 2
    again = np.array([list(point.values.values()) for point in points_of(sweep, SMALL)])
    assert np.array_equal(values, again)


def test_log_levels_have_equal_ratios_and_exact_ends() -> None:
    levels = parameter("objective.rotation", low=0.1, high=1000.0, count=5, scale="log").levels
    assert (levels[0], levels[-1]) == (0.1, 1000.0)
    assert np.allclose(np.diff(np.log(np.array(levels, float))), np.log(10))


def test_tables_of_lists_are_named_and_coordinates_have_letters() -> None:
    found = scenarios(
        parameter("obstacle.vessel.radius_mm", values=[5.0]),
        parameter("obstacle.1.margin_mm", values=[1.0]),
        parameter("target.center_mm.y", values=[30.0]),
        parameter("grid.spacing_mm.1", values=[5.0]),
    )[0]
    assert found
    assert (found.obstacles[0].radius_mm, found.obstacles[0].margin_mm) == (5.0, 1.0)
    assert (found.target.center_mm, found.grid.spacing_mm) == ((50.0, 30.0), (5.0, 4.0))


@pytest.mark.parametrize(
    ("key", "rule"),
    [
        ("needle.curvature_radius", 'did you mean "curvature_radius_mm"?'),
        ("needel.curvature_radius_mm", 'has no table "needel"; did you mean "needle"?'),
        ("obstacle.vesel.radius_mm", 'has no entry "vesel"'),
        ("obstacle.2.radius_mm", 'has no entry "2"'),
        ("obstacle.x.radius_mm", 'has no entry "x"'),
        ("target.center_mm.z", 'has no entry "z"'),
        ("needle.curvature_radius_mm.x", 'has no key "x" in a value that is no table'),
    ],
)
def test_a_key_that_no_scenario_has_is_refused(key: str, rule: str) -> None:
    with pytest.raises(SweepError, match=r"parameter 1\.key") as refused:
        scenarios(parameter(key, values=[5.0]))
    assert rule in str(refused.value)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("target.center_mm.y", "target.center_mm.y"),
        ("target.center_mm.y", "target.center_mm.2"),
        ("target.center_mm", "target.center_mm.x"),
        ("obstacle.1.margin_mm", "obstacle.vessel.margin_mm"),
        ("obstacle.vessel", "obstacle.1.radius_mm"),
    ],
)
def test_two_parameters_over_the_same_key_are_refused(one: str, other: str) -> None:
    with pytest.raises(SweepError, match=r"parameter 2\.key") as refused:
        scenarios(parameter(one, name="a", values=[5.0]), parameter(other, name="b", values=[6.0]))
    assert f'changes what "{one}" changes' in str(refused.value)
    assert scenarios(parameter("target.center_mm.x", values=[40.0]), parameter("target.center_mm.y", values=[20.0]))[0]


def test_values_of_a_product_differ() -> None:
    twice = [parameter("needle.curvature_radius_mm", values=[40.0, 50.0, 40])]
    with pytest.raises(SweepError, match=r'parameter 1\.values .* must differ with design = "product": 40'):
        Sweep("small.toml", twice)
    assert Sweep("small.toml", twice, design="list").tables == 3  # type: ignore[arg-type]


def test_a_key_that_only_a_later_file_has_is_no_mistake(tmp_path: Path) -> None:
    (tmp_path / "one.toml").write_text(SCENARIO.replace("vessel", "bone"))
    (tmp_path / "two.toml").write_text(SCENARIO)
    files = parameter("scenario", values=[str(tmp_path / "one.toml"), str(tmp_path / "two.toml")])
    sweep = Sweep("", (files, parameter("obstacle.vessel.margin_mm", values=[0.5])))
    assert [bool(point.scenario) for point in points_of(sweep, sweep.problems())] == [False, True]


def test_several_files(tmp_path: Path) -> None:
    (tmp_path / "one.toml").write_text(SCENARIO)
    (tmp_path / "two.toml").write_text(
        SCENARIO.replace("vessel", "bone").replace("radius_mm = 40.0", "radius_mm = 55.0")
    )
    text = 'schema = "needleplan.sweep/1"\n[[parameter]]\nkey = "scenario"\nname = "patient"\n'
    text += 'values = ["one.toml", "two.toml"]\n'
    (tmp_path / "sweep.toml").write_text(
        text + '[[parameter]]\nkey = "obstacle.vessel.margin_mm"\nvalues = [0.5, 1.0]\n'
    )
    sweep = Sweep.read(tmp_path / "sweep.toml")
    points = list(points_of(sweep, sweep.problems()))
    assert [bool(point.scenario) for point in points] == [True, True, False, False]
    assert 'has no entry "vessel"' in points[2].why
    assert points[1].values["patient"] == str(tmp_path / "one.toml")
    (tmp_path / "sweep.toml").write_text(text)
    sweep = Sweep.read(tmp_path / "sweep.toml")
    found = [point.scenario for point in points_of(sweep, sweep.problems())]
    assert found == [Scenario.read(tmp_path / name) for name in ("one.toml", "two.toml")]
    for more, rule in (
        ('scenario = "one.toml"\n', "holds the files: leave out scenario and anatomy"),
        ("", "only one parameter may hold files"),
    ):
        wrong = text.replace("[[parameter]]", more + "[[parameter]]")
        wrong += "" if more else '[[parameter]]\nkey = "anatomy"\nvalues = ["a.toml"]\n'
        with pytest.raises(SweepError, match=rule):
            parse_toml(wrong, Sweep)
    with pytest.raises(SweepError, match="must be names of files"):
        parse_toml(text.replace('["one.toml", "two.toml"]', "[1, 2]"), Sweep)


def test_a_combination_against_a_rule_is_a_point_without_a_scenario() -> None:
    points = list(points_of(Sweep("small.toml", (parameter("target.center_mm.x", values=[40.0, 80.0]),)), SMALL))
    assert [bool(point.scenario) for point in points] == [True, False]
    assert "must lie in the workspace" in points[1].why


@pytest.mark.parametrize(
    ("text", "rules"),
    [
        ("", ["parameter: is missing: must be at least one [[parameter]]"]),
        ("parameter = []", ["a sweep needs at least one [[parameter]]"]),
        ('[[parameter]]\nkey = "a.b"', ["values: is missing: give values, or low and high"]),
        ('[[parameter]]\nkey = "a.b"\nvalues = []', ["must be a list of at least one value"]),
        ('[[parameter]]\nkey = "a.b"\nlow = 2\nhigh = 1', ["must be larger than low, 2"]),
        ('[[parameter]]\nkey = "a.b"\nlow = 0\nhigh = 1\nscale = "log"', ["must be above 0"]),
        ('[[parameter]]\nkey = "a.b"\nvalues = [1]\nlow = 0', ["must be left out beside values"]),
        ('[[parameter]]\nkey = "a.b"\nvalues = [nan]', ["must be a finite number"]),
        ('[[parameter]]\nkey = "a.b"\nvalues = [1]\n[[parameter]]\nkey = "c.b"\nvalues = [1]', ["earlier parameter"]),
        ('design = "sampled"\n[[parameter]]\nkey = "a.b"\nlow = 0\nhigh = 1', ["needs the number of tables"]),
        ('samples = 3\n[[parameter]]\nkey = "a.b"\nvalues = [1]', ["must be left out unless"]),
        ('desing = "list"\n[[parameter]]\nkey = "a.b"\nvalues = [1]\ncount = 1',
         ['did you mean "design"?', "count = 1: must be a whole number from 2"]),
        ('design = "list"\n[[parameter]]\nkey = "a.b"\nvalues = [1]\n[[parameter]]\nkey = "c.d"\nvalues = [1, 2]',
         ["must all have as many values", "(b: 1, d: 2)"]),
    ],
)  # fmt: skip
def test_every_mistake_of_a_file_is_reported(text: str, rules: list[str]) -> None:
    with pytest.raises(SweepError) as refused:
        parse_toml(HEAD + text, Sweep, "mine.toml")
    for rule in rules:
        assert rule in str(refused.value)


def test_a_sweep_reads_back_and_finds_its_scenario_beside_it(tmp_path: Path) -> None:
    sweep = Sweep.read(write_sweep(tmp_path))
    assert parse_toml(sweep.to_toml(), Sweep) == sweep
    assert sweep.problems() == SMALL
    assert sweep.design is Design.PRODUCT


@pytest.mark.parametrize("name", shipped_sweeps())
def test_shipped_sweeps_have_only_scenarios(name: str) -> None:
    sweep = Sweep.read(name)
    assert all(point.scenario for point in points_of(sweep, sweep.problems()))


def test_too_many_tables_are_refused_with_their_count_and_time() -> None:
    many = [parameter(f"objective.{name}", low=1.0, high=2.0, count=1000) for name in ("rotation", "collision", "exit")]
    with pytest.raises(SweepError, match=r"1,000,000,000 tables of \d[\d,]* states, \d+ (days|years)"):
        Sweep("small.toml", many).require_finite(SMALL)
