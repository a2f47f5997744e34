"""A CAN bus, accessed by the optional library `canopen`, and one CiA-402 drive on the bus."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from needleplan.devices._base import Closing
from needleplan.devices._clock import Clock, Deadline
from needleplan.devices.cia402.objects import AbortOption, Bit, Cia402State, Control, Service, state_of
from needleplan.devices.cia402.objects import Cia402Entry as Entry
from needleplan.devices.cia402.setup import AxisSetup
from needleplan.errors import ConfigurationError, DeviceFault, LinkClosed, Mistake

if TYPE_CHECKING:
    from canopen import Network

__all__ = ["CanBus", "Cia402Drive", "Frame", "library"]

_SYNC = 0x80  # identifier of the SYNC message
_CYCLE_S = 0.02  # time (s) after which the receiving thread of the library notices that the bus is to be closed


@dataclass(frozen=True)
class Frame:
    """A received frame that is not the answer to an SDO request."""

    node: int
    service: Service
    data: bytes
    received_ns: int


def library(name: str = "canopen") -> Any:
    """Return the module `name`: `canopen`, a submodule, or `can`. Raises ConfigurationError if it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        rule = "needs the library canopen: install it with `pip install needleplan[canopen]`"
        raise ConfigurationError(Mistake("canopen", "", rule)) from error


