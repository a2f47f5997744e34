"""Periodic motions of the needle: what friction is identified from (thesis, sections 3.4.1 and 3.4.2)."""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals.array import Array
from needleplan.signals.motion import Motion

__all__ = ["Start", "cycles", "sinusoid"]

_MOVING = 0.05
"""Share of the largest speed below which a sample says nothing about the direction of a measured motion."""


class Start(StrEnum):
    """Where a sine begins. Both begin at rest: a sine that begins at full speed gives bristles a blow (3 to 4 N)."""

    END = "end"
    """At an end of the stroke, where the velocity is zero: offset -+ amplitude cos."""

    MIDDLE = "middle"
    """In the middle of the stroke, with a clock that takes a while to reach its speed: offset +- amplitude sin."""


def sinusoid(
    *,
    offset_mm: float,
    amplitude_mm: float,
    frequency_hz: float,
    cycles: float = 4.0,
    rate_hz: float = 200.0,
    start: Start = Start.END,
    outward: bool = False,
    ramp_cycles: float = 0.25,
) -> Motion:
    """Return a sine about the depth `offset_mm`; `amplitude_mm` is from zero to peak. It moves in first, or `outward`.

    From the middle, the phase speeds up evenly during the first `ramp_cycles` periods, so that the velocity begins at
    zero and never exceeds 2 pi frequency amplitude. Velocities are the derivative, not differences. Raises DataError
    for numbers that are not positive, or fewer than two samples.
    """
    numbers = {
        "amplitude_mm": amplitude_mm, "frequency_hz": frequency_hz, "cycles": cycles, "rate_hz": rate_hz,
        "ramp_cycles": ramp_cycles,
    }  # fmt: skip
    mistakes = [
        Mistake(name, f"{value:g}", "must be a positive number")
        for name, value in numbers.items()
        if not 0 < value < math.inf
    ]
    if not math.isfinite(offset_mm):
        mistakes.append(Mistake("offset_mm", str(offset_mm), "must be a finite number"))
    if mistakes:
        raise DataError(mistakes, "sinusoid")
    omega = 2 * math.pi * frequency_hz
    ramp = ramp_cycles / frequency_hz if start is Start.MIDDLE else 0.0
    time = np.arange(round((cycles / frequency_hz + ramp / 2) * rate_hz) + 1) / rate_hz
    early = time < ramp
    phase = omega * np.where(early, time**2 / (2 * ramp or 1.0), time - ramp / 2)
    phase_rate = omega * np.where(early, time / (ramp or 1.0), 1.0)
    size = -amplitude_mm if outward else amplitude_mm
    if start is Start.END:
        depth, velocity = offset_mm - size * np.cos(phase), size * phase_rate * np.sin(phase)
    else:
        depth, velocity = offset_mm + size * np.sin(phase), size * phase_rate * np.cos(phase)
    return Motion.sampled(time, depth, velocity)


def cycles(motion: Motion) -> Array:
    """Return for every sample how many cycles, each two reversals, are behind it; shape (samples,).

    Samples slower than a twentieth of the largest speed belong to the movement before, so that the noise of a measured
    velocity makes no reversals. A motion that begins in the middle has a first cycle of three quarters of a period.
    """
    velocity = motion.velocity_mm_s
    sure = np.abs(velocity) >= _MOVING * np.abs(velocity).max()
    moving = np.flatnonzero(sure & (velocity != 0))
    if not moving.size:
        return np.zeros(len(motion))
    sign = np.sign(velocity[moving])
    reversals = np.concatenate([[0], np.cumsum(sign[1:] != sign[:-1])])
    last = np.searchsorted(moving, np.arange(len(motion)), side="right") - 1
    passed: Array = np.asarray(reversals[np.maximum(last, 0)] // 2, float)
    return passed
