"""Motion profiles: sines for the identification of friction, and trapezoidal velocities for insertions.

A robot's linear stage follows the trapezoidal profile (linear segments with parabolic blends, LSPB). From one depth to
the next, the velocity rises linearly for `blend_s`, is constant at the preset velocity v, and falls linearly for
`blend_s`; the acceleration is v / blend_s. On a segment shorter than v * blend_s the velocity is a triangle with the
same acceleration. The position is the exact integral of the velocity. Sections 3.4.1 and 3.4.2 of the thesis define the
sines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from itertools import pairwise

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals._record import Array, Motion

__all__ = ["Start", "cycles", "insertion_cycles", "lspb", "sinusoid"]

# Share of the largest speed below which the sign of a measured velocity is ignored.
_MOVING = 0.05


class Start(StrEnum):
    """Where a sinusoidal motion begins.

    The motion begins at rest. A start at full speed would add a step of 3 to 4 N, from the damping of the bristles. In
    the formulas below, the upper sign holds for a motion that moves in first.
    """

    END = "end"
    """At one end of the stroke, where the velocity is zero: depth = offset -+ amplitude cos(phase)."""

    MIDDLE = "middle"
    """In the middle of the stroke, with a phase that accelerates from rest: depth = offset +- amplitude sin(phase)."""


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
    """Return a sinusoidal motion around a depth.

    The velocity is the exact derivative of the depth. If the motion starts in the middle, the phase accelerates
    uniformly during the first `ramp_cycles` periods: the velocity begins at zero and never exceeds 2 pi frequency
    amplitude, and the motion takes ramp_cycles / 2 periods longer.

    Parameters
    ----------
    offset_mm : float
        Depth in the middle (mm).
    amplitude_mm : float
        Zero-to-peak amplitude (mm).
    frequency_hz : float
        Frequency (Hz).
    cycles : float, default 4.0
        Number of periods.
    rate_hz : float, default 200.0
        Sampling rate (Hz).
    start : Start, default Start.END
        Whether the motion starts at an end or in the middle.
    outward : bool, default False
        Whether the needle moves out first. Default: in first.
    ramp_cycles : float, default 0.25
        Duration of the acceleration of the phase, in periods.

    Returns
    -------
    Motion

    Raises
    ------
    DataError
        `offset_mm` is not finite, or another number is not positive and finite. The error lists all mistakes.
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
    """Return the number of completed cycles at every sample, shape (samples,). Every second reversal completes a cycle.

    Samples slower than a twentieth of the largest speed count as part of the previous movement, so that noise of a
    measured velocity causes no reversals. If the motion begins in the middle, the first cycle lasts three quarters of a
    period.
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


def lspb(
    depths_mm: Sequence[float],
    velocities_mm_s: Sequence[float],
    *,
    blend_s: float = 0.5,
    dwells_s: Sequence[float] | None = None,
    rate_hz: float = 200.0,
) -> Motion:
    """Return a motion through given depths that comes to rest at each depth (linear segments, parabolic blends).

    The last sample is at the end of the motion or just after it.

    Parameters
    ----------
    depths_mm : sequence of float
        Depths (mm), at least two.
    velocities_mm_s : sequence of float
        Positive speeds of the segments (mm/s), one fewer than the depths.
    blend_s : float, default 0.5
        Duration of each acceleration and deceleration (s). It is shorter on a segment too short for its speed.
    dwells_s : sequence of float, optional
        Times at rest (s) at each depth except the first. Default: 0.
    rate_hz : float, default 200.0
        Sampling rate (Hz).

    Returns
    -------
    Motion

    Raises
    ------
    DataError
        Counts do not match, numbers are out of range, or successive depths are equal. The error lists all mistakes.
    """
    dwells = [0.0] * len(velocities_mm_s) if dwells_s is None else list(dwells_s)
    _require(depths_mm, velocities_mm_s, dwells, blend_s, rate_hz)
    times, starts, velocities, accelerations = _pieces(depths_mm, velocities_mm_s, dwells, blend_s)
    # Without the tolerance, rounding could add a sample after an end that lies on the time grid.
    time = np.arange(math.ceil(times[-1] * rate_hz - 1e-9) + 1) / rate_hz
    piece = np.clip(np.searchsorted(times, time + 1e-9 / rate_hz, side="right") - 1, 0, len(starts) - 1)
    since = time - times[piece]
    depth = starts[piece] + velocities[piece] * since + accelerations[piece] * since**2 / 2
    velocity = velocities[piece] + accelerations[piece] * since
    return Motion.sampled(time, depth, np.where(np.abs(velocity) < 1e-9 * max(velocities_mm_s), 0.0, velocity))


def insertion_cycles(
    depth_mm: float,
    velocity_mm_s: float,
    *,
    retraction_mm_s: float | None = None,
    cycles: int = 1,
    blend_s: float = 0.5,
    dwell_s: float = 0.0,
    pause_s: float = 0.0,
    rate_hz: float = 200.0,
) -> Motion:
    """Return a motion that inserts from the surface to a depth and retracts, one or several times.

    Parameters
    ----------
    depth_mm : float
        Full depth (mm).
    velocity_mm_s : float
        Speed of the insertion (mm/s).
    retraction_mm_s : float, optional
        Speed of the retraction (mm/s). Default: `velocity_mm_s`.
    cycles : int, default 1
        Number of cycles.
    blend_s : float, default 0.5
        Duration of each acceleration and deceleration (s), as in `lspb`.
    dwell_s : float, default 0.0
        Time at rest at full depth (s).
    pause_s : float, default 0.0
        Time at rest at the surface between cycles (s).
    rate_hz : float, default 200.0
        Sampling rate (Hz).

    Returns
    -------
    Motion

    Raises
    ------
    DataError
        `cycles` is not a whole number of at least 1, or `lspb` raises it.
    """
    if not (isinstance(cycles, int) and cycles >= 1):
        raise DataError(Mistake("cycles", str(cycles), "must be a whole number of at least 1"))
    back = velocity_mm_s if retraction_mm_s is None else retraction_mm_s
    return lspb(
        [0.0, *[depth_mm, 0.0] * cycles],
        [velocity_mm_s, back] * cycles,
        blend_s=blend_s,
        dwells_s=[*[dwell_s, pause_s] * (cycles - 1), dwell_s, 0.0],
        rate_hz=rate_hz,
    )


def _pieces(
    depths: Sequence[float], speeds: Sequence[float], dwells: Sequence[float], blend_s: float
) -> tuple[Array, Array, Array, Array]:
    """Divide a profile into pieces of constant acceleration; the last piece is rest at the last depth.

    Return time (s), depth (mm), velocity (mm/s) and acceleration (mm/s^2) at the start of every piece, shape (pieces,).
    """
    times, starts, velocities, accelerations = [0.0], [], [], []
    for begin, end, speed, dwell in zip(depths[:-1], depths[1:], speeds, dwells, strict=True):
        sign, distance = math.copysign(1.0, end - begin), abs(end - begin)
        acceleration = speed / blend_s
        blend = min(blend_s, math.sqrt(distance / acceleration))
        peak = acceleration * blend
        ramp = peak * blend / 2
        for duration, start, velocity, change in (
            (blend, begin, 0.0, acceleration),
            ((distance - 2 * ramp) / peak, begin + sign * ramp, peak, 0.0),
            (blend, end - sign * ramp, peak, -acceleration),
            (dwell, end, 0.0, 0.0),
        ):
            if duration > 1e-12:
                times.append(times[-1] + duration)
                starts.append(start)
                velocities.append(sign * velocity)
                accelerations.append(sign * change)
    times_ = np.array(times)
    # After the end the needle rests at the last depth.
    return times_, np.array([*starts, depths[-1]]), np.array([*velocities, 0.0]), np.array([*accelerations, 0.0])


def _require(
    depths: Sequence[float], speeds: Sequence[float], dwells: Sequence[float], blend_s: float, rate_hz: float
) -> None:
    mistakes = []
    if len(depths) < 2 or len(speeds) != len(depths) - 1:
        rule = f"must be one fewer than the {len(depths)} depths, of which at least two are needed"
        mistakes.append(Mistake("velocities_mm_s", f"{len(speeds)} numbers", rule))
    if len(dwells) != len(speeds):
        mistakes.append(Mistake("dwells_s", f"{len(dwells)} numbers", "must be one for each velocity"))
    for name, values, positive in (
        ("depths_mm", depths, False),
        ("velocities_mm_s", speeds, True),
        ("blend_s", [blend_s], True),
        ("rate_hz", [rate_hz], True),
    ):
        for value in values:
            if not math.isfinite(value) or (positive and value <= 0):
                mistakes.append(Mistake(name, f"{value}", f"must be a {'positive' if positive else 'finite'} number"))
    mistakes += [
        Mistake("dwells_s", f"{value}", "must be a number of at least 0")
        for value in dwells
        if not (math.isfinite(value) and value >= 0)
    ]
    mistakes += [
        Mistake("depths_mm", f"{begin:g}, {end:g}", "must differ from one to the next; rest is dwells_s")
        for begin, end in pairwise(depths)
        if begin == end
    ]
    if mistakes:
        raise DataError(mistakes, "motion profile")
