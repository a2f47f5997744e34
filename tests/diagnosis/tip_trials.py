"""Paths of a tip simulated with the models and noise, to test single stages; `tests/blind` tests the whole."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from needleplan.models import Model, SpatialBicycle, simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Array, Motion, Record, Role, lspb

BASE = SpatialBicycle(curvature_per_mm=1 / 200)
NOISE_MM = 0.1
RATE_HZ = 20.0


def motion(kind: int) -> Motion:
    """Return an insertion at two speeds with half a turn in the rest between."""
    turn_mm, speeds, start = ((35, [5, 10], 0.0), (25, [10, 4], np.pi), (45, [8, 6], 0.0))[kind]
    path = lspb([0, turn_mm, 70], speeds, dwells_s=[2, 1], rate_hz=RATE_HZ)
    resting = np.flatnonzero(np.diff(path.depth_mm) == 0)
    half = path.time_s[resting[0]] + np.array([0.5, 1.5])
    return replace(path, angle_rad=start + np.interp(path.time_s, half, [0.0, np.pi]))


def recordings(
    effects: Mapping[str, Mapping[str, float]] | None = None, seed: int = 0, base: SpatialBicycle = BASE
) -> list[Record]:
    """Return two training trials, a held-out one of another motion, and a noise record."""
    generator = np.random.default_rng(seed)

    def noise(samples: int) -> Array:
        return np.asarray(NOISE_MM * generator.standard_normal((3, samples)))

    found = []
    for number, role in enumerate((Role.TRAIN, Role.TRAIN, Role.HOLDOUT)):
        model: Model = base.with_values(curvature_per_mm=base.curvature_per_mm * generator.uniform(0.97, 1.03))
        for name, values in (effects or {}).items():
            model = effect_named(name).apply(model, values)
        path = motion(number)
        x, y, z = simulate(model, path).output + noise(len(path))
        columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}
        columns |= {"angle_rad": path.angle_rad, "x_mm": x, "y_mm": y, "z_mm": z}
        found.append(Record(columns, f"trial {number}", role))
    time = np.arange(600) / RATE_HZ
    x, y, z = noise(600)
    still = {"time_s": time, "depth_mm": np.zeros(600), "x_mm": x, "y_mm": y, "z_mm": z}
    return [*found, Record(still, "noise", Role.NOISE)]
