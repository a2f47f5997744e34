"""Friction of the shaft and cutting force of the tip: values, intervals, scatter between trials, and remarks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from needleplan.errors import DataError
from needleplan.identification import shaft_and_tip
from needleplan.models import ModelFile, ShaftAndTip, simulate
from needleplan.recording import write_records
from needleplan.signals import Record, Role, insertion_cycles, lspb
from tests.cli.commands import needleplan
from tests.diagnosis.trials import BASE, NOISE_N, recordings


def test_the_mean_over_trials_is_near_the_truth_and_the_scatter_is_found() -> None:
    """The trials of `recordings` scatter by up to 12 % in friction and cutting force, with a deviation of 7 %."""
    some = [replace(each, trial=f"{seed}, {each.trial}") for seed in range(4) for each in recordings(seed=seed)]
    found = shaft_and_tip.identify(some)
    assert isinstance(found.model, ShaftAndTip)
    for name, each in found.estimates.items():
        assert each.low < getattr(BASE, name) < each.high, name
        assert each.identified
    assert found.estimates["friction"].between_sd == pytest.approx(0.07 * BASE.friction, rel=0.6)
    assert {name: value for name, value, _ in found.scores}["RMSE of the fits"] == pytest.approx(NOISE_N, rel=0.1)
    says = [each.says for each in found.findings]
    assert "friction differs from trial to trial" in says
    assert "the residual is the noise of the sensor" in says
    figure = Figure()
    found.draw(figure)
    assert figure.axes


def test_intervals_hold_the_truth_of_one_trial() -> None:
    motion = lspb([-2, 40, 20, 60, -2], [5, 5, 5, 5], rate_hz=100)
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    output = simulate(BASE, motion).output
    held = 0
    for seed in range(20):
        force = output + np.random.default_rng(seed).normal(0, 0.02, len(motion))
        estimates = shaft_and_tip.identify([Record({**columns, "force_n": force}, "one")], starts=1).estimates
        held += sum(each.low < getattr(BASE, name) < each.high for name, each in estimates.items())
    assert held >= 0.85 * 80


def test_a_residual_above_the_noise_leads_to_the_diagnosis() -> None:
    found = shaft_and_tip.identify(recordings({"viscous": {"size": 1e-3}}, seed=3))
    assert any("`needleplan diagnose` finds what the model lacks" in each.says for each in found.findings)


def test_what_limits_the_identification_is_said() -> None:
    motion = insertion_cycles(50.0, 5.0, rate_hz=50.0)
    inward = slice(0, int(np.argmax(motion.depth_mm)))
    force = simulate(BASE, motion).output + np.random.default_rng(0).normal(0, 0.02, len(motion))
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "force_n": force}
    alone = Record({name: values[inward] for name, values in columns.items()}, "in")
    assert any("there is no retraction" in each for each in shaft_and_tip.identify([alone]).remarks)
    with pytest.raises(DataError, match="needs more than 5 mm"):
        shaft_and_tip.identify([alone.select(np.flatnonzero(alone["depth_mm"] < 4))])
    with pytest.raises(DataError, match="no trial to identify from"):
        shaft_and_tip.identify([each for each in recordings() if each.role is Role.NOISE])


def test_its_file_is_the_base_of_a_diagnosis(tmp_path: Path) -> None:
    write_records(recordings(seed=3), tmp_path / "data.csv")
    assert needleplan("identify", "shaft-and-tip", "data.csv", "-o", "base.toml", cwd=tmp_path).returncode == 0
    file = ModelFile.read(tmp_path / "base.toml")
    assert file.model.name == "shaft_and_tip"
    assert set(file.estimates) == set(file.model.values())
    assert needleplan("compare", "base.toml", "data.csv", "--fit", cwd=tmp_path).returncode == 0
