"""An entry has one success: list, JSON, CSV, VTP, markups and `plan` print the same, and the list is ordered by it."""

import csv
import json
import re
from pathlib import Path

import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy

from needleplan import planning
from needleplan.anatomy import Anatomy, write_phantom
from tests.anatomy.test_vtp import polydata
from tests.anatomy.volumes import box, write
from tests.cli.commands import needleplan

# A row of the list: rank, three numbers on the success with their interval, then clearance, length, rotations, losses.
ROW = re.compile(
    r"\s+(\d+) {2,}([\d.]+) % {2,}([\d.]+) % {2,}([\d.]+) % - +([\d.]+) % {2,}([\d.]+) mm {2,}(\d+) mm {2,}(\d+) {2,}"
    r"([\d.]+) {2,}([\d.]+) {2,}"
)
# Whether a larger number in a column is better: expected, success, both ends, clearance, length, rotations, losses.
IS_BETTER = (True, True, True, True, True, False, False, False, False)


def rows_of(text: str) -> list[tuple[float, ...]]:
    """Return the numbers of a printed list, best first; its ranks must be 1, 2 ..."""
    found = [match.groups() for line in text.splitlines() if (match := ROW.match(line))]
    assert [int(each[0]) for each in found] == list(range(1, len(found) + 1))
    return [tuple(map(float, each[1:])) for each in found]


def beats(lower: tuple[float, ...], higher: tuple[float, ...]) -> bool:
    """Return whether a row is better than another in every column."""
    return all(a > b if more else a < b for a, b, more in zip(lower, higher, IS_BETTER, strict=True))


def shown(number: object) -> float:
    return float(f"{100 * float(str(number)):.1f}")


def check(scene: Path, folder: Path, top: int) -> tuple[float, ...]:
    """Assert that all outputs of `entry` agree and the list is in the order of what it shows; return its first row."""
    folder.mkdir()
    files = {name: folder / name for name in ("map.csv", "map.vtp", "map.mrk.json")}
    options = ("-o", files["map.csv"], "--vtp", files["map.vtp"], "--markups", files["map.mrk.json"], "--top", top)
    listed = needleplan("entry", scene, *options)
    assert listed.returncode == 0, listed.stderr
    rows = rows_of(listed.stdout)
    assert len(rows) == top
    for place, row in enumerate(rows):
        assert not any(beats(lower, row) for lower in rows[place + 1 :])
    assert rows == sorted(rows, key=lambda row: tuple(-each for each in row[:4]))
    entries = json.loads(needleplan("entry", scene, "--top", top, "--json").stdout)["entries"]
    table = list(csv.DictReader(files["map.csv"].read_text().splitlines()))
    of_lines = polydata(files["map.vtp"]).GetCellData()
    arrays = {name: vtk_to_numpy(of_lines.GetArray(name)) for name in
              ("success", "success_low", "success_high", "success_runs", "execution", "rank")}  # fmt: skip
    labels = json.loads(files["map.mrk.json"].read_text())["markups"][0]["controlPoints"]
    for place, (row, entry, line) in enumerate(zip(rows, entries, table, strict=False)):
        assert (line["rank"], line["success_source"], line["success_runs"]) == (f"{place + 1}", "executions", "2000")
        assert (entry["success_source"], entry["success_runs"]) == ("executions", 2000)
        expected, success, low, high = row[:4]
        assert shown(entry["expected_success"]) == expected
        here = (arrays["rank"] == place + 1) & ((arrays["execution"] == 0) | (place == 0))
        assert here.sum() == (41 if place == 0 else 1)
        for names, value in (
            ((entry["success"], line["success"], *arrays["success"][here]), success),
            ((entry["success_interval"][0], line["success_low"], *arrays["success_low"][here]), low),
            ((entry["success_interval"][1], line["success_high"], *arrays["success_high"][here]), high),
        ):
            assert {shown(each) for each in names} == {value}
        assert labels[place]["label"] == f"entry {place + 1}: {success} %"
        assert labels[place]["description"].endswith("by 2,000 executions")
    assert all(line["success_source"] in ("table", "executions") for line in table)
    for line in table:
        assert (line["success_source"] == "table") == (line["success_low"] == "")
    return rows[0]


@pytest.mark.slow
def test_all_outputs_of_a_box_agree(tmp_path: Path) -> None:
    scene = write(tmp_path, box())
    _, success, low, high, *_ = check(scene, tmp_path / "files", 3)
    planned = needleplan("plan", scene)
    assert f"success      {success} %, 95 % interval {low} to {high} %, by 2,000 executions\n" in planned.stdout


@pytest.mark.study
@pytest.mark.parametrize(("kind", "seed"), [("prostate", 3)])
def test_all_outputs_of_a_phantom_agree(kind: str, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = write_phantom(kind, tmp_path / "phantom", seed)
    entries = planning.rank_entries(Anatomy.read(scene))
    monkeypatch.setattr(planning, "rank_entries", lambda _: entries)  # text and JSON share the estimates
    check(scene, tmp_path / "files", 5)


@pytest.mark.slow
def test_the_exact_list_is_ordered_by_success_alone(tmp_path: Path) -> None:
    done = needleplan("entry", write(tmp_path, box()), "--exact-entry", "--top", 5)
    rows = rows_of(re.sub(r"(?m)^( +\d+ +)(.* - +[\d.]+ %)( +[\d.]+ %)", r"\1\3  \2", done.stdout))
    successes = [row[1] for row in rows]
    assert len(rows) >= 2
    assert successes == sorted(successes, reverse=True)
