"""Names, short forms, copies, notebooks and messages: what a user of Python meets first."""

import copy
import math
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import MdpError, NeedleplanError, PoseError, ScenarioError, TableError
from needleplan.planning import Decision, Stats
from tests.conftest import SMALL


def test_names(small: npl.Scenario) -> None:
    assert npl.__version__ == metadata.version("needleplan")
    assert isinstance(small.obstacles[0], npl.Obstacle)
    assert npl.recording.__name__ == "needleplan.recording"


def test_plan_takes_a_name_or_a_path(table: npl.PolicyTable, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    for path in (tmp_path / "small.toml", str(tmp_path / "small.toml")):
        assert npl.plan(path).digest == table.digest
    assert npl.plan("unreachable").scenario == npl.Scenario.read("unreachable")
    with pytest.raises(ScenarioError, match='did you mean "four_obstacles"'):
        npl.plan("four_obstacle")


def test_poses_in_degrees() -> None:
    pose = npl.Pose.deg(0, 28, 18, -1)
    assert pose == npl.Pose(0.0, 28.0, math.radians(18), -1) == (0.0, 28.0, math.radians(18), -1)
    assert npl.Pose.deg(0, 28, 18).bevel is None
    assert str(npl.Pose.deg(0, 28, 18)) == "x 0 mm, y 28 mm, heading 18 deg, either bevel"
    assert npl.Pose.deg(0, 28, -360).heading_rad == pytest.approx(-2 * math.pi)
    for degrees in (361, math.nan, "a"):
        with pytest.raises(PoseError, match="heading_deg = "):
            npl.Pose.deg(0, 28, degrees)  # type: ignore[arg-type]


def test_a_pose_wound_up_by_an_execution_is_brought_back() -> None:
    assert npl.Pose.wound([1, 2, 7.0, -1]) == (1.0, 2.0, 7.0 - 2 * math.pi, -1)
    assert npl.Pose.wound([1, 2, -6.0, 1]) == (1.0, 2.0, -6.0, 1)


def test_a_pose_may_be_an_entry_a_pose_or_numbers(table: npl.PolicyTable) -> None:
    entry = table.best_entry()
    ways: list[Any] = [entry, entry.pose, tuple(entry.pose), list(entry.pose), np.array(entry.pose)]
    for way in ways:
        assert table.start(way) == entry.pose
        assert table.path(way).start == entry.pose
        assert table.rollout(way, 50) == table.rollout(entry, 50)
        assert table.lookup(way) == table.lookup(*entry.pose)
    free = npl.Pose(*entry.pose[:3])
    assert table.start(free) == table.start(entry.pose[:3])
    assert table.lookup(free) == table.lookup(*table.start(free))
    assert table.lookup(x_mm=0, y_mm=20, heading_rad=0, bevel=1) == table.lookup(0, 20, 0, 1)
    assert table.lookup(np.float32(0), np.float32(20), 0, 1) == table.lookup(0, 20, 0, 1)  # type: ignore[call-overload]


@pytest.mark.parametrize("copied", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy, copy.copy])
def test_copies(table: npl.PolicyTable, copied: Callable[[Any], Any]) -> None:
    assert copied(table.scenario) == table.scenario
    again = copied(table)
    assert (again.digest, again.stats, again.scenario) == (table.digest, table.stats, table.scenario)
    assert "lattice" not in vars(again)
    for name in ("values", "policy", "success"):
        assert not getattr(again, name).flags.writeable
    entry = table.best_entry()
    assert again.rollout(entry, 50) == table.rollout(entry, 50)
    path, rollouts = table.path(entry), table.rollout(entry, 50)
    np.testing.assert_array_equal(copied(path).poses, path.poses)
    assert copied(rollouts) == rollouts
    assert copied(entry) == entry
    assert copied(npl.Pose.deg(0, 1, 2)) == npl.Pose.deg(0, 1, 2)


def shown(table: npl.PolicyTable) -> list[Any]:
    entry = table.best_entry()
    return [table.scenario, table, table.path(entry), table.rollout(entry, 50)]


