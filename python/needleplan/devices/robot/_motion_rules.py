"""Rules of the robot protocol about motions and stops. The docstring of a function is the rule."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

from needleplan.devices.robot._bench import RobotBench
from needleplan.devices.robot._codes import Fault, Result, RobotKind, RobotState
from needleplan.devices.robot._probe import RobotProbe, require
from needleplan.devices.robot.messages import Hello, RobotCommand, encode

__all__ = [
    "deadlines", "foreign_stop", "goodbye", "insert", "latch", "late_heartbeat", "limits", "once", "redirect",
    "repeated_heartbeat", "repeated_hello", "restart", "rotate", "standing", "stop", "stop_in_every_state",
    "stop_in_rotation", "stop_overtaken", "stop_repeated", "stop_under_load", "superseded", "watchdog", "witness",
]  # fmt: skip

K, R = RobotKind, Result
_WATCHDOG_S = 0.06  # watchdog time (s) of the rules that are silent
_LATE_S = 0.05  # time (s) by which a stop may be late: servo ticks, drives, and the programs of both sides
_STANDS_S = 0.04  # time (s) at rest before which STANDING is wrong: 50 ms, less a fifth for times of servo ticks
_BUSY_S = 4.0  # time (s) for which a silent controller keeps the robot: 5 s, less a fifth


def _unfed(probe: RobotProbe, what: str, unfit: Callable[[], Hello | RobotCommand]) -> None:
    for _ in range(round((_WATCHDOG_S + _LATE_S) / 0.005)):
        probe.post(unfit())
        probe.listen(0.005, alive=False)
    probe.ends_in_fault(Fault.WATCHDOG, what, 0.02)


def once(bench: RobotBench) -> None:
    """A command number is executed once; a repetition gets the first answer, also after HELLO of another sender."""
    probe, other = bench.ready(), bench.probe()
    motion = bench.motion
    probe.go(motion.start_mm)
    other.expect(other.hello(), R.BUSY)
    again = probe.command(K.INSERT, motion.far_mm, motion.speed_mm_s, number=probe.number)
    probe.expect(again)
    probe.stays("a repeated number")


def superseded(bench: RobotBench) -> None:
    """A motion that arrives after a STOP with a higher number gets SUPERSEDED, and does not begin."""
    probe = bench.ready()
    motion = bench.motion
    probe.go(motion.start_mm)
    late = probe.head()
    probe.stop()
    probe.expect(probe.command(K.INSERT, motion.far_mm, motion.speed_mm_s, number=late.number), R.SUPERSEDED)
    probe.stays("a motion older than the STOP")


def deadlines(bench: RobotBench) -> None:
    """A motion gets LATE after its deadline or without one, and DEADLINE_BEYOND if it is valid for too long."""
    probe = bench.ready()
    motion = bench.motion
    probe.go(motion.start_mm)
    for kind, target, speed in (
        (K.INSERT, motion.far_mm, motion.speed_mm_s),
        (K.ROTATE, motion.roll_rad + 0.1, motion.speed_rad_s),
    ):
        probe.expect(probe.command(kind, target, speed, valid_s=-0.002), R.LATE)
        probe.expect(replace(probe.command(kind, target, speed), deadline_ns=0), R.LATE)
        probe.expect(probe.command(kind, target, speed, valid_s=1.0), R.DEADLINE_BEYOND)
    probe.stays("a late motion")


def limits(bench: RobotBench) -> None:
    """A motion beyond a limit of the session is refused with the limit, not reduced; one that is no number, too."""
    probe = bench.ready()
    motion = bench.motion
    limits, fast, turn = motion.limits, motion.speed_mm_s, motion.speed_rad_s
    probe.go(motion.start_mm)
    for kind, target, speed, result in (
        (K.INSERT, limits.most_mm + 0.2, fast, R.DEPTH_BEYOND), (K.INSERT, limits.least_mm - 0.2, fast, R.DEPTH_BEYOND),
        (K.INSERT, motion.far_mm, 1.2 * fast, R.SPEED_BEYOND),
        (K.ROTATE, limits.roll_rad + 0.05, turn, R.ROLL_BEYOND),
        (K.ROTATE, -limits.roll_rad - 0.05, turn, R.ROLL_BEYOND),
        (K.ROTATE, motion.roll_rad + 0.1, 1.2 * turn, R.ROTATION_BEYOND),
        (K.INSERT, math.nan, fast, R.OUT_OF_RANGE), (K.INSERT, motion.far_mm, math.nan, R.OUT_OF_RANGE),
        (K.INSERT, motion.far_mm, 0.0, R.OUT_OF_RANGE), (K.INSERT, motion.far_mm, -fast, R.OUT_OF_RANGE),
    ):  # fmt: skip
        probe.expect(probe.command(kind, target, speed), result)
    probe.stays("a refused motion")


def insert(bench: RobotBench) -> None:
    """INSERT moves at its speed to its target; MOVING is set until the needle is there."""
    probe = bench.ready()
    motion = bench.motion
    probe.go(motion.start_mm)
    command = probe.command(K.INSERT, motion.far_mm, motion.speed_mm_s)
    probe.expect(command)
    on_the_way = probe.listen(bench.motion.seconds + 0.2)
    heard = [status for status in on_the_way if status.head.number == command.head.number]
    require(bool(heard), "no status has the number of the accepted command")
    short = [status for status in heard if abs(status.depth_mm - motion.far_mm) > 0.5]
    require(all(status.moving for status in short), "MOVING is not set on the way")
    most = max(
        (
            abs(b.depth_mm - a.depth_mm) * 1e9 / (b.head.sent_ns - a.head.sent_ns)
            for a, b in zip(heard, heard[50:], strict=False)
        ),
        default=0.0,
    )
    require(most <= 1.3 * motion.speed_mm_s, f"moves at {most:.1f} mm/s instead of {motion.speed_mm_s:.1f}")
    probe.go(motion.start_mm)


def rotate(bench: RobotBench) -> None:
    """ROTATE moves the roll, not the depth, to its target."""
    probe = bench.ready()
    motion = bench.motion
    for target in (motion.roll_rad + 0.1, motion.roll_rad):
        depth_mm = probe.last.depth_mm
        probe.expect(probe.command(K.ROTATE, target, motion.speed_rad_s))
        probe.listen(0.4)
        require(
            abs(probe.last.roll_rad - target) < 0.05, f"is at {probe.last.roll_rad:.3f} rad instead of {target:.3f}"
        )
        require(abs(probe.last.depth_mm - depth_mm) < 0.1, "moves the depth, too")


def redirect(bench: RobotBench) -> None:
    """A motion during a motion replaces its target."""
    probe = bench.ready().depart()
    motion = bench.motion
    probe.go(motion.start_mm)


def standing(bench: RobotBench) -> None:
    """STANDING is set at rest, and not before the measured positions have stood for 50 ms."""
    probe = bench.ready()
    probe.listen(0.2)
    require(bool(probe.last.standing), "is not set at rest")
    probe.depart(0.2)
    require(not probe.last.standing, "is set during a motion")
    probe.stop()
    probe.listen(0.15)
    require(bool(probe.last.standing), "is not set after a STOP")
    moved_ns = max(
        (b.head.sent_ns for (_, a), (_, b) in pairwise(probe.statuses) if abs(b.depth_mm - a.depth_mm) > 0.001),
        default=0,
    )
    early = [status for _, status in probe.statuses if 0 <= status.head.sent_ns - moved_ns < 1e9 * _STANDS_S]
    require(not any(status.standing for status in early), f"is set within {_STANDS_S:g} s of the last motion")


def stop(bench: RobotBench) -> None:
    """STOP, without a deadline, stops a motion: the needle is measured at rest within its braking distance."""
    bench.ready().depart().stop()


def stop_overtaken(bench: RobotBench) -> None:
    """A STOP that a heartbeat has overtaken stops the needle."""
    probe = bench.ready().depart()
    stop = probe.timeless(K.STOP)
    probe.post(probe.command(K.ALIVE, number=0))
    probe.post(stop)
    probe.rests("a STOP that a heartbeat has overtaken", bench.motion.speed_mm_s)


def stop_in_rotation(bench: RobotBench) -> None:
    """STOP stops a rotation."""
    probe = bench.ready()
    motion = bench.motion
    probe.expect(probe.command(K.ROTATE, motion.roll_rad + 0.19, 0.25))
    probe.listen(0.15)
    probe.expect(probe.timeless(K.STOP))
    probe.rests("STOP")
    require(probe.last.roll_rad - motion.roll_rad < 0.15, "rotates on after STOP")
    probe.expect(probe.command(K.ROTATE, motion.roll_rad, motion.speed_rad_s))
    probe.listen(0.3)


def stop_repeated(bench: RobotBench) -> None:
    """Many STOP, with numbers of their own and repeated, are all accepted, and are no fault."""
    probe = bench.ready().depart()
    stops = [probe.timeless(K.STOP) for _ in range(20)]
    for stop in stops:
        probe.post(stop)
        probe.post(stop)
    probe.rests("STOP", bench.motion.speed_mm_s)
    require(probe.last.state is RobotState.ENABLED, f"is {probe.last.state.name} instead of ENABLED")
    accepted = {
        answer.head.number for answer in probe.answers if answer.asked == K.STOP and answer.result is R.ACCEPTED
    }
    require(stops[-1].head.number in accepted, "the last STOP is not accepted")


def stop_under_load(bench: RobotBench) -> None:
    """STOP stops the needle among 600 damaged, repeated and foreign datagrams."""
    probe = bench.ready().depart(0.08)
    alive = encode(probe.command(K.ALIVE, number=0), probe.seal)
    flood = (alive, alive[:-1] + bytes([alive[-1] ^ 1]), bytes(1400))
    for datagram in flood * 100:
        probe.post(datagram)
    stop = probe.timeless(K.STOP)
    probe.post(stop)
    for datagram in flood * 100:
        probe.post(datagram)
    probe.expect(replace(stop, head=probe.head(stop.head.number)))
    probe.rests("STOP", bench.motion.speed_mm_s)


def stop_in_every_state(bench: RobotBench) -> None:
    """STOP is accepted while DISABLED and in FAULT."""
    probe = bench.probe()
    probe.expect(probe.hello())
    probe.expect(probe.timeless(K.STOP))
    bench.foreign_stop().close()
    probe.ends_in_fault(Fault.FOREIGN_STOP, "STOP of another sender", 0.3)
    probe.expect(probe.timeless(K.STOP))


def foreign_stop(bench: RobotBench) -> None:
    """STOP with session 0 from any sender stops the needle, and changes the state to FAULT with FOREIGN_STOP."""
    probe = bench.ready().depart()
    bench.foreign_stop()
    probe.ends_in_fault(Fault.FOREIGN_STOP, "STOP of another sender", 0.1)


def witness(bench: RobotBench) -> None:
    """The sender of a STOP with session 0 gets statuses of session 0 for 0.5 s, with the number of its STOP."""
    probe = bench.ready()
    other = bench.foreign_stop()
    heads = [status.head for status in other.listen(0.4, alive=False)]
    require(len(heads) >= 40, f"{len(heads)} statuses in 0.4 s")
    require({(head.session, head.number) for head in heads} == {(0, other.number)}, "another session or number")
    require(all(a.sequence < b.sequence for a, b in pairwise(heads)), "they are not counted")
    probe.listen(0.4)
    other.listen(0.05, alive=False)
    require(not other.listen(0.2, alive=False), "they do not end")


def latch(bench: RobotBench) -> None:
    """FAULT latches: only RESET leads to DISABLED, and neither RESET nor ENABLE resumes a motion."""
    probe = bench.ready().depart()
    motion = bench.motion
    bench.foreign_stop()
    probe.ends_in_fault(Fault.FOREIGN_STOP, "STOP of another sender", 0.3)
    for message in (
        probe.command(K.ENABLE), probe.command(K.HOME), probe.command(K.INSERT, motion.far_mm, motion.speed_mm_s)
    ):  # fmt: skip
        probe.expect(message, R.IN_FAULT)
    probe.expect(probe.command(K.RESET))
    probe.expect(probe.command(K.INSERT, motion.far_mm, motion.speed_mm_s), R.NOT_ENABLED)
    probe.expect(probe.command(K.ENABLE))
    probe.stays("RESET and ENABLE")


def watchdog(bench: RobotBench) -> None:
    """Without a datagram for `silence_us` during a motion, the needle stops in FAULT with WATCHDOG, and not earlier."""
    probe = bench.probe()
    probe.silence_s = 2 * _WATCHDOG_S
    probe.enable().depart()
    probe.listen(_WATCHDOG_S, alive=False)
    require(
        probe.last.state is RobotState.ENABLED, f"stops within {_WATCHDOG_S:g} s of silence, half of what was asked"
    )
    probe.ends_in_fault(Fault.WATCHDOG, "silence", _WATCHDOG_S + _LATE_S)


def repeated_heartbeat(bench: RobotBench) -> None:
    """A heartbeat that arrives again is no sign of life."""
    probe = bench.probe()
    probe.silence_s = _WATCHDOG_S
    alive = probe.enable().depart().command(K.ALIVE, number=0)
    _unfed(probe, "repeated heartbeats", lambda: alive)


def repeated_hello(bench: RobotBench) -> None:
    """HELLO of the session that arrives again is no sign of life, and changes no answer to a repeated command."""
    probe = bench.probe()
    probe.silence_s = _WATCHDOG_S
    hello = probe.hello()
    probe.expect(hello)
    for kind in (K.RESET, K.ENABLE):
        probe.expect(probe.command(kind))
    probe.post(hello)
    probe.expect(probe.command(K.ENABLE, number=probe.number))
    probe.depart()
    _unfed(probe, "repeated HELLO", lambda: hello)


def late_heartbeat(bench: RobotBench) -> None:
    """A heartbeat after its deadline is no sign of life."""
    probe = bench.probe()
    probe.silence_s = _WATCHDOG_S
    probe.enable().depart()
    _unfed(probe, "late heartbeats", lambda: probe.command(K.ALIVE, number=0, valid_s=-0.05))


def goodbye(bench: RobotBench) -> None:
    """GOODBYE during a motion stops the needle, disables the robot, and releases it at once."""
    probe = bench.ready().depart()
    probe.expect(probe.command(K.GOODBYE))
    other = bench.probe()
    other.expect(other.hello())
    other.rests("GOODBYE", bench.motion.speed_mm_s)
    require(other.last.state is RobotState.DISABLED, f"is {other.last.state.name} instead of DISABLED")


def restart(bench: RobotBench) -> None:
    """After a controller has died during a motion, the next one gets BUSY for 5 s, then a robot in FAULT at rest."""
    dead = bench.probe()
    dead.silence_s = _WATCHDOG_S
    begun_mm = dead.enable().depart(0.05).last.depth_mm
    other = bench.probe()
    other.expect(other.hello(), R.BUSY)
    begun_ns = other.clock.now_ns()
    require(other.is_released(), "is not released 6 s after its controller has died")
    kept_s = (other.clock.now_ns() - begun_ns) / 1e9
    require(kept_s > _BUSY_S, f"is released {kept_s:.1f} s after its controller has died")
    other.rests("the death of its controller")
    moved_mm = abs(other.last.depth_mm - begun_mm)
    require(other.last.state is RobotState.FAULT, f"is {other.last.state.name} instead of FAULT")
    require(moved_mm < 0.6 * abs(bench.motion.far_mm - bench.motion.start_mm) + 0.5,
            f"has moved on by {moved_mm:.2f} mm")  # fmt: skip
