"""Measure the joint filter: its time per sample with any model, and its recovery from clipped starts.

python benches/python/joint_filter.py > benches/results/joint_filter.md
python benches/python/joint_filter.py --starts 2        # short test run

**Time.** Median of the time of an update over one record, for the points of the differences at once and one by one, in
turns in one run.

**Clipped starts.** Force Models I and II with four published parameter sets, an insertion and retraction of 60 mm at
50 Hz, noise of 1.9 mN. Every free parameter of a start is wrong by a factor that is drawn log-uniformly from 1/6 to
6; the seeds are 1000, 1001 and so on. A start with g <= 0 at the surface is not a model: f1 is clipped to just above
the bound, as a caller would do. The first N clipped and the first N other starts of every set are run; with f2 > 0 no
start is clipped. Recovered: the mean absolute error of the open loop is below 10 mN.
"""

import argparse
import math
from collections.abc import Iterator
from itertools import islice
from statistics import median
from time import perf_counter

import numpy as np

from needleplan.estimation import FilterSample, JointFilter, JointForce, NumericJointSystem
from needleplan.identification import Recipe, identify_by_passes, mean_absolute_error
from needleplan.models import Bicycle, Model, RelaxingForce, simulate
from needleplan.models.force import DepthForce, ForceModel1
from needleplan.signals import Array, MovingAverage, Record, insertion_cycles
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES
from needleplan_thesis.chapter3.published import model_ii, model_iii_b

AVERAGE = MovingAverage(5)
NOISE_N = 1.9e-3
LIMIT_N = 10e-3
FACTOR = 6.0
FIRST_SEED = 1000
# Smallest distance of a clipped f1 from its bound, as a share of the bound.
CLIPPED = 1e-6

MODELS: dict[str, Model] = {
    "force Model II": PUBLISHED_FORCES[0].model,
    "friction Model II": model_ii(1),
    "friction Model III-B": model_iii_b(1),
    "bicycle": Bicycle(0.01),
    "relaxing force, one branch": RelaxingForce(
        contact_mm=2.0, stiffness=0.03, growth=0.1, branch_1=1.0, time_1_s=1.0, boundary_1_mm=30.0
    ),
}


def times_ms(model: Model) -> tuple[float, float]:
    """Return the median time of an update (ms), with the points at once and one by one."""
    motion = insertion_cycles(20.0, 10.0, rate_hz=100.0)
    measured = simulate(model, motion).output
    filters = [
        JointFilter(NumericJointSystem(model, at_once=way), model, variance=1e-4, sd=0.2) for way in (True, False)
    ]
    spent: list[list[float]] = [[], []]
    for row in zip(motion.time_s, motion.depth_mm, measured, motion.velocity_mm_s, strict=True):
        sample = FilterSample(*map(float, row))
        for filtered, seconds in zip(filters, spent, strict=True):
            began = perf_counter()
            filtered.update(sample)
            seconds.append(perf_counter() - began)
    return 1e3 * median(spent[0]), 1e3 * median(spent[1])


def starts(true: DepthForce, clipped: bool) -> Iterator[tuple[int, DepthForce]]:
    """Yield seeds and starts that had to be clipped, or the others."""
    free = [name for name, what in true.parameters().items() if what.free]
    if clipped and true.f2 > 0:
        return
    for seed in range(FIRST_SEED, FIRST_SEED + 1000):
        factors = np.exp(np.random.default_rng(seed).uniform(-math.log(FACTOR), math.log(FACTOR), len(free)))
        values = {name: getattr(true, name) * factor for name, factor in zip(free, factors.tolist(), strict=True)}
        floor = max(0.0, -values.get("f2", true.f2))
        if (values["f1"] <= floor) == clipped:
            yield seed, true.with_values(**{**values, "f1": max(values["f1"], (1 + CLIPPED) * floor)})


def recovered(true: DepthForce, seed: int, start: DepthForce) -> bool:
    """Return whether the passes of the filter find the force from a start."""
    motion = insertion_cycles(60.0, 10.0, rate_hz=50.0)
    clean = AVERAGE.apply(simulate(true, motion).output)
    noise = np.random.default_rng(seed).normal(0.0, NOISE_N, len(motion))
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    truth = Record({**columns, "force_n": clean})
    run = identify_by_passes(JointForce(start), start, [truth.with_column("force_n", clean + noise)], Recipe())
    return run.ok and mean_absolute_error(run.model, [truth], smooth=AVERAGE) < LIMIT_N


def told(counts: Array) -> str:
    """Return "k of n"."""
    return f"{counts[0]} of {counts[1]}"


def main() -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=9, help="clipped, and other, starts of every set (9)")
    options = parser.parse_args()
    print("# Joint filter\n\n" + (__doc__ or "").split("\n\n", 2)[2])
    print("\n## Time of an update\n\n| model | at once, ms | one by one, ms | ratio |\n|---|--:|--:|--:|")
    for name, model in MODELS.items():
        fast, slow = times_ms(model)
        print(f"| {name} | {fast:.2f} | {slow:.2f} | {slow / fast:.1f} |", flush=True)
    print("\n## Recovery\n\n| parameters | clipped starts | other starts |\n|---|--:|--:|")
    sums = np.zeros((2, 2), int)
    for each in PUBLISHED_FORCES[:4]:
        for kind, true in (("II", each.model), ("I", ForceModel1(**each.model.values()))):
            counts = np.zeros((2, 2), int)
            for which, clipped in enumerate((True, False)):
                some = list(islice(starts(true, clipped), options.starts))
                counts[which] = sum(recovered(true, seed, start) for seed, start in some), len(some)
            print(f"| {each.title}, Model {kind} | {told(counts[0])} | {told(counts[1])} |", flush=True)
            sums += counts
    print(f"| all | {told(sums[0])} | {told(sums[1])} |")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
