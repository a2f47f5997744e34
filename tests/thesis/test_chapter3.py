"""Chapter 3: checks that take seconds; the tables themselves take a minute."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.models import simulate
from needleplan.models.friction import Profile
from needleplan.reports.chapters import Effort, Request
from needleplan.reports.comparison import Agreement, Origin
from needleplan_thesis.chapter3 import chapter
from needleplan_thesis.chapter3.fits import NOISE_N, CaseFits, Generator, errors_mn, fit_case, periodic
from needleplan_thesis.chapter3.prediction import inside, predictors
from needleplan_thesis.chapter3.published import (
    CASES,
    MODEL_III_B,
    TABLE_3_5,
    Errors,
    model_ii,
    passing_through,
    pooled_mn,
)
from needleplan_thesis.chapter3.simplifications import opening, velocity_lag

pytestmark = pytest.mark.study


def test_the_columns_of_table_3_5_are_put_back_right() -> None:
    for cases in TABLE_3_5.values():
        for each in cases.values():
            assert pooled_mn(each) == pytest.approx(each.total, abs=0.5)


def test_pooling_finds_columns_that_were_exchanged() -> None:
    """The identity is no tautology: low errors of one case do not fit the totals of another."""
    wrong = [
        abs(pooled_mn(Errors(cases[a].total, cases[b].low, cases[b].high)) - cases[a].total)
        for cases in TABLE_3_5.values()
        for a in cases
        for b in cases
        if a != b
    ]
    assert np.mean(np.array(wrong) > 0.5) > 0.9


@pytest.fixture(scope="module")
def fits() -> list[CaseFits]:
    return [fit_case(case, Generator.III_B, 20.0, (0.5, 5.0), case) for case in CASES]


@pytest.mark.parametrize("case", CASES)
def test_the_order_of_the_errors(fits: list[CaseFits], case: int) -> None:
    total = {label: fits[case - 1].errors(label).total for label in TABLE_3_5}
    assert total["III-B"] < total["II"] < total["I"] <= total["Karnopp"] + 0.01
    assert 14 < total["III-B"] < 25
    assert 14 < total["II"] < 25


@pytest.mark.parametrize("case", CASES)
def test_parameters_come_back(fits: list[CaseFits], case: int) -> None:
    assert fits[case - 1].exponent == 5.0
    for name, each in fits[case - 1].fits["III-B"].estimates.items():
        assert each.low <= MODEL_III_B[case][name].mean <= each.high or each.value == pytest.approx(
            MODEL_III_B[case][name].mean, abs=4 * each.sd
        )


def test_the_errors_of_the_parts_pool(fits: list[CaseFits]) -> None:
    for each in fits:
        errors = each.errors("Karnopp")
        assert pooled_mn(errors) == pytest.approx(errors.total, rel=0.02)


def test_data_from_the_lumped_model_prefer_it() -> None:
    found = fit_case(2, Generator.II, 20.0, (5.0,), 0)
    assert found.errors("II").total <= found.errors("III-B").total


@pytest.mark.parametrize("generator", Generator)
def test_the_noise_has_its_standard_deviation(generator: Generator) -> None:
    record = periodic(2, generator, 50.0, 3)
    residual = record["force_n"] - simulate(model_ii(2), passing_through(2, rate_hz=50.0)).output
    assert residual.std() >= 0.95 * NOISE_N
    if generator is Generator.II:
        assert residual.std() == pytest.approx(NOISE_N, rel=0.05)
        assert errors_mn(model_ii(2), record).total == pytest.approx(1e3 * NOISE_N, rel=0.05)


@pytest.mark.parametrize("profile", ["solid", "dashed"])
@pytest.mark.parametrize("case", [1, 2])
def test_friction_that_is_frozen_at_the_middle_has_the_published_error(case: int, profile: str) -> None:
    clean = inside(case, profile, hidden=False, rate_hz=100.0)
    errors = {label: clean.error_mn(model) for label, model in predictors(case).items()}
    assert 55 < errors["II"] < 85
    assert 55 < errors["I"] < 85
    assert errors["II, Fn = 1 N"] > 150
    assert max(errors["III-A"], errors["III-B"], errors["II, Fn(L)"]) < errors["II"] / 2


def test_hidden_effects_are_where_they_belong() -> None:
    insertion = inside(2, "solid", rate_hz=100.0)
    force, friction = insertion.record["force_n"], insertion.friction_n
    left = force - friction - insertion.cutting_n
    assert left.std() > NOISE_N
    assert insertion.cutting_n[insertion.major].min() >= 0.1
    assert not insertion.cutting_n[insertion.motion.velocity_mm_s <= 0].any()


def test_a_late_velocity_stiffens_the_bristles() -> None:
    bias = [each.ours for each in velocity_lag(lambda _: None)]
    none, averaged, late, both = (float(each) for each in bias if isinstance(each, float))
    assert abs(none) < 3
    assert -20 < averaged < -5
    assert late > 100
    assert -30 < both < -5


def test_the_opening_of_a_loop() -> None:
    angle = np.linspace(0, 6 * np.pi, 3000)
    assert opening(np.sin(angle), np.cos(angle)) == pytest.approx(2, abs=1e-3)
    assert opening(np.sin(angle), np.sin(angle)) == pytest.approx(0, abs=1e-3)


def test_the_chapter_runs_and_draws(tmp_path: Path) -> None:
    notes: list[str] = []
    rows = chapter.run(Request(tmp_path, Effort.QUICK, notes.append))
    assert len({each.id for each in rows}) == len(rows) > 150
    assert all(each.source.startswith("thesis, ") for each in rows if each.origin is Origin.THESIS)
    assert {each.id.split("/")[1].split(",")[0] for each in rows} >= {f"Table 3.{n}" for n in range(1, 7)}
    assert all(each.reason for each in rows if each.verdict in (Agreement.DIFFERS, Agreement.NOT_REPRODUCED))
    assert {each.name for each in tmp_path.iterdir()} == {
        "fig_3_3_profiles.png", "fig_3_5_loops.png", "fig_3_6_prediction.png", "fig_3_7_tissue.png",
    }  # fmt: skip
    assert notes
    assert predictors(1)["III-A"].profile is Profile.RIGHT
