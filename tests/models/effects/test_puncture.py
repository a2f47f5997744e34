"""A membrane may be loaded exponentially, as a square, or linearly."""

from __future__ import annotations

import numpy as np
import pytest

from needleplan.models import simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Array, lspb
from tests.diagnosis.trials import BASE

MOTION = lspb([-2, 40], [5], rate_hz=100)


def gained(**values: float) -> Array:
    """Return the force of a membrane at 30 mm that breaks at 0.2 N, before it breaks."""
    model = effect_named("puncture").apply(BASE, {"size": 0.2, "depth_mm": 30.0, **values})
    force = simulate(model, MOTION).output - simulate(BASE, MOTION).output
    return np.asarray(force[(MOTION.depth_mm > 5) & (MOTION.depth_mm <= 30)])


@pytest.mark.parametrize(
    ("rise", "law"),
    [
        (0.0, lambda before_mm: np.exp(-before_mm / 4)),
        (0.5, lambda before_mm: np.maximum(1 - before_mm / 8, 0) ** 2),
        (1.0, lambda before_mm: np.maximum(1 - before_mm / 4, 0)),
    ],
)
def test_the_force_grows_by_the_law_and_has_the_same_slope_at_the_break(rise: float, law) -> None:
    before_mm = 30 - MOTION.depth_mm[(MOTION.depth_mm > 5) & (MOTION.depth_mm <= 30)]
    assert gained(bulge_mm=4.0, rise=rise) == pytest.approx(0.2 * law(before_mm), abs=1e-9)


def test_without_a_rise_the_force_is_exponential_and_a_small_rise_is_nearly_so() -> None:
    assert np.array_equal(gained(bulge_mm=4.0), gained(bulge_mm=4.0, rise=0.0))
    assert gained(bulge_mm=4.0, rise=1e-5) == pytest.approx(gained(bulge_mm=4.0), abs=1e-5)
