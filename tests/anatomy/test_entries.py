"""From a small volume to ranked entries, in Python and on the command line."""

import csv
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from needleplan.anatomy import PHANTOMS, Anatomy, AnatomyFile, grid_of, write_phantom
from needleplan.errors import ScenarioError
from needleplan.planning import EntryMap, rank_entries
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.cli.commands import needleplan, refused


@pytest.fixture(scope="module")
def entries() -> EntryMap:
    return rank_entries(anatomy(box()), threads=1)


@pytest.mark.slow
def test_the_best_entries_reach_the_target_by_short_ways(entries: EntryMap) -> None:
    best = [entries.entry(number) for number in entries.best(3)]
    assert best[0].success.value > 0.8
    assert all(each.reached for each in best)
    expected = [round(each.expected_success, 3) for each in best]
    assert expected == sorted(expected, reverse=True)
    exact = [entries.estimate(number).shown for number in entries.best(3, exact=True)]
    assert exact == sorted(exact, reverse=True)
    for each in best:
        assert 40 < each.length_mm < 60
        assert each.clearance_mm > 0
        assert each.direction[2] > 0.9
        assert 12 <= each.position_mm[0] <= 27
        assert 0 <= each.tilt_cost <= 1
        assert 0 <= each.shift_cost <= 1
    first, second = (np.array(each.position_mm) for each in best[:2])
    assert np.linalg.norm(first - second) >= 6


def test_the_ranking_is_that_of_all_expected_successes(entries: EntryMap) -> None:
    every = {number: entries.expected_success(number) for number in range(len(entries.success))}
    assert all(0 <= expected <= entries.success[number] for number, expected in every.items())
    candidates = entries.ranking.candidates(5)
    assert round(every[candidates[0]], 3) == round(max(every.values()), 3)
    assert set(entries.best(5)) == set(candidates)
    # Half of the weight of both errors is on the entry itself, the other half on rings around it.
    number = entries.best(1)[0]
    entry = entries.entry(number)
    assert entry.success.value - entry.expected_success <= (entry.shift_cost + entry.tilt_cost) / 2 + 1e-9


def test_prediction_and_executions_agree(entries: EntryMap) -> None:
    number = entries.best(1)[0]
    assert entries.realised(number, 600) == pytest.approx(entries.success[number], abs=0.12)


def test_paths_without_noise_end_in_the_target(entries: EntryMap) -> None:
    number = entries.best(1)[0]
    labels, volume = box(), anatomy(box()).volume
    path = entries.path_mm(number)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=-1)
    assert steps.sum() == pytest.approx(entries.paths.length_mm[number], rel=1e-3)
    assert steps.max() <= 1.0 + 1e-9
    assert np.linalg.norm(volume.voxels(path[-1]) - [9.5, 9.5, 25.5]) < 6
    assert 4 not in labels[tuple(np.round(volume.voxels(path)).astype(int).T)]


def test_a_wall_with_a_hole_is_not_called_impossible() -> None:
    labels = box(wall=True)
    labels[8:12, 8:12, 18:21] = 1
    found = rank_entries(anatomy(labels), threads=1)
    assert found.reachable
    assert not found.impossible


def test_a_needle_that_cannot_turn_finds_no_path_around_a_plate() -> None:
    labels = box()
    labels[3:17, 3:17, 12:16] = 4
    fine = TEXT.replace("spacing_mm = 4.0", "spacing_mm = 2.0")
    stiff = rank_entries(anatomy(labels, fine.replace("radius_mm = 60.0", "radius_mm = 2000.0")), threads=1)
    assert not stiff.reachable
    assert stiff.impossible
    supple = rank_entries(anatomy(labels, fine.replace("radius_mm = 60.0", "radius_mm = 20.0")), threads=1)
    assert not supple.impossible


