"""Measure the computing time of needle deflection: one shape, many at once, an insertion, a step of the path law.

PYTHONPATH=. python benches/python/deflection.py --json deflection.json
PYTHONPATH=. python benches/python/deflection.py --insertions 200            # short test run
"""

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import machine
import numpy as np

from needleplan.models import NeedleShaft, TipPath, fit, simulate
from needleplan.models.deflection import (
    AxialTerms,
    Beam,
    ElasticTissue,
    FreePath,
    march,
    solve_elements,
    tip_path_mm,
)
from needleplan.signals import Motion, Record
from tests.reference.exact_beam import solve_exact

NEEDLE = NeedleShaft(0.718, 0.413, 203.0, math.radians(24.8))
TISSUE = ElasticTissue(3.87e-3, 123.9e-6)
# Goal for the computing time of one shape among many (us).
GOAL_US = 5.0


def main() -> int:
    """Run all measurements and print two tables; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--insertions", type=int, default=4000, metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    together = shapes(options.insertions)
    others = {**alone(), **insertions()}
    print(
        f"{options.insertions:,} insertions at once, 80 mm deep, different forces; goal: below {GOAL_US:g} us a shape\n"
    )
    print("| shape, tip and coil | us each | worst relative error |")
    print("|---|--:|--:|")
    for name, (microseconds, error) in together.items():
        print(f"| {name} | {microseconds:.2f} | {error:.1e} |")
    print("\n| one at a time | |")
    print("|---|--:|")
    for name, value in others.items():
        print(f"| {name} | {value:.3g} |")
    print(f"\n{about['processor']}, load {about['load_before']}, commit {about['commit']}, {about['date']}")
    if options.json:
        told = {name: {"us": us, "error": error} for name, (us, error) in together.items()}
        record = {"machine": about, "insertions": options.insertions, "together": told, "alone": others}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


def shapes(count: int) -> dict[str, tuple[float, float]]:
    """Return, by method, microseconds per shape of `count` shapes at once and the largest relative error at the tip.

    The reference is the exact solution, or a very fine mesh if no exact solution exists.
    """
    force, depth = np.linspace(0.01, 0.2, count), np.full(count, 80.0)
    results = {}
    for terms in (AxialTerms.PLAIN, AxialTerms.PRINTED, AxialTerms.CONSISTENT):

        def made(terms: AxialTerms = terms) -> Beam:
            return Beam.of(NEEDLE, TISSUE, depth, force, 15.0, terms=terms)

        if terms is AxialTerms.CONSISTENT:
            true = solve_elements(made(), element_mm=1.0)
        else:
            true = solve_exact(made()).tip_mm
            results[f"{terms}, exact"] = (each_us(lambda made=made: both(solve_exact(made())), count), 0.0)
        for element in (None, 4.0):
            error = float(np.abs(solve_elements(made(), element_mm=element) / true - 1).max())
            seconds = each_us(lambda made=made, element=element: solve_elements(made(), 9.3, element_mm=element), count)
            results[f"{terms}, elements of {'1/(5 lam)' if element is None else '4 mm'}"] = (seconds, error)
    return results


def both(shape: object) -> object:
    """Return the deflections of a shape at the tip and at the coil, 9.3 mm behind it."""
    return shape.at(0.0), shape.at(9.3)  # type: ignore[attr-defined]


def alone() -> dict[str, float]:
    """Return the microseconds of single calls, by name."""
    beam = Beam.of(NEEDLE, TISSUE, 80.0, 0.15, 15.0)
    plain = Beam.of(NEEDLE, TISSUE, 80.0, 0.15, 15.0, terms=AxialTerms.PLAIN)
    tip = FreePath(NEEDLE, TISSUE).advanced(10.0, 0.05)
    return {
        "exact, us": each_us(lambda: solve_exact(plain).at(0.0)),
        "elements, us": each_us(lambda: solve_elements(beam)),
        "path law, one step, us": each_us(lambda: tip.advanced(10.5, 0.05).lateral_mm),
    }


def insertions() -> dict[str, float]:
    """Return the milliseconds of insertions to 80 mm, of a simulation and of a fit, by name."""
    depth = np.arange(161) / 2
    force = 0.05 * np.minimum(depth / 20, 1) ** 2
    many = np.linspace(0.5, 1.5, 500)[:, None] * force
    time = np.arange(0, 8, 0.025)
    motion = Motion.sampled(time, 10 * time, np.full_like(time, 10.0))
    model = TipPath.of(NEEDLE, TISSUE.stiffness_n_mm2, 0.05)
    noise = 0.05 * np.random.default_rng(0).standard_normal(time.size)
    record = Record({
        "time_s": time, "depth_mm": 10 * time, "velocity_mm_s": motion.velocity_mm_s,
        "y_mm": simulate(model, motion).output + noise,
    })  # fmt: skip
    return {
        "march with memory, 160 steps, ms": each_us(lambda: march(NEEDLE, TISSUE, force, 0.5, 15.0), 1000),
        "the same, 500 insertions at once, ms each": each_us(lambda: march(NEEDLE, TISSUE, many, 0.5, 15.0), 500_000),
        "path law, 161 depths, ms": each_us(lambda: tip_path_mm(NEEDLE, TISSUE, depth, 0.9 * force), 1000),
        "TipPath simulated, 320 samples, ms": each_us(lambda: simulate(model, motion), 1000),
        "TipPath fitted, 320 samples, ms": each_us(lambda: fit(model.with_values(cutting_force=0.02), record), 1000),
    }


def each_us(work: Callable[[], object], share: int = 1) -> float:
    """Call `work` repeatedly for at least half a second; return the shortest time (us), divided by `share`."""
    work()
    best, end = math.inf, perf_counter() + 0.5
    while perf_counter() < end:
        began = perf_counter()
        work()
        best = min(best, perf_counter() - began)
    return 1e6 * best / share


if __name__ == "__main__":
    sys.exit(main())
