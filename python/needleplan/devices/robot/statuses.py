"""What the control side learns from the datagrams of the robot, without any input or output."""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.devices.robot.messages import Head

__all__ = ["RobotClock", "StatusCounts", "StatusWatch"]

_WRAP = 1 << 32
_HALF = _WRAP // 2
_WINDOW_NS = 5_000_000_000


@dataclass
class StatusCounts:
    """What came from the robot in this session, and what did not."""

    received: int = 0
    lost: int = 0
    repeated: int = 0
    """Twice, or behind a newer one."""

    unread: int = 0
    """Dropped here because nobody read them."""

    malformed: int = 0
    foreign: int = 0
    """Of another session."""


class StatusWatch:
    """Follows the numbers of the statuses."""

    def __init__(self) -> None:
        self.counts = StatusCounts()
        self._last: int | None = None

    def see(self, sequence: int) -> int | None:
        """Return how many are missing before a status; None where it is not newer than the last."""
        ahead = 1 if self._last is None else (sequence - self._last) % _WRAP
        if not 0 < ahead < _HALF:
            self.counts.repeated += 1
            return None
        self._last = sequence
        self.counts.received += 1
        self.counts.lost += ahead - 1
        return ahead - 1


class RobotClock:
    """What time it is at least on the clock of the robot, and how long a datagram takes there and back.

    The robot's time of sending, taken as that of arrival, is behind by what the datagram took. Of the last 5 to 10
    seconds the one that was least behind is used: older ones do not count, because no two clocks run alike.
    """

    def __init__(self) -> None:
        self.round_trip_s: float | None = None
        """The last one that was measured."""

        self.worst_round_trip_s = 0.0
        self._ahead_ns: list[int] = []
        self._since_ns = 0
        self._echo_ns = 0

    def see(self, head: Head, now_ns: int) -> None:
        """Take the times of a datagram that arrived at `now_ns`."""
        ahead_ns = head.sent_ns - now_ns
        if not self._ahead_ns or now_ns - self._since_ns > _WINDOW_NS:
            self._ahead_ns = [*self._ahead_ns[-1:], ahead_ns]
            self._since_ns = now_ns
        self._ahead_ns[-1] = max(self._ahead_ns[-1], ahead_ns)
        if head.echo_ns > self._echo_ns:
            self._echo_ns = head.echo_ns
            self.round_trip_s = max(now_ns - head.echo_ns - 1000 * head.held_us, 0) / 1e9
            self.worst_round_trip_s = max(self.worst_round_trip_s, self.round_trip_s)

    def at(self, now_ns: int) -> int:
        """Return the time of the robot, or one somewhat before, at `now_ns` here; 0 where it was never heard."""
        return max(now_ns + max(self._ahead_ns), 1) if self._ahead_ns else 0
