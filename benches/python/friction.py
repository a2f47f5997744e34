"""Measure the time to simulate 60 s of friction at 200 Hz, by model; the goal is 50 ms for Model III-B.

python benches/python/friction.py --json friction.json
"""

import argparse
import json
import sys
from pathlib import Path
from statistics import median
from time import perf_counter

import machine

from needleplan.models import AveragedLuGre, Karnopp, Model, Profile, distributed, fit, simulate
from needleplan.signals import Motion, Record, Start, sinusoid
from needleplan_thesis.chapter3.published import model_i, model_ii, model_iii_b

GOAL_MS = 50.0
RUNS = 31
CASE = 1


def main() -> int:
    """Run all measurements and print a table. Returns exit code 1 if the goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    motion = sinusoid(offset_mm=38, amplitude_mm=25, frequency_hz=0.05, cycles=3, start=Start.MIDDLE, ramp_cycles=0.25)[
        slice(12_000)
    ]
    figures = {f"{name}, ms": 1e3 * timed(model, motion) for name, model in models().items()}
    figures["distributed, 0.1 mm, ms"] = 1e3 * once(motion)
    figures["fit of Model III-B, ms"] = 1e3 * fitted(models()["Model III-B"], motion)
    goal = figures["Model III-B, ms"]
    print(f"60 s at 200 Hz, {len(motion):,} samples, tip inside of the tissue; median of {RUNS} runs\n")
    for name, value in figures.items():
        print(f"{name:28}  {value:10.4g}")
    print(f"\ngoal: Model III-B in less than {GOAL_MS:g} ms: {'met' if goal < GOAL_MS else 'missed'}")
    if options.json:
        record = {"machine": about, "samples": len(motion), "goal_ms": GOAL_MS, "figures": figures}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return int(goal >= GOAL_MS)


def models() -> dict[str, Model]:
    """Return the models of the friction family by name, with the parameters of case 1."""
    return {
        "Karnopp": Karnopp(mu_c=0.3, sigma2=0.02),
        "Model I": model_i(CASE),
        "Model II": model_ii(CASE),
        "Model II with Fn(L)": model_ii(CASE).with_values(profile=Profile.ISOSCELES),
        "Model III-A": AveragedLuGre(**{**vars(model_iii_b(CASE)), "profile": Profile.RIGHT}),
        "Model III-B": model_iii_b(CASE),
    }


def timed(model: Model, motion: Motion) -> float:
    """Return the median time (s) of a simulation, after one run that is not timed."""
    simulate(model, motion)
    seconds = []
    for _ in range(RUNS):
        began = perf_counter()
        simulate(model, motion)
        seconds.append(perf_counter() - began)
    return median(seconds)


def once(motion: Motion) -> float:
    """Return the time (s) of a single simulation by the distributed model."""
    began = perf_counter()
    distributed(model_ii(CASE), motion, Profile.ISOSCELES)
    return perf_counter() - began


def fitted(model: Model, motion: Motion) -> float:
    """Return the median time (s) of three fits of six parameters, from starting values wrong by a factor of 1.5."""
    record = Record({
        "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
        "force_n": simulate(model, motion).output,
    })  # fmt: skip
    start = model.with_values(**{name: 1.5 * getattr(model, name) for name in ("sigma0", "sigma1", "mu_c", "mu_s")})
    seconds = []
    for _ in range(3):
        began = perf_counter()
        fit(start, record)
        seconds.append(perf_counter() - began)
    return median(seconds)


if __name__ == "__main__":
    sys.exit(main())
