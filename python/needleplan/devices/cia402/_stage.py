"""Stage with two CiA-402 drives on a CAN bus: one inserts the needle, the other rotates it.

Motions use the profile position mode, in which a drive stops by itself at its target even if the controller fails. In a
cyclic velocity mode the drive would move on until its heartbeat watchdog expires.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from dataclasses import replace

from needleplan.config import Integer, Number
from needleplan.devices._base import Stage, StageSample
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._opening import Address
from needleplan.devices.cia402._axes import Cia402Axis, DriveTiming, Rounds
from needleplan.devices.cia402._drive import CanBus, Cia402Drive, Frame
from needleplan.devices.cia402.objects import Cia402Entry, Service, decode_emergency
from needleplan.devices.cia402.setup import DrivesSetup
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["CanopenStage"]

_OPERATIONAL = 5  # NMT state OPERATIONAL in a heartbeat message
_NANO = 1_000_000_000


class CanopenStage(Stage):
    """Stage that commands two drives on `bus`; `node` is the node number of this controller.

    A command also sends heartbeats before its requests, because it may last longer than the watchdog time of the other
    drive. `read` sends no heartbeat, so that the drives also stop if the control loop fails while another thread
    continues to read. The constructor calls `start` and raises its errors.
    """

    setup: DrivesSetup

    def __init__(self, bus: CanBus, setup: DrivesSetup, *, node: int = 127, timing: DriveTiming | None = None) -> None:
        self.timing: DriveTiming = DriveTiming() if timing is None else timing
        self.setup, self._node = setup, node
        self._bus, self._clock = bus, bus.clock
        self._lock = threading.RLock()
        self._fault: DeviceFault | None = None
        self._closed = self._running = False
        self._beat_ns = 0
        self._drives: list[Cia402Drive] = []
        self._axes: list[Cia402Axis] = []
        with self.closed_if_failing():
            for axis in (setup.insertion, setup.roll):
                drive = Cia402Drive(bus, axis, self.timing.answer_s, self.timing.change_s, self._beat)
                self._drives.append(drive)
                self._axes.append(Cia402Axis(axis, drive.name, self.timing.slack_s))
            self._rounds = Rounds(bus, self._axes, self.timing)
            self.start()

    @classmethod
    def open(cls, address: str, *, timing: DriveTiming | None = None, clock: Clock | None = None) -> CanopenStage:
        """Open `canopen://can0?setup=drives.toml` and enable both drives.

        The options are:

        - `setup`: path of the setup file of both drives; required.
        - `interface`: interface of python-can, by default `socketcan`.
        - `bitrate`: bit rate of the bus (bit/s), by default that of the interface.
        - `node`: node number of this controller, by default 127.
        - `watchdog_s`: time without a heartbeat after which a drive stops, by default that of `timing` (0.04 s).

        Raises AddressError if the address is wrong, ConfigurationError if the setup is wrong or `canopen` is not
        installed, and DeviceFault if the bus or a drive cannot be used.
        """
        parsed = Address.parse(address)
        if parsed.scheme != "canopen" or not parsed.host or parsed.port is not None or parsed.path not in ("", "/"):
            raise AddressError(Mistake("address", address, "must name a bus, as in canopen://can0?setup=drives.toml"))
        parsed.only(("setup", "interface", "bitrate", "node", "watchdog_s"))
        if "setup" not in parsed.options:
            raise AddressError(Mistake("setup", "", "is missing: a TOML file with [insertion] and [roll]"), address)
        node = parsed.option("node", Integer(1, 127), 127)
        bitrate = parsed.option("bitrate", Integer(0, 1_000_000), 0)
        usual = DriveTiming() if timing is None else timing
        watchdog_s = parsed.option("watchdog_s", Number("s", at_least=0.02, at_most=60), usual.watchdog_s)
        setup = DrivesSetup.read(parsed.options["setup"])
        if node in (setup.insertion.node, setup.roll.node):
            raise AddressError(Mistake("node", str(node), "must differ from the node numbers of the drives"), address)
        interface = parsed.options.get("interface", "socketcan")
        options = {"bitrate": bitrate} if bitrate else {}
        bus = CanBus(parsed.host, interface, SystemClock() if clock is None else clock, **options)
        asked = replace(usual, watchdog_s=watchdog_s)
        return cls(bus, setup, node=node, timing=asked)

    def start(self) -> None:
        """Configure both drives, reset faults if their causes are gone, and enable the drives; nothing moves.

        The constructor calls `start`. After a fault, only a person may decide to call it again. Raises DeviceFault if a
        drive cannot be configured or enabled.
        """
        with self._lock:
            self._fault, self._running = None, False
            try:
                for drive in self._drives:
                    drive.configure(self._node, self.timing.watchdog_s, self.timing.heartbeat_s)
                    drive.reset_fault()
                # The watchdog of a drive starts with the first heartbeat.
                self._beat(due=True)
                for which in range(len(self._drives)):
                    self._enable(which)
            except DeviceFault as fault:
                raise self._give_up(fault) from None
            # Frames received so far describe the drives before they were enabled.
            while self._next_frame(0) is not None:
                pass
            self._rounds.begin_anew()
            self._running = True

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin a motion to a depth. Raises DeviceFault if a value is beyond its limit or the drive refuses."""
        self._move(0, depth_mm, velocity_mm_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin a rotation of the needle base to a roll angle. Raises DeviceFault in the same cases as `insert`."""
        self._move(1, roll_rad, velocity_rad_s)

    def stop(self) -> None:
        """Stop both axes by a quick stop; the next motion command of an axis enables its drive again.

        Raises DeviceFault if a drive does not acknowledge the stop, LinkClosed after `close`. A drive that receives no
        heartbeats stops by itself.
        """
        self._require_open()
        try:
            # Marked before the drives report the effects of the stop, so that a reading thread expects them.
            for axis in self._axes:
                axis.stop()
            for drive in self._drives:
                drive.quick_stop()  # both drives get the command before any thread waits for an answer
            with self._lock:
                for axis in self._axes:
                    axis.stop()
                faults = [fault for drive in self._drives if (fault := _tried(drive)) is not None]
        except DeviceFault as fault:
            raise self._give_up(fault) from None
        if faults:
            raise self._give_up(faults[0])

    def send_stop(self) -> None:
        """Let another thread send a quick stop to both drives, because the caller may hold the lock of the bus."""
        self._require_open()
        threading.Thread(target=self._quick_stop, name="stop", daemon=True).start()

    def _quick_stop(self) -> None:
        # Marked before the drives report the effects of the stop, so that a reading thread expects them.
        for axis in self._axes:
            axis.stop()
        for drive in self._drives:
            with contextlib.suppress(DeviceFault):
                drive.quick_stop()

    def measure(self, timeout_s: float) -> StageSample | None:
        """Return the next sample, also after a fault, or None after `timeout_s`. Raises DeviceFault."""
        self._require_open()
        return self._read(timeout_s)

    def heartbeat(self) -> None:
        """Send a heartbeat if `timing.heartbeat_s` has passed since the last one.

        Raises DeviceFault if the heartbeat cannot be sent, LinkClosed after `close`.
        """
        self._require_open()
        try:
            self._beat()
        except DeviceFault as fault:
            raise self._give_up(fault) from None

    def read(self, timeout_s: float) -> StageSample | None:
        """Return the next sample, or None after `timeout_s`.

        Raises DeviceFault if a drive reports a fault or is silent, and then at every call until `start`.
        """
        self._require_no_fault()
        return self._read(timeout_s)

    def _read(self, timeout_s: float) -> StageSample | None:
        deadline = Deadline(self._clock, timeout_s)
        waited = False
        while True:
            with self._lock:
                sample = self._step()
            if sample is not None:
                return sample
            if waited and deadline.passed:
                return None
            frame = self._next_frame(min(deadline.left_s, self.timing.sync_s / 2))
            waited = True
            if frame is not None:
                with self._lock:
                    self._guarded(frame)

    def close(self) -> None:
        """Stop both axes, switch off the power stages, and disconnect from the bus. Closing again does nothing."""
        if self._closed:
            return
        with contextlib.suppress(DeviceFault):
            self.stop()
        self._closed = True
        for drive in self._drives:
            with contextlib.suppress(DeviceFault):
                drive.disable()
        self._bus.close()

    def _move(self, which: int, target: float, velocity: float) -> None:
        self._require_no_fault()
        drive, axis = self._drives[which], self._axes[which]
        limits = axis.setup.limits
        if not (limits.least <= target <= limits.most and 0 < velocity <= limits.fastest):
            allowed = f"targets from {limits.least:g} to {limits.most:g}, speeds up to {limits.fastest:g}"
            raise DeviceFault(f"{axis.name}: {target:g} at a speed of {velocity:g} is not permitted; only {allowed}")
        if axis.setup.speed(velocity) < 1:
            raise DeviceFault(f"{axis.name}: a speed of {velocity:g} is below the smallest speed of the drive")
        with self._lock:
            self._drain()
            try:
                if axis.stopped:
                    self._enable(which)
                self._beat(due=True)
                drive.move(target, velocity)
                position = axis.setup.position(drive.read(Cia402Entry.POSITION))
            except DeviceFault as fault:
                raise self._give_up(fault) from None
            # Answers to earlier requests hold positions from before the motion; they must not be used.
            self._rounds.forget()
            self._drain()
            axis.begin(target, velocity, position, self._clock.now_ns())

    def _enable(self, which: int) -> None:
        drive, axis = self._drives[which], self._axes[which]
        drive.enable()
        axis.enabled(axis.setup.position(drive.read(Cia402Entry.POSITION)))

    def _step(self) -> StageSample | None:
        """Return the sample if both drives have answered. Else send the next SYNC if it is due, and return None.

        Raises DeviceFault if a drive reports a fault or is silent.
        """
        self._drain()
        if (sample := self._rounds.sample()) is not None:
            return sample
        if silent := self._rounds.silent():
            raise self._give_up(DeviceFault(silent))
        try:
            self._rounds.ask()
        except DeviceFault as fault:
            raise self._give_up(fault) from None
        return None

    def _beat(self, due: bool = False) -> None:
        now_ns = self._clock.now_ns()
        if due or now_ns - self._beat_ns >= self.timing.heartbeat_s * _NANO:
            self._beat_ns = now_ns
            self._bus.send(Service.HEARTBEAT + self._node, bytes([_OPERATIONAL]))

    def _next_frame(self, timeout_s: float) -> Frame | None:
        try:
            return self._bus.frames.get(timeout=timeout_s) if timeout_s > 0 else self._bus.frames.get_nowait()
        except queue.Empty:
            return None

    def _drain(self) -> None:
        while (frame := self._next_frame(0)) is not None:
            self._guarded(frame)

    def _guarded(self, frame: Frame) -> None:
        """Store the content of a frame. At the first fault, stop both axes, latch the fault and raise DeviceFault."""
        which = next(at for at, axis in enumerate(self._axes) if axis.setup.node == frame.node)
        wrong = self._take(self._axes[which], frame)
        if not wrong or self._fault is not None:
            return
        if wrong == "FAULT":
            with contextlib.suppress(DeviceFault):
                wrong = f"FAULT: {self._drives[which].cause()}"
        raise self._give_up(DeviceFault(f"{self._axes[which].name}: {wrong}"))

    def _take(self, axis: Cia402Axis, frame: Frame) -> str:
        if frame.service is Service.EMERGENCY:
            emergency = decode_emergency(frame.data)
            return "" if emergency is not None and emergency.code >> 8 == 0 else str(emergency or "emergency")
        if frame.service is Service.HEARTBEAT:
            state = frame.data[0] & 0x7F if frame.data else -1
            return (
                "" if state == _OPERATIONAL or not self._running else f"is in NMT state {state} instead of OPERATIONAL"
            )
        earliest_ns = self._rounds.earliest_ns
        if self._rounds.asked_ns is None or earliest_ns is None:
            return ""
        if frame.service is Service.VELOCITY:
            return axis.take_velocity(frame.data)
        return axis.take_status(frame.data, earliest_ns, frame.received_ns)

    def _require_no_fault(self) -> None:
        self._require_open()
        if self._fault is not None:
            raise self._fault

    def _give_up(self, fault: DeviceFault) -> DeviceFault:
        """Stop both axes, latch `fault` until `start` unless one is latched already, and return the latched fault."""
        if self._fault is None:
            self._fault = fault
        self._running = False
        for drive in self._drives:
            with contextlib.suppress(DeviceFault):
                drive.quick_stop()
        for axis in self._axes:
            axis.stop()
        return self._fault


def _tried(drive: Cia402Drive) -> DeviceFault | None:
    try:
        drive.confirm_stop()
    except DeviceFault as fault:
        return fault
    return None
