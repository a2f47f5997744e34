"""A guarded stage with a force sensor and a tracker that speak their bytes, on one virtual clock, recorded as a run is.

The loop is the least that there can be: read what has come, hand it to the guard, say that one is alive.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from needleplan.control.safety import GuardedStage, OperatingState, Order, SafetyEvent, SafetyEventName, SafetyLimits
from needleplan.devices import ForceSensor, PoseSample, Source, Tracker, VirtualClock
from needleplan.devices.ati import NetFt, NetFtBox, parse_configuration
from needleplan.devices.ndi import AuroraDevice, NdiTracker, SimulatedTool
from needleplan.errors import DeviceFault, NeedleplanError
from needleplan.recording import EVENT, Recorder, Recording, Session, WhenFull
from tests.control.safety.bench import NotedStage
from tests.devices.ati.bench import Wrench
from tests.devices.ati.box_link import BoxLink
from tests.devices.ndi.aurora_link import AuroraLink
from tests.devices.ndi.bench import REFERENCE, TIP, needle, plate

TURN_S = 0.005
LIMITS = SafetyLimits(out_of_plane_mm=400.0)


class Rig:
    """Devices, guard and recorder; `begin` opens and enables, `turn` is one turn of the loop."""

    def __init__(self, path: Path) -> None:
        self.clock = VirtualClock(10**12)
        self.wrench = Wrench()
        self.box = NetFtBox(self.wrench)
        self.box.ft_sequence = 3_000_000_000  # it has been on for days
        self.box_link = BoxLink(self.box, self.clock)
        self.tip = SimulatedTool(TIP, needle)
        self.aurora = AuroraDevice([self.tip, SimulatedTool(REFERENCE, plate, handle=0x0B)], self.clock)
        self.aurora_link = AuroraLink(self.aurora, self.clock)
        self.stage = NotedStage(self.clock)
        self.events: list[SafetyEvent] = []
        self.path = path
        self.recorder = Recorder(path, Session("fault", monotonic_ns=10**12), when_full=WhenFull.WAIT)
        self.channel = self.recorder.channel("/events", EVENT)
        self.guard = GuardedStage(
            self.stage, LIMITS, clock=self.clock, listener=self.heard, accepted_limits="a tip that is no matter here"
        )
        self.force: ForceSensor | None = None
        self.tracker: Tracker | None = None
        self.refusals: list[NeedleplanError] = []

    def heard(self, event: SafetyEvent) -> None:
        self.events.append(event)
        self.channel.put(event.time_ns, event.entry())

    def open_force(self) -> NetFt:
        self.force = NetFt(self.box_link, lambda: parse_configuration(self.box.page()), clock=self.clock)
        return self.force

    def open_tracker(self) -> NdiTracker:
        self.tracker = NdiTracker(self.aurora_link, tool=TIP, clock=self.clock)
        return self.tracker

    def open(self) -> None:
        """Open both devices; what refuses to open is told to the guard, as `insert` does."""
        for source, each in ((Source.FORCE, self.open_force), (Source.POSE, self.open_tracker)):
            self.trying(source, each)

    def check_force(self) -> None:
        """Ask the force sensor whether its configuration is still that of the start."""
        assert isinstance(self.force, NetFt)
        self.trying(Source.FORCE, self.force.check_configuration)

    def trying(self, source: Source, what: Callable[[], Any]) -> None:
        """Do something with a device, and tell the guard where it fails."""
        try:
            what()
        except NeedleplanError as error:
            self.refusals.append(error)
            self.guard.device_failed(source, error)

    def begin(self) -> None:
        """Open, enable as a person does, and insert."""
        self.open()
        self.turns(0.3)
        for order in (Order.HOME, Order.ENABLE):
            self.guard.order(order, "anna")
        self.guard.insert(100.0, 5.0)
        self.stage.moving = True
        self.turns(0.05)
        assert self.guard.state.operating is OperatingState.ENABLED, self.guard.state

    def turn(self) -> None:
        """Let the loop make one turn of 5 ms."""
        began_ns = self.clock.now_ns()
        if self.force is not None:
            # A turn may take longer than 5 ms; what has come meanwhile does not wait, because it would grow old.
            timeout_s = TURN_S
            while self.read(Source.FORCE, self.force, timeout_s):
                timeout_s = 0.0
        if self.tracker is not None:
            self.read(Source.POSE, self.tracker, 0.0)
        self.clock.sleep(TURN_S - (self.clock.now_ns() - began_ns) * 1e-9)
        if self.stage.moving:
            self.stage.depth_mm += 5 * TURN_S
        try:
            self.guard.read(0.0)
        except DeviceFault as error:
            self.refusals.append(error)
        self.guard.tick()
        # A stage obeys a stop.
        self.stage.moving &= self.stage.wire[-1:] != [("stop",)]

    def read(self, source: Source, device: ForceSensor | Tracker, timeout_s: float) -> bool:
        """Read a device once and show the guard what came; return whether a sample came."""
        try:
            sample = device.read(timeout_s)
        except DeviceFault as error:
            self.refusals.append(error)
            self.guard.device_failed(source, error)
            return False
        if isinstance(sample, PoseSample):
            x, y, _ = sample.position_mm
            self.guard.observe(sample, tip_mm=(x, y), out_of_plane_mm=0.0 if math.isfinite(x) else math.nan)
        elif sample is not None:
            self.guard.observe(sample)
        return sample is not None

    def turns(self, seconds: float) -> None:
        end_ns = self.clock.now_ns() + round(seconds * 1e9)
        while self.clock.now_ns() < end_ns:
            self.turn()

    def turns_until_stop(self, seconds: float) -> float:
        """Go on until a stop is on the wire, and return how long that took; NaN where none came."""
        began_ns, count = self.clock.now_ns(), len(self.stage.wire)
        while self.clock.now_ns() < began_ns + round(seconds * 1e9):
            self.turn()
            if ("stop",) in self.stage.wire[count:]:
                at = count + self.stage.wire[count:].index(("stop",))
                return (self.stage.times_ns[at] - began_ns) * 1e-9
        return math.nan

    def close(self) -> None:
        self.recorder.close()

    def recorded(self) -> Sequence[dict[str, Any]]:
        """Finish the recording, and return the events that are in it."""
        self.close()
        return [each.values for each in Recording.read(self.path).messages(["/events"])]

    def first_stop(self) -> SafetyEvent | None:
        """The first event by which ENABLED was left."""
        return next((each for each in self.events if each.name is SafetyEventName.TRANSITION
                     and each.before is OperatingState.ENABLED), None)  # fmt: skip
