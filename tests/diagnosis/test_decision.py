"""The answer from posteriors that are written by hand."""

import math
from types import SimpleNamespace

import pytest

from needleplan.diagnosis import Ranked, Settings, Verdict, _constants, decide
from needleplan.diagnosis._constants import CONSTANTS
from needleplan.diagnosis._diagnose import at_bound
from needleplan.diagnosis._posterior import Posterior
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.diagnosis.channels import GapAxis
from needleplan.errors import DataError
from needleplan.models.effects import effect_named

DEPTH, SPEED, TIME = GapAxis.DEPTH, GapAxis.SPEED, GapAxis.TIME


def answer(*ranked: Ranked, **more):
    assert sum(each.probability for each in ranked) == pytest.approx(1.0)
    return decide(ranked, Settings(), **more)


def test_none_is_answered_only_if_nothing_is_certain():
    ranked = Ranked(0.93, ()), Ranked(0.05, ("viscous",)), Ranked(0.02, ("bias",))
    assert answer(*ranked).verdict is Verdict.NONE
    assert answer(*ranked, powered=False).verdict is Verdict.UNDERPOWERED


def test_a_function_in_front_that_is_not_certain_is_no_sign_that_nothing_is_missing():
    ranked = Ranked(0.48, (), SPEED), Ranked(0.3, ("viscous",)), Ranked(0.2, ("relaxation",)), Ranked(0.02, ())
    found = answer(*ranked)
    assert (found.verdict, found.names) == (Verdict.AMBIGUOUS, ())
    assert found.tied == ((), ("viscous",), ("relaxation",))


def test_nothing_in_front_without_certainty_is_underpowered():
    found = answer(Ranked(0.6, ()), Ranked(0.3, ("viscous",)), Ranked(0.1, ("bias",)))
    assert (found.verdict, found.names) == (Verdict.UNDERPOWERED, ())
    assert found.probability == pytest.approx(0.6)


def test_an_effect_in_front_without_certainty_is_ambiguous():
    found = answer(Ranked(0.15, ()), Ranked(0.8, ("bristle",)), Ranked(0.05, ("bias",)))
    assert (found.verdict, found.names) == (Verdict.AMBIGUOUS, ())


def test_a_set_is_named_from_its_probability_with_and_without_a_component():
    found = answer(Ranked(0.7, ("viscous",)), Ranked(0.25, ("viscous",), DEPTH), Ranked(0.05, ()))
    assert (found.verdict, found.names) == (Verdict.NAMED, ("viscous",))
    assert found.probability == pytest.approx(0.95)


def test_effects_that_may_be_what_is_left_of_another_law_of_the_base_are_not_named():
    ranked = Ranked(0.97, ("viscous",)), Ranked(0.03, ())
    laws = {"friction reverses": 10.0}  # nats, more than log(0.97 / 0.03)
    found = answer(*ranked, laws=laws)
    assert (found.verdict, found.names, found.tied[0]) == (Verdict.AMBIGUOUS, (), ("viscous",))
    assert "friction reverses by another law" in found.because
    assert found.other_laws == ("friction reverses",)
    assert answer(Ranked(0.97, ()), Ranked(0.03, ("viscous",)), laws=laws).verdict is Verdict.NONE


def test_effects_that_lead_by_more_than_another_law_of_the_base_are_named_beside_it():
    laws = {"friction reverses": 5.0}
    ranked = Ranked(0.97, ("bias", "viscous")), Ranked(0.03 - 1e-6, ("bias",)), Ranked(1e-6, ())
    found = answer(*ranked, laws=laws)
    assert (found.verdict, found.names, found.other_laws) == (Verdict.INCOMPLETE, ("bias",), ())
    assert found.because.endswith("may be what is left of the base: viscous")
    assert answer(*ranked, laws={"friction reverses": 3.0}).verdict is Verdict.NAMED


def test_a_component_along_another_axis_is_missing_too():
    found = answer(Ranked(0.1, ("viscous",)), Ranked(0.9, ("viscous",), DEPTH))
    assert (found.verdict, found.names, found.axis) == (Verdict.INCOMPLETE, ("viscous",), DEPTH)


def test_a_component_alone_is_an_unknown_gap_along_its_axis():
    found = answer(Ranked(0.5, (), TIME), Ranked(0.2, (), DEPTH), Ranked(0.25, ("drift",)), Ranked(0.05, ()))
    assert (found.verdict, found.axis) == (Verdict.UNKNOWN, TIME)
    assert found.probability == pytest.approx(0.7)


def test_a_family_of_sets_is_ambiguous():
    found = answer(Ranked(0.55, ("drift",)), Ranked(0.43, ("thermal_drift",)), Ranked(0.02, ()))
    assert found.verdict is Verdict.AMBIGUOUS
    assert found.tied[:2] == (("drift",), ("thermal_drift",))
    assert found.family == ("drift", "thermal_drift")


def test_a_certain_effect_is_named_although_a_companion_is_possible():
    found = answer(Ranked(0.62, ("tissue_motion",)), Ranked(0.33, ("latency", "tissue_motion")), Ranked(0.05, ()))
    assert (found.verdict, found.names) == (Verdict.NAMED, ("tissue_motion",))
    assert found.probability == pytest.approx(0.95)


