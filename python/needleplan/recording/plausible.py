"""Whether numbers can be in the units that their columns promise.

Only what no needle does is questioned: a depth in metres, a time in milliseconds, a force in millinewtons. Whoever
means it says so (`accept_units`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.errors import Mistake
from needleplan.signals import Array, Record, Role
from needleplan.signals.record import UNITS

__all__ = ["questionable_units"]


@dataclass(frozen=True)
class _Range:
    """Between which sizes a column lies in an experiment with needles, and what is likely where it does not."""

    least: float
    too_small: str
    most: float
    too_large: str


_SPANS = {
    "depth_mm": _Range(0.5, "in metres?", 1000, "in micrometres?"),
    "velocity_mm_s": _Range(0.02, "in metres per second?", 2000, "in micrometres per second?"),
    "force_n": _Range(1e-4, "in kilonewtons, or not calibrated?", 200, "in millinewtons, or not calibrated?"),
    "torque_n_mm": _Range(1e-4, "in newton metres?", 1e4, "not calibrated?"),
    "angle_rad": _Range(0, "", 31.5, "in degrees?"),
}
_POSITIONS = _Range(0.02, "in metres?", 10_000, "in micrometres?")
_STEPS = _Range(1e-5, "not in seconds?", 2.0, "in milliseconds?")
_AGREE = 5.0
"""Factor between depth per time and velocity beyond which their units cannot be the same."""


def questionable_units(record: Record) -> list[Mistake]:
    """Return a mistake for every column whose size no needle has; a record of noise may be as small as it likes."""
    found = []
    quiet = record.role is Role.NOISE
    for name, allowed in _SPANS.items():
        if name in record.columns:
            size = _span(record[name]) if name == "depth_mm" else _largest(record[name])
            found += _judge(name, size, UNITS[name], allowed, quiet)
    places = {name: _span(record[name]) for name in ("x_mm", "y_mm", "z_mm") if name in record.columns}
    if places:
        name = max(places, key=lambda each: places[each])
        found += _judge(name, places[name], "mm", _POSITIONS, quiet)
    steps = np.diff(record["time_s"])
    if steps.size:
        found += _judge("time_s", float(np.median(steps)), "s from sample to sample", _STEPS, False)
    return found or _agreement(record)


def _judge(name: str, size: float, unit: str, allowed: _Range, quiet: bool) -> list[Mistake]:
    if 0 < size < allowed.least and not quiet:
        rule = f"is questionably small, {allowed.too_small}"
    elif size > allowed.most:
        rule = f"is questionably large, {allowed.too_large}"
    else:
        return []
    return [Mistake(name, f"{size:.3g} {unit}", f"{rule} Convert it, or accept the units as they are")]


def _agreement(record: Record) -> list[Mistake]:
    """Compare the velocity with the change of the depth, by the slope between them: it bears noise in the depth."""
    if not {"depth_mm", "velocity_mm_s"} <= record.columns.keys() or len(record) < 5:
        return []
    given, steps = record["velocity_mm_s"], np.diff(record["time_s"])
    middle = (given[1:] + given[:-1]) / 2
    moved = np.diff(record["depth_mm"]) / steps
    good = np.isfinite(middle) & np.isfinite(moved)
    power = float(middle[good] ** 2 @ steps[good])
    if power == 0 or _span(record["depth_mm"]) == 0:
        return []
    slope = float((middle[good] * moved[good]) @ steps[good]) / power
    if 1 / _AGREE <= slope <= _AGREE:
        return []
    rule = f"must be the change of depth_mm per time, which is {slope:.3g} times as much: their units or signs differ"
    return [Mistake("velocity_mm_s", "", rule)]


def _span(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.ptp(good)) if good.size else 0.0


def _largest(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.abs(good).max()) if good.size else 0.0
