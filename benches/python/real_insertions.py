"""Measure the error of the predicted tip of real insertions, each predicted from the others of its tissue.

python benches/python/real_insertions.py ../shared/data/real_insertions --json benches/results/real_insertions.json \
    > benches/results/real_insertions.md

The folder holds the open-loop insertions of maribernardes/mpc_stepwise_trajcontrol (three in each of four tissues,
100 mm deep, 2 Hz). y and z are relative to the position of the guide. The error is the distance of the predicted from
the measured tip at the depth that all insertions of the tissue reach, in the plane of bending and in 3D. The measured
tip is the median of the samples within 1 mm of this depth.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from needleplan.identification import curvature, deflection
from needleplan.models import simulate
from needleplan.recording import read_records
from needleplan.signals import Motion, Record, Role

TISSUES = ("phantomA", "phantomB", "phantomC", "exvivo")
# The first step into the tissue (mm) is not part of the path.
SKIP_MM = 5.0
# Samples within this distance (mm) of the depth count for the measured tip.
WITHIN_MM = 1.0

# y and z (mm) of the tip that a route predicts at a depth (mm) from training records; None: not predicted.
Route = Callable[[Sequence[Record], float], tuple[float, float | None]]


def straight(train: Sequence[Record], depth_mm: float) -> tuple[float, float | None]:  # noqa: ARG001
    """Return the tip of a needle that goes straight on from the guide."""
    return 0.0, 0.0


def arc_of_the_guide(train: Sequence[Record], depth_mm: float) -> tuple[float, float | None]:
    """Return the tip of an arc with the identified curvature that starts along the guide."""
    found = curvature.identify(train, skip_mm=SKIP_MM, segments=1)
    return found.estimates["curvature_per_mm"].value * depth_mm**2 / 2, 0.0


def documented(train: Sequence[Record], depth_mm: float) -> tuple[float, float | None]:
    """Return the tip that `identify curvature` predicts."""
    said = curvature.identify(train, skip_mm=SKIP_MM, segments=1, at_mm=depth_mm).prediction
    assert said is not None
    return said.y_mm, said.z_mm


def path_law(train: Sequence[Record], depth_mm: float) -> tuple[float, float | None]:
    """Return the tip that the model of `identify deflection` simulates."""
    model = deflection.identify(train).model
    assert model is not None
    depth = np.linspace(0.0, depth_mm, 201)
    return float(simulate(model, Motion.sampled(depth, depth)).output[-1]), None


def mean_of_tips(train: Sequence[Record], depth_mm: float) -> tuple[float, float | None]:
    """Return the mean of the measured tips, without a model."""
    y, z = np.mean([tip(each, depth_mm) for each in train], axis=0)
    return float(y), float(z)


ROUTES: dict[str, Route] = {
    "straight line": straight,
    "one arc, heading of the guide": arc_of_the_guide,
    "identify deflection, simulated": path_law,
    "mean of the measured tips, no model": mean_of_tips,
    "identify curvature, predicted tip": documented,
}


def tip(record: Record, depth_mm: float) -> tuple[float, float]:
    """Return y and z (mm) of the measured tip at a depth."""
    apart = np.abs(record["depth_mm"] - depth_mm)
    near = apart <= max(WITHIN_MM, float(apart.min()))
    return float(np.median(record["y_mm"][near])), float(np.median(record["z_mm"][near]))


def errors(route: Route, trials: Sequence[Record]) -> list[tuple[float, float]]:
    """Return the error (mm) of each insertion in the plane and in 3D, predicted from the other insertions."""
    depth = min(float(each["depth_mm"].max()) for each in trials)
    found = []
    for number, held in enumerate(trials):
        train = [replace(each, role=Role.TRAIN) for k, each in enumerate(trials) if k != number]
        y, z = route(train, depth)
        true_y, true_z = tip(held, depth)
        found.append((abs(y - true_y), float("nan") if z is None else float(np.hypot(y - true_y, z - true_z))))
    return found


def main() -> int:
    """Print a table of routes and errors; with --json, write the errors of every insertion."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of the data set")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    trials = {
        each: [read_records(path)[0] for path in sorted(options.folder.glob(f"{each}_openloop_*.csv"))]
        for each in TISSUES
    }
    print("Mean distance between predicted and measured tip, leave one insertion out.\n")
    print(f"| route | in plane, mm | largest, mm | in 3D, mm | {' | '.join(TISSUES)} |")
    print(f"|---|--:|--:|--:|{'--:|' * len(TISSUES)}")
    record = {}
    for name, route in ROUTES.items():
        found = {tissue: np.array(errors(route, some)) for tissue, some in trials.items()}
        together = np.concatenate(list(found.values()))
        space = together[:, 1].mean()
        parts = " | ".join(f"{each[:, 0].mean():.2f}" for each in found.values())
        shown = "" if np.isnan(space) else f"{space:.2f}"
        print(f"| {name} | {together[:, 0].mean():.2f} | {together[:, 0].max():.2f} | {shown} | {parts} |")
        record[name] = {
            tissue: np.where(np.isnan(each), None, each.round(4)).tolist() for tissue, each in found.items()
        }
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
