"""Several effects at once: what is no rival, what is only tried together, and what the others make needless."""

from __future__ import annotations

from dataclasses import replace

import pytest

from needleplan.diagnosis import Library, Verdict, diagnose, select
from needleplan.diagnosis.calibrate import Calibration, calibrate
from needleplan.diagnosis.noise import fit_axes
from needleplan.diagnosis.refit import Added, refit
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.step import Stop
from needleplan.diagnosis.verify import verify
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
    base = Space([case.block for case in calibration.training])
    return refit([Added(effect_named(name), TRUE[name]) for name in names], calibration, base)


@pytest.mark.slow
def test_two_effects_that_bring_as_much_are_no_rivals() -> None:
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
    assert sorted(each.added.values["depth_mm"] for each in found.effects) == pytest.approx([20.0, 48.0], abs=0.5)


def test_what_holds_beside_another_effect_is_weighed_beside_it(calibration: Calibration) -> None:
    alone, both = fitted(calibration, "bias"), fitted(calibration, "bias", "viscous")
    whole, further = verify(both, calibration), verify(both, calibration, alone)
    first = verify(alone, calibration)
    assert whole is not None
    assert further is not None
    assert first is not None
    # The likelihood of the held-out trials goes up in two steps, or at once.
    assert first.gain + further.gain == pytest.approx(whole.gain, abs=1.0)
    assert further.kept > 0.5 * further.promised > 0
    assert further.before_rms == pytest.approx(first.after_rms, rel=1e-3)


@pytest.mark.slow
def test_every_member_is_worth_its_place() -> None:
    hidden = {"viscous": {"size": 3e-4}, "puncture": {"size": 0.4, "depth_mm": 40.0, "bulge_mm": 2.0}}
    found = diagnose(BASE, recordings(hidden, seed=1), library=LIBRARY)
    selection = found.selection
    assert selection.joint
    assert len(selection.members) == len(selection.joint.added) == 2
    for member in selection.members:
        assert member.balance >= found.gates.balance
        assert not member.rivals
    # What one brings beside the other one is no more than what both bring.
    assert max(member.gain for member in selection.members) < selection.joint.gain
    assert [step.stop for step in selection.steps[:2]] == [Stop.ACCEPTED, Stop.ACCEPTED]
    assert sum(each.share for each in found.effects) == pytest.approx(1.0)


@pytest.mark.slow
def test_what_has_no_name_does_not_get_one_beside_others() -> None:
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
def test_one_that_is_left_may_still_be_another_one(calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    # Two were found, one of them needless, and the other one has a rival: then neither name is given.
    joint = fitted(calibration, "bias")
    rival = Added(effect_named("drift"), {"size": 1e-3})
    members = (select.Member(joint.gain, 20.0, 1e-6, (rival,)),)
    monkeypatch.setattr(select, "_pruned", lambda search, steps: (joint, members, False))  # noqa: ARG005
    found = diagnose(BASE, recordings(TRUE, seed=11), library=LIBRARY)
    assert found.verdict is not Verdict.NAMED
    assert found.names == ()
    assert found.selection.steps[-1].stop is Stop.TIE
    assert set(found.selection.steps[-1].tied) == {"bias", "drift"}


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
