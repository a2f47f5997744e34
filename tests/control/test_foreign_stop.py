"""Random orders and faults with foreign robots, honest, deaf, lying, late and mute, in virtual time.

An honest robot goes no farther than its braking distance after an order to stop: from where its needle is in truth when
the person gives the order, by the formula of a constant deceleration, without a word of the guard. Whatever a robot
does, no run ends with an exit code that lets the needle seem at rest while it moves, and no run goes on before the
needle rests.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

import pytest

from needleplan.bystander import stop
from needleplan.cli.insert_answer import exit_code
from needleplan.control import Insertion, Listener, Options
from needleplan.control.safety import OperatingState, Order, SafetyEvent, SafetyLimits
from needleplan.devices import (
    ForceSample,
    ForceSensor,
    PoseSample,
    Sample,
    StageSample,
    Stamp,
    Station,
    Tracker,
    VirtualClock,
)
from needleplan.devices.robot import RobotServer, RobotStage
from needleplan.errors import MotionRefused
from needleplan.estimation.registration import Registration
from needleplan.stopping import Rest
from tests.control.foreign_robot import Character, ForeignRobot
from tests.control.scenes import small_table
from tests.devices.robot.network import RobotNetwork

ENTRY = (0.0, 20.0)
SPEED_MM_S = 8.0
# Time (s) from the decision to stop until the robot has the order: one turn of the network
WIRE_S = 0.002
# Interval (s) of the samples of the force; motion (mm) in two ticks of the robot
FORCE_S, STEP_MM = 0.005, 0.02


class WellForce(ForceSensor):
    """A force of 1 N with noise, 200 times per second."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock, self.due_ns, self.number, self.force_n = clock, clock.now_ns(), 0, 1.0

    def bias(self) -> None:
        """Do nothing."""

    def read(self, timeout_s: float) -> ForceSample | None:  # noqa: ARG002
        if self.clock.now_ns() < self.due_ns:
            return None
        self.due_ns, self.number = self.clock.now_ns() + round(FORCE_S * 1e9), self.number + 1
        return ForceSample(
            Stamp(self.clock.now_ns(), self.number), (0.0, 0.001 * (self.number % 2), self.force_n), (0.0, 0.0, 0.0)
        )

    def close(self) -> None:
        """Do nothing."""


class WellTracker(Tracker):
    """A coil in the tip of a needle that goes straight ahead, 40 times per second; hidden for a while if told so."""

    def __init__(self, clock: VirtualClock, robot: ForeignRobot) -> None:
        self.clock, self.robot, self.due_ns, self.number = clock, robot, clock.now_ns(), 0
        self.hidden_until_ns = 0

    def read(self, timeout_s: float) -> PoseSample | None:  # noqa: ARG002
        now_ns = self.clock.now_ns()
        if now_ns < self.due_ns:
            return None
        self.due_ns, self.number = now_ns + 25_000_000, self.number + 1
        half = 0.5**0.5
        place = (ENTRY[0] + self.robot.depth_mm, ENTRY[1] + 0.01 * (self.number % 2), 0.0)
        sample = PoseSample(Stamp(now_ns, self.number), place, (half, 0.0, half, 0.0), 0.1)
        return None if now_ns < self.hidden_until_ns else sample

    def close(self) -> None:
        """Do nothing."""


