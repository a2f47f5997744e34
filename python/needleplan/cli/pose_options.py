"""Options of the commands that read poses of a tracked needle: columns, noise of the tracker, acceptance."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.estimation.registration import Pivot, PoseNoise, RegistrationVerdict

__all__ = ["add_poses", "pivot_lines", "pivot_record", "pose_noise", "verdict_record"]


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
    from needleplan.estimation.registration import PoseNoise, noise_at_rest, read_poses

    if options.accept is not None and not options.accept.strip():
        raise InputError(Mistake("--accept", "", "must be a reason, as a text"))
    if options.noise_mm is not None:
        if not 0 < options.noise_mm < math.inf:
            raise InputError(Mistake("--noise-mm", f"{options.noise_mm:g}", "must be a positive number"))
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
