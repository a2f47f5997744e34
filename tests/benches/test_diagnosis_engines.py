"""The table that compares engines of the diagnosis: cases of both generators, counts of right and wrong answers."""

import sys
from pathlib import Path

import pytest

BENCHES = Path(__file__).parents[2] / "benches" / "python"


@pytest.fixture(scope="module", autouse=True)
def on_path():
    sys.path.insert(0, str(BENCHES))
    yield
    sys.path.remove(str(BENCHES))


def line(stratum, truth, names, **more):
    verdict = more.pop("verdict", "named" if names else "none")
    return {
        "key": "k", "stratum": stratum, "motion": "rich", "heterogeneity": 0.0, "failure": "", "axes": [],
        "truth": [{"name": name, "noncentrality": value, "parameters": {"size": 1.0}} for name, value in truth],
        "verdict": verdict, "names": names, "axis": None, "probability": None, "estimates": {}, "shrink": None,
        "cpu_s": 1.0, "rate_hz": 50, **more,
    }  # fmt: skip


def test_the_same_draw_gives_the_same_cases_of_the_tuning_seeds():
    from diagnosis_engines_case import draw

    first = [case.key for case in draw("first", 30, 3, None, None)]
    assert first == [case.key for case in draw("first", 30, 3, None, None)]
    assert len(set(first)) == 30
    assert all(10_000_000 <= int(key.split()[1]) < 20_000_000 for key in first)


def test_a_case_of_the_second_generator_is_diagnosed_with_its_own_base_model():
    from diagnosis_engines_case import draw

    case = next(iter(draw("second", 3, 5, ["single"], "rich")))
    model, records, hidden, _ = case.make()
    assert [str(each.role) for each in records].count("train") >= 2
    assert len(hidden) == 1
    assert 0.02 < model.friction < 0.06


def test_other_base_laws_change_the_force_and_keep_the_effects_of_the_tuning_seeds():
    import numpy as np
    import tuning_base_laws
    from diagnosis_engines_case import draw

    cases = list(draw("tuning_base_laws", 40, 1, None, None))
    assert {case.facts["stratum"] for case in cases} == set(tuning_base_laws.STRATA)
    laws = [tuning_base_laws.BaseLaw.drawn(seed) for seed in range(20)]
    assert {each.friction for each in laws} == set(tuning_base_laws.FRICTION_LAWS)
    assert {each.cutting for each in laws} == set(tuning_base_laws.CUTTING_LAWS)
    assert {each.scenery.law for each in laws} > {"dahl", "soft"}
    model, records, hidden, _ = cases[0].make()
    assert model == tuning_base_laws.nominal(tuning_base_laws.spec("null", 1))
    assert not hidden
    assert all(np.isfinite(each["force_n"]).all() for each in records)


def test_rows_count_right_and_wrong_answers():
    from diagnosis_engines_table import rows

    lines = [
        line("null", [], []),
        line("null", [], ["drift"]),
        line("single", [("viscous", 100.0)], ["viscous"], estimates={"viscous": {"size": [1.1, 0.9, 1.3]}}),
        line("single", [("viscous", 100.0)], ["stribeck"]),
        line("single", [("viscous", 50.0)], []),
        line("pair", [("viscous", 200.0), ("bias", 900.0)], ["bias"]),
        line("outside", [("slip", 400.0)], [], verdict="unknown", axis="time", axes=["time"]),
    ]
    found = {name: value for name, _, value in rows(lines)}
    assert found["nothing hidden, rich: false names"].startswith("1 of 2,")
    assert found["single, noncentrality >= 70, rich, 0%: right"].startswith("1 of 2,")
    assert found["the same, all heterogeneities: wrong"].startswith("1 of 2,")
    assert found["pairs, both >= 100: exact"].startswith("0 of 1,")
    assert found["pairs, both >= 100: strongest"].startswith("1 of 1,")
    assert found["outside, unknown: right axis"].startswith("1 of 1,")
    assert found["95 % intervals hold the truth"].startswith("1 of 1,")
