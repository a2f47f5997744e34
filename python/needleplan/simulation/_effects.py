"""Effects of the lab twin that a plan does not take into account, and their random streams."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from needleplan.config import ConfigTable, Maybe, Number, ruled
from needleplan.errors import SimulationError
from needleplan.models.effects import lab_key

__all__ = ["Draws", "Effects", "Stream", "random_for"]


def _key(name: str) -> Any:
    """Declare a field by the catalogue of the effects."""
    declared = lab_key(name)
    rule = Number(declared.unit, at_least=declared.lower, at_most=declared.upper)
    return ruled(Maybe(rule) if declared.default is None else rule, declared.default, about=declared.about)


@dataclass(frozen=True)
class Effects(ConfigTable, key="effects", error=SimulationError):
    """Amplitudes of all effects, without an effect by default, and the time and length scales of some effects.

    `needleplan.models.effects.LAB_EFFECTS` declares unit, range, equation and meaning of each.
    """

    curvature_error: float = _key("curvature_error")
    curvature_scatter: float = _key("curvature_scatter")
    curvature_speed_power: float = _key("curvature_speed_power")
    pre_bend_per_mm: float = _key("pre_bend_per_mm")
    sag_per_mm: float = _key("sag_per_mm")
    sag_fading_mm: float | None = _key("sag_fading_mm")
    heading_noise_rad_sqrt_mm: float | None = _key("heading_noise_rad_sqrt_mm")
    torsional_friction_n: float = _key("torsional_friction_n")
    torsional_release_mm: float = _key("torsional_release_mm")
    tissue_compliance_mm_n: float = _key("tissue_compliance_mm_n")
    tissue_relaxation_s: float = _key("tissue_relaxation_s")
    respiration_along_mm: float = _key("respiration_along_mm")
    respiration_across_mm: float = _key("respiration_across_mm")
    respiration_period_s: float = _key("respiration_period_s")
    respiration_rest: float = _key("respiration_rest")
    encoder_step_mm: float = _key("encoder_step_mm")
    encoder_step_rad: float = _key("encoder_step_rad")
    reaction_mm_s2_n: float = _key("reaction_mm_s2_n")
    force_noise_n: float = _key("force_noise_n")
    force_offset_n: float = _key("force_offset_n")
    force_drift_n_s: float = _key("force_drift_n_s")
    force_gain_error: float = _key("force_gain_error")
    tracker_noise_mm: float = _key("tracker_noise_mm")
    tracker_wander_mm: float = _key("tracker_wander_mm")
    tracker_wander_s: float = _key("tracker_wander_s")
    tracker_distortion_mm: float = _key("tracker_distortion_mm")
    tracker_distortion_length_mm: float = _key("tracker_distortion_length_mm")
    tracker_angle_noise_rad: float = _key("tracker_angle_noise_rad")
    tracker_dropout: float = _key("tracker_dropout")
    tracker_dropout_s: float = _key("tracker_dropout_s")
    fibre_noise_per_mm: float = _key("fibre_noise_per_mm")
    fibre_bias_per_mm: float = _key("fibre_bias_per_mm")
    ultrasound_noise_mm: float = _key("ultrasound_noise_mm")
    ultrasound_missed: float = _key("ultrasound_missed")
    ultrasound_outliers: float = _key("ultrasound_outliers")
    ultrasound_outlier_mm: float = _key("ultrasound_outlier_mm")
    ultrasound_delay_s: float = _key("ultrasound_delay_s")
    coil_offset_mm: float = _key("coil_offset_mm")


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
    FIBRE_NOISE = 11
    FIBRE_BIAS = 12
    ULTRASOUND_NOISE = 13
    ULTRASOUND_CHANCE = 14


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
