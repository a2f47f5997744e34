"""`needleplan retract`: a person moves the needle out without an insertion."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, print_json, print_summary
from needleplan.cli.estop import MOVES, EmergencyStop, add_estop, alarm, not_at_rest, require_estop
from needleplan.cli.interrupt import handled_signals, needle_measured, needle_moves
from needleplan.cli.options import add_answer, add_limits, require_rules, safety_limits
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.stopping import Rest

if TYPE_CHECKING:
    from needleplan.bystander import StopOutcome
    from needleplan.control import RetractionReport
    from needleplan.control.safety import SafetyLimits

__all__ = ["add_to", "run"]

# Exit codes: refused before anything moved, or the stage cannot be reached; stopped, for example by Ctrl-C.
_REFUSED, _INTERRUPTED = 2, 130
# longest time (s) until the needle rests, before the retraction
_STOP_S = 2.0


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "retract",
        help="pull the needle out, by order of a person",
        description="Pull the needle out to a depth, also after a fault or a crash of `insert`, without force sensor "
        "and tracker. The needle is stopped first, whoever moves it. Ctrl-C stops the needle. Exit code 1: it stopped "
        "before the depth; 2: refused, nothing moved; 3: the needle moves, or its rest is unknown.",
    )
    parser.add_argument(
        "--robot",
        required=True,
        metavar="URL",
        help="address of the robot: udp://, serial:// or canopen://, as for `insert`",
    )
    parser.add_argument("--depth", type=float, default=0.0, metavar="MM", help="depth to retract to, mm (default: 0)")
    parser.add_argument(
        "--speed", type=float, default=5.0, metavar="MM_S", help="speed of the retraction, mm/s (default: 5)"
    )
    add_limits(parser)
    parser.add_argument(
        "--hold-to-run", nargs="?", const="key", metavar="SWITCH",
        help="move only while a key of this terminal is held, or "
        "a switch: udp://HOST:PORT?key_file=FILE, evdev:///dev/input/eventN",
    )  # fmt: skip
    parser.add_argument(
        "--anyway", action="store_true", help="pull the needle out also if it was not measured at rest after the stop"
    )
    add_estop(parser)
    parser.add_argument("--by", default="", metavar="NAME", help="name of the person who gives the order")
    parser.add_argument(
        "--wait", type=float, default=10.0, metavar="S",
        help="longest time to wait until the robot accepts a controller, s (default: 10; after a crash it takes "
        "about 5 s)",
    )  # fmt: skip
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run `needleplan retract` and return the exit code.

    0: the depth is reached; 1: stopped by a fault; 2: refused, or the stage cannot be used; 3: the needle moves, or its
    rest is unknown; 130: stopped by a person. Raises InputError (AddressError and others) for wrong options and files.
    """
    from needleplan.control import Retraction, open_deadman, open_stage_patiently
    from needleplan.devices import halt, stop_stage

    limits = safety_limits(options)
    _require_numbers(options, limits)
    hook = require_estop(options.estop)
    report: RetractionReport | None = None
    with ExitStack() as signals:
        try:
            with ExitStack() as stack:
                stack.callback(hook.finish)
                switch = options.hold_to_run
                deadman = stack.enter_context(open_deadman(switch, "--hold-to-run")) if switch else None
                if is_shared := options.robot.strip().startswith(("udp:", "serial:")):
                    # Nobody has to have control for this stop, and it ends the run of another controller.
                    _require_rest(options, hook, lambda tell: stop_stage(options.robot, _STOP_S, tell))
                stage = open_stage_patiently(options.robot, options.wait, _note_waiting)
                stack.callback(stage.close)
                if not is_shared:
                    _require_rest(options, hook, lambda tell: halt(stage, _STOP_S, tell))
                retraction = Retraction(
                    stage, options.depth, options.speed, limits=limits, by=options.by, deadman=deadman,
                    accepted_limits=options.accept_limits or "", on_alarm=lambda rest: alarm(rest, hook),
                )  # fmt: skip
                if deadman is not None:
                    note("hold the switch to move; Ctrl-C ends the retraction")
                # Until the answer is printed: while the needle moves, no signal may end the program with its own code.
                signals.enter_context(handled_signals(lambda _: retraction.stop()))
                report = retraction.run()
        except _NotAtRest as refusal:
            complain(f"{refusal}; nothing was moved by this command (--anyway pulls the needle out all the same)")
            return MOVES
        except MotionRefused as refusal:
            complain(f"{refusal}; nothing was moved")
            return MOVES if hook.alarms else _REFUSED
        except DeviceFault as fault:
            complain(str(fault))
            return MOVES if hook.alarms else _REFUSED
        except KeyboardInterrupt:
            if not hook.alarms:
                raise
            complain("interrupted; the needle was not measured at rest: use the emergency stop")
            return MOVES
        finally:
            if hook.alarms if report is None else report.rest is not Rest.RESTS:
                needle_moves()
        return _answer(options, report)


