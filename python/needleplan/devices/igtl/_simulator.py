"""A simulated PLUS server with selectable faults; it sends the same bytes as a real PLUS server.

`PlusDevice` generates the bytes. `PlusLink` connects a client to the device within one process on a virtual clock;
`PlusServer` offers the device at a TCP port.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from needleplan.artifacts import CallRepr
from needleplan.devices._base import Closing
from needleplan.devices.igtl._tracker import PoseKind
from needleplan.devices.igtl.contents import decode_start, encode_reply
from needleplan.devices.igtl.messages import IgtlMessage, MessageReader, encode_message, stamp_of
from needleplan.devices.igtl.poses import (
    IgtlPose,
    IgtlTool,
    ToolKind,
    encode_position,
    encode_qtdata,
    encode_tdata,
    encode_transform,
)

__all__ = ["PlusDevice", "PlusFaults", "PlusServer", "TrackedTool"]

_NANO = 1_000_000_000
_LONGEST = 65_536  # bytes read from a client at once, at most
_BEGAN_S = 1_700_000_000.0  # time of the simulated server at its start, s since 1970


@dataclass
class TrackedTool:
    """A simulated tool. `pose` returns position (mm) and quaternion (w, x, y, z) at a time in s.

    `name` is the name of the tool's transform. A `status` other than OK means that the tool is not visible.
    """

    name: str
    pose: Callable[[float], tuple[tuple[float, float, float], tuple[float, float, float, float]]]
    status: str = "OK"
    kind: ToolKind = ToolKind.SIX_DOF


@dataclass
class PlusFaults(CallRepr):
    """Faults that the simulated server shows from now on."""

    damage: int = 0
    """Number of the next messages that are sent with one wrong bit."""

    cut: int = 0
    """Number of the next messages of which only the first half is sent."""

    noise_before: bytes = b""
    """Bytes sent before the next message."""

    absurd: int = 0
    """Number of the next messages whose header has an impossibly large length."""

    freeze: bool = False
    """Whether the same frame is sent repeatedly, with the same time."""

    skip: int = 0
    """Number of the next frames that are not sent."""

    mute: bool = False
    """Whether no frames are sent."""

    time_step_s: float = 0.0
    """Offset (s) of the times in the messages."""

    stretch: float = 1.0
    """Factor on the quaternions; with a factor other than 1 the sent matrices are not rotations."""

    flip: bool = False
    """Whether quaternions are sent with the opposite sign."""

    timeless: bool = False
    """Whether messages are sent without a time."""


@dataclass
class PlusDevice(CallRepr):
    """The simulated PLUS server. If `on_request`, it sends poses only after a request; if `refuse`, it denies requests.

    Like PLUS, the server sends messages with header version 1 until it receives a message with a higher version. Then
    it sends messages with this version, at most with `version`. `queries` lists the kinds of all received messages.
    """

    tools: Sequence[TrackedTool]
    kind: PoseKind = PoseKind.TRANSFORM
    rate_hz: float = 40.0
    version: int = 2
    on_request: bool = False
    refuse: bool = False
    valid_only: bool = True
    """Whether tools that are not visible are left out, as with `SendValidTransformsOnly` of PLUS."""

    faults: PlusFaults = field(default_factory=PlusFaults)
    queries: list[str] = field(default_factory=list)
    requested: bool = False
    sent_version: int = 1
    _reader: MessageReader = field(default_factory=MessageReader)
    _last_s: float = 0.0

    def frame(self, time_s: float) -> bytes:
        """Return the bytes of the frame at `time_s` (s since the start); b"" if no frame is sent."""
        faults = self.faults
        if faults.mute or (self.on_request and not self.requested):
            return b""
        if faults.skip:
            faults.skip -= 1
            return b""
        if not faults.freeze:
            self._last_s = time_s
        return b"".join(self._through_faults(encode_message(message)) for message in self._messages(self._last_s))

    def answer(self, data: bytes) -> bytes:
        """Receive bytes from a client, and return the encoded replies; b"" if there are none."""
        self._reader.feed(data)
        replies = b""
        while (query := self._reader.next()) is not None:
            self.queries.append(query.kind)
            self.sent_version = min(max(self.sent_version, query.version), self.version)
            prefix, _, kind = query.kind.partition("_")
            if prefix in ("STT", "STP"):
                if prefix == "STT":
                    decode_start(query.content)
                self.requested = prefix == "STT" and not self.refuse
                replies += encode_message(IgtlMessage(f"RTS_{kind}", query.device, encode_reply(not self.refuse)))
        return replies

    def _messages(self, time_s: float) -> list[IgtlMessage]:
        faults = self.faults
        stamp = 0 if faults.timeless else stamp_of(_BEGAN_S + time_s + faults.time_step_s)
        seen = [tool for tool in self.tools if tool.status == "OK" or not self.valid_only]
        poses = [self._pose(tool, time_s) for tool in seen]
        kind = self.kind.upper()
        if self.kind.holds_tools:
            tools = [IgtlTool(tool.name[:20], pose, tool.kind) for tool, pose in zip(seen, poses, strict=True)]
            content = encode_tdata(tools) if self.kind is PoseKind.TDATA else encode_qtdata(tools)
            metadata = {f"{tool.name}Status": tool.status for tool in seen}
            return [self._message(kind, f"TDATA_{len(seen)}Elem", content, stamp, metadata)]
        encode = encode_transform if self.kind is PoseKind.TRANSFORM else encode_position
        return [
            self._message(kind, tool.name[:20], encode(pose), stamp, _metadata_of(tool))
            for tool, pose in zip(seen, poses, strict=True)
        ]

    def _pose(self, tool: TrackedTool, time_s: float) -> IgtlPose:
        if tool.status != "OK":
            return IgtlPose((0.0, 0.0, 0.0))
        position_mm, quaternion = tool.pose(time_s)
        scale = self.faults.stretch * (-1 if self.faults.flip else 1)
        w, x, y, z = (component * scale for component in quaternion)
        return IgtlPose(position_mm, (w, x, y, z))

    def _message(self, kind: str, device: str, content: bytes, stamp: int, metadata: dict[str, str]) -> IgtlMessage:
        if self.sent_version < 2:
            return IgtlMessage(kind, device, content, stamp)
        return IgtlMessage(kind, device, content, stamp, self.sent_version, metadata=metadata)

    def _through_faults(self, data: bytes) -> bytes:
        faults = self.faults
        before, faults.noise_before = faults.noise_before, b""
        if faults.damage:
            faults.damage -= 1
            data = data[:-1] + bytes([data[-1] ^ 0x10])
        if faults.absurd:
            faults.absurd -= 1
            data = data[:42] + b"\x7f" + b"\xff" * 7 + data[50:]
        if faults.cut:
            faults.cut -= 1
            data = data[: len(data) // 2]
        return before + data


def _metadata_of(tool: TrackedTool) -> dict[str, str]:
    long = {"IGTL_DEVICE_NAME": tool.name} if len(tool.name) > 20 else {}
    return {"TransformStatus": tool.status, **long}


class PlusServer(Closing):
    """Offers a simulated PLUS server at a TCP port of this machine, to one client at a time."""

    host: str
    port: int

    def __init__(self, device: PlusDevice, host: str = "127.0.0.1", port: int = 0) -> None:
        self.device = device
        self._listener = socket.create_server((host, port))
        self.host, self.port = self._listener.getsockname()[:2]
        self._woken, self._wake = socket.socketpair()
        self._stopping = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address `igtl://host:port`; a client appends `/` and the name of a tool."""
        return f"igtl://{self.host}:{self.port}"

    def close(self) -> None:
        """Stop serving and close the connection of the client. Closing again does nothing."""
        if self._stopping:
            return
        self._stopping = True
        self._wake.send(b"x")
        self._thread.join()
        for each in (self._listener, self._woken, self._wake):
            each.close()

    def _serve(self) -> None:
        began_s = time.monotonic()
        while not self._stopping:
            select.select([self._listener, self._woken], [], [])
            if self._stopping:
                return
            client, _ = self._listener.accept()
            with client, contextlib.suppress(OSError):
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._stream(client, began_s)

    def _stream(self, client: socket.socket, began_s: float) -> None:
        period_s = 1 / self.device.rate_hz
        number = int((time.monotonic() - began_s) / period_s)
        while not self._stopping:
            wait_s = began_s + (number + 1) * period_s - time.monotonic()
            ready, _, _ = select.select([client, self._woken], [], [], max(wait_s, 0))
            if client in ready:
                data = client.recv(_LONGEST)
                if not data:
                    return
                client.sendall(self.device.answer(data))
            if time.monotonic() >= began_s + (number + 1) * period_s:
                number += 1
                client.sendall(self.device.frame(number * period_s))
