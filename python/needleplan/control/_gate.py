"""Gating of an insertion: the needle advances only while breathing leaves the tissue near its place in the plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from needleplan.anatomy import Breathing
from needleplan.artifacts import CallRepr
from needleplan.errors import InputError, Mistake

__all__ = ["BreathGate"]

# Shortest time (s) for which a gate must open in a breath: the needle starts and stops within it.
_LEAST_OPEN_S = 0.6
# Number of times in a period at which the level is computed.
_SAMPLES = 2000


@dataclass(frozen=True)
class BreathGate(CallRepr):
    """Times at which breathing leaves the tissue near its place in the plan.

    Parameters
    ----------
    breathing : Breathing
        Motion of the tissue.
    within_mm : float
        Largest displacement (mm) of tissue from its place in the plan while the gate is open.
    exhaled_s : float, default 0
        Time (s) of the clock at the end of an exhalation.

    Raises
    ------
    InputError
        If the gate is open for less than 0.6 s in a breath.

    Examples
    --------
    >>> from needleplan.anatomy import Breathing
    >>> from needleplan.control import BreathGate
    >>> gate = BreathGate(Breathing(full_mm=15.0, still=("bone",)), within_mm=2.0)
    >>> wait_s, open_s = gate.window(2.0)  # at full inspiration
    >>> round(wait_s, 1), round(open_s, 1)
    (1.2, 1.7)
    """

    breathing: Breathing
    within_mm: float
    exhaled_s: float = 0.0
    spans_s: tuple[tuple[float, float], ...] = field(init=False, repr=False)
    """Begin, after an exhalation, and length (s) of the times in a breath at which the gate is open."""

    longest_s: float = field(init=False, repr=False)
    """Longest time (s) for which the gate is open in a breath."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "spans_s", self._spans())
        longest_s = max((length for _, length in self.spans_s), default=0.0)
        object.__setattr__(self, "longest_s", longest_s)
        if longest_s < _LEAST_OPEN_S:
            rule = f"opens the gate for {longest_s:.2f} s in a breath; {_LEAST_OPEN_S:g} s are needed"
            raise InputError(Mistake("gate", f"{self.within_mm:g}", rule))

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> BreathGate:
        """Return the gate of a JSON record, as `dataclasses.asdict` makes it."""
        return cls(Breathing(**record["breathing"]), record["within_mm"], record["exhaled_s"])

    def off_mm(self, time_s: float) -> float:
        """Return the largest displacement (mm) of the tissue from its place in the plan, at a time of the clock (s)."""
        level = float(self.breathing.level_at(time_s - self.exhaled_s))
        return abs(level - self.breathing.level) * self.breathing.full_mm

    def window(self, time_s: float) -> tuple[float, float]:
        """Return the time (s) until the gate is open, 0 if it is, and the time (s) for which it then stays open."""
        period = self.breathing.period_s
        if self.longest_s >= period:
            return 0.0, period
        at = (time_s - self.exhaled_s) % period
        for start, length in self.spans_s:
            if (ago := (at - start) % period) < length:
                return 0.0, length - ago
        return min(((start - at) % period, length) for start, length in self.spans_s)

    def _spans(self) -> tuple[tuple[float, float], ...]:
        period = self.breathing.period_s
        times = np.arange(_SAMPLES) * period / _SAMPLES
        is_open = abs(self.breathing.level_at(times) - self.breathing.level) * self.breathing.full_mm <= self.within_mm
        if is_open.all():
            return ((0.0, period),)
        starts = np.flatnonzero(is_open & ~np.roll(is_open, 1))
        ends = np.flatnonzero(~is_open & np.roll(is_open, 1))
        tick = period / _SAMPLES
        return tuple((tick * float(at), tick * float(((ends - at) % _SAMPLES).min())) for at in starts)
