"""Measure how often the 95 % region of `identify curvature` holds the tip of the next insertion.

python benches/python/predicted_tip.py --json benches/results/predicted_tip.json > benches/results/predicted_tip.md
python benches/python/predicted_tip.py --runs 10        # short test run

The generator shares no code with needleplan: it integrates the heading in steps of 0.1 mm. The shapes of the curvature,
the scatter between insertions and the noise differ from those of the fit (see `CASES`). The truth is the path of one
more insertion, without the noise of the tracker. The region does not use the noise model, so the fast fit for white
noise is used.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needleplan.identification import TrackerNoise, curvature
from needleplan.signals import Record

Floats = NDArray[np.float64]
# Range of the coverage that counts as correct, from the requirement.
WANTED = (0.90, 0.98)
DEPTH_MM, STEP_MM, SAMPLES = 100.0, 0.1, 60
FINE = np.arange(0.0, DEPTH_MM + STEP_MM / 2, STEP_MM)


@dataclass(frozen=True)
class Case:
    """A kind of insertions: curvature by depth, scatter of one insertion, and noise of the tracker."""

    name: str
    bend: Callable[[np.random.Generator], Floats]
    pose: Callable[[np.random.Generator], tuple[float, float]]
    noise: Callable[[np.random.Generator], Floats]


@dataclass(frozen=True)
class Row:
    """Result of one case: coverage of the region, and median half width and mean error in y (mm)."""

    case: str
    insertions: int
    planes: int
    runs: int
    held: float
    half_width_mm: float
    error_mm: float


def constant(random: np.random.Generator) -> Floats:
    """Return a constant curvature with a scatter of 10 % between insertions."""
    return np.full(FINE.size, 1e-3 * (1 + 0.1 * random.standard_normal()))


def fading(random: np.random.Generator) -> Floats:
    """Return a curvature that fades exponentially, with a random length."""
    return np.asarray(1.5e-3 * np.exp(-FINE / random.uniform(25.0, 45.0)))


def layers(random: np.random.Generator) -> Floats:
    """Return two layers whose border scatters by 5 mm; the second is nearly straight."""
    return np.where(random.normal(45.0, 5.0) > FINE, 1.8e-3, 1e-4)


def wavy(random: np.random.Generator) -> Floats:
    """Return a curvature with waves of random phase."""
    return np.asarray(8e-4 + 6e-4 * np.sin(FINE / 9.0 + random.uniform(0, 2 * np.pi)))


def gaussian_pose(random: np.random.Generator) -> tuple[float, float]:
    """Return heading and offset with normal scatter."""
    return 0.05 + 0.005 * random.standard_normal(), 0.2 * random.standard_normal()


def uniform_pose(random: np.random.Generator) -> tuple[float, float]:
    """Return heading and offset with uniform scatter."""
    return random.uniform(0.04, 0.076), random.uniform(-0.6, 0.2)


def heavy_pose(random: np.random.Generator) -> tuple[float, float]:
    """Return heading and offset with the scatter of a Student distribution with five degrees of freedom."""
    return 0.05 + 0.004 * random.standard_t(5), 0.2 * random.standard_t(5)


def white(random: np.random.Generator) -> Floats:
    """Return white noise of 0.15 mm."""
    return 0.15 * random.standard_normal(SAMPLES)


def drifting(random: np.random.Generator) -> Floats:
    """Return a random walk that ends at 0.15 mm (standard deviation), plus white noise of 0.1 mm."""
    walk = np.cumsum(random.standard_normal(SAMPLES)) * 0.15 / np.sqrt(SAMPLES)
    return np.asarray(walk + 0.1 * random.standard_normal(SAMPLES))


def outlying(random: np.random.Generator) -> Floats:
    """Return white noise of 0.1 mm, of which 3 % of the samples are ten times as large, rounded to 0.05 mm."""
    size = np.where(random.random(SAMPLES) < 0.03, 1.0, 0.1)
    return np.round(size * random.standard_normal(SAMPLES) / 0.05) * 0.05


CASES = (
    Case("constant, normal scatter, white noise", constant, gaussian_pose, white),
    Case("fading, uniform scatter, drifting noise", fading, uniform_pose, drifting),
    Case("two layers, Student scatter, outliers", layers, heavy_pose, outlying),
    Case("waves, uniform scatter, outliers", wavy, uniform_pose, outlying),
)


def side(case: Case, random: np.random.Generator, share: float) -> Floats:
    """Return the true lateral positions (mm) of one insertion; curvature and heading are multiplied by `share`."""
    heading, offset = case.pose(random)
    turned = share * heading + np.concatenate([[0.0], np.cumsum(share * case.bend(random)[:-1] * STEP_MM)])
    return np.asarray(offset + np.concatenate([[0.0], np.cumsum(np.sin(turned[:-1]) * STEP_MM)]))


def study(case: Case, insertions: int, planes: int, runs: int, seed: int, layers: int | None) -> Row:
    """Return the result of one case. `layers` is as in `curvature.identify`."""
    random = np.random.default_rng(seed)
    held, widths, errors = 0, [], []
    at = np.linspace(0.05, 1.0, SAMPLES) * DEPTH_MM
    shares = (1.0, 0.2)[:planes]
    for _ in range(runs):
        records = []
        for number in range(insertions):
            columns = {"time_s": np.arange(SAMPLES) / 2, "depth_mm": at, "x_mm": at}
            for name, share in zip(("y_mm", "z_mm"), shares, strict=False):
                columns[name] = np.interp(at, FINE, side(case, random, share)) + case.noise(random)
            records.append(Record(columns, f"{number}"))
        said = curvature.identify(
            records, segments=1, at_mm=DEPTH_MM, noise=TrackerNoise.WHITE, layers=layers
        ).prediction
        assert said is not None
        assert said.y_region_mm is not None
        truth = [float(side(case, random, share)[-1]) for share in shares]
        regions = [said.y_region_mm, *([said.z_region_mm] if said.z_region_mm else [])]
        held += all(low <= true <= high for true, (low, high) in zip(truth, regions, strict=True))
        widths.append((said.y_region_mm[1] - said.y_region_mm[0]) / 2)
        errors.append(abs(said.y_mm - truth[0]))
    return Row(case.name, insertions, planes, runs, held / runs, float(np.median(widths)), float(np.mean(errors)))


def main() -> int:
    """Run all cases and print a table; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--layers", choices=("1", "auto"), default="auto", help="curvature by depth (auto)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    sizes = ((3, 1), (5, 1), (5, 2))
    rows = []
    fitted = "one arc" if options.layers == "1" else "the curvature by depth that held-out insertions choose"
    print(f"Coverage of the 95 % region of the predicted tip at 100 mm, {fitted}, data of a foreign generator.\n")
    print("| insertions | planes | curvature, scatter, noise | runs | inside | 90 to 98 %? | half width | error in y |")
    print("|--:|--:|---|--:|--:|---|--:|--:|")
    for seed, (case, size) in enumerate((case, size) for case in CASES for size in sizes):
        row = study(case, *size, options.runs, seed, None if options.layers == "auto" else 1)
        rows.append(row)
        says = "yes" if WANTED[0] <= row.held <= WANTED[1] else "**no**"
        print(
            f"| {row.insertions} | {row.planes} | {row.case} | {row.runs} | {100 * row.held:.1f} % | {says} | "
            f"{row.half_width_mm:.2f} mm | {row.error_mm:.2f} mm |",
            flush=True,
        )
    total = np.average([row.held for row in rows])
    print(f"\nAll cases: {100 * total:.1f} %.")
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
