"""The names of the columns of a data file, and what is said about a name that is not one of them.

A column in another unit is not converted behind anybody's back: the message says the name that is wanted and the
factor.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

from needleplan.errors import Mistake
from needleplan.signals.record import UNITS

__all__ = ["NUMBERS", "TEXTS", "judge_names"]

NUMBERS = tuple(UNITS)
TEXTS = ("phase", "trial", "role")

_LENGTHS = {"m": 1e3, "cm": 10.0, "um": 1e-3, "inch": 25.4}
_FACTORS: dict[str, dict[str, float]] = {
    "time_s": {"time_ms": 1e-3, "time_us": 1e-6, "time_ns": 1e-9, "time_min": 60.0},
    "velocity_mm_s": {"velocity_m_s": 1e3, "velocity_cm_s": 10.0, "velocity_mm_min": 1 / 60},
    "force_n": {"force_mn": 1e-3, "force_kn": 1e3, "force_gf": 9.80665e-3, "force_lbf": 4.4482216},
    "torque_n_mm": {"torque_n_m": 1e3, "torque_nm": 1e3, "torque_mn_m": 1.0, "torque_mnm": 1.0},
    "angle_rad": {"angle_deg": math.pi / 180, "angle_rev": 2 * math.pi, "angle_mrad": 1e-3},
    **{
        f"{name}_mm": {f"{name}_{unit}": factor for unit, factor in _LENGTHS.items()}
        for name in ("depth", "x", "y", "z")
    },
}
_CONVERSIONS = {other: (name, factor) for name, others in _FACTORS.items() for other, factor in others.items()}
_BARE = {name.rsplit("_", 2)[0] if name in ("velocity_mm_s", "torque_n_mm") else name.rsplit("_", 1)[0]: name
         for name in NUMBERS}  # fmt: skip


def judge_names(names: Iterable[str]) -> tuple[tuple[str, ...], list[Mistake]]:
    """Return the names that are left out because nothing here needs them, and the mistakes among the others.

    A name is a mistake where it stands twice, is a known column in another unit or spelling, or is nearly one.
    """
    unknown: list[str] = []
    mistakes: list[Mistake] = []
    seen: set[str] = set()
    names = tuple(names)
    for name in names:
        if name in seen:
            mistakes.append(Mistake(name, "", "stands there twice"))
        seen.add(name)
        if name in NUMBERS or name in TEXTS:
            continue
        rule = _meant(name, names)
        if rule:
            mistakes.append(Mistake(name, "", rule))
        else:
            unknown.append(name)
    if "time_s" not in seen and not any("time_s" in each.rule for each in mistakes):
        mistakes.append(Mistake("time_s", "", "is missing: every file of data needs this column"))
    return tuple(unknown), mistakes


def _meant(name: str, names: Sequence[str]) -> str:
    """Return the rule that a name breaks, or nothing where it means something else altogether.

    A name like that of a column that is there too, such as force_x beside force_n, is another quantity and no slip.
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
    close = get_close_matches(lower, [*NUMBERS, *TEXTS], n=1, cutoff=0.8)
    return f'is not a known column; did you mean "{close[0]}"?' if close and close[0] not in names else ""
