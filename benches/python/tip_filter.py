"""Measure the tip filter in the lab twin: tip error, depth at which a wrong curvature is detected, computing time.

python benches/python/tip_filter.py --json benches/results/tip_filter.json > benches/results/tip_filter.md
python benches/python/tip_filter.py --seeds 2          # short test run

Insertions of 55 mm at 5 mm/s, planned with R = 40 mm, with a needle that bends 20 % more and half turns at 15 and 35
mm. The coil is 9.3 mm behind the tip. The tracker has 0.2 mm and 10 mrad of white noise; the heading has a random walk
of 2 mrad per root mm. "Line" is the usual estimate: the tip on the axis of the coil, 9.3 mm ahead.
"""

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import machine
import numpy as np

from needleplan.estimation import PoseUse, Registration, TipFilter, TipSettings, TipStatus
from needleplan.simulation import Effects, Lab, Setup, SimulatedEntry, SimulatedLayer

# Distance of the coil behind the tip, and planned radius.
COIL_MM, PLANNED_MM = 9.3, 40.0
# Effects of the lab in every case.
USUAL: dict[str, float] = {
    "curvature_error": 0.2, "heading_noise_rad_sqrt_mm": 0.002, "tracker_noise_mm": 0.2,
    "tracker_angle_noise_rad": 0.01, "coil_offset_mm": COIL_MM, "encoder_step_mm": 1e-3, "encoder_step_rad": 5e-4,
}  # fmt: skip
# Settings of the filter that match the white noise of the tracker in `USUAL`.
TOLD = TipSettings(position_sd_mm=0.2, angle_sd_rad=0.01)
# Depth (mm) of each leg of an insertion, and roll (rad) to which the needle is then rotated.
LEGS = ((15.0, math.pi), (35.0, 0.0), (55.0, None))
LAYERS = (SimulatedLayer(25.0, 1 / 60), SimulatedLayer(45.0, 1 / 30))


@dataclass(frozen=True)
class Case:
    """The imperfections of a lab, and the settings of the filter."""

    name: str
    effects: dict[str, float]
    settings: TipSettings = TOLD
    layers: tuple[SimulatedLayer, ...] = ()


CASES = (
    Case("as above", {}),
    Case("tracker error of 0.2 mm that wanders over 1 s, told", {"tracker_wander_mm": 0.2},
         replace(TOLD, wander_sd_mm=0.2)),
    Case("the same, not told", {"tracker_wander_mm": 0.2}),
    Case("field distorted by 1 mm over 200 mm, told as wander", {"tracker_distortion_mm": 1.0},
         replace(TOLD, wander_sd_mm=0.7, wander_s=20.0)),
    Case("the same, not told", {"tracker_distortion_mm": 1.0}),
    Case("dropouts of 0.3 s, one in 50 frames", {"tracker_dropout": 0.02, "tracker_dropout_s": 0.3}),
    Case("twist: 0.3 N mm/mm, a lag of 0.2 rad at 55 mm", {"torsional_friction_n": 0.3}),
    Case("layers of R = 60 and 30 mm from 25 and 45 mm on, not in the plan", {}, TOLD, LAYERS),
    Case("respiration of 2 mm across", {"respiration_across_mm": 2.0}),
    Case("respiration of 2 mm along", {"respiration_along_mm": 2.0}),
)  # fmt: skip


@dataclass(frozen=True)
class Frame:
    """Results at one tracker frame.

    Errors of the filter and of the line (mm), normalised squared errors, ratio of estimated to planned curvature with
    its standard deviation, and time of an update (s).
    """

    depth_mm: float
    off_mm: float
    line_off_mm: float
    nees: float
    nis: float
    lost: bool
    factor: float
    factor_sd: float
    seconds: float


@dataclass(frozen=True)
class Row:
    """Statistics of a case, from all its frames."""

    name: str
    mean_mm: float
    p95_mm: float
    line_mean_mm: float
    line_p95_mm: float
    nees: float
    nis: float
    lost: float


