"""The next motion never costs the verdict: deep trials have a file, and what a file cannot hold is said."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.diagnosis import CandidateMotion, Insert, Library, NextTrials, Program, channels, diagnose
from needleplan.models import ModelFile
from needleplan.models.effects import effect_named
from needleplan.recording import write_records
from needleplan.reports import diagnosis as reports
from needleplan.reports.diagnosis import motion_problem
from needleplan.reports.diagnosis.motion_file import motion_files
from needleplan.signals import Limits, Record
from needleplan.simulation import Simulation
from tests.diagnosis.trials import BASE, recordings


def proposed(deepest_mm: float) -> NextTrials:
    limits = Limits(deepest_mm)
    program = Program("deep", "to the end", (Insert(deepest_mm, 15.0),), limits)
    motion = CandidateMotion("deep", program.motion(50.0), program)
    return NextTrials((motion,), 1.0, 0.5, 2.0, (("deep", 1.0),), "which effect")


def deeper(records: list[Record], factor: float) -> list[Record]:
    """Return the recordings with depths and speeds times a factor."""
    return [
        replace(record, columns={
            name: values * (factor if name in ("depth_mm", "velocity_mm_s") else 1.0)
            for name, values in record.columns.items()
        })
        for record in records
    ]  # fmt: skip


@pytest.mark.parametrize(("deepest_mm", "length_mm"), [(66.0, 200.0), (200.0, 200.0), (240.5, 241.0), (990.0, 990.0)])
def test_a_motion_deeper_than_the_usual_shaft_has_a_file(deepest_mm: float, length_mm: float) -> None:
    (motion,) = motion_files(proposed(deepest_mm), BASE).values()
    assert motion.problem == ""
    simulation = Simulation.from_toml(motion.text)
    assert simulation.setup.shaft.length_mm == length_mm
    assert simulation.setup.robot.deepest_mm == deepest_mm


def test_what_a_file_cannot_hold_is_a_problem_and_no_error() -> None:
    (motion,) = motion_files(proposed(1200.0), BASE).values()
    assert motion.text == ""
    assert "robot.deepest_mm = 1200" in motion.problem


@pytest.mark.parametrize(("factor", "says"), [(1.0, ""), (4.0, ""), (20.0, "robot.deepest_mm = 1320")])
def test_limits_are_known_before_the_work(factor: float, says: str) -> None:
    problem = motion_problem(deeper(recordings(), factor), BASE)
    assert says in problem if says else problem == ""
    assert motion_problem([recordings()[-1]], BASE) == ""
    unread = recordings()[0]
    gaps = replace(unread, columns={**unread.columns, "depth_mm": np.where(np.arange(len(unread)) % 7, 66.0, math.nan)})
    assert motion_problem([gaps], BASE) == ""


@pytest.mark.study
def test_a_deep_trial_gets_its_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ModelFile(BASE).write(tmp_path / "base.toml")
    records = deeper(recordings({"viscous": {"size": 2e-5}}), 16.0)
    write_records(records, tmp_path / "data.csv")
    # All effects, and the variation of the tissue on the usual grid over a metre, would take a minute.
    monkeypatch.setattr(channels, "TISSUE_GRID_MM", 4.0)
    few = Library([effect_named(name) for name in ("viscous", "stribeck")], BASE)
    found = diagnose(BASE, records, library=few)
    monkeypatch.setattr(reports, "diagnose_records", lambda *_, **__: (found, ModelFile(BASE), few))
    out = tmp_path / "found"
    arguments = ["diagnose", str(tmp_path / "base.toml"), str(tmp_path / "data.csv"), "-o", str(out), "--accept-units"]
    assert main(arguments) in (0, 1)
    said = capsys.readouterr()
    document = json.loads((out / "diagnosis.json").read_text())
    assert f"\n{document['verdict']}: " in said.out
    assert not (out / "next_motion.toml").exists()
    assert "warning: the next motion will have no file" in said.err
