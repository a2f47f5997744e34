"""A diagnosis is read for the page: what is damaged or missing is one message, and the rest is shown."""

import copy
import json
import random
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import needleplan as npl
from needleplan.artifacts import digest
from needleplan.errors import DataError
from needleplan.page import DiagnosisFile, DiagnosisPage, is_diagnosis
from needleplan.page._diagnosis_file import _document
from needleplan.reports.diagnosis import traces_of
from tests.diagnosis.trials import BASE
from tests.page.diagnosed import GIVEN, ODD, found, written

JUNK: list[Any] = [None, 3, -1.5, "x", "\0", [], {}, [1], {"a": 1}, True, float("inf"), [[[]]], 10**300]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("diagnosed"))


@pytest.fixture
def folder(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "found"))


def message(page: DiagnosisPage) -> dict[str, Any]:
    """Return the header of the message on the diagnosis."""
    body = page.diagnosis({})
    told: dict[str, Any] = json.loads(body[4 : 4 + int.from_bytes(body[:4], "little")])
    return told


def changed(folder: Path, **keys: object) -> Path:
    """Write other values into the document."""
    file = folder / "diagnosis.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | keys))
    return folder


@pytest.mark.study
def test_the_curves_are_those_of_the_diagnosis(folder: Path) -> None:
    opened = DiagnosisFile.read(folder)
    assert opened.problem == ""
    traces = traces_of(found())
    assert len(opened.curves) == len(traces) == 3
    for curves, trace in zip(opened.curves, traces, strict=True):
        np.testing.assert_array_equal(curves.time_s, trace.motion.time_s)
        assert curves.after is not None
        assert trace.after is not None
        np.testing.assert_allclose(curves.measured, trace.measured, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(curves.before, trace.before, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(curves.after, trace.after, rtol=1e-6, atol=1e-7)
    told = message(DiagnosisPage(opened))
    assert [each["role"] for each in told["trials"]] == ["train", "train", "holdout"]
    assert told["trials"][0]["trial"] == ODD
    assert told["trials"][2]["after_rms"] < told["trials"][2]["before_rms"]
    assert told["verdict"] == "named"
    assert told["effects"][0]["parameters"][0]["low"] < 1.5e-4 < told["effects"][0]["parameters"][0]["high"]
    assert told["hypotheses"][0]["words"] == "viscous"
    assert all(each["because"] for each in told["hypotheses"])


@pytest.mark.slow
def test_the_object_and_the_folder_show_the_same(folder: Path) -> None:
    view = npl.view(found())
    assert view.title == "Diagnosis: missing effect: viscous friction"
    other = npl.view(folder)
    (one,), (two,) = (each.html.split(b'"/api/diagnosis": ')[1:] for each in (view, other))
    assert one.split(b'"')[1] == two.split(b'"')[1]
    with pytest.raises(npl.InputError, match="must not be given with a diagnosis"):
        npl.view(found(), (0, 0, 0))


def test_the_given_model_stands_beside_the_data(folder: Path) -> None:
    told = message(DiagnosisPage(DiagnosisFile.read(folder)))
    given = told["given"]
    rows = {each["name"]: each for each in given["parameters"]}
    friction, estimate = rows.pop("friction"), found().estimates()["friction"]
    assert (friction["given"], friction["departs"]) == (GIVEN.friction, True)
    assert (friction["file_low"], friction["file_high"]) == (BASE.friction / 2 - 2e-9, BASE.friction / 2 + 2e-9)
    assert (friction["value"], friction["low"], friction["high"]) == (estimate.value, estimate.low, estimate.high)
    assert [each["name"] for each in given["stages"]] == ["given", "parameters", "effects", "laws"]
    assert rows
    assert {each["file_low"] for each in rows.values()} == {None}
    assert any("outside the interval of the model file" in each for each in told["sentences"])


def test_missing_changed_and_foreign_curves_are_a_message(folder: Path) -> None:
    file = folder / "traces.h5"
    content = file.read_bytes()
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert "belongs to another diagnosis, or has changed since" in DiagnosisFile.read(folder).problem
    file.unlink()
    opened = DiagnosisFile.read(folder / "diagnosis.json")
    assert opened.problem.startswith("No curves are shown: traces.h5 is missing. Run `needleplan diagnose` again")
    told = message(DiagnosisPage(opened))
    assert told["problem"] == opened.problem
    assert told["trials"][0]["before_rms"] is None


def test_curves_of_another_file_or_of_other_lengths_are_refused(folder: Path, tmp_path: Path) -> None:
    with h5py.File(folder / "traces.h5", "a") as file:
        del file["trial 0"]["depth_mm"]
        file["trial 0"]["depth_mm"] = np.zeros(3)
    changed(folder, traces={"digest": digest((folder / "traces.h5").read_bytes())})
    assert "different lengths" in DiagnosisFile.read(folder).problem
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = np.zeros(3)
    with h5py.File(folder / "traces.h5", "a") as file:
        del file["trial 0"]["depth_mm"]
        file["trial 0"]["depth_mm"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "x")
    changed(folder, traces={"digest": digest((folder / "traces.h5").read_bytes())})
    opened = DiagnosisFile.read(folder)
    assert not opened.curves
    assert opened.problem.startswith("No curves are shown: traces.h5 is not as")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is damaged: it is not JSON"),
        ("[" * 100_000, "is damaged: it is not JSON"),
        ("[]", "schema = null: must be"),
        ('{"schema": "needleplan.diagnosis/3"}', '"needleplan.diagnosis/3": must be "needleplan.diagnosis/2"'),
        ('{"schema": "needleplan.diagnosis/2"}', "trials = null: must be a list"),
        (
            '{"schema": "needleplan.diagnosis/1"}',
            '"needleplan.diagnosis/1": must be "needleplan.diagnosis/2": diagnose',
        ),
    ],
)
def test_a_damaged_document_is_refused(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "diagnosis.json").write_text(text)
    with pytest.raises(DataError, match=r"diagnosis\.json") as refused:
        DiagnosisFile.read(tmp_path)
    assert says in str(refused.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("trials", []), ("trials", [3]), ("trials", [{"trial": "a"}]), ("effects", [{}]), ("noise", {"rms": "high"}),
        ("hypotheses", [7]), ("hypotheses", [{"words": "a"}]), ("where", [{"p_value": "x"}]), ("held_out", [1]),
        ("next_motion", {"name": "a"}), ("source", {"model": 3}), ("settings", {}),
        ("words", {"answer": 3}), ("hypotheses", [{"words": "", "probability": None, "because": ""}]),
        ("noise", {"rms": True}),
    ],
)  # fmt: skip
def test_a_document_with_a_wrong_value_is_refused(folder: Path, key: str, value: object) -> None:
    with pytest.raises(DataError):
        DiagnosisPage(DiagnosisFile.read(changed(folder, **{key: value})))


