"""The law tolerance of the base: its columns, and what it does to a base whose friction follows another law."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from needleplan.diagnosis._base_law import _PLACES, _modes, base_laws
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models import ShaftAndTip, simulate
from needleplan.models.effects import Reach, effect_named
from needleplan.signals import insertion_cycles
from tests.diagnosis.tip_trials import BASE as TIP_BASE

BASE = ShaftAndTip(friction=0.03, cutting=0.4, onset_mm=4.0, presliding_mm=0.1)
MOTION = insertion_cycles(40.0, 5.0)
REACH, LARGEST_N, SETTINGS = Reach.of([MOTION]), 2.0, Settings(base_law=1.0, entry_law=4.0)


def columns(model=BASE, effects=()):
    trial = SimpleNamespace(model=model, motion=MOTION, measured=np.zeros(len(MOTION)))
    return base_laws(trial, effects, REACH, LARGEST_N, SETTINGS)


def explained(law, found):
    """Return the share of a change of the force that the columns and the parameters of the base explain."""
    state = simulate(BASE, MOTION).states
    both = np.column_stack([found, BASE.shaft_n(state, MOTION), BASE.tip_n(state, MOTION)])
    fitted = both @ np.linalg.lstsq(both, law, rcond=1e-9)[0]
    return 1 - float(((law - fitted) ** 2).sum() / (law**2).sum())


def test_columns_are_in_proportion_to_the_tolerance():
    trial = SimpleNamespace(model=BASE, motion=MOTION, measured=np.zeros(len(MOTION)))
    small = base_laws(
        trial,
        (),
        REACH,
        LARGEST_N,
        replace(SETTINGS, base_law=0.1 * SETTINGS.base_law, entry_law=0.1 * SETTINGS.entry_law),
    )
    np.testing.assert_allclose(small, 0.1 * columns(), atol=1e-12)


@pytest.mark.parametrize("law", ["density", "load", "direction", "wedge", "onset", "rim"])
def test_other_laws_of_friction_and_cutting_lie_within_the_tolerance(law):
    depth, state = np.maximum(MOTION.depth_mm, 0.0), simulate(BASE, MOTION).states
    shaft, tip = BASE.shaft_n(state, MOTION), BASE.tip_n(state, MOTION)
    change = {
        "density": shaft * (depth / 40.0) ** 0.2,
        "load": shaft * np.maximum(shaft + tip, 0.0),
        "direction": np.maximum(shaft, 0.0),
        "wedge": -BASE.cutting * np.minimum(depth / 4.0, 1.0) * (1 - state[0]) / 2,
        "onset": BASE.cutting * depth / (depth + 3.0) * (1 + state[0]) / 2,
        "rim": -BASE.friction * np.minimum(depth, 0.7) * state[0],
    }[law]
    assert explained(change, columns()) > 0.99


def test_a_bump_and_breathing_lie_outside_of_the_tolerance():
    depth, noise_n = np.maximum(MOTION.depth_mm, 0.0), 0.01
    trial = SimpleNamespace(model=BASE, motion=MOTION, measured=np.zeros(len(MOTION)))
    found = base_laws(trial, (), REACH, LARGEST_N, Settings()) / noise_n
    for law in (np.exp(-(((depth - 25.0) / 1.0) ** 2)), np.sin(2 * np.pi * 0.4 * MOTION.time_s)):
        output = 0.1 * law / noise_n
        inner = np.linalg.solve(np.eye(found.shape[1]) + found.T @ found, found.T @ output)
        left = output @ output - (found.T @ output) @ inner  # noncentrality beside the tolerance
        assert left > 0.4 * output @ output


def test_at_the_entry_the_tolerance_has_a_scale_of_its_own():
    trial = SimpleNamespace(model=BASE, motion=MOTION, measured=np.zeros(len(MOTION)))
    rims = base_laws(trial, (), REACH, LARGEST_N, Settings(base_law=0.0))[:, -4:]
    assert (np.abs(rims).max(axis=0) > 0.005).all()
    sliding = (MOTION.depth_mm > 30.0) & (simulate(BASE, MOTION).states[0] > 0.99)
    # in the depth, a rim is a constant friction, which the base absorbs
    assert np.ptp(rims[sliding], axis=0).max() < 1e-3


def test_the_rise_of_the_cutting_force_deviates_most_near_the_onset():
    spread = np.sqrt((_modes() ** 2).sum(axis=0))
    near, far, entry = (float(np.interp(np.log(each), _PLACES, spread)) for each in (1.0, 30.0, 0.03))
    assert 0.6 < near < 1.0
    assert far < 0.15
    assert entry < 0.15


@pytest.mark.parametrize("name", ["puncture", "gain_error", "tissue_motion"])
def test_beside_an_effect_the_forces_of_shaft_and_tip_are_those_of_a_simulation(name):
    effect = effect_named(name)
    values = {key: {"size": 0.3, "depth_mm": 8.0}.get(key, 1.0) for key in effect.parameters}
    found = columns(effects=[FittedEffect(effect, values)])
    assert np.isfinite(found).all()
    rule = columns()
    assert found.shape == rule.shape
    same = np.allclose(found, rule, atol=1e-6)
    assert same is (name == "puncture")  # an added effect leaves friction and cutting force as they are


def test_the_path_of_the_tip_has_no_such_law():
    assert columns(TIP_BASE).shape == (len(MOTION), 0)


def test_beside_breathing_through_the_entry_the_columns_stay_in_proportion_to_the_forces():
    effect = effect_named("respiration")
    values = {"size": 11.0, "frequency_hz": 0.25, "phase_rad": 1.0, "rest": -1.0}
    found = columns(effects=[FittedEffect(effect, values)])
    largest = np.abs(simulate(BASE, MOTION).output).max()
    assert np.abs(found).max() < 10 * SETTINGS.entry_law * largest
