"""Simulated CiA-402 drives on a CAN bus of python-can, with selectable faults.

Each drive is a `canopen` node with the object dictionary of CiA 402, a motor without load, and a heartbeat watchdog.
"""

from __future__ import annotations

import math
import struct
import threading
from dataclasses import dataclass, field
from typing import Any

from needleplan.artifacts import CallRepr
from needleplan.devices._base import Closing
from needleplan.devices._clock import Clock, SystemClock
from needleplan.devices.cia402._drive import CanBus, library
from needleplan.devices.cia402._motor import Motor
from needleplan.devices.cia402.objects import AbortOption, Bit, Cia402Entry, Cia402State, Control, Service
from needleplan.devices.cia402.setup import AxisSetup, DrivesSetup

__all__ = ["Cia402DriveFaults", "SimulatedDrive", "SimulatedDrives", "object_dictionary"]

_TYPES = {"<B": 0x05, "<H": 0x06, "<I": 0x07, "<b": 0x02, "<h": 0x03, "<i": 0x04}


def object_dictionary() -> Any:
    """Return a `canopen` object dictionary with all entries of `Cia402Entry`, readable and writable."""
    parts = library("canopen.objectdictionary")
    dictionary = library().ObjectDictionary()
    records: dict[int, Any] = {}
    for entry in Cia402Entry:
        variable = parts.ODVariable(entry.name, entry.index, entry.subindex)
        variable.data_type, variable.access_type, variable.default = _TYPES[entry.value[2]], "rw", 0
        if entry.subindex == 0 and not any(other.index == entry.index and other.subindex for other in Cia402Entry):
            dictionary.add_object(variable)
            continue
        if entry.index not in records:
            records[entry.index] = parts.ODRecord(f"record {entry.index:04X}", entry.index)
            dictionary.add_object(records[entry.index])
        records[entry.index].add_member(variable)
    return dictionary


_EMERGENCY = struct.Struct("<HB5s")
_WORDS = {
    Cia402State.SWITCH_ON_DISABLED: 0x40, Cia402State.READY: 0x21, Cia402State.SWITCHED_ON: 0x23,
    Cia402State.ENABLED: 0x27, Cia402State.QUICK_STOP: 0x07, Cia402State.FAULT: 0x08,
}  # fmt: skip
_PRE_OPERATIONAL = 128


@dataclass
class Cia402DriveFaults(CallRepr):
    """Faults that the simulated drive shows from now on."""

    mute: bool = False
    """Whether the drive sends nothing and executes no commands."""

    deaf: bool = False
    """Whether the drive ignores SDO requests."""

    refuse: dict[Cia402Entry, int] = field(default_factory=dict)
    """Entries that cannot be written, each with the SDO abort code that the drive answers."""

    ignore: set[Cia402Entry] = field(default_factory=set)
    """Entries for which the drive acknowledges a write request but keeps the old value."""

    stuck: bool = False
    """Whether the motor stands still although the drive accepts motions."""

    backwards: bool = False
    """Whether the encoder counts in the wrong direction."""

    limit: bool = False
    """Whether the statusword reports an active limit."""

    following: bool = False
    """Whether the statusword reports a following error."""

    torque_off: bool = False
    """Whether the safe torque off (STO) is active, so that the drive cannot be enabled."""


_ENTRIES = {(entry.index, entry.subindex): entry for entry in Cia402Entry}


