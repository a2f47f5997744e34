"""`needleplan register`: the transform from tracker to plan coordinates, for a needle that it calibrates.

Options of the commands that read poses of a tracked needle: columns, noise of the tracker, acceptance.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, print_json, print_summary, working
from needleplan.cli.options import add_answer, add_output, numbers, require_outputs, require_rules
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.estimation.registration import Pivot, PoseNoise, Registered, RegistrationVerdict

__all__ = ["add_poses", "add_to", "pivot_lines", "pivot_record", "pose_noise", "run", "verdict_record"]


def add_poses(parser: argparse.ArgumentParser) -> None:
    """Declare `--rest` and `--noise-mm`, the noise of the tracker; `--columns`; and `--accept`."""
    noise = parser.add_mutually_exclusive_group()
    noise.add_argument("--rest", metavar="POSES", help="poses of the needle at rest, to measure the tracker's noise")
    noise.add_argument(
        "--noise-mm", type=float, metavar="MM", help="declared root mean square error of a position of the tracker, mm"
    )
    parser.add_argument(
        "--columns", action="append", metavar="MAP",
        help="columns and units of files of poses with other names, as in x=2[m],y=3[m],z=4[m],qw=8,qx=5,qy=6,qz=7",
    )  # fmt: skip
    parser.add_argument("--accept", metavar="REASON", help="accept what speaks against the result; the file records it")


def pose_noise(options: argparse.Namespace) -> PoseNoise | None:
    """Return the noise of the tracker that the options measure or declare; None if neither is given.

    Raises InputError for a noise that is not positive, a blank `--accept`, and files that do not show the noise.
    """
    from needleplan.config import Number
    from needleplan.estimation.registration import PoseNoise, noise_at_rest, read_poses

    if options.accept is not None and not options.accept.strip():
        raise InputError(Mistake("--accept", "", "must be a reason, as a text"))
    if options.noise_mm is not None:
        require_rules(options, {"--noise-mm": Number("mm", above=0)})
        return PoseNoise(options.noise_mm)
    return noise_at_rest(read_poses(options.rest, options.columns), options.rest) if options.rest else None


def pivot_lines(pivot: Pivot) -> dict[str, str]:
    """Return the lines of a summary about the calibration of a coil."""
    turned = (
        f"{pivot.poses} poses, spread {math.degrees(pivot.spread_rad):.1f} degrees, condition {pivot.condition:.3g}"
    )
    if not pivot.ok:
        return {"coil": pivot.status.value, "pivot": turned}
    offset = float(pivot.tip_mm[0])
    low, high = (float(limit[0]) for limit in pivot.interval_mm)
    behind = "its axis points to the tip" if offset >= 0 else "its axis points away from the tip"
    return {
        "coil": f"{abs(offset):.2f} mm behind the tip, +- {(high - low) / 2:.2f} mm (95 %); {behind}",
        "pivot": f"{turned}, residual {pivot.rms_mm:.2f} mm",
    }


def pivot_record(pivot: Pivot) -> dict[str, object]:
    """Return the JSON record of the calibration of a coil."""
    return {
        "poses": pivot.poses, "spread_rad": pivot.spread_rad, "condition": pivot.condition,
        "rms_mm": pivot.rms_mm, "offset_mm": float(pivot.tip_mm[0]), "offset_sd_mm": float(pivot.tip_sd_mm[0]),
        "interval_mm": [float(limit[0]) for limit in pivot.interval_mm], "outliers": pivot.outliers,
    }  # fmt: skip


def verdict_record(verdict: RegistrationVerdict) -> dict[str, object]:
    """Return the JSON record of a verdict."""
    return {
        "status": verdict.status.value,
        "noise_mm": verdict.noise_mm or None,
        "noise_source": verdict.noise_source,
        "accepted": verdict.accepted,
        "reasons": verdict.reasons,
    }


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "register",
        help="register the tracker to the plan",
        description="Compute the transform from the tracker to the plan from points in both frames, with the needle "
        "calibrated from the poses of --pivot, as `needleplan calibrate` does, and judge both. Exit code 1: refused, "
        "and no file is written.",
    )
    parser.add_argument("--pivot", required=True, metavar="POSES", help="poses of the coil while the needle pivots")
    parser.add_argument("--points", required=True, metavar="POINTS", help="points in both frames")
    add_poses(parser)
    parser.add_argument(
        "--points-columns", action="append", metavar="MAP",
        help="columns and units of a file of points with other names, as in tracker_x=Tx[m],plan_x=R",
    )  # fmt: skip
    add_output(parser, "REGISTRATION.toml", "write the registration")
    parser.add_argument(
        "--transform", metavar="FILE", help="write tracker to plan as a transform for 3D Slicer (.tfm, .h5)"
    )
    parser.add_argument("--target", metavar="X,Y[,Z]", help="target of the plan, mm: print the expected error there")
    parser.add_argument("--title", default="", metavar="TEXT", help="title of the registration file")
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 0 if the registration passed or was accepted, else 1."""
    from needleplan.anatomy import require_transform_name, transform_bytes
    from needleplan.artifacts import write_whole
    from needleplan.estimation.registration import register_tracker

    target = _target(options.target)
    require_transform_name("--transform", options.transform)
    read = [options.pivot, options.points, *([options.rest] if options.rest else [])]
    require_outputs(options, read, options.output, options.transform)
    with working(options, "registering"):
        noise = pose_noise(options)
        done = register_tracker(
            options.pivot, options.points, options.title, noise=noise, pivot_columns=options.columns,
            points_columns=options.points_columns, accepted=options.accept or "",
        )  # fmt: skip
    if done.registration and options.output:
        done.registration.write(options.output)
        note(f"wrote {options.output}")
    if done.registration and options.transform:
        write_whole(
            options.transform, transform_bytes(done.registration.matrix, Path(options.transform).suffix.lower())
        )
        note(f"wrote {options.transform}")
    if options.json:
        print_json(_record(done, target, options.output))
    else:
        print_summary(options, options.title or "registration", _lines(done, target))
        for remark in done.remarks:
            note(f"remark: {remark}")
    if not done.ok:
        kept = f", no {options.output or options.transform}" if options.output or options.transform else ""
        return complain(f"refused{kept}: " + "; ".join(done.verdict.reasons))
    for reason in done.verdict.reasons:
        note(f"accepted in spite of {reason}")
    return 0


