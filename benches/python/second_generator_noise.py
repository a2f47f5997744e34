"""Noise, heterogeneity and noncentrality of the second generator."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from second_generator_law import DEEP_MM, Insertion, depths

KNOT_MM = 4.0  # spacing of the functions that stand for the heterogeneity in the noncentrality


@dataclass(frozen=True)
class Noise:
    """Sensor noise e_i = colour e_{i-1} + n_i of standard deviation `rms_n`; `colour` is 0 for white noise."""

    rms_n: float
    colour: float

    def draw(self, rng: np.random.Generator, samples: int) -> np.ndarray:
        """Noise of `samples` samples, N."""
        innovations = rng.normal(0, self.innovation_n, samples)
        innovations[0] *= self.rms_n / self.innovation_n  # stationary from the first sample on
        return lfilter([1.0], [1.0, -self.colour], innovations)

    @property
    def innovation_n(self) -> float:
        """Standard deviation of n, N."""
        return self.rms_n * float(np.sqrt(1 - self.colour**2))

    def whitened(self, columns: np.ndarray) -> np.ndarray:
        """Columns in which the noise would be independent with variance 1."""
        first = columns[:1] / self.rms_n
        return np.concatenate([first, (columns[1:] - self.colour * columns[:-1]) / self.innovation_n])


def draw_noise(rng: np.random.Generator, rate_hz: int) -> Noise:
    """White in half of the data sets, else an AR(1) with a correlation time of 4 to 30 ms."""
    rms = float(np.exp(rng.uniform(np.log(0.008), np.log(0.03))))
    if rng.random() < 0.5:
        return Noise(rms, 0.0)
    return Noise(rms, float(np.exp(-1 / (rate_hz * rng.uniform(0.004, 0.030)))))


def draw_field(rng: np.random.Generator, heterogeneity: float, length_mm: float) -> np.ndarray:
    """Smooth random function of depth: standard deviation `heterogeneity`, correlation exp(-(step/length)^2/4)."""
    table = depths()
    spacing = length_mm / 3
    knots = np.arange(-4 * length_mm, DEEP_MM + 4 * length_mm, spacing)
    weights = np.exp(-(((table[:, None] - knots[None, :]) / length_mm) ** 2) / 2)
    # the knots are independent, so the sum of squared weights is the variance
    weights /= np.sqrt(np.mean(np.sum(weights**2, axis=1)))
    return heterogeneity * weights @ rng.normal(size=len(knots))


def heterogeneity_columns(trial: Insertion, heterogeneity: float, length_mm: float) -> np.ndarray:
    """Change of the sampled force with each of the independent numbers behind the two fields of the trial."""
    knots = np.arange(0.0, DEEP_MM, KNOT_MM)
    covariance = np.exp(-(((knots[:, None] - knots[None, :]) / length_mm) ** 2) / 4)
    root = np.linalg.cholesky(covariance + 1e-6 * np.eye(len(knots)))
    table = depths()
    hats = np.maximum(0.0, 1 - np.abs(table[:, None] - knots[None, :]) / KNOT_MM) @ root
    integral = np.cumsum(hats, axis=0) * (table[1] - table[0]) * trial.tissue.friction
    # the fields act at the depth of the sample: a sampling interval is short beside the length of the field
    length, grip, tip = (trial.sampled(each) for each in (trial.length, trial.grip, trial.tip))
    index = np.clip(np.searchsorted(table, length), 0, len(table) - 1)
    return heterogeneity * np.concatenate([integral[index] * grip[:, None], hats[index] * tip[:, None]], axis=1)


def unabsorbed(signal: np.ndarray, base: np.ndarray, noise: Noise, random: np.ndarray | None = None) -> float:
    """Noncentrality of one trial: energy that base model and random functions leave, in units of the noise.

    Parameters
    ----------
    signal : array (samples,)
        Hidden force, N.
    base : array (samples, parameters)
        Sensitivities of the base model; their coefficients are free.
    noise : Noise
        Its variance and correlation.
    random : array (samples, functions), optional
        Functions with independent coefficients of variance 1 (heterogeneity).
    """
    columns = noise.whitened(np.column_stack([signal, base] if random is None else [signal, base, random]))
    scale = np.linalg.norm(columns, axis=0)
    scale[:1] = 1.0
    scale[base.shape[1] + 1 :] = 1.0
    columns = columns / np.where(scale > 0, scale, 1.0)
    gram = columns.T @ columns
    inner, cross = gram[1:, 1:], gram[1:, 0]
    ridge = np.concatenate([np.full(base.shape[1], 1e-12), np.ones(inner.shape[0] - base.shape[1])])
    return max(float(gram[0, 0] - cross @ np.linalg.solve(inner + np.diag(ridge), cross)), 0.0)
