"""A simulated run as a recording."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.recording import Recording
from needleplan.simulation import Simulation, run_simulation

TEXT = """schema = "needleplan.simulation/1"
title = "short"
[tissue]
curvature_per_mm = 0.01
[effects]
tracker_dropout = 0.2
force_noise_n = 0.02
[[move]]
insert_to_mm = 5.0
velocity_mm_s = 10.0
[[move]]
rotate_to_rad = 1.0
velocity_rad_s = 6.0
"""


def test_every_sample_is_in_it(tmp_path: Path) -> None:
    file, path = tmp_path / "short.toml", tmp_path / "run.mcap"
    file.write_text(TEXT)
    assert main(["simulate", str(file), "--seed", "7", "-o", str(path)]) == 0
    run = run_simulation(Simulation.read(file), 7)
    recording = Recording.read(path)
    assert recording.session.digests == {"simulation": run.simulation.digest}
    assert (recording.counts["/stage"], recording.counts["/force"]) == (len(run.stage), len(run.forces))
    stage = [each.values["depth_mm"] for each in recording.messages(["/stage"])]
    assert stage == [each.depth_mm for each in run.stage]
    poses = [(each.values["x_mm"], each.values["health"]) for each in recording.messages(["/pose"])]
    np.testing.assert_array_equal([x for x, _ in poses], [each.position_mm[0] for each in run.poses])
    assert {health for _, health in poses} == {"good", "missing"}
    phases = [(each.time_ns * 1e-9, each.values["text"]) for each in recording.messages(["/event"])]
    assert phases == [(pytest.approx(each.begin_s), each.label) for each in run.phases]


def test_a_recording_is_of_one_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "insertion", "--runs", "2", "-o", str(tmp_path / "run.mcap")]) == 2
    assert "--runs = 2: must be 1" in capsys.readouterr().err
