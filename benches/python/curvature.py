"""Measure the coverage of the intervals of a fitted curvature, and the bias of the fit.

python benches/python/curvature.py --json benches/results/curvature.json > benches/results/curvature.md
python benches/python/curvature.py --trials 20          # short test run

80 mm of an arc of 1200 mm in 320 points (10 mm/s at 40 Hz), errors of 0.1 mm in x and y: white; correlated as
exp(-distance / length); and smooth, as exp(-(distance / length)^2 / 2). Every row of the table has its own seed.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import machine
import numpy as np
from numpy.typing import NDArray

from needleplan.identification import PathForm, TrackerNoise, arc_curvature
from needleplan.models import arc_step

LENGTH_MM, RADIUS_MM, SIGMA_MM, POINTS = 80.0, 1200.0, 0.1, 320
PLACES = np.linspace(0, LENGTH_MM, POINTS)
# Range of the coverage of a 95 % interval that counts as correct.
WANTED = (0.93, 0.97)
Noise = Callable[[np.random.Generator], NDArray[np.float64]]


@dataclass(frozen=True)
class Row:
    """One study: coverage of the interval, mean estimated / true curvature, median half width and scatter of R."""

    noise: str
    assumed: str
    trials: int
    held: float
    ratio: float
    half_width_mm: float
    scatter_mm: float
    milliseconds: float


def main() -> int:
    """Run all studies and print a table; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    unknown: dict[str, Any] = {}
    white: dict[str, Any] = {"noise": TrackerNoise.WHITE}
    tangent: dict[str, Any] = {"form": PathForm.TANGENT, "entry": (0.0, 0.0, 0.0)}
    rough, smooth = (lambda d, c: np.exp(-d / c)), (lambda d, c: np.exp(-((d / c) ** 2) / 2))
    studies: list[tuple[str, Noise, str, dict[str, Any]]] = [
        ("white", _white, "white", white),
        ("white", _white, "unknown", unknown),
        ("white", _white, "unknown; tangent at entry", tangent),
        ("correlated over 5 mm", _drawn(rough, 5.0), "white", white),
        ("correlated over 5 mm", _drawn(rough, 5.0), "unknown", unknown),
        ("correlated over 10 mm, half of it white", _mixed(_drawn(rough, 10.0)), "unknown", unknown),
        ("correlated over 20 mm", _drawn(rough, 20.0), "unknown", unknown),
        ("correlated over 20 mm", _drawn(rough, 20.0), "known: 20 mm", {"correlation_mm": 20.0}),
        ("smooth over 5 mm, half of it white", _mixed(_drawn(smooth, 5.0)), "unknown", unknown),
    ]
    rows = [_study(seed, options.trials, *study) for seed, study in enumerate(studies)]
    kasa = _kasa(options.trials)
    _print(rows, kasa, about)
    if options.json:
        record = {"machine": about, "kasa_ratio": kasa, "rows": [asdict(row) for row in rows]}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


def _study(seed: int, trials: int, name: str, noise: Noise, assumed: str, options: dict[str, Any]) -> Row:
    random = np.random.default_rng(seed)
    clean = _arc()
    paths = [clean + SIGMA_MM * noise(random) for _ in range(trials)]
    began = perf_counter()
    found = [arc_curvature(path, **options) for path in paths]
    seconds = perf_counter() - began
    value = np.array([each.curvature_per_mm for each in found])
    low, high = (np.array([getattr(each, f"{end}_per_mm") for each in found]) for end in ("low", "high"))
    held = float(np.mean((low <= 1 / RADIUS_MM) & (high >= 1 / RADIUS_MM)))
    to_mm = RADIUS_MM**2  # dR = R^2 dk
    return Row(
        name, assumed, trials, held, float(value.mean() * RADIUS_MM), float(np.median(high - low) / 2 * to_mm),
        float(value.std() * to_mm), 1e3 * seconds / trials,
    )  # fmt: skip


def _arc() -> NDArray[np.float64]:
    x, y, _ = arc_step(0.0, 0.0, 0.0, 1 / RADIUS_MM, PLACES)
    return np.column_stack([x, y])


def _white(random: np.random.Generator) -> NDArray[np.float64]:
    return random.standard_normal((POINTS, 2))


def _drawn(kernel: Callable[[NDArray[np.float64], float], NDArray[np.float64]], length_mm: float) -> Noise:
    apart = np.abs(PLACES[:, None] - PLACES)
    factor = np.linalg.cholesky(kernel(apart, length_mm) + 1e-9 * np.eye(POINTS))
    return lambda random: np.asarray(factor @ random.standard_normal((POINTS, 2)))


def _mixed(noise: Noise) -> Noise:
    return lambda random: np.sqrt(0.5) * (noise(random) + random.standard_normal((POINTS, 2)))


def _kasa(trials: int) -> float:
    """Return the mean of R / true R for white noise, by plain algebraic least squares (Kasa), which is biased."""
    random = np.random.default_rng(0)
    found = []
    for _ in range(trials):
        points = _arc() + SIGMA_MM * _white(random)
        rows = np.column_stack([points, np.ones(POINTS)])
        b, c, d = np.linalg.lstsq(rows, -(points**2).sum(axis=1), rcond=None)[0]
        found.append(np.sqrt(b**2 / 4 + c**2 / 4 - d))
    return float(np.mean(found) / RADIUS_MM)


def _print(rows: list[Row], kasa: float, about: dict[str, Any]) -> None:
    print(f"{LENGTH_MM:g} mm of an arc of R = {RADIUS_MM:g} mm, {POINTS} points, errors {SIGMA_MM:g} mm.")
    print(f"{about['processor']}, {about['date'][:10]}, commit {about['commit']}, Python {about['python']}.\n")
    print("| noise | assumed | trials | interval holds | 95 +- 2 %? | k / true k | half width, R | scatter, R | ms |")
    print("|---|---|--:|--:|---|--:|--:|--:|--:|")
    for row in rows:
        says = "yes" if WANTED[0] <= row.held <= WANTED[1] else "**no**"
        print(
            f"| {row.noise} | {row.assumed} | {row.trials} | {100 * row.held:.1f} % | {says} | {row.ratio:.4f} | "
            f"{row.half_width_mm:.0f} mm | {row.scatter_mm:.0f} mm | {row.milliseconds:.1f} |"
        )
    print(f"\nPlain algebraic least squares (Kasa), white noise: R / true R = {kasa:.3f}.")


if __name__ == "__main__":
    raise SystemExit(main())
