"""Measure how often the 95 % intervals of a fit hold the true parameters, for white and correlated noise.

python benches/python/fit_intervals.py --json benches/results/fit_intervals.json > benches/results/fit_intervals.md
python benches/python/fit_intervals.py --runs 10        # short test run

Two insertions and retractions of force Model II (other speeds and depths each), noise of 5 % of the largest force, at
50 to 500 Hz: white, AR(1) with the coefficient 0.9, AR(2) with a resonance, and white noise after a moving average of
five samples. The fit starts at the truth, so that a local optimum does not count as a wrong interval. All intervals
count, also those of parameters that are not identified. `kernel` is the estimator of Newey and West with 3 n^(1/3)
lags, which the fit used before.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from needleplan.models import fit, simulate
from needleplan.models.force import ForceModel2
from needleplan.signals import Array, Record, insertion_cycles

TRUE = ForceModel2(sigma0=7.9e-3, sigma1=2.46, sigma2=4.14e-3, f1=0.0559, f2=-0.0211, alpha=0.0525, beta=0.0255)
NOISE_SHARE = 0.05
RATES_HZ = (50.0, 200.0, 500.0)
# Range of the coverage that counts as correct, from the requirement.
WANTED = (0.92, 0.98)


def white(random: np.random.Generator, count: int) -> Array:
    """Return white noise of unit variance."""
    return random.standard_normal(count)


def first_order(random: np.random.Generator, count: int) -> Array:
    """Return an AR(1) process of unit variance with the coefficient 0.9."""
    return _process(random, count, [0.9])


def resonant(random: np.random.Generator, count: int) -> Array:
    """Return an AR(2) process of unit variance with a resonance at a tenth of the sampling rate."""
    return _process(random, count, [2 * 0.9 * np.cos(0.2 * np.pi), -0.81])


def averaged(random: np.random.Generator, count: int) -> Array:
    """Return white noise after a moving average of five samples, with unit variance."""
    return np.convolve(random.standard_normal(count + 4), np.ones(5) / np.sqrt(5), mode="valid")


def _process(random: np.random.Generator, count: int, coefficients: list[float]) -> Array:
    from scipy.signal import lfilter

    warm = 500
    found = lfilter([1.0], [1.0, *(-each for each in coefficients)], random.standard_normal(count + warm))[warm:]
    long = lfilter([1.0], [1.0, *(-each for each in coefficients)], np.eye(1, 4000)[0])
    return np.asarray(found / np.sqrt(np.sum(long**2)))


NOISES: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "white": white, "AR(1), 0.9": first_order, "AR(2), resonant": resonant, "average of five": averaged,
}  # fmt: skip


def study(noise: str, rate_hz: float, runs: int, seed: int, kernel: bool) -> dict[str, object]:
    """Return the coverage of one noise and rate, by parameter, for the fit and, if asked, for the kernel estimator."""
    random = np.random.default_rng([seed, int(rate_hz)])
    motions = [insertion_cycles(80.0, 10.0, rate_hz=rate_hz), insertion_cycles(60.0, 5.0, rate_hz=rate_hz)]
    forces = [simulate(TRUE, motion).output for motion in motions]
    size = NOISE_SHARE * max(float(np.ptp(force)) for force in forces)
    held: dict[str, list[bool]] = {"fit": [], "kernel": []}
    for _ in range(runs):
        records = [
            Record({
                "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
                "force_n": force + size * NOISES[noise](random, len(force)),
            })
            for motion, force in zip(motions, forces, strict=True)
        ]  # fmt: skip
        for name, lags in (("fit", None), ("kernel", round(3 * len(motions[0]) ** (1 / 3))))[: 1 + kernel]:
            found = fit(TRUE, records, lags=lags)
            held[name] += [
                each.low <= getattr(TRUE, parameter) <= each.high
                for parameter, each in found.estimates.items()
            ]  # fmt: skip
    return {
        "noise": noise, "rate_hz": rate_hz, "runs": runs, "intervals": len(held["fit"]),
        **{name: float(np.mean(some)) for name, some in held.items() if some},
        "by_parameter": dict(zip(found.free, np.reshape(held["fit"], (runs, -1)).mean(axis=0).tolist(), strict=True)),
    }  # fmt: skip


def main() -> int:
    """Run all cases and print a table; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--rates", type=float, nargs="+", default=RATES_HZ)
    parser.add_argument("--noises", nargs="+", default=list(NOISES), choices=NOISES)
    parser.add_argument("--no-kernel", action="store_true", help="leave out the kernel estimator")
    parser.add_argument("--seed", type=int, default=100, help="seed of the noise (100)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows = []
    print("| noise | rate | runs, intervals | inside | 92 to 98 %? | least, by parameter | kernel estimator |")
    print("|---|--:|--:|--:|---|---|--:|")
    for rate in options.rates:
        for noise in options.noises:
            row = study(noise, rate, options.runs, options.seed, not options.no_kernel)
            rows.append(row)
            inside = float(str(row["fit"]))
            says = "yes" if WANTED[0] <= inside <= WANTED[1] else "**no**"
            counts = f"{row['runs']}, {row['intervals']}"
            kernel = f"{100 * float(str(row['kernel'])):.1f} %" if "kernel" in row else "not run"
            each = row["by_parameter"]
            assert isinstance(each, dict)
            least = min(each, key=lambda name: each[name])
            worst = f"{least} {100 * each[least]:.1f} %"
            print(
                f"| {noise} | {rate:g} Hz | {counts} | {100 * inside:.1f} % | {says} | {worst} | {kernel} |", flush=True
            )
    print(f"\nAll: {100 * np.mean([float(str(each['fit'])) for each in rows]):.1f} %.")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
