"""The law of reversal of the base as a nuisance: its modes, the blended model, and the density that a fit increases."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleplan.diagnosis import Settings
from needleplan.diagnosis._base_law import base_laws
from needleplan.diagnosis._evidence import LinearModel
from needleplan.diagnosis._reversal import COUNT, blended, blended_by, reversal_laws
from needleplan.diagnosis._tangents import unblended
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models import ShaftAndTip, simulate
from needleplan.models.effects import GivingTissue, Reach, effect_named
from needleplan.signals import Motion, insertion_cycles
from tests.diagnosis.test_evidence import LEVEL, block

BASE = ShaftAndTip(friction=0.03, cutting=0.4, onset_mm=4.0, presliding_mm=0.5)
MOTION = insertion_cycles(20.0, 5.0)


def test_no_coefficients_are_the_model_itself():
    for wrap in (lambda model: model, lambda model: GivingTissue(base=model, size=0.5, lag_s=0.3)):
        plain, other = (simulate(wrap(model), MOTION).output for model in (BASE, blended(BASE, np.zeros(COUNT))))
        np.testing.assert_allclose(other, plain, atol=1e-12)


def test_the_output_is_linear_in_the_coefficients_which_can_be_read_back():
    wanted = np.array([0.2, -0.1, 0.05, 0.1, -0.05, 0.05, 0.02, -0.03, 0.06])
    model = blended(BASE, wanted)
    np.testing.assert_allclose(blended_by(model), wanted, atol=1e-6)
    assert unblended(model) == BASE
    plain, once, twice = (simulate(blended(BASE, k * wanted), MOTION).output for k in (0, 1, 2))
    assert np.ptp(once - plain) > 0.05
    np.testing.assert_allclose(twice - plain, 2 * (once - plain), atol=1e-6)


def spread_at(travels: list[float]) -> list[float]:
    """Return the prior standard deviation of the bristle, in units of the tolerance, at travels in presliding lengths.

    From rest, the bristle rises by half of the swing of a reversal.
    """
    motion = insertion_cycles(60.0, 5.0)
    plain = simulate(BASE, motion).states[0]
    deviations = np.array([simulate(blended(BASE, each), motion).states[0] - plain for each in np.eye(COUNT)[:-1]])
    spread, inward = np.sqrt((deviations**2).sum(axis=0)), motion.velocity_mm_s > 0
    depths = motion.depth_mm[inward] / BASE.presliding_mm
    return [float(spread[inward][np.abs(depths - each).argmin()]) for each in travels]


def test_the_law_may_deviate_most_near_the_presliding_length():
    near = spread_at([0.3, 0.5, 1.0, 2.0, 4.0])
    assert min(near) > 0.3
    assert max(near) < 0.6
    assert max(spread_at([30.0])) < 0.15


def test_another_presliding_length_is_no_deviation_of_the_law():
    # The derivative of 1 - exp(-x) by the logarithm of its length is -x exp(-x), with equal weight of each log x.
    travel = np.geomspace(0.05, 100.0, 400)
    base = BASE.with_values(presliding_mm=1.0)
    motion = Motion(travel, travel, np.ones(400), np.ones(400), np.zeros(400))
    plain = simulate(base, motion).states[0]
    for each in np.eye(COUNT)[:-1]:  # the last one is the memory
        deviation = simulate(blended(base, each), motion).states[0] - plain
        longer = travel * np.exp(-travel)
        cosine = longer @ deviation / np.linalg.norm(longer) / np.linalg.norm(deviation)
        assert abs(cosine) < 0.05


def test_far_from_a_reversal_the_law_may_deviate_in_inverse_proportion_to_the_travel():
    near, far = spread_at([10.0, 20.0])
    assert near / far == pytest.approx((1 + 20 / 3) / (1 + 10 / 3), rel=0.1)


def test_the_density_at_a_point_is_largest_at_the_mean():
    random = np.random.default_rng(5)
    blocks = [block(random, 40, 3, 4) for _ in range(2)]
    columns = [np.vstack([random.normal(size=(40, 6)), np.zeros((3, 6))]) for _ in blocks]
    residuals = [each.residual.copy() for each in blocks]
    model, fixed = LinearModel(blocks, columns, np.ones(6)), np.array([0, 1])
    f = model.mean[LEVEL]
    steps = model.base_steps(LEVEL, f)
    moved = [
        type(each)(residual - each.base @ step, each.base, each.modes, each.variances)
        for each, residual, step in zip(blocks, residuals, steps, strict=True)
    ]
    there = LinearModel(moved, columns, np.ones(6))

    def density(linear, values):
        energy, volume = linear.at_point(fixed, values, np.array([LEVEL]))
        return (volume - energy / 2)[0]

    best = density(there, f[:2])
    assert best > density(model, f[:2])
    for shift in ([0.1, 0.0], [0.0, -0.1]):
        assert density(there, f[:2] + shift) < best


@pytest.mark.parametrize("name", ["puncture", "stribeck", "gain_error", "relaxation", "tissue_motion"])
def test_the_derivatives_of_the_output_beside_an_effect_are_those_of_a_simulation(name):
    effect = effect_named(name)
    values = {key: {"size": 0.3, "depth_mm": 8.0}.get(key, 1.0) for key in effect.parameters}
    model = blended(BASE, np.full(COUNT, 0.03))
    trial = SimpleNamespace(model=model, motion=MOTION, measured=np.zeros(len(MOTION)))
    found = reversal_laws(trial, [FittedEffect(effect, values)])
    step = 0.01 * np.eye(COUNT)[2]
    there, here = (
        simulate(effect.apply(blended(BASE, np.full(COUNT, 0.03) + each), values), MOTION).output
        for each in (step, -step)
    )
    np.testing.assert_allclose(found[:, 2], (there - here) / 0.02, atol=0.02 * np.ptp(found[:, 2]))


@pytest.mark.parametrize("name", ["friction", "cutting", "presliding_mm"])
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_laws_are_found_at_the_bounds_of_the_base(name, end):
    value = getattr(BASE.parameters()[name], end)
    model = blended(BASE.with_values(**{name: value}), np.zeros(COUNT))
    trial = SimpleNamespace(model=model, motion=MOTION, measured=np.zeros(len(MOTION)))
    for effects in ([], [FittedEffect(effect_named("gain_error"), {"size": 0.3})]):
        found = np.hstack([
            reversal_laws(trial, effects), base_laws(trial, effects, Reach.of([MOTION]), 1.0, Settings())
        ])  # fmt: skip
        assert np.isfinite(found).all()
