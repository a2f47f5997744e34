"""Measure the error of the end of real insertions that the tip filter predicts after half of the path.

python benches/python/real_adaptation.py ../shared/data/real_insertions --json benches/results/real_adaptation.json \
    > benches/results/real_adaptation.md

The insertions are those of `real_insertions.py`. For each, `identify curvature` finds entry pose and curvature in the
two others of its tissue (two insertions do not choose the shape of the curvature, so the default is one curvature); the
filter gets these as its plan, as in `insert --needle`. It then takes the poses of the insertion up to half of its
depth. Its path is extrapolated to the depth that all insertions of the tissue reach. The files have positions only, so
the direction of each pose has a standard deviation of 2 rad: it counts for nothing. All other settings are the
defaults. That was decided after seeing these data: noise from their description (0.3 mm that drifts over 10 s) gave
0.60 mm in 3D after half of the path, where the defaults give 0.26. No other data have judged the choice.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from real_insertions import SKIP_MM, TISSUES, read, tip

from needleplan.devices import PoseSample, StageSample, Stamp
from needleplan.estimation import Registration, TipFilter, TipSettings
from needleplan.identification import Identification, curvature
from needleplan.models import BicycleByDepth
from needleplan.signals import Record, Role

SETTINGS = TipSettings(angle_sd_rad=2.0)
# Shares of the depth at which the end is predicted.
SHARES = (0.25, 0.5, 0.75)
# Entry pose (x, y, heading, z, elevation), roll of the bending (rad), curvature by depth.
Plan = tuple[tuple[float, ...], float, Callable[[float], float]]
_NANO = 1e9


def plan_of(train: Sequence[Record], layers: int | None) -> Plan:
    """Return entry pose (x, y, heading, z, elevation), roll of the bending, and curvature by depth, from insertions.

    The roll is the direction of the mean curvature, as a calibration of the base would find it.
    """
    flat, raised = (
        curvature.identify(train, skip_mm=SKIP_MM, segments=1, plane=plane, layers=layers) for plane in ("xy", "xz")
    )
    y, z = _pose(flat), _pose(raised)
    sideways, upwards = (_mean_bend(each) for each in (flat, raised))
    roll = math.atan2(upwards, sideways)
    scale = math.hypot(sideways, upwards) / sideways if sideways else 1.0
    return (0.0, *y, *z), roll, lambda depth_mm: scale * _bend(flat, depth_mm)


def _pose(found: Identification) -> tuple[float, float]:
    return found.estimates["offset_mm"].value, found.estimates["heading_rad"].value


def _bend(found: Identification, depth_mm: float) -> float:
    model = found.model
    if isinstance(model, BicycleByDepth):
        return float(model.curvature_at(depth_mm))
    return found.estimates["curvature_per_mm"].value


def _mean_bend(found: Identification) -> float:
    return float(np.mean([_bend(found, each) for each in np.linspace(0, 100, 101)]))


def predicted(plan: Plan, held: Record, end_mm: float, share: float) -> np.ndarray:
    """Return the predicted end (y, z in mm), and its standard deviations, from the first share of an insertion."""
    entry, roll, bend = plan
    found = TipFilter(Registration(), entry, lambda x_mm, *_: bend(x_mm), SETTINGS)
    depth = np.maximum.accumulate(held["depth_mm"])
    rows = np.flatnonzero(np.isfinite(held["y_mm"]) & (depth <= share * end_mm))
    for number, row in enumerate(rows.tolist()):
        now = Stamp(round(_NANO * (1 + held["time_s"][row])), number)
        found.predict(StageSample(now, float(depth[row]), 0.0, roll, moving=True))
        at = tuple(float(held[name][row]) for name in ("x_mm", "y_mm", "z_mm"))
        if depth[row] > SKIP_MM:
            found.update(PoseSample(now, at, (1.0, 0.0, 0.0, 0.0), math.nan))
    state, covariance = found.ahead(end_mm - float(depth[rows[-1]]))
    return np.concatenate([state[1:3], np.sqrt(np.diag(covariance)[1:3])])


def main() -> int:
    """Print a table of errors; with --json, write the error of every insertion."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of the data set")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    record: dict[str, dict[str, list[list[float]]]] = {}
    print("Distance of the predicted from the measured end of the path, mean over twelve insertions (largest).")
    print("The noise of the filter was chosen with these data in view: see the bench.\n")
    print("| plan | share of the path | in plane, mm | out of plane, mm | in 3D, mm | tissues, in 3D, mm |")
    print("|---|--:|--:|--:|--:|---|")
    for name, layers in (("one curvature", 1), ("two layers", 2)):
        rows: dict[float, dict[str, list[list[float]]]] = {share: {} for share in SHARES}
        for tissue in TISSUES:
            trials = [read(path) for path in sorted(options.folder.glob(f"{tissue}_openloop_*.csv"))]
            end = min(float(each["depth_mm"].max()) for each in trials)
            for number, held in enumerate(trials):
                train = [replace(each, role=Role.TRAIN) for k, each in enumerate(trials) if k != number]
                plan, measured = plan_of(train, layers), np.array(tip(held, end))
                for share, of in rows.items():
                    found = predicted(plan, held, end, share)
                    off = [*(found[:2] - measured), *found[2:]]
                    of.setdefault(tissue, []).append([round(float(each), 4) for each in off])
        for share, of in rows.items():
            record[f"{name}, {share:g}"] = of
            print(line(name, share, of), flush=True)
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


def line(name: str, share: float, rows: dict[str, list[list[float]]]) -> str:
    """Return a row of the table."""
    off = np.abs(np.concatenate([np.array(each)[:, :2] for each in rows.values()]))
    space = np.hypot(*off.T)
    parts = ", ".join(f"{np.hypot(*np.array(each)[:, :2].T).mean():.2f}" for each in rows.values())
    shown = " | ".join(f"{each.mean():.2f} ({each.max():.2f})" for each in (off[:, 0], off[:, 1], space))
    return f"| {name} | {share:.0%} | {shown} | {parts} |"


if __name__ == "__main__":
    raise SystemExit(main())
