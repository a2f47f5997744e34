"""Compare predicted with realised success of 3D policy tables, at random entries off the grid.

python benches/python/space_predictions.py > benches/results/space_predictions.md      # an hour on one processor
python benches/python/space_predictions.py --spacing 4 --entries 3 --runs 50           # short test run

Two invented volumes of 80 x 48 x 48 mm with round obstacles and a target of 3 mm radius; a needle of 80 mm radius,
a noise of 4 degrees a step of 8 mm, eight roll angles and a straight step, directions 4 degrees apart.
"""

import argparse
import math
from typing import Any

import machine
import numpy as np

from needleplan import _ppvi
from needleplan.planning import Outcome

SIZE_MM = np.array([80.0, 48.0, 48.0])
STEP_MM, NOISE_DEG, DIRECTIONS_DEG, CONE_DEG, RADIUS_MM, TARGET_MM = 8.0, 4.0, 4.0, 45.0, 80.0, 3.0
# Name, target, and obstacles as (centre, radius), in mm.
VOLUMES = (
    ("four obstacles", (72, 24, 24), (((40, 24, 24), 8), ((55, 10, 30), 6), ((30, 36, 14), 7), ((60, 36, 34), 5))),
    (
        "five obstacles",
        (70, 26, 22),
        (((30, 14, 24), 9), ((30, 36, 24), 8), ((52, 24, 36), 7), ((52, 24, 10), 7), ((62, 34, 24), 4)),
    ),
)
FREE, AT_TARGET, OBSTACLE = 0, 1, 2


def space_of(target_mm: Any, obstacles: Any, spacing_mm: float) -> Any:
    """Return the problem of a volume."""
    shape = np.round(SIZE_MM / spacing_mm).astype(int) + 1
    points = np.stack(np.meshgrid(*[np.arange(n) * spacing_mm for n in shape], indexing="ij"), -1)
    voxels = np.full(shape, FREE, np.uint8)
    for center, radius in obstacles:
        voxels[((points - np.array(center)) ** 2).sum(-1) <= radius**2] = OBSTACLE
    voxels[((points - np.array(target_mm)) ** 2).sum(-1) <= TARGET_MM**2] = AT_TARGET
    return _ppvi.Space(
        voxels=voxels,
        spacing_mm=[spacing_mm] * 3,
        curvature_radii_mm=[RADIUS_MM],
        advance=round(STEP_MM / spacing_mm),
        rolls=8,
        cone_rad=math.radians(CONE_DEG),
        direction_spacing_rad=math.radians(DIRECTIONS_DEG),
        noise_rad_per_sqrt_mm=math.radians(NOISE_DEG) / math.sqrt(STEP_MM),
        insertion_per_mm=1.0,
        rotation=1.0,
        collision=1e4,
        exit=1e4,
        straight=(0.0, 1.0),
    )


def differences(table: Any, target_mm: Any, entries: int, runs: int) -> np.ndarray:
    """Return predicted minus realised success (points) at random entries that aim roughly at the target."""
    random, found = np.random.default_rng(3), []
    while len(found) < entries:
        at = np.array([0.0, *(48 * (0.08 + 0.84 * random.random(2)))])
        slopes = (np.array(target_mm) - at)[1:] / target_mm[0] + 0.5 * (random.random(2) - 0.5)
        pose = np.array([[*at, 1.0, *slopes]])
        try:
            predicted = table.look_up(pose)["success"][0]
        except ValueError:  # beyond the cone
            continue
        outcomes = table.rollout(pose, runs=runs, seed=7)["outcome"]
        found.append(100 * (predicted - np.mean(outcomes == Outcome.TARGET.code)))
    return np.array(found)


def main() -> None:
    """Measure both volumes with both ways to interpolate success, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, nargs="+", default=[2.0, 1.0], metavar="MM")
    parser.add_argument("--entries", type=int, default=30)
    parser.add_argument("--runs", type=int, default=1000)
    options = parser.parse_args()
    print(f"Predicted less realised success in 3D, in points; commit {machine.commit()}.\n")
    print("| volume | spacing | success | million states a second | mean difference | bias | largest |")
    print("|---|--:|---|--:|--:|--:|--:|")
    for spacing_mm in options.spacing:
        for name, target_mm, obstacles in VOLUMES:
            space = space_of(target_mm, obstacles, spacing_mm)
            for order in ("bilinear", "cubic"):
                table = space.solve(cubic_success=order == "cubic", threads=1)
                rate = float(np.prod(space.shape)) / table.report()["seconds"] / 1e6
                found = differences(table, target_mm, options.entries, options.runs)
                print(
                    f"| {name} | {spacing_mm:g} mm | {order} | {rate:.1f} | {abs(found).mean():.1f} | "
                    f"{found.mean():+.1f} | {abs(found).max():.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
