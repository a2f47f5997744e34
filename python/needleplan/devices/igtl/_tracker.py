"""Tracker whose poses are received from an OpenIGTLink server such as PLUS."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from urllib.parse import unquote

from needleplan.config import Choice, Integer, Number
from needleplan.devices._base import PoseSample, Tracker
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._links import Link
from needleplan.devices._opening import Address, open_link
from needleplan.devices.igtl.contents import decode_reply, encode_start
from needleplan.devices.igtl.messages import IgtlMessage, MessageReader, encode_message
from needleplan.devices.igtl.poses import (
    IgtlPose,
    IgtlPoseLimits,
    IgtlPoseValidator,
    IgtlTool,
    ToolKind,
    decode_position,
    decode_qtdata,
    decode_tdata,
    decode_transform,
)
from needleplan.errors import AddressError, ConfigurationError, DeviceFault, Mistake, ProtocolError

__all__ = ["IGTL_PORT", "IgtlCounts", "IgtlTracker", "PoseKind", "named_address", "names_of", "open_named"]

IGTL_PORT = 18944

_NAME_BYTES = 20  # length of a device name in a header; PLUS cuts longer names
_MOST_OTHERS = 20  # largest number of other devices that the message of a failed start names


class PoseKind(StrEnum):
    """Kind of the messages that contain the poses."""

    TRANSFORM = "transform"
    POSITION = "position"
    TDATA = "tdata"
    QTDATA = "qtdata"

    @property
    def holds_tools(self) -> bool:
        """Whether one message holds several named tools."""
        return self in (PoseKind.TDATA, PoseKind.QTDATA)


@dataclass
class IgtlCounts:
    """Numbers of samples, lost frames, repeated frames, damaged messages and other messages since the opening."""

    samples: int = 0
    lost: int = 0
    repeated: int = 0
    damaged: int = 0
    others: int = 0


class IgtlTracker(Tracker):
    """Receives over `link` the poses of the device `name`, or of the tool with that name in TDATA or QTDATA.

    If `ask`, the tracker requests TDATA or QTDATA from the server: at most one message every `interval_ms`, in the
    coordinate system `coordinates` (empty: the server chooses). `rate_hz` is the frame rate, from which lost frames are
    counted; 0: they are not counted. If not `needs_crc`, messages with the checksum 0 are accepted. The constructor
    calls `start` and raises its errors; raises ConfigurationError if `ask` is combined with another `kind`.
    """

    name: str
    kind: PoseKind

    def __init__(
        self,
        link: Link,
        name: str,
        *,
        kind: PoseKind = PoseKind.TRANSFORM,
        ask: bool = False,
        interval_ms: int = 0,
        coordinates: str = "",
        rate_hz: float = 0.0,
        needs_crc: bool = True,
        limits: IgtlPoseLimits | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._clock: Clock = SystemClock() if clock is None else clock
        self._link, self.name, self.kind = link, name, kind
        self._ask, self._interval_ms, self._coordinates = ask and kind.holds_tools, interval_ms, coordinates
        self._rate_hz, self._needs_crc = rate_hz, needs_crc
        self.limits: IgtlPoseLimits = IgtlPoseLimits() if limits is None else limits
        self.counts: IgtlCounts = IgtlCounts()
        self._closed = False
        with self.closed_if_failing():
            if ask and not kind.holds_tools:
                raise ConfigurationError(Mistake("ask", "yes", "only TDATA and QTDATA can be requested"))
            self.start()

    @classmethod
    def open(cls, address: str, *, limits: IgtlPoseLimits | None = None) -> IgtlTracker:
        """Open `igtl://host[:18944]/NeedleToTracker` and wait for the first pose.

        The options are:

        - `message`: transform (the default), position, tdata or qtdata.
        - `ask`: yes to request TDATA or QTDATA from the server, by default no.
        - `interval_ms`: with `ask`, shortest time (ms) between messages, by default 0.
        - `coordinates`: with `ask`, coordinate system of the poses, by default chosen by the server.
        - `rate_hz`: frame rate, from which lost frames are counted, by default 0 (not counted).
        - `crc`: absent to accept messages with the checksum 0, by default required.
        - `timeout_s`: longest time (s) to connect, by default 3.

        Raises AddressError if the address is wrong, ConfigurationError if the server does not send this device,
        DeviceFault if the server cannot be reached.
        """
        parsed, name, needs_crc = named_address(address, ("message", "ask", "interval_ms", "coordinates", "rate_hz"))
        kind = parsed.option("message", Choice(PoseKind), PoseKind.TRANSFORM)
        ask = parsed.option("ask", Choice({"no": False, "yes": True}), False)
        interval_ms = parsed.option("interval_ms", Integer(0, 2**31 - 1), 0)
        rate_hz = parsed.option("rate_hz", Number("Hz", at_least=0, at_most=1e6), 0.0)
        link = open_named(parsed)
        coordinates = parsed.options.get("coordinates", "")
        return cls(
            link, name, kind=kind, ask=ask, interval_ms=interval_ms, coordinates=coordinates, rate_hz=rate_hz,
            needs_crc=needs_crc, limits=limits,
        )  # fmt: skip

    def start(self) -> None:
        """Request the poses if `ask`, and wait for the first pose; also restarts the tracker after a fault.

        Raises ConfigurationError if no pose of the device arrives within `limits.start_s`, DeviceFault if the server
        refuses the request, sends damaged messages, or has disconnected. `start` cannot restore a lost connection: open
        a new tracker.
        """
        self._fault: DeviceFault | None = None
        # Poses of all kinds are decoded, so that the message of a failed start can name the devices that were received.
        wanted = {*(kind.upper() for kind in PoseKind), f"RTS_{self.kind.upper()}"}
        self._reader = MessageReader(wanted, needs_crc=self._needs_crc)
        self._validator = IgtlPoseValidator(self.limits, self._rate_hz)
        self._others: dict[str, None] = {}
        self._damaged_before = 0
        # PLUS sends the highest header version that it has received, and only version 2 contains the status of a coil.
        self._link.send(encode_message(IgtlMessage("GET_STATUS", "", version=2)))
        if self._ask:
            self._send("STT", encode_start(self._interval_ms, self._coordinates))
        self._new_pose_ns = self._clock.now_ns()
        deadline = Deadline(self._clock, self.limits.start_s)
        self._first: PoseSample | None = None
        self._present = False
        while not self._present and not deadline.passed:
            self._first = self._next(deadline)
        if not self._present:
            others = ", ".join(self._others) or "nothing"
            rule = (
                f"must be a {self.kind.upper()} that the server sends; in {self.limits.start_s:g} s it sent: {others}"
            )
            raise ConfigurationError(Mistake("name", self.name, rule), "tracker")

    def read(self, timeout_s: float) -> PoseSample | None:
        """Return the next pose sample, or None after `timeout_s`.

        Raises DeviceFault if no new pose arrives for `limits.silence_s`, the server cannot be used any more, or the
        connection is lost, and then at every call until `start`. Raises LinkClosed after `close`.
        """
        self._require_open()
        if self._fault is not None:
            raise self._fault
        sample, self._first = self._first, None
        try:
            if sample is None:
                sample = self._next(Deadline(self._clock, timeout_s))
                self._check_progress(sample)
        except DeviceFault as fault:
            self._fault = fault
            raise
        if sample is not None:
            self.counts.samples += 1
            self.counts.lost += sample.stamp.lost
        return sample

    def _next(self, deadline: Deadline) -> PoseSample | None:
        """Return the sample of the next new pose, or None after the deadline, even if other messages keep arriving."""
        asked = False
        while True:
            message = self._reader.next()
            self._count_damage(whole=message is not None)
            if message is None:
                if asked and deadline.passed:
                    return None
                self._reader.feed(self._link.receive(deadline.left_s))
                asked = True
                continue
            sample = self._take(message)
            if sample is not None:
                self._new_pose_ns = self._clock.now_ns()
                return sample

    def _take(self, message: IgtlMessage) -> PoseSample | None:
        if message.kind.startswith("RTS_"):
            if not decode_reply(message.content):
                raise DeviceFault(f"tracker: the server refuses to send {self.kind.upper()}")
            return None
        pose, status = None, ""
        if self.kind.holds_tools and message.kind == self.kind.upper():
            pose, status = self._among(message)
        elif message.kind == self.kind.upper() and self.name in names_of(message):
            pose = _WHOLE[self.kind](message.content)
            status = message.metadata.get("TransformStatus", "")
        else:
            self._note_other(f"{message.kind} {message.device!r}")
            self.counts.others += 1
            return None
        self._present |= pose is not None
        sample = self._validator.validate(pose, message.timestamp, status, self._clock.now_ns())
        self.counts.repeated += sample is None
        return sample

    def _among(self, message: IgtlMessage) -> tuple[IgtlPose | None, str]:
        """Return pose and status of the tracked tool in a TDATA or QTDATA message; (None, "") without this tool.

        Raises DeviceFault if several tools have the name of the tracked tool.
        """
        tools = _MANY[self.kind](message.content)
        short = self.name.encode()[:_NAME_BYTES].decode(errors="ignore")
        matching = [each for each in tools if each.name == short]
        for each in tools:
            self._note_other(f"{message.kind} {each.name!r}")
        if len(matching) > 1:
            raise DeviceFault(f"tracker: {len(matching)} tools are called {short!r}")
        if not matching:
            return None, ""
        tool = matching[0]
        status = message.metadata.get(f"{self.name}Status", message.metadata.get(f"{short}Status", ""))
        if tool.kind is ToolKind.POSITION_ONLY:
            return IgtlPose(tool.pose.position_mm, distortion=tool.pose.distortion, oriented=False), status
        return tool.pose, status

    def _check_progress(self, sample: PoseSample | None) -> None:
        silent_s = (self._clock.now_ns() - self._new_pose_ns) / 1e9
        if sample is not None or silent_s < self.limits.silence_s:
            return
        waiting = f", {self._reader.pending} bytes of an incomplete message" if self._reader.pending else ""
        raise DeviceFault(
            f"tracker: no new {self.kind.upper()} {self.name!r} for {silent_s:.3g} s; received {self.counts.repeated} "
            f"repeated and {self.counts.others} other messages{waiting}. Some servers omit coils that are not visible"
        )

    def _count_damage(self, whole: bool) -> None:
        self.counts.damaged = self._reader.damaged
        if self._reader.damaged - self._damaged_before >= self.limits.damaged:
            raise ProtocolError(f"tracker: {self.limits.damaged} damaged messages in succession: is this OpenIGTLink?")
        if whole:
            self._damaged_before = self._reader.damaged

    def _note_other(self, what: str) -> None:
        if len(self._others) < _MOST_OTHERS:
            self._others[what] = None

    def _send(self, prefix: str, content: bytes = b"") -> None:
        self._link.send(encode_message(IgtlMessage(f"{prefix}_{self.kind.upper()}", "", content)))

    def close(self) -> None:
        """Ask the server to stop a requested transmission, and close the connection. Closing again does nothing."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(DeviceFault):
            if self._ask:
                self._send("STP")
        self._link.close()


