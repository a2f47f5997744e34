"""The answer of `needleplan insert`, and its exit code."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from needleplan.cli.answer import complain, note, print_json, print_summary
from needleplan.cli.estop import MOVES, not_at_rest
from needleplan.cli.insert_plan import InsertPlan
from needleplan.cli.uncertainty import promise_record
from needleplan.stopping import Rest

if TYPE_CHECKING:
    from needleplan.control import InsertionReport
    from needleplan.models.path import Vector

__all__ = ["answer_insertion", "exit_code"]

# Exit codes: refused before anything moved; stopped, for example by Ctrl-C.
_REFUSED, _INTERRUPTED = 2, 130


def answer_insertion(
    plan: InsertPlan,
    report: InsertionReport,
    true: tuple[Vector, Vector] | None,
    options: argparse.Namespace,
    recording: Path | None,
) -> int:
    """Print the result of an insertion, write its figures, and return the exit code.

    `true` holds the true positions (mm) of tip and target in a simulated lab; None for real devices. `recording` is the
    path of the finished recording or of its partial file; None if nothing was recorded.
    """
    true_tip, true_target = true or (None, None)
    more_true = plan.true_record(*true) if true else {"true_error_mm": None}
    in_space = math.dist(*true) if true else None
    if recording:
        note(f"wrote {recording}")
    if options.figure:
        from needleplan.plotting import save

        save(plan.figure(report, true_tip), options.figure)
        note(f"drew {options.figure}")
    if options.vtp:
        from needleplan.artifacts import write_whole

        write_whole(options.vtp, plan.vtp(report))
        note(f"wrote {options.vtp}")
    success = plan.success() if report.steps else None
    if options.json:
        accepted = {"accepted_limits": options.accept_limits} if options.accept_limits else {}
        promise = {**success.record(), "predicted_success": success.value} if success else {}
        promise |= promise_record(plan.promise)
        print_json({**report.record(), **promise, **plan.record(report), **accepted, **more_true,
                    "true_error_in_space_mm": in_space,
                    "true_tip_mm": true_tip and list(true_tip),
                    "true_target_mm": true_target and list(true_target), "recording": recording and str(recording),
                    "figure": options.figure})  # fmt: skip
    else:
        lines = {
            "ended": f"{report.outcome}: {report.cause}",
            "error": f"{report.error_in_space_mm:.2f} mm from the centre of the target ({plan.errors(report)}), "
            f"{report.beyond_rim_mm:.2f} mm beyond its rim"
            + ("" if in_space is None else f"; in truth {in_space:.2f} mm from the centre"),
            "path": f"{report.inserted_mm:.1f} mm in {len(report.steps)} steps, {report.turns} turns",
            "plan": f"success {success}; replanned {report.replans} times"
            if success else "nothing was decided",
        }  # fmt: skip
        more = {
            "deviation": plan.deviations(report),
            "force": f"at most {report.largest_force_n:.2f} N",
            "time": f"{report.duration_s:.1f} s",
        }
        print_summary(options, plan.table.scenario.title or options.table, lines, more)
    code = exit_code(report)
    if code:
        complain(f"{report.outcome}: {report.cause}")
    if code == MOVES:
        complain(f"{not_at_rest(report.rest)} at the end of the run; use the emergency stop")
    return code


def exit_code(report: InsertionReport) -> int:
    """Return the exit code of a run.

    The code is `MOVES`, for any outcome, if the needle was not measured at rest at the end. For a refused run, which
    commands no motion, it is `MOVES` only if the needle was measured in motion.
    """
    from needleplan.control import InsertionOutcome

    # A run that was refused has not moved the needle; without a measured position, it says nothing of the needle.
    is_ours = report.outcome is not InsertionOutcome.REFUSED or report.rest is Rest.MOVES
    if is_ours and report.rest is not Rest.RESTS:
        return MOVES
    codes = {InsertionOutcome.TARGET: 0, InsertionOutcome.REFUSED: _REFUSED, InsertionOutcome.STOPPED: _INTERRUPTED}
    return codes.get(report.outcome, 1)
