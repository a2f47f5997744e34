"""Tracker that reads the pose of the coil in the needle tip from an NDI Aurora or Polaris."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

from needleplan.config import Choice, Number
from needleplan.devices._base import PoseSample, Tracker
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._links import Link, SerialLink
from needleplan.devices._opening import BAUDS, Address, open_link
from needleplan.devices.ndi.commands import BAUD_CODES, NdiConversation, NdiRefused
from needleplan.devices.ndi.frames import Frames, NdiPoseLimits, NdiPoseValidator, parse_bx, parse_tx
from needleplan.errors import AddressError, ConfigurationError, DeviceFault, LinkClosed, Mistake, ProtocolError

__all__ = ["NDI_PORT", "NdiCounts", "NdiTool", "NdiTracker", "choose_tool", "enable_tools", "set_speed", "wake"]

_FIRST_ANSWER_S = 2.0  # longest time (s) to the reply at a new speed, or to the first command on a serial line
_RESET_S = 5.0  # longest time (s) from a serial break to the message RESET
_SETTLING_S = 0.1  # pause (s) after a change of the speed of the serial line
_ROUNDS = 8  # largest number of passes to initialise tools
# Arguments of PHSR: handles of removed tools; of tools to be initialised; of tools to be enabled; of enabled tools
_STALE, _OCCUPIED, _INITIALISED, _ENABLED = "01", "02", "03", "04"


@dataclass(frozen=True)
class NdiTool:
    """An enabled tool: handle (may change at every start), serial number (does not change) and type."""

    handle: int
    serial: str
    kind: str


def wake(conversation: NdiConversation) -> None:
    """Initialise the device by the command INIT.

    If the device refuses INIT, because it is still tracking, stop tracking and repeat INIT. If the device does not
    answer on a serial line, reset the device by a serial break at 9600 baud and repeat INIT. Raises DeviceFault if INIT
    still fails.
    """
    serial = isinstance(conversation.link, SerialLink)
    try:
        conversation.ask("INIT", timeout_s=_FIRST_ANSWER_S if serial else None)
    except NdiRefused:
        conversation.ask("TSTOP")  # the device is still in tracking mode from an earlier session
        conversation.ask("INIT")
    except DeviceFault:
        if not isinstance(conversation.link, SerialLink):
            raise
        conversation.discard()
        conversation.link.baud = 9600
        conversation.link.send_break()
        deadline = Deadline(conversation.clock, _RESET_S)
        while not deadline.passed and conversation.receive(deadline.left_s) != "RESET":
            pass
        conversation.ask("INIT")


def set_speed(conversation: NdiConversation, baud: int) -> None:
    """Change the speed of the device and of the serial port to `baud`.

    Raises ConfigurationError if the link is not a serial line or NDI has no code for `baud`, DeviceFault if the device
    refuses the speed or does not answer at the new speed.
    """
    if not isinstance(conversation.link, SerialLink):
        raise ConfigurationError(Mistake("speed", str(baud), "only a serial line has a speed"))
    if baud not in BAUD_CODES:
        raise ConfigurationError(Mistake("speed", str(baud), f"must be one of {', '.join(map(str, BAUD_CODES))}"))
    before = conversation.link.baud
    conversation.ask("COMM", f"{BAUD_CODES[baud]}0000")  # the device replies at the old speed
    conversation.link.baud = baud
    conversation.clock.sleep(_SETTLING_S)
    try:
        conversation.ask("VER", "0", timeout_s=_FIRST_ANSWER_S)
    except DeviceFault as fault:
        raise DeviceFault(f"tracker: answers at {before} baud, but not at {baud} baud after COMM: {fault}") from fault


def enable_tools(conversation: NdiConversation) -> list[NdiTool]:
    """Free the handles of removed tools, initialise and enable the connected tools, and return all enabled tools.

    Raises DeviceFault if the device refuses a command or does not answer, ProtocolError for an invalid reply.
    """
    for handle in _handles(conversation, _STALE):
        conversation.ask("PHF", f"{handle:02X}")
    # Some tools have further handles, which appear only after the first handle has been initialised.
    for _ in range(_ROUNDS):
        waiting = _handles(conversation, _OCCUPIED)
        if not waiting:
            break
        for handle in waiting:
            conversation.ask("PINIT", f"{handle:02X}")
    for handle in _handles(conversation, _INITIALISED):
        conversation.ask("PENA", f"{handle:02X}D")
    return [_tool(conversation, handle) for handle in _handles(conversation, _ENABLED)]


def choose_tool(tools: list[NdiTool], wanted: str) -> NdiTool:
    """Return the tool with the serial number `wanted`, or the only tool if `wanted` is empty.

    Raises ConfigurationError if no tool or several tools match.
    """
    there = ", ".join(f"{tool.serial or 'without number'} (handle {tool.handle:02X})" for tool in tools) or "none"
    matching = [tool for tool in tools if wanted in ("", tool.serial)]
    if len(matching) != 1:
        rule = "must be the serial number of one tool" if wanted else "must be given unless there is exactly one tool"
        raise ConfigurationError(Mistake("tool", wanted, f"{rule}; available: {there}"), "tracker")
    return matching[0]


def _handles(conversation: NdiConversation, which: str) -> list[int]:
    reply = conversation.ask("PHSR", which)
    try:
        count = int(reply[:2], 16)
        handles = [int(reply[at : at + 2], 16) for at in range(2, 2 + 5 * count, 5)]
    except ValueError as error:
        raise ProtocolError(f"tracker: {reply[:40]!r} is not a valid reply to PHSR:{which}") from error
    if len(reply) != 2 + 5 * count:
        raise ProtocolError(f"tracker: PHSR:{which} announces {count} handles in {len(reply)} characters")
    return handles


def _tool(conversation: NdiConversation, handle: int) -> NdiTool:
    """Query a tool and return it; its serial number and type are empty if the device refuses the query.

    The reply holds type (8 characters), manufacturer (12), revision (3), serial number (8) and port status (2).
    """
    try:
        reply = conversation.ask("PHINF", f"{handle:02X}0001")
    except NdiRefused:
        return NdiTool(handle, "", "")
    return NdiTool(handle, reply[23:31].strip(), reply[:8].strip())


NDI_PORT = 8765

_POLL_S = 0.004  # pause (s) before the next request after the device has repeated a frame
_TRANSIENT = (0x04, 0x05)  # error codes for a command that was damaged in transmission; it is sent again


@dataclass
class NdiCounts:
    """Numbers of samples, lost frames, repeated frames, damaged replies and refused requests since the opening.

    A refused request also counts as a damaged reply.
    """

    samples: int = 0
    lost: int = 0
    repeated: int = 0
    damaged: int = 0
    refused: int = 0


class NdiTracker(Tracker):
    """Reads over `link` the poses of the tool with the serial number `tool`; if `tool` is "", of the only tool.

    `speed` is the baud rate to change to at the start (0: no change). Poses are requested by the command TX if `text`,
    else by BX. If `beyond`, poses outside of the measurement volume are returned as SUSPECT, else as MISSING. The
    constructor calls `start` and raises its errors.
    """

    def __init__(
        self,
        link: Link,
        *,
        tool: str = "",
        speed: int = 0,
        text: bool = False,
        beyond: bool = False,
        limits: NdiPoseLimits | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._clock: Clock = SystemClock() if clock is None else clock
        self.limits: NdiPoseLimits = NdiPoseLimits() if limits is None else limits
        self.counts: NdiCounts = NdiCounts()
        self._conversation = NdiConversation(link, self._clock, self.limits.reply_s)
        self._wanted, self._speed = tool, speed
        self._name, self._mode = "TX" if text else "BX", "0801" if beyond else "0001"
        self._closed = self._tracking = self._speed_changed = False
        with self.closed_if_failing():
            self.start()

    @classmethod
    def open(cls, address: str, *, limits: NdiPoseLimits | None = None) -> NdiTracker:
        """Open `serial:///dev/ttyUSB0[?baud=9600]` or `tcp://host[:8765][?timeout_s=3]` and start tracking.

        The options are:

        - `baud`: present speed of the serial line, by default 9600.
        - `timeout_s`: longest time (s) to connect by TCP, by default 3.
        - `speed`: speed of a serial line after the start, by default unchanged.
        - `tool`: serial number of the tool, by default that of the only tool.
        - `reply`: bx (the default) for binary replies, tx for text replies.
        - `rate_hz`: frame rate of the tracker, by default 40 Hz (Aurora); a Polaris has 20 or 60 Hz.
        - `beyond`: yes if poses outside of the measurement volume are returned as SUSPECT, by default no (MISSING).

        Raises AddressError if the address is wrong, ConfigurationError if the tool or the speed cannot be chosen,
        DeviceFault if no NDI device answers.
        """
        parsed = Address.parse(address)
        if parsed.scheme not in ("serial", "tcp"):
            raise AddressError(Mistake("address", address, "a tracker is reached by serial:///port or tcp://host"))
        ours = ("tool", "speed", "reply", "beyond", "rate_hz")
        parsed.only((*ours, "baud") if parsed.scheme == "serial" else (*ours, "timeout_s"))
        text = parsed.option("reply", Choice({"bx": False, "tx": True}), False)
        beyond = parsed.option("beyond", Choice({"no": False, "yes": True}), False)
        speed = parsed.option("speed", BAUDS, 0)
        limits = NdiPoseLimits() if limits is None else limits
        rate_hz = parsed.option("rate_hz", Number("Hz", at_least=1, at_most=1000), limits.rate_hz)
        limits = replace(limits, rate_hz=rate_hz)
        rest = {name: value for name, value in parsed.options.items() if name not in ours}
        link = open_link(Address(parsed.scheme, parsed.host, parsed.port, parsed.path, rest), NDI_PORT)
        return cls(link, tool=parsed.options.get("tool", ""), speed=speed, text=text, beyond=beyond, limits=limits)

    @property
    def tool(self) -> NdiTool:
        """The tracked tool."""
        return self._tool

    def start(self) -> None:
        """Initialise the device and its tools, and start tracking; also restarts the tracker after a fault.

        Raises DeviceFault if the device does not answer or refuses a command, ConfigurationError if the tool or the
        speed cannot be chosen.
        """
        self._fault: DeviceFault | None = None
        self._asked_ns: int | None = None
        self._received_ns = 0
        self._took_s = 0.0
        self._damaged_replies = 0
        wake(self._conversation)
        if self._speed:
            set_speed(self._conversation, self._speed)
            self._speed_changed = True
        self._tool = choose_tool(enable_tools(self._conversation), self._wanted)
        self._validator = NdiPoseValidator(self._tool.handle, self.limits)
        self._conversation.ask("TSTART")
        self._tracking = True
        self._conversation.discard()

    def read(self, timeout_s: float) -> PoseSample | None:
        """Return the next pose sample, or None after `timeout_s`.

        Raises DeviceFault if the tracker cannot be used, and then at every call until `start`. Raises LinkClosed if the
        connection is closed.
        """
        self._require_open()
        if self._fault is not None:
            raise self._fault
        deadline = Deadline(self._clock, timeout_s)
        try:
            while True:
                frames = self._exchange(deadline)
                sample = None
                if frames is not None:
                    sample = self._validator.validate(frames, self._clock.now_ns(), self._took_s)
                if sample is not None:
                    self.counts.samples += 1
                    self.counts.lost += sample.stamp.lost
                    return sample
                self.counts.repeated += frames is not None
                if deadline.passed:
                    return None
                if frames is not None:
                    self._clock.sleep(min(_POLL_S, deadline.left_s))
        except LinkClosed:
            raise
        except DeviceFault as fault:
            self._fault = fault
            raise

    def _exchange(self, deadline: Deadline) -> Frames | None:
        """Request a frame unless a request is pending, and return the reply.

        Return None if the reply is damaged, or has not arrived by the deadline or within `gap_s`. Raises DeviceFault if
        no reply arrives within `reply_s`, if too many replies are damaged, or if the device has reset itself.
        """
        now_ns = self._clock.now_ns()
        if self._asked_ns is None:
            # Bytes that arrive without a pending request are an outdated late reply, or report a reset of the device.
            if "RESET" in self._conversation.discard():
                self._parse("RESET")
            self._conversation.send(self._name, self._mode)
            self._asked_ns = self._received_ns = now_ns
        before = self._conversation.reader.pending
        wait_s = min(deadline.left_s, self.limits.gap_s)
        damaged = self._conversation.reader.damaged
        reply = self._conversation.receive(wait_s)
        if reply is not None:
            self._took_s = (self._clock.now_ns() - self._asked_ns) / 1e9
            self._asked_ns = None
            return self._parse(reply)
        now_ns = self._clock.now_ns()
        pending = self._conversation.reader.pending
        if pending != before:
            self._received_ns = now_ns
        cut_short = bool(pending) and now_ns - self._received_ns >= self.limits.gap_s * 1e9
        if cut_short:
            self._conversation.reader.clear()
        if cut_short or (self._conversation.reader.damaged > damaged and not pending):
            self._damaged("cut short" if cut_short else "wrong CRC")
        elif (now_ns - self._asked_ns) / 1e9 >= self.limits.reply_s:
            raise DeviceFault(f"tracker: no reply to {self._name} for {self.limits.reply_s:g} s")
        return None

    def _parse(self, reply: str | bytes) -> Frames | None:
        if reply == "RESET":
            raise DeviceFault("tracker: it has reset itself; was its power interrupted?")
        try:
            if isinstance(reply, str):
                self._conversation.refuse(self._name, reply)
            frames = parse_tx(reply) if isinstance(reply, str) else parse_bx(reply)
        except NdiRefused as refusal:
            if refusal.code not in _TRANSIENT:
                raise
            self.counts.refused += 1
            self._damaged(str(refusal))
            return None
        except ProtocolError as error:
            self._damaged(str(error))
            return None
        self._damaged_replies = 0
        return frames

    def _damaged(self, why: str) -> None:
        """Count an unusable reply, after which the frame is requested again; raises DeviceFault after too many."""
        self._asked_ns = None
        self._damaged_replies += 1
        self.counts.damaged += 1
        if self._damaged_replies >= self.limits.damaged:
            raise DeviceFault(
                f"tracker: {self._damaged_replies} damaged replies in succession: {why}; check speed and cable"
            )

    def close(self) -> None:
        """Close the link. Before, stop tracking if it has started, and return a changed speed to 9600 baud."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(DeviceFault):
            if self._tracking:
                self._conversation.ask("TSTOP", timeout_s=1.0)
        with contextlib.suppress(DeviceFault):
            if self._speed_changed:
                self._conversation.ask("COMM", "00000", timeout_s=1.0)
        self._conversation.link.close()