def test_reprs_are_one_line(table: npl.PolicyTable) -> None:
    entry = table.best_entry()
    decision, stats = table.lookup(entry), table.stats
    assert isinstance(decision, Decision)
    assert isinstance(stats, Stats)
    for each in (*shown(table), entry, decision, stats):
        assert re.fullmatch(rf"<{type(each).__name__}\b.{{10,150}}>", repr(each)), repr(each)
    assert repr(table) == '<PolicyTable "Small": 61 x 41 x 36 x 2 = 180,072 states, converged>'
    assert repr(table.scenario) == '<Scenario "Small": 60 x 40 mm, 1 obstacle, 180,072 states>'
    assert f"success {entry.success:.3f}" in repr(entry)


@pytest.mark.slow
def test_html_has_a_picture_and_escaped_text(table: npl.PolicyTable, small: npl.Scenario) -> None:
    from dataclasses import replace

    for each in (*shown(table), replace(small, title="<script>&")):
        html = each._repr_html_()
        assert html.count('src="data:image/png;base64,iVBOR') == 1
        assert len(html) < 200_000
        assert "<script" not in html
    assert "&lt;script&gt;&amp;" in html


def test_matplotlib_is_imported_only_to_draw() -> None:
    code = (
        "import sys, needleplan as npl; table = npl.plan('four_obstacles'); entry = table.best_entry();"
        "repr([table, table.scenario, table.path(entry), table.rollout(entry, 10)]);"
        "assert not {'matplotlib', 'xarray', 'pandas'} & set(sys.modules), sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_xarray_has_names_and_units(table: npl.PolicyTable) -> None:
    data = table.to_xarray()
    assert dict(data.sizes) == {"x": 61, "y": 41, "heading": 36, "bevel": 2}
    assert [data[name].attrs["units"] for name in ("x", "y", "heading", "bevel")] == ["mm", "mm", "rad", "1"]
    assert [data[name].attrs["units"] for name in ("values", "policy", "success")] == ["cost", "1", "1"]
    decision = table.lookup(10, 20, 0, -1, nearest=True)
    state = data.sel(x=10, y=20, heading=0, bevel=-1)
    assert (state["values"], state.policy, state.success) == (decision.value, decision.action, decision.success)
    assert (data.digest, data.scenario) == (table.digest, table.scenario.to_toml())


def test_without_xarray_the_message_says_how_to_get_it(table: npl.PolicyTable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(npl.InputError, match=r"pip install needleplan\[xarray\]"):
        table.to_xarray()


TOO_LARGE = 18.0
DOORS: dict[str, Callable[[npl.PolicyTable], object]] = {
    "lookup": lambda table: table.lookup(0, 20, TOO_LARGE, 1),
    "lookup of a tuple": lambda table: table.lookup((0, 20, TOO_LARGE)),
    "path": lambda table: table.path((0, 20, TOO_LARGE)),
    "rollout": lambda table: table.rollout((0, 20, TOO_LARGE, 1)),
    "start": lambda table: table.start([0, 20, TOO_LARGE]),
    "plot": lambda table: table.plot(heading_rad=TOO_LARGE),
    "Pose": lambda _: npl.Pose(0, 20, TOO_LARGE),
    "Pose.of": lambda _: npl.Pose.of((0, 20, -TOO_LARGE, 1)),
}


@pytest.mark.parametrize("door", DOORS)
def test_a_heading_beyond_a_full_turn_was_meant_in_degrees(table: npl.PolicyTable, door: str) -> None:
    with pytest.raises(
        PoseError, match=r"heading_rad = -?18: must lie between -2 pi and 2 pi rad; degrees\?"
    ) as caught:
        DOORS[door](table)
    assert caught.value.mistakes[0].key == "heading_rad"


def test_lookup_many_names_the_row_in_degrees(table: npl.PolicyTable) -> None:
    poses = np.array([(0, 20, 2 * math.pi, 1), (0, 20, -2 * math.pi, 1), (0, 20, -18, 1), (0, 20, 90, 1)])
    with pytest.raises(PoseError, match=r"poses\[2\]\.heading_rad = -18: .*degrees\?.*-0\.3142 rad"):
        table.lookup_many(poses)
    assert len(table.lookup_many(poses[:2].astype(np.float32)).action) == 2


MDP = npl.mdp.TabularMdp([[[1.0]]], [[1.0]], 0.5)
WRONG: dict[str, tuple[Callable[[npl.PolicyTable, Any], object], list[Any]]] = {
    "noise_seed": (lambda table, value: table.path((0, 20, 0), noise_seed=value), [-1, 2**64, 1.5, "a", True]),
    "runs": (
        lambda table, value: table.rollout((0, 20, 0), runs=value),
        [1.5, 2**62, 0, "a", None, math.nan, math.inf],
    ),
    "seed": (lambda table, value: table.rollout((0, 20, 0), seed=value), [-1, 0.5, None, 2**64, [1]]),
    "pose": (lambda table, value: table.path(value), [None, 3, "abcd", b"abcd", (1, 2), {}, (0, 99, 0), (0, 99, 0, 1)]),
    "x_mm": (lambda table, value: table.lookup(value, 1, 1, 1), ["a", None, [], {}, 1j]),
    "y_mm": (lambda table, value: table.best_entry(y_mm=value), ["a", [], -1, math.nan]),
    "bevel": (lambda table, value: table.lookup(1, 1, 1, value), ["a", None]),
    "nearest": (lambda table, value: table.lookup(1, 1, 1, 1, nearest=value), [None, 1, "yes", np.empty(0)]),
    "edge": (lambda table, value: table.best_entry(value), [3, None, "lift"]),
    "poses": (
        lambda table, value: table.lookup_many(value),
        [None, 3, "a", [(1, 2, 3)], [[["a"]]], {}, [(1, 2, 3, 1j)]],
    ),
    "path": (lambda _, value: npl.PolicyTable.read(value), [None, 3, [], 1.5]),
    "scenario": (lambda _, value: npl.plan(value), [None, 3, []]),
    "progress": (lambda table, value: npl.plan(table.scenario, value), [3, "a"]),
    "values": (lambda table, value: rebuilt(table, values=value), [None, [1.0], np.zeros(3)]),
    "stats": (lambda table, value: rebuilt(table, stats=value), [None]),
    "mdp": (lambda _, value: npl.mdp.solve(value), [None, 3]),
    "method": (lambda _, value: npl.mdp.solve(MDP, method=value), ["swep", None, 3]),
    "priority": (lambda _, value: npl.mdp.solve(MDP, priority=value), ["H3", None]),
    "tolerance": (lambda _, value: npl.mdp.solve(MDP, tolerance=value), ["a", None, -1, math.nan]),
    "max_sweeps": (lambda _, value: npl.mdp.solve(MDP, max_sweeps=value), [-1, 1.5, 2**70, "a"]),
    "time_limit_s": (lambda _, value: npl.mdp.solve(MDP, time_limit_s=value), ["a", -1, math.nan]),
    "threads": (lambda _, value: npl.mdp.solve(MDP, threads=value), [-4, 0, 1.5, 10**9, "a"]),
    "labels": (lambda _, value: npl.mdp.solve(MDP, method="ppvi", labels=value), [["a"], [-1], [0.5], [0, 0], 2**33]),
    "discount": (lambda _, value: npl.mdp.TabularMdp([[[1.0]]], [[1.0]], value), ["a", None, 0, 1.5, math.nan]),
    "costs": (lambda _, value: npl.mdp.TabularMdp([[[1.0]]], value, 0.5), ["a", None, [1.0, 2.0], [[1.0, 2.0]]]),
    "transitions": (lambda _, value: npl.mdp.TabularMdp(value, [[1.0]], 0.5), ["a", None, 3, [[1.0]], [[[1.0, 0.0]]]]),
}


@pytest.mark.parametrize("kind", [ValueError, KeyError, TypeError, MemoryError])
def test_an_exception_of_progress_is_not_changed(small: npl.Scenario, kind: type[Exception]) -> None:
    raised = kind("of the caller")

    def fail(*_: float) -> None:
        raise raised

    for solve in (lambda: npl.plan(small, fail), lambda: npl.mdp.solve(MDP, progress=fail)):
        with pytest.raises(kind) as caught:
            solve()
        assert caught.value is raised


def rebuilt(table: npl.PolicyTable, **changed: Any) -> npl.PolicyTable:
    names = ("values", "policy", "success", "stats", "scenario")
    return npl.PolicyTable(**({name: getattr(table, name) for name in names} | changed))


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, (_, values) in WRONG.items() for value in values])
def test_wrong_arguments_are_named(table: npl.PolicyTable, key: str, value: Any) -> None:
    with pytest.raises(NeedleplanError) as caught:
        WRONG[key][0](table, value)
    assert isinstance(caught.value, PoseError | TableError | ScenarioError | MdpError | npl.InputError)
    (mistake,) = caught.value.mistakes
    assert mistake.key.split("[")[0] == key
    assert len(mistake.rule.split()) >= 3