@pytest.mark.slow
def test_any_change_of_the_document_is_shown_or_refused(folder: Path) -> None:
    file = folder / "diagnosis.json"
    document, content = json.loads(file.read_text()), (folder / "traces.h5").read_bytes()
    places = [place for place in places_in(document) if place]
    draw = random.Random(0)
    seen = {"shown": 0, "refused": 0}
    for _ in range(200):
        changed_ = copy.deepcopy(document)
        *way, last = draw.choice(places)[: draw.randint(1, 5)]
        inner = changed_
        for key in way:
            inner = inner[key]
        inner[last] = copy.deepcopy(draw.choice(JUNK))
        file.write_text(json.dumps(changed_))
        try:
            page = DiagnosisPage(DiagnosisFile.read(file) if draw.random() < 0.02 else opened_as(file, content))
        except DataError:
            seen["refused"] += 1
        else:
            assert json.dumps(message(page))
            seen["shown"] += 1
    assert min(seen.values()) > 20


def opened_as(file: Path, content: bytes) -> DiagnosisFile:
    """Read a document with known curves, without the child process that tries the file of curves."""
    return DiagnosisFile.of(_document(file), content, str(file))


def places_in(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the keys that lead to every value within a document."""
    yield place
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places_in(value[key], (*place, key))


def test_folders_without_a_diagnosis_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"holds no diagnosis\.json: give the folder that"):
        DiagnosisFile.read(tmp_path)


def test_a_folder_named_as_a_scenario_hides_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "layered").mkdir()
    assert npl.Scenario.read("layered").title
    assert not is_diagnosis("layered")
    assert is_diagnosis(str(tmp_path))
    (tmp_path / "layered" / "diagnosis.json").write_text("{}")
    assert is_diagnosis("layered")


def test_code_repeats_every_option(folder: Path) -> None:
    source = json.loads((folder / "diagnosis.json").read_text())["source"] | {
        "data": ["a b.txt"], "holdout": ["c.txt"], "noise": ["d.txt"], "columns": ["time=t[ms],force=-Fz[mN]"],
        "surface_mm": 110.0, "rate_hz": 50.0, "accept_units": True, "effects": ["mine.py"],
    }  # fmt: skip
    page = DiagnosisPage(DiagnosisFile.read(changed(folder, source=source)))
    words = shlex.split(page.code({"language": "command"}).decode().splitlines()[0])
    from needleplan.cli.program import make_parser

    options = make_parser().parse_args(words[1:])
    assert (options.data, options.holdout, options.noise) == (["a b.txt"], ["c.txt"], ["d.txt"])
    assert (options.columns, options.surface, options.rate) == (["time=t[ms],force=-Fz[mN]"], 110.0, 50.0)
    assert (options.accept_units, options.effects) == (True, ["mine.py"])
    code = page.code({"language": "python"}).decode()
    compile(code, "code", "exec")
    for part in ("ColumnMap.parse(['time=t[ms],force=-Fz[mN]'], surface_mm=110.0)", "'c.txt': Role.HOLDOUT"):
        assert part in code
    with pytest.raises(npl.InputError, match="python or command"):
        page.code({"language": "rust"})
    unknown = DiagnosisPage(DiagnosisFile.read(changed(folder, source=None)))
    with pytest.raises(npl.InputError, match="does not say from which files"):
        unknown.code({"language": "python"})