class CanBus(Closing):
    """An open CAN bus.

    Raises ConfigurationError if `canopen` is not installed, DeviceFault if the bus cannot be opened.
    """

    def __init__(self, channel: str, interface: str, clock: Clock, **options: Any) -> None:
        canopen = library()
        self._errors: tuple[type[Exception], ...] = (library("can").CanError, OSError, RuntimeError)
        self.name: str = f"canopen://{channel}"
        self.clock = clock
        self.network: Network = canopen.Network()
        self.network.NOTIFIER_CYCLE = _CYCLE_S  # `close` takes at most this time
        self.frames: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self._closed = False
        try:
            self.network.connect(channel=channel, interface=interface, **options)
        except (*self._errors, ValueError, NotImplementedError, ImportError) as error:
            raise DeviceFault(f"{self.name} cannot be opened by {interface}: {error}") from error

    def listen(self, node: int, *services: Service) -> None:
        """From now on, put the frames that `node` sends for `services` into the queue `frames`."""
        for service in services:
            self.network.subscribe(service + node, self._put(node, service))

    def _put(self, node: int, service: Service) -> Callable[[int, bytearray, float], None]:
        def put(_identifier: int, data: bytearray, _timestamp: float) -> None:
            self.frames.put(Frame(node, service, bytes(data), self.clock.now_ns()))

        return put

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame. Raises LinkClosed if the bus is closed, disconnected, or off because of too many errors."""
        if self._closed:
            raise LinkClosed(f"{self.name} is closed")
        try:
            self.network.send_message(identifier, data)
        except self._errors as error:
            raise LinkClosed(f"{self.name}: {error}") from error

    def sync(self) -> None:
        """Send SYNC, which requests the positions and velocities of all drives."""
        self.send(_SYNC, b"")

    def close(self) -> None:
        """Disconnect from the bus."""
        if not self._closed:
            self._closed = True
            # If the bus is disconnected, the library raises only after it has released all resources.
            with contextlib.suppress(*self._errors):
                self.network.disconnect()


_PROFILE_POSITION = 1  # mode of operation: move to a target position with a trapezoidal velocity
_STOP_AND_STAY = 6  # quick stop option: decelerate, then stay in QUICK STOP ACTIVE

_EVERY_SYNC, _AT_ONCE = 1, 255  # transmission types of a PDO: at every SYNC; as soon as it is received
_OFF = 1 << 31  # bit of a COB-ID entry that disables the PDO
_POLL_S = 0.002  # pause (s) between two requests of the statusword
# Command that leads from each state towards OPERATION ENABLED
_NEXT = {
    Cia402State.SWITCH_ON_DISABLED: Control.SHUTDOWN,
    Cia402State.READY: Control.SWITCH_ON,
    Cia402State.SWITCHED_ON: Control.ENABLE,
    Cia402State.QUICK_STOP: Control.ENABLE,
}


class Cia402Drive:
    """The drive of one axis. Each method but `quick_stop` waits for the answers of the drive.

    Each method raises DeviceFault if the drive does not answer or the bus cannot be used. `heartbeat` is called before
    each request, so that the watchdog of the other drive does not expire during the wait.
    """

    def __init__(
        self, bus: CanBus, setup: AxisSetup, answer_s: float, change_s: float, heartbeat: Callable[[], None]
    ) -> None:
        self.bus = bus
        self.setup = setup
        self.change_s = change_s
        self._heartbeat = heartbeat
        canopen = library()
        self._node = bus.network.add_node(canopen.RemoteNode(setup.node, canopen.ObjectDictionary()))
        self._node.sdo.RESPONSE_TIMEOUT = answer_s
        self._sdo_error: type[Exception] = library("canopen.sdo.exceptions").SdoError
        bus.listen(setup.node, Service.EMERGENCY, Service.STATUS, Service.VELOCITY, Service.HEARTBEAT)

    @property
    def name(self) -> str:
        """Name of the drive in messages: axis and node number."""
        return f"{self.setup.name} drive (node {self.setup.node})"

    def write(self, entry: Entry, value: int) -> None:
        """Write `value` to an entry of the object dictionary and wait for the acknowledgement."""
        self._ask(entry, "write", lambda: self._node.sdo.download(*entry.value[:2], entry.packing.pack(value)))

    def read(self, entry: Entry) -> int:
        """Request an entry of the object dictionary and return its value.

        Raises DeviceFault also if the value has a wrong size.
        """
        data = self._ask(entry, "read", lambda: self._node.sdo.upload(*entry.value[:2]))
        if len(data) != entry.packing.size:
            raise DeviceFault(
                f"{self.name}: {entry} has {len(data)} bytes instead of {entry.packing.size}: is it a CiA-402 drive?"
            )
        return int(entry.packing.unpack(data)[0])

    @property
    def state(self) -> Cia402State | None:
        """State of the drive; each access requests the statusword. None if the statusword encodes no state."""
        return state_of(self.read(Entry.STATUSWORD))

    def configure(self, master: int, silence_s: float, heartbeat_s: float) -> None:
        """Disable the drive and write its mode, limits, PDOs and heartbeats.

        The drive will stop if it receives no heartbeat of the node `master` for `silence_s`, and will send heartbeats
        every `heartbeat_s`. Raises DeviceFault if the drive rejects or ignores a setting, because a drive without a
        working watchdog must not be enabled.
        """
        setup, limits, node = self.setup, self.setup.limits, self.setup.node
        self._node.nmt.state = "PRE-OPERATIONAL"
        self.write(Entry.CONTROLWORD, Control.DISABLE_VOLTAGE)
        acceleration, stop = (max(setup.speed(each), 1) for each in (limits.acceleration, limits.stop))
        ends = sorted(map(setup.counts, (limits.least, limits.most)))
        for entry, value in (
            (Entry.MODE, _PROFILE_POSITION), (Entry.ABORT_CONNECTION, AbortOption.QUICK_STOP),
            (Entry.QUICK_STOP, _STOP_AND_STAY), (Entry.LEAST_POSITION, ends[0]), (Entry.MOST_POSITION, ends[1]),
            (Entry.FASTEST, setup.speed(limits.fastest)), (Entry.ACCELERATION, acceleration),
            (Entry.DECELERATION, acceleration), (Entry.QUICK_DECELERATION, stop),
            (Entry.FOLLOWING_WINDOW, max(round(abs(limits.margin * setup.counts_per_unit)), 1)),
            (Entry.PRODUCER_HEARTBEAT, round(heartbeat_s * 1000)),
            (Entry.CONSUMER_HEARTBEAT, master << 16 | round(silence_s * 1000)),
            (Entry.RPDO1_COB, _OFF | Service.CONTROL + node), (Entry.RPDO1_TYPE, _AT_ONCE), (Entry.RPDO1_COUNT, 0),
            (Entry.RPDO1_FIRST, Entry.CONTROLWORD.mapping), (Entry.RPDO1_COUNT, 1),
            (Entry.RPDO1_COB, Service.CONTROL + node),
            (Entry.TPDO1_COB, _OFF | Service.STATUS + node), (Entry.TPDO1_TYPE, _EVERY_SYNC), (Entry.TPDO1_COUNT, 0),
            (Entry.TPDO1_FIRST, Entry.STATUSWORD.mapping), (Entry.TPDO1_SECOND, Entry.POSITION.mapping),
            (Entry.TPDO1_COUNT, 2), (Entry.TPDO1_COB, Service.STATUS + node),
            (Entry.TPDO2_COB, _OFF | Service.VELOCITY + node), (Entry.TPDO2_TYPE, _EVERY_SYNC),
            (Entry.TPDO2_COUNT, 0), (Entry.TPDO2_FIRST, Entry.VELOCITY.mapping), (Entry.TPDO2_COUNT, 1),
            (Entry.TPDO2_COB, Service.VELOCITY + node),
        ):  # fmt: skip
            self.write(entry, value)
        for entry, expected in (
            (Entry.ABORT_CONNECTION, AbortOption.QUICK_STOP), (Entry.MODE_SHOWN, _PROFILE_POSITION),
            (Entry.CONSUMER_HEARTBEAT, master << 16 | round(silence_s * 1000)),
        ):  # fmt: skip
            stored = self.read(entry)
            if stored != expected:
                raise DeviceFault(f"{self.name}: {entry} is {stored} after {expected} was written")
        self._node.nmt.state = "OPERATIONAL"

    def reset_fault(self) -> None:
        """Disable the drive and reset its fault, if any. Raises DeviceFault if the fault persists."""
        self.write(Entry.CONTROLWORD, Control.DISABLE_VOLTAGE)
        if self.state not in (Cia402State.FAULT, Cia402State.FAULT_REACTION):
            return
        self.write(Entry.CONTROLWORD, Control.RESET_FAULT)
        deadline = Deadline(self.bus.clock, self.change_s)
        while self.state in (Cia402State.FAULT, Cia402State.FAULT_REACTION):
            if deadline.passed:
                raise DeviceFault(f"{self.name}: the fault stays: {self.cause()}")
            self.bus.clock.sleep(_POLL_S)
        self.write(Entry.CONTROLWORD, Control.DISABLE_VOLTAGE)

    def enable(self) -> None:
        """Bring the drive to OPERATION ENABLED, with the present position as its target, so that nothing moves.

        Raises DeviceFault if the drive is in FAULT or does not reach the state within `change_s`.
        """
        self.write(Entry.TARGET_POSITION, self.read(Entry.POSITION))
        deadline = Deadline(self.bus.clock, self.change_s)
        while (state := self.state) is not Cia402State.ENABLED:
            if state is Cia402State.FAULT:
                raise DeviceFault(f"{self.name}: FAULT instead of OPERATION ENABLED: {self.cause()}")
            if deadline.passed:
                raise DeviceFault(f"{self.name}: stays in {state}: is power or enable missing (STO, emergency stop)?")
            if state in _NEXT:
                self.write(Entry.CONTROLWORD, _NEXT[state])
            else:
                self.bus.clock.sleep(_POLL_S)

    def move(self, position: float, velocity: float) -> None:
        """Begin a motion to `position`, which replaces the present motion; wait until the drive accepts the target.

        Raises DeviceFault if the drive leaves OPERATION ENABLED or does not accept the target within `change_s`.
        """
        self.write(Entry.TARGET_POSITION, self.setup.counts(position))
        self.write(Entry.PROFILE_VELOCITY, self.setup.speed(velocity))
        # The rising edge of controlword bit 4 starts the motion; the drive acknowledges it by statusword bit 12.
        self.write(Entry.CONTROLWORD, Control.ENABLE)
        self._until(acknowledged=False)
        self.write(Entry.CONTROLWORD, Control.NEW_TARGET_NOW)
        self._until(acknowledged=True)
        self.write(Entry.CONTROLWORD, Control.ENABLE)

    def quick_stop(self) -> None:
        """Send the quick stop without waiting for an answer."""
        self.bus.send(Service.CONTROL + self.setup.node, Entry.CONTROLWORD.packing.pack(Control.QUICK_STOP))

    def confirm_stop(self) -> None:
        """Send the quick stop again and wait for its acknowledgement."""
        self.write(Entry.CONTROLWORD, Control.QUICK_STOP)

    def disable(self) -> None:
        """Switch off the power stage of the drive (controlword DISABLE VOLTAGE)."""
        self.write(Entry.CONTROLWORD, Control.DISABLE_VOLTAGE)

    def cause(self) -> str:
        """Request the error code and the error register, and return them as text."""
        code, register = self.read(Entry.ERROR_CODE), self.read(Entry.ERROR_REGISTER)
        return f"error 0x{code:04X}, register 0x{register:02X}"

    def _until(self, acknowledged: bool) -> None:
        deadline = Deadline(self.bus.clock, self.change_s)
        while True:
            word = self.read(Entry.STATUSWORD)
            if state_of(word) is not Cia402State.ENABLED:
                raise DeviceFault(f"{self.name}: left OPERATION ENABLED for {state_of(word)} as a motion was to begin")
            if bool(word & Bit.ACKNOWLEDGED) == acknowledged:
                return
            if deadline.passed:
                raise DeviceFault(f"{self.name}: does not accept a new target")
            self.bus.clock.sleep(_POLL_S)

    def _ask(self, entry: Entry, request: str, ask: Any) -> Any:
        self._heartbeat()
        try:
            return ask()
        except self._sdo_error as error:
            raise DeviceFault(f"{self.name}: {request} {entry}: {error}") from error
        except (OSError, RuntimeError, library("can").CanError) as error:
            raise DeviceFault(f"{self.name}: {request} {entry}: the bus cannot be used: {error}") from error