def main() -> int:
    """Run all cases and print tables; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    rows, seconds = [], np.zeros(0)
    for case in CASES:
        frames = [each for seed in range(options.seeds) for each in insertion(case, seed)]
        rows.append(_row(case, frames))
        seconds = np.concatenate([seconds, [each.seconds for each in frames]])
    seen = {f"{radius:g}": detection(radius, options.seeds) for radius in (40.0, 100.0, 200.0)}
    times = {name: float(np.percentile(seconds, share) * 1e3) for name, share in (("median", 50), ("p99", 99))}
    _print(rows, seen, times, options.seeds, about)
    if options.json:
        record = {"machine": about, "rows": [asdict(row) for row in rows], "detection_mm": seen, "update_ms": times}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


def insertion(case: Case, seed: int, radius_mm: float = PLANNED_MM, legs: Any = LEGS) -> Iterator[Frame]:
    """Yield the results at the tracker frames of one insertion, from a depth of 5 mm on."""
    effects = Effects(**(USUAL | case.effects))
    lab = Lab(Setup(1 / radius_mm, entry=SimulatedEntry(depth_mm=-2.0), layers=case.layers, effects=effects), seed)
    tip = TipFilter(Registration(coil_offset_mm=COIL_MM), (0.0, 0.0, 0.0), 1 / radius_mm, case.settings)
    for depth, roll in legs:
        lab.stage.insert(depth, 5.0)
        yield from _frames(lab, tip)
        if roll is not None:
            lab.stage.rotate(roll, 6.0)
            yield from _frames(lab, tip)


def _frames(lab: Lab, tip: TipFilter) -> Iterator[Frame]:
    moving = True
    while moving:
        sample = lab.stage.read(0.01)
        assert sample is not None
        moving = sample.moving
        tip.predict(sample)
        for pose in lab.tracker.waiting():
            began = perf_counter()
            use = tip.update(pose)
            found = tip.tip
            seconds = perf_counter() - began
            if sample.depth_mm < 5 or use is PoseUse.MISSING:
                continue
            state, covariance = tip.tip_state()
            true = lab.plant.tip()
            angles = [math.atan2(true.tangent[1], true.tangent[0]), math.asin(true.tangent[2])]
            error = state[:5] - [*true.position_mm, *angles]
            coil, direction = tip.registration.place(pose.position_mm, pose.quaternion)
            line = np.array(coil) + COIL_MM * np.array(direction)
            yield Frame(
                sample.depth_mm, math.dist(state[:3], true.position_mm), math.dist(line, true.position_mm),
                float(error @ np.linalg.solve(covariance[:5, :5], error)), tip.nis, found.status is TipStatus.LOST,
                found.curvature_factor, found.curvature_factor_sd, seconds,
            )  # fmt: skip


def detection(radius_mm: float, seeds: int) -> list[float | None]:
    """Return by seed the depth (mm) from which the 95 % interval of the curvature excludes the plan, or None."""
    found: list[float | None] = []
    for seed in range(seeds):
        case = Case("", {"curvature_error": 0.2 if seed % 2 else -0.2})
        frames = list(insertion(case, seed, radius_mm, ((100.0, None),)))
        inside = [abs(each.factor - 1) < 1.96 * each.factor_sd for each in frames]
        last = max((number for number, each in enumerate(inside) if each), default=-1)
        found.append(frames[last + 1].depth_mm if last + 1 < len(frames) else None)
    return found


def _row(case: Case, frames: list[Frame]) -> Row:
    off, line = (np.array([getattr(each, name) for each in frames]) for name in ("off_mm", "line_off_mm"))
    nees, nis, lost = (float(np.mean([getattr(each, name) for each in frames])) for name in ("nees", "nis", "lost"))
    tails = [float(np.percentile(each, 95)) for each in (off, line)]
    return Row(case.name, float(off.mean()), tails[0], float(line.mean()), tails[1], nees, nis, lost)


def _print(
    rows: list[Row], seen: dict[str, list[float | None]], times: dict[str, float], seeds: int, about: dict[str, Any]
) -> None:
    print(f"{seeds} insertions a row; errors of the tip in 3D, mm. NEES and NIS have the mean 5 where all is as told.")
    print(f"{about['processor']}, {about['date'][:10]}, commit {about['commit']}, Python {about['python']}.\n")
    print("| lab | filter: mean | 95 % | line: mean | 95 % | NEES | NIS | frames lost |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|")
    for row in rows:
        print(
            f"| {row.name} | {row.mean_mm:.2f} | {row.p95_mm:.2f} | {row.line_mean_mm:.2f} | {row.line_p95_mm:.2f} | "
            f"{row.nees:.1f} | {row.nis:.1f} | {100 * row.lost:.0f} % |"
        )
    what = "A curvature 20 % above or below the plan, no turns"
    print(f"\n{what}: the depth from which on its 95 % interval leaves it out.\n")
    print("| planned R | median | latest | not seen at 100 mm |")
    print("|--:|--:|--:|--:|")
    for radius, depths in seen.items():
        known = [each for each in depths if each is not None]
        told = [f"{value:.0f} mm" for value in (np.median(known), max(known))] if known else ["-", "-"]
        print(f"| {radius} mm | {' | '.join(told)} | {len(depths) - len(known)} of {len(depths)} |")
    print(
        f"\nA pose taken and the tip told: {times['median']:.2f} ms (median), {times['p99']:.2f} ms (99th percentile)."
    )


if __name__ == "__main__":
    raise SystemExit(main())