def test_a_wall_makes_it_impossible(tmp_path: Path) -> None:
    found = rank_entries(anatomy(box(wall=True)), threads=1)
    assert found.impossible
    assert not found.reachable
    done = needleplan("entry", write(tmp_path, box(wall=True)), "--json", "--transform", tmp_path / "best.tfm")
    assert not (tmp_path / "best.tfm").exists()
    assert "best.tfm: no entry reaches the target" in done.stderr
    assert done.returncode == 1
    assert json.loads(done.stdout)["answer"] == "impossible"
    assert "impossible: no path leads from the entry region" in done.stderr
    assert "degrees of the axis" in done.stderr


@pytest.mark.study
def test_the_command_prints_writes_and_draws(tmp_path: Path) -> None:
    file = write(tmp_path, box())
    done = needleplan("entry", file, "--top", 2, "-o", tmp_path / "map.csv", "--figure", tmp_path / "map.png")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("A box (invented)\n")
    assert "of 1,000 executions with noise" in done.stdout
    rows = list(csv.DictReader((tmp_path / "map.csv").read_text().splitlines()))
    assert [row["rank"] for row in rows[:3]] == ["1", "2", ""]
    others = [float(row["table_success"]) for row in rows[2:]]
    assert all(second <= first + 0.0011 for first, second in itertools.pairwise(others))
    assert (tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"
    answer = json.loads(needleplan("entry", file, "--top", 2, "--json").stdout)
    assert answer["answer"] == "possible"
    assert len(answer["entries"]) == 2
    assert [entry["position_mm"] for entry in answer["entries"]] == [
        pytest.approx([float(row[f"{axis}_mm"]) for axis in "ras"], abs=1e-3) for row in rows[:2]
    ]
    assert len(rows) == answer["entry_points"]


@pytest.mark.slow
def test_exports_are_read_by_others(tmp_path: Path, entries: EntryMap) -> None:
    file, markups, success = write(tmp_path, box()), tmp_path / "a.mrk.json", tmp_path / "a.nii.gz"
    done = needleplan("entry", file, "--top", 2, "--markups", markups, "--success", success)
    assert done.returncode == 0, done.stderr
    points, *curves = json.loads(markups.read_text())["markups"]
    assert (points["type"], points["coordinateSystem"], len(curves)) == ("Fiducial", "RAS", 2)
    best = entries.entry(entries.best(2)[0])
    np.testing.assert_allclose(points["controlPoints"][0]["position"], best.position_mm, atol=1e-6)
    np.testing.assert_allclose(curves[0]["controlPoints"][0]["position"], best.position_mm, atol=1e-6)
    end = curves[0]["controlPoints"][-1]["position"]
    image = SimpleITK.ReadImage(str(success))
    lps = [(-x, -y, z) for x, y, z in (best.position_mm, end)]
    assert image[image.TransformPhysicalPointToIndex(lps[0])] == pytest.approx(best.success.value, abs=0.1)
    assert image[image.TransformPhysicalPointToIndex(lps[1])] == 1
    assert image.GetSpacing() == pytest.approx((4.0, 4.0, 4.0))
    assert image.GetMetaData("descrip") == (
        "success by the table; at entries by executions where known and 3 points off"
    )
    values = [
        image[image.TransformPhysicalPointToIndex((-x, -y, z))]
        for x, y, z in entries.grid.frame.world(entries.poses[:, :3])
    ]
    assert values == pytest.approx(entries.success.tolist(), abs=1e-6)
    assert needleplan("entry", file, "--success", tmp_path / "a.csv").returncode == 2


def test_without_the_libraries_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write(tmp_path, box())
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    for command in (("entry", file), ("new", tmp_path / "x", "--anatomy", "liver")):
        done = needleplan(*command)
        assert done.returncode == 2
        assert "pip install needleplan[volumes]" in done.stderr


@pytest.mark.parametrize("count", [0, -2])
def test_a_list_has_an_entry(tmp_path: Path, count: int) -> None:
    refused(needleplan("entry", write(tmp_path, box()), f"--top={count}"), f"--top = {count}: must be a whole number")


@pytest.mark.parametrize(
    ("option", "value"), [("--edge", "top"), ("--edge", "left"), ("--at", "3"), ("--needle", "needle.toml")]
)
def test_options_of_tables_are_refused(tmp_path: Path, option: str, value: str) -> None:
    done = needleplan("entry", write(tmp_path, box()), option, value)
    assert done.returncode == 2
    assert f"{option} = " in done.stderr


def test_a_curvature_by_label_is_used() -> None:
    text = TEXT.replace("[needle]", '[[anatomy.curvature]]\nlabel = "body"\nradius_mm = 30.0\n[needle]')
    grid = grid_of(anatomy(box(), text))
    assert grid.radii_mm == (60.0, 30.0)
    assert (grid.tissues[grid.codes == 0] == 1).any()
    assert (grid.tissues[grid.codes == 1] == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", PHANTOMS)
def test_phantoms_are_small_and_can_be_planned_in(name: str, tmp_path: Path) -> None:
    file = write_phantom(name, tmp_path / "a", 3)
    assert all(each.stat().st_size < 300_000 for each in file.parent.iterdir())
    read = Anatomy.read(file)
    assert "invented" in read.file.title
    grid = grid_of(read)
    assert len(grid.entry_points_mm()) > 50
    assert (grid.codes == 1).any()
    assert (grid.codes == 2).any()


def test_the_seed_decides_all(tmp_path: Path) -> None:
    first, same, other = (write_phantom("prostate", tmp_path / f"{at}", seed) for at, seed in enumerate((3, 3, 4)))
    for each in sorted(first.parent.iterdir()):
        assert each.read_bytes() == (same.parent / each.name).read_bytes()
    name = "prostate.nii.gz"
    assert (first.parent / name).read_bytes() != (other.parent / name).read_bytes()


def test_new_writes_a_folder_and_never_overwrites(tmp_path: Path) -> None:
    folder = tmp_path / "phantom"
    assert needleplan("new", folder, "--anatomy", "prostate", "--seed", 1).returncode == 0
    assert {each.name for each in folder.iterdir()} == {"prostate.nii.gz", "labels.ctbl", "anatomy.toml"}
    done = needleplan("new", folder, "--anatomy", "prostate")
    assert done.returncode == 2
    assert "--force overwrites" in done.stderr
    assert needleplan("new", tmp_path / "x", "--anatomy", "liver", "--svg", "a.svg").returncode == 2
    assert needleplan("new", tmp_path / "x", "--seed", 3).returncode == 2


SIDES = """[[anatomy.entries]]
name = "left side"
region = { center_mm = [15.0, 20.0, 4.0], radius_mm = 4.0 }
[[anatomy.entries]]
name = "front"
region = { center_mm = [25.0, 24.0, 4.0], radius_mm = 4.0 }
[needle]"""


def test_several_entry_regions_have_names(tmp_path: Path) -> None:
    text = TEXT.replace('entry = "entry"\n', "").replace("[needle]", SIDES)
    done = needleplan("entry", write(tmp_path, box(), text), "--top", 3, "--json")
    entries = json.loads(done.stdout)["entries"]
    assert {each["entry_region"] for each in entries} == {"left side", "front"}
    for each in entries:
        nearer = np.linalg.norm(np.array([[15.0, 20.0, 4.0], [25.0, 24.0, 4.0]]) - each["position_mm"], axis=1).argmin()
        assert each["entry_region"] == ("left side", "front")[nearer]
    assert AnatomyFile.from_toml(AnatomyFile.from_toml(text).to_toml()) == AnatomyFile.from_toml(text)
    for wrong, says in (
        (TEXT.replace("[needle]", SIDES), "anatomy.entry is given, too"),
        (TEXT.replace('entry = "entry"\n', ""), "anatomy.entry: is missing"),
        (text.replace("front", "left side"), "names must differ"),
        (text.replace("25.0, 24.0, 4.0", "125.0, 24.0, 4.0"), r'entries 2 \("front"\)'),
    ):
        with pytest.raises(ScenarioError, match=says):
            Anatomy.read(write(tmp_path, box(), wrong))
