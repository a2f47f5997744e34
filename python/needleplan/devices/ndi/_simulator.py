"""A simulated NDI Aurora with selectable faults; it sends the same bytes as a real Aurora.

`AuroraDevice` does no input or output: it receives bytes and returns its replies. `AuroraLink` connects a client to the
device within one process on a virtual clock; `needleplan.devices.endpoint` offers the device at a TCP port or
pseudo-terminal. The poses of the coils are functions of time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from needleplan.artifacts import CallRepr
from needleplan.devices._clock import Clock, SystemClock
from needleplan.devices.ndi.commands import BAUD_CODES, decode_command, encode_text
from needleplan.devices.ndi.frames import Frames, NdiVisibility, ToolFrame, encode_bx, encode_tx
from needleplan.errors import ProtocolError

__all__ = ["AuroraDevice", "AuroraFaults", "SimulatedTool"]

_Pose = Callable[[float], tuple[tuple[float, float, float, float], tuple[float, float, float]]]
_SPEEDS = {code: baud for baud, code in BAUD_CODES.items()}
_LONGEST_COMMAND = 1024  # bytes without a carriage return after which the device discards its input


@dataclass
class SimulatedTool(CallRepr):
    """A simulated coil in a port; `pose` returns quaternion (w, x, y, z) and position (mm) at a time in s."""

    serial: str
    pose: _Pose
    handle: int = 0x0A
    visibility: NdiVisibility = NdiVisibility.VALID
    error_mm: float = 0.05
    port_bits: int = 0
    """Additional bits of the port status, such as 0x40 (out of the measurement volume)."""

    initialised: bool = False
    enabled: bool = False

    @property
    def port_status(self) -> int:
        """Port status word: the bits for tool in port, initialised and enabled, and `port_bits`."""
        return 0x01 | self.initialised * 0x10 | self.enabled * 0x20 | self.port_bits


@dataclass
class AuroraFaults(CallRepr):
    """Faults that the simulated device shows from now on."""

    damage: int = 0
    """Number of the next replies that are sent with one wrong bit."""

    cut: int = 0
    """Number of the next replies of which only the first half is sent."""

    noise_before: bytes = b""
    """Bytes sent before the next reply."""

    error: int | None = None
    """Error code with which the device answers the next TX or BX; None for a normal reply."""

    freeze: bool = False
    """Whether the same frame is sent repeatedly."""

    system_status: int = 0
    """System status word in the frames."""

    delay_s: float = 0.0
    """Additional delay (s) of each reply over an AuroraLink."""

    mute: bool = False
    """Whether no replies are sent."""

    ignore_speed: bool = False
    """Whether the device acknowledges COMM without changing its speed."""


@dataclass
class AuroraDevice(CallRepr):
    """The simulated Aurora with its tools; `commands` lists the received commands.

    Frame numbers come from the function `count`, or from `clock` and `rate_hz` if `count` is None.
    """

    tools: Sequence[SimulatedTool]
    clock: Clock = field(default_factory=SystemClock)
    rate_hz: float = 40.0
    first_frame: int = 1
    baud: int = 9600
    tracking: bool = False
    count: Callable[[], int] | None = None
    faults: AuroraFaults = field(default_factory=AuroraFaults)
    commands: list[str] = field(default_factory=list)
    _input: bytearray = field(default_factory=bytearray)
    _began_ns: int = 0
    _frame: int = 0

    def answer(self, data: bytes) -> bytes:
        """Receive bytes, and return the replies to all commands that are now complete; b"" if there are none."""
        self._input += data
        replies = b""
        while (end := self._input.find(b"\r")) >= 0:
            line = bytes(self._input[:end])
            del self._input[: end + 1]
            replies += self._through_faults(self._reply(line))
        if len(self._input) > _LONGEST_COMMAND:
            self._input.clear()
            replies += encode_text("ERROR02")
        return replies

    def reset(self) -> bytes:
        """Restart the device, as after a serial break or a power dip; return the message that it then sends."""
        self.tracking, self.baud = False, 9600
        self._input.clear()
        for tool in self.tools:
            tool.initialised = tool.enabled = False
        return encode_text("RESET")

    def _reply(self, line: bytes) -> bytes:
        try:
            name, arguments = decode_command(line)
        except ProtocolError:
            return encode_text("ERROR04" if b":" in line else "ERROR01")
        self.commands.append(f"{name}:{arguments}")
        if name in ("TX", "BX"):
            return self._frames(name)
        ask: Callable[[str], str] | None = {
            "INIT": self._initialise, "COMM": self._speed, "PHSR": self._handles, "PHF": self._free,
            "PINIT": self._initialise_tool, "PENA": self._enable, "PHINF": self._information, "TSTART": self._start,
            "TSTOP": self._stop, "VER": self._version,
        }.get(name)  # fmt: skip
        return encode_text("ERROR01" if ask is None else ask(arguments))

    def _version(self, _: str) -> str:
        return "needleplan simulated Aurora"

    def _initialise(self, _: str) -> str:
        if self.tracking:
            return "ERROR0C"
        for tool in self.tools:
            tool.initialised = tool.enabled = False
        return "OKAY"

    def _speed(self, arguments: str) -> str:
        if len(arguments) != 5 or arguments[0] not in _SPEEDS:
            return "ERROR06"
        if not self.faults.ignore_speed:
            self.baud = _SPEEDS[arguments[0]]
        return "OKAY"

    def _handles(self, which: str) -> str:
        choose: dict[str, Callable[[SimulatedTool], bool]] = {
            "": lambda _: True, "00": lambda _: True, "01": lambda _: False, "02": lambda tool: not tool.initialised,
            "03": lambda tool: tool.initialised and not tool.enabled, "04": lambda tool: tool.enabled,
        }  # fmt: skip
        if which not in choose:
            return "ERROR23"
        chosen = [
            tool for tool in self.tools if tool.visibility is not NdiVisibility.UNOCCUPIED and choose[which](tool)
        ]
        return f"{len(chosen):02X}" + "".join(f"{tool.handle:02X}{tool.port_status & 0xFFF:03X}" for tool in chosen)

    def _named(self, arguments: str) -> SimulatedTool | None:
        return next((tool for tool in self.tools if f"{tool.handle:02X}" == arguments[:2]), None)

    def _free(self, arguments: str) -> str:
        return "ERROR08" if self._named(arguments) is None else "OKAY"

    def _initialise_tool(self, arguments: str) -> str:
        tool = self._named(arguments)
        if tool is None:
            return "ERROR08"
        tool.initialised = True
        return "OKAY"

    def _enable(self, arguments: str) -> str:
        tool = self._named(arguments)
        if tool is None or arguments[2:] not in ("D", "S", "B"):
            return "ERROR08" if tool is None else "ERROR23"
        if not tool.initialised:
            return "ERROR0E"
        tool.enabled = True
        return "OKAY"

    def _information(self, arguments: str) -> str:
        tool = self._named(arguments)
        if tool is None:
            return "ERROR08"
        return f"{'02000000':8}{'NDI':12}{'001':3}{tool.serial:8.8}{tool.port_status & 0xFF:02X}"

    def _start(self, _: str) -> str:
        self.tracking, self._began_ns = True, self.clock.now_ns()
        return "OKAY"

    def _stop(self, _: str) -> str:
        self.tracking = False
        return "OKAY"

    def _frames(self, name: str) -> bytes:
        if not self.tracking:
            return encode_text("ERROR0C")
        if self.faults.error is not None:
            error, self.faults.error = self.faults.error, None
            return encode_text(f"ERROR{error:02X}")
        if self.count is not None:
            self._frame = self.count()
        elif not self.faults.freeze:
            self._frame = int((self.clock.now_ns() - self._began_ns) / 1e9 * self.rate_hz + 1e-6)
        number = (self.first_frame + self._frame) % (1 << 32)
        frames = Frames(
            tuple(self._where(tool, number) for tool in self.tools if tool.enabled), self.faults.system_status
        )
        return encode_bx(frames) if name == "BX" else encode_text(encode_tx(frames))

    def _where(self, tool: SimulatedTool, number: int) -> ToolFrame:
        status = tool.port_status
        if tool.visibility is not NdiVisibility.VALID:
            return ToolFrame(tool.handle, tool.visibility, port_status=status, frame=number)
        quaternion, position_mm = tool.pose(self._frame / self.rate_hz)
        return ToolFrame(tool.handle, tool.visibility, quaternion, position_mm, tool.error_mm, status, number)

    def _through_faults(self, reply: bytes) -> bytes:
        faults = self.faults
        if faults.mute:
            return b""
        before, faults.noise_before = faults.noise_before, b""
        if faults.damage:
            faults.damage -= 1
            middle = len(reply) // 2
            reply = reply[:middle] + bytes([reply[middle] ^ 0x04]) + reply[middle + 1 :]
        if faults.cut:
            faults.cut -= 1
            reply = reply[: len(reply) // 2]
        return before + reply
