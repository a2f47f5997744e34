"""Simulated force sensor and tracker of `needleplan lab`, each in its own process and with a real device's protocol.

The plant (the simulated needle and tissue) runs in another process. The plant sends each sample as a datagram over a
local socket and never waits: a sample that the sensor's process does not receive in time is dropped. A force sensor
that receives no samples for 0.1 s repeats its last measurement. `simulation.lab_processes` starts these processes and
contains the plant.
"""

from __future__ import annotations

import contextlib
import math
import signal
import socket
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import Connection
from typing import TypeVar

from needleplan.devices._base import Closing, ForceSample, PoseSample
from needleplan.devices._clock import no_long_collections
from needleplan.devices.ati import NetFtBox, NetFtServer
from needleplan.devices.endpoint import Endpoint, PtyEndpoint, TcpEndpoint
from needleplan.devices.ndi import AuroraDevice, SimulatedTool
from needleplan.devices.ndi.frames import NdiVisibility

__all__ = [
    "TOOL",
    "Failed",
    "FeedReader",
    "FeedSender",
    "LabAddresses",
    "LabPlaces",
    "Ready",
    "Served",
    "TrackerLine",
    "call_at_end",
    "feed_pair",
    "place_or_report",
    "report_end",
    "serve_force",
    "serve_tracker",
]

TOOL = "NP000001"
"""Serial number of the simulated coil in the needle."""

_WRENCH, _POSE = struct.Struct("<6d"), struct.Struct("<9d")
# Time (s) without a datagram from the plant after which `on_silence` is called
_SILENT_S = 0.1
_PlacedDevice = TypeVar("_PlacedDevice")


class TrackerLine(StrEnum):
    """Kind of line at which the simulated tracker is offered: pseudo-terminal or TCP port."""

    PTY = "pty"
    TCP = "tcp"


@dataclass(frozen=True)
class LabPlaces:
    """Requested host and ports of the simulated devices; port 0 means any free port."""

    host: str = "127.0.0.1"
    robot_port: int = 0
    force_port: int = 0
    http_port: int = 0
    """Port of the configuration page of the force sensor."""

    tracker_line: TrackerLine = TrackerLine.PTY
    tracker_port: int = 0
    robot_line: bool = False
    """Whether the robot is offered at a pseudo-terminal instead of a UDP port."""


@dataclass(frozen=True)
class LabAddresses:
    """Addresses of the simulated devices, in the form that the drivers open."""

    robot: str
    force: str
    tracker: str


@dataclass(frozen=True)
class Ready:
    """Message of a device process to its parent: the device is ready at `address`."""

    address: str


@dataclass(frozen=True)
class Failed:
    """Message of a device process to its parent: the device could not be opened, for the reason `why`."""

    why: str


@dataclass(frozen=True)
class Served:
    """Last message of a device process to its parent.

    The message contains the number of ticks, the number of late ticks (`overruns`), and the largest delay of a tick
    (s); zeros from a sensor. `statuses` counts those of a robot that the lab follows.
    """

    ticks: int = 0
    overruns: int = 0
    worst_overrun_s: float = 0.0
    statuses: int = 0


def place_or_report(parent: Connection, place: Callable[[], _PlacedDevice]) -> _PlacedDevice | None:
    """Open a simulated device by calling `place`, and return the device.

    If `place` raises OSError or OverflowError, send `Failed` to the parent process and return None.
    """
    try:
        return place()
    except (OSError, OverflowError) as error:
        parent.send(Failed(str(getattr(error, "strerror", None) or error)))
        return None


def call_at_end(parent: Connection, end: Callable[[], None]) -> None:
    """Arrange that `end` is called when the parent sends a message, when the parent has ended, or on SIGTERM.

    This process ignores Ctrl-C (SIGINT) from then on. `end` may be called more than once.
    """
    # Ctrl-C reaches all processes of a terminal; only the parent process decides whether the others end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: end())

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):
            parent.recv()
        end()

    threading.Thread(target=wait, daemon=True).start()


def report_end(parent: Connection, message: Served) -> None:
    """Send the last message to the parent process; do nothing if the parent has already ended."""
    with contextlib.suppress(OSError):
        parent.send(message)