def _target(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    x, y, z = (*numbers("--target", text, 2, 3, form="X,Y or X,Y,Z"), 0.0)[:3]
    return x, y, z


def _lines(done: Registered, target: tuple[float, float, float] | None) -> dict[str, str]:
    lines = pivot_lines(done.pivot)
    if motion := done.motion:
        lines["points"] = f"{motion.points}, FRE {motion.fre_mm:.2f} mm, FLE {motion.fle_mm:.2f} mm"
    if done.registration and target:
        lines["target"] = f"TRE {done.registration.tre_mm(target):.2f} mm expected"
    verdict = done.verdict
    noise = f"; noise of the tracker {verdict.noise_mm:.2g} mm, {verdict.noise_source}" if verdict.noise_mm else ""
    return {**lines, "verdict": f"{verdict.status}{noise}"}


def _record(done: Registered, target: tuple[float, float, float] | None, output: str | None) -> dict[str, object]:
    made, motion = done.registration, done.motion
    record: dict[str, object] = {
        "status": done.pivot.status.value,
        "verdict": verdict_record(done.verdict),
        "pivot": pivot_record(done.pivot),
        "remarks": done.remarks,
    }
    if motion:
        outlier = done.outlier
        record["points"] = {
            "count": motion.points, "fre_mm": motion.fre_mm, "fle_mm": motion.fle_mm,
            "distances_mm": dict(zip(done.names, motion.distances_mm.tolist(), strict=True)),
            "outlier": None if outlier is None else done.names[outlier.number],
        }  # fmt: skip
    if made:
        record |= {
            "coil": {
                "offset_mm": made.coil_offset_mm, "offset_sd_mm": made.coil_offset_sd_mm, "axis": made.coil_axis,
            },
            "frame": {"quaternion": made.quaternion, "translation_mm": made.translation_mm},
            "tre_mm": made.tre_mm(target) if target else None,
            "digest": made.digest,
            "output": output,
        }  # fmt: skip
    return record
