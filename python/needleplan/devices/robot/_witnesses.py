"""Who has stopped the robot without a session, and sees for a while where the needle is."""

from __future__ import annotations

from needleplan.devices.robot.messages import Head

__all__ = ["StopWitness", "StopWitnesses"]

_WRAP = 1 << 32
# time (ns) after its last STOP for which a sender gets statuses: ten times the standstill that counts as rest
_WATCH_NS = 500_000_000
# time (ns) between two statuses to one sender: ten statuses in the 50 ms of a standstill
_EVERY_NS = 5_000_000
# largest number of senders at a time: several people may stop the robot at once, a flood of senders may not load it
_MOST = 4


class StopWitness:
    """One sender of a STOP without a session: its last STOP, and when that STOP was received."""

    def __init__(self, peer: tuple[str, int]) -> None:
        self.peer = peer
        self.stop: Head = Head(0, 0, 0)
        self.received_ns = self.sent_ns = self._count = 0

    def head(self, now_ns: int) -> Head:
        """Return the head of the next status to this sender, which echoes its last STOP."""
        self._count = (self._count + 1) % _WRAP
        held_us = min((now_ns - self.received_ns) // 1000, _WRAP - 1)
        return Head(0, self._count, now_ns, self.stop.sent_ns, held_us, self.stop.number, self.stop.version)


class StopWitnesses:
    """The last four senders of a STOP without a session. Each gets a status every 5 ms until 0.5 s after its STOP."""

    def __init__(self) -> None:
        self._witnesses: dict[tuple[str, int], StopWitness] = {}
        self._has_served = False
        """Whether the last tick has served a sender; then this tick serves the controller."""

    def add(self, peer: tuple[str, int], stop: Head, now_ns: int) -> None:
        """Note a STOP that `peer` has sent."""
        witness = self._witnesses.pop(peer, None) or StopWitness(peer)
        witness.stop, witness.received_ns = stop, now_ns
        self._witnesses[peer] = witness
        if len(self._witnesses) > _MOST:
            del self._witnesses[next(iter(self._witnesses))]

    def due(self, now_ns: int) -> StopWitness | None:
        """Return the sender that gets the status of this tick; None, at least every second time, for the controller."""
        has_served, self._has_served = self._has_served, False
        if has_served or not self._witnesses:
            return None
        for peer in [each.peer for each in self._witnesses.values() if now_ns - each.received_ns > _WATCH_NS]:
            del self._witnesses[peer]
        waiting = [each for each in self._witnesses.values() if now_ns - each.sent_ns >= _EVERY_NS]
        if not waiting:
            return None
        witness = min(waiting, key=lambda candidate: candidate.sent_ns)
        witness.sent_ns, self._has_served = now_ns, True
        return witness
