"""Heterogeneous tissue of two kinds, drawn by recursions and filters that the engine does not use."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from needleplan.diagnosis import Library, Verdict, diagnose
from needleplan.models import simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Array, Record, Role
from tests.diagnosis.trials import BASE, NOISE_N, RATE_HZ, motion

STEP_MM = 0.1
PLACES_MM = np.arange(0.0, 70.0, STEP_MM)
HETEROGENEITY = 0.1
LAYER = {"size": 0.06, "depth_mm": 34.0, "width_mm": 1.5}
# Few effects, so that the test is short; the layer is the one that heterogeneous tissue resembles.
LIBRARY = Library([effect_named(name) for name in ("cutting_layer", "cutting_with_depth", "viscous")], BASE)


def rough(random: np.random.Generator) -> Array:
    """An autoregression of first order along the depth, of the correlation length 5 mm and variance 1."""
    keep, found = np.exp(-STEP_MM / 5.0), random.standard_normal(PLACES_MM.size)
    for index in range(1, found.size):
        found[index] = keep * found[index - 1] + np.sqrt(1 - keep**2) * found[index]
    return np.asarray(found)


def smooth(random: np.random.Generator) -> Array:
    """White noise after a Gaussian filter of 3.5 mm, of variance 1."""
    sd = 3.5 / STEP_MM
    filtered = gaussian_filter1d(random.standard_normal(PLACES_MM.size), sd, mode="wrap")
    return np.asarray(filtered * np.sqrt(2 * np.sqrt(np.pi) * sd))


def recordings(tissue, layer: bool, seed: int, heterogeneity: float = HETEROGENEITY) -> list[Record]:
    """Two training trials, a held-out one of another motion, and a noise record; noise and tissue differ by trial."""
    random = np.random.default_rng(seed)
    model = effect_named("cutting_layer").apply(BASE, LAYER) if layer else BASE
    found = []
    for number, role in enumerate((Role.TRAIN, Role.TRAIN, Role.HOLDOUT)):
        path = motion(number)
        run, depth = simulate(model, path), np.maximum(path.depth_mm, 0.0)
        plain = simulate(BASE, path)
        along, at_tip = tissue(random), tissue(random)
        mean = np.interp(depth, PLACES_MM, np.cumsum(along) * STEP_MM) / np.maximum(depth, STEP_MM)
        more = mean * BASE.shaft_n(plain.states, path) + np.interp(depth, PLACES_MM, at_tip) * BASE.tip_n(
            plain.states, path
        )
        force = run.output + heterogeneity * more + random.normal(0.0, NOISE_N / 4, len(path))
        columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}
        found.append(Record({**columns, "force_n": force}, f"trial {number}", role))
    still = {"time_s": np.arange(1500) / RATE_HZ, "force_n": random.normal(0.0, NOISE_N / 4, 1500)}
    return [*found, Record(still, "noise", Role.NOISE)]


@pytest.mark.slow
@pytest.mark.parametrize("tissue", [rough, smooth])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.study)])
def test_the_kind_of_the_tissue_is_found_and_no_effect_is_named(tissue, seed):
    found = diagnose(BASE, recordings(tissue, layer=False, seed=seed), library=LIBRARY)
    assert found.verdict in (Verdict.NONE, Verdict.UNDERPOWERED)
    assert found.tissue[tissue.__name__] > 0.9
    assert 0.05 < found.heterogeneity < 0.2


@pytest.mark.slow
def test_homogeneous_tissue_needs_next_to_no_functions_of_the_depth():
    found = diagnose(BASE, recordings(smooth, layer=False, seed=1, heterogeneity=0.0), library=LIBRARY)
    assert found.verdict in (Verdict.NONE, Verdict.UNDERPOWERED)
    assert found.heterogeneity < 0.02
    assert found.tissue["homogeneous"] > 0.9
    assert sum(found.tissue.values()) == pytest.approx(1.0)
    assert all(modes.shape[1] < 100 for modes, _ in found.posterior.problem.modes)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.study)])
def test_a_layer_is_seen_in_smooth_tissue(seed):
    found = diagnose(BASE, recordings(smooth, layer=True, seed=seed), library=LIBRARY)
    assert found.names == ("cutting_layer",)
    depth = found.effects[0].estimates["depth_mm"]
    assert abs(depth.value - LAYER["depth_mm"]) < 1.0
