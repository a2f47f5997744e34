"""Validation of the columns of a data file: their names, and whether their values are plausible in their units.

A column in another unit is refused, never converted; the message names the expected column and the factor. Values are
refused as implausible only if they cannot occur in a needle experiment, for example because a depth is in metres or a
time in milliseconds; the option `accept_units` disables this check.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.config import closest
from needleplan.errors import Mistake
from needleplan.signals import FIBRE_COLUMNS, UNITS, Array, Record, Role

__all__ = [
    "NUMBERS",
    "TEXTS",
    "column_of",
    "questionable_units",
    "unit_factor",
    "unit_of",
    "units_of",
    "validate_names",
]

NUMBERS = tuple(UNITS)
TEXTS = ("phase", "trial", "role", "coordinate_frame")

_LENGTHS = {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "inch": 25.4}
# Factor that converts a number in a unit to the unit of the column.
_UNIT_FACTORS: dict[str, dict[str, float]] = {
    "time_s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "velocity_mm_s": {"mm/s": 1.0, "m/s": 1e3, "cm/s": 10.0, "um/s": 1e-3, "mm/min": 1 / 60},
    "force_n": {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3, "gf": 9.80665e-3, "lbf": 4.4482216},
    "torque_n_mm": {"N mm": 1.0, "Nmm": 1.0, "N m": 1e3, "Nm": 1e3, "mN m": 1.0, "mNm": 1.0},
    "angle_rad": {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi, "mrad": 1e-3},
    "duty_cycle": {"1": 1.0, "%": 0.01},
    **{f"{name}_mm": _LENGTHS for name in ("depth", "x", "y", "z", "image_u", "image_v")},
    **{f"{frame}_{axis}_mm": _LENGTHS for frame in ("tracker", "plan") for axis in "xyz"},
    **{name: {"1": 1.0} for name in ("qw", "qx", "qy", "qz")},
    **{name: {"1/mm": 1.0, "1/m": 1e-3, "1/cm": 0.1} for name in FIBRE_COLUMNS},
}
_TWO_PARTS = ("velocity_mm_s", "torque_n_mm", *FIBRE_COLUMNS)  # columns whose units have two words
_BARE = {name.rsplit("_", 2)[0] if name in _TWO_PARTS else name.rsplit("_", 1)[0]: name
         for name in NUMBERS if name != "duty_cycle"}  # fmt: skip
# Column and factor by the lower-case name of a column in another unit, such as depth_m.
_CONVERSIONS = {
    f"{bare}_{unit.lower().replace('1/', 'per_').replace('/', '_').replace(' ', '_')}": (name, factor)
    for bare, name in _BARE.items()
    for unit, factor in _UNIT_FACTORS[name].items()
}


def column_of(quantity: str) -> str | None:
    """Return the column for the name of a quantity, such as force_n for `force` or `force_n`; None if there is none."""
    return quantity if quantity in NUMBERS else _BARE.get(quantity)


def unit_of(column: str) -> str:
    """Return the unit of a column."""
    return UNITS.get(column) or next(unit for unit, factor in _UNIT_FACTORS[column].items() if factor == 1.0)


def units_of(column: str) -> tuple[str, ...]:
    """Return the units from which a column can be converted."""
    return tuple(_UNIT_FACTORS[column])


def unit_factor(column: str, unit: str) -> float | None:
    """Return the factor from a unit, in any case of letters, to the unit of a column; None for another unit."""
    given = unit.strip().replace("µ", "u").replace("μ", "u").replace("·", " ").replace("°", "deg").lower()
    return next((factor for each, factor in _UNIT_FACTORS[column].items() if each.lower() == given), None)


def validate_names(names: Iterable[str]) -> tuple[tuple[str, ...], list[Mistake]]:
    """Return the names of unknown columns, which readers leave out, and the mistakes in the other names.

    It is a mistake if a name occurs twice, if a known column has another unit or spelling, or if `time_s` is missing.
    """
    unknown: list[str] = []
    mistakes: list[Mistake] = []
    seen: set[str] = set()
    names = tuple(names)
    for name in names:
        if name in seen:
            mistakes.append(Mistake(name, "", "occurs twice"))
        seen.add(name)
        if name in NUMBERS or name in TEXTS:
            continue
        rule = _meant(name, names)
        if rule:
            mistakes.append(Mistake(name, "", rule))
        else:
            unknown.append(name)
    if "time_s" not in seen and not any("time_s" in mistake.rule for mistake in mistakes):
        mistakes.append(
            Mistake(
                "time_s", "", "is missing: every data file needs this column; --columns reads files with other names"
            )
        )
    return tuple(unknown), mistakes


def _meant(name: str, names: Sequence[str]) -> str:
    """Return the rule that an unknown column name violates, or "" if the column is another quantity.

    A name that resembles a known column counts as another quantity if the file also has the known column, for example
    force_x in a file with force_n.
    """
    lower = name.strip().lower().replace(" ", "_")
    if lower in NUMBERS or lower in TEXTS:
        return f'must be written "{lower}"'
    if lower in _CONVERSIONS:
        wanted, factor = _CONVERSIONS[lower]
        return f"must be {wanted}: multiply by {factor:.10g} and rename the column"
    if lower in _BARE:
        wanted = _BARE[lower]
        return f'must carry its unit, {UNITS[wanted]}: convert where necessary and rename it "{wanted}"'
    close = closest(lower, [*NUMBERS, *TEXTS], cutoff=0.8)
    return f'is not a known column; did you mean "{close}"?' if close and close not in names else ""


@dataclass(frozen=True)
class _Range:
    """Plausible range of a column, with the likely mistake if values are smaller or larger."""

    least: float
    too_small: str
    most: float
    too_large: str


_SPANS = {
    "depth_mm": _Range(0.5, "in metres?", 1000, "in micrometres?"),
    "velocity_mm_s": _Range(0.02, "in metres per second?", 2000, "in micrometres per second?"),
    "force_n": _Range(5e-3, "in kilonewtons, or not calibrated?", 200, "in millinewtons, or not calibrated?"),
    "torque_n_mm": _Range(1e-4, "in newton metres?", 1e4, "not calibrated?"),
    "angle_rad": _Range(0, "", 31.5, "in degrees?"),
    "duty_cycle": _Range(0, "", 1, "in percent?"),
    **dict.fromkeys(FIBRE_COLUMNS, _Range(0, "", 0.1, "in 1/m?")),
}
_POSITIONS = _Range(0.02, "in metres?", 10_000, "in micrometres?")
_STEPS = _Range(1e-5, "not in seconds?", 2.0, "in milliseconds?")
# Median speed (mm/s) while moving above which depth or time have another unit or scale; needles move at 0.1 to 50 mm/s.
_FASTEST = 150.0
_AGREE = 5.0  # ratio of velocity to change of depth per time above which (or below 1/5) their units disagree


def questionable_units(record: Record) -> list[Mistake]:
    """Return a mistake for every column with implausible values; of the three positions, only for the widest.

    If there is none, velocity and depth are compared. Records of noise may have arbitrarily small values.
    """
    mistakes = []
    quiet = record.role is Role.NOISE
    for name, allowed in _SPANS.items():
        if name in record.columns:
            size = _span(record[name]) if name == "depth_mm" else _largest(record[name])
            mistakes += _out_of_range(name, size, UNITS[name], allowed, quiet)
    places = {name: _span(record[name]) for name in ("x_mm", "y_mm", "z_mm") if name in record.columns}
    if places:
        name = max(places, key=lambda column: places[column])
        mistakes += _out_of_range(name, places[name], "mm", _POSITIONS, quiet)
    steps = np.diff(record["time_s"])
    if steps.size:
        mistakes += _out_of_range("time_s", float(np.median(steps)), "s from sample to sample", _STEPS, False)
    return mistakes or _agreement(record)


def _out_of_range(name: str, size: float, unit: str, allowed: _Range, quiet: bool) -> list[Mistake]:
    if 0 < size < allowed.least and not quiet:
        rule = f"is questionably small, {allowed.too_small}"
    elif size > allowed.most:
        rule = f"is questionably large, {allowed.too_large}"
    else:
        return []
    return [
        Mistake(
            name,
            f"{size:.3g} {unit}",
            f"{rule} Convert it, or accept the units as they are (--accept-units, accept_units=True)",
        )
    ]


def _agreement(record: Record) -> list[Mistake]:
    """Return a mistake if velocity and change of depth per time disagree in unit or sign.

    Both are compared by the slope of a regression, which is robust against noise in the depth.
    """
    if "depth_mm" not in record.columns or len(record) < 5:
        return []
    if "velocity_mm_s" not in record.columns:
        return _too_fast(record)
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


def _too_fast(record: Record) -> list[Mistake]:
    speed = np.abs(np.diff(record["depth_mm"]) / np.diff(record["time_s"]))
    moving = speed[np.isfinite(speed) & (speed > 0)]
    middle = float(np.median(moving)) if moving.size else 0.0
    if middle <= _FASTEST:
        return []
    said = f"{_span(record['depth_mm']):.3g} mm in {float(np.ptp(record['time_s'])):.3g} s"
    rule = (
        f"the depth changes by {middle:.3g} mm/s, which is questionably fast for a needle: does the scale of depth_mm "
        "or time_s agree with the documented speed? Convert it, or accept the units as they are (--accept-units, "
        "accept_units=True)"
    )
    return [Mistake("depth_mm", said, rule)]


def _span(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.ptp(good)) if good.size else 0.0


def _largest(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.abs(good).max()) if good.size else 0.0
