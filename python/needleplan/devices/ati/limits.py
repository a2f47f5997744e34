"""What a wrench at the base of a needle can be, and how long a sensor may be silent.

The defaults are those of a needle robot, not of a sensor: no needle bears 50 N, and no tissue lets go of 10 N within
one sample. They catch a cable that is torn off, not a puncture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from needleplan.devices.ati.rdt import RdtRecord

__all__ = ["ForceLimits", "Plausibility"]

_FULL = (1 << 31) - 1
_Three = tuple[float, float, float]


@dataclass(frozen=True)
class ForceLimits:
    """When a sample is suspect, and when the sensor is given up."""

    silence_s: float = 0.1
    """The stream has stopped where nothing has come for so long."""

    start_s: float = 0.3
    """The first record must have come within this time of the start request; it is sent three times."""

    most_force_n: float = 50.0
    most_torque_n_mm: float = 5000.0
    step_n: float = 10.0
    """Largest change of a force from one sample to the next."""

    stuck_samples: int = 50
    """All six counts of a living sensor do not stay the same for so many samples."""

    frozen_samples: int = 10
    """The box has stopped measuring where `ft_sequence` stands still for so many records."""

    malformed: int = 50
    """So many datagrams in a row that are no records are another device."""

    bias_samples: int = 20
    steady_n: float = 0.1
    """Before a bias, the standard deviation of each force over `bias_samples` is at most this."""

    unloaded_n: float = 0.5
    """Once biased, the force is at most this where it is biased again: more is a needle under load."""


@dataclass
class Plausibility:
    """Compares each wrench with what is possible, and with the one before."""

    limits: ForceLimits
    _counts: tuple[int, ...] = ()
    _same: int = 0
    _force_n: _Three | None = field(default=None)

    def forget(self) -> None:
        """The next sample may be far from the last, as after a bias."""
        self._force_n, self._counts, self._same = None, (), 0

    def notes(self, record: RdtRecord, force_n: _Three, torque_n_mm: _Three) -> tuple[str, ...]:
        """Return what is wrong with a wrench; nothing where it is plausible."""
        notes = []
        self._same = self._same + 1 if record.counts == self._counts else 1
        self._counts = record.counts
        if self._same >= self.limits.stuck_samples:
            notes.append(f"the same wrench {self._same} times")
        if any(not -_FULL <= count < _FULL for count in record.counts):
            notes.append("counts at the end of their range")
        if not all(map(math.isfinite, (*force_n, *torque_n_mm))):
            notes.append("not finite")
        elif max(map(abs, force_n)) > self.limits.most_force_n:
            notes.append(f"more than {self.limits.most_force_n:g} N")
        elif max(map(abs, torque_n_mm)) > self.limits.most_torque_n_mm:
            notes.append(f"more than {self.limits.most_torque_n_mm:g} N mm")
        if self._force_n is not None:
            step_n = max(abs(now - before) for now, before in zip(force_n, self._force_n, strict=True))
            if not step_n <= self.limits.step_n:
                notes.append(f"a step of {step_n:.3g} N")
        self._force_n = force_n
        return tuple(notes)
