import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from needleplan.models import ShaftAndTip, simulate
from needleplan.models.effects import effect_named
from needleplan.signals import lspb

MOTION = lspb([-2, 40, 20, 35, 10], [5, 8, 5, 8], dwells_s=[0, 0, 0, 0], rate_hz=50.0)
EFFECT = effect_named("fresh_cutting")


@given(st.floats(0.05, 3), st.floats(1, 10))
def test_at_full_share_nothing_is_cut_in_the_old_path_whatever_cutting_takes(cutting: float, onset_mm: float) -> None:
    base = ShaftAndTip(friction=0.01, cutting=cutting, onset_mm=onset_mm, presliding_mm=0.05)
    with_it = EFFECT.apply(base, {"size": 1.0, "margin_mm": 0.1})
    force = simulate(with_it, MOTION).output
    states = simulate(base, MOTION).states
    behind = np.maximum.accumulate(MOTION.depth_mm) - MOTION.depth_mm
    again = (behind > 3) & (MOTION.velocity_mm_s > 0)
    assert again.any()
    assert np.allclose(force[again], base.shaft_n(states, MOTION)[again], atol=1e-9 * cutting)
    fresh = behind == 0
    assert np.array_equal(force[fresh], simulate(base, MOTION).output[fresh])