def test_a_probable_companion_makes_a_certain_effect_incomplete():
    found = answer(Ranked(0.62, ("latency", "tissue_motion")), Ranked(0.38, ("tissue_motion",)))
    assert (found.verdict, found.names) == (Verdict.INCOMPLETE, ("tissue_motion",))


def test_one_certain_effect_of_an_uncertain_set_is_incomplete():
    found = answer(Ranked(0.6, ("bias", "viscous")), Ranked(0.35, ("bias", "stribeck")), Ranked(0.05, ("stribeck",)))
    assert (found.verdict, found.names) == (Verdict.INCOMPLETE, ("bias",))


def test_a_bound_and_a_contradicting_trial_are_reported():
    ranked = Ranked(0.97, ("relaxation",)), Ranked(0.03, ())
    found = answer(*ranked, at_bound={"relaxation": "time_s", "drift": "size"})
    assert (found.verdict, found.names) == (Verdict.IMPLAUSIBLE, ())
    assert found.because == "at the end of its range: relaxation.time_s"
    assert answer(*ranked, at_bound={"drift": "size"}).names == ("relaxation",)
    found = answer(*ranked, contradiction="trial 2 lacks relaxation")
    assert (found.verdict, found.names) == (Verdict.AMBIGUOUS, ())
    assert found.because == "relaxation: trial 2 lacks relaxation"


def test_every_constant_states_unit_effect_and_reason():
    described = Settings().described()
    assert len(described) <= 15
    assert all(each.unit and each.effect and each.reason for each in described)


def test_the_table_of_constants_has_the_names_that_the_modules_import():
    declared = {name for name in _constants.__all__ if name.isupper()} - {"CONSTANTS"}
    assert [each.name for each in CONSTANTS if each.name not in declared or not (each.effect and each.reason)] == []
    assert len(CONSTANTS) == len(declared)
    assert all(getattr(_constants, each.name) is each.value for each in CONSTANTS)


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("named", 1.0, "above 0 and at most 0.999999999"),
        ("any_effect", 0, "above 0 and at most 0.999999999"),
        ("base_law", -0.1, "at least 0"),
        ("law_tolerance", math.nan, "at least 0"),
        ("other_law", 0.5, "at least 1"),
        ("rate_hz", 0.0, "above 0"),
        ("relevant", None, "at least 0"),
        ("further_cause", True, "above 0 and at most 0.999999999"),
    ],
)
def test_a_constant_out_of_its_range_is_refused(name: str, value: object, rule: str) -> None:
    with pytest.raises(DataError) as refused:
        Settings(**{name: value})  # type: ignore[arg-type]
    assert str(refused.value).startswith(f"Settings.{name}")
    assert str(refused.value).endswith(rule)


def test_no_name_without_the_data_that_support_one() -> None:
    ranked = [Ranked(0.99, ("viscous",)), Ranked(0.01, ())]
    found = decide(ranked, Settings(), lacks=("noise record", "held-out trial"))
    assert (found.verdict, found.names, found.tied[0]) == (Verdict.AMBIGUOUS, (), ("viscous",))
    assert found.because.endswith("do not support a name: no noise record, no held-out trial")


def test_no_probability_exceeds_one():
    found = decide([Ranked(0.6, ("viscous",)), Ranked(0.4 + 1e-13, ("viscous",), DEPTH)], Settings())
    assert found.probability == 1.0
    posterior = object.__new__(Posterior)
    object.__setattr__(posterior, "logs", {((), ""): 3e-14, (("bias",), ""): -40.0})
    assert posterior.ranked[0][0] == posterior.probability(()) == 1.0


def test_hypotheses_without_weight_are_in_the_order_of_their_evidence():
    posterior = object.__new__(Posterior)
    logs = {(("viscous",), ""): -7082.1, (("track_ageing",), ""): -7081.6, ((), "time"): 0.0}
    object.__setattr__(posterior, "logs", logs)
    assert [names for _, names, _ in posterior.ranked] == [(), ("track_ageing",), ("viscous",)]


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("backlash", {"size": 0.02}, "size"),
        ("backlash", {"size": 0.03}, None),
        ("tissue_motion", {"size": 0.1, "lag_s": 0.015, "growth": 0.0}, "lag_s"),
        ("tissue_motion", {"size": 0.1, "lag_s": 1.0, "growth": 0.0}, None),
        ("respiration", {"size": 0.1, "frequency_hz": 0.3, "phase_rad": 0.0, "rest": 1.0}, None),
        ("latency", {"size": 0.013}, None),
        ("latency", {"size": 2.0}, "size"),
    ],
)
def test_what_is_at_the_least_value_of_its_range(name: str, values: dict[str, float], expected: str | None):
    bounds = {"backlash": {"size": (0.02, 10.0)}, "tissue_motion": {"lag_s": (0.015, 1.0), "growth": (0.0, 1.0)}}
    bounds["latency"] = {"size": (0.013, 2.0)}
    fitted = FittedEffect(effect_named(name), values, bounds.get(name, {}))
    assert at_bound(SimpleNamespace(effects=[fitted])) == ({name: expected} if expected else {})
