"""Recordings simulated with the models and noise, to test single stages; `tests/blind` tests the whole."""

from collections.abc import Mapping

import numpy as np

from needleplan.models import Model, ShaftAndTip, simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Array, Motion, Record, Role, lspb

BASE = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
NOISE_N = 0.02
RATE_HZ = 50.0


def motion(kind: int) -> Motion:
    depths, speeds, dwells = (
        ([-2, 20, 14, 45, 60, 50, 66, -2], [8, 5, 4, 10, 5, 6, 14], [2, 0, 1.5, 0, 0, 1, 0]),
        ([-2, 15, 30, 22, 48, 42, 66, -2], [3, 10, 8, 6, 2.5, 9, 15], [0, 1.5, 0, 2, 0, 0, 0]),
        ([-2, 25, 55, 40, 60, -2], [4, 7, 7, 5, 10], [0, 1, 0, 0, 0]),
    )[kind]
    return lspb(depths, speeds, dwells_s=dwells, rate_hz=RATE_HZ)


def coloured(generator: np.random.Generator, samples: int) -> Array:
    white = generator.standard_normal(samples + 100)
    noise = np.zeros(samples + 100)
    for index in range(1, len(noise)):
        noise[index] = 0.5 * noise[index - 1] + white[index]
    return np.asarray(NOISE_N * noise[100:] * np.sqrt(1 - 0.25))


def recordings(
    effects: Mapping[str, Mapping[str, float]] | None = None, seed: int = 0, *, base: Model = BASE
) -> list[Record]:
    """Return two training trials, a held-out one of another motion, and a noise record."""
    generator = np.random.default_rng(seed)
    found = []
    for number, role in enumerate((Role.TRAIN, Role.TRAIN, Role.HOLDOUT)):
        scale = generator.uniform(0.88, 1.12, 2)
        model: Model = base.with_values(
            friction=scale[0] * base.values()["friction"], cutting=scale[1] * base.values()["cutting"]
        )
        for name, values in (effects or {}).items():
            model = effect_named(name).apply(model, values)
        path = motion(number)
        force = simulate(model, path).output + coloured(generator, len(path))
        columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}
        found.append(Record({**columns, "force_n": force}, f"trial {number}", role))
    time = np.arange(1500) / RATE_HZ
    still = {"time_s": time, "depth_mm": np.full(1500, -5.0), "force_n": coloured(generator, 1500)}
    return [*found, Record(still, "noise", Role.NOISE)]
