"""Tissue that moves with the needle, held against its rates integrated by a slow twin and against a closed form."""

import numpy as np
import pytest

from needleplan.models import ShaftAndTip, simulate
from needleplan.models._simulate import _kutta
from needleplan.models.effects import GivingTissue, SlowTurning, effect_named
from needleplan.signals import Motion, lspb

BASE = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.2)


def path(rate_hz: float) -> Motion:
    return lspb([0, 12, 9, 25, 0], [8, 5, 6, 10], dwells_s=[1, 0.5, 1, 0], rate_hz=rate_hz)


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [0.3, *(pytest.param(lag, marks=pytest.mark.study) for lag in (0.02, 2.0))])
@pytest.mark.parametrize("growth", [0.0, 0.7])
@pytest.mark.parametrize(
    "inner", [BASE, SlowTurning(base=BASE, size=0.3), SlowTurning(base=BASE, size=2.0, share=0.4, tip=0.0)],
    ids=["plain", "slow", "partly slow"],
)  # fmt: skip
def test_it_is_its_rates_integrated(inner: ShaftAndTip | SlowTurning, growth: float, lag_s: float) -> None:
    model = GivingTissue(base=inner, size=0.8, lag_s=lag_s, growth=growth)
    fine, coarse = path(1000.0), path(100.0)
    slow = _kutta(model, fine, model.initial_state(fine), 1)
    np.testing.assert_allclose(simulate(model, fine).states, slow, atol=2e-3)
    seen = [np.interp(coarse.time_s, fine.time_s, row) for row in slow]
    np.testing.assert_allclose(simulate(model, coarse).states, seen, atol=0.03)


def test_a_bristle_in_a_share_of_the_contacts_is_that_share_of_two_models() -> None:
    motion, long = path(200.0), BASE.with_values(presliding_mm=BASE.presliding_mm + 2.0)
    short_states, long_states = simulate(BASE, motion).states, simulate(long, motion).states
    wanted = 0.6 * BASE.shaft_n(short_states, motion) + 0.4 * BASE.shaft_n(long_states, motion)
    wanted = wanted + 0.9 * BASE.tip_n(short_states, motion) + 0.1 * BASE.tip_n(long_states, motion)
    found = effect_named("bristle").apply(BASE, {"size": 2.0, "share": 0.4, "tip": 0.1})
    np.testing.assert_allclose(simulate(found, motion).output, wanted, atol=1e-12)


def test_without_a_damper_tissue_goes_along_by_its_share_of_the_friction() -> None:
    # z' = (v - size z')(1 - z)/presliding: the way to z is -presliding log(1 - z) + size z.
    model = GivingTissue(base=BASE, size=0.5, lag_s=1e-3)
    motion = lspb([0, 3], [2], rate_hz=1000.0)
    bristle, moved = simulate(model, motion).states
    way = -BASE.presliding_mm * np.log(1 - bristle) + 0.5 * bristle
    early = bristle < 0.95
    np.testing.assert_allclose(way[early], motion.depth_mm[early], atol=0.01)
    assert moved[-1] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("depth_mm", [10.0, 50.0, 80.0])
def test_tissue_that_is_held_as_a_whole_moves_in_proportion_to_the_inserted_length(depth_mm: float) -> None:
    model = GivingTissue(base=BASE, size=0.5, lag_s=0.05, growth=1.0)
    bristle, moved = simulate(model, lspb([0, depth_mm], [5], rate_hz=500.0)).states
    assert bristle[-1] == pytest.approx(1.0, abs=1e-4)
    assert moved[-1] == pytest.approx(0.5 * depth_mm / 50, rel=0.01)
    half = GivingTissue(base=BASE, size=0.5, lag_s=0.05, growth=0.5)
    moved = simulate(half, lspb([0, depth_mm], [5], rate_hz=500.0)).states[1]
    assert moved[-1] == pytest.approx(0.25 + 0.25 * depth_mm / 50, rel=0.01)


def test_the_tip_feels_it_too() -> None:
    # Behind the entry there is hardly a shaft yet: what a reversal changes there is the tip's force.
    motion = lspb([0, 2, 1.8, 2.2], [2, 2, 2], rate_hz=200.0)
    given = effect_named("tissue_motion").apply(BASE, {"size": 0.5, "lag_s": 0.05})
    change = simulate(given, motion).output - simulate(BASE, motion).output
    shaft = BASE.friction * 2.2
    assert np.abs(change).max() > 3 * shaft
