import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.errors import DataError
from needleplan.identification import NoiseStatus, headings_at, tip_noise
from needleplan.identification._tip_noise import probabilities_of
from needleplan.scenario import TipMotion
from needleplan.signals import Array, Record

HEADINGS, RADIUS_MM = 60, 40.0
STEP_RAD = 2 * math.pi / HEADINGS
STEP_MM = RADIUS_MM * STEP_RAD


@settings(deadline=None)  # the first example imports scipy
@given(st.floats(1e-4, 2.0))
def test_probabilities_have_the_variance_and_the_scenario_takes_them(steps: float) -> None:
    noise = probabilities_of(steps * STEP_RAD, STEP_RAD)
    variance = 2 * sum(k**2 * p for k, p in enumerate(noise))
    assert variance == pytest.approx(steps**2, rel=0.02, abs=2e-6)
    assert TipMotion(headings=HEADINGS, tip_noise=noise).tip_noise == noise


def replicates(random: np.random.Generator, trials: int, noise: tuple[float, ...], measured_rad: float) -> Array:
    """Headings after every fourth step of the planner's own noise, each trial with an entry of its own."""
    steps = np.arange(-len(noise) + 1, len(noise))
    walk = random.choice(steps, p=[noise[abs(k)] for k in steps], size=(trials, 16)).cumsum(axis=1) * STEP_RAD
    entry = random.normal(0, 0.1, (trials, 1))
    return np.asarray(entry + walk[:, 3::4] + random.normal(0, measured_rad, (trials, 4)))


DEPTHS = STEP_MM * np.arange(4, 17, 4)


@pytest.mark.parametrize("measured_rad", [0.0, 0.03])
def test_the_noise_of_the_planner_is_found_again(measured_rad: float) -> None:
    truth = (0.466, 0.24, 0.027)
    sd = STEP_RAD * math.sqrt(2 * (0.24 + 4 * 0.027))
    random, held = np.random.default_rng(0), 0
    for _ in range(200):
        headings = replicates(random, 8, truth, measured_rad)
        found = tip_noise(headings, DEPTHS, headings=HEADINGS, radius_mm=RADIUS_MM, measurement_sd_rad=measured_rad)
        assert found.status is NoiseStatus.IDENTIFIED
        held += found.low_rad <= sd <= found.high_rad
    assert held / 200 > 0.9
    many = tip_noise(
        replicates(random, 4000, truth, measured_rad), DEPTHS, headings=HEADINGS, radius_mm=RADIUS_MM,
        measurement_sd_rad=measured_rad,
    )  # fmt: skip
    assert many.sd_rad == pytest.approx(sd, rel=0.02)
    assert many.probabilities[:3] == pytest.approx(truth, abs=0.02)


def test_it_says_when_the_data_are_not_enough() -> None:
    random = np.random.default_rng(1)
    few = tip_noise(replicates(random, 2, (0.6, 0.2), 0.0), DEPTHS, headings=HEADINGS, radius_mm=RADIUS_MM)
    assert few.status is NoiseStatus.FEW_REPLICATES
    assert "are few" in few.says
    quiet = random.normal(0, 0.02, (6, 4))
    hidden = tip_noise(quiet, DEPTHS, headings=HEADINGS, radius_mm=RADIUS_MM, measurement_sd_rad=0.02)
    assert hidden.status is NoiseStatus.NOT_SEPARABLE
    assert not hidden.ok
    wild = tip_noise(random.normal(0, 2, (6, 4)), DEPTHS, headings=HEADINGS, radius_mm=RADIUS_MM)
    assert wild.status is NoiseStatus.TOO_WIDE
    assert "take fewer headings" in wild.says
    with pytest.raises(DataError, match="too few"):
        tip_noise(quiet[:1], DEPTHS, headings=HEADINGS, radius_mm=RADIUS_MM)
    with pytest.raises(DataError, match="the depths increase"):
        tip_noise(quiet, DEPTHS[::-1], headings=HEADINGS, radius_mm=RADIUS_MM)


def test_headings_come_from_tracked_points() -> None:
    random, records = np.random.default_rng(2), []
    x = np.linspace(0, 60, 241)
    for slope in (0.0, 0.1, -0.05):
        columns = {"time_s": x / 10, "x_mm": x, "y_mm": slope * x + random.normal(0, 0.1, x.size)}
        records.append(Record(columns, f"{slope}"))
    found, sd = headings_at(records, np.array([10.0, 30.0, 50.0]), 10.0)
    np.testing.assert_allclose(found, np.arctan([[0.0] * 3, [0.1] * 3, [-0.05] * 3]), atol=4 * sd)
    assert sd == pytest.approx(0.1 / math.sqrt(41 * 10**2 / 12), rel=0.15)
    with pytest.raises(DataError, match="at least 4"):
        headings_at(records, np.array([80.0]), 10.0)
    with pytest.raises(DataError, match="apart"):
        headings_at(records, np.array([10.0, 12.0]), 10.0)
