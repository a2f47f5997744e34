"""Robots with one planted fault each, and the case of the conformance test that must find it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

from needleplan.devices.robot import RobotLimits, RobotState
from needleplan.devices.robot._probe import sealed
from needleplan.devices.robot.messages import Hello, RobotCommand, RobotKind, decode, encode
from needleplan.errors import ProtocolError
from tests.devices.robot.bench import Bench

K = RobotKind


@dataclass
class Faulty:
    """A robot on a virtual clock whose received and sent datagrams pass through functions that a test replaces."""

    bench: Bench

    @property
    def session(self) -> Any:
        return self.bench.machine._session

    def receives(self, change: Callable[[Any], Any]) -> None:
        """Let `change` see and alter each sound command before the robot does; None: the robot does not get it."""
        receive = self.bench.machine.receive

        def altered(datagram: bytes, sender: tuple[str, int], now_ns: int) -> bytes:
            try:
                message = decode(datagram)
            except ProtocolError:
                return receive(datagram, sender, now_ns)
            assert isinstance(message, Hello | RobotCommand)
            changed = change(message)
            return b"" if changed is None else receive(encode(changed), sender, now_ns)

        self.bench.machine.receive = altered  # type: ignore[method-assign]

    def sends(self, change: Callable[[Any], Any]) -> None:
        """Let `change` alter each status."""
        tick = self.bench.machine.tick

        def altered(now_ns: int) -> Any:
            sent = tick(now_ns)
            return sent and (encode(change(decode(sent[0]))), sent[1])

        self.bench.machine.tick = altered  # type: ignore[method-assign]


FAULTS: dict[str, tuple[str, Callable[[Faulty], object]]] = {}


def planted(case: str) -> Callable[[Callable[[Faulty], object]], None]:
    """Register a function that plants one fault, which `case` must find."""

    def register(plant: Callable[[Faulty], object]) -> None:
        FAULTS[plant.__name__] = case, plant

    return register


@planted("stop")
def ignores_stop(robot: Faulty) -> None:
    robot.bench.drive.faults.missed_stops = 10**9


@planted("stop")
def brakes_slowly(robot: Faulty) -> None:
    robot.bench.drive.faults.braking_mm_s2 = 8.0


@planted("stop-repeated")
def takes_many_stops_for_a_fault(robot: Faulty) -> None:
    stops = count()

    def see(message: Any) -> Any:
        if message.kind is K.STOP and next(stops) > 10:
            robot.bench.machine.state = RobotState.FAULT
        return message

    robot.receives(see)


@planted("stop-in-every-state")
def drops_stop_in_fault(robot: Faulty) -> None:
    machine = robot.bench.machine
    robot.receives(lambda each: None if each.kind is K.STOP and machine.state is RobotState.FAULT else each)


@planted("stop-under-load")
def is_deaf_after_a_flood(robot: Faulty) -> None:
    receive, deaf_ns = robot.bench.machine.receive, [0]
    moments: list[int] = []

    def tired(datagram: bytes, sender: tuple[str, int], now_ns: int) -> bytes:
        moments.append(now_ns)
        if moments.count(now_ns) > 50:
            deaf_ns[0] = now_ns + 10**9
        return b"" if now_ns < deaf_ns[0] else receive(datagram, sender, now_ns)

    robot.bench.machine.receive = tired  # type: ignore[method-assign]


@planted("foreign-stop")
def ignores_foreign_stops(robot: Faulty) -> None:
    robot.receives(lambda each: replace(each, kind=K.ALIVE) if each.head.session == 0 else each)


@planted("foreign-stop")
def stops_for_others_without_fault(robot: Faulty) -> None:
    machine = robot.bench.machine
    machine._stop_for_any = machine._stop.begin  # type: ignore[method-assign]


@planted("witness")
def tells_others_no_position(robot: Faulty) -> None:
    robot.bench.machine._witnesses.add = lambda *_: None  # type: ignore[method-assign]


@planted("watchdog")
def has_no_watchdog(robot: Faulty) -> None:
    robot.bench.machine.limits = RobotLimits(shortest_silence_s=9.0, longest_silence_s=9.0)


@planted("watchdog")
def has_a_hasty_watchdog(robot: Faulty) -> None:
    robot.bench.machine.limits = RobotLimits(longest_silence_s=0.02)


@planted("repeated-heartbeat")
def takes_repeated_datagrams_for_life(robot: Faulty) -> None:
    sequences = count(1)
    robot.receives(lambda each: replace(each, head=replace(each.head, sequence=next(sequences))))


@planted("repeated-hello")
def takes_repeated_hello_for_life(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        if robot.session and isinstance(message, Hello):
            robot.session.received_ns = robot.bench.machine._now_ns
        return message

    robot.receives(see)


@planted("once")
def forgets_its_answer_with_the_next_hello(robot: Faulty) -> None:
    forgotten: set[int] = set()

    def see(message: Any) -> Any:
        if isinstance(message, Hello):
            forgotten.update([robot.session.number] if robot.session else [])
        return None if message.head.number in forgotten else message

    robot.receives(see)


@planted("stop-overtaken")
def drops_what_was_overtaken(robot: Faulty) -> None:
    robot.receives(lambda each: None if robot.session and each.head.sequence <= robot.session.sequence else each)


@planted("late-heartbeat")
def takes_late_heartbeats_for_life(robot: Faulty) -> None:
    robot.receives(lambda each: replace(each, deadline_ns=2**63) if each.kind is K.ALIVE else each)


@planted("deadlines")
def executes_late_motions(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        now_ns = robot.bench.clock.now_ns() + robot.bench.network.ahead_ns
        late = message.kind is K.INSERT and message.deadline_ns < now_ns
        return replace(message, deadline_ns=now_ns + 1000) if late else message

    robot.receives(see)


@planted("once")
def executes_a_number_again(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        if robot.session and message.kind is K.INSERT:
            robot.session.number = message.head.number - 1
        return message

    robot.receives(see)


@planted("superseded")
def executes_motions_older_than_a_stop(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        if robot.session and message.kind is K.INSERT and message.head.number < robot.session.number:
            robot.session.number = message.head.number - 1
        return message

    robot.receives(see)


@planted("wrap")
def compares_counters_without_wrap(robot: Faulty) -> None:
    highest = [0]

    def see(message: Any) -> Any:
        highest[0] = max(highest[0], message.head.number)
        if robot.session and 0 < message.head.number < highest[0]:
            robot.session.number = message.head.number + 1
        return message

    robot.receives(see)


@planted("wrap")
def takes_nothing_for_life_after_a_wrap(robot: Faulty) -> None:
    highest = [0]

    def see(message: Any) -> Any:
        highest[0] = max(highest[0], message.head.sequence)
        if robot.session and message.head.sequence < highest[0]:
            return replace(message, head=replace(message.head, sequence=robot.session.sequence))
        return message

    robot.receives(see)


@planted("limits")
def reduces_depths_instead_of_refusing(robot: Faulty) -> None:
    robot.receives(lambda each: replace(each, target=min(each.target, 2.0)) if each.kind is K.INSERT else each)


@planted("limits")
def knows_no_limit_of_speed(robot: Faulty) -> None:
    robot.receives(lambda each: replace(each, speed=min(each.speed, 5.0)) if each.kind is K.INSERT else each)


@planted("limits")
def takes_nan_for_zero(robot: Faulty) -> None:
    robot.receives(
        lambda each: replace(each, target=0.0) if each.kind is K.INSERT and math.isnan(each.target) else each
    )


@planted("not-enabled")
def needs_no_enable(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        if message.kind is K.INSERT:
            robot.bench.machine.state = RobotState.ENABLED
        return message

    robot.receives(see)


@planted("wide-limits")
def promises_limits_that_it_does_not_have(robot: Faulty) -> None:
    robot.receives(lambda each: replace(each, limits=type(each.limits)()) if each.kind is K.HELLO else each)


@planted("latch")
def enables_out_of_a_fault(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        if message.kind is K.ENABLE:
            robot.bench.machine._reset()
        return message

    robot.receives(see)


@planted("latch")
def resumes_the_motion_after_enable(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        if message.kind is K.ENABLE:
            robot.bench.drive.insert(2.0, 5.0)
            robot.bench.machine._stop.end()
        return message

    robot.receives(see)


@planted("homed")
def forgets_the_lost_zero(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        if message.kind is K.HELLO:
            robot.bench.machine.homed = True
        return message

    robot.receives(see)


@planted("standing")
def always_says_that_it_stands(robot: Faulty) -> None:
    robot.sends(lambda status: replace(status, standing=True))


@planted("standing")
def says_at_once_that_it_stands(robot: Faulty) -> None:
    robot.sends(lambda status: replace(status, standing=not status.moving))


@planted("insert")
def says_during_a_motion_that_it_is_complete(robot: Faulty) -> None:
    robot.bench.drive.faults.claims_rest = True


@planted("insert")
def moves_twice_as_fast(robot: Faulty) -> None:
    insert = robot.bench.drive.insert
    robot.bench.drive.insert = lambda depth, speed: insert(depth, 2 * speed)  # type: ignore[method-assign]


@planted("rotate")
def does_not_rotate(robot: Faulty) -> None:
    robot.bench.drive.rotate = lambda *_: None  # type: ignore[method-assign]


@planted("statuses")
def sends_100_statuses_per_second(robot: Faulty) -> None:
    tick, ticks = robot.bench.machine.tick, count()
    robot.bench.machine.tick = lambda now: None if next(ticks) % 10 else tick(now)  # type: ignore[method-assign]


@planted("echo")
def says_that_every_datagram_just_arrived(robot: Faulty) -> None:
    robot.sends(lambda status: replace(status, head=replace(status.head, held_us=0)))


@planted("missed")
def counts_no_missing_datagrams(robot: Faulty) -> None:
    robot.sends(lambda status: replace(status, missed=0))


@planted("version-2")
def answers_version_2_in_version_3(robot: Faulty) -> None:
    robot.sends(lambda status: replace(status, head=replace(status.head, version=3)))


@planted("busy")
def lets_a_second_controller_take_over(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        if message.kind is K.HELLO:
            robot.bench.machine._session = None
        return message

    robot.receives(see)


@planted("sessions")
def begins_ended_sessions_again(robot: Faulty) -> None:
    def see(message: Any) -> Any:
        robot.bench.machine._ended.clear()
        return message

    robot.receives(see)


@planted("goodbye")
def moves_on_after_goodbye(robot: Faulty) -> None:
    machine = robot.bench.machine

    def end() -> None:
        machine._session, machine.state = None, RobotState.DISABLED

    machine._end = end  # type: ignore[method-assign]


@planted("restart")
def keeps_a_dead_controller(robot: Faulty) -> None:
    robot.bench.machine.limits = RobotLimits(release_s=1e9)


@planted("restart")
def releases_after_two_seconds(robot: Faulty) -> None:
    robot.bench.machine.limits = RobotLimits(release_s=2.0)


@planted("damaged")
def does_not_check_checksums(robot: Faulty) -> None:
    receive = robot.bench.machine.receive

    def trusting(datagram: bytes, sender: tuple[str, int], now_ns: int) -> bytes:
        return receive(sealed(datagram[:-4]), sender, now_ns)

    robot.bench.machine.receive = trusting  # type: ignore[method-assign]


@planted("other-version")
def is_silent_to_other_versions(robot: Faulty) -> None:
    receive = robot.bench.machine.receive
    robot.bench.machine.receive = (  # type: ignore[method-assign]
        lambda data, *rest: receive(data, *rest) if data[4:5] < b"\x04" else b""
    )


@planted("key")
def does_not_check_tags(robot: Faulty) -> None:
    robot.bench.machine._is_authentic = lambda *_: True  # type: ignore[method-assign]
