"""Measure how often intervals of fits of several recordings hold the truth if the parameters scatter between trials.

Forces of two to five trials are simulated with white noise. In every trial all parameters differ from the truth by
tau n, in the coordinate of the fit, with a normal number n; tau is 0, 1 or 3 times the error by the noise of one trial.
Counted are the 95 % intervals that hold the truth, of the joint fit alone, and with the scatter between trials
(`needleplan.identification._between_trials`).

    python benches/python/trial_scatter.py [--runs N] [-o benches/results/trial_scatter.md]

The fits start at the truth, so that a local optimum does not count as a wrong interval.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.identification._between_trials import with_scatter
from needleplan.models import Fit, Karnopp, LumpedOnTissue, Model, fit, simulate
from needleplan.models.force import ForceModel2
from needleplan.signals import Motion, Record, insertion_cycles, lspb, sinusoid

NOISE_N = 0.02
FORCE = {
    "sigma0": 7.9e-3,
    "sigma1": 2.46,
    "sigma2": 4.14e-3,
    "f1": 0.0559,
    "f2": -0.0211,
    "alpha": 0.0525,
    "beta": 0.0255,
}
TRIALS, RATIOS = (2, 3, 5), (0.0, 1.0, 3.0)


@dataclass(frozen=True)
class Case:
    """A model, its free parameters, and the motion of trial i of n."""

    name: str
    model: Model
    free: tuple[str, ...]
    motion: Callable[[int], Motion]


def _reversals(number: int) -> Motion:  # noqa: ARG001
    return lspb([20, 60, 20, 60, 20], [2, 5, 10, 4], rate_hz=20.0)


def _one_speed(number: int) -> Motion:
    """In and out at a constant speed: mu_c and sigma2 cannot be separated."""
    speed = (2.0, 5.0, 10.0, 3.0, 7.0)[number]
    time = np.arange(0.0, 80 / speed, 0.05)
    velocity = np.where(time < 40 / speed, speed, -speed)
    return Motion.sampled(time, 20 + 40 - np.abs(40 - speed * time), velocity)


def _insertion(number: int) -> Motion:  # noqa: ARG001
    return insertion_cycles(60.0, 5.0, rate_hz=20.0)


def _sinusoid(number: int) -> Motion:
    return sinusoid(offset_mm=60.0, amplitude_mm=(4.0, 8.0, 12.0, 6.0, 10.0)[number], frequency_hz=0.2, cycles=2.0,
                    rate_hz=20.0)  # fmt: skip


CASES = (
    Case("friction, every trial with several speeds", Karnopp(mu_c=0.5, sigma2=0.02), ("mu_c", "sigma2"), _reversals),
    Case("friction, one speed a trial", Karnopp(mu_c=0.5, sigma2=0.02), ("mu_c", "sigma2"), _one_speed),
    Case(
        "force by depth", ForceModel2(**FORCE),
        ("sigma1", "sigma2"), _insertion,
    ),
    Case(
        "tissue motion",
        LumpedOnTissue(
            mu_c=0.7, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09, stiffness=0.5, damping=0.1
        ),
        ("mu_c", "stiffness"), _sinusoid,
    ),
)  # fmt: skip


def errors(case: Case) -> dict[str, float]:
    """Return the error of each coordinate by the noise of one trial: that of a fit of five trials, times root five."""
    records = [recorded(case, number, case.model, np.random.default_rng(number)) for number in range(5)]
    found, what = fit(case.model, records, free=case.free).estimates, case.model.parameters()
    return {name: float(np.sqrt(5) * each.sd / what[name].slope(each.value)) for name, each in found.items()}


def recorded(case: Case, number: int, model: Model, rng: np.random.Generator) -> Record:
    """Return a trial of a model with noise."""
    motion = case.motion(number)
    force = simulate(model, motion).output + NOISE_N * rng.standard_normal(len(motion))
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    return Record({**columns, "force_n": force}, f"trial {number + 1}")


def scattered(case: Case, sds: dict[str, float], ratio: float, rng: np.random.Generator) -> Model:
    """Return the model of one trial: each parameter off by `ratio` errors of a single trial, in its coordinate."""
    what = case.model.parameters()
    return case.model.with_values(
        **{
            name: what[name].value(
                what[name].coordinate(getattr(case.model, name)) + ratio * sd * rng.standard_normal()
            )
            for name, sd in sds.items()
        }
    )


def coverage(case: Case, trials: int, ratio: float, runs: int, seed: int = 0) -> tuple[float, float]:
    """Return the shares of intervals with the truth: of the joint fit, and with the scatter between trials."""
    rng, sds = np.random.default_rng([seed, trials, round(10 * ratio)]), errors(case)
    hits = np.zeros(2)
    for _ in range(runs):
        records = [recorded(case, number, scattered(case, sds, ratio, rng), rng) for number in range(trials)]
        joint = fit(case.model, records, free=case.free)
        hits += [_held(case, found) for found in (joint, with_scatter(joint, records).fit)]
    before, after = hits / (runs * len(case.free))
    return float(before), float(after)


def _held(case: Case, found: Fit) -> int:
    return sum(
        found.estimates[name].low <= getattr(case.model, name) <= found.estimates[name].high for name in case.free
    )


def table(cases: Sequence[Case], runs: Callable[[Case], int]) -> list[str]:
    """Return the lines of the table."""
    rows = ["| fit | trials | scatter / error | runs | joint fit alone | with the scatter between trials |",
            "|---|--:|--:|--:|--:|--:|"]  # fmt: skip
    for case in cases:
        for trials in TRIALS:
            if case.motion is _one_speed and trials == 2:
                continue  # without one of two trials nothing is determined
            for ratio in RATIOS:
                before, after = coverage(case, trials, ratio, runs(case))
                rows.append(f"| {case.name} | {trials} | {ratio:g} | {runs(case)} | {before:.1%} | {after:.1%} |")
                print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("-o", "--output", default="benches/results/trial_scatter.md")
    options = parser.parse_args()
    rows = table(CASES, lambda case: 2 * options.runs // 5 if case.motion is _sinusoid else options.runs)
    text = [
        "# Scatter between trials in the intervals of fits", "",
        f"`python benches/python/trial_scatter.py --runs {options.runs}`: share of the 95 % intervals that hold the "
        "truth.",
        "", *rows, "",
    ]  # fmt: skip
    Path(options.output).write_text("\n".join(text))


if __name__ == "__main__":
    main()
