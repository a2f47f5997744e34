"""Contacts that close their small loops, held against elements that are moved one by one."""

import numpy as np
import pytest
from scipy.special import gammaincinv

from needleplan.models import ShaftAndTip, simulate
from needleplan.models.friction import BlendedReversal
from needleplan.signals import Array, Motion, lspb

BASE = ShaftAndTip(friction=0.02, cutting=0.4, onset_mm=4.0, presliding_mm=0.5)
CLOSED = BlendedReversal(**BASE.values(), shares=(1.0,), weights=(0.0,), closed=1.0)


def moved_one_by_one(motion: Motion, elements: int = 400) -> Array:
    """Return the mean of elements that stretch over their yield travel, and slide at -1 and 1."""
    yields = BASE.presliding_mm * gammaincinv(2.0, (np.arange(elements) + 0.5) / elements) / 2
    state, found = np.zeros(elements), [0.0]
    for move in np.diff(motion.depth_mm):
        state = np.clip(state + move / yields, -1.0, 1.0)
        found.append(state.mean())
    return np.array(found)


@pytest.mark.parametrize("turns", [[0, 12, 9, 25, 0], [0, 5, 4.8, 5.1, 4.9, 5.0, 9]])
def test_it_is_the_mean_of_elements(turns: list[float]) -> None:
    motion = lspb(turns, [4] * (len(turns) - 1), dwells_s=[0.5] + [0.0] * (len(turns) - 2), rate_hz=2000.0)
    np.testing.assert_allclose(simulate(CLOSED, motion).states[0], moved_one_by_one(motion), atol=0.02)


def test_from_sliding_to_sliding_both_laws_are_one() -> None:
    motion = lspb([0, 10, 0], [4, 4], rate_hz=2000.0)
    plain, closed = (simulate(model, motion).states[0] for model in (BASE, CLOSED))
    back = motion.velocity_mm_s < 0
    np.testing.assert_allclose(closed[back], plain[back], atol=0.02)


def test_a_small_loop_closes_and_dahls_creeps() -> None:
    motion = lspb([0, 10, *[9.9, 10] * 20], [2] * 41, rate_hz=2000.0)
    plain, closed = (simulate(model, motion).states[0] for model in (BASE, CLOSED))
    assert closed[-1] == pytest.approx(1.0, abs=0.01)
    assert plain[-1] < 0.3


def test_a_share_is_a_blend() -> None:
    motion = lspb([0, 10, 9.7, 10, 9], [2] * 4, rate_hz=500.0)
    half = BlendedReversal(**BASE.values(), shares=(1.0,), weights=(0.0,), closed=0.5)
    plain, all_, some = (simulate(model, motion).output for model in (BASE, CLOSED, half))
    np.testing.assert_allclose(some, (plain + all_) / 2, atol=1e-12)
