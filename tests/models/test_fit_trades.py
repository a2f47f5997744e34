"""Parameters that only a product or a sum of them determines are all named, and none of them is identified."""

import numpy as np
import pytest
from scipy.signal import lfilter

from needleplan.models import fit, simulate
from needleplan.models._noise_model import noise_model
from needleplan.models.friction import Karnopp
from needleplan.signals import Record, insertion_cycles

TRUE = Karnopp(mu_c=0.01, sigma2=1e-3)


def record(seed: int = 0) -> Record:
    motion = insertion_cycles(60.0, 5.0, rate_hz=40.0)
    output = simulate(TRUE, motion).output
    noise = np.random.default_rng(seed).normal(0, 0.02 * np.ptp(output), len(motion))
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    return Record(columns | {"force_n": output + noise}, "one")


def test_friction_and_normal_force_freed_together_are_named_and_not_identified() -> None:
    found = fit(TRUE, record(), free=["mu_c", "sigma2", "normal_force_n"])
    assert {"mu_c", "normal_force_n"} <= {name for each in found.undetermined for name in each}
    assert not found.estimates["normal_force_n"].identified
    assert not found.estimates["mu_c"].identified
    (sentence,) = found.trades
    assert sentence.startswith("the data determine")
    assert all(name in sentence for name in ("mu_c", "sigma2", "normal_force_n"))


def test_what_the_data_determine_is_not_named() -> None:
    found = fit(TRUE, record(), free=["mu_c"])
    assert found.undetermined == ()
    assert found.trades == ()
    assert found.estimates["mu_c"].identified


@pytest.mark.parametrize("slope", [0.0, 0.6, 0.9])
def test_the_noise_model_finds_the_correlation_that_a_fit_has_reduced(slope: float) -> None:
    """A line with 20 parameters fitted to AR(1) noise removes a share of it; the correction puts it back."""
    random, count, found, plain = np.random.default_rng(3), 800, [], []
    place = np.linspace(0, 1, count)
    jacobian = np.cos(np.pi * np.outer(place, np.arange(20)))
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    for _ in range(20):
        noise = random.standard_normal(count)
        for at in range(1, count):
            noise[at] += slope * noise[at - 1]
        left = noise - jacobian @ (inverse @ (jacobian.T @ noise))
        model = noise_model([left], [jacobian], inverse)
        variance = 1 / (1 - slope**2)
        found.append(model.variance / variance)
        plain.append(float(left @ left) / count / variance)
        assert model.correlation[0] == 1.0
    assert np.mean(found) == pytest.approx(1.0, abs=0.12)
    assert abs(np.mean(found) - 1) < abs(np.mean(plain) - 1) + 0.02


def test_the_matrix_of_the_process_is_that_of_its_autocorrelation() -> None:
    random = np.random.default_rng(0)
    noise = np.convolve(random.standard_normal(404), np.ones(5) / 5, "valid")
    jacobian = random.standard_normal((400, 3))
    model = noise_model([noise], [jacobian], np.linalg.inv(jacobian.T @ jacobian))
    lags = np.abs(np.subtract.outer(np.arange(400), np.arange(400)))
    known = np.zeros(400)
    known[: len(model.correlation)] = model.correlation[:400]
    np.testing.assert_allclose(model.spread(jacobian), known[lags] @ jacobian, atol=1e-9)
    assert (model.freedom([jacobian], np.linalg.inv(jacobian.T @ jacobian), 400) < 397).all()


def test_slow_columns_have_few_degrees_of_freedom() -> None:
    """AR(1), 0.9: the variance of a mean is s^2/(1 - a)^2/n, and its relative variance (2 sd(a)/(1 - a))^2 + 2/n."""
    random = np.random.default_rng(4)
    noise = lfilter([1.0], [1.0, -0.9], random.standard_normal(9000))[1000:]
    jacobian = np.ones((8000, 1))
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    model = noise_model([noise - noise.mean()], [jacobian], inverse)
    assert model.order == 1
    slope = model.coefficients[0]
    expected = 8000 / (1 + 2 * (1 - slope**2) / (1 - slope) ** 2)
    assert model.freedom([jacobian], inverse, 8000)[0] == pytest.approx(expected, rel=0.02)
    white = noise_model([random.standard_normal(8000)], [jacobian], inverse)
    assert white.order == 0
    assert white.freedom([jacobian], inverse, 8000)[0] == 7999
