"""A tracker behind an OpenIGTLink server such as PLUS."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from urllib.parse import unquote

from needleplan.devices._base import PoseSample, Tracker
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._links import Link
from needleplan.devices._opening import Address, open_link
from needleplan.devices.igtl._validation import IgtlPoseLimits, IgtlPoseValidator
from needleplan.devices.igtl.contents import decode_reply, encode_start
from needleplan.devices.igtl.messages import IgtlMessage, MessageReader, encode_message
from needleplan.devices.igtl.poses import (
    IgtlPose,
    IgtlTool,
    ToolKind,
    decode_position,
    decode_qtdata,
    decode_tdata,
    decode_transform,
)
from needleplan.errors import AddressError, ConfigurationError, DeviceFault, LinkClosed, Mistake, ProtocolError

__all__ = ["IGTL_PORT", "IgtlCounts", "IgtlTracker", "PoseKind"]

IGTL_PORT = 18944

_NAME_BYTES = 20
_MOST_HEARD = 20


class PoseKind(StrEnum):
    """The kind of message that carries the pose."""

    TRANSFORM = "transform"
    POSITION = "position"
    TDATA = "tdata"
    QTDATA = "qtdata"

    @property
    def holds_tools(self) -> bool:
        """Whether one message has many tools, each with its name."""
        return self in (PoseKind.TDATA, PoseKind.QTDATA)


@dataclass
class IgtlCounts:
    """What came from the server since the start, and what did not."""

    samples: int = 0
    lost: int = 0
    repeated: int = 0
    damaged: int = 0
    others: int = 0


class IgtlTracker(Tracker):
    """Follows the device `name`, or the tool of that name in TDATA and QTDATA, over `link`.

    With `ask` the server is asked to send TDATA or QTDATA, at most every `interval_ms`, in `coordinates` (a name that
    the server knows; empty for its own choice). Where `rate_hz` is given, frames that are missing between two times are
    counted as lost.
    """

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
        limits: IgtlPoseLimits | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._clock: Clock = SystemClock() if clock is None else clock
        self._link, self.name, self.kind = link, name, kind
        self._ask, self._interval_ms, self._coordinates = ask and kind.holds_tools, interval_ms, coordinates
        self._rate_hz = rate_hz
        self.limits = IgtlPoseLimits() if limits is None else limits
        self.counts = IgtlCounts()
        self._closed = False
        try:
            if ask and not kind.holds_tools:
                raise ConfigurationError(Mistake("ask", "yes", "only TDATA and QTDATA are asked for"))
            self.start()
        except BaseException:
            self.close()
            raise

    @classmethod
    def open(cls, address: str, *, limits: IgtlPoseLimits | None = None) -> IgtlTracker:
        """Open `igtl://host[:18944]/NeedleToTracker` and wait for its first pose.

        Options: `message` (transform, position, tdata, qtdata), `ask` (yes or no), `interval_ms`, `coordinates`,
        `rate_hz`, `timeout_s` of the connection. Raises AddressError, ConfigurationError where the server does not send
        that device, DeviceFault where there is no server.
        """
        parsed = Address.parse(address)
        if parsed.scheme != "igtl":
            raise AddressError(Mistake("address", address, "must begin with igtl://"))
        parsed.only(("message", "ask", "interval_ms", "coordinates", "rate_hz", "timeout_s"))
        name = unquote(parsed.path.removeprefix("/"))
        if not name or "/" in name:
            rule = "must name what is tracked, as in igtl://host/NeedleToTracker"
            raise AddressError(Mistake("address", address, rule))
        kind = parsed.option("message", PoseKind, PoseKind.TRANSFORM)
        ask = parsed.option("ask", {"no": False, "yes": True}.__getitem__, False)
        interval_ms = parsed.option("interval_ms", int, 0)
        rate_hz = parsed.option("rate_hz", float, 0.0)
        if not 0 <= rate_hz < 1e6:
            raise AddressError(Mistake("rate_hz", str(rate_hz), "must be a positive number"), address)
        rest = {key: value for key, value in parsed.options.items() if key == "timeout_s"}
        link = open_link(Address("tcp", parsed.host, parsed.port, "", rest), IGTL_PORT)
        coordinates = parsed.options.get("coordinates", "")
        return cls(
            link, name, kind=kind, ask=ask, interval_ms=interval_ms, coordinates=coordinates, rate_hz=rate_hz,
            limits=limits,
        )  # fmt: skip

    def start(self) -> None:
        """Begin anew, and wait for the first pose. Raises DeviceFault, ConfigurationError.

        A connection that was lost does not come back: open the tracker again.
        """
        self._fault: DeviceFault | None = None
        # Kinds that are not wanted are passed over, but the others that could be meant are told where none comes.
        self._reader = MessageReader({*(each.upper() for each in PoseKind), f"RTS_{self.kind.upper()}"})
        self._validator = IgtlPoseValidator(self.limits, self._rate_hz)
        self._heard: dict[str, None] = {}
        self._damaged_before = 0
        # PLUS answers in the highest header version that it has heard, and only version 2 tells whether a coil is seen.
        self._link.send(encode_message(IgtlMessage("GET_STATUS", "", version=2)))
        if self._ask:
            self._send("STT", encode_start(self._interval_ms, self._coordinates))
        self._seen_ns = self._clock.now_ns()
        deadline = Deadline(self._clock, self.limits.start_s)
        self._first: PoseSample | None = None
        self._present = False
        while not self._present and not deadline.passed:
            self._first = self._next(deadline)
        if not self._present:
            heard = ", ".join(self._heard) or "no poses at all"
            rule = (
                f"must be a {self.kind.upper()} that the server sends; within {self.limits.start_s:g} s came: {heard}"
            )
            raise ConfigurationError(Mistake("name", self.name, rule), "tracker")

    def read(self, timeout_s: float) -> PoseSample | None:
        """Return the next frame, or None after `timeout_s`. Frames come in their order, none is left out.

        Raises DeviceFault, again and again until `start`.
        """
        if self._closed:
            raise LinkClosed("the tracker is closed")
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
        """Return the next new frame; None when the time is up, whatever else keeps coming."""
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
            sample = self._understand(message)
            if sample is not None:
                self._seen_ns = self._clock.now_ns()
                return sample

    def _understand(self, message: IgtlMessage) -> PoseSample | None:
        if message.kind.startswith("RTS_"):
            if not decode_reply(message.content):
                raise DeviceFault(f"tracker: the server refuses to send {self.kind.upper()}")
            return None
        pose, status = None, ""
        if self.kind.holds_tools and message.kind == self.kind.upper():
            pose, status = self._among(message)
        elif message.kind == self.kind.upper() and self.name in _names(message):
            pose = _WHOLE[self.kind](message.content)
            status = message.metadata.get("TransformStatus", "")
        else:
            self._hear(f"{message.kind} {message.device!r}")
            self.counts.others += 1
            return None
        self._present |= pose is not None
        sample = self._validator.validate(pose, message.timestamp, status, self._clock.now_ns())
        self.counts.repeated += sample is None
        return sample

    def _among(self, message: IgtlMessage) -> tuple[IgtlPose | None, str]:
        """Return pose and status of our tool in a message with many; no pose where it is not in there."""
        tools = _MANY[self.kind](message.content)
        short = self.name.encode()[:_NAME_BYTES].decode(errors="ignore")
        found = [each for each in tools if each.name == short]
        for each in tools:
            self._hear(f"{message.kind} {each.name!r}")
        if len(found) > 1:
            raise DeviceFault(f"tracker: {len(found)} tools are called {short!r}")
        if not found:
            return None, ""
        tool = found[0]
        status = message.metadata.get(f"{self.name}Status", message.metadata.get(f"{short}Status", ""))
        if tool.kind is ToolKind.POSITION_ONLY:
            return IgtlPose(tool.pose.position_mm, distortion=tool.pose.distortion, oriented=False), status
        return tool.pose, status

    def _check_progress(self, sample: PoseSample | None) -> None:
        silent_s = (self._clock.now_ns() - self._seen_ns) / 1e9
        if sample is not None or silent_s < self.limits.silence_s:
            return
        waiting = f"; {self._reader.pending} bytes of an unfinished message wait" if self._reader.pending else ""
        raise DeviceFault(
            f"tracker: no new {self.kind.upper()} {self.name!r} for {silent_s:.3g} s; {self.counts.repeated} repeated "
            f"and {self.counts.others} other messages{waiting}. A server may leave out what it does not see"
        )

    def _count_damage(self, whole: bool) -> None:
        self.counts.damaged = self._reader.damaged
        if self._reader.damaged - self._damaged_before >= self.limits.damaged:
            raise ProtocolError(f"tracker: {self.limits.damaged} damaged messages in a row: is this OpenIGTLink?")
        if whole:
            self._damaged_before = self._reader.damaged

    def _hear(self, what: str) -> None:
        if len(self._heard) < _MOST_HEARD:
            self._heard[what] = None

    def _send(self, prefix: str, content: bytes = b"") -> None:
        self._link.send(encode_message(IgtlMessage(f"{prefix}_{self.kind.upper()}", "", content)))

    def close(self) -> None:
        """Ask a server that was asked to send to stop, and close the connection."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(DeviceFault):
            if self._ask:
                self._send("STP")
        self._link.close()


def _names(message: IgtlMessage) -> tuple[str, ...]:
    """Return the names of a device: PLUS puts those that are too long for the header into the metadata."""
    return message.device, message.metadata.get("IGTL_DEVICE_NAME", message.device)


_WHOLE: dict[PoseKind, Callable[[bytes], IgtlPose]] = {
    PoseKind.TRANSFORM: decode_transform,
    PoseKind.POSITION: decode_position,
}
_MANY: dict[PoseKind, Callable[[bytes], Sequence[IgtlTool]]] = {
    PoseKind.TDATA: decode_tdata,
    PoseKind.QTDATA: decode_qtdata,
}
