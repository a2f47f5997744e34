"""Measure how often intervals of a mean over trials, and the range of the next trial, hold the truth.

python benches/python/trials.py --json benches/results/trials.json > benches/results/trials.md
python benches/python/trials.py --runs 2000        # short test run

Trial i measures theta + u_i + e_i with u_i ~ N(0, tau^2) and e_i ~ N(0, s_i^2). `combine` gets the s_i, or does not.
Beside it stand other intervals for the same numbers: `combine`, never narrower than the interval for tau = 0; two
standard deviations of the mean; weights 1 / s^2 with Birge's ratio; weights 1 / (s^2 + tau^2) with tau by DerSimonian
and Laird and the variance of Hartung and Knapp, with and without the factor of at least one.

The second part simulates and identifies whole insertions: `identify curvature`, `deflection` and `shaft-and-tip`.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from needleplan.identification import TrackerNoise, combine, curvature, deflection, shaft_and_tip
from needleplan.models import ShaftAndTip, TipPath, arc_step, simulate
from needleplan.signals import Array, Motion, Record, insertion_cycles

# Range of the coverage that counts as correct, from the requirement.
WANTED = (0.92, 0.98)
# Standard deviations s_i of the errors of the trials, in units of the smallest.
ERRORS = (
    (1, 1), (1, 2), (1, 3),
    (1, 1, 1), (1, 2, 3), (1, 1, 3), (1, 3, 3),
    (1, 1, 1, 1, 1), (1, 2, 2, 3, 3), (1, 1, 1, 1, 3), (1, 3, 3, 3, 3),
)  # fmt: skip
# Errors that differ by more, where a coverage outside of 92 to 98 % is expected.
EXTREME = ((1, 10), (1, 1, 10), (1, 10, 10), (1, 1, 1, 10, 10), (1, 100), (1, 1, 100), (1, 1, 1, 100, 100))
# Scatter tau between trials, in units of the root mean square of the s_i.
SCATTERS = (0.0, 1.0, 3.0)

Interval = Callable[[Array, Array], tuple[float, float]]


def plain(x: Array, _: Array) -> tuple[float, float]:
    """Return mean and half width of two standard deviations of the mean."""
    return float(x.mean()), float(2 * x.std(ddof=1) / np.sqrt(len(x)))


def birge(x: Array, s: Array) -> tuple[float, float]:
    """Return the mean with weights 1 / s^2 and 1.96 of its standard deviations, times Birge's ratio if above one."""
    weight = 1 / s**2
    mean = float(weight @ x / weight.sum())
    ratio = max(float(weight @ (x - mean) ** 2) / (len(x) - 1), 1.0)
    return mean, 1.96 * float(np.sqrt(ratio / weight.sum()))


def moments(x: Array, s: Array, least: float = 0.0) -> tuple[float, float]:
    """Return the mean with weights 1 / (s^2 + tau^2), and Student's half width with a factor of at least `least`."""
    weight = 1 / s**2
    mean = weight @ x / weight.sum()
    excess = weight @ (x - mean) ** 2 - (len(x) - 1)
    weight = 1 / (s**2 + max(0.0, excess / (weight.sum() - (weight**2).sum() / weight.sum())))
    mean = float(weight @ x / weight.sum())
    factor = max(float(weight @ (x - mean) ** 2) / (len(x) - 1), least)
    return mean, float(stdtrit(len(x) - 1, 0.975) * np.sqrt(factor / weight.sum()))


def modified(x: Array, s: Array) -> tuple[float, float]:
    """Return the same with a factor of at least one."""
    return moments(x, s, 1.0)


def known(x: Array, s: Array) -> tuple[float, float]:
    """Return mean and half width of `combine` with the standard deviations of the trials."""
    mean = combine(x, s)
    return mean.value, mean.interval()[1] - mean.value


def unknown(x: Array, _: Array) -> tuple[float, float]:
    """Return mean and half width of `combine` without the standard deviations of the trials."""
    mean = combine(x)
    return mean.value, mean.interval()[1] - mean.value


