"""An OpenIGTLink server, and a server that shows an insertion in 3D Slicer.

The server runs in its own thread and serves any number of clients. `publish` never waits: the server keeps only the
newest message of each kind and device, and sends this message to a slow client when the client is ready. A client that
accepts no data for `stalled_s` is disconnected.
"""

from __future__ import annotations

import contextlib
import math
import os
import selectors
import socket
import threading
import time
from collections.abc import Sequence
from enum import StrEnum

from needleplan.devices._base import Closing
from needleplan.devices._opening import Address
from needleplan.devices.igtl._tracker import IGTL_PORT
from needleplan.devices.igtl.contents import (
    IgtlStatus,
    Point,
    Sensor,
    StatusCode,
    Unit,
    encode_points,
    encode_polyline,
    encode_reply,
    encode_sensor,
    encode_status,
    encode_string,
)
from needleplan.devices.igtl.messages import IgtlMessage, MessageReader, encode_message, padded, stamp_of
from needleplan.devices.igtl.poses import IgtlPose, encode_transform
from needleplan.errors import AddressError, DeviceFault, InputError, Mistake

__all__ = ["MessageServer", "Shown", "SlicerServer"]

_LONGEST_READ = 65_536  # bytes read from a client at once, at most
_LONGEST_QUERY = 4096  # largest accepted body of a query, in bytes
_KERNEL_BYTES = 1 << 16  # size of the send buffer that is requested from the operating system for each client
_MOST_REPLIES = 64  # number of unsent replies kept for a client; older ones are dropped

_Key = tuple[str, str]


class _Client:
    """One client: the newest unsent message of each kind and device, unsent replies, and the message being sent."""

    def __init__(self, connection: socket.socket, now_s: float) -> None:
        self.connection = connection
        self.reader = MessageReader(longest=_LONGEST_QUERY)
        self.waiting: dict[_Key, bytes] = {}
        self.replies: list[bytes] = []
        self.sending = b""
        self.moved_s = now_s

    def send(self, now_s: float) -> bool:
        """Send as much as the client accepts without waiting; return whether unsent data remain.

        Raises OSError if the client has disconnected.
        """
        while self.sending or self._take():
            try:
                sent = self.connection.send(self.sending)
            except BlockingIOError:
                return True
            self.sending = self.sending[sent:]
            self.moved_s = now_s
        self.moved_s = now_s
        return False

    def _take(self) -> bool:
        if self.replies:
            self.sending = self.replies.pop(0)
        elif self.waiting:
            self.sending = self.waiting.pop(next(iter(self.waiting)))
        return bool(self.sending)


