"""A simulated network between a robot and its controllers, in virtual time, with faults of its datagrams."""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass, field

from needleplan.devices import Link, VirtualClock
from needleplan.devices.robot import RobotMachine
from needleplan.devices.robot._machine import Peer
from needleplan.errors import LinkClosed

__all__ = ["RobotLink", "RobotNetwork", "Way"]

_NANO = 1_000_000_000
_TICK_NS = 1_000_000


@dataclass
class Way:
    """Simulated faults of the datagrams in one direction."""

    cut: bool = False
    """Whether all datagrams are lost."""

    lose: int = 0
    """Number of the next datagrams that are lost."""

    double: int = 0
    """Number of the next datagrams that arrive twice."""

    delay_s: float = 0.0
    """Time from sending to arrival (s)."""

    seen: list[bytes] = field(default_factory=list)
    """All sent datagrams, including lost ones."""

    def copies(self, datagram: bytes) -> int:
        """Record a sent datagram and return how many copies arrive (0, 1 or 2); decrement `lose` or `double`."""
        self.seen.append(datagram)
        if self.cut or self.lose:
            self.lose -= bool(self.lose)
            return 0
        self.double -= (twice := self.double > 0)
        return 1 + twice


class RobotNetwork:
    """Simulated network between a robot and its controllers; the robot's clock is `ahead_ns` ahead of `clock`."""

    def __init__(self, machine: RobotMachine, clock: VirtualClock, ahead_ns: int = 77_000_000_000) -> None:
        self.machine = machine
        self.clock = clock
        self.ahead_ns = ahead_ns
        self.to_robot: Way = Way()
        self.from_robot: Way = Way()
        self._due_ns = clock.now_ns() + _TICK_NS
        self._count = 0
        self._coming: list[tuple[int, int, bytes, Peer]] = []
        self._going: list[tuple[int, int, bytes, Peer]] = []
        self._inboxes: dict[Peer, deque[bytes]] = {}

    def link(self, name: str = "controller") -> RobotLink:
        """Return a new link for a controller; `name` serves as the controller's host name."""
        peer = (name, 1)
        self._inboxes[peer] = deque()
        return RobotLink(self, peer, self._inboxes[peer])

    def send(self, datagram: bytes, peer: Peer) -> None:
        """Send a datagram from the controller `peer` to the robot."""
        self._put(self._coming, self.to_robot, datagram, peer)

    def pass_until(self, end_ns: int, inbox: deque[bytes] | None = None) -> None:
        """Advance the clock to `end_ns`, or until `inbox` has a datagram; meanwhile run the robot and its network."""
        while not inbox:
            now_ns = self.clock.now_ns()
            waiting = [queue[0][0] for queue in (self._coming, self._going) if queue]
            next_ns = min([self._due_ns, *waiting])
            if next_ns > end_ns:
                self.clock.advance((end_ns - now_ns) / _NANO)
                return
            self.clock.advance((next_ns - now_ns) / _NANO)
            self._happen(next_ns)

    def _happen(self, now_ns: int) -> None:
        if self._going and self._going[0][0] <= now_ns:
            _, _, datagram, peer = heapq.heappop(self._going)
            if peer in self._inboxes:
                self._inboxes[peer].append(datagram)
        elif self._coming and self._coming[0][0] <= now_ns:
            _, _, datagram, peer = heapq.heappop(self._coming)
            answer = self.machine.receive(datagram, peer, now_ns + self.ahead_ns)
            if answer:
                self._put(self._going, self.from_robot, answer, peer)
        else:
            self._due_ns += _TICK_NS
            sent = self.machine.tick(now_ns + self.ahead_ns)
            if sent is not None:
                self._put(self._going, self.from_robot, *sent)

    def _put(self, queue: list[tuple[int, int, bytes, Peer]], way: Way, datagram: bytes, peer: Peer) -> None:
        due_ns = self.clock.now_ns() + round(way.delay_s * _NANO)
        for _ in range(way.copies(datagram)):
            self._count += 1
            heapq.heappush(queue, (due_ns, self._count, datagram, peer))


class RobotLink(Link):
    """Link of one controller to the robot in a RobotNetwork."""

    def __init__(self, network: RobotNetwork, peer: Peer, inbox: deque[bytes]) -> None:
        self._network, self._peer, self._inbox = network, peer, inbox
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send a datagram to the robot. Raises LinkClosed after `close`."""
        self._require_open()
        self._network.send(data, self._peer)

    def receive(self, timeout_s: float) -> bytes:
        """Advance the clock of the network, and return the next datagram; b"" after `timeout_s`.

        Raises LinkClosed after `close`.
        """
        self._require_open()
        self._network.pass_until(self._network.clock.now_ns() + round(timeout_s * _NANO), self._inbox)
        return self._inbox.popleft() if self._inbox else b""

    def close(self) -> None:
        """Close the link."""
        self._closed = True

    def _require_open(self) -> None:
        if self._closed:
            raise LinkClosed("the link to the robot is closed")