def _answer(options: argparse.Namespace, report: RetractionReport) -> int:
    from needleplan.control import RetractionOutcome

    if options.json:
        print_json(
            {"ending": report.outcome, "cause": report.cause, "began_mm": report.began_mm, "ended_mm": report.ended_mm,
             "rest": report.rest}
        )  # fmt: skip
    else:
        way = f"from {_depth(report.began_mm)} to {_depth(report.ended_mm)}"
        print_summary(options, options.robot, {"ended": f"{report.outcome}: {report.cause}", "path": way})
    if report.outcome is not RetractionOutcome.REACHED:
        complain(f"{report.outcome}: {report.cause}")
    if report.rest is not Rest.RESTS:
        complain(f"{not_at_rest(report.rest)} at the end of the retraction; use the emergency stop")
        return MOVES
    if report.outcome is RetractionOutcome.REACHED:
        return 0
    return _INTERRUPTED if report.outcome is RetractionOutcome.STOPPED else 1


class _NotAtRest(Exception):
    """The needle was not measured at rest, and the person has not said `--anyway`."""


def _note_waiting(why: str) -> None:
    note(f"waiting for the robot: {why}")


def _require_rest(
    options: argparse.Namespace, hook: EmergencyStop,
    stop: Callable[[Callable[[StopOutcome], object]], StopOutcome],
) -> None:  # fmt: skip
    """Stop the needle by `stop`, which gets a function for its alarms.

    Raises _NotAtRest if the needle was not measured at rest, unless the person pulls anyway. Signals that arrive
    meanwhile want the same as the command does now; then raises KeyboardInterrupt, if the needle rests.
    """
    interrupted: list[str] = []
    with handled_signals(interrupted.append):
        try:
            outcome = stop(lambda outcome: alarm(outcome.rest, hook))
            why = "" if outcome.is_confirmed else outcome.why_not(options.robot)
        except DeviceFault as fault:
            why = str(fault)
    hook.alarms = 1 if why else 0
    if not why:
        needle_measured()
    if why and (interrupted or not options.anyway):
        raise _NotAtRest(why)
    if interrupted:
        raise KeyboardInterrupt


def _require_numbers(options: argparse.Namespace, limits: SafetyLimits) -> None:
    """Raise InputError for numbers that the guard would refuse only after the stage is opened."""
    from needleplan.config import Number

    require_rules(options, {
        "--depth": Number("mm, within the limits,", at_least=limits.shallowest_mm, at_most=limits.deepest_mm),
        "--speed": Number("mm/s, within the limits,", above=0, at_most=limits.retraction_velocity_mm_s),
        "--wait": Number("s", at_least=0),
    })  # fmt: skip


def _depth(depth_mm: float | None) -> str:
    return "an unknown depth" if depth_mm is None else f"{depth_mm:.2f} mm"
