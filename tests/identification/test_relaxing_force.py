from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.identification import force
from needleplan.models import ModelFile, RelaxingForce, simulate
from needleplan.recording import write_records
from needleplan.signals import Motion, Record, Role

BRANCH = RelaxingForce(contact_mm=3.0, stiffness=0.04, growth=0.08, branch_1=1.2, time_1_s=1.5, friction=0.005)
CAPSULE = replace(BRANCH, boundary_1_mm=14.0, ratio_1=0.6, cutting=0.1)
NOISE_N = 0.004


def insertion(model: RelaxingForce, seed: int, *, dwell: bool = True, rate_hz: float = 12.0) -> Record:
    """20 mm at 4 mm/s; with a dwell of 4 s at 9 mm, one of 5 s at the end, and a retraction to 15 mm."""
    time = np.arange(round((16 if dwell else 5) * rate_hz)) / rate_hz
    knots = ([0, 2.25, 6.25, 9, 14, 16], [0, 9, 9, 20, 20, 12]) if dwell else ([0, 5], [0, 20])
    motion = Motion.sampled(time, np.interp(time, *knots))
    noise = np.random.default_rng(seed).normal(0.0, NOISE_N, time.size)
    columns = {"time_s": time, "depth_mm": motion.depth_mm, "force_n": simulate(model, motion).output + noise}
    return Record(columns, f"trial {seed}")


def said(found: force.Identification, name: str) -> str:
    return next(each.says for each in found.findings if each.name == name)


@pytest.mark.slow
def test_held_out_trials_choose_and_a_capsule_is_found() -> None:
    held = replace(insertion(CAPSULE, 2), role=Role.HOLDOUT)
    found = force.identify([insertion(CAPSULE, 1), held], average=1, model="relaxing")
    assert isinstance(found.model, RelaxingForce)
    assert "held-out trials chose: 1 capsule, one branch" in said(found, "choice of the member")
    assert found.model.boundary_1_mm == pytest.approx(14.0, abs=0.1)
    assert found.model.branch_2 == 0.0
    for name in ("stiffness", "growth", "branch_1", "time_1_s", "friction"):
        assert found.model.values()[name] == pytest.approx(getattr(CAPSULE, name), rel=0.1), name
    assert not any("no dwell" in each for each in found.remarks)
    scores = {name: value for name, value, _ in found.scores}
    assert scores["1 capsule, one branch: RMSE held out"] < 1.3 * NOISE_N
    assert scores["spring: RMSE held out"] > 5 * NOISE_N


@pytest.mark.slow
def test_a_constant_speed_does_not_show_a_relaxation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, model = str(tmp_path / "trials.csv"), str(tmp_path / "model.toml")
    write_records([insertion(BRANCH, 3, dwell=False)], data)
    assert main(["identify", "force", data, "--model", "relaxing", "--average", "1", "-o", model, "--verbose"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("force: relaxing_force")
    assert "branches were not tried" in printed
    assert "nothing is held out" in printed
    assert isinstance(ModelFile.read(model).model, RelaxingForce)
    assert main(["identify", "friction", data, "--model", "relaxing"]) == 2
    library = ["--force-library", str(tmp_path / "library.toml"), "--needle-name", "18G", "--tissue-name", "gel"]
    assert main(["identify", "force", data, "--model", "relaxing", *library]) == 2
    assert "leave out --model or --force-library" in capsys.readouterr().err
