"""`needleplan register`: determine the offset from coil to tip, and the transform from tracker to plan coordinates."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, print_json, print_summary, working
from needleplan.cli.options import add_answer, add_output, numbers, require_outputs

if TYPE_CHECKING:
    from needleplan.estimation.registration import Registered

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "register",
        help="register a tracked needle: coil to tip, tracker to plan",
        description="Compute the distance of the coil of a tracked needle from its tip, from poses while the needle "
        "pivots about its tip, and the transform from the tracker to the plan, from points in both frames. "
        "Exit code 1: the needle was not turned enough.",
    )
    parser.add_argument("--pivot", required=True, metavar="POSES.csv", help="poses of the coil while the needle pivots")
    parser.add_argument("--points", required=True, metavar="POINTS.csv", help="points in both frames")
    add_output(parser, "REGISTRATION.toml", "write the registration")
    parser.add_argument(
        "--transform", metavar="FILE", help="write tracker to plan as a transform for 3D Slicer (.tfm, .h5)"
    )
    parser.add_argument("--target", metavar="X,Y[,Z]", help="target of the plan, mm: print the expected error there")
    parser.add_argument("--title", default="", metavar="TEXT", help="title of the registration file")
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 1 if no registration could be determined, else 0."""
    from needleplan.anatomy import require_transform_name, transform_bytes
    from needleplan.artifacts import write_whole
    from needleplan.estimation.registration import register_needle

    target = _target(options.target)
    require_transform_name("--transform", options.transform)
    require_outputs(options, [options.pivot, options.points], options.output, options.transform)
    with working(options, "registering"):
        done = register_needle(options.pivot, options.points, options.title)
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
        for remark in done.remarks if done.ok else ():
            note(f"remark: {remark}")
    return 0 if done.ok else complain("; ".join(done.remarks))


def _target(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    x, y, z = (*numbers("--target", text, 2, 3, form="X,Y or X,Y,Z"), 0.0)[:3]
    return x, y, z


def _lines(done: Registered, target: tuple[float, float, float] | None) -> dict[str, str]:
    pivot = done.pivot
    turned = (
        f"{pivot.poses} poses, spread {math.degrees(pivot.spread_rad):.1f} degrees, condition {pivot.condition:.3g}"
    )
    if done.registration is None or done.motion is None:
        return {"coil": pivot.status.value, "pivot": turned}
    made, motion = done.registration, done.motion
    low, high = (float(each[0]) for each in pivot.interval_mm)
    behind = "its axis points to the tip" if made.coil_axis > 0 else "its axis points away from the tip"
    reach = (high - low) / 2
    lines = {
        "coil": f"{made.coil_offset_mm:.2f} mm behind the tip, +- {reach:.2f} mm (95 %); {behind}",
        "pivot": f"{turned}, residual {pivot.rms_mm:.2f} mm",
        "points": f"{motion.points}, FRE {motion.fre_mm:.2f} mm, FLE {motion.fle_mm:.2f} mm",
    }
    if target:
        lines["target"] = f"TRE {made.tre_mm(target):.2f} mm expected"
    return lines


def _record(done: Registered, target: tuple[float, float, float] | None, output: str | None) -> dict[str, object]:
    pivot, made, motion = done.pivot, done.registration, done.motion
    record: dict[str, object] = {
        "status": pivot.status.value,
        "pivot": {
            "poses": pivot.poses, "spread_rad": pivot.spread_rad, "condition": pivot.condition,
            "rms_mm": pivot.rms_mm, "offset_mm": float(pivot.tip_mm[0]), "offset_sd_mm": float(pivot.tip_sd_mm[0]),
            "interval_mm": [float(each[0]) for each in pivot.interval_mm], "outliers": pivot.outliers,
        },
        "remarks": done.remarks,
    }  # fmt: skip
    if made and motion:
        outlier = done.outlier
        record |= {
            "coil": {
                "offset_mm": made.coil_offset_mm, "offset_sd_mm": made.coil_offset_sd_mm, "axis": made.coil_axis,
            },
            "frame": {"quaternion": made.quaternion, "translation_mm": made.translation_mm},
            "points": {
                "count": motion.points, "fre_mm": motion.fre_mm, "fle_mm": motion.fle_mm,
                "distances_mm": dict(zip(done.names, motion.distances_mm.tolist(), strict=True)),
                "outlier": None if outlier is None else done.names[outlier.number],
            },
            "tre_mm": made.tre_mm(target) if target else None,
            "digest": made.digest,
            "output": output,
        }  # fmt: skip
    return record