@dataclass
class Rig(Listener):
    """A run with a foreign robot, and the script of what happens to it: times (s) after the needle is 1 mm deep."""

    character: Character
    script: list[tuple[float, Callable[[Rig], object]]]
    mistakes: list[str] = field(default_factory=list)
    alarms: list[Rest] = field(default_factory=list)
    estop_cuts_power: bool = False

    def __post_init__(self) -> None:
        self.clock = VirtualClock(5_000_000_000)
        self.robot = ForeignRobot(self.character)
        self.network = RobotNetwork(self.robot, self.clock)  # type: ignore[arg-type]
        stage = RobotStage(self.network.link(), clock=self.clock, draw_session=lambda: 5)
        self.force, self.tracker = WellForce(self.clock), WellTracker(self.clock, self.robot)
        self.insertion = Insertion(
            small_table(), Station(stage, self.force, self.tracker, self.clock),
            Options(velocity_mm_s=SPEED_MM_S, velocity_rad_s=6.0, replan=False, resume_s=0.5),
            registration=Registration(), limits=SafetyLimits(out_of_plane_mm=20.0), accepted_limits="a test",
            listeners=[self], on_alarm=self.alarmed,
        )  # fmt: skip
        self.began_ns: int | None = None
        self.farthest_mm: float | None = None
        """Depth (mm), in truth, beyond which no needle may go after an order to stop; None without one."""

    def alarmed(self, rest: Rest) -> None:
        self.alarms.append(rest)
        if self.estop_cuts_power:
            self.robot.power = False

    def sample(self, sample: Sample) -> None:
        """Carry out what is due in the script."""
        if not isinstance(sample, StageSample):
            return
        if self.began_ns is None and self.robot.depth_mm > 1.0:
            self.began_ns = self.clock.now_ns()
        while self.script and self.began_ns is not None:
            at_s, what = self.script[0]
            if (self.clock.now_ns() - self.began_ns) * 1e-9 < at_s:
                break
            self.script.pop(0)
            with contextlib.suppress(MotionRefused):
                what(self)

    def safety(self, event: SafetyEvent) -> None:
        """See that the guard says of the needle what is true."""
        if event.before is not None and event.state is OperatingState.ENABLED:
            if self.robot.moves:
                self.mistakes.append("it goes on although the needle moves")
            else:
                self.farthest_mm = None

    def order(self, after_s: float = 0.0) -> None:
        """Note that the needle must stop, `after_s` later at the latest."""
        if self.farthest_mm is None and self.character.is_honest:
            way_mm = SPEED_MM_S * (after_s + WIRE_S) + SPEED_MM_S**2 / (2 * self.character.braking_mm_s2)
            self.farthest_mm = self.robot.depth_mm + way_mm + STEP_MM

    def look(self) -> None:
        """See how far the needle has gone since the order; an honest robot stops within the braking distance."""
        if self.farthest_mm is not None and self.robot.depth_mm > self.farthest_mm:
            self.mistakes.append(f"{self.robot.depth_mm - self.farthest_mm:.2f} mm beyond the braking distance")

    def run(self) -> int:
        """Run it, and return the exit code of `needleplan insert`."""
        tick = self.robot.tick

        def watched(now_ns: int) -> tuple[bytes, tuple[str, int]] | None:
            sent = tick(now_ns)
            self.look()
            return sent

        self.robot.tick = watched  # type: ignore[method-assign]
        report = self.insertion.run()
        is_moving = self.robot.moves
        code = exit_code(report)
        if is_moving and code != 3:
            self.mistakes.append(f"exit code {code} while the needle moves at {self.robot.speed_mm_s:.1f} mm/s")
        if self.insertion.guard.rest is Rest.RESTS and is_moving:
            self.mistakes.append("the guard takes a moving needle for resting")
        if code == 3 and not self.alarms:
            self.mistakes.append("nobody was told")
        self.insertion.close()
        return code


def paused_for(seconds: float) -> Callable[[Rig], object]:
    """A person pauses, and resumes after a while; the resume is part of the script."""

    def pause(rig: Rig) -> None:
        now_s = (rig.clock.now_ns() - (rig.began_ns or 0)) * 1e-9
        rig.script = sorted([*rig.script, (now_s + seconds, resumed)], key=lambda each: each[0])
        rig.order()
        rig.insertion.guard.order(Order.PAUSE, "anna")

    return pause


def resumed(rig: Rig) -> None:
    rig.insertion.guard.order(Order.RESUME, "anna")


def stopped(rig: Rig) -> None:
    rig.order()
    rig.insertion.stop("Ctrl-C")


def stopped_by_the_guard(rig: Rig) -> None:
    rig.order()
    rig.insertion.guard.stop()


def retracted(rig: Rig) -> None:
    rig.order()
    rig.insertion.guard.retract(rig.robot.depth_mm - 1.0, 5.0, "anna")


def pushed(rig: Rig) -> None:
    rig.order(after_s=FORCE_S)
    rig.force.force_n = 9.0


