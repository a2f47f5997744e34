"""Base laws of the third generator: friction along the shaft, force of the tip, and their reversal.

The documented law has the depth L and the bristle z, and a sample is the mean of the force over one sample
interval:

    F = friction L z + cutting (1 - exp(-L/onset)) (1 + z)/2,      dz = (1 - sign z) dx/presliding

Other laws replace the way in which z follows the travel, the rise of the tip force with the depth, the share of
the tip force during a reversal, and the friction of the first millimetres. All reversal laws are exact on each
monotone piece of the motion.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from scipy.ndimage import gaussian_filter1d
from third_generator_motion import FINE_HZ, Array, StagePath

STEP_MM = 0.1  # grid of the heterogeneity along the depth
DEEPEST_MM = 90.0


@dataclass(frozen=True)
class Trial:
    """One insertion: its motion, its parameters, and its tissue (relative deviations over a grid of depths)."""

    name: str
    role: str
    number: int
    rate_hz: int
    path: StagePath
    base: dict[str, float]
    shaft_deviation: Array
    tip_deviation: Array

    def shaft_mm(self, depth: Array) -> Array:
        """Give the length of the shaft in tissue, weighted by the relative friction of each place."""
        inside = np.maximum(depth, 0.0)
        if not self.shaft_deviation.any():
            return inside
        grid = np.arange(self.shaft_deviation.size) * STEP_MM
        middle = (self.shaft_deviation[1:] + self.shaft_deviation[:-1]) / 2
        return inside + np.interp(inside, grid, np.concatenate([[0.0], np.cumsum(middle)]) * STEP_MM)

    def tip_factor(self, depth: Array) -> Array | float:
        """Give the relative tip force of the tissue at the depths."""
        if not self.tip_deviation.any():
            return 1.0
        return 1.0 + np.interp(depth, np.arange(self.tip_deviation.size) * STEP_MM, self.tip_deviation)

    def sampled(self, fine: Array) -> Array:
        """Give the mean over one sample interval around each sample of a force on the fine grid."""
        every = FINE_HZ // self.rate_hz
        total = np.concatenate([[0.0], np.cumsum(fine[1:] + fine[:-1])]) / 2
        at = np.arange(0, fine.size, every)
        low, high = np.maximum(at - every // 2, 0), np.minimum(at + every // 2, fine.size - 1)
        return (total[high] - total[low]) / (high - low)

    def points(self, fine: Array) -> Array:
        """Give the values of a quantity of the fine grid at the sampling times."""
        return fine[:: FINE_HZ // self.rate_hz]


def deviations(rng: Generator, heterogeneity: float, length_mm: float) -> Array:
    """Draw a smooth random function of depth with a Gaussian correlation of the given length."""
    count = round(DEEPEST_MM / STEP_MM)
    white = rng.standard_normal(count)
    sd = length_mm / np.sqrt(2) / STEP_MM
    smooth = gaussian_filter1d(white, sd, mode="wrap") * np.sqrt(2 * np.sqrt(np.pi) * sd)
    return np.asarray(np.maximum(heterogeneity * smooth, -0.9))


def pieces(x: Array) -> list[tuple[int, int, float]]:
    """Divide a travel into monotone pieces (first index, last index, direction); a rest ends a piece."""
    moves = np.diff(x)
    moving = np.flatnonzero(np.abs(moves) > 1e-12)
    if not moving.size:
        return [(0, x.size - 1, 1.0)]
    signs = np.sign(moves[moving])
    starts = np.concatenate([[0], moving[np.flatnonzero(np.diff(signs)) + 1]])
    ends = np.append(starts[1:], x.size - 1)
    ways = np.concatenate([[signs[0]], signs[np.flatnonzero(np.diff(signs)) + 1]])
    return [(int(a), int(b), float(s)) for a, b, s in zip(starts, ends, ways, strict=True)]


Reversal = Callable[[float, float, Array], Array]  # (direction, z before, travel in presliding lengths) -> z


def exponential(way: float, before: float, travel: Array) -> Array:
    """Dahl's law: the bristle approaches the direction exponentially."""
    return way - (way - before) * np.exp(-travel)


def powered(exponent: float) -> Reversal:
    """Dahl's law with an exponent: d(1 - s z) = -(1 - s z)^exponent dx."""

    def law(way: float, before: float, travel: Array) -> Array:
        left = max(1 - way * before, 1e-9) ** (1 - exponent) + (exponent - 1) * travel
        return way * (1 - np.maximum(left, 1e-12) ** (1 / (1 - exponent)))

    return law


def elastoplastic(share: float) -> Reversal:
    """Elastic up to `share` of the full friction, then exponentially plastic (after Dupont et al.)."""

    def law(way: float, before: float, travel: Array) -> Array:
        elastic = max(share - way * before, 0.0)
        start = max(share, way * before)
        plastic = 1 - (1 - start) * np.exp(-np.maximum(travel - elastic, 0.0) / (1 - share))
        return way * np.where(travel < elastic, way * before + travel, plastic)

    return law


def plastic(way: float, before: float, travel: Array) -> Array:
    """One element of Iwan's model: elastic, then perfectly plastic."""
    return np.clip(before + way * travel, -1.0, 1.0)


