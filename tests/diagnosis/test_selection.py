"""Several effects at once: independent effects, joint trials, and effects that others make redundant."""

from __future__ import annotations

from dataclasses import replace

import pytest

from needleplan.diagnosis import FittedEffect, Library, RoundOutcome, Verdict, diagnose, selection
from needleplan.diagnosis.alternatives import validate
from needleplan.diagnosis.calibration import Calibration, calibrate
from needleplan.diagnosis.data import fit_axes
from needleplan.diagnosis.joint_fit import fit_jointly
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.models import Channel
from needleplan.models.effects import effect_named, effects_of
from needleplan.signals import Role
from tests.diagnosis.trials import BASE, recordings

LIBRARY = Library(effects_of(Channel.FORCE), BASE)
TRUE = {"viscous": {"size": 2e-4}, "bias": {"size": 0.03}}


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    data = recordings(TRUE, seed=11)
    by = {role: [each for each in data if each.role is role] for role in Role}
    noise = fit_axes([[each["force_n"] for each in by[Role.NOISE]]])
    return calibrate(BASE, by[Role.TRAIN], by[Role.HOLDOUT], noise)


def fitted(calibration: Calibration, *names: str):  # type: ignore[no-untyped-def]
    base = JointLikelihood([trial.whitened for trial in calibration.training])
    return fit_jointly([FittedEffect(effect_named(name), TRUE[name]) for name in names], calibration, base)


@pytest.mark.slow
def test_two_effects_with_equal_gains_are_no_tie() -> None:
    # One effect is at two places, and as strong at each: neither explains the other.
    hidden = {"bump": {"size": 0.12, "depth_mm": 20.0, "width_mm": 1.5}, "bias": {"size": 0.05}}
    found = diagnose(BASE, recordings(hidden, seed=6), library=LIBRARY)
    assert found.verdict is Verdict.NAMED
    assert set(found.names) == set(hidden)


@pytest.mark.slow
def test_one_effect_at_two_places_has_one_name() -> None:
    data = recordings({"bump": {"size": 0.15, "depth_mm": 20.0, "width_mm": 1.5}}, seed=8)
    twice = recordings({"bump": {"size": 0.15, "depth_mm": 48.0, "width_mm": 1.5}}, seed=8)
    plain = recordings(None, seed=8)
    both = [
        each.with_column("force_n", each["force_n"] + other["force_n"] - none["force_n"])
        if each.role is not Role.NOISE else each
        for each, other, none in zip(data, twice, plain, strict=True)
    ]  # fmt: skip
    found = diagnose(BASE, both, library=LIBRARY)
    assert found.names == ("bump",)
    assert sorted(each.values["depth_mm"] for each in found.effects) == pytest.approx([20.0, 48.0], abs=0.5)


def test_validation_beside_an_effect_adds_to_its_own(calibration: Calibration) -> None:
    alone, both = fitted(calibration, "bias"), fitted(calibration, "bias", "viscous")
    whole, further = validate(both, calibration), validate(both, calibration, alone)
    first = validate(alone, calibration)
    assert whole is not None
    assert further is not None
    assert first is not None
    # The likelihood of the held-out trials goes up in two steps, or at once.
    assert first.likelihood_gain + further.likelihood_gain == pytest.approx(whole.likelihood_gain, abs=1.0)
    assert further.achieved > 0.5 * further.predicted > 0
    assert further.before_rms == pytest.approx(first.after_rms, rel=1e-3)


@pytest.mark.slow
def test_each_effect_of_a_set_has_the_required_gain() -> None:
    hidden = {"viscous": {"size": 3e-4}, "puncture": {"size": 0.4, "depth_mm": 40.0, "bulge_mm": 2.0}}
    found = diagnose(BASE, recordings(hidden, seed=1), library=LIBRARY)
    selected = found.selection
    assert selected.joint
    assert len(selected.effects) == len(selected.joint.effects) == 2
    for member in selected.effects:
        assert member.bic_gain >= found.gates.bic_gain
        assert not member.alternatives
    # What one brings beside the other one is no more than what both bring.
    assert max(member.likelihood_gain for member in selected.effects) < selected.joint.likelihood_gain
    assert [step.outcome for step in selected.rounds[:2]] == [RoundOutcome.ACCEPTED, RoundOutcome.ACCEPTED]
    assert sum(each.share for each in found.effects) == pytest.approx(1.0)


@pytest.mark.slow
def test_an_unknown_effect_beside_a_known_one_is_not_named() -> None:
    data = [
        each if each.role is Role.NOISE else each.with_column(
            "force_n", each["force_n"] + 0.05 * (each["time_s"] > each["time_s"][0] + 9.0)
        )
        for each in recordings({"viscous": {"size": 3e-4}}, seed=12)
    ]  # fmt: skip
    found = diagnose(BASE, data, library=LIBRARY)
    assert set(found.names) <= {"viscous"}
    assert found.verdict in (Verdict.INCOMPLETE, Verdict.UNKNOWN)


@pytest.mark.slow
def test_a_remaining_effect_may_still_be_tied(calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    # Two were found, one of them needless, and the other one has a rival: then neither name is given.
    joint = fitted(calibration, "bias")
    alternative = FittedEffect(effect_named("drift"), {"size": 1e-3})
    only = replace(
        joint.newest, likelihood_gain=joint.likelihood_gain, bic_gain=20.0, p_value=1e-6, alternatives=(alternative,)
    )
    monkeypatch.setattr(selection, "_prune", lambda search, rounds: (joint, (only,), False))  # noqa: ARG005
    found = diagnose(BASE, recordings(TRUE, seed=11), library=LIBRARY)
    assert found.verdict is not Verdict.NAMED
    assert found.names == ()
    assert found.selection.rounds[-1].outcome is RoundOutcome.TIE
    assert set(found.selection.rounds[-1].tied) == {"bias", "drift"}


@pytest.mark.slow
def test_a_tie_is_not_broken_by_an_order() -> None:
    # Of two names for the same columns neither is better; the third effect is found beside whichever.
    same = replace(effect_named("bias"), name="offset")
    library = Library([*effects_of(Channel.FORCE), same], BASE)
    hidden = {"bias": {"size": 0.05}, "puncture": {"size": 0.5, "depth_mm": 40.0, "bulge_mm": 2.0}}
    found = diagnose(BASE, recordings(hidden, seed=9), library=library)
    assert found.verdict is Verdict.INCOMPLETE
    assert found.names == ("puncture",)
    assert set(found.decision.tied) == {"bias", "offset"}