def floored(x: Array, s: Array) -> tuple[float, float]:
    """Return mean and half width of `combine`, never narrower than the interval of the mean for tau = 0."""
    mean, reach = known(x, s)
    return mean, max(reach, 1.96 * float(np.sum(s**-2.0)) ** -0.5)


INTERVALS: dict[str, Interval] = {
    "`combine`": known,
    "`combine`, s unknown": unknown,
    "`combine`, at least that for tau = 0": floored,
    "two sd": plain,
    "Birge": birge,
    "moments": moments,
    "moments, at least one": modified,
}


def study(errors: tuple[int, ...], scatter: float, runs: int, seed: int) -> dict[str, object]:
    """Return the coverage and the median half width of each interval, and how often the range holds the next trial."""
    random, s = np.random.default_rng(seed), np.array(errors, float)
    tau = scatter * float(np.sqrt(np.mean(s**2)))
    held = dict.fromkeys(INTERVALS, 0)
    widths: dict[str, list[float]] = {name: [] for name in INTERVALS}
    following = 0
    for _ in range(runs):
        x = np.hypot(s, tau) * random.standard_normal(len(s))
        for name, interval in INTERVALS.items():
            mean, reach = interval(x, s)
            held[name] += abs(mean) <= reach
            widths[name].append(reach)
        region = combine(x, s).next_trial()
        assert region is not None
        following += region[0] <= np.hypot(random.choice(s), tau) * random.standard_normal() <= region[1]
    return {
        "errors": errors,
        "scatter": scatter,
        "coverage": {name: count / runs for name, count in held.items()},
        "half_width": {name: float(np.median(each)) for name, each in widths.items()},
        "next_trial": following / runs,
    }


DEPTH_MM = np.linspace(2.0, 100.0, 99)
"""Depths of the samples of an insertion."""

SCATTER_SHARE = 0.05
"""Standard deviation between insertions of a parameter, relative to its mean, where insertions scatter."""


def path(random: np.random.Generator, bend: float, heading: float) -> Record:
    """Return an insertion along an arc, with white noise of 0.1 mm."""
    x, y, _ = arc_step(0.0, 0.0, heading, bend, DEPTH_MM)
    noise = random.normal(0.0, 0.1, DEPTH_MM.size)
    return Record(
        {"time_s": DEPTH_MM / 5, "depth_mm": DEPTH_MM, "x_mm": x, "y_mm": y + noise}, f"{random.integers(9**9)}"
    )


def by_curvature(random: np.random.Generator, trials: int, scatter: float) -> list[bool]:
    """Return whether the intervals of `identify curvature` hold curvature and heading."""
    bends, headings = (1 + scatter * random.standard_normal((2, trials))) * np.array([[1 / 300], [0.05]])
    records = [path(random, *pose) for pose in zip(bends, headings, strict=True)]
    estimates = curvature.identify(records, segments=1, layers=1, noise=TrackerNoise.WHITE).estimates
    truth = {"curvature_per_mm": 1 / 300, "heading_rad": 0.05}
    return [estimates[name].low <= value <= estimates[name].high for name, value in truth.items()]


def by_deflection(random: np.random.Generator, trials: int, scatter: float) -> list[bool]:
    """Return whether the interval of `identify deflection` holds the curvature far behind the entry."""
    true = TipPath.of(deflection.NEEDLE, deflection.TISSUE.stiffness_n_mm2, 0.05)
    motion = Motion.sampled(DEPTH_MM / 5, DEPTH_MM)
    records = []
    for share in 1 + scatter * random.standard_normal(trials):
        y = simulate(replace(true, cutting_force=true.cutting_force * share), motion).output
        columns = {"time_s": motion.time_s, "depth_mm": DEPTH_MM, "y_mm": y + random.normal(0.0, 0.1, y.size)}
        records.append(Record(columns, f"{len(records)}"))
    found = deflection.identify(records).estimates["curvature"]
    return [found.low <= true.curvature_1_mm <= found.high]


