"""A motion to be made next, whatever for; and how a trial of it would be calibrated, before there is one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.calibrate import Calibration, Case, fit_case, late
from needleplan.diagnosis.program import Program
from needleplan.models import Model, simulate
from needleplan.signals import Motion, Record, Role

__all__ = ["NextMotion", "Tried", "predicted_case"]

Tried = tuple[Program, Motion]
"""A program, and its motion at the rate of the recordings."""


@dataclass(frozen=True)
class NextMotion(ABC):
    """The motion to be made next, and the role that its recording should have."""

    program: Program
    motion: Motion
    role: Role

    @property
    @abstractmethod
    def why(self) -> str:
        """What is expected of it, and of the last motion once more; a sentence or two for a person."""


def predicted_case(base: Model, calibration: Calibration, motion: Motion) -> Case:
    """Return a trial of a motion as it would be calibrated: what the base can take up there, and the tissue vary."""
    lag_s = float(np.mean([case.lag_s for case in calibration.training]))
    output = late(simulate(base, motion).output.ravel(), motion, lag_s)
    columns = dict(zip(base.channel.columns, np.split(output, len(base.channel.columns)), strict=True))
    record = Record(
        {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
         "angle_rad": motion.angle_rad, **columns}, "next",
    )  # fmt: skip
    return fit_case(base, record, calibration.noise, calibration.free, start_lag_s=lag_s, about=base)
