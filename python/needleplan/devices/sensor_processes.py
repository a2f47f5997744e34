"""Force sensor and tracker of `needleplan lab` as processes of their own, which speak the bytes of real devices.

The process of the plant sends each measured value as a datagram on a pair of local sockets, and never waits: a value
that a sensor's process does not fetch is dropped. A force sensor that receives nothing reports its last value as
frozen. This file knows nothing of the physics; `simulation.lab_processes` starts these processes and has the plant.
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
"""Serial number of the coil in the needle."""

_WRENCH, _POSE = struct.Struct("<6d"), struct.Struct("<9d")
# s without a datagram after which the measured value counts as frozen
_SILENT_S = 0.1
_PlacedDevice = TypeVar("_PlacedDevice")


class TrackerLine(StrEnum):
    """Line on which the tracker is reached."""

    PTY = "pty"
    TCP = "tcp"


@dataclass(frozen=True)
class LabPlaces:
    """Requested host and ports of the devices; port 0 means any free port."""

    host: str = "127.0.0.1"
    robot_port: int = 0
    force_port: int = 0
    http_port: int = 0
    """Port of the configuration page of the force sensor."""

    tracker_line: TrackerLine = TrackerLine.PTY
    tracker_port: int = 0


@dataclass(frozen=True)
class LabAddresses:
    """Addresses of the devices, as the drivers open them."""

    robot: str
    force: str
    tracker: str


@dataclass(frozen=True)
class Ready:
    """Message of a process: its device is ready at `address`."""

    address: str


@dataclass(frozen=True)
class Failed:
    """Message of a process: its device cannot be placed there; `why` is the reason."""

    why: str


@dataclass(frozen=True)
class Served:
    """Last message of a process: its ticks, and how often and by how much they were late."""

    ticks: int = 0
    overruns: int = 0
    worst_overrun_s: float = 0.0


def place_or_report(parent: Connection, place: Callable[[], _PlacedDevice]) -> _PlacedDevice | None:
    """Return the device at its place; if it cannot be placed there, send Failed and return None."""
    try:
        return place()
    except (OSError, OverflowError) as error:
        parent.send(Failed(str(getattr(error, "strerror", None) or error)))
        return None


def call_at_end(parent: Connection, end: Callable[[], None]) -> None:
    """Call `end` when the process must end: on a message, on SIGTERM, or when the parent process is gone."""
    # Ctrl-C reaches all processes of a terminal; the parent process decides and sends a message.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: end())

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):
            parent.recv()
        end()

    threading.Thread(target=wait, daemon=True).start()


def report_end(parent: Connection, message: Served) -> None:
    """Send the last message, if the parent process is still there."""
    with contextlib.suppress(OSError):
        parent.send(message)


def feed_pair() -> tuple[socket.socket, socket.socket]:
    """Return two connected sockets: one for the plant, one for a sensor."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)


class FeedSender:
    """The plant's end of a pair of sockets."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        end.setblocking(False)

    def send(self, sample: ForceSample | PoseSample) -> None:
        """Send a sample; drop it if the other process does not fetch."""
        if isinstance(sample, ForceSample):
            data = _WRENCH.pack(*sample.force_n, *sample.torque_n_mm)
        else:
            data = _POSE.pack(sample.stamp.sequence, *sample.quaternion, *sample.position_mm, sample.error_mm)
        with contextlib.suppress(OSError):  # full, or the other process has ended
            self._end.send(data)


class FeedReader(Closing):
    """The sensor's end of a pair of sockets: calls `receive` for each sample, and `on_silence` after 0.1 s without one.

    A ForceSample arrives as three forces (N) and three torques (N mm). A PoseSample arrives as the number of its frame,
    quaternion (w, x, y, z), position (mm) and error (mm); these are NaN if the coil is not seen.
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
        """End the thread, and close the socket."""
        self._closing.set()
        self._thread.join()
        self._end.close()


def serve_force(parent: Connection, places: LabPlaces, feed: socket.socket) -> None:
    """Run the process of the force sensor."""
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
    """Run the process of the tracker, with one coil."""
    nan = math.nan
    received = now = (0.0, nan, nan, nan, nan, nan, nan, nan, nan)
    tool = SimulatedTool(TOOL, lambda _: ((now[1], now[2], now[3], now[4]), (now[5], now[6], now[7])))

    def receive(values: tuple[float, ...]) -> None:
        nonlocal received
        frame, w, qx, qy, qz, x, y, z, error_mm = values
        received = (frame, w, qx, qy, qz, x, y, z, error_mm)

    def count() -> int:
        """Return the number of the frame that was received last: a frame is available as soon as it is measured."""
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