@dataclass(frozen=True)
class BaseLaw:
    """A base law; the default is the documented one.

    `elements` are (weight, presliding relative to the parameter) of parallel bristles, `compliance` makes the
    presliding grow with the depth, `damping_s` is LuGre's damping of the bristles, `rim_mm` the depth of looser
    contact at the entry.
    """

    reversal: Reversal = exponential
    elements: tuple[tuple[float, float], ...] = ((1.0, 1.0),)
    onset: Callable[[Array], Array] = field(default=lambda y: -np.expm1(-y))
    tip_exponent: float = 1.0
    compliance: float = 0.0
    damping_s: float = 0.0
    rim_mm: float = 0.0

    def bristle(self, slide: Array, presliding_mm: float, widths: tuple[tuple[float, float], ...] = ()) -> Array:
        """Give z along a travel; `widths` are (weight, further presliding in mm) of parts of the contact."""
        parts = pieces(slide)
        if self.compliance:
            deep = np.maximum(slide, 0.0) / 40.0
            slide = np.where(slide > 0, 40 * np.log1p(self.compliance * deep) / self.compliance, slide)
        z = np.zeros_like(slide)
        for share, more in widths or ((1.0, 0.0),):
            for weight, ratio in self.elements:
                width = presliding_mm * ratio + more
                one, before = np.empty_like(slide), 0.0
                for first, last, way in parts:
                    travel = np.abs(slide[first : last + 1] - slide[first]) / width
                    one[first : last + 1] = self.reversal(way, before, travel)
                    before = float(one[last])
                z += share * weight * one
        return z

    def damped(self, z: Array) -> Array:
        """Add the damping of the bristles."""
        return z + self.damping_s * np.gradient(z, 1 / FINE_HZ) if self.damping_s else z

    def pushed(self, z: Array) -> Array:
        """Give the share of the tip force: 1 while the tip is pushed in, 0 while it is withdrawn."""
        share = np.clip((1 + z) / 2, 0.0, 1.0)
        return share if self.tip_exponent == 1.0 else share**self.tip_exponent

    def tip(self, depth: Array, cutting: float, onset_mm: float) -> Array:
        """Give the force of a tip that is pushed in (N)."""
        return cutting * self.onset(np.maximum(depth, 0.0) / onset_mm)

    def rim(self, length: Array) -> Array:
        """Take the loose contact at the entry off an inserted length (mm)."""
        return length + self.rim_mm * np.expm1(-length / self.rim_mm) if self.rim_mm else length


DOCUMENTED = BaseLaw()

ONSETS: dict[str, Callable[[float], Callable[[Array], Array]]] = {
    "weibull": lambda n: lambda y: -np.expm1(-(y ** (1 + 0.4 * n))),
    "hill": lambda n: lambda y: y ** (1.4 + 0.4 * n) / (y ** (1.4 + 0.4 * n) + 0.7 ** (1.4 + 0.4 * n)),
    "tanh": lambda n: lambda y: np.tanh((0.8 + 0.2 * n) * y),
    "smooth ramp": lambda n: lambda y: y / (2 * (1 + (y / 2) ** (3 + 3 * n)) ** (1 / (3 + 3 * n))),
}
REVERSALS = ("two bristles", "powered", "elastoplastic", "iwan", "lugre", "compliant")


def other_law(rng: Generator) -> tuple[BaseLaw, dict[str, object]]:
    """Draw another law of friction, reversal and onset, with a description for the truth."""
    name, onset = str(rng.choice(REVERSALS)), str(rng.choice(list(ONSETS)))
    a, b, c = rng.random(3)
    shape: dict[str, object] = {}
    if name == "two bristles":
        shape["elements"] = ((0.5 + 0.3 * a, 0.55 + 0.25 * b), (0.5 - 0.3 * a, 1.6 + 1.2 * c))
    elif name == "powered":
        shape["reversal"] = powered(0.65 + 0.2 * b if a < 0.5 else 1.15 + 0.35 * b)
    elif name == "elastoplastic":
        shape["reversal"] = elastoplastic(0.1 + 0.3 * a)
    elif name == "iwan":
        shape["reversal"] = plastic
        widths = (1 + b) * np.array([0.4, 0.8, 1.3, 2.0, 3.0]) / 1.5
        shape["elements"] = tuple((0.2, float(each)) for each in widths)
    elif name == "lugre":
        shape["damping_s"] = 0.0005 + 0.0015 * a
    else:
        shape["compliance"] = 0.2 + 0.6 * a
    law = BaseLaw(
        onset=ONSETS[onset](float(rng.random())), tip_exponent=float(rng.uniform(0.8, 1.3)),
        rim_mm=float(rng.uniform(0.2, 1.2)), **shape,  # type: ignore[arg-type]
    )  # fmt: skip
    said = {
        "reversal": name,
        "onset": onset,
        "tip_exponent": round(law.tip_exponent, 3),
        "rim_mm": round(law.rim_mm, 3),
    }
    return law, said


def documented_force(trial: Trial, base: dict[str, float]) -> Array:
    """Give the samples of the documented law in homogeneous tissue, for the motion of a trial."""
    depth = trial.path.depth_mm
    z = DOCUMENTED.bristle(depth, base["presliding_mm"])
    tip = DOCUMENTED.tip(depth, base["cutting"], base["onset_mm"])
    return trial.sampled(base["friction"] * np.maximum(depth, 0.0) * z + tip * DOCUMENTED.pushed(z))


def sensitivities(trial: Trial, base: dict[str, float]) -> Array:
    """Give the derivatives of the documented force by the logarithms of the four parameters, shape [samples, 4]."""
    columns = []
    for key in ("friction", "cutting", "onset_mm", "presliding_mm"):
        up, down = ({**base, key: base[key] * np.exp(step)} for step in (0.01, -0.01))
        columns.append((documented_force(trial, up) - documented_force(trial, down)) / 0.02)
    return np.column_stack(columns)
