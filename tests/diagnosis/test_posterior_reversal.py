"""The law of reversal of the base as a nuisance: its modes, the blended model, and the density that a fit increases."""

from __future__ import annotations

import numpy as np

from needleplan.diagnosis.posterior._evidence import LinearModel
from needleplan.diagnosis.posterior._reversal import _MODES, blended, blended_by, unblended
from needleplan.models import ShaftAndTip, simulate
from needleplan.models.effects import GivingTissue
from needleplan.signals import insertion_cycles
from tests.diagnosis.test_posterior_evidence import LEVEL, block

BASE = ShaftAndTip(friction=0.03, cutting=0.4, onset_mm=4.0, presliding_mm=0.5)
MOTION = insertion_cycles(20.0, 5.0)


def test_no_coefficients_are_the_model_itself():
    for wrap in (lambda model: model, lambda model: GivingTissue(base=model, size=0.5, lag_s=0.3)):
        plain, other = (simulate(wrap(model), MOTION).output for model in (BASE, blended(BASE, np.zeros(_MODES))))
        np.testing.assert_allclose(other, plain, atol=1e-12)


def test_the_output_is_linear_in_the_coefficients_which_can_be_read_back():
    wanted = np.array([0.2, -0.1, 0.05, 0.1, -0.05, 0.05, 0.02])
    model = blended(BASE, wanted)
    np.testing.assert_allclose(blended_by(model), wanted, atol=1e-6)
    assert unblended(model) == BASE
    plain, once, twice = (simulate(blended(BASE, k * wanted), MOTION).output for k in (0, 1, 2))
    assert np.ptp(once - plain) > 0.05
    np.testing.assert_allclose(twice - plain, 2 * (once - plain), atol=1e-6)


def test_the_law_may_deviate_by_one_prior_deviation_near_the_presliding_length():
    travel = simulate(BASE, MOTION).motion.depth_mm
    swing = np.array([simulate(blended(BASE, each), MOTION).states[0] for each in np.eye(_MODES)])
    near = (travel > 0.25) & (travel < 1.0) & (MOTION.velocity_mm_s > 0)
    spread = np.sqrt((swing[:, near] ** 2).sum(axis=0))
    assert spread.min() > 0.5
    assert spread.max() < 2.3  # a reversal from sliding to sliding changes the bristle by 2


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
    best = there.at_point(fixed, f[:2])[LEVEL]
    assert best > model.at_point(fixed, f[:2])[LEVEL]
    for shift in ([0.1, 0.0], [0.0, -0.1]):
        assert there.at_point(fixed, f[:2] + shift)[LEVEL] < best