def by_force(random: np.random.Generator, trials: int, scatter: float) -> list[bool]:
    """Return whether the intervals of `identify shaft-and-tip` hold friction and cutting force."""
    true = ShaftAndTip(friction=0.01, cutting=0.5, onset_mm=3.0, presliding_mm=0.5)
    motion = insertion_cycles(50.0, 10.0, rate_hz=20.0)
    records = []
    for number, (first, second) in enumerate(np.exp(scatter * random.standard_normal((trials, 2)))):
        model = replace(true, friction=true.friction * first, cutting=true.cutting * second)
        force = simulate(model, motion).output + random.normal(0.0, 0.02, len(motion))
        columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
        records.append(Record({**columns, "force_n": force}, f"{number}"))
    estimates = shaft_and_tip.identify(records, starts=1).estimates
    return [estimates[name].low <= getattr(true, name) <= estimates[name].high for name in ("friction", "cutting")]


KINDS = {"curvature": by_curvature, "deflection": by_deflection, "shaft-and-tip": by_force}


def shares(rows: list[dict[str, object]]) -> Iterator[str]:
    """Return the lines of the table of the intervals."""
    yield f"| s | tau / rms(s) | {' | '.join(INTERVALS)} | next trial |"
    yield "|---|--:" + "|--:" * (len(INTERVALS) + 1) + "|"
    for row in rows:
        coverage, widths = row["coverage"], row["half_width"]
        cells = [f"{marked(coverage[name])}, {widths[name]:.2f}" for name in INTERVALS]  # type: ignore[index]
        errors = " : ".join(map(str, row["errors"]))  # type: ignore[call-overload]
        yield f"| {errors} | {row['scatter']:g} | {' | '.join(cells)} | {marked(row['next_trial'])} |"  # type: ignore[arg-type]


def marked(share: float) -> str:
    """Return a coverage in percent, bold outside of the range that counts as correct."""
    text = f"{100 * share:.1f} %"
    return text if WANTED[0] <= share <= WANTED[1] else f"**{text}**"


def main() -> int:
    """Run all cases and print the tables; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10_000, help="simulated sets of trials a row (10,000)")
    parser.add_argument("--insertions", type=int, default=300, help="simulated sets of insertions a row (300)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    seeds = iter(range(1000))
    parts = [
        [study(errors, scatter, options.runs, next(seeds)) for errors in kinds for scatter in SCATTERS]
        for kinds in (ERRORS, EXTREME)
    ]
    low, high = (100 * np.sqrt(share * (1 - share) / options.runs) for share in (0.95, 0.98))
    print("Coverage of 95 % intervals of a mean over trials, and median half width in units of the smallest s.")
    print(f"{options.runs} runs a row: the standard error is {low:.2f} % at 95 %, {high:.2f} % at 98 %.")
    print("Bold: outside of 92 to 98 %.\n")
    print("\n".join(shares(parts[0])))
    print("\nErrors that differ by more:\n")
    print("\n".join(shares(parts[1])))
    print(f"\nWhole insertions, {options.insertions} runs a row, bold as above.\n")
    print("| `identify` | insertions | scatter between insertions | parameters | inside |\n|---|--:|--:|--:|--:|")
    whole = []
    for kind, identify in KINDS.items():
        for trials in (2, 3, 5):
            for scatter in (0.0, SCATTER_SHARE):
                random = np.random.default_rng(next(seeds))
                held = [identify(random, trials, scatter) for _ in range(options.insertions)]
                share = float(np.mean(held))
                whole.append({"kind": kind, "trials": trials, "scatter": scatter, "inside": share})
                print(f"| {kind} | {trials} | {100 * scatter:g} % | {len(held[0])} | {marked(share)} |", flush=True)
    if options.json:
        options.json.write_text(
            json.dumps({"intervals": parts, "insertions": whole}, indent=1) + "\n", encoding="utf-8"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
