"""From power on to tracking: the sequence of commands that an NDI device wants."""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.devices.clock import Deadline
from needleplan.devices.ndi.commands import BAUD_CODES, Refused
from needleplan.devices.ndi.conversation import Conversation
from needleplan.devices.serial_port import SerialLink
from needleplan.errors import ConfigurationError, DeviceFault, Mistake, ProtocolError

__all__ = ["Tool", "choose_tool", "enable_tools", "set_speed", "wake"]

_FIRST_ANSWER_S = 2.0
_RESET_S = 5.0
_SETTLING_S = 0.1
_ROUNDS = 8
_STALE, _OCCUPIED, _INITIALISED, _ENABLED = "01", "02", "03", "04"


@dataclass(frozen=True)
class Tool:
    """A tool that is enabled: its handle, which may change with every start, and its serial number, which may not."""

    handle: int
    serial: str
    kind: str


def wake(talk: Conversation) -> None:
    """Initialise the device; over a serial line reset it first where it does not answer. Raises DeviceFault."""
    serial = isinstance(talk.link, SerialLink)
    try:
        talk.ask("INIT", timeout_s=_FIRST_ANSWER_S if serial else None)
    except Refused:
        talk.ask("TSTOP")  # somebody left it tracking
        talk.ask("INIT")
    except DeviceFault:
        if not isinstance(talk.link, SerialLink):
            raise
        talk.hush()
        talk.link.baud = 9600
        talk.link.send_break()
        deadline = Deadline(talk.clock, _RESET_S)
        while not deadline.passed and talk.receive(deadline.left_s) != "RESET":
            pass
        talk.ask("INIT")


def set_speed(talk: Conversation, baud: int) -> None:
    """Change both ends of a serial line to `baud`. Raises DeviceFault where the device does not follow."""
    if not isinstance(talk.link, SerialLink):
        raise ConfigurationError(Mistake("speed", str(baud), "only a serial line has a speed"))
    if baud not in BAUD_CODES:
        raise ConfigurationError(Mistake("speed", str(baud), f"must be one of {', '.join(map(str, BAUD_CODES))}"))
    before = talk.link.baud
    talk.ask("COMM", f"{BAUD_CODES[baud]}0000")  # answered at the old speed
    talk.link.baud = baud
    talk.clock.sleep(_SETTLING_S)
    try:
        talk.ask("VER", "0", timeout_s=_FIRST_ANSWER_S)
    except DeviceFault as fault:
        raise DeviceFault(f"tracker: answers at {before} baud, but after COMM not at {baud}: {fault}") from fault


def enable_tools(talk: Conversation) -> list[Tool]:
    """Free the handles of tools that are gone, initialise and enable those that are there. Raises DeviceFault."""
    for handle in _handles(talk, _STALE):
        talk.ask("PHF", f"{handle:02X}")
    # Some tools show further handles once the first has been initialised.
    for _ in range(_ROUNDS):
        waiting = _handles(talk, _OCCUPIED)
        if not waiting:
            break
        for handle in waiting:
            talk.ask("PINIT", f"{handle:02X}")
    for handle in _handles(talk, _INITIALISED):
        talk.ask("PENA", f"{handle:02X}D")
    return [_tool(talk, handle) for handle in _handles(talk, _ENABLED)]


def choose_tool(tools: list[Tool], wanted: str) -> Tool:
    """Return the tool with the serial number `wanted`, or the only one. Raises ConfigurationError."""
    there = ", ".join(f"{tool.serial or 'without number'} (handle {tool.handle:02X})" for tool in tools) or "none"
    found = [tool for tool in tools if wanted in ("", tool.serial)]
    if len(found) != 1:
        rule = "must be the serial number of one tool" if wanted else "must be given where there is not one tool"
        raise ConfigurationError(Mistake("tool", wanted, f"{rule}; there: {there}"), "tracker")
    return found[0]


def _handles(talk: Conversation, which: str) -> list[int]:
    reply = talk.ask("PHSR", which)
    try:
        count = int(reply[:2], 16)
        handles = [int(reply[at : at + 2], 16) for at in range(2, 2 + 5 * count, 5)]
    except ValueError as error:
        raise ProtocolError(f"tracker: {reply[:40]!r} does not answer PHSR:{which}") from error
    if len(reply) != 2 + 5 * count:
        raise ProtocolError(f"tracker: PHSR:{which} announces {count} handles in {len(reply)} characters")
    return handles


def _tool(talk: Conversation, handle: int) -> Tool:
    """Ask who a tool is: kind (8 characters), maker (12), revision (3), serial number (8), port status (2)."""
    try:
        reply = talk.ask("PHINF", f"{handle:02X}0001")
    except Refused:
        return Tool(handle, "", "")
    return Tool(handle, reply[23:31].strip(), reply[:8].strip())
