"""Every mistake of a scenario file gives one clear message, all of them at once, and never another exception."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from needleplan.errors import ScenarioError
from needleplan.scenario import Scenario, shipped

TEXT = """schema = "needleplan.scenario/1"
title = "Test"
[workspace]
width_mm = 120.0
height_mm = 80.0
[[obstacle]]
name = "vessel"
polygon_mm = [[25, 0], [40, 0], [40, 22], [32, 30], [25, 20]]
[[obstacle]]
polygon_mm = [[-5, 60], [10, 60], [10, 95]]
[target]
center_mm = [100.0, 50.0]
radius_mm = 2.0
[needle]
curvature_radius_mm = 40.0
[[needle.layer]]
from_mm = 30.0
curvature_radius_mm = 45
[[needle.layer]]
from_mm = 60
curvature_radius_mm = 50
[[tissue]]
name = "tumour"
polygon_mm = [[80, 20], [110, 20], [110, 70]]
curvature_radius_mm = 80
[motion]
headings = 60
tip_noise = [0.466, 0.24, 0.027]
arc_samples = 4
[grid]
spacing_mm = [1.0, 1.0]
transition = "nearest"
[objective]
insertion_per_mm = 1.0
discount = 1.0
[solver]
method = "ppvi"
partitions = [12, 8]
tolerance = 0.01
"""

CASES = [
    ("width_mm = 120.0", "width_mm = -1", "workspace.width_mm = -1: must be a finite number in mm above 0"),
    ("width_mm = 120.0", "width_mm = 0", "workspace.width_mm = 0: must be"),
    ("width_mm = 120.0", "width_mm = true", "workspace.width_mm = true: must be a finite number"),
    ("width_mm = 120.0", 'width_mm = "120"', 'workspace.width_mm = "120": must be a finite number'),
    ("width_mm = 120.0", "width_mm = nan", "workspace.width_mm = nan: must be a finite number"),
    ("width_mm = 120.0", "width_mm = inf", "workspace.width_mm = inf: must be a finite number"),
    ("width_mm = 120.0", f"width_mm = 1{'0' * 400}", "must be a finite number"),
    ("width_mm = 120.0", "width_mm = 1979-05-27", "must be a finite number"),
    ("width_mm = 120.0", "", "workspace.width_mm: is missing"),
    ("width_mm = 120.0", "width_mm = 120.0\nwidht_mm = 1", 'unknown key; did you mean "width_mm"?'),
    ("[needle]", "[nedle]", 'nedle: unknown key; did you mean "needle"?'),
    ("[[obstacle]]", "[[obstacles]]", 'obstacles: unknown key; did you mean "obstacle"?'),
    ("/1", "/2", 'schema = "needleplan.scenario/2": must be "needleplan.scenario/1"'),
    ('title = "Test"', "title = 3", "title = 3: must be a text"),
    ('"vessel"', "3", "obstacle 1.name = 3: must be a text"),
    ("[40, 22]", "[40]", 'obstacle 1 ("vessel").polygon_mm = [[25, 0], [40, 0], [40]'),
    ("[40, 22]", "[40]", "point 3: must be two numbers, [x, y]"),
    ("[40, 22]", '[40, "22"]', "point 3: each of the two must be a finite number"),
    ("[40, 22]", "[20, 10]", "must not cross or touch its own boundary; it does so at (25,"),
    ("[10, 95]", "[-5, 60]", "obstacle 2.polygon_mm = [[-5, 60], [10, 60], [-5, 60]]: must have at least three"),
    ("[10, 95]", "[40, 60]", "must enclose an area"),
    ("[[-5, 60], [10, 60], [10, 95]]", "3", "obstacle 2.polygon_mm = 3: must be a list of points"),
    ("[100.0, 50.0]", "[130, 50]", "target.center_mm = [130.0, 50.0]: must lie in the workspace, [0, 120] x [0, 80]"),
    ("[100.0, 50.0]", "[30, 10]", 'must not lie in or on an obstacle; it does in obstacle 1 ("vessel")'),
    ("[100.0, 50.0]", "[40, 10]", "must not lie in or on an obstacle"),
    ("[100.0, 50.0]", "[1, 2, 3]", "target.center_mm = [1, 2, 3]: must be two numbers"),
    ("radius_mm = 2.0\n[n", "radius_mm = 0.0\n[n", "target.radius_mm = 0.0: must be"),
    ("[100.0, 50.0]\nradius_mm = 2.0", "[100.5, 50.5]\nradius_mm = 0.5", "must be at least 0.707107, the distance"),
    ("= 40.0", "= -40.0", "needle.curvature_radius_mm = -40.0: must be"),
    (
        "from_mm = 60",
        "from_mm = 30",
        "needle.layer 2.from_mm = 30: must increase from layer to layer; 30 comes after 30",
    ),
    (
        "from_mm = 60",
        "from_mm = 20",
        "needle.layer 2.from_mm = 20: must increase from layer to layer; 20 comes after 30",
    ),
    ("from_mm = 60", "from_mm = 121", "needle.layer 2.from_mm = 121.0: must lie in the workspace, from 0 to 120"),
    ("from_mm = 60", "from_mm = -1", "needle.layer 2.from_mm = -1: must be a finite number in mm at least 0"),
    ("from_mm = 60", "", "needle.layer 2.from_mm: is missing"),
    ("from_mm = 60", "fromm_mm = 60", 'needle.layer 2.fromm_mm: unknown key; did you mean "from_mm"?'),
    ("_mm = 45", "_mm = 0", "needle.layer 1.curvature_radius_mm = 0: must be a finite number in mm above 0"),
    (
        "[[needle.layer]]",
        "[[needle.layers]]",
        'needle.layers: unknown key; did you mean "layer"?',
    ),
    (
        "[[needle.layer]]\nfrom_mm = 60\ncurvature_radius_mm = 50",
        "[[needl]]",
        'needl: unknown key; did you mean "needle"',
    ),
    ("[[tissue]]", "[tissue]", "tissue = {...}: must be tables, each below its own [[tissue]]"),
    ("[[tissue]]", "[[tisue]]", 'tisue: unknown key; did you mean "tissue"?'),
    (
        "curvature_radius_mm = 80",
        "curvature_radius_mm = nan",
        'tissue 1 ("tumour").curvature_radius_mm = nan: must be a finite number in mm',
    ),
    ("[110, 20], [110, 70]", "[110, 20]", 'tissue 1 ("tumour").polygon_mm = [[80, 20], [110, 20]]: must have at least'),
    ("[110, 20], [110, 70]", "[90, 30], [90, 10], [80, 30]", "must not cross or touch its own boundary"),
    ("headings = 60", "headings = 60.0", "motion.headings = 60.0: must be a whole number from 4 to 100000"),
    ("headings = 60", "headings = 3", "motion.headings = 3: must be a whole number"),
    ("headings = 60", "headings = 4", "motion.headings = 4: must be more than 4, so that the tip noise stays"),
    ("0.466", "0.5", "motion.tip_noise = [0.5, 0.24, 0.027]: P(0) + 2 * (P(+-1) + P(+-2) + ...) must be 1, not 1.034"),
    ("0.24,", "-0.24,", "motion.tip_noise = [0.466, -0.24, 0.027]: each probability must be a finite number"),
    ("[0.466, 0.24, 0.027]", "[]", "must be 1 to 8 probabilities"),
    ("[0.466, 0.24, 0.027]", "1", "must be 1 to 8 probabilities"),
    ("arc_samples = 4", "arc_samples = 0", "motion.arc_samples = 0: must be a whole number from 1"),
    ("[1.0, 1.0]", "[1.0, 0]", "grid.spacing_mm = [1.0, 0]: each of the two must be a finite number in mm above 0"),
    ("[1.0, 1.0]", "[200, 1]", "grid.spacing_mm = [200.0, 1.0]: must not exceed the workspace"),
    ('"nearest"', '"nearst"', 'must be one of "nearest", "interpolated"; did you mean "nearest"?'),
    ("insertion_per_mm = 1.0", "insertion_per_mm = 0", "must be above 0 if the discount is 1"),
    ("discount = 1.0", "discount = 1.1", "objective.discount = 1.1: must be a finite number above 0 and at most 1"),
    ('"ppvi"', '"PPVI"', 'solver.method = "PPVI": must be one of "sweep", "ppvi", "vi"'),
    ("[12, 8]", "[122, 8]", "solver.partitions = [122, 8]: must not exceed the grid, 121 x 81 points"),
    ("[12, 8]", "[12, 0]", "solver.partitions = [12, 0]: each of the two must be a whole number from 1"),
    ("tolerance = 0.01", "tolerance = 0", "solver.tolerance = 0: must be"),
    ("tolerance = 0.01", "threads = 0", "solver.threads = 0: must be a whole number from 1"),
    ("[workspace]\nwidth_mm = 120.0\nheight_mm = 80.0", "workspace = 3", "workspace = 3: must be a table, [workspace]"),
    ("[workspace]\nwidth_mm = 120.0\nheight_mm = 80.0", "", "workspace.height_mm: is missing"),
    ("[workspace]", "[workspace", "is not TOML: "),
    ("[workspace]", f"a = {'[' * 5000}", "is not TOML: "),
    ("[workspace]", f"a = {'9' * 5000}", "is not TOML: "),
]


def message(text: str, source: str = "") -> str:
    with pytest.raises(ScenarioError) as caught:
        Scenario.from_toml(text, source)
    return str(caught.value)


def test_the_text_itself_is_fine() -> None:
    assert len(Scenario.from_toml(TEXT).obstacles) == 2


@pytest.mark.parametrize(("old", "new", "expected"), CASES)
def test_a_mistake_names_key_value_and_rule(old: str, new: str, expected: str) -> None:
    assert TEXT.count(old) >= 1
    assert expected in message(TEXT.replace(old, new))


def test_a_single_obstacle_table_is_explained() -> None:
    head, rest = TEXT.split("[[obstacle]]\npolygon_mm = [[-5", 1)[0].split("[[obstacle]]", 1)
    assert "must be tables, each below its own [[obstacle]]" in message(f"{head}[obstacle]{rest.split('[[obst')[0]}")


def test_all_mistakes_come_in_one_message() -> None:
    text = TEXT.replace("width_mm = 120.0", "width_mm = -1").replace("0.466", "nan").replace("headings", "heading")
    text = text.replace("tolerance = 0.01", "tolerance = -1").replace("[40, 22]", "[20, 10]")
    lines = message(text, "my.toml").splitlines()
    assert lines[0] == "my.toml: 5 mistakes"
    keys = ("workspace.width_mm", "motion.tip_noise", "motion.heading:", "solver.tolerance", "obstacle 1")
    assert all(any(line.startswith(f"  {key}") for line in lines) for key in keys)


def test_contradictions_are_found_beside_broken_parts() -> None:
    lines = message(TEXT.replace("[100.0, 50.0]", "[130, 50]").replace("= 40.0", "= 0")).splitlines()
    assert any("target.center_mm" in line for line in lines)
    assert any("needle.curvature_radius_mm" in line for line in lines)


UNREADABLE: list[tuple[str, Callable[[Path], object], str]] = [
    ("missing.toml", lambda _: None, "no such file, and no shipped scenario of that name"),
    ("four_obstacle", lambda _: None, 'did you mean "four_obstacles"?'),
    ("folder", lambda path: path.mkdir(), "cannot be read: Is a directory"),
    ("binary.toml", lambda path: path.write_bytes(b"title = '\xff'"), "is not TOML: not UTF-8 at byte 9"),
    ("empty.toml", lambda path: path.write_bytes(b""), "needle.curvature_radius_mm: is missing"),
    ("nul\0.toml", lambda _: None, "cannot be read: embedded null byte"),
]


@pytest.mark.parametrize(("name", "make", "expected"), UNREADABLE)
def test_unreadable_files_are_told(
    name: str, make: Callable[[Path], object], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    make(tmp_path / name)
    with pytest.raises(ScenarioError) as caught:
        Scenario.read(name)
    assert str(caught.value).startswith(f"{name}: ")
    assert expected in str(caught.value)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.data())
def test_damaged_text_gives_a_scenario_or_a_scenario_error(data: st.DataObject) -> None:
    text = Scenario.read(data.draw(st.sampled_from(shipped()))).to_toml()
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        length = data.draw(st.integers(0, 12))
        text = text[:start] + data.draw(st.text(max_size=6)) + text[start + length :]
    try:
        scenario = Scenario.from_toml(text)
    except ScenarioError as error:
        assert error.mistakes
    else:
        assert Scenario.from_toml(scenario.to_toml()) == scenario


ANY = st.recursive(
    st.one_of(
        st.sampled_from(["nan", "inf", "-inf", "true", "0", "-1", "1e308", "1979-05-27", '"nearest"', "[]", "{}"]),
        st.integers().map(str),
        st.floats(allow_nan=False, allow_infinity=False).map(repr),
    ),
    lambda values: st.lists(values, max_size=4).map(lambda entries: f"[{', '.join(entries)}]"),
    max_leaves=8,
)
LINES = [index for index, line in enumerate(TEXT.splitlines()) if " = " in line]


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(LINES), ANY), min_size=1, max_size=4))
@example([(LINES[0], "{}")])
def test_any_value_gives_a_scenario_or_a_scenario_error(changes: list[tuple[int, str]]) -> None:
    lines = TEXT.splitlines()
    for index, value in changes:
        lines[index] = f"{lines[index].split(' = ')[0]} = {value}"
    try:
        scenario = Scenario.from_toml("\n".join(lines))
    except ScenarioError as error:
        assert all(mistake.rule for mistake in error.mistakes)
    else:
        assert scenario.states > 0
