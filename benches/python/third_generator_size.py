"""Sensor noise, noncentrality and amplitudes of the third generator.

Noncentrality: energy of a hidden signal in the training trials, in units of the variance of the noise and
whitened by its colour, that is left after the four sensitivities of the documented base model have been
projected out of each trial. Counted with the tissue, the variance is that of the noise and of the heterogeneity
together, of the first order in the deviations.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter
from third_generator_law import BaseLaw, Trial, documented_force, sensitivities
from third_generator_motion import Array
from third_generator_state import Effect, HiddenEffect, simulate

STRATA = ((5.0, 30.0), (30.0, 70.0), (70.0, 100.0), (100.0, 300.0), (300.0, 10_000.0))
KEYS = ("friction", "cutting", "onset_mm", "presliding_mm")


@dataclass(frozen=True)
class SensorNoise:
    """Sum of white noise and an autoregression of first order.

    `rms` is the standard deviation of the sum (N), `correlation` that of neighbouring samples of the coloured
    part, and `share` the coloured part of the variance.
    """

    rms: float
    correlation: float
    share: float

    def draw(self, rng: Generator, samples: int) -> Array:
        """Draw noise (N)."""
        white, start = rng.standard_normal((2, samples)), rng.standard_normal()
        drive = white[0] * np.sqrt(1 - self.correlation**2)
        state = [self.correlation * start]
        coloured, _ = lfilter([1.0], [1.0, -self.correlation], drive, zi=state)
        return np.asarray(self.rms * (np.sqrt(self.share) * coloured + np.sqrt(1 - self.share) * white[1]))

    def whitened(self, columns: Array) -> Array:
        """Filter columns [samples, ...] such that the noise would be white with the variance 1."""
        phi, variance = self.correlation, self.rms**2
        near = self.share * phi * variance
        zero, one = (1 + phi**2) * variance - 2 * phi * near, near - phi * variance
        if abs(one) < 1e-15 * zero:
            theta, innovation = 0.0, zero
        else:
            ratio = zero / one
            theta = (ratio - np.sign(ratio) * np.sqrt(ratio**2 - 4)) / 2
            innovation = one / theta
        return np.asarray(lfilter([1.0, -phi], [1.0, theta], columns, axis=0) / np.sqrt(innovation))


@dataclass(frozen=True)
class Tissue:
    """Heterogeneity: its standard deviation, and its correlation length (mm)."""

    heterogeneity: float = 0.0
    length_mm: float = 5.0


def tissue_modes(trial: Trial, law: BaseLaw, tissue: Tissue) -> Array:
    """Give the force of each leading mode of the heterogeneity with its standard deviation, shape [samples, modes]."""
    depth = trial.points(trial.path.depth_mm)
    if not tissue.heterogeneity:
        return np.zeros((depth.size, 0))
    grid = np.arange(0.25, float(depth.max()) + 0.5, 0.5)
    kernel = np.exp(-((grid[:, None] - grid) ** 2) / (2 * tissue.length_mm**2))
    variances, modes = np.linalg.eigh(kernel)
    kept = variances > 1e-4 * variances[-1]
    modes = tissue.heterogeneity * modes[:, kept] * np.sqrt(variances[kept])
    inside, where = depth > 0, np.clip(depth / 0.5, 0, grid.size - 1)
    index, z = where.astype(int), trial.points(law.bristle(trial.path.depth_mm, trial.base["presliding_mm"]))
    lengths = np.vstack([np.zeros(modes.shape[1]), np.cumsum(modes, axis=0) * 0.5])
    part = (where - index)[:, None]
    shaft = lengths[index] * (1 - part) + lengths[index + 1] * part
    tip = law.tip(depth, trial.base["cutting"], trial.base["onset_mm"]) * law.pushed(z)
    both = [trial.base["friction"] * z[:, None] * shaft, tip[:, None] * modes[index]]
    return np.hstack(both) * inside[:, None]


class Sizing:
    """Noncentrality of hidden effects in the training trials of one data set."""

    def __init__(
        self, trials: Sequence[Trial], law: BaseLaw, noise: SensorNoise, bases: Sequence[dict[str, float]],
        tissue: Tissue = Tissue(), *, counts_tissue: bool = False,
    ) -> None:  # fmt: skip
        self.trials, self.law, self.noise, self.counts_tissue = trials, law, noise, counts_tissue
        self.plain = [simulate(trial, law, ()) for trial in trials]
        self.bases = [
            np.linalg.qr(noise.whitened(sensitivities(trial, base)))[0]
            for trial, base in zip(trials, bases, strict=True)
        ]
        self.tissues = []
        for trial, base in zip(trials, self.bases, strict=True):
            modes = noise.whitened(tissue_modes(trial, law, tissue))
            modes -= base @ (base.T @ modes)
            self.tissues.append((modes, np.eye(modes.shape[1]) + modes.T @ modes))

    def forces(self, hidden: Sequence[HiddenEffect]) -> list[Array]:
        """Give the noise-free samples of each trial (N)."""
        return [simulate(trial, self.law, hidden) for trial in self.trials]

    def remaining(self, signals: Sequence[Array]) -> list[Array]:
        """Give the whitened signals of each trial without what the base model absorbs."""
        whites = [self.noise.whitened(signal) for signal in signals]
        return [white - base @ (base.T @ white) for white, base in zip(whites, self.bases, strict=True)]

    def product(self, first: Sequence[Array], second: Sequence[Array], *, with_tissue: bool = False) -> float:
        """Give the inner product of what remains of two signals; of one and the same it is the noncentrality."""
        total = 0.0
        for a, b, (modes, spread) in zip(first, second, self.tissues, strict=True):
            total += float(a @ b)
            if with_tissue and modes.shape[1]:
                total -= float((a @ modes) @ np.linalg.solve(spread, modes.T @ b))
        return total

    def noncentrality(self, signals: Sequence[Array], *, with_tissue: bool = False) -> float:
        """Give the energy of what remains of a signal."""
        left = self.remaining(signals)
        return self.product(left, left, with_tissue=with_tissue)

    def of_size(self, effect: Effect, size: float, numbers: dict[str, object]) -> float:
        """Give the noncentrality of an effect alone, counted as the data set counts."""
        forces = self.forces([HiddenEffect(effect, size, numbers)])
        signals = [a - b for a, b in zip(forces, self.plain, strict=True)]
        return self.noncentrality(signals, with_tissue=self.counts_tissue)

    def sized(
        self,
        effect: Effect,
        numbers: dict[str, object],
        sign: float,
        highest: float,
        stratum: tuple[float, float],
        target: float,
    ) -> tuple[float, float]:
        """Find a size with a noncentrality near `target`, within the stratum if possible; give both."""
        lowest = min(effect.low, highest)
        size = float(np.sqrt(lowest * highest))
        best, slope, seen = (0.0, 0.0), 2.0, []
        for _ in range(5):
            value = self.of_size(effect, sign * size, numbers)
            seen.append((np.log(size), np.log(max(value, 1e-12))))
            if abs(np.log(max(value, 1e-12) / target)) < abs(np.log(max(best[1], 1e-12) / target)):
                best = (sign * size, value)
            if stratum[0] <= value <= stratum[1] and abs(np.log(value / target)) < 0.25:
                break
            if value < 1e-9 or (size >= highest and value < stratum[0]) or (size <= lowest and value > stratum[1]):
                break
            if len(seen) > 1 and abs(seen[-1][0] - seen[-2][0]) > 1e-3:
                slope = float(np.clip((seen[-1][1] - seen[-2][1]) / (seen[-1][0] - seen[-2][0]), 0.7, 4.0))
            size = float(np.clip(size * np.exp((np.log(target) - seen[-1][1]) / slope), lowest, highest))
        return best


def fitted_base(trials: Sequence[Trial], forces: Sequence[Array], start: dict[str, float]) -> dict[str, float]:
    """Fit the documented base model to forces by Gauss and Newton, with steps of at most 0.5 in the logarithm."""
    now = dict(start)
    for _ in range(8):
        left = np.concatenate([f - documented_force(t, now) for t, f in zip(trials, forces, strict=True)])
        by = np.concatenate([sensitivities(trial, now) for trial in trials])
        step = np.clip(np.linalg.lstsq(by, left, rcond=None)[0], -0.5, 0.5)
        now = {key: now[key] * float(np.exp(change)) for key, change in zip(KEYS, step, strict=True)}
        if np.abs(step).max() < 1e-3:
            break
    return now
