"""Motion profiles: linear segments with parabolic blends (LSPB), the trapezoidal velocity of a robot's linear stage.

From one depth to the next the velocity rises linearly for `blend_s`, stays at the preset velocity v, and falls
linearly for `blend_s`; the acceleration is a = v / blend_s. A segment shorter than v * blend_s never reaches v: its
velocity is a triangle of the same acceleration. The position is the exact integral of the velocity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals.array import Array
from needleplan.signals.motion import Motion

__all__ = ["insertion_cycles", "lspb"]


def lspb(
    depths_mm: Sequence[float],
    velocities_mm_s: Sequence[float],
    *,
    blend_s: float = 0.5,
    dwells_s: Sequence[float] | None = None,
    rate_hz: float = 200.0,
) -> Motion:
    """Move through `depths_mm`, coming to rest at each.

    `velocities_mm_s`, positive, is the speed of the linear part of each segment, one fewer than there are depths;
    `dwells_s` is the time at rest at each depth but the first (default: none). Sampled at `rate_hz`; the last sample is
    the first at or after the end. Raises DataError, with all mistakes, for numbers that make no profile.
    """
    dwells = [0.0] * len(velocities_mm_s) if dwells_s is None else list(dwells_s)
    _require(depths_mm, velocities_mm_s, dwells, blend_s, rate_hz)
    times, starts, velocities, accelerations = _pieces(depths_mm, velocities_mm_s, dwells, blend_s)
    # Rounding must not add a sample at rest after a motion whose end is on the grid.
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
    """Insert from the surface to `depth_mm` and retract, `cycles` times.

    The retraction has the speed of the insertion unless `retraction_mm_s` says otherwise; `dwell_s` is the rest at full
    depth, `pause_s` that at the surface between cycles. Raises DataError as `lspb` does.
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
    """Return start time, depth, velocity and acceleration of every piece of constant acceleration, rest at the end."""
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
    # What follows the end is rest at the last depth.
    return times_, np.array([*starts, depths[-1]]), np.array([*velocities, 0.0]), np.array([*accelerations, 0.0])


def _require(
    depths: Sequence[float], speeds: Sequence[float], dwells: Sequence[float], blend_s: float, rate_hz: float
) -> None:
    mistakes = []
    if len(depths) < 2 or len(speeds) != len(depths) - 1:
        rule = f"must be one fewer than the depths, of which there are {len(depths)}, at least two"
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
