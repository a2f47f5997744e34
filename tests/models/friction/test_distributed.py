"""The distributed model, against what it must become, and the lumped ones against it."""

import numpy as np
import pytest

from needleplan.errors import ModelError
from needleplan.models import simulate
from needleplan.models.friction import Beta, LumpedLuGre, Profile, QuasiStatic, distributed
from needleplan.signals import Array, Motion, Start, sinusoid
from needleplan_thesis.chapter3.published import CASES, THICKNESS_MM, model_ii, model_iii_b, passing_through


def rms(difference: Array) -> float:
    return 1e3 * float(np.sqrt(np.mean(difference**2)))


def inside(case: int) -> Motion:
    """Half a cycle out, one in: the tip stays in the tissue."""
    each = CASES[case]
    return sinusoid(
        offset_mm=38, amplitude_mm=25, frequency_hz=each.frequency_hz, cycles=1, start=Start.MIDDLE, rate_hz=100
    )


@pytest.mark.parametrize("velocity", [8.0, -8.0])
def test_steady_sliding_is_model_i(velocity: float) -> None:
    """In the steady state of a uniform patch the partial differential equation has the solution (3.9)."""
    time = np.arange(0, 10.5, 0.005)
    motion = Motion.sampled(time, 180 + velocity * time, np.full(time.size, velocity))
    model = model_ii(1)
    surface = {name: value for name, value in model.values().items() if name != "sigma1"}
    # The mean over twenty samples: single ones tremble as bristles pass the ends of the patch.
    ours = distributed(model, motion, Profile.UNIFORM, 0.05)[-20:].mean()
    assert ours == pytest.approx(float(simulate(QuasiStatic(**surface), motion).output[-1]), abs=1e-4)


def test_finer_bristles_change_nothing() -> None:
    model, motion = model_ii(2), passing_through(2, 1, 100)
    coarse, fine = (distributed(model, motion, Profile.ISOSCELES, each) for each in (0.1, 0.025))
    assert rms(coarse - fine) < 0.25


@pytest.mark.parametrize("case", [2, 4])
def test_the_lumped_model_follows_a_constant_patch(case: int) -> None:
    """Model II within 0.5 mN; the averaged one with lambda 5 off by 4 to 18 mN, for its beta is not in the equation."""
    motion = passing_through(case, 1.5, 100)
    two, three = model_ii(case), model_iii_b(case)
    assert rms(distributed(two, motion, Profile.ISOSCELES) - simulate(two, motion).output) < 0.6
    assert 4 < rms(distributed(three, motion, Profile.ISOSCELES) - simulate(three, motion).output) < 19


@pytest.mark.parametrize("case", [2, 4])
def test_the_lumped_model_with_the_length_follows_a_moving_tip(case: int) -> None:
    motion, three = inside(case), model_iii_b(case)
    exact = distributed(three, motion, Profile.ISOSCELES)
    values = {name: value for name, value in three.values().items() if name != "exponent"}
    lumped = rms(simulate(LumpedLuGre(**values, profile=Profile.ISOSCELES), motion).output - exact)
    tip = rms(simulate(three.with_values(beta=Beta.TIP), motion).output - exact)
    published = rms(simulate(three, motion).output - exact)
    assert lumped < 0.5 < tip < 2.6 < published < 9


def test_a_needle_that_has_not_arrived_has_no_friction() -> None:
    motion = sinusoid(offset_mm=-20, amplitude_mm=10, frequency_hz=0.2, cycles=1, rate_hz=50)
    assert not distributed(model_ii(1), motion, Profile.RIGHT).any()


def test_insertion_from_the_surface_is_the_lumped_model_with_its_length() -> None:
    """All bristles slide together: only the youngest are less bent."""
    motion = sinusoid(offset_mm=30, amplitude_mm=30, frequency_hz=0.05, cycles=0.5, rate_hz=100)
    model = model_ii(1).with_values(profile=Profile.UNIFORM)
    force = distributed(model, motion, Profile.UNIFORM)
    np.testing.assert_allclose(force, simulate(model, motion).output, atol=6e-3)
    assert motion.depth_mm.max() < THICKNESS_MM
    assert force.max() > 0.2


def test_bristles_must_be_closer_than_the_ramp() -> None:
    with pytest.raises(ModelError, match="third of the ramp"):
        distributed(model_ii(1), inside(1), Profile.UNIFORM, 1.0)
