"""A guard before a stage that only notes what it is told, with samples that are as good as one likes."""

import math
from dataclasses import replace
from typing import Any

from needleplan.control.safety import Cause, GuardedStage, Order, SafetyEvent, SafetyEventName, SafetyLimits
from needleplan.devices import ForceSample, PoseSample, Stage, StageSample, Stamp, VirtualClock
from needleplan.errors import DeviceFault


class NotedStage(Stage):
    """Moves as told, at once; everything that reaches it is in `wire`, with its time."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.wire: list[tuple[Any, ...]] = []
        self.times_ns: list[int] = []
        self.depth_mm, self.roll_rad, self.velocity_mm_s, self.moving = 0.0, 0.0, 0.0, False
        self.broken = False
        self.number = 0

    def note(self, *what: Any) -> None:
        if self.broken:
            raise DeviceFault("the stage is not there")
        self.wire.append(what)
        self.times_ns.append(self.clock.now_ns())

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        self.note("insert", depth_mm, velocity_mm_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        self.note("rotate", roll_rad, velocity_rad_s)

    def stop(self) -> None:
        self.note("stop")

    def read(self, timeout_s: float) -> StageSample | None:
        if self.broken:
            raise DeviceFault("the stage is not there")
        self.clock.sleep(timeout_s)
        self.number += 1
        stamp = Stamp(self.clock.now_ns(), self.number)
        return StageSample(stamp, self.depth_mm, self.velocity_mm_s, self.roll_rad, self.moving)

    def close(self) -> None:
        self.broken = True


class Bench:
    """Guard, stage, clock and all events."""

    def __init__(self, **limits: Any) -> None:
        self.clock = VirtualClock(10**12)
        self.stage = NotedStage(self.clock)
        self.events: list[SafetyEvent] = []
        others = {name: limits.pop(name) for name in ("check_tip", "needs_deadman", "on_alarm") if name in limits}
        self.guard = GuardedStage(
            self.stage, SafetyLimits(**limits), clock=self.clock, listener=lambda event: self.events.append(event),
            accepted_limits="a test", **others,
        )  # fmt: skip
        self.number = 0
        self.force: dict[str, Any] = {}
        self.pose: dict[str, Any] = {}
        self.tip: dict[str, Any] = {"tip_mm": (10.0, 5.0), "out_of_plane_mm": 0.1}
        self.without: set[str] = set()
        """Which of force, pose, stage and loop are silent."""

    def turn(self, seconds: float = 0.005) -> None:
        """Let the loop make one turn."""
        self.clock.sleep(seconds)
        self.number += 1
        stamp = Stamp(self.clock.now_ns(), self.number)
        force = ForceSample(stamp, (0.0, 0.1, 1.0), (0.0, 0.0, 0.0))
        noise_mm = 0.01 * (self.number % 2)  # a tracker never gives a pose twice bit for bit
        pose = PoseSample(stamp, (1.0, 2.0, 3.0 + noise_mm), (1.0, 0.0, 0.0, 0.0), 0.1)
        if "force" not in self.without:
            self.guard.observe(replace(force, **self.force))
        if "pose" not in self.without:
            self.guard.observe(replace(pose, **self.pose), **self.tip)
        if "stage" not in self.without:
            self.guard.read(0)
        if "loop" not in self.without:
            self.guard.tick()
        else:
            self.guard.check()

    def turns(self, seconds: float) -> None:
        """Let the loop go on for a while."""
        for _ in range(round(seconds / 0.005)):
            self.turn()

    def rest(self) -> None:
        """Let the loop go on while an order to go on waits for the needle to rest."""
        while self.guard.state.waits:
            self.turn()

    def enabled(self) -> GuardedStage:
        """Return the guard, enabled as a person would."""
        self.turn()
        for order in (Order.HOME, Order.RESET, Order.ENABLE):
            self.guard.order(order, "anna")
        self.rest()
        self.stage.wire.clear()
        self.stage.times_ns.clear()
        return self.guard

    def named(self, name: SafetyEventName) -> list[SafetyEvent]:
        return [each for each in self.events if each.name is name]

    @property
    def causes(self) -> set[Cause]:
        """The causes of all transitions since the beginning."""
        return {cause for each in self.named(SafetyEventName.TRANSITION) for cause in each.causes}


NAN = math.nan
