"""Gating: the needle advances only while breathing leaves the tissue near its place in the plan."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from needleplan.anatomy import Breathing
from needleplan.control import BreathGate, InsertionOutcome, Listener, Options, RunEventName, RunSetup
from needleplan.devices import Sample, StageSample
from needleplan.errors import InputError
from needleplan.simulation import Effects
from tests.cli.commands import needleplan
from tests.control.space_scenes import FAST, QUIET, box_table, inserted, space_station

BREATHING = Breathing(full_mm=15.0, still=("bone",), period_s=4.0)


def test_the_window_is_where_the_level_is_low() -> None:
    gate = BreathGate(BREATHING, 3.0, exhaled_s=10.0)
    half_s = 4 / np.pi * np.arcsin((3 / 15) ** 0.25)  # sin(pi t / 4)^4 = 3 / 15
    assert gate.longest_s == pytest.approx(2 * half_s, abs=0.01)
    assert gate.window(10.0) == pytest.approx((0.0, half_s), abs=0.01)
    assert gate.window(11.9) == pytest.approx((2.1 - half_s, 2 * half_s), abs=0.01)
    assert gate.window(14.0 - half_s / 2) == pytest.approx((0.0, 1.5 * half_s), abs=0.01)
    assert gate.off_mm(12.0) == pytest.approx(15.0)
    assert BreathGate(BREATHING, 15.0).window(1.0) == (0.0, 4.0)
    inhaled = BreathGate(replace(BREATHING, level=1.0), 3.0)
    assert inhaled.window(0.0)[0] == pytest.approx(2 - inhaled.longest_s / 2, abs=0.01)


def test_a_gate_that_hardly_opens_is_refused() -> None:
    with pytest.raises(InputError, match="opens the gate for"):
        BreathGate(replace(BREATHING, rest=-1.0, level=0.0), 0.05)


def test_a_recording_keeps_the_gate() -> None:
    setup = RunSetup(Options(gate=BreathGate(BREATHING, 3.0, 1.5)))
    assert RunSetup.from_texts(setup.texts) == setup


class Speeds(Listener):
    """Listener that keeps the stage samples."""

    def __init__(self) -> None:
        self.stage: list[StageSample] = []

    def sample(self, sample: Sample) -> None:
        if isinstance(sample, StageSample):
            self.stage.append(sample)


@pytest.mark.slow
@pytest.mark.usefixtures("few_executions")
def test_the_needle_advances_only_while_the_gate_is_open() -> None:
    effects: Effects = replace(
        QUIET, respiration_across_mm=5.0, respiration_rest=1.0, respiration_period_s=2.0
    )  # fmt: skip
    table, speeds = box_table(), Speeds()
    exhaled_s = space_station(table, effects).exhaled_s  # the phase of the lab is that of its seed
    gate = BreathGate(replace(BREATHING, full_mm=10.0, period_s=2.0), 2.0, exhaled_s)
    options = replace(FAST, velocity_mm_s=10.0, gate=gate, longest_mm=20.0)
    report, _ = inserted(table, effects, options=options, listeners=[speeds])
    assert report.outcome is InsertionOutcome.TOO_LONG, report.cause
    moving = [each for each in speeds.stage if abs(each.velocity_mm_s) > 0.1]
    assert moving
    off = [gate.off_mm(each.stamp.received_ns * 1e-9) for each in moving]
    assert max(off) <= 2.0
    waits = [each for each in report.events if each.name is RunEventName.WAITING]
    assert any("until the tissue is within 2 mm of the plan" in each.text for each in waits)
    # A wait says that the tissue is off only while it is.
    off_mm = [float(each.text.split("now ")[1].split()[0]) for each in waits if each.text.endswith("mm off")]
    assert min(off_mm) >= 2.0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--gate", "3"], "needs a 3D table of an anatomy with [breathing]"),
        (["--exhaled-at", "3"], "is for --gate"),
    ],
)
def test_what_cannot_be_gated_is_refused(options: list[str], says: str, tmp_path: Path) -> None:
    file = tmp_path / "table.h5"
    box_table().write(file)
    done = needleplan("insert", file, *options)
    assert done.returncode == 2
    assert says in done.stderr
