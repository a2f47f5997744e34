"""The scoring of the benchmark, against counts by hand; and a few blind data sets, diagnosed and scored."""

from __future__ import annotations

import importlib
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.blind.campaign import MOTIONS, Case, Purpose, Stratum, Variety
from tests.blind.effect import ForceName
from tests.blind.force import ForceSpec, Wanted

BENCHES = Path(__file__).parents[2] / "benches" / "python"
SEEDS = count(1)


@pytest.fixture(scope="module", autouse=True)
def _benches_are_found() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHES)
        yield


@pytest.fixture(scope="module")
def score() -> ModuleType:
    return importlib.import_module("diagnosis_score")


def line(stratum: str, verdict: str, names: list[str], truth: list[tuple[str, float]], **other: Any) -> dict[str, Any]:
    """An outcome, rich, without heterogeneity; the base leaves of each effect a hundred times its size."""
    hidden = [{"name": name, "size": size, "rms": 0.03 * size, "noncentrality": 100 * size, "parameters": {"size": 1.0}}
              for name, size in truth]  # fmt: skip
    effects = [{"name": name, "rms": 0.03, "estimates": {"size": [1.1, 0.9, 1.3]}} for name in names]
    return {
        "seed": next(SEEDS), "stratum": stratum, "variety": "rich", "heterogeneity": 0.0, "never_tuned": False,
        "truth": hidden, "verdict": verdict, "names": names, "effects": effects, "axis": None, "true_axis": None,
        "level": 0.0, "shrink": 0.9, "failure": "", "cpu_s": 1.0, "wall_s": 2.0,
    } | other  # fmt: skip


def test_counts_are_those_by_hand(score: ModuleType) -> None:
    found = score.summary([
        *(line("null", "none", [], []) for _ in range(19)),
        line("null", "named", ["bias"], []),
        line("single", "named", ["viscous"], [("viscous", 2.0)]),
        line("single", "named", ["bias"], [("viscous", 3.0)]),
        line("single", "named", ["bump", "bump"], [("bump", 3.0)]),  # one hidden effect, several bumps
        line("single", "underpowered", [], [("viscous", 0.2)]),
        line("single", "incomplete", ["viscous"], [("viscous", 1.0)]),
        line("pair", "named", ["bias", "viscous"], [("viscous", 1.0), ("bias", 2.0)]),
        line("pair", "incomplete", ["bias"], [("viscous", 1.0), ("bias", 2.0)]),
        line("pair", "named", ["drift"], [("viscous", 1.0), ("bias", 9.0)]),  # not within a factor of four
        line("outside", "unknown", [], [("slip_step", 1.0)], axis="time", true_axis="time"),
        line("outside", "unknown", [], [("buckling", 1.0)], axis="time", true_axis="force"),
        line("outside", "named", ["bias"], [("gain_curve", 1.0)]),
        line("outside", "named", ["bias"], [("gain_curve", 0.2)]),  # too small to count
    ])  # fmt: skip
    nulls, singles, pairs, outside = (
        found["null"]["rich 0"],
        found["single"]["rich 0"],
        found["pair"]["0"],
        found["outside"]["all"],
    )

    def hits(each: dict[str, Any]) -> tuple[int, int]:
        return each["hits"], each["of"]

    assert hits(nulls["falsely_named"]) == (1, 20)
    assert nulls["names"] == {"bias": 1}
    assert hits(singles["right"]) == (2, 4)
    assert hits(singles["wrong"]) == (1, 4)
    assert hits(singles["detected"]) == (4, 4)
    assert hits(pairs["exact"]) == (1, 2)
    assert hits(pairs["strongest"]) == (2, 2)
    assert hits(outside["declined"]) == (2, 3)
    assert hits(outside["right_axis"]) == (1, 2)
    assert hits(found["coverage"]["0"]["parameters"]) == (2, 2)
    assert found["confusion"]["viscous"] == {"viscous": 1, "bias": 1, "INCOMPLETE": 1}


def test_bounds_of_a_share(score: ModuleType) -> None:
    none = score.rate(0, 300)
    assert none["high"] == pytest.approx(1 - 0.025 ** (1 / 300))
    assert score.rate(300, 300)["low"] == pytest.approx(0.025 ** (1 / 300))
    assert score.rate(0, 0)["rate"] is None


@pytest.mark.slow
def test_a_part_of_a_run_has_its_goals_and_its_page(score: ModuleType, tmp_path: Path) -> None:
    goals, page = importlib.import_module("diagnosis_goals"), importlib.import_module("diagnosis_page")
    found = score.summary([line("null", "none", [], []), line("single", "named", ["bias"], [("bias", 2.0)])])
    judged = goals.goals(found, 3.0)
    reached = {each.what: each.reached for each in judged}
    assert reached["named and right, from 1 noise RMS, rich motion, 0 % heterogeneity"] is True
    assert reached["two effects, 0 %: exact set"] is None
    run = {"done": 2, "wanted": 9, "purpose": "tuning", "engine": "e", "channel": "force", "large": 1.0}
    report = {"run": run, "machine": {"commit": "c", "date": "d", "processor": "p"}, "summary": found}
    assert "A part of the run" in page.page(report, judged, "x")
    page.draw(found, tmp_path / "x")
    assert {each.name for each in tmp_path.iterdir()} == {"x_power.png", "x_confusion.png"}


@pytest.mark.study
def test_a_blind_data_set_of_a_seed_that_belongs_to_nobody(score: ModuleType) -> None:
    """One data set, far above the noise, through the whole bench: the campaign itself takes hours."""
    bench = importlib.import_module("diagnosis_case").Bench()
    hidden = ForceSpec(401, (Wanted(ForceName.VISCOUS, 3.0),), 0.0, *MOTIONS[Variety.RICH])
    found = score.summary([bench.outcome(Case(Purpose.TUNING, Stratum.SINGLE, Variety.RICH, hidden))])
    assert not found["failures"]
    assert found["single"]["rich 0"]["right"]["hits"] == 1
