"""Calls with wrong types, values, units and files: each raises a NeedleplanError with a short message."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import needleplan as npl
from needleplan.signals import Motion, Record

NAN, INF = float("nan"), float("inf")
FRAME = pd.DataFrame({"time_s": [0.0, 1.0, 2.0], "depth_mm": [0.0, 1.0, 2.0], "force_n": [0.0, 0.1, NAN]})
FORCE = npl.models.RelaxingForce()
# Most characters of a line of a message, with the name of a file in a temporary folder left out.
LONGEST_LINE = 330


def calls(table: npl.PolicyTable) -> dict[str, Callable[[], Any]]:
    """Return calls by their names, with files of the working folder."""
    start, mdp = (1.0, 10.0, 0.0), npl.mdp
    wrong: list[Any] = [None, 3, "", b"four_obstacles", ["four_obstacles"], FRAME, "folder", "empty.toml", "bin.toml"]
    found: dict[str, Callable[[], Any]] = {}
    for number, value in enumerate(wrong):
        found |= {
            f"plan {number}": lambda value=value: npl.plan(value),
            f"open {number}": lambda value=value: npl.open(value),
            f"read {number}": lambda value=value: npl.PolicyTable.read(value),
            f"recording {number}": lambda value=value: npl.recording.Recording.read(value),
        }
    for number, pose in enumerate(
        [None, "0,30,15", (NAN, 1, 0, 1), (INF, 1, 0, 1), (1, 1, 90, 1), ("a", 1, 0, 1), (1, 1), (1, 1, 0, 0), FRAME]
    ):
        found |= {
            f"lookup {number}": lambda pose=pose: table.lookup(pose),
            f"path {number}": lambda pose=pose: table.path(pose),
            f"rollout from {number}": lambda pose=pose: table.rollout(pose, runs=10),
            f"success {number}": lambda pose=pose: table.success_under(pose, pose),
        }
    for poses in ([], [[1, 2], [3]], "abc", np.zeros((3, 3)), np.full((2, 4), NAN), FRAME):
        found[f"lookup_many {type(poses)} {len(poses)}"] = lambda poses=poses: table.lookup_many(poses)
    for runs, seed in ((0, 0), (1.5, 0), ("many", 0), (10**12, 0), (10, -1), (10, "x"), (10, None)):
        found[f"rollout {runs} {seed}"] = lambda runs=runs, seed=seed: table.rollout(start, runs=runs, seed=seed)
    return found | {
        "plan in feet": lambda: npl.Scenario.from_toml("[workspace]\nwidth_ft = 3"),
        "plan progress": lambda: npl.plan("four_obstacles", progress=3),  # type: ignore[call-overload]
        "edge": lambda: table.best_entry(edge="middle"),
        "write nowhere": lambda: table.write("no/such/table.h5"),
        "write folder": lambda: table.write("folder"),
        "view": lambda: npl.view(3),
        "view start": lambda: npl.view(table, start=(NAN, 1, 1)),
        "plot": lambda: table.plot(3),  # type: ignore[arg-type]
        "diagnose": lambda: npl.diagnose("model.toml", "data.csv"),
        "diagnose frame": lambda: npl.diagnose(FORCE, FRAME),
        "diagnose nothing": lambda: npl.diagnose(FORCE, []),
        "record of nothing": lambda: Record(None),  # type: ignore[arg-type]
        "record of texts": lambda: Record({"time_s": "now"}),  # type: ignore[dict-item]
        "diagnose other": lambda: npl.diagnose({}, {}),
        "model": lambda: npl.models.Bicycle(curvature_per_mm="0.01"),  # type: ignore[arg-type]
        "simulate": lambda: npl.models.simulate(FORCE, FRAME),
        "fit": lambda: npl.models.fit(FORCE, "data.csv"),
        "motion": lambda: Motion.sampled([0, 1, NAN], [0, 1, 2]),
        "pose": lambda: npl.Pose.deg(0, 0, 0, 2),
        "toml": lambda: npl.Scenario.from_toml(3),  # type: ignore[arg-type]
        "obstacle": lambda: npl.Obstacle(((0, 0), (1, NAN), (2, 2))),
        "obstacle text": lambda: npl.Obstacle("abc"),
        "mdp": lambda: mdp.TabularMdp([[1]], [[1]], discount=2),
        "mdp text": lambda: mdp.TabularMdp("a", "b", discount=0.9),
        "solve": lambda: mdp.solve(None),
    }


def test_no_sloppy_call_ends_otherwise(table: npl.PolicyTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.toml").touch()
    (tmp_path / "bin.toml").write_bytes(bytes(range(256)))
    bad = {}
    for name, call in calls(table).items():
        try:
            bad[name] = f"returned {call()!r}"
        except npl.NeedleplanError as error:
            lines = str(error).splitlines()
            if max(map(len, lines)) > LONGEST_LINE:
                bad[name] = f"long: {error}"
        except Exception as error:
            bad[name] = f"{type(error).__name__}: {error}"
    assert bad == {}
