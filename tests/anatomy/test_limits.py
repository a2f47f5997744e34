"""Limits of an insertion in the anatomy file: which entries are left, how many, and what an empty set says."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from needleplan.anatomy import AnatomyFile, SpaceScenario
from needleplan.errors import ScenarioError
from needleplan.planning import EntryMap, SpaceTable, plan_space, rank_entries, rank_for_targets
from tests.anatomy.test_several_targets import TWO
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.cli.commands import needleplan


def limited(lines: str, text: str = TEXT, needle: str = "") -> str:
    """Return the text of an anatomy file with limits."""
    return text.replace("[lattice]", f"{needle}\n[limits]\n{lines}\n[lattice]")


@pytest.fixture(scope="module")
def free() -> EntryMap:
    return rank_entries(anatomy(box()), threads=1)


@pytest.fixture(scope="module")
def solved(free: EntryMap) -> SpaceTable:
    return free.table


def with_limits(table: SpaceTable, text: str) -> SpaceTable:
    """Return a table for the anatomy file of a text that differs from that of the table in limits."""
    scenario = table.scenario
    return SpaceTable(SpaceScenario(AnatomyFile.from_toml(text), scenario.grid), table.solved)


def test_without_limits_nothing_is_counted(solved: SpaceTable) -> None:
    assert solved.kept_entries.counts == ()
    assert "limits" not in solved.scenario.to_toml()


def test_a_box_and_half_spaces_keep_the_points_in_them(free: EntryMap, solved: SpaceTable) -> None:
    text = limited(
        "low_mm = [14.0, 0.0, 0.0]\nhigh_mm = [40.0, 24.0, 60.0]\n"
        "[[limits.half_spaces]]\nnormal = [0.0, 0.0, 1.0]\nat_most_mm = 100.0"
    )
    kept = with_limits(solved, text).kept_entries
    places = free.grid.frame.world(free.poses[:, :3])
    inside = ((places >= [14, 0, 0]) & (places <= [40, 24, 60])).all(-1)
    assert 0 < inside.sum() < len(places)
    assert np.array_equal(kept.poses, free.poses[inside])
    low, high, half = kept.counts
    assert (low.before, high.left, half.left) == (len(places), inside.sum(), inside.sum())
    assert str(half) == f"{half.left} of {half.before} entries left after limits.half_spaces 1"
    assert AnatomyFile.from_toml(AnatomyFile.from_toml(text).to_toml()) == AnatomyFile.from_toml(text)


def test_directions_are_the_best_ones_in_the_cone(solved: SpaceTable) -> None:
    table = with_limits(solved, limited("toward = [0.0, 0.0, 1.0]\ntoward_deg = 6.0"))
    directions = table.entry_poses[:, 3:] @ solved.scenario.frame_axes
    assert (directions[:, 2] >= np.cos(np.radians(6.0)) - 1e-9).all()
    free_ones = solved.entry_poses[:, 3:] @ solved.scenario.frame_axes
    within = free_ones[:, 2] >= np.cos(np.radians(6.0))
    assert np.array_equal(directions[within], free_ones[within])
    assert not within.all()


@pytest.mark.parametrize("key", ["limits.insertion_mm", "needle.length_mm"])
def test_longer_paths_are_left_out(free: EntryMap, solved: SpaceTable, key: str) -> None:
    most = float(np.median(free.paths.length_mm))
    needle = f"length_mm = {most}" if key.startswith("needle") else ""
    table = with_limits(solved, limited("" if needle else f"insertion_mm = {most}", needle=needle))
    assert np.array_equal(table.entry_poses, free.poses[free.paths.length_mm <= most])
    assert [each.key for each in table.kept_entries.counts] == [key]


@pytest.mark.parametrize(
    ("lines", "key"),
    [
        ("insertion_mm = 5.0", "limits.insertion_mm"),
        ("low_mm = [0.0, 0.0, 50.0]", "limits.low_mm"),
        ("toward = [0.0, 0.0, -1.0]\ntoward_deg = 10.0", "limits.toward_deg"),
    ],
)
def test_a_limit_that_leaves_no_entry_is_named(solved: SpaceTable, lines: str, key: str) -> None:
    with pytest.raises(ScenarioError, match="leaves none of") as raised:
        _ = with_limits(solved, limited(lines)).entry_poses
    assert key in str(raised.value)


@pytest.mark.parametrize(
    ("lines", "rule"),
    [
        ("toward = [0.0, 0.0, 1.0]", "limits.toward_deg: is missing"),
        ("toward = [0.0, 0.0, 2.0]\ntoward_deg = 5.0", "limits.toward"),
        ("low_mm = [0.0, 0.0, 0.0]\nhigh_mm = [1.0, 0.0, 1.0]", "limits.high_mm"),
        ("insertion_mm = 0.0", "limits.insertion_mm"),
    ],
)
def test_impossible_limits_are_refused(lines: str, rule: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        AnatomyFile.from_toml(limited(lines))
    assert rule in str(raised.value)


def test_several_targets_keep_the_entries_from_which_all_are_near_enough() -> None:
    free = rank_for_targets(anatomy(box(), TWO), threads=1)
    lengths = np.max([each.paths.length_mm for each in free.maps.values()], 0)
    most = float(np.median(lengths))
    found = rank_for_targets(anatomy(box(), limited(f"insertion_mm = {most}", TWO)), threads=1)
    assert len(found.cost) == (lengths <= most).sum()
    assert found.limits[-1].left == len(found.cost) < found.limits[-1].before == len(lengths)


def test_the_command_prints_the_counts_which_a_table_file_has_too(tmp_path: Path) -> None:
    text, table = limited("low_mm = [14.0, 0.0, 0.0]"), tmp_path / "table.h5"
    (count,) = json.loads(needleplan("entry", write(tmp_path, box(), text), "--json", "--top", 1).stdout)["limits"]
    assert count["key"] == "limits.low_mm"
    assert 0 < count["left"] < count["before"]
    plan_space(SpaceScenario.of(anatomy(box(), text)), threads=1).write(table)
    assert [asdict(each) for each in SpaceTable.read(table).kept_entries.counts] == [count]
    done = needleplan("entry", write(tmp_path, box(), limited("low_mm = [0.0, 0.0, 50.0]")))
    assert done.returncode == 2
    assert "anatomy.toml: limits.low_mm: leaves none of" in done.stderr
