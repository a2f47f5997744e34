"""`needleplan check-robot`: whether a robot keeps the rules of the robot protocol."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, print_json
from needleplan.cli.estop import MOVES
from needleplan.cli.interrupt import needle_measured, needle_moves, needle_unmeasured
from needleplan.cli.options import add_answer
from needleplan.errors import AddressError, DeviceFault, InputError, Mistake

if TYPE_CHECKING:
    from needleplan.devices.robot.conformance import RobotBench

__all__ = ["add_to"]


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "check-robot",
        help="test whether a robot keeps the rules of the robot protocol",
        description="Try every rule of the robot protocol on a robot: heartbeats, deadlines, limits, STOP under load, "
        "lost and repeated datagrams, restart of the controller. Takes half a minute. The needle moves: take it out of "
        "everything, and stand at the emergency stop. Exit code 1: a rule is broken; 3: the needle moves, or its rest "
        "is unknown.",
    )
    parser.add_argument(
        "address", metavar="ADDRESS",
        help="address of the robot: udp://HOST[:PORT][?key_file=FILE], or serial:///dev/ttyUSB0[?baud=460800]",
    )  # fmt: skip
    parser.add_argument(
        "--may-move", type=float, required=True, metavar="MM",
        help="how far the test may move the needle from its present depth, mm: 1 to 10, or -10 to -1 outwards; and "
        "0.2 rad to both sides",
    )  # fmt: skip
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="try this case; may be repeated")
    add_answer(parser, verbose=False)
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    from needleplan.config import suggestion
    from needleplan.devices.robot import stop_robot
    from needleplan.devices.robot.conformance import CASES, open_bench

    unknown = [Mistake("--only", name, f"is not a case{suggestion(name, CASES)}") for name in options.only
               if name not in CASES]  # fmt: skip
    if unknown:
        raise InputError(unknown)

    def stop() -> bool:
        try:
            return stop_robot(options.address).is_confirmed
        except DeviceFault:
            return False

    try:
        bench = open_bench(options.address, options.may_move)
    except AddressError as error:
        keys = {"may_move_mm": "--may-move"}
        raise AddressError(
            [replace(mistake, key=keys.get(mistake.key, mistake.key)) for mistake in error.mistakes]
        ) from None
    except DeviceFault as fault:
        hint = "" if "no answer" not in str(fault) else ": is a robot there, free, and with this key or none?"
        return complain(f"{str(fault) if options.address in str(fault) else f'{options.address}: {fault}'}{hint}")
    motion = bench.motion
    note(
        f"moves the needle from {motion.start_mm:.2f} mm to {motion.far_mm:.2f} mm, at most {motion.speed_mm_s:g} mm/s,"
        f" and by {motion.roll_range_rad:g} rad to both sides"
    )
    needle_unmeasured(stop)
    with bench:
        return _tried(options, bench)


def _tried(options: argparse.Namespace, bench: RobotBench) -> int:
    """Try the cases, print their outcomes, and return the exit code."""
    from needleplan.devices.robot.conformance import ConformanceVerdict, try_cases

    outcomes = []
    for case in try_cases(bench, options.only):
        outcomes.append(case)
        if not options.json:
            sign = {ConformanceVerdict.HOLDS: "ok", ConformanceVerdict.BROKEN: "--"}.get(case.verdict, "  ")
            found = f": {case.found}" if case.found else ""
            print(f"  {sign}  {case.name:<19} {case.rule.rstrip('.')}{found}", flush=True)
    (needle_measured if bench.rests else needle_moves)()
    broken = sum(case.verdict is ConformanceVerdict.BROKEN for case in outcomes)
    tried = sum(case.verdict is not ConformanceVerdict.OMITTED for case in outcomes)
    if options.json:
        print_json(
            {"rests": bench.rests, "tried": tried, "broken": broken, "cases": [asdict(each) for each in outcomes]}
        )
    else:
        print(f"{tried - broken} of {tried} rules hold")
    if not bench.rests:
        complain("the needle was not measured at rest: use the emergency stop")
        return MOVES
    return int(broken > 0)