def named_address(address: str, known: Sequence[str] = ()) -> tuple[Address, str, bool]:
    """Return the parts of `igtl://host[:18944]/NAME`, the name, and whether the option `crc` requires checksums.

    `known` are further options. Raises AddressError.
    """
    parsed = Address.parse(address)
    if parsed.scheme != "igtl":
        raise AddressError(Mistake("address", address, "must begin with igtl://"))
    parsed.only((*known, "crc", "timeout_s"))
    name = unquote(parsed.path.removeprefix("/"))
    if not name or "/" in name:
        rule = "must name the device of the messages, as in igtl://host/NeedleToTracker"
        raise AddressError(Mistake("address", address, rule))
    return parsed, name, parsed.option("crc", Choice({"required": True, "absent": False}), True)


def open_named(parsed: Address) -> Link:
    """Open the connection to the server at an address of `named_address`. Raises DeviceFault."""
    rest = {key: value for key, value in parsed.options.items() if key == "timeout_s"}
    return open_link(Address("tcp", parsed.host, parsed.port, "", rest), IGTL_PORT)


def names_of(message: IgtlMessage) -> tuple[str, ...]:
    """Return the name of a device in the header and in the metadata, where PLUS stores names above 20 bytes."""
    return message.device, message.metadata.get("IGTL_DEVICE_NAME", message.device)


_WHOLE: dict[PoseKind, Callable[[bytes], IgtlPose]] = {
    PoseKind.TRANSFORM: decode_transform,
    PoseKind.POSITION: decode_position,
}
_MANY: dict[PoseKind, Callable[[bytes], Sequence[IgtlTool]]] = {
    PoseKind.TDATA: decode_tdata,
    PoseKind.QTDATA: decode_qtdata,
}
