"""Each published table beside the sentences of the thesis about it: a number in a wrong column contradicts one."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import pytest

from needleplan.models.force import ForceModel1, ForceModel2
from needleplan.reports.comparison import Agreement, Evidence
from needleplan_thesis.chapter2.bank import TABLE_2_1
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES, TABLE_2_2
from needleplan_thesis.chapter3.published import (
    CASES,
    MODEL_I,
    MODEL_II,
    MODEL_III_B,
    TABLE_3_5,
    TABLE_3_6,
    Errors,
    pooled_mn,
)
from needleplan_thesis.chapter3.tables import statements
from needleplan_thesis.chapter5.insertions import CASES as DEFLECTIONS
from needleplan_thesis.chapter5.insertions import SENSITIVITY
from needleplan_thesis.chapter6.tables import TABLE_6_2, TABLE_6_3, VALUE_ITERATION


def contradicted(table: dict[str, dict[int, Errors]]) -> list[str]:
    """Return the sentences about Table 3.5 that do not hold in `table`."""
    rows = [row for row in statements(table) if row.published is not None]
    assert len(rows) == 8
    assert {row.kind for row in rows} == {Evidence.ARITHMETIC}
    return [row.id for row in rows if row.verdict is not Agreement.REPRODUCED]


def test_every_sentence_about_table_3_5_holds() -> None:
    assert contradicted(TABLE_3_5) == []


def test_no_other_order_of_the_cases_of_table_3_5_agrees_with_its_sentences() -> None:
    for order in permutations(CASES):
        if order != tuple(CASES):
            swapped = {
                label: dict(zip(CASES, (cases[c] for c in order), strict=True)) for label, cases in TABLE_3_5.items()
            }
            assert contradicted(swapped), order


def test_the_columns_of_a_case_of_table_3_5_belong_together() -> None:
    """Total, low and high range pool in all rows of a case; with the low range of another case they do not."""
    for cases in TABLE_3_5.values():
        for errors in cases.values():
            assert pooled_mn(errors) == pytest.approx(errors.total, abs=0.5)
    for case, other in permutations(CASES, 2):
        assert any(
            abs(pooled_mn(Errors(rows[case].total, rows[other].low, rows[case].high)) - rows[case].total) > 0.5
            for rows in TABLE_3_5.values()
        )


def table_2_2(model: str, transition: bool) -> tuple[float, float, float]:
    (row,) = [row for row in TABLE_2_2 if (row.model, row.transition) == (model, transition)]
    return row.insertion_n, row.retraction_n, row.entire_n


def test_table_2_1_goes_to_the_stated_limit() -> None:
    """Thesis: "Not much improvement ... for the diagonal magnitudes larger than 10^15"; II fixes f2 and alpha."""
    assert max(n for filters in TABLE_2_1.values() for each in filters for n in each.values()) == 15
    names = {model: {name for each in filters for name in each} for model, filters in TABLE_2_1.items()}
    assert names[ForceModel1] - names[ForceModel2] == {"f2", "alpha"}
    assert names[ForceModel2] - names[ForceModel1] == {"beta"}


def test_table_2_2_has_the_better_model_and_the_better_half() -> None:
    """Thesis: "Model II outperforms model I"; the second half is "less affected by the initial oscillatory ..."."""
    for transition in (True, False):
        pairs = zip(table_2_2("I", transition), table_2_2("II", transition), strict=True)
        assert all(second < first for first, second in pairs)
    for model in ("I", "II"):
        pairs = zip(table_2_2(model, True), table_2_2(model, False), strict=True)
        assert all(without < including for including, without in pairs)


def test_the_errors_of_chapter_2_stand_with_their_figures() -> None:
    """Thesis: "9.87mN and 7.52mN" (Fig. 2.7a, b); "9.27mN, 9.41mN, and 11.02mN, respectively" (Fig. 2.9a to c)."""
    assert {force.title: force.mae_n for force in PUBLISHED_FORCES} == pytest.approx(
        {"A/A 10 mm/s": 9.87e-3, "A/A 6 mm/s": 7.52e-3, "B/B 10 mm/s": 9.27e-3, "B/B 6 mm/s": 9.41e-3,
         "B/A 10 mm/s": 11.02e-3}
    )  # fmt: skip


def test_sigma0_has_the_most_inconsistency_and_mu_c_can_have_it() -> None:
    """Thesis: "The parameter sigma0 had the most inconsistency. Estimation of mu_c could exhibit a similar ..."."""
    widest = [
        max(parameters, key=lambda name: parameters[name].sd)
        for table in (MODEL_I, MODEL_II, MODEL_III_B)
        for parameters in table.values()
    ]
    assert set(widest) == {"sigma0", "mu_c"}
    assert widest.count("sigma0") == 10


def test_case_4_is_the_fastest_and_beyond_10_mm_s() -> None:
    """Thesis: "(for v <= -10mm/s)" is said of Fig. 3.5(c), which is case 4."""
    assert CASES[4].top_speed_mm_s == max(case.top_speed_mm_s for case in CASES.values()) > 10


def column_3_6(model: str) -> list[float]:
    return [error for profile in TABLE_3_6.values() for error in profile[model]]


def test_table_3_6_has_close_distributed_models_and_a_lumped_one_as_bad_as_the_static() -> None:
    """Thesis: III-A and III-B have "close levels of accuracy albeit version B performed slightly better"."""
    third, fourth = column_3_6("III-A"), column_3_6("III-B")
    assert sum(fourth) < sum(third)
    assert sum(b < a for a, b in zip(third, fourth, strict=True)) == 3
    for static, lumped in zip(column_3_6("I"), column_3_6("II"), strict=True):
        assert lumped == pytest.approx(static, rel=0.1)
    assert min(column_3_6("I") + column_3_6("II")) > max(third + fourth)


SLOW_A, SLOW_B, FAST_A, FAST_B = DEFLECTIONS

TABLE_5_2: dict[str, Callable[[], bool]] = {
    "this parameter was underestimated by the model in the four studied cases": lambda: all(
        case.estimated_mm < case.measured_mm for case in DEFLECTIONS
    ),
    "its percentage error varied from 8.7% (case c) to 18.72% (case d)": lambda: (
        [round(case.error_percent, 2) for case in (FAST_A, FAST_B)] == [8.7, 18.72]
        and sorted(DEFLECTIONS, key=lambda case: case.error_percent)[:: len(DEFLECTIONS) - 1] == [FAST_A, FAST_B]
    ),
    "the maximum error that occurred at the tip area in Fig. 5.2(a) was confined to 0.374mm": lambda: (
        SLOW_A.max_error_mm == max(case.max_error_mm for case in DEFLECTIONS) == 0.374
    ),
    "the model slightly outperforms for tissue B": lambda: all(
        soft.mean_error_mm > stiff.mean_error_mm and soft.max_error_mm > stiff.max_error_mm
        for soft, stiff in ((SLOW_A, SLOW_B), (FAST_A, FAST_B))
    ),
    "a higher velocity ... results in a smaller radius of curvature": lambda: all(
        fast.measured_mm < slow.measured_mm and fast.estimated_mm < slow.estimated_mm
        for slow, fast in ((SLOW_A, FAST_A), (SLOW_B, FAST_B))
    ),
    "a phantom with a lower stiffness results in a smaller radius of curvature": lambda: all(
        soft.measured_mm < stiff.measured_mm and soft.estimated_mm < stiff.estimated_mm
        for soft, stiff in ((SLOW_A, SLOW_B), (FAST_A, FAST_B))
    ),
    "the maximum insertion forces for tissues A and B were ... 0.232N and 0.276N ... at v=15mm/s": lambda: (
        [case.greatest_n for case in DEFLECTIONS] == [None, None, 0.232, 0.276]
    ),
}


@pytest.mark.parametrize("sentence", TABLE_5_2)
def test_table_5_2_agrees_with_its_sentence(sentence: str) -> None:
    assert TABLE_5_2[sentence]()


def changes(row: int) -> list[float]:
    """Return how far a row of Table 5.3 is from the error with the nominal values (%), by case."""
    return [abs(SENSITIVITY[row][column] - case.error_percent) for column, case in enumerate(DEFLECTIONS)]


def test_table_5_3_agrees_with_its_sentences() -> None:
    """More robust to kf too high than too low; less sensitive to vf too high than to kf too low; "almost 5%"."""
    stiffer, softer, more_viscous, _ = (changes(row) for row in range(4))
    assert all(high < low for high, low in zip(stiffer, softer, strict=True))
    assert all(viscous < low for viscous, low in zip(more_viscous, softer, strict=True))
    better = [SLOW_B.error_percent - SENSITIVITY[row][1] for row in (0, 3)]
    assert all(4.5 < gain < 5 for gain in better)


def test_table_6_2_agrees_with_its_sentences() -> None:
    """H2 outperforms H1; (12, 8) with H2 is the fastest; all beat 8 hours 4 minutes; tc leads in the last two rows."""
    total = {(row.partitions, row.priority): row.total_s for row in TABLE_6_2}
    for partitions in {row.partitions for row in TABLE_6_2}:
        first, second = (total[partitions, priority] for priority in ("H1", "H2"))
        assert second < first
    assert min(total, key=lambda case: total[case]) == ((12, 8), "H2")
    assert max(total.values()) < VALUE_ITERATION.seconds == 29_040
    assert [row.partitions for row in TABLE_6_2 if row.priorities_s > row.solving_s] == [(24, 16)] * 2


def test_table_6_3_agrees_with_its_sentences() -> None:
    """Thesis: "Five partitions seem to be unprocessed" of (12, 8); more partitions, "a smaller number of" states."""
    unprocessed = {columns * rows - done for (columns, rows), (done, _) in TABLE_6_3.items() if columns == 12}
    assert unprocessed == {5}
    states = [states for _, states in TABLE_6_3.values()]
    assert states == sorted(states, reverse=True)
    assert len(set(states)) == 3


def test_the_update_rate_is_roughly_updates_over_time() -> None:
    """Thesis: "8 hours and 4 minutes ... 230,519,520 single updates ... roughly 7928.5 updates per second"."""
    assert VALUE_ITERATION.updates / VALUE_ITERATION.seconds == pytest.approx(
        VALUE_ITERATION.updates_per_second, rel=2e-3
    )
