"""Rules of the robot protocol about datagrams, sessions and states. The docstring of a function is the rule."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

from needleplan.devices.robot._bench import RobotBench
from needleplan.devices.robot._codes import Fault, Result, RobotKind, RobotState
from needleplan.devices.robot._probe import require, sealed
from needleplan.devices.robot.messages import OLDEST_VERSION, VERSION, MotionLimits, encode

__all__ = [
    "busy", "damaged", "echo", "hello", "homed", "key", "missed", "not_enabled", "other_version", "sessions",
    "statuses", "version_2", "wide_limits", "wrap",
]  # fmt: skip

K, R = RobotKind, Result
_WRAP = 1 << 32


def hello(bench: RobotBench) -> None:
    """The answer to HELLO repeats its session, number and sending time."""
    probe = bench.probe()
    hello = probe.hello()
    probe.expect(hello)
    head = probe.answers[-1].head
    require((head.session, head.number) == (hello.head.session, hello.head.number), "has another session or number")
    require(head.echo_ns == hello.head.sent_ns, f"echo_ns is {head.echo_ns} instead of {hello.head.sent_ns}")


def statuses(bench: RobotBench) -> None:
    """The controller gets 500 statuses or 200 compact ones per second, or more, numbered, with times that increase."""
    probe = bench.probe()
    probe.expect(probe.hello())
    statuses = probe.listen(0.3)
    heads = [status.head for status in statuses]
    pairs = list(pairwise(heads))
    require(bool(pairs), "sends no statuses")
    require(all(0 < (b.sequence - a.sequence) % _WRAP < 1000 for a, b in pairs), "`sequence` does not count statuses")
    require(all(a.sent_ns < b.sent_ns for a, b in pairs), "`sent_ns` does not increase")
    rate = (heads[-1].sequence - heads[0].sequence) % _WRAP * 1e9 / (heads[-1].sent_ns - heads[0].sent_ns)
    require(rate >= (200 if statuses[-1].compact else 500), f"sends {rate:.0f} statuses per second")


def echo(bench: RobotBench) -> None:
    """A status repeats the sending time of the last received datagram, and states the time since its arrival."""
    probe = bench.ready()
    alive = probe.command(K.ALIVE, number=0)
    probe.post(alive)
    probe.listen(0.25, alive=False)
    (arrived_ns, status), sent_ns = probe.statuses[-1], alive.head.sent_ns
    require(status.head.echo_ns == sent_ns, f"echo_ns is {status.head.echo_ns} instead of {sent_ns}")
    round_ms = (arrived_ns - sent_ns) / 1e6 - status.head.held_us / 1e3
    require(-1 <= round_ms < 150, f"held_us is {status.head.held_us}: a round trip of {round_ms:.0f} ms")


def missed(bench: RobotBench) -> None:
    """`missed` counts the datagrams that did not arrive."""
    probe = bench.ready()
    probe.listen(0.02)
    before = probe.last.missed
    probe.sequence = (probe.sequence + 3) % _WRAP
    probe.listen(0.05)
    counted = probe.last.missed - before
    require(counted >= 3, f"counts {counted} of 3")


def damaged(bench: RobotBench) -> None:
    """A datagram with a wrong checksum, a wrong size, or of an unknown kind is dropped."""
    probe = bench.probe()
    probe.expect(probe.hello())
    probe.expect(probe.command(K.RESET))
    good = encode(probe.command(K.ENABLE), probe.seal)
    number, body = probe.number, good[:-4]
    for bad in (
        good[:-1] + bytes([good[-1] ^ 1]), good[:20], sealed(body[:-8]), sealed(body + bytes(8)), b"NPLR",
        sealed(body[:5] + b"\x33" + body[6:]), sealed(b"XPLR" + body[4:]), bytes(1400),
    ):  # fmt: skip
        probe.post(bad)
    probe.listen(0.1)
    require(all(answer.head.number != number for answer in probe.answers), "answers a damaged ENABLE")
    require(probe.last.state is RobotState.DISABLED, "executes a damaged ENABLE")
    probe.expect(probe.command(K.ENABLE))


def other_version(bench: RobotBench) -> None:
    """A datagram of an unknown version is answered with WRONG_VERSION, unless a robot has sent it."""
    probe = bench.probe()
    hello = encode(probe.hello())
    for kind, answers in ((K.HELLO, True), (K.STATUS, False)):
        before = probe.other_versions + sum(answer.result is R.WRONG_VERSION for answer in probe.answers)
        probe.post(sealed(hello[:4] + bytes([99, kind]) + hello[6:-4]))
        probe.listen(0.1, alive=False)
        after = probe.other_versions + sum(answer.result is R.WRONG_VERSION for answer in probe.answers)
        require(
            (after > before) == answers, f"{kind.name} of version 99 {'is' if after > before else 'is not'} answered"
        )


def version_2(bench: RobotBench) -> None:
    """HELLO of version 2 begins a session of version 2, whose `flags` has no HOMED and no STANDING."""
    probe = bench.probe()
    probe.expect(probe.hello(version=OLDEST_VERSION))
    heard = probe.listen(0.1, alive=False)
    require(bool(heard), f"sends no status that version {OLDEST_VERSION} permits")
    require({status.head.version for status in heard} == {OLDEST_VERSION}, f"sends statuses of version {VERSION}")


def busy(bench: RobotBench) -> None:
    """A second controller gets BUSY, also if it uses the session of the first one."""
    probe, other = bench.probe(), bench.probe()
    probe.expect(probe.hello())
    other.expect(other.hello(), R.BUSY)
    other.session, other.sequence, other.number = probe.session, 1000, 1000
    other.expect(other.hello(), R.BUSY)
    other.seal = other.answered = probe.seal
    other.statuses = [(other.clock.now_ns(), probe.last)]
    other.expect(other.command(K.ENABLE), R.BUSY)
    probe.listen(0.02)
    require(probe.last.state is RobotState.DISABLED, "executes a command of another sender")
    other.session = 0
    probe.expect(probe.command(K.ENABLE))


def sessions(bench: RobotBench) -> None:
    """Commands of a session that has ended or never began, and HELLO of an ended session or of 0, get OLD_SESSION."""
    probe = bench.probe()
    probe.expect(probe.command(K.ENABLE), R.OLD_SESSION)
    probe.expect(probe.hello(session=0), R.OLD_SESSION)
    probe.expect(probe.hello())
    probe.expect(probe.command(K.GOODBYE))
    probe.seal = probe.seal and replace(probe.seal, nonce=0)
    probe.expect(probe.hello(), R.OLD_SESSION)
    probe.expect(probe.command(K.ENABLE), R.OLD_SESSION)


def key(bench: RobotBench) -> None:
    """Without the tag of the key and of the session, datagrams get NOT_AUTHENTIC; STOP with session 0 needs no tag."""
    probe = bench.probe()
    probe.key = probe.seal = None
    probe.expect(probe.hello(), R.NOT_AUTHENTIC)
    probe.key = bench.key
    probe.enable()
    seal, probe.seal = probe.seal, probe.seal and replace(probe.seal, nonce=0)
    probe.expect(probe.command(K.RESET), R.NOT_AUTHENTIC)
    probe.seal = None
    probe.expect(probe.command(K.RESET), R.NOT_AUTHENTIC)
    probe.seal = seal
    bench.foreign_stop().close()
    probe.ends_in_fault(Fault.FOREIGN_STOP, "STOP without a tag", 0.3)


def wrap(bench: RobotBench) -> None:
    """Counters begin anywhere and wrap at 2^32."""
    probe = bench.probe()
    probe.sequence = probe.number = _WRAP - 3
    probe.enable()
    probe.expect(probe.command(K.RESET))
    probe.expect(probe.command(K.ENABLE))
    require(probe.number < 10, "the counters have not wrapped")
    probe.expect(probe.command(K.ENABLE, number=_WRAP - 1), R.SUPERSEDED)
    probe.depart(1.5 * probe.silence_s)
    require(probe.last.state is RobotState.ENABLED, "takes heartbeats after the wrap for no sign of life")


def not_enabled(bench: RobotBench) -> None:
    """Without ENABLE, a motion gets NOT_ENABLED; a late ENABLE gets LATE."""
    probe = bench.probe()
    motion = bench.motion
    for kind in (K.HELLO, K.RESET):
        probe.expect(probe.hello() if kind is K.HELLO else probe.command(kind))
    probe.expect(probe.command(K.ENABLE, valid_s=-0.002), R.LATE)
    probe.expect(probe.command(K.INSERT, motion.far_mm, motion.speed_mm_s), R.NOT_ENABLED)
    probe.stays("a motion without ENABLE")


def wide_limits(bench: RobotBench) -> None:
    """HELLO with limits wider than those of the robot is refused with the limit, and begins no session."""
    for limits, result in (
        (MotionLimits(-1e9, 1e9), R.DEPTH_BEYOND), (MotionLimits(speed_mm_s=1e9), R.SPEED_BEYOND),
        (MotionLimits(roll_rad=1e9), R.ROLL_BEYOND), (MotionLimits(rotation_rad_s=1e9), R.ROTATION_BEYOND),
        (MotionLimits(valid_us=_WRAP - 1), R.DEADLINE_BEYOND), (MotionLimits(speed_mm_s=math.nan), R.OUT_OF_RANGE),
    ):  # fmt: skip
        probe = bench.probe()
        probe.expect(probe.hello(limits), result)
        probe.session = 0
    probe = bench.probe()
    probe.expect(probe.hello())


def homed(bench: RobotBench) -> None:
    """HOME and UNHOME set and clear HOMED, which persists after the session."""
    probe = bench.ready()
    for kind, homed in ((K.UNHOME, False), (K.HOME, True), (K.UNHOME, False)):
        probe.expect(probe.command(kind))
        probe.listen(0.02)
        require(probe.last.homed is homed, f"HOMED is {probe.last.homed} after {kind.name}")
    probe.expect(probe.command(K.GOODBYE))
    other = bench.ready()
    other.listen(0.02)
    require(other.last.homed is False, "HOMED is set in the next session")
