import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.models import ModelFile
from needleplan.recording import write_records
from needleplan.signals import Record
from tests.identification.arcs import arc, white


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three insertions on an arc of 1200 mm, with tracker noise."""
    random, trials = np.random.default_rng(0), []
    for name in ("one", "two", "three"):
        x, y = (arc() + white(random)).T
        columns = {"time_s": np.arange(320) / 40, "depth_mm": np.linspace(0, 80, 320), "x_mm": x, "y_mm": y}
        trials.append(Record(columns, name))
    path = tmp_path_factory.mktemp("data") / "arcs.csv"
    write_records(trials, path)
    return path


@pytest.mark.slow
def test_curvature_from_a_file_to_a_model(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, figure = tmp_path / "model.toml", tmp_path / "figure.png"
    assert main(["identify", "curvature", str(data), "-o", str(model), "--figure", str(figure), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    found = ModelFile.read(model)
    estimate = found.estimates["curvature_per_mm"]
    assert estimate.low < 1 / 1200 < estimate.high
    assert said["parameters"] == found.model.values()
    assert said["digest"] == found.digest
    assert (
        [each["trial"] for each in said["trials"]] == [each.name for each in found.parents] == ["one", "two", "three"]
    )
    assert {each.digest for each in found.parents} == {said["trials"][0]["digest"]}
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_table_says_what_was_found(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", "curvature", str(data)]) == 0
    short = capsys.readouterr().out.splitlines()
    assert main(["identify", "curvature", str(data), "--verbose"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "curvature: bicycle"
    predicted = next(number for number, line in enumerate(lines) if line.startswith("predicted tip"))
    assert short == [*lines[:4], f"  ... {predicted - 4} more lines with --verbose", *lines[predicted:]]
    assert "95 % region" in lines[predicted + 1]
    assert lines[predicted + 2].startswith("  order of the 3 insertions: no drift was found")
    assert lines[predicted + 3].startswith("  each insertion predicted from those before it: mean error 0.")
    assert any(line.startswith("  curvature_per_mm") and line.endswith("1/mm") for line in lines)
    assert any("agreement of trials" in line and "agree with one curvature" in line for line in lines)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["curvature", "nothing.csv"], "nothing.csv: cannot be read: No such file"),
        (["friction", "{data}"], "force_n: is missing, and is needed here"),
        (["curvature", "{metres}"], "in metres?"),
        (["curvature", "{data}", "-o", "no/such/folder.toml"], "no such folder"),
        (["curvature", "{data}", "-o", "{data}"], "it would replace"),
        (["curvature", "{data}", "-o", "same.png", "--figure", "./same.png"], "be written twice"),
        (
            ["curvature", "{data}", "--average", "3"],
            "--average: is for shaft-and-tip, force and tissue-motion, not for curvature",
        ),
        (["deflection", "{data}", "--geometry", "1,0.5"], "must be 4 numbers"),
        (["deflection", "{data}", "--geometry", "1,0.5,200,20,40"], "must be MM:RATIO"),
        (["deflection", "{data}", "--geometry", "1,0.5,200,20,400:2"], "stiffness_steps"),
        (["deflection", "{data}", "--geometry", "0.5,1,200,20"], "must be less than outer_diameter_mm"),
        (["deflection", "{data}", "--stiffness", "nan"], "must be a finite number"),
    ],
)
def test_wrong_input_is_exit_code_2(
    arguments: list[str], message: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    metres = tmp_path / "metres.csv"
    metres.write_text("time_s,depth_mm,y_mm\n0,0,0\n1,0.05,0.001\n")
    filled = [each.format(data=data, metres=metres) for each in arguments]
    assert main(["identify", *filled]) == 2
    assert message in capsys.readouterr().err


def test_data_are_not_overwritten(data: Path) -> None:
    before = data.read_bytes()
    main(["identify", "curvature", str(data), "--figure", str(data.parent / "." / data.name)])
    assert data.read_bytes() == before


@pytest.mark.slow
def test_what_is_known_reaches_the_identification(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    known = ["--geometry", "1.27,0.9,200,20,150:2", "--stiffness", "0.01", "--skip", "10"]
    assert main(["identify", "deflection", str(data), *known, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["parameters"]["stiffness"] == 0.01
    assert said["parameters"]["bevel"] == pytest.approx(np.radians(20))
    assert any("the first 10 mm" in each for each in said["remarks"])
    assert not any("no needle given" in each for each in said["remarks"])
