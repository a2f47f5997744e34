"""Conformance of a robot: every rule of the robot protocol, tried on the robot itself.

The robot moves between its present depth and a depth that a person has permitted, and every session asks for limits
that allow no other motion.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from enum import StrEnum

from needleplan.artifacts import CallRepr
from needleplan.devices._links import Link
from needleplan.devices._opening import Address, open_link
from needleplan.devices.robot import _motion_rules, _session_rules
from needleplan.devices.robot._bench import RobotBench
from needleplan.devices.robot._codes import RobotKind
from needleplan.devices.robot._probe import RobotAstray, RuleBroken
from needleplan.devices.robot._stage import read_key
from needleplan.devices.robot._way import RobotWay, open_way
from needleplan.errors import DeviceFault, LinkClosed

__all__ = ["CASES", "ConformanceCase", "ConformanceVerdict", "RobotBench", "open_bench", "try_cases"]

CASES: dict[str, Callable[[RobotBench], None]] = {
    name.replace("_", "-"): case
    for rules in (_session_rules, _motion_rules)
    for name, case in vars(rules).items()
    if name in rules.__all__
}
"""Functions that try one rule each, by name; they raise DeviceFault if the robot breaks it."""


class ConformanceVerdict(StrEnum):
    """Outcome of a case."""

    HOLDS = "holds"
    BROKEN = "broken"
    OMITTED = "omitted"
    """The case does not apply, or the test was given up before."""


@dataclass(frozen=True)
class ConformanceCase(CallRepr):
    """Result of one test: a rule of the protocol, the verdict, and what a robot did that breaks the rule."""

    name: str
    rule: str
    verdict: ConformanceVerdict
    found: str = ""


def try_cases(bench: RobotBench, only: Collection[str] = ()) -> Iterator[ConformanceCase]:
    """Try all cases, or those in `only`, and yield each outcome.

    At the end, the robot moves back to the depth at the start, its HOMED is restored, and `bench.rests` tells whether
    the needle rests.
    """
    gave_up = ""
    for name, case in CASES.items():
        if only and name not in only:
            continue
        rule, deviation = " ".join((case.__doc__ or "").split()), ""
        if gave_up or (name == "key" and bench.key is None):
            yield ConformanceCase(name, rule, ConformanceVerdict.OMITTED, gave_up or "the robot has no key")
            continue
        try:
            with bench.closing():
                case(bench)
        except RobotAstray as astray:
            deviation = gave_up = str(astray)
        except DeviceFault as broken:
            deviation = str(broken)
            try:
                with bench.closing():
                    if not bench.probe().is_released():
                        gave_up = "the robot gave no control for 6 s after a broken rule: the test was given up"
            except LinkClosed as closed:
                gave_up = str(closed)
        yield ConformanceCase(
            name, rule, ConformanceVerdict.BROKEN if deviation else ConformanceVerdict.HOLDS, deviation
        )
    bench.rests = False
    with bench.closing(), contextlib.suppress(DeviceFault):
        probe = bench.ready()
        probe.ask(probe.command(RobotKind.HOME if bench.was_homed else RobotKind.UNHOME))
        if not gave_up:
            with contextlib.suppress(RuleBroken):
                probe.go(bench.motion.start_mm)
        probe.rests("the test")
        bench.rests = True


def open_bench(address: str, may_move_mm: float) -> RobotBench:
    """Return the bench of the robot at `udp://host[:5005]` or `serial:///dev/ttyUSB0[?baud=460800]`.

    Both may have the option `key_file`. Raises AddressError and DeviceFault.
    """
    way = open_way(address, ("key_file",))
    try:
        options = way.address.options
        key = read_key(options["key_file"]) if "key_file" in options else None
        return RobotBench(lambda: _link(way), may_move_mm, key, way=way)
    except BaseException as error:
        hint = way.hint
        way.close()
        if hint and isinstance(error, DeviceFault):
            raise DeviceFault(f"{error}; {hint}") from error
        raise


def _link(way: RobotWay) -> Link:
    if way.failure:
        raise LinkClosed(f"robot: {way.failure}")
    return open_link(Address("udp", way.host, way.port))
