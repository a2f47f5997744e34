"""The way to a robot: a UDP port, or a serial line that this program serves at a UDP port of this machine.

A stop by a bystander, who does not control the robot.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TextIO

from needleplan import _ppvi
from needleplan.bystander import WITHIN_S, StopOutcome, stop
from needleplan.devices._base import Closing
from needleplan.devices._clock import Deadline, SystemClock
from needleplan.devices._links import SerialLink
from needleplan.devices._opening import BAUDS, Address
from needleplan.devices.robot.messages import ROBOT_PORT
from needleplan.errors import AddressError, DeviceFault, Mistake
from needleplan.line_owner import line_place, line_port

__all__ = ["LINE_BAUD", "RobotWay", "open_way", "robot_address", "stop_robot"]


LINE_BAUD = 460_800
"""Speed (bit/s) of a serial line to a robot, by default: 400 compact statuses per second fill two thirds of it."""

_LOCALHOST = "127.0.0.1"
_LOOKED_AT_S = 0.2  # longest time (s) for which a program that looks for the owner of a line locks its file


class RobotWay(Closing):
    """The way to a robot, whose datagrams are exchanged with `host` and `port`; `address` are the parts of its address.

    If this program owns the serial line to the robot, threads of Rust pass the datagrams on until `close`.
    """

    def __init__(
        self, address: Address, host: str, port: int, line: _ppvi.RobotLine | None = None, lock: TextIO | None = None
    ) -> None:
        self.address: Address = address
        self.host: str = host
        self.port: int = port
        self._line, self._lock = line, lock

    @property
    def failure(self) -> str:
        """Why nothing passes any more, such as a line that was unplugged; empty while something may pass."""
        failure = None if self._line is None else self._line.failure
        return "" if failure is None else f"serial://{self.address.path}: {failure}"

    @property
    def hint(self) -> str:
        """Why a robot on a serial line may not have answered; empty for a robot that is reached by UDP."""
        if self._line is None:
            return ""
        received, datagrams, _ = self._line.counts
        if self.failure or datagrams:
            return self.failure
        heard = f"received {received} bytes but no message" if received else "received nothing"
        baud = self.address.options.get("baud", LINE_BAUD)
        return f"{self.address.path} has {heard}: has the robot power, its cable, and baud = {baud}?"

    @property
    def counts(self) -> tuple[int, int, int]:
        """Received bytes and messages of the line, and messages for which it had no room; 0 without a line."""
        return (0, 0, 0) if self._line is None else self._line.counts

    def close(self) -> None:
        """Release the line. Closing again does nothing."""
        if self._line is not None:
            self._line.close()
        if self._lock is not None:
            self._lock.close()


def robot_address(address: str, known: Collection[str] | None = None) -> Address:
    """Return the parts of `udp://host[:5005]` or `serial:///dev/ttyUSB0[?baud=460800]`.

    `known` are the options that the address may have besides `baud`; None permits any. Raises AddressError.
    """
    parsed = Address.parse(address)
    if parsed.scheme not in ("udp", "serial"):
        rule = "a robot is reached by udp://host or serial:///dev/ttyUSB0"
        raise AddressError(Mistake("address", address, rule))
    if known is not None:
        parsed.only((*known, "baud") if parsed.scheme == "serial" else known)
    if parsed.scheme == "udp":
        parsed.network(ROBOT_PORT)
    elif parsed.host or parsed.port is not None or len(parsed.path) < 2:
        rule = "must name a port of this machine after three slashes: serial:///dev/ttyUSB0"
        raise AddressError(Mistake("address", address, rule))
    return parsed


def open_way(address: str, known: Collection[str] | None = None, *, shared: bool = False) -> RobotWay:
    """Open the way to the robot at an address of `robot_address`.

    A serial line is opened, and belongs to this program until `close`. If it is `shared` and another program of this
    user owns it, the way leads through that program. Raises AddressError if the address is wrong, DeviceFault if the
    line cannot be opened.
    """
    parsed = robot_address(address, known)
    if parsed.scheme == "udp":
        return RobotWay(parsed, *parsed.network(ROBOT_PORT))
    if shared and (port := line_port(parsed.path)) is not None:
        return RobotWay(parsed, _LOCALHOST, port)
    baud = parsed.option("baud", BAUDS, LINE_BAUD)
    lock = _locked(parsed.path)
    try:
        line = _ppvi.RobotLine(SerialLink(parsed.path, baud).hand_over(), baud)
        lock.write(f"{line.port}")
        lock.flush()
    except BaseException as error:
        lock.close()
        if isinstance(error, OSError):
            raise DeviceFault(f"serial://{parsed.path} cannot be opened: {error}") from error
        raise
    return RobotWay(parsed, _LOCALHOST, line.port, line, lock)


def _locked(path: str) -> TextIO:
    """Return the empty file of `line_place`, locked for this program. Raises DeviceFault if another one has it."""
    try:
        import fcntl
    except ImportError:
        raise DeviceFault(f"serial://{path}: a robot on a serial line needs a POSIX system") from None
    place = Path(line_place(path))
    try:
        place.parent.mkdir(mode=0o700, exist_ok=True)
        if place.parent.lstat().st_uid != os.getuid():
            raise PermissionError(f"{place.parent} belongs to another user")
        file = place.open("a", encoding="ascii")
    except OSError as error:
        raise DeviceFault(f"serial://{path}: {place} cannot be written: {error.strerror or error}") from error
    patience = Deadline(SystemClock(), _LOOKED_AT_S)
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            file.truncate(0)
            return file
        except OSError:
            if patience.passed:
                file.close()
                raise DeviceFault(f"serial://{path}: another program controls the robot on this line") from None
        time.sleep(_LOOKED_AT_S / 20)


def stop_robot(
    address: str, within_s: float = WITHIN_S, on_alarm: Callable[[StopOutcome], object] | None = None
) -> StopOutcome:
    """Stop the robot at `udp://host[:5005]` or `serial:///dev/ttyUSB0[?baud=460800]`, without taking control.

    Returns when the needle is measured at rest. A serial line is shared with the program that controls the robot.

    The stop is sent again every 10 ms. `on_alarm` gets the present outcome once if the needle still moves, and once if
    the robot reports no position. The stop needs no key. If the robot has a controller, the robot enters FAULT, and the
    run of the controller ends. Raises AddressError if the address is wrong, DeviceFault if the needle is not measured
    at rest within `within_s`.
    """
    with open_way(address, shared=True) as way:
        try:
            outcome = stop(way.host, way.port, within_s, on_alarm)
        except (OSError, UnicodeError) as error:
            raise AddressError(Mistake("host", way.host, "is not a host that this machine can find")) from error
        if not outcome.is_confirmed:
            name = f"serial://{way.address.path}" if way.address.scheme == "serial" else f"udp://{way.host}:{way.port}"
            raise DeviceFault("; ".join(filter(None, (outcome.why_not(name), way.hint))))
    return outcome
