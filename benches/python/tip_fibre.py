"""Measure what curvature sensors along the needle add to the tip filter: error after half of the path, in the lab twin.

python benches/python/tip_fibre.py --json benches/results/tip_fibre.json > benches/results/tip_fibre.md
python benches/python/tip_fibre.py --seeds 2          # short test run

The first half of insertions of 55 mm at 5 mm/s, planned with R = 40 mm, with a needle that bends 20 % more and a half
turn at 15 mm. Tracker: 0.2 mm and 10 mrad of white noise. Sensors: gauge of 5 mm, 100 Hz, 2e-4 1/mm of white noise, and
constant errors of 1e-4 1/mm. The heading has a random walk of 2 mrad per root mm. Both filters see the same samples.
"""

import argparse
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

import machine
import numpy as np

from needleplan.estimation import Registration, TipFilter, TipSettings
from needleplan.models.deflection import FibreSensors
from needleplan.simulation import Effects, Lab, Setup, SimulatedEntry

RADIUS_MM, HALF_MM = 40.0, 27.5
LEGS = ((15.0, math.pi), (HALF_MM, None))
SETTINGS = TipSettings(position_sd_mm=0.2, angle_sd_rad=0.01, fibre_sd_per_mm=2e-4, fibre_bias_sd_per_mm=1e-4)


@dataclass(frozen=True)
class Case:
    """Places of coil and sensors behind the tip, and the depth from which the tracker is lost."""

    coil_mm: float
    sensors_mm: tuple[float, ...]
    lost_from_mm: float = math.inf


CASES = (
    Case(9.3, (10.0, 30.0, 65.0, 100.0)),
    Case(9.3, (2.5, 10.0, 30.0, 65.0)),
    Case(30.0, (10.0, 30.0, 65.0, 100.0)),
    Case(9.3, (10.0, 30.0, 65.0, 100.0), 12.0),
    Case(9.3, (2.5, 10.0, 30.0, 65.0), 12.0),
)


@dataclass(frozen=True)
class Ends:
    """Error (mm) of the tip and NEES (mean 5) at half of the path, for each filter, and time of an update (s)."""

    errors_mm: tuple[float, float]
    nees: tuple[float, float]
    seconds: float


def insertion(case: Case, seed: int) -> Ends:
    """Return the results of one insertion: tracker alone, then tracker and sensors."""
    sensors = FibreSensors(case.sensors_mm)
    effects = Effects(
        curvature_error=0.2, heading_noise_rad_sqrt_mm=0.002, tracker_noise_mm=0.2, tracker_angle_noise_rad=0.01,
        coil_offset_mm=case.coil_mm, encoder_step_mm=1e-3, encoder_step_rad=5e-4, fibre_noise_per_mm=2e-4,
        fibre_bias_per_mm=1e-4,
    )  # fmt: skip
    lab = Lab(Setup(1 / RADIUS_MM, entry=SimulatedEntry(depth_mm=-2.0), effects=effects, fibre=sensors), seed)
    registration = Registration(coil_offset_mm=case.coil_mm)
    filters = [TipFilter(registration, (0.0, 0.0, 0.0), 1 / RADIUS_MM, SETTINGS, fibre) for fibre in (None, sensors)]
    seconds, updates = 0.0, 0
    for depth, roll in LEGS:
        lab.stage.insert(depth, 5.0)
        for turn in (False, True):
            if turn and roll is not None:
                lab.stage.rotate(roll, 6.0)
            moving = not turn or roll is not None
            while moving:
                sample = lab.stage.read(0.01)
                assert sample is not None
                moving = sample.moving
                poses = lab.tracker.waiting() if sample.depth_mm < case.lost_from_mm else []
                fibres = lab.fibre.waiting()
                for each in filters:
                    each.predict(sample)
                    for pose in poses:
                        each.update(pose)
                began = perf_counter()
                for fibre in fibres:
                    filters[1].update_fibre(fibre)
                seconds, updates = seconds + perf_counter() - began, updates + len(fibres)
    true = lab.plant.tip()
    place = [*true.position_mm, math.atan2(true.tangent[1], true.tangent[0]), math.asin(true.tangent[2])]
    off, nees = [], []
    for each in filters:
        state, covariance = each.tip_state()
        error = state[:5] - place
        off.append(float(np.linalg.norm(error[:3])))
        nees.append(float(error @ np.linalg.solve(covariance[:5, :5], error)))
    return Ends((off[0], off[1]), (nees[0], nees[1]), seconds / updates)


def main() -> int:
    """Run all cases and print a table; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about, rows, seconds = machine.description(), [], []
    for case in CASES:
        ends = [insertion(case, seed) for seed in range(options.seeds)]
        errors, nees = (np.array([getattr(each, name) for each in ends]) for name in ("errors_mm", "nees"))
        seconds += [each.seconds for each in ends]
        rows.append(
            {"case": asdict(case), "error_mm": errors.mean(axis=0).tolist(), "nees": nees.mean(axis=0).tolist()}
        )
    print(f"{options.seeds} insertions a row; mean error of the tip in 3D after half of the path. NEES has the mean 5.")
    print(f"{about['processor']}, {about['date'][:10]}, commit {about['commit']}, Python {about['python']}.\n")
    print("| coil behind the tip | sensors behind the tip | tracker | tracker alone | and sensors | ratio | NEES |")
    print("|--:|---|---|--:|--:|--:|--:|")
    for case, row in zip(CASES, rows, strict=True):
        (alone, both), lost = row["error_mm"], case.lost_from_mm
        seen = "always" if math.isinf(lost) else f"lost from {lost:g} mm on"
        places = ", ".join(f"{each:g}" for each in case.sensors_mm)
        print(f"| {case.coil_mm:g} mm | {places} mm | {seen} | {alone:.3f} mm | {both:.3f} mm | {alone / both:.1f} | "
              f"{row['nees'][0]:.1f}, {row['nees'][1]:.1f} |")  # fmt: skip
    print(f"\nA sample of the sensors: {1e3 * float(np.median(seconds)):.2f} ms (median).")
    if options.json:
        record = {"machine": about, "rows": rows, "update_ms": 1e3 * float(np.median(seconds))}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
