"""Measure the forecast of the next insertion of a series: coverage and width of its region, and its error.

PYTHONPATH=. python benches/python/next_insertion.py > benches/results/next_insertion.md
PYTHONPATH=. python benches/python/next_insertion.py --short

Series of another hand (`tests/blind/series.py`): steady, with a slope of 0.5 to 2 scatters an insertion, with a step of
3 to 8 scatters, with a walk of 0.5 to 2 scatters. From the true tips of all insertions but the last, the last one is
forecast. "Width" is the mean width of the region over that of the same law with the scatter known (very many assumed
insertions with the true scatter); "error" is the mean 3D error over that of the mean of the tips.

With --paths, the end of the last insertion is predicted by `predict_end` after a half of its measured path.
"""

import argparse
import itertools

import numpy as np

from needleplan.identification import InsertionForecast, next_insertion, population, predict_end
from needleplan.signals import Record
from tests.blind.series import LENGTH_MM, Drift, Insertion, drawn

EARLIER = (1, 2, 3, 5, 8, 12, 20, 30)
SCATTERS_MM = (0.25, 0.5, 1.0)
# Weight of an assumed scatter that counts as known.
KNOWN = 10**6


def known_scatter(tips: np.ndarray, scatter_mm: float) -> InsertionForecast:
    """Return the forecast of the same law for a known scatter."""
    count, population._ASSUMED_COUNT = population._ASSUMED_COUNT, KNOWN
    conformal, population._CONFORMAL = population._CONFORMAL, KNOWN
    try:
        return next_insertion(tips, scatter_mm)
    finally:
        population._ASSUMED_COUNT, population._CONFORMAL = count, conformal


def study(drift: Drift, earlier: int, runs: int, typical_mm: float) -> tuple[float, float, float, float]:
    """Return coverage, that with the scatter known, relative width, and relative error of the forecasts."""
    random = np.random.default_rng([1, earlier, list(Drift).index(drift)])
    held, width, error = np.zeros(2), np.zeros(2), np.zeros(2)
    for _ in range(runs):
        series = drawn(random, drift, earlier + 1, typical_mm=typical_mm, wander_rad=0.0)
        tips, last = series.tips_mm[:-1], series.tips_mm[-1]
        found = (next_insertion(tips, population.deviation_mm(LENGTH_MM)), known_scatter(tips, series.scatter_mm))
        held += [bool(((each.low <= last) & (last <= each.high)).all()) for each in found]
        width += [float((each.high - each.low).mean()) for each in found]
        error += [np.linalg.norm(each - last) for each in (found[0].values, tips.mean(axis=0))]
    return float(held[0] / runs), float(held[1] / runs), float(width[0] / width[1]), float(error[0] / error[1])


def record(insertion: Insertion, name: str) -> Record:
    """Return the measured insertion."""
    columns = {"time_s": insertion.depth_mm / 2, "depth_mm": insertion.depth_mm, "x_mm": insertion.depth_mm}
    return Record({**columns, "y_mm": insertion.y_mm, "z_mm": insertion.z_mm}, name)


def on_the_way(drift: Drift, earlier: int, runs: int, share: float) -> tuple[float, float, float]:
    """Return coverage, mean half width and mean 3D error (mm) of ends predicted after a share of the path."""
    random = np.random.default_rng([2, earlier, list(Drift).index(drift)])
    held, widths, errors = 0, [], []
    for _ in range(runs):
        series = drawn(random, drift, earlier + 1, wander_rad=random.choice([2e-4, 5e-4, 1e-3]))
        records = [record(each, str(number)) for number, each in enumerate(series.insertions)]
        end = predict_end(records[-1], records[:-1], depth_mm=LENGTH_MM, until_mm=share * LENGTH_MM, layers=1)
        assert end.z_mm is not None
        assert end.z_region_mm is not None
        y, z = series.insertions[-1].tip_mm
        held += end.y_region_mm[0] <= y <= end.y_region_mm[1] and end.z_region_mm[0] <= z <= end.z_region_mm[1]
        widths += [(high - low) / 2 for low, high in (end.y_region_mm, end.z_region_mm)]
        errors.append(np.hypot(end.y_mm - y, end.z_mm - z))
    return held / runs, float(np.mean(widths)), float(np.mean(errors))


def main() -> int:
    """Run all cases and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--paths", action="store_true", help="also predict ends from half of a path")
    parser.add_argument("--short", action="store_true", help="a few runs of few cases, in seconds")
    options = parser.parse_args()
    runs, counts, scatters = (5, (3, 20), (0.5,)) if options.short else (options.runs, EARLIER, SCATTERS_MM)
    print("| series | typical scatter | earlier insertions | region holds | with the scatter known | width | error |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    for drift in Drift:
        for typical in scatters:
            for earlier in counts:
                held, known, width, error = study(drift, earlier, runs, typical)
                print(
                    f"| {drift} | {typical:g} mm | {earlier} | {held:.1%} | {known:.1%} | {width:.2f} | {error:.2f} |",
                    flush=True,
                )
    if not (options.paths or options.short):
        return 0
    print("\n| series | earlier insertions | share of the path | region holds | half width of a side | error in 3D |")
    print("|---|--:|--:|--:|--:|--:|")
    kinds, sizes, shares = (Drift.STEADY, Drift.STEP), (2, 3, 6), (0.25, 0.5, 0.75)
    if options.short:
        kinds, sizes, shares = kinds[:1], sizes[:1], shares[1:2]
    for drift, earlier, share in itertools.product(kinds, sizes, shares):
        held, wide, error = on_the_way(drift, earlier, max(runs // 5, 1), share)
        print(f"| {drift} | {earlier} | {share:.0%} | {held:.1%} | {wide:.2f} mm | {error:.2f} mm |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
