"""A guarded robot that speaks its bytes over a network that can be told to misbehave, on a virtual clock."""

import contextlib

from needleplan.control.safety import Cause, GuardedStage, Order, SafetyEvent, SafetyEventName, SafetyLimits
from needleplan.devices import ForceSample, PoseSample, Stamp
from needleplan.devices.robot import RobotState
from needleplan.errors import DeviceFault
from tests.devices.robot.bench import Bench


class RobotRig:
    """Force and tracker are well; only what the loop itself says keeps the robot's watchdog quiet."""

    def __init__(self) -> None:
        self.bench = Bench()
        self.stage = self.bench.stage()
        self.events: list[SafetyEvent] = []
        self.guard = GuardedStage(
            self.stage, SafetyLimits(), clock=self.bench.clock, listener=lambda event: self.events.append(event)
        )
        self.faults: list[str] = []
        self.number = 0
        self.hangs = False
        """Whether the loop hangs; samples still come, and somebody looks."""

    def begin(self) -> None:
        """Enable as a person does, and insert."""
        self.turns(0.05)
        for order in (Order.HOME, Order.ENABLE):
            self.guard.order(order, "anna")
        self.guard.insert(100.0, 10.0)
        self.turns(0.1)
        assert self.moving
        assert self.state == "ENABLED", self.guard.state

    @property
    def state(self) -> str:
        return str(self.guard.state.operating)

    @property
    def moving(self) -> bool:
        """Whether the axes move, in truth."""
        return self.bench.truth[1] and self.bench.machine.state is RobotState.ENABLED

    def turn(self) -> None:
        """Let the loop make one turn of 5 ms."""
        for _ in range(5):
            began_ns = self.bench.clock.now_ns()
            try:
                self.guard.read(0.001)
            except DeviceFault as fault:
                self.faults.append(str(fault))
            left_s = 0.001 - (self.bench.clock.now_ns() - began_ns) * 1e-9
            if left_s > 0:
                self.bench.wait(left_s)
        with contextlib.suppress(DeviceFault):
            for _ in range(300):  # what waits because the loop was held up
                if self.guard.read(0.0) is None:
                    break
        self.number += 1
        stamp = Stamp(self.bench.clock.now_ns(), self.number)
        self.guard.observe(ForceSample(stamp, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))
        pose = PoseSample(stamp, (0.0, 0.0, 0.01 * (self.number % 2)), (1.0, 0.0, 0.0, 0.0), 0.1)
        self.guard.observe(pose, tip_mm=(0.0, 0.0), out_of_plane_mm=0.0)
        if self.hangs:
            self.guard.check()
        else:
            self.guard.tick()

    def turns(self, seconds: float) -> None:
        end_ns = self.bench.clock.now_ns() + round(seconds * 1e9)
        while self.bench.clock.now_ns() < end_ns:
            self.turn()

    def left_enabled(self) -> tuple[str, frozenset[Cause], int]:
        """The state after ENABLED, why, and when."""
        first = next(
            each for each in self.events if each.name is SafetyEventName.TRANSITION and each.before == "ENABLED"
        )
        return str(first.state), first.causes, first.time_ns

    def start_again(self) -> None:
        """Do what a person does to a robot that has given up."""
        with contextlib.suppress(DeviceFault):
            self.stage.start()
