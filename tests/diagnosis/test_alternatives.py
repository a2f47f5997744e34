"""Nonparametric alternatives that are fitted and validated like effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from needleplan.diagnosis import Diagnosis, Verdict, diagnose
from needleplan.diagnosis.alternatives import AlternativeModel
from needleplan.signals import Record, Role
from tests.diagnosis.trials import BASE, recordings

SLIP_S = 14.5


def slipped(each: Record, by_n: float) -> Record:
    force = each["force_n"] + by_n * (each["time_s"] >= SLIP_S)
    return each if each.role is Role.NOISE else replace(each, columns={**each.columns, "force_n": force})


def step_of(found: Diagnosis) -> AlternativeModel:
    return next(each for each in found.selection.rounds[0].alternatives if each.name == "step in time")


@pytest.mark.slow
@pytest.mark.parametrize("by_n", [0.04, -0.25])
def test_a_slip_has_no_name_however_large(by_n: float) -> None:
    found = diagnose(BASE, [slipped(each, by_n) for each in recordings(seed=3)])
    assert found.verdict is Verdict.UNKNOWN
    step, best = step_of(found), found.selection.rounds[0].ranked[0]
    assert step.bic_gain > best.newest.bic_gain
    assert step.held_out_difference > 0


@pytest.mark.slow
def test_a_drift_is_no_step_in_another_motion() -> None:
    found = diagnose(BASE, recordings({"drift": {"size": 0.0025}}, seed=4))
    assert found.names == ("drift",)
    step = step_of(found)
    assert step.held_out_difference < 0
    assert np.isclose(step.combined_gain, step.bic_gain + step.held_out_difference)
