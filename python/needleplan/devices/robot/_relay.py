"""A relay between controllers and a robot, which passes every datagram on unchanged, and reads the statuses."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Callable

from needleplan.devices.robot._machine import Peer
from needleplan.devices.robot.messages import RobotStatus, decode
from needleplan.errors import ProtocolError

__all__ = ["RobotRelay"]

_MOST = 16  # largest number of controllers at a time; the oldest one gets no more datagrams
_LONGEST = 2048  # bytes of the longest datagram


class RobotRelay:
    """Relays datagrams between a UDP socket of this machine and the robot at `robot` (host, port).

    The robot sees one sender for each sender at the socket.

    `run` calls `seen` with each status of a session, and `tick` with the monotonic time (s) at every interval. A tick
    that begins more than one interval late counts as an overrun, and missed ticks are omitted.
    """

    def __init__(
        self, robot: Peer, seen: Callable[[RobotStatus], object], tick: Callable[[float], object],
        host: str = "127.0.0.1", port: int = 0, interval_s: float = 0.001,
    ) -> None:  # fmt: skip
        self._robot, self._seen, self._tick, self._interval_s = robot, seen, tick, interval_s
        self.ticks: int = 0
        self.overruns: int = 0
        self.worst_overrun_s: float = 0.0
        self.statuses: int = 0
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._selector = selectors.DefaultSelector()
        self._ways: dict[Peer, socket.socket] = {}
        try:
            self._front.bind((host, port))
        except OSError:
            self.close()
            raise
        self._front.setblocking(False)
        self._selector.register(self._front, selectors.EVENT_READ, None)
        self.address: str = "udp://{}:{}".format(*self._front.getsockname())
        self._stopping = threading.Event()

    def run(self) -> None:
        """Pass datagrams on, until `stop`."""
        due_s = time.monotonic()
        while not self._stopping.is_set():
            due_s += self._interval_s
            while (left_s := due_s - time.monotonic()) > 0:
                for key, _ in self._selector.select(left_s):
                    self._pass(key.data)
            late_s = time.monotonic() - due_s
            if late_s > self._interval_s:
                self.overruns += 1
                self.worst_overrun_s = max(self.worst_overrun_s, late_s)
                due_s += late_s
            self.ticks += 1
            self._tick(time.monotonic())

    def _pass(self, peer: Peer | None) -> None:
        """Pass a datagram on: from the robot to `peer`, or, if it is None, from a controller to the robot."""
        with contextlib.suppress(OSError):  # a robot that is not there yet, or a full buffer: the datagram is lost
            if peer is None:
                datagram, sender = self._front.recvfrom(_LONGEST)
                self._way(sender).send(datagram)
                return
            if peer not in self._ways:
                return  # its way was closed for a newer controller
            datagram = self._ways[peer].recv(_LONGEST)
            self._front.sendto(datagram, peer)
            with contextlib.suppress(ProtocolError):
                message = decode(datagram)
                if isinstance(message, RobotStatus):
                    self.statuses += 1
                    self._seen(message)

    def _way(self, peer: Peer) -> socket.socket:
        if peer not in self._ways:
            if len(self._ways) == _MOST:
                self._close_way(next(iter(self._ways)))
            way = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            way.setblocking(False)
            way.connect(self._robot)
            self._ways[peer] = way
            self._selector.register(way, selectors.EVENT_READ, peer)
        return self._ways[peer]

    def _close_way(self, peer: Peer) -> None:
        way = self._ways.pop(peer)
        self._selector.unregister(way)
        way.close()

    def stop(self) -> None:
        """Make `run` return after its present tick."""
        self._stopping.set()

    def close(self) -> None:
        """Close all sockets."""
        for peer in list(self._ways):
            self._close_way(peer)
        self._selector.close()
        self._front.close()
