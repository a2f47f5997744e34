"""Identified models on the command line: into a plan, and into a scenario."""

import json
import math
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.cli import main
from needleplan.models import Bicycle, Estimate, ModelFile, Parent
from needleplan.recording import write_records
from needleplan.scenario import Needle, Scenario
from tests.conftest import SMALL
from tests.identification.test_scenario_part import insertions

TISSUE = '[[tissue]]\nname = "tumour"\npolygon_mm = [[40, 10], [55, 10], [50, 35]]\ncurvature_radius_mm = 70\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scenario of a layer and a tissue, and the models of a needle and of a straight path."""
    monkeypatch.chdir(tmp_path)
    layer = "[[needle.layer]]\nfrom_mm = 20\ncurvature_radius_mm = 30\n"
    Path("small.toml").write_text(SMALL.replace("[motion]", f"{layer}{TISSUE}[motion]"))
    for name, curvature, low, high in (("needle", 0.02, 0.0195, 0.021), ("straight", 0.001, -0.001, 0.003)):
        estimates = {"curvature_per_mm": Estimate(curvature, 0.001, low, high, "1/mm", low > 0)}
        ModelFile(Bicycle(curvature), estimates, (Parent("one", ""), Parent("two", ""))).write(f"{name}.toml")
    return tmp_path


def test_a_plan_takes_the_needle_and_a_tissue_from_models(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["plan", "small.toml", "--needle", "needle.toml", "--tissue", "tumour=needle.toml", "-o", "table.h5"]
    assert main(arguments) == 0
    said = capsys.readouterr()
    words = "radius 50 mm (95 % interval 47.62 to 51.28), bicycle identified from 2 trials"
    assert f"needle: {words}, needle.toml; it replaces 1 layer too" in said.err
    assert f"tissue tumour: {words}, needle.toml\n" in said.err
    scenario = npl.PolicyTable.read(folder / "table.h5").scenario
    assert scenario.needle == Needle(50.0)
    assert scenario.tissues[0].curvature_radius_mm == 50.0
    assert main(arguments) == 2
    assert "table.h5: exists already; --force overwrites it" in capsys.readouterr().err
    assert main([*arguments, "--force", "--verbose"]) == 0
    assert f"  needle       {words}" in capsys.readouterr().out
    assert main([*arguments, "--force", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["scenario_digest"] == scenario.digest
    needle, tissue = answer["identified"]
    assert (needle["place"], tissue["place"], needle["radius_mm"]) == ("needle", "tissue tumour", 50.0)
    assert needle["interval_mm"] == pytest.approx([1 / 0.021, 1 / 0.0195])
    assert needle["digest"] == ModelFile.read("needle.toml").digest


def test_a_needle_with_an_entry_pose_says_where_the_guide_is(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    estimates = {
        "curvature_per_mm": Estimate(0.02, 0.001, 0.0195, 0.021, "1/mm", True),
        "heading_rad": Estimate(0.06, 0.01, 0.04, 0.08, "rad", True, 0.02),
        "offset_mm": Estimate(0.5, 0.1, 0.3, 0.7, "mm", True, 0.2),
    }
    ModelFile(Bicycle(0.02, 0.06, 0.5), estimates).write(folder / "entered.toml")
    assert main(["plan", "small.toml", "--needle", "entered.toml", "-o", "entered.h5", "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)
    assert main(["entry", "entered.h5", "--needle", "entered.toml", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    guide = answer["guide"]
    assert planned["guide"] == guide
    assert guide["heading_rad"] == pytest.approx(answer["heading_rad"] - 0.06 * answer["bevel"], abs=1e-9)
    apart = math.hypot(guide["x_mm"] - answer["x_mm"], guide["y_mm"] - answer["y_mm"])
    assert apart == pytest.approx(0.5)
    assert main(["entry", "entered.h5", "--needle", "needle.toml"]) == 0
    assert "success" in capsys.readouterr().out


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--needle", "none.toml"], "none.toml: cannot be read"),
        (["--needle", "small.toml"], "small.toml: "),
        (["--needle", "straight.toml"], "straight.toml: parameters.curvature_per_mm = -0.001 to 0.003: is not"),
        (["--tissue", "needle.toml"], "--tissue = needle.toml: must be NAME=MODEL.toml"),
        (["--tissue", "tumor=needle.toml"], 'small.toml: tissue = "tumor": there is no [[tissue]] of that name'),
    ],
)  # fmt: skip
def test_a_model_that_gives_no_radius_is_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", "small.toml", *arguments]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_insertions_become_a_scenario(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_records(
        [each.with_column("depth_mm", each["x_mm"]) for each in insertions(3, deep_mm=100.0)], folder / "trials.csv"
    )
    arguments = ["identify", "curvature", "trials.csv", "--scenario", "small.toml", "--layers", "2"]
    assert main([*arguments, "--scenario-out", "new.toml"]) == 0
    said = capsys.readouterr().out
    new = Scenario.read("new.toml")
    assert len(new.needle.layers) == 1
    assert new.motion.tip_noise != Scenario.read("small.toml").motion.tip_noise
    tables = said[said.index("[needle]") :].split("\n\n")
    assert [table.splitlines()[0] for table in tables] == ["[needle]", "[[needle.layer]]", "[motion]"]
    assert all(table.strip() in new.to_toml() for table in tables)
    assert "  tip noise: the heading scatters by" in said
    assert main([*arguments, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)["scenario"]
    assert answer["tip_noise"] == list(new.motion.tip_noise)
    assert answer["digest"] == new.digest
    assert answer["pieces"][1]["low_mm"] == new.needle.layers[0].from_mm


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["force", "x.csv", "--layers", "2"], "--layers = force: is for curvature only"),
        (["curvature", "x.csv", "--scenario-out", "y.toml"], "--scenario: is missing"),
        (["force", "x.csv", "--scenario", "small.toml"], "--scenario = force: must be curvature"),
        (["curvature", "x.csv", "--scenario", "smal.toml"], "smal.toml: no such file"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", *arguments]) == 2
    assert message in capsys.readouterr().err
