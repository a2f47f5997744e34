"""Measure how often the 95 % intervals of a fit hold the true parameters, for white and correlated noise.

python benches/python/fit_intervals.py --json benches/results/fit_intervals.json > benches/results/fit_intervals.md
python benches/python/fit_intervals.py --short

Two insertions and retractions of force Model I or II (other speeds and depths each), or two motions with reversals and
several speeds of a friction model, noise of 5 % of the range of the force, at 50 to 500 Hz: white, AR(1) with the
coefficient 0.9, AR(2) with a resonance, and white noise after a moving average of five samples. The fit starts at the
truth, so that a local optimum does not count as a wrong interval. All intervals count, also those of parameters that
are not identified; a column has the identified ones alone. `kernel` is the estimator of Newey and West with 3 n^(1/3)
lags.
"""

import argparse
import itertools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from needleplan.models import AveragedLuGre, Karnopp, LumpedLuGre, Model, fit, simulate
from needleplan.models.force import ForceModel1, ForceModel2
from needleplan.signals import Array, Motion, Record, insertion_cycles, lspb

_FORCE = {
    "sigma0": 7.9e-3, "sigma1": 2.46, "sigma2": 4.14e-3, "f1": 0.0559, "f2": -0.0211, "alpha": 0.0525, "beta": 0.0255,
}  # fmt: skip
_BRISTLES = {"mu_c": 0.73, "sigma2": 0.016, "sigma0": 1.3, "sigma1": 0.46, "mu_s": 0.034, "alpha": 0.09}
MODELS: dict[str, Model] = {
    "force I": ForceModel1(**_FORCE),
    "force II": ForceModel2(**_FORCE),
    "Karnopp": Karnopp(mu_c=0.5, sigma2=0.02),
    "friction II": LumpedLuGre(**_BRISTLES),
    "friction III-B": AveragedLuGre(**_BRISTLES),
}
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


def motions_of(name: str, rate_hz: float) -> list[Motion]:
    """Return the two motions of a model."""
    if name.startswith("force"):
        return [insertion_cycles(80.0, 10.0, rate_hz=rate_hz), insertion_cycles(60.0, 5.0, rate_hz=rate_hz)]
    return [lspb([20, 60, 20, 60, 20], speeds, rate_hz=rate_hz) for speeds in ([2, 5, 10, 4], [3, 8, 6, 4])]


def study(name: str, noise: str, rate_hz: float, runs: int, seed: int, kernel: bool) -> dict[str, object]:
    """Return the coverage of one noise and rate, by parameter, for the fit and, if asked, for the kernel estimator."""
    random = np.random.default_rng([seed, int(rate_hz)])
    true, motions = MODELS[name], motions_of(name, rate_hz)
    forces = [simulate(true, motion).output for motion in motions]
    size = NOISE_SHARE * max(float(np.ptp(force)) for force in forces)
    held: dict[str, list[bool]] = {"fit": [], "kernel": []}
    identified: list[bool] = []
    for _ in range(runs):
        records = [
            Record({
                "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
                "force_n": force + size * NOISES[noise](random, len(force)),
            })
            for motion, force in zip(motions, forces, strict=True)
        ]  # fmt: skip
        for estimator, lags in (("fit", None), ("kernel", round(3 * len(motions[0]) ** (1 / 3))))[: 1 + kernel]:
            found = fit(true, records, lags=lags)
            held[estimator] += [
                each.low <= getattr(true, parameter) <= each.high
                for parameter, each in found.estimates.items()
            ]  # fmt: skip
            if lags is None:
                identified += [each.identified for each in found.estimates.values()]
    return {
        "model": name, "noise": noise, "rate_hz": rate_hz, "runs": runs, "intervals": len(held["fit"]),
        **{estimator: float(np.mean(some)) for estimator, some in held.items() if some},
        "identified": float(np.mean(np.array(held["fit"])[identified])) if any(identified) else None,
        "by_parameter": dict(zip(found.free, np.reshape(held["fit"], (runs, -1)).mean(axis=0).tolist(), strict=True)),
    }  # fmt: skip


def main() -> int:
    """Run all cases and print a table; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--models", nargs="+", default=["force II"], choices=MODELS)
    parser.add_argument("--short", action="store_true", help="two runs of two models, in seconds")
    parser.add_argument("--rates", type=float, nargs="+", default=RATES_HZ)
    parser.add_argument("--noises", nargs="+", default=list(NOISES), choices=NOISES)
    parser.add_argument("--no-kernel", action="store_true", help="leave out the kernel estimator")
    parser.add_argument("--seed", type=int, default=100, help="seed of the noise (100)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    if options.short:
        options.runs, options.models, options.rates, options.noises = 2, ["force II", "Karnopp"], [50.0], ["AR(1), 0.9"]
    rows = []
    print(
        "| model | noise | rate | runs, intervals | inside | 92 to 98 %? | of identified ones | least, by parameter | "
        "kernel estimator |"
    )
    print("|---|---|--:|--:|--:|---|--:|---|--:|")
    for rate, noise, name in itertools.product(options.rates, options.noises, options.models):
        row = study(name, noise, rate, options.runs, options.seed, not options.no_kernel)
        rows.append(row)
        inside = float(str(row["fit"]))
        says = "yes" if WANTED[0] <= inside <= WANTED[1] else "**no**"
        counts = f"{row['runs']}, {row['intervals']}"
        sure = f"{100 * float(str(row['identified'])):.1f} %" if row["identified"] is not None else "none"
        kernel = f"{100 * float(str(row['kernel'])):.1f} %" if "kernel" in row else "not run"
        each = row["by_parameter"]
        assert isinstance(each, dict)
        least = min(each, key=lambda parameter: each[parameter])
        worst = f"{least} {100 * each[least]:.1f} %"
        print(
            f"| {name} | {noise} | {rate:g} Hz | {counts} | {100 * inside:.1f} % | {says} | {sure} | {worst} | "
            f"{kernel} |",
            flush=True,
        )
    print(f"\nAll: {100 * np.mean([float(str(each['fit'])) for each in rows]):.1f} %.")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
