"""The curvature that is left of a needle that turns while it is inserted."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.errors import DataError
from needleplan.identification.duty_cycle import SHARE, curvature_by_duty, identify, scenario_with_share
from needleplan.recording import read_records, write_records
from needleplan.scenario import Scenario
from needleplan.signals import Array, Record, Role
from tests.conftest import SMALL
from tests.identification.arcs import arc, white

A_PER_MM, LEFT = 1 / 150, 0.12
DUTIES = (0.0, 0.0, 0.5, 0.5, 1.0, 1.0)


def law(duty: float, left: float = LEFT) -> float:
    return A_PER_MM * (1 - duty + duty * left)


def trial(number: int, duty: float, curvature: float, random: np.random.Generator) -> Record:
    points = arc(curvature, 80) + white(random, 80)
    columns = {
        "time_s": np.arange(80) / 10,
        "x_mm": points[:, 0],
        "y_mm": points[:, 1],
        "duty_cycle": np.full(80, duty),
    }
    return Record(columns, f"trial {number}")


def insertions(seed: int = 1, duties: tuple[float, ...] = DUTIES, scatter: float = 0.02) -> list[Record]:
    random = np.random.default_rng(seed)
    return [
        trial(number, duty, law(duty) + scatter * A_PER_MM * random.standard_normal(), random)
        for number, duty in enumerate(duties)
    ]


def test_the_share_is_found_with_its_interval() -> None:
    found = identify(insertions())
    share = found.estimates[SHARE]
    assert share.identified
    assert share.low < LEFT < share.high
    assert share.value == pytest.approx(LEFT, abs=0.05)
    half = identify(insertions(), duty=0.5).estimates[SHARE]
    assert half.value == pytest.approx(0.5 + 0.5 * share.value)
    assert half.low == pytest.approx(0.5 + 0.5 * share.low)


@pytest.mark.parametrize("scatter", [0.0, 0.08])
def test_intervals_hold_the_truth_as_often_as_they_say(scatter: float) -> None:
    """Nine insertions whose errors differ by up to 1 : 5, 600 times: 92 to 98 %, and three standard deviations more."""
    random = np.random.default_rng(5)
    duty = np.repeat([0.0, 0.4, 1.0], 3)
    sd = A_PER_MM * np.tile([0.01, 0.02, 0.05], 3)
    held = np.zeros(3)
    for _ in range(600):
        k = np.array([law(each) for each in duty]) + np.hypot(sd, scatter * A_PER_MM) * random.standard_normal(9)
        fit = curvature_by_duty(duty, k, sd)
        share, plain = fit.share(1.0), fit.at(0.0)
        held += [
            share.low < LEFT < share.high,
            plain.low < A_PER_MM < plain.high,
            fit.bend is not None and fit.bend[1] > 0.05,
        ]
    slack = 3 * np.sqrt(0.98 * 0.02 * 600)
    assert np.all((held >= 0.92 * 600) & (held <= 0.98 * 600 + slack)), held


def test_the_interval_of_the_share_is_where_the_difference_may_be_zero() -> None:
    """Fieller's interval by trying: q is in it if B - q A may be zero."""
    random = np.random.default_rng(2)
    k = np.array([law(each) for each in DUTIES]) + 0.1 * A_PER_MM * random.standard_normal(6)
    fit = curvature_by_duty(np.array(DUTIES), k, np.full(6, 0.05 * A_PER_MM))
    tried = np.linspace(-3, 3, 60_001)
    apart = [fit.law.combination([-q, 1.0]).interval() for q in tried]
    inside = tried[[low <= 0 <= high for low, high in apart]]
    share = fit.share(1.0)
    assert share.low == pytest.approx(inside.min(), abs=2e-4)
    assert share.high == pytest.approx(inside.max(), abs=2e-4)


def test_a_fall_that_is_not_linear_is_said() -> None:
    duty = np.repeat([0.0, 0.5, 1.0], 3)
    fit = curvature_by_duty(duty, A_PER_MM * (1 - duty**3), np.full(9, 0.01 * A_PER_MM))
    assert fit.bend is not None
    score, p_value = fit.bend
    assert score > 0
    assert p_value < 1e-3


def test_a_straight_needle_has_no_share() -> None:
    random = np.random.default_rng(3)
    found = identify([trial(number, duty, 0.0, random) for number, duty in enumerate(DUTIES)])
    assert not found.ok
    assert any("the path may be straight" in each for each in found.remarks)
    with pytest.raises(DataError, match="is not identified"):
        scenario_with_share(found, Scenario.from_toml(SMALL))


def test_a_trial_held_out_judges() -> None:
    random = np.random.default_rng(4)
    like, unlike = (
        replace(trial(number, 0.5, law(0.5, left), random), role=Role.HOLDOUT)
        for number, left in ((10, LEFT), (11, 0.9))
    )
    found = identify([*insertions(), like, unlike])
    values = {each.name: each.p_value or 0.0 for each in found.findings}
    assert values["held out, trial 10"] > 0.05 > values["held out, trial 11"]


@pytest.mark.parametrize(
    ("column", "message"),
    [
        (None, "duty_cycle: is missing"),
        (np.linspace(0, 1, 80), "duty_cycle = 0 to 1: must be one number"),
        (np.full(80, 1.5), "duty_cycle = 1.5 to 1.5: must be one number from 0 to 1"),
        (np.full(80, np.nan), "duty_cycle = no number: must be one number"),
    ],
)
def test_duty_cycles_that_cannot_be(column: Array | None, message: str) -> None:
    record = insertions()[0]
    columns = {name: each for name, each in record.columns.items() if name != "duty_cycle"}
    with pytest.raises(DataError, match=message):
        identify([replace(record, columns=columns | ({} if column is None else {"duty_cycle": column}))])


@pytest.mark.parametrize("duties", [(0.0, 0.5), (0.0, 0.0, 0.0)])
def test_too_few_insertions_are_refused(duties: tuple[float, ...]) -> None:
    with pytest.raises(DataError, match="at least three insertions with two different duty cycles"):
        identify(insertions(duties=duties))


@pytest.mark.slow
def test_from_a_file_to_a_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_records(insertions(), "trials.csv")
    Path("small.toml").write_text(SMALL)
    arguments = ["identify", "duty-cycle", "trials.csv", "--scenario", "small.toml", "--scenario-out", "new.toml"]
    assert main([*arguments, "--figure", "line.png"]) == 0
    said = capsys.readouterr().out
    share = Scenario.read("new.toml").motion.straight_curvature_share
    assert share == pytest.approx(identify(read_records(["trials.csv"])).estimates[SHARE].value, rel=1e-3)
    assert f"straight_curvature_share = {share}" in said
    assert Path("line.png").stat().st_size > 1000
    assert main([*arguments[:5], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scenario"]["straight_curvature_share"] == share
    assert main(["plan", "new.toml", "-o", "table.h5"]) == 0