class SimulatedDrive:
    """One simulated drive at the node number of `setup`; the owner must call `tick` regularly."""

    bus: CanBus
    setup: AxisSetup
    clock: Clock

    def __init__(self, bus: CanBus, setup: AxisSetup) -> None:
        self.bus, self.setup, self.clock = bus, setup, bus.clock
        self.faults: Cia402DriveFaults = Cia402DriveFaults()
        self.state: Cia402State = Cia402State.SWITCH_ON_DISABLED
        self.motor: Motor = Motor(setup, setup.zero_counts, self.clock.now_ns())
        self.stopped_after_s: float | None = None
        """Time without a heartbeat after which the drive stopped by itself, or None."""

        self._lock = threading.RLock()
        self._values = dict.fromkeys(Cia402Entry, 0)
        self._values[Cia402Entry.ABORT_CONNECTION] = AbortOption.FAULT
        self._acknowledged = False
        self._error = (0, 0)
        self._heartbeat_ns: int | None = None
        self._sent_ns = 0
        canopen = library()
        self._abort = library("canopen.sdo.exceptions").SdoAbortedError
        self._node = canopen.LocalNode(setup.node, object_dictionary())
        # Remove the library's own heartbeat thread, which would continue in spite of the fault `mute`.
        self._node._write_callbacks.remove(self._node.nmt.on_write)
        self._node.add_read_callback(self._read)
        self._node.add_write_callback(self._write)
        network = bus.network
        network.add_node(self._node)
        network.unsubscribe(self._node.sdo.rx_cobid)
        for identifier, take in (
            (self._node.sdo.rx_cobid, self._question), (0x80, self._sync),
            (Service.CONTROL + setup.node, self._control),
        ):  # fmt: skip
            network.subscribe(identifier, take)
        self._masters: set[int] = set()

    @property
    def position(self) -> float:
        """Present position of the axis, mm or rad."""
        with self._lock:
            self.motor.advance(self.clock.now_ns())
            return self.setup.position(round(self.motor.counts))

    @property
    def at_rest(self) -> bool:
        """Whether the motor stands still."""
        with self._lock:
            self.motor.advance(self.clock.now_ns())
            return self.motor.speed == 0

    def trip(self, code: int, register: int = 0x81) -> None:
        """Stop the motor, change to FAULT and send an emergency message with `code` and `register`."""
        with self._lock:
            self.motor.halt(self.clock.now_ns(), quick=True)
            self.state, self._error = Cia402State.FAULT, (code, register)
        self._send(Service.EMERGENCY, _EMERGENCY.pack(code, register, bytes(5)))

    def press_stop(self) -> None:
        """Activate the safe torque off, as an emergency stop does: the motor stops without a fault of the drive."""
        with self._lock:
            self.faults.torque_off = True
            self._unpowered()

    def release_stop(self) -> None:
        """Deactivate the safe torque off; the drive stays disabled."""
        self.faults.torque_off = False

    def jump(self, distance: float) -> None:
        """Change the measured position at once by `distance`, mm or rad."""
        with self._lock:
            self.motor.counts += distance * self.setup.counts_per_unit

    def restart(self) -> None:
        """Restart the drive, as after a power dip: it is disabled and sends a boot-up message."""
        with self._lock:
            self._unpowered()
            self._heartbeat_ns = None
        self._node.nmt.on_command(0, bytes([_PRE_OPERATIONAL, self.setup.node]), 0.0)
        self._send(Service.HEARTBEAT, b"\0")

    def tick(self) -> None:
        """Advance the motor, react to a missing heartbeat of the controller, and send a heartbeat if it is due."""
        now_ns = self.clock.now_ns()
        with self._lock:
            self.motor.advance(now_ns)
            limit_ns = (self._values[Cia402Entry.CONSUMER_HEARTBEAT] & 0xFFFF) * 1_000_000
            late_ns = now_ns - self._heartbeat_ns if self._heartbeat_ns is not None and limit_ns else 0
            late = late_ns > limit_ns > 0
            if late:
                self._heartbeat_ns = None
                self._abandoned(late_ns / 1e9)
            period_ns = self._values[Cia402Entry.PRODUCER_HEARTBEAT] * 1_000_000
            due = bool(period_ns) and now_ns - self._sent_ns >= period_ns
            if due:
                self._sent_ns = now_ns
        if late:
            self._send(Service.EMERGENCY, _EMERGENCY.pack(0x8130, 0x11, bytes(5)))
        if due:
            self._send(Service.HEARTBEAT, bytes([self._node.nmt._state]))

    def _abandoned(self, late_s: float) -> None:
        """React to a heartbeat that is missing for `late_s`, as entry 0x6007 (abort connection option) prescribes."""
        option = self._values[Cia402Entry.ABORT_CONNECTION]
        if self.state is not Cia402State.ENABLED or option == AbortOption.NOTHING:
            return
        self.stopped_after_s = late_s
        if option == AbortOption.QUICK_STOP:
            self._quick_stop()
        elif option == AbortOption.FAULT:
            self.state, self._error = Cia402State.FAULT, (0x8130, 0x11)
            self.motor.halt(self.clock.now_ns(), quick=True)
        else:
            self._unpowered()

    def _quick_stop(self) -> None:
        self.state = Cia402State.QUICK_STOP
        self.motor.halt(self.clock.now_ns(), quick=True)

    def _unpowered(self) -> None:
        self.state = Cia402State.SWITCH_ON_DISABLED
        self.motor.halt(self.clock.now_ns(), quick=True)

    def _send(self, service: Service, data: bytes) -> None:
        if not self.faults.mute:
            self.bus.send(service + self.setup.node, data)

    def _question(self, identifier: int, data: bytearray, timestamp: float) -> None:
        if not (self.faults.mute or self.faults.deaf):
            self._node.sdo.on_request(identifier, data, timestamp)

    def _control(self, _identifier: int, data: bytearray, _timestamp: float) -> None:
        if self._operational and self._values[Cia402Entry.RPDO1_COUNT] and not self.faults.mute:
            with self._lock:
                self._command(int.from_bytes(data[:2], "little"))

    def _take_heartbeat(self, _identifier: int, _data: bytearray, _timestamp: float) -> None:
        self._heartbeat_ns = self.clock.now_ns()

    def _sync(self, _identifier: int, _data: bytearray, _timestamp: float) -> None:
        if not self._operational:
            return
        with self._lock:
            self.motor.advance(self.clock.now_ns())
            status = Cia402Entry.STATUSWORD.packing.pack(self._shown(Cia402Entry.STATUSWORD))
            status += Cia402Entry.POSITION.packing.pack(self._shown(Cia402Entry.POSITION))
            velocity = Cia402Entry.VELOCITY.packing.pack(self._shown(Cia402Entry.VELOCITY))
        for service, count, data in (
            (Service.STATUS, Cia402Entry.TPDO1_COUNT, status), (Service.VELOCITY, Cia402Entry.TPDO2_COUNT, velocity),
        ):  # fmt: skip
            if self._values[count]:
                self._send(service, data)

    @property
    def _operational(self) -> bool:
        return bool(self._node.nmt.state == "OPERATIONAL")

    def _read(self, *, index: int, subindex: int, od: Any) -> int | None:
        del od
        entry = _ENTRIES.get((index, subindex))
        if entry is None:
            return None
        with self._lock:
            self.motor.advance(self.clock.now_ns())
            return self._shown(entry)

    def _shown(self, entry: Cia402Entry) -> int:
        if entry is Cia402Entry.STATUSWORD:
            word = _WORDS[self.state]
            word |= Bit.TARGET_REACHED if self.motor.arrived else 0
            word |= Bit.ACKNOWLEDGED if self._acknowledged else 0
            word |= Bit.LIMIT if self.faults.limit else 0
            return word | (Bit.FOLLOWING_ERROR if self.faults.following else 0)
        if entry is Cia402Entry.POSITION:
            return round(self.motor.shown(self.faults.backwards))
        if entry is Cia402Entry.VELOCITY:
            return round(
                math.copysign(self.setup.speed(self.motor.speed / self.setup.counts_per_unit), self.motor.speed)
            )
        if entry is Cia402Entry.MODE_SHOWN:
            return self._values[Cia402Entry.MODE]
        if entry is Cia402Entry.ERROR_CODE:
            return self._error[0]
        if entry is Cia402Entry.ERROR_REGISTER:
            return self._error[1]
        return self._values[entry]

    def _write(self, *, index: int, subindex: int, od: Any, data: bytes) -> None:
        del od
        entry = _ENTRIES.get((index, subindex))
        if entry is None:
            return
        value = int(entry.packing.unpack(data)[0])
        if entry in self.faults.refuse:
            raise self._abort(self.faults.refuse[entry])
        if entry in self.faults.ignore:
            return
        with self._lock:
            self._values[entry] = value
            if entry is Cia402Entry.CONTROLWORD:
                self._command(value)
        if entry is Cia402Entry.CONSUMER_HEARTBEAT and (master := value >> 16 & 0x7F) not in self._masters:
            self._masters.add(master)
            self.bus.network.subscribe(Service.HEARTBEAT + master, self._take_heartbeat)

    def _command(self, word: int) -> None:
        """Execute a controlword: change the state, and begin a motion at the rising edge of bit 4."""
        state, off = self.state, self.faults.torque_off
        if word & Control.RESET_FAULT:
            if state is Cia402State.FAULT:
                self.state, self._error = Cia402State.SWITCH_ON_DISABLED, (0, 0)
        elif state is Cia402State.FAULT:
            pass
        elif not word & 0x02:
            self._unpowered()
        elif not word & 0x04:
            if state is Cia402State.ENABLED:
                self._quick_stop()
            elif state is not Cia402State.QUICK_STOP:
                self._unpowered()
        elif word & 0x0F == Control.SHUTDOWN and not off:
            self.state = Cia402State.READY
        elif word & 0x0F == Control.SWITCH_ON and state is Cia402State.READY:
            self.state = Cia402State.SWITCHED_ON
        elif word & 0x0F == Control.ENABLE and state in (Cia402State.SWITCHED_ON, Cia402State.QUICK_STOP) and not off:
            self.state = Cia402State.ENABLED
        rises = bool(word & 0x10) and not self._acknowledged
        if rises and self.state is Cia402State.ENABLED and self._values[Cia402Entry.MODE] == 1:
            self._begin()
        self._acknowledged = bool(word & 0x10) and self.state is Cia402State.ENABLED

    def _begin(self) -> None:
        target = min(
            max(self._values[Cia402Entry.TARGET_POSITION], self._values[Cia402Entry.LEAST_POSITION]),
            self._values[Cia402Entry.MOST_POSITION],
        )
        speed = min(self._values[Cia402Entry.PROFILE_VELOCITY], self._values[Cia402Entry.FASTEST])
        fastest = abs(self.setup.velocity(speed) * self.setup.counts_per_unit)
        self.motor.begin(self.clock.now_ns(), target, fastest, stuck=self.faults.stuck)


_TICK_S = 0.002  # interval (s) between two ticks of the simulated drives


class SimulatedDrives(Closing):
    """Two simulated drives on a CAN bus, by default a virtual bus within this process; they run in their own thread."""

    channel: str
    interface: str

    def __init__(
        self, setup: DrivesSetup, channel: str, interface: str = "virtual", clock: Clock | None = None
    ) -> None:
        self.channel, self.interface = channel, interface
        self.bus: CanBus = CanBus(channel, interface, SystemClock() if clock is None else clock)
        self.insertion: SimulatedDrive = SimulatedDrive(self.bus, setup.insertion)
        self.roll: SimulatedDrive = SimulatedDrive(self.bus, setup.roll)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address of the bus; a client appends the option `setup` with the path of its setup file."""
        return f"canopen://{self.channel}?interface={self.interface}"

    def close(self) -> None:
        """End the simulation thread and disconnect from the bus; the drives are not stopped first."""
        if not self._stopping.is_set():
            self._stopping.set()
            self._thread.join()
            self.bus.close()

    def _run(self) -> None:
        while not self._stopping.wait(_TICK_S):
            for drive in (self.insertion, self.roll):
                drive.tick()
