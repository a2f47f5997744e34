from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.diagnosis import Library, diagnose
from needleplan.diagnosis._diagnose import _best_sampling
from needleplan.diagnosis._screening import Screening
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models.effects import BreathingTissue, effect_named
from needleplan.models.friction import BlendedReversal
from needleplan.signals import Role
from tests.diagnosis.trials import BASE, motion, recordings

TRUTH = {"frequency_hz": 0.256, "phase_rad": 1.9, "rest": 1.0, "size": 11.0}


@given(st.floats(0.01, 20), st.floats(0.05, 0.6), st.floats(-6, 6), st.floats(-1, 1))
def test_tissue_goes_by_the_size_from_end_to_end_and_as_fast_as_it_says(
    size: float, frequency_hz: float, phase_rad: float, rest: float
) -> None:
    needle = motion(0)
    breath = BreathingTissue(base=BASE, size=size, frequency_hz=frequency_hz, phase_rad=phase_rad, rest=rest)
    seen = breath.relative(needle)
    moved = needle.depth_mm - seen.depth_mm
    assert np.ptp(moved) == pytest.approx(size, rel=2e-3)
    rate = np.gradient(moved, needle.time_s)
    assert np.abs(rate - (needle.velocity_mm_s - seen.velocity_mm_s))[1:-1].max() < 2e-2 * size


def test_at_full_rest_it_dwells_where_the_breath_is_out() -> None:
    needle = motion(0)
    breath = BreathingTissue(base=BASE, **TRUTH)
    angle = 2 * np.pi * TRUTH["frequency_hz"] * needle.time_s + TRUTH["phase_rad"]
    usual = TRUTH["size"] * np.cos((angle - np.pi / 2) / 2) ** 4
    assert np.allclose(needle.depth_mm - breath.relative(needle).depth_mm, usual)


@pytest.mark.study
def test_breaths_that_turn_the_movement_round_are_named_and_measured() -> None:
    library = Library([effect_named(name) for name in ("respiration", "viscous")], BASE)
    found = diagnose(BASE, recordings({"respiration": TRUTH}, seed=3), library=library)
    assert found.names == ("respiration",)
    estimates = found.effects[0].estimates
    assert estimates["size"].value == pytest.approx(TRUTH["size"], rel=0.02)
    assert estimates["frequency_hz"].value == pytest.approx(TRUTH["frequency_hz"], rel=0.01)


@pytest.mark.study
def test_beside_contacts_that_close_their_small_loops_a_small_breath_is_named_and_its_intervals_hold_it() -> None:
    base = BASE.with_values(presliding_mm=0.2)
    closed = BlendedReversal(**base.values(), shares=(1.0,), weights=(0.0,), closed=1.0)
    breath = {"frequency_hz": 0.256, "phase_rad": 1.9, "rest": 0.0, "size": 0.1}
    library = Library([effect_named(name) for name in ("respiration", "friction_layer", "stribeck")], base)
    found = diagnose(base, recordings({"respiration": breath}, base=closed), library=library)
    assert found.names == ("respiration",)
    for name, value in found.effects[0].estimates.items():  # of four intervals of 95 % one may fail
        assert abs(breath[name] - value.value) < 3 * value.sd


@pytest.mark.study
def test_tissue_that_is_held_as_a_whole_is_named_and_its_growth_is_measured() -> None:
    moving = {"size": 0.4, "lag_s": 0.3, "growth": 1.0}
    library = Library([effect_named(name) for name in ("tissue_motion", "relaxation", "respiration")], BASE)
    found = diagnose(BASE, recordings({"tissue_motion": moving}, seed=1), library=library)
    assert found.names == ("tissue_motion",)
    assert found.effects[0].values["growth"] > 0.8
    assert found.effects[0].estimates["size"].value == pytest.approx(0.4, rel=0.2)


@pytest.mark.study
def test_a_breath_of_one_phase_is_found_among_many_optima_and_is_not_named_after_phases_by_trial() -> None:
    breath = {"size": 0.6, "frequency_hz": 0.166, "phase_rad": 0.85, "rest": 0.78}
    library = Library([effect_named(name) for name in ("respiration", "respiration_by_trial")], BASE)
    found = diagnose(BASE, recordings({"respiration": breath}, seed=11), library=library)
    assert found.names == ("respiration",)
    estimates = found.effects[0].estimates
    for name in ("size", "frequency_hz", "rest"):
        assert estimates[name].low < breath[name] < estimates[name].high


def test_a_breath_by_trial_has_a_counterpart_with_the_mean_of_its_phases() -> None:
    both = [effect_named(name) for name in ("respiration", "respiration_by_trial")]
    _, empty = _best_sampling(BASE, recordings(), Settings())
    screening = Screening.of(empty.problem, Library(both, BASE))
    own = tuple({"phase_rad": phase} for phase in (3.1, -3.1, 3.0))
    by_trial = FittedEffect(both[1], {**TRUTH, "phase_rad": 3.1}, own=own)
    shared = screening.shared(by_trial)
    assert shared is not None
    assert shared.name == "respiration"
    assert shared.values == {**TRUTH, "phase_rad": pytest.approx((3.1 + 2 * np.pi - 3.1 + 3.0) / 3, abs=1e-3)}
    assert screening.shared(shared) is None
    assert Screening.of(empty.problem, Library(both[1:], BASE)).shared(by_trial) is None
    # The third trial becomes a reference: its phase says nothing.
    *shown, last = empty.problem.trials
    reference = replace(last, record=replace(last.record, role=Role.REFERENCE))
    beside = replace(screening, problem=replace(empty.problem, trials=(*shown, reference)))
    away = replace(by_trial, own=({"phase_rad": 3.1}, {"phase_rad": 3.0}, {"phase_rad": 0.0}))
    agreeing = beside.shared(away, agreeing=True)
    assert agreeing is not None
    assert agreeing.values["phase_rad"] == pytest.approx(3.05)
    assert screening.shared(away, agreeing=True) is None
