"""Several targets: what the file says, one lattice, the ranking of entries, and the order of the insertions."""

import csv
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from needleplan.anatomy import FREE, TARGET, AnatomyFile, SpaceScenario
from needleplan.errors import InputError, ScenarioError
from needleplan.planning import TargetMap, entry_map, plan, plan_space, rank_entries, rank_for_targets
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.cli.commands import needleplan

BALL = "{ center_mm = [16.0, 20.0, 50.0], radius_mm = 4.0 }"


def several(*targets: tuple[str, str]) -> str:
    """Return the text of an anatomy with targets: their names and regions."""
    listed = "".join(f'[[anatomy.targets]]\nname = "{name}"\nregion = {region}\n' for name, region in targets)
    return TEXT.replace('target = "target"\n', "").replace("[needle]", f"{listed}[needle]")


TWO = several(("lesion", '"target"'), ("core", BALL))


@pytest.fixture(scope="module")
def found() -> TargetMap:
    return rank_for_targets(anatomy(box(), TWO), threads=1)


def test_the_file_reads_back() -> None:
    file = AnatomyFile.from_toml(TWO)
    assert AnatomyFile.from_toml(file.to_toml()) == file
    assert [each.name for each in file.anatomy.targets] == ["lesion", "core"]


@pytest.mark.parametrize(
    ("text", "key", "rule"),
    [
        (several(("a", '"target"'), ("a", BALL)), "targets 2.name", "is the name of [[anatomy.targets]] 1 too"),
        (several(("a", BALL), ("b", BALL)), 'targets 2 ("b").region', "is the region of [[anatomy.targets]] 1"),
        (several(("a", '"target"'), ("b", "3")), 'targets 2 ("b").region', 'is the label of the target "a" too'),
        (several(("all", '"target"')), "targets 1.name", "is a word of `entry --rank`"),
        (several(("a\\nb", '"target"')), "targets 1.name", "must be one line of characters that can be printed"),
        (several(("a", "{ center_mm = [16.0, 20.0, 50.0] }")), 'targets 1 ("a").region.radius_mm', "is missing"),
        (
            several(("a", "{ center_mm = [90.0, 20.0, 50.0], radius_mm = 2.0 }")),
            'targets 1 ("a").region',
            "lies outside of the volume",
        ),
        (several(("a", '"nothing"')), 'targets 1 ("a").region', "nothing"),
        (several(*((f"{n}", BALL) for n in range(21))), "targets", "must be at most 20 tables"),
        (TWO.replace("entry =", 'target = "target"\nentry ='), "targets", "leave out one of them"),
        (several(), "target", "is missing"),
        (several(("a", '"vessel"')), 'targets 1 ("a").region', "all of its voxels belong to anatomy.obstacles"),
    ],
)
def test_mistakes_name_the_target(text: str, key: str, rule: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        anatomy(box(), text)
    assert f"anatomy.{key}" in str(raised.value)
    assert rule in str(raised.value)


def test_one_of_several_is_the_anatomy_with_this_target_alone() -> None:
    """A single entry of the list has the lattice and the table of `target`, bit for bit."""
    alone = SpaceScenario.of(anatomy(box()))
    listed = SpaceScenario.of_targets(anatomy(box(), several(("lesion", '"target"'))))["lesion"]
    assert np.array_equal(alone.grid.voxels, listed.grid.voxels)
    assert np.array_equal(alone.grid.possible, listed.grid.possible)
    tables = [plan_space(each, threads=1).solved for each in (alone, listed)]
    for name in ("values", "policy", "success"):
        assert np.array_equal(*(getattr(table, name) for table in tables))


def test_targets_share_the_lattice_and_the_entries(found: TargetMap) -> None:
    grids = [each.grid for each in found.maps.values()]
    assert grids[0].frame is grids[1].frame
    assert np.array_equal(found.maps["lesion"].poses[:, :3], found.maps["core"].poses[:, :3])
    blocked = [np.where(grid.voxels == TARGET, FREE, grid.voxels) for grid in grids]
    assert np.array_equal(*blocked)
    for grid in grids:
        assert grid.target.contains(grid.target_points_mm).mean() > 0.9
    with pytest.raises(ScenarioError, match="has several targets"):
        SpaceScenario.of(anatomy(box(), TWO))
    with pytest.raises(ScenarioError, match=r"target_name.*must be the name of a target: lesion, core"):
        plan(anatomy(box(), TWO), target_name="none")
    with pytest.raises(ScenarioError, match="is for an anatomy with several targets"):
        plan("four_obstacles", target_name="core")
    assert plan(anatomy(box(), TWO), target_name="core").digest == found.maps["core"].table.digest


def test_a_target_alone_has_the_success_of_its_own_table(found: TargetMap) -> None:
    scenario = SpaceScenario.of_targets(anatomy(box(), TWO))["core"]
    alone = entry_map(plan_space(scenario, threads=1), threads=1)
    assert np.array_equal(alone.success, found.maps["core"].success)
    assert scenario.title == "A box (invented): core"


@pytest.mark.parametrize("rank", ["expected", "all", "lesion", "core"])
def test_the_list_is_in_the_order_of_its_score(found: TargetMap, rank: str) -> None:
    ranked = found.best(3, rank=rank, exact=True)
    scores = [each.score for each in ranked]
    assert all(a > b - 0.001 for a, b in itertools.pairwise(scores))
    for each in ranked:
        chances = {name: one.success.value for name, one in each.targets.items()}
        assert each.expected_number == pytest.approx(sum(chances.values()))
        assert each.reached_all == pytest.approx(math.prod(chances.values()))
        assert each.expected_interval[0] <= each.expected_number <= each.expected_interval[1]
        assert each.all_interval[0] <= each.reached_all <= each.all_interval[1]
        expected = {"expected": each.expected_number, "all": each.reached_all} | chances
        assert each.score == pytest.approx(expected[rank])
    with_error = found.best(1, rank=rank)[0]
    assert with_error.score <= found.entry(with_error.number, rank=rank, exact=True).score


def test_no_other_order_reaches_more_before_a_failure(found: TargetMap) -> None:
    entry = found.best(1)[0]
    chances = [one.success.value for one in entry.targets.values()]
    sums = [np.cumprod(order).sum() for order in itertools.permutations(chances)]
    assert entry.expected_before_failure == pytest.approx(max(sums), abs=1e-3)


def test_an_unknown_rank_is_refused(found: TargetMap) -> None:
    with pytest.raises(InputError, match="must be expected, all or the name of a target: lesion, core"):
        found.scores("nothing")


def test_the_command_writes_a_row_and_a_curve_for_each_insertion(tmp_path: Path) -> None:
    scene, files = write(tmp_path, box(), TWO), [tmp_path / "map.csv", tmp_path / "map.mrk.json"]
    done = needleplan("entry", scene, "--top", 2, "-o", files[0], "--markups", files[1], "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    best = record["entries"][0]
    rows = list(csv.DictReader(files[0].read_text().splitlines()))
    assert len(rows) == 2 * record["entry_points"]
    assert [row["target"] for row in rows[:2]] == best["order"] == list(best["targets"])
    for row, name in zip(rows, best["order"], strict=False):
        assert float(row["success"]) == pytest.approx(best["targets"][name]["success"], rel=1e-5)
        assert (row["success_source"], row["success_runs"]) == ("executions", "1000")
    curves = [each["name"] for each in json.loads(files[1].read_text())["markups"] if each["type"] == "Curve"]
    assert curves[:2] == [f"path 1.{number} {name}" for number, name in enumerate(best["order"], start=1)]


def test_options_of_one_target_and_of_several_are_told_apart(tmp_path: Path) -> None:
    scene = write(tmp_path, box(), TWO)
    for arguments, text in (
        (("entry", scene, "--vtp", tmp_path / "map.vtp"), "holds for one target, and this anatomy has several"),
        (("entry", scene, "--rank", "nothing"), "must be expected, all or the name of a target: lesion, core"),
        (("plan", scene), "is required for an anatomy with several targets: lesion, core"),
        (("plan", scene, "--target-name", "nothing"), "must be the name of a target: lesion, core"),
    ):
        done = needleplan(*arguments)
        assert done.returncode == 2
        assert text in done.stderr
    single = write(tmp_path, box())
    refused = needleplan("entry", single, "--rank", "all")
    assert refused.returncode == 2
    assert "holds for an anatomy with several targets, and this has one" in refused.stderr
    assert needleplan("plan", single, "--target-name", "core").returncode == 2


def test_a_target_behind_a_wall_is_named(tmp_path: Path) -> None:
    near = "{ center_mm = [20.0, 20.0, 26.0], radius_mm = 4.0 }"
    done = needleplan("entry", write(tmp_path, box(wall=True), several(("near", near), ("far", '"target"'))), "--json")
    assert done.returncode == 1
    assert "no entry reaches far in 0.1 % of executions by the table; proved for the voxels" in done.stderr
    record = json.loads(done.stdout)
    assert (record["answer"], record["unreached"]) == ("impossible", ["far"])


def test_one_ranking_of_one_target_is_that_of_rank_entries() -> None:
    one = rank_for_targets(anatomy(box(), several(("lesion", '"target"'))), threads=1)
    alone = rank_entries(anatomy(box()), threads=1)
    assert np.array_equal(one.success[0], np.minimum(alone.success, 1.0))
