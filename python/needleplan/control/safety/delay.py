"""How long a sample was on its way, by the clock of its device, of which nobody knows where its zero is.

The shortest way so far counts as none: what a sample took longer is what it is older than its arrival says. So samples
that wait in a network, or in a buffer that nobody reads, do not pass for fresh. The two clocks may go at rates that
differ by up to 0.1 %, as no two crystals do; a device clock that goes back begins anew.

This is for stages. The time of a tracker is often the number of its frame by a rate that somebody has set, and trackers
answer with their latest frame, which has not waited.
"""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.devices import Stamp

__all__ = ["Delay"]

_NANO = 1e-9
_RATE = 0.001


@dataclass(frozen=True)
class Delay:
    """What is known of the way from one device; `late_s` is that of the last sample, zero where it has no clock."""

    late_s: float = 0.0
    _shortest_s: float = 0.0
    _received_s: float = 0.0
    _device_s: float | None = None

    def then(self, stamp: Stamp) -> Delay:
        """Return what is known after another sample."""
        if stamp.device_time_s is None:
            return self
        received_s = stamp.received_ns * _NANO
        way_s = received_s - stamp.device_time_s
        shortest_s = way_s
        if self._device_s is not None and stamp.device_time_s >= self._device_s:
            allowed_s = _RATE * max(received_s - self._received_s, 0.0)
            shortest_s = min(way_s, self._shortest_s + allowed_s)
        return Delay(way_s - shortest_s, shortest_s, received_s, stamp.device_time_s)