def feed_pair() -> tuple[socket.socket, socket.socket]:
    """Return two connected sockets: the first for the plant, the second for a sensor."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)


class FeedSender:
    """Sends measured values from the plant to a sensor process over the socket `end`."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        end.setblocking(False)

    def send(self, sample: ForceSample | PoseSample) -> None:
        """Send a sample without waiting; drop it if the socket is full or the other process has ended."""
        if isinstance(sample, ForceSample):
            data = _WRENCH.pack(*sample.force_n, *sample.torque_n_mm)
        else:
            data = _POSE.pack(sample.stamp.sequence, *sample.quaternion, *sample.position_mm, sample.error_mm)
        with contextlib.suppress(OSError):  # full, or the other process has ended
            self._end.send(data)


class FeedReader(Closing):
    """Receives measured values from the plant over the socket `end`, in its own thread.

    The thread calls `receive` with the numbers of each sample, and `on_silence` after each 0.1 s without a sample. A
    ForceSample is sent as three forces (N) and three torques (N mm). A PoseSample is sent as frame number, quaternion
    (w, x, y, z), position (mm) and error (mm); quaternion, position and error are NaN if the coil is not visible.
    """

    def __init__(
        self,
        end: socket.socket,
        receive: Callable[[tuple[float, ...]], None],
        on_silence: Callable[[], None],
        kind: type[ForceSample] | type[PoseSample],
    ) -> None:
        self._end, self._receive, self._on_silence = end, receive, on_silence
        self._format = _WRENCH if kind is ForceSample else _POSE
        self._closing = threading.Event()
        end.settimeout(_SILENT_S)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._closing.is_set():
            try:
                data = self._end.recv(256)
            except TimeoutError:
                self._on_silence()
                continue
            except OSError:
                self._on_silence()
                return
            if len(data) == self._format.size:
                self._receive(self._format.unpack(data))

    def close(self) -> None:
        """Stop the thread and close the socket."""
        self._closing.set()
        self._thread.join()
        self._end.close()


def serve_force(parent: Connection, places: LabPlaces, feed: socket.socket) -> None:
    """Run the simulated force sensor in this process until the parent ends it; `feed` delivers the wrenches.

    If a port cannot be opened, `Failed` is sent to the parent and the function returns.
    """
    wrench = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    box = NetFtBox(lambda _: wrench)

    def receive(values: tuple[float, ...]) -> None:
        nonlocal wrench
        fx, fy, fz, tx, ty, tz = values
        wrench = (fx, fy, fz, tx, ty, tz)
        box.faults.freeze = False

    def on_silence() -> None:
        box.faults.freeze = True

    server = place_or_report(parent, lambda: NetFtServer(box, places.host, places.force_port, places.http_port))
    if server is None:
        return
    ended = threading.Event()
    call_at_end(parent, ended.set)
    with no_long_collections(), server, FeedReader(feed, receive, on_silence, ForceSample):
        parent.send(Ready(server.address))
        ended.wait()
    report_end(parent, Served())


def serve_tracker(parent: Connection, places: LabPlaces, feed: socket.socket) -> None:
    """Run the simulated tracker, with one coil, in this process until the parent ends it; `feed` delivers the poses.

    If the line cannot be opened, `Failed` is sent to the parent and the function returns.
    """
    nan = math.nan
    received = now = (0.0, nan, nan, nan, nan, nan, nan, nan, nan)
    tool = SimulatedTool(TOOL, lambda _: ((now[1], now[2], now[3], now[4]), (now[5], now[6], now[7])))

    def receive(values: tuple[float, ...]) -> None:
        nonlocal received
        frame, w, qx, qy, qz, x, y, z, error_mm = values
        received = (frame, w, qx, qy, qz, x, y, z, error_mm)

    def count() -> int:
        """Make the last received pose the current pose of the tool, and return its frame number."""
        nonlocal now
        now = received
        tool.visibility, tool.error_mm = (
            (NdiVisibility.VALID if math.isfinite(now[1]) else NdiVisibility.MISSING),
            now[8],
        )
        return int(now[0])

    device = AuroraDevice([tool], count=count)

    def place() -> Endpoint:
        if places.tracker_line is TrackerLine.PTY:
            return PtyEndpoint(device)
        return TcpEndpoint(device, places.host, places.tracker_port)

    endpoint = place_or_report(parent, place)
    if endpoint is None:
        return
    ended = threading.Event()
    call_at_end(parent, ended.set)
    with no_long_collections(), endpoint, FeedReader(feed, receive, lambda: None, PoseSample):
        parent.send(Ready(endpoint.address))
        ended.wait()
    report_end(parent, Served())
