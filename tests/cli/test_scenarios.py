"""The commands `scenarios` and `new`."""

import json
import re
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.scenario import Needle, Obstacle, Target, Workspace, shipped
from tests.cli.commands import needleplan, refused
from tests.conftest import SMALL


def test_scenarios_are_listed() -> None:
    listed = json.loads(needleplan("scenarios", "--json").stdout)
    assert [each["name"] for each in listed] == shipped()
    for each in listed:
        scenario = npl.Scenario.read(each["name"])
        assert (each["title"], each["states"]) == (scenario.title, scenario.states)
        assert each["size_mm"] == [scenario.workspace.width_mm, scenario.workspace.height_mm]
    lines = needleplan("scenarios").stdout.splitlines()
    assert len(lines) == len(listed)
    assert re.fullmatch(r"four_obstacles +120 x 80 mm +1,176,120 states +Four obstacles", lines[1])


@pytest.mark.parametrize("source", shipped())
def test_a_new_scenario_is_one_that_can_be_planned(source: str, tmp_path: Path) -> None:
    done = needleplan("new", 'mine "2"', "--from", source, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "")
    text = (tmp_path / 'mine "2".toml').read_text()
    assert text.startswith("#")
    assert text.count("#") > 10
    new, old = npl.Scenario.from_toml(text), npl.Scenario.read(source)
    assert new.title == 'mine "2"'
    assert new.to_toml().split("\n", 2)[2] == old.to_toml().split("\n", 2)[2]


def test_new_scenarios_that_cannot_be(tmp_path: Path) -> None:
    seed = ("--anatomy", "prostate", "--seed", "-1")
    refused(needleplan("new", "p", *seed, cwd=tmp_path), "seed = -1: must be a whole number from 0")
    refused(needleplan("new", "s", "--from", "", cwd=tmp_path), "path = '': must be the path of a file")
    assert not any(tmp_path.iterdir())
    refused(needleplan("new", "mine", "--from", "brian", cwd=tmp_path), 'did you mean "brain"')
    refused(needleplan("new", "a/b", cwd=tmp_path), "a/b.toml: cannot be written: no such folder")
    refused(needleplan("new", ".toml", cwd=tmp_path), "must be the name of a file")
    (tmp_path / "own.toml").write_text(SMALL)
    refused(needleplan("new", "own", "--from", "own.toml", "--force", cwd=tmp_path), "it would replace own.toml")
    assert list(tmp_path.iterdir()) == [tmp_path / "own.toml"]


DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="12cm" height="80mm" viewBox="0 0 1200 800">
<rect id="vessel" x="300" y="500" width="100" height="300"/><circle id="target" cx="1000" cy="350" r="20"/></svg>"""


def test_a_drawing_becomes_a_commented_scenario(tmp_path: Path) -> None:
    (tmp_path / "scene.svg").write_text(DRAWING)
    done = needleplan("new", "mine", "--svg", "scene.svg", "--from", "layered", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "")
    text = (tmp_path / "mine.toml").read_text()
    assert text.startswith("# A scenario for needleplan, made from scene.svg and layered.")
    assert text.count("#") > 10
    new, old = npl.Scenario.from_toml(text), npl.Scenario.read("layered")
    assert new.workspace == Workspace(120, 80)
    assert new.target == Target((100, 45), 2)
    assert new.obstacles == (Obstacle([[30, 30], [40, 30], [40, 0], [30, 0]], "vessel"),)
    assert (new.title, new.tissues, new.needle) == ("mine", (), Needle(old.needle.curvature_radius_mm))
    assert (new.motion, new.grid, new.objective) == (old.motion, old.grid, old.objective)
    assert needleplan("new", "half", "--svg", "scene.svg", "--mm-per-unit", "0.05", cwd=tmp_path).returncode == 0
    assert npl.Scenario.read(tmp_path / "half.toml").workspace == Workspace(60, 40)


@pytest.mark.parametrize(
    ("drawing", "options", "message"),
    [
        (None, (), "scene.svg: cannot be read: No such file or directory"),
        ("<svg", (), "scene.svg: is not an SVG file"),
        (DRAWING.replace("target", "tumour"), (), "scene.svg: target: is missing: name a circle"),
        (DRAWING.replace("80mm", "80"), (), "mm_per_unit: is missing: the drawing does not state its height in mm"),
        (DRAWING.replace("12cm", "90mm"), (), "width and height of the drawing state different scales, 0.075 and 0.1"),
        (DRAWING, ("--mm-per-unit", "-1"), "scene.svg: mm_per_unit = -1.0: must be a positive number"),
        (DRAWING.replace("1000", "350").replace('"350" r', '"600" r'), (), "scene.svg: target.center_mm"),
    ],
)
def test_drawings_that_are_refused(drawing: str | None, options: tuple[str, ...], message: str, tmp_path: Path) -> None:
    if drawing:
        (tmp_path / "scene.svg").write_text(drawing)
    done = needleplan("new", "mine", "--svg", "scene.svg", *options, cwd=tmp_path)
    refused(done, message)
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "mine.toml").exists()


def test_options_of_drawings_that_are_refused(tmp_path: Path) -> None:
    refused(needleplan("new", "mine", "--mm-per-unit", "2", cwd=tmp_path), "must not be given without --svg")
    (tmp_path / "scene.svg").write_text(DRAWING)
    done = needleplan("new", "mine", "-o", "scene.svg", "--svg", "scene.svg", "--force", cwd=tmp_path)
    refused(done, "it would replace scene.svg")
    assert (tmp_path / "scene.svg").read_text() == DRAWING
