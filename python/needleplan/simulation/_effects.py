"""Effects of the lab twin that a plan does not take into account, and their random streams."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from needleplan.config import ConfigTable, Maybe, Number, ruled
from needleplan.errors import SimulationError

__all__ = ["Draws", "Effects", "Stream", "random_for"]


def _amplitude(unit: str, at_most: float, default: float = 0.0, *, signed: bool = False) -> Any:
    return ruled(Number(unit, at_least=-at_most if signed else 0.0, at_most=at_most), default)


def _scale(unit: str, at_most: float, default: object = MISSING) -> Any:
    return ruled(Number(unit, above=0, at_most=at_most), default)


@dataclass(frozen=True)
class Effects(ConfigTable, key="effects", error=SimulationError):
    """Amplitudes of all effects, without an effect by default, and the time and length scales of some effects."""

    curvature_error: float = _amplitude("", 0.95, signed=True)
    """Relative difference of the true curvature from the planned curvature."""

    curvature_scatter: float = _amplitude("", 0.5)
    """Standard deviation, over insertions with different seeds, of an additional relative curvature difference."""

    curvature_speed_power: float = _amplitude("", 1, signed=True)
    """Exponent p of rate-dependent tissue: the curvature is proportional to (speed / 5 mm/s)^p."""

    pre_bend_per_mm: float = _amplitude("1/mm", 0.1, signed=True)
    """Curvature of a pre-bent needle, perpendicular to the curvature caused by the bevel, also when the tip rolls."""

    sag_per_mm: float = _amplitude("1/mm", 0.1, signed=True)
    """Downward curvature at the entry, caused by the weight of the needle. The curvature decreases in proportion to the
    length outside of the tissue."""

    heading_noise_rad_sqrt_mm: float | None = ruled(Maybe(Number("rad/sqrt(mm)", at_least=0, at_most=0.1)), None)
    """Standard deviation of the heading after 1 mm of path, in the plane and out of it; proportional to the square root
    of the path length. None: the tip noise of the plan in an insertion by a table, otherwise 0."""

    torsional_friction_n: float = _amplitude("N mm/mm", 10)
    """Torque per inserted length with which the tissue resists rotation."""

    torsional_release_mm: float = _amplitude("mm", 1000)
    """Length of insertion over which the twist of the shaft falls to 1/e; 0: insertion does not release the twist.
    `Torsion.release_mm` gives the value of isotropic friction."""

    tissue_compliance_mm_n: float = _amplitude("mm/N", 100)
    """Displacement of the tissue along the needle caused by a force of 1 N."""

    tissue_relaxation_s: float = _scale("s", 100, 0.2)
    """Ratio of the damping to the stiffness with which the tissue is supported."""

    respiration_along_mm: float = _amplitude("mm", 30)
    """Amplitude of the respiration along the direction of the entry."""

    respiration_across_mm: float = _amplitude("mm", 30)
    """Amplitude of the respiration perpendicular to the direction of the entry, to the left."""

    respiration_period_s: float = _scale("s", 60, 4.0)

    encoder_step_mm: float = _amplitude("mm", 0.1)
    """Encoder resolution of the insertion axis; 0: exact."""

    encoder_step_rad: float = _amplitude("rad", 0.1)
    """Encoder resolution of the roll axis; 0: exact."""

    reaction_mm_s2_n: float = _amplitude("mm/s^2/N", 1e4)
    """Acceleration of the insertion axis caused by 1 N on the needle: the inverse of the moved mass."""

    force_noise_n: float = _amplitude("N", 1)
    """Standard deviation of a force sample before the moving average."""

    force_offset_n: float = _amplitude("N", 10, signed=True)
    force_drift_n_s: float = _amplitude("N/s", 0.1, signed=True)
    force_gain_error: float = _amplitude("", 0.5, signed=True)

    tracker_noise_mm: float = _amplitude("mm", 5)
    """Standard deviation of the position along each axis, independent from frame to frame."""

    tracker_wander_mm: float = _amplitude("mm", 5)
    """Standard deviation of the correlated drift of the position along each axis."""

    tracker_wander_s: float = _scale("s", 1000, 1.0)
    """Time in which the correlation of the drift falls to 1/e."""

    tracker_distortion_mm: float = _amplitude("mm", 20)
    """Amplitude of a smooth distortion of the tracker's field that does not change with time."""

    tracker_distortion_length_mm: float = _scale("mm", 1e4, 200.0)
    """Wavelength of the field distortion."""

    tracker_angle_noise_rad: float = _amplitude("rad", 0.5)
    """Standard deviation of the direction of the coil, about each axis perpendicular to it."""

    tracker_dropout: float = _amplitude("", 1)
    """Probability that a dropout begins at a frame."""

    tracker_dropout_s: float = _scale("s", 60, 0.1)
    """Mean duration of a dropout."""

    coil_offset_mm: float = _amplitude("mm", 50)
    """Distance of the coil behind the tip."""


class Stream(IntEnum):
    """Random streams: each random effect has its own stream, so one effect does not change the numbers of another.

    The values must never change, because the random numbers depend on them.
    """

    CURVATURE = 1
    HEADING = 2
    RESPIRATION = 3
    FORCE_NOISE = 4
    TRACKER_NOISE = 5
    TRACKER_WANDER = 6
    TRACKER_ANGLE = 7
    TRACKER_DROPOUT = 8
    TRACKER_FIELD = 9
    ENTRY = 10


def random_for(seed: int, stream: Stream) -> np.random.Generator:
    """Return the random generator of a stream for a seed (0 or above)."""
    return np.random.default_rng([seed, int(stream)])


class Draws:
    """Rows of standard normal numbers, which are drawn in blocks."""

    def __init__(self, random: np.random.Generator, width: int) -> None:
        self._random, self._width = random, width
        self._rows: list[list[float]] = []

    def next(self) -> list[float]:
        """Return the next row of `width` numbers."""
        if not self._rows:
            self._rows = self._random.standard_normal((256, self._width))[::-1].tolist()
        return self._rows.pop()