def hidden(rig: Rig) -> None:
    rig.tracker.hidden_until_ns = rig.clock.now_ns() + 120_000_000


def cut_off(rig: Rig) -> None:
    rig.network.from_robot.cut = True


def cut_both(rig: Rig) -> None:
    rig.network.from_robot.cut = rig.network.to_robot.cut = True


def some_lost(rig: Rig) -> None:
    rig.network.to_robot.lose = rig.network.from_robot.lose = 3


EVENTS: tuple[Callable[[Rig], object], ...] = (
    paused_for(0.02), paused_for(0.05), paused_for(0.09), paused_for(0.3), stopped, stopped, stopped_by_the_guard,
    retracted, pushed, hidden, cut_off, cut_both, some_lost,
)  # fmt: skip
CHARACTERS = (
    Character(), Character(braking_mm_s2=120.0), Character(deaf=True), Character(deaf=True, no_watchdog=True),
    Character(lies=True), Character(lies=True, no_watchdog=True), Character(late_s=0.2), Character(late_s=0.8),
    Character(mute=True), Character(lies=True, mute=True),
)  # fmt: skip


def rig_of(seed: int) -> Rig:
    draw = Random(seed)
    script = sorted(
        ((draw.uniform(0.0, 1.2), draw.choice(EVENTS)) for _ in range(draw.randint(1, 3))), key=lambda each: each[0]
    )
    script.append((1.5, stopped))
    return Rig(draw.choice(CHARACTERS), script, estop_cuts_power=draw.random() < 0.3)


@pytest.mark.parametrize("seed", range(20))
def test_random_orders_and_faults(seed: int) -> None:
    rig = rig_of(seed)
    rig.run()
    assert rig.mistakes == []


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=pytest.mark.slow if seed < 50 else pytest.mark.study) for seed in range(20, 300)]
)
def test_more_random_orders_and_faults(seed: int) -> None:
    rig = rig_of(seed)
    rig.run()
    assert rig.mistakes == []


@pytest.mark.parametrize("speed_mm_s", [5.0, 0.3])
@pytest.mark.parametrize("character", CHARACTERS, ids=str)
def test_a_bystander_confirms_only_rest(character: Character, speed_mm_s: float) -> None:
    """On real sockets: the robot has no controller, and its needle goes in."""
    robot = ForeignRobot(character)
    robot.begin(100.0, speed_mm_s)
    with RobotServer(robot) as server:  # type: ignore[arg-type]
        outcome = stop(server.host, server.port, 60.0 if character.is_honest or character.late_s else 0.7)
        is_moving = robot.moves
    assert outcome.is_confirmed == (character.is_honest or bool(character.late_s))
    assert not (outcome.is_confirmed and is_moving)


@pytest.mark.parametrize("seconds", [0.02, 0.05, 0.09])
@pytest.mark.parametrize("late_s", [0.0, 0.05])
def test_a_resume_soon_after_a_pause_goes_on_when_the_needle_rests(seconds: float, late_s: float) -> None:
    rig = Rig(Character(late_s=late_s), [(0.1, paused_for(seconds)), (1.0, stopped)])
    assert rig.run() == 130
    assert rig.mistakes == []
    assert rig.robot.depth_mm > 1.0 + 0.6 * SPEED_MM_S  # it went on


@pytest.mark.parametrize(
    ("character", "cuts", "code"),
    [
        (Character(), False, 130),
        (Character(lies=True), False, 3),
        (Character(lies=True), True, 130),
        (Character(deaf=True, no_watchdog=True), False, 3),
        (Character(mute=True), False, 3),
    ],
    ids=["honest", "lying", "lying, with an emergency stop", "deaf", "mute"],
)
def test_ctrl_c(character: Character, cuts: bool, code: int) -> None:
    rig = Rig(character, [(0.2, stopped)], estop_cuts_power=cuts)
    assert rig.run() == code
    assert rig.mistakes == []
    assert bool(rig.alarms) == (not character.is_honest)
    assert len(rig.alarms) == len(set(rig.alarms))
    assert math.isfinite(rig.robot.depth_mm)
