"""The verdict for different held-out gains."""

from __future__ import annotations

from dataclasses import replace

import pytest

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose
from needleplan.diagnosis._verdict import decide
from needleplan.models import Channel
from needleplan.models.effects import effects_of
from tests.diagnosis.trials import BASE, recordings

LIBRARY = Library(effects_of(Channel.FORCE), BASE)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    made = diagnose(BASE, recordings({"viscous": {"size": 4e-4}}, seed=2), library=LIBRARY)
    assert made.verdict is Verdict.NAMED
    return made


@pytest.mark.slow
@pytest.mark.parametrize(
    ("achieved", "shrink", "verdict"),
    [
        (100.0, 0.9, Verdict.NAMED),
        (95.0, 0.3, Verdict.INCOMPLETE),  # as predicted, and another effect is present too
        (45.0, 0.3, Verdict.UNKNOWN),  # less than predicted
        (300.0, 0.3, Verdict.UNKNOWN),  # more: another effect acts alike
        (95.0, 0.05, Verdict.UNKNOWN),  # almost nothing of the gap
    ],
)
def test_an_effect_that_achieves_its_prediction_stays_named(
    found: Diagnosis, achieved: float, shrink: float, verdict: Verdict
) -> None:
    selection = found.selection
    assert selection.validation is not None
    seen = replace(selection.validation, predicted=100.0, achieved=achieved, shrink=shrink, gap_sds=20.0)
    decision = decide(replace(selection, validation=seen), found.gates, detection_limit=0.0)
    assert decision.verdict is verdict
    assert decision.named == (("viscous",) if verdict in (Verdict.NAMED, Verdict.INCOMPLETE) else ())


@pytest.mark.slow
def test_a_small_effect_of_another_family_is_found_beside_a_large_one() -> None:
    hidden = {"inertia": {"size": 8.0}, "bump": {"size": 0.085, "depth_mm": 33.0, "width_mm": 2.0}}
    made = diagnose(BASE, recordings(hidden, seed=5), library=LIBRARY)
    assert made.verdict is Verdict.NAMED
    assert set(made.names) == set(hidden)
    first, second = made.selection.effects
    assert made.gates.further_elsewhere < second.likelihood_gain / first.likelihood_gain < made.gates.further