class MessageServer(Closing):
    """OpenIGTLink server at `host` and `port`; port 0 selects a free port.

    New messages are sent at most every `interval_s`. A client that accepts no data for `stalled_s` is disconnected.
    Raises DeviceFault if the port cannot be opened.
    """

    host: str
    port: int
    interval_s: float
    stalled_s: float

    def __init__(
        self, host: str = "127.0.0.1", port: int = 18944, *, interval_s: float = 0.02, stalled_s: float = 10.0
    ) -> None:
        try:
            self._listener = socket.create_server((host, port))
        except OSError as error:
            raise DeviceFault(f"igtl://{host}:{port} cannot be served: {error.strerror or error}") from error
        self.host, self.port = self._listener.getsockname()[:2]
        self.interval_s, self.stalled_s = interval_s, stalled_s
        self.dropped: int = 0
        """Number of clients that were disconnected because they accepted no data."""

        self._lock = threading.Lock()
        self._fresh: dict[_Key, IgtlMessage] = {}
        self._newest: dict[_Key, bytes] = {}
        self._woken, self._wake = os.pipe()
        self._awake = self._stopping = False
        self._selector = selectors.DefaultSelector()
        self._clients: dict[socket.socket, _Client] = {}
        self._thread = threading.Thread(target=self._serve, name="openigtlink", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address of the server, `igtl://host:port`."""
        return f"igtl://{self.host}:{self.port}"

    @property
    def clients(self) -> int:
        """Number of connected clients."""
        return len(self._clients)

    def publish(self, kind: str, device: str, content: bytes, time_s: float | None = None) -> None:
        """Queue a message for all clients, in place of the previous message of the same kind and device.

        `time_s` is in seconds since 1970 and defaults to the present time. The method does not wait. Raises InputError
        if `kind` or `device` is too long, DeviceFault after `close`.
        """
        padded(kind, 12, "message type"), padded(device, 20, "device name")
        message = IgtlMessage(kind, device, content, stamp_of(time.time() if time_s is None else time_s))
        with self._lock:
            if self._stopping:
                raise DeviceFault("the OpenIGTLink server is closed")
            self._fresh[kind, device] = message
            wake, self._awake = not self._awake, True
        if wake:
            os.write(self._wake, b"x")

    def close(self) -> None:
        """Disconnect all clients and stop serving."""
        with self._lock:
            if self._stopping:
                return
            self._stopping = True
        os.write(self._wake, b"x")
        self._thread.join()
        os.close(self._wake)
        os.close(self._woken)

    def _serve(self) -> None:
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        next_s = time.monotonic()
        while not self._stopping:
            now_s = time.monotonic()
            if self._awake and now_s >= next_s:
                self._hand_out()
                next_s = now_s + self.interval_s
            self._send_all()
            wait_s = next_s - now_s if self._awake else self.stalled_s if self._clients else None
            for key, _ in self._selector.select(wait_s):
                if key.fileobj is self._listener:
                    self._accept()
                elif key.fileobj == self._woken:
                    os.read(self._woken, 4096)
                elif isinstance(key.fileobj, socket.socket):
                    self._read(self._clients[key.fileobj])
        for client in list(self._clients.values()):
            self._disconnect(client)
        self._listener.close()
        self._selector.close()

    def _hand_out(self) -> None:
        """Encode each new message once; for each client, replace the unsent message of the same kind and device."""
        with self._lock:
            fresh, self._fresh, self._awake = self._fresh, {}, False
        for key, message in fresh.items():
            self._newest[key] = data = encode_message(message)
            for client in self._clients.values():
                client.waiting[key] = data

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            connection, _ = self._listener.accept()
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # The kernel buffer is small, because messages that wait in it for a slow client would arrive outdated.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BYTES)
            client = _Client(connection, time.monotonic())
            client.waiting.update(self._newest)
            self._clients[connection] = client
            self._selector.register(connection, selectors.EVENT_READ)

    def _read(self, client: _Client) -> None:
        try:
            data = client.connection.recv(_LONGEST_READ)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._disconnect(client)
            return
        client.reader.feed(data)
        while (query := client.reader.next()) is not None:
            client.replies += self._answer(query)
        del client.replies[:-_MOST_REPLIES]

    def _answer(self, query: IgtlMessage) -> list[bytes]:
        """Return the encoded replies to a GET_, STT_ or STP_ query; [] for other messages.

        STT_ and STP_ (start and stop) have no further effect, because every client receives all messages anyway.
        """
        prefix, _, short = query.kind.partition("_")
        if prefix == "GET":
            found = [
                data for (kind, device), data in self._newest.items()
                if kind[:8] == short[:8] and query.device in ("", device)
            ]  # fmt: skip
            whole = "TRANSFORM" if short == "TRANSFOR" else short  # GET_TRANSFORM exceeds 12 bytes and lacks its M
            return found or [encode_message(IgtlMessage(whole, query.device))]
        if prefix in ("STT", "STP"):
            offered = prefix == "STT" and any(kind[:8] == short[:8] for kind, _ in self._newest)
            return [encode_message(IgtlMessage(f"RTS_{short}"[:12], query.device, encode_reply(offered)))]
        return []

    def _send_all(self) -> None:
        now_s = time.monotonic()
        for client in list(self._clients.values()):
            try:
                more = client.send(now_s)
            except OSError:
                self._disconnect(client)
                continue
            if more and now_s - client.moved_s > self.stalled_s:
                self.dropped += 1
                self._disconnect(client)
                continue
            interest = selectors.EVENT_READ | (selectors.EVENT_WRITE if more else 0)
            self._selector.modify(client.connection, interest)

    def _disconnect(self, client: _Client) -> None:
        if self._clients.pop(client.connection, None) is not None:
            self._selector.unregister(client.connection)
            client.connection.close()


_Vector = tuple[float, float, float]
_TARGET_COLOUR = (255, 64, 64, 255)  # red, green, blue, opacity
_LARGEST = 1e6  # largest magnitude of a shown number, in its unit; larger numbers are refused


class Shown(StrEnum):
    """Names of the nodes that Slicer creates for the messages."""

    TIP = "NeedleTip"
    TARGET = "Target"
    PLANNED = "PlannedPath"
    EXECUTED = "ExecutedPath"
    FORCE = "Force"
    TORQUE = "Torque"
    STATE = "NeedleState"
    NOTE = "NeedleNote"


class SlicerServer(MessageServer):
    """A server to which Slicer connects as a client (module OpenIGTLinkIF), by default at port 18944.

    All positions are in mm and in the same frame, which Slicer interprets as RAS; for another frame, apply a transform
    to the nodes in Slicer. All methods return at once, with or without a client. They raise InputError for numbers that
    are not finite or exceed a million, and DeviceFault after `close`.
    """

    @classmethod
    def open(cls, address: str = "igtl://127.0.0.1") -> SlicerServer:
        """Serve at `igtl://host[:18944]`; host 127.0.0.1 accepts Slicer on this machine only, 0.0.0.0 on any machine.

        Raises AddressError if the address is wrong, DeviceFault if the port is in use.
        """
        parsed = Address.parse(address)
        if parsed.scheme != "igtl":
            raise AddressError(Mistake("address", address, "must begin with igtl://"))
        parsed.only(())
        return cls(*parsed.network(IGTL_PORT))

    def show_tip(self, position_mm: _Vector, quaternion: Sequence[float], time_s: float | None = None) -> None:
        """Show the pose of the needle tip at `time_s` (s since 1970, default now); `quaternion` is (w, x, y, z)."""
        w, x, y, z = quaternion
        _require_numbers("tip", (*position_mm, w, x, y, z))
        self.publish("TRANSFORM", Shown.TIP, encode_transform(IgtlPose(position_mm, (w, x, y, z))), time_s)

    def show_target(self, position_mm: _Vector, diameter_mm: float = 0.0) -> None:
        """Show the target as a point with a diameter."""
        _require_numbers("target", (*position_mm, diameter_mm))
        point = Point(Shown.TARGET, position_mm, "Target", _TARGET_COLOUR, diameter_mm)
        self.publish("POINT", Shown.TARGET, encode_points([point]))

    def show_plan(self, points_mm: Sequence[_Vector]) -> None:
        """Show the planned path as a line; fewer than two points remove it."""
        self._line(Shown.PLANNED, points_mm)

    def show_path(self, points_mm: Sequence[_Vector]) -> None:
        """Show the executed path as a line; fewer than two points remove it."""
        self._line(Shown.EXECUTED, points_mm)

    def show_force(self, force_n: _Vector, torque_n_mm: _Vector | None = None) -> None:
        """Show the force, and the torque if given, at the base of the needle."""
        _require_numbers("force", force_n)
        self.publish("SENSOR", Shown.FORCE, encode_sensor(Sensor(force_n, Unit.NEWTON)))
        if torque_n_mm is not None:
            _require_numbers("torque", torque_n_mm)
            self.publish("SENSOR", Shown.TORQUE, encode_sensor(Sensor(torque_n_mm, Unit.NEWTON_MILLIMETRE)))

    def show_state(self, state: str, code: StatusCode = StatusCode.OK, cause: str = "") -> None:
        """Show the state of the robot (such as `ENABLED`, at most 20 bytes) and the cause of this state."""
        self.publish("STATUS", Shown.STATE, encode_status(IgtlStatus(code, state, cause)))

    def show_note(self, text: str) -> None:
        """Show a line of text."""
        self.publish("STRING", Shown.NOTE, encode_string(text))

    def _line(self, name: Shown, points_mm: Sequence[_Vector]) -> None:
        _require_numbers(name, [number for point in points_mm for number in point])
        self.publish("POLYDATA", name, encode_polyline(points_mm))


def _require_numbers(name: str, numbers: Sequence[float]) -> None:
    if not all(map(math.isfinite, numbers)) or max(map(abs, numbers), default=0.0) > _LARGEST:
        raise InputError(Mistake(name, str(numbers), "must be finite numbers between minus and plus one million"))
