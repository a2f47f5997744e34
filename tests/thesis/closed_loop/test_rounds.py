"""One round of the closed loop: a layer is diagnosed, planned with, and the target is hit."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from needleplan.diagnosis import Verdict
from needleplan.models import Estimate
from needleplan.reports.chapters import Effort, Request, reproduce
from needleplan.reports.comparison import Agreement
from needleplan.signals import Role
from needleplan_thesis.closed_loop.chapter import closed_loop_scenario, files
from needleplan_thesis.closed_loop.hidden import HIDDEN, hidden_named, laboratory, recordings
from needleplan_thesis.closed_loop.loop import NamedEffect, OpenLoopInsertion, Round, diagnosed
from needleplan_thesis.closed_loop.summary import reduction, summarized, total

pytestmark = pytest.mark.study

SCENARIO = closed_loop_scenario()


def test_a_layer_is_named_and_the_next_plan_hits_the_target(tmp_path: Path) -> None:
    found = {each.id: each for each in reproduce(["diagnosis"], Request(tmp_path, Effort.QUICK, str, runs=2))}
    assert found["diagnosis/soft_layer/named"].ours == "1 curvature_layer"
    assert found["diagnosis/together/median error, shrink"].verdict is Agreement.MET
    assert found["diagnosis/together/gap of success, shrink"].ours == pytest.approx(1.0, abs=0.01)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["diagnosis.json", "diagnosis.md", "diagnosis.png"]
    assert sorted(each.name for each in tmp_path.iterdir()) == sorted(files(Request(tmp_path, Effort.QUICK, str)))
    document = json.loads((tmp_path / "diagnosis.json").read_text())
    (only,) = document["rounds"]
    assert (only["seeds"], only["verdicts"], only["motions"]) == ([0, 1], ["named"], [])
    size = only["named"][0]["estimates"]["size"]
    assert size["low"] < -0.25 < size["high"] < 0
    assert size["high"] - size["low"] < 0.15
    assert min(each["error_mm"] for each in only["before"]) > 3 > 1.5 > max(each["error_mm"] for each in only["after"])
    assert "| from 25 mm on the curvature is 25 % smaller |" in (tmp_path / "diagnosis.md").read_text()


def test_a_needle_that_sags_is_named_though_it_distorts_the_base() -> None:
    found, _ = diagnosed(hidden_named("sagging_needle"), SCENARIO, 20)
    assert (found[-1].verdict, found[-1].names) == (Verdict.NAMED, ("gravity",))
    assert found[-1].effects[0].values["size"] == pytest.approx(0.0015, rel=0.2)


def test_recordings_of_a_lab_suit_a_diagnosis() -> None:
    data = recordings(HIDDEN[0].hide(laboratory(SCENARIO)), 0)
    assert [each.role for each in data] == [Role.TRAIN] * 3 + [Role.HOLDOUT] * 2 + [Role.NOISE]
    for each in data[:5]:
        assert np.ptp(each["angle_rad"]) == pytest.approx(np.pi, abs=0.01)
        assert np.isfinite(each["z_mm"]).all()
        assert np.diff(each["time_s"]) == pytest.approx(0.025)


def a_round(seed: int, before_mm: float, after_mm: float) -> Round:
    def inserted(error_mm: float) -> tuple[OpenLoopInsertion, ...]:
        return (OpenLoopInsertion(0.9, error_mm <= 1.5, error_mm),)

    size = Estimate(0.1 * (seed + 1), 0.01, 0.05, 0.5, "", identified=True)
    return Round(
        HIDDEN[0].name, (seed,), (Verdict.AMBIGUOUS, Verdict.NAMED), ("fast",),
        (NamedEffect("gravity", {"size": size}),),
        inserted(before_mm), inserted(after_mm), inserted(0.4),
    )  # fmt: skip


def test_statistics_of_rounds() -> None:
    rounds = [a_round(0, 4.0, 0.5), a_round(1, 6.0, 2.5), a_round(2, 1.0, 0.6)]
    found = summarized(HIDDEN[0], rounds)
    assert (found.verdicts, found.named, found.motions) == ({Verdict.NAMED: 3}, {("gravity",): 3}, {"fast": 3})
    assert found.parameters["gravity.size"].value == pytest.approx(0.2)
    assert (found.before.error_mm, found.after.error_mm, found.known.error_mm) == (4.0, 0.6, 0.4)
    assert (found.before.gap, found.after.gap) == pytest.approx((0.9 - 1 / 3, 0.9 - 2 / 3))
    whole = total([found, replace(found, after=found.before)], rounds)
    assert whole.gap == pytest.approx((2 * found.before.gap, found.before.gap + found.after.gap, 2 * found.known.gap))
    assert whole.error_mm == (4.0, 0.6, 0.4)


def test_a_reduction_is_relative_to_the_gap() -> None:
    assert reduction(4.0, 1.0) == 0.75
    assert reduction(4.0, 1.0, 0.5) == pytest.approx(1 - 0.5 / 3.5)
    assert reduction(4.0, 6.0) == -0.5
    assert reduction(0.0, 1.0) is None
    assert math.isclose(reduction(0.9, 0.9) or 0.0, 0.0)
