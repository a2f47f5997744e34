"""Blind data for the diagnosis: the third generator.

It writes axial forces of needle insertions in which one effect, two effects, or none is hidden. It is written
from the pages of docs/, the documented equations of the effects and textbook mechanics, before any result on its
data was known, without sight of the engine's code and of the other generators. Its laws were once compared with
the public models (`apply`, `simulate`). What is drawn, all from `(seed, index)`:

kind
    In each 20 consecutive indices, in random order: 5 `none`, 8 `single`, 3 `pair`, 4 `outside`.
motion
    60 % `rich` (one of five families: steps, strokes, dither, pecking, chained speeds; the held-out trial is of
    another one), 20 % `one_speed` (insertions at one speed, half of the sets with a retraction; held out at 0.6
    or 1.6 times the speed), 20 % `cycles` (two or three, from the air or inside; held out at another speed and
    stroke). Deepest depth 40 to 70 mm, speeds 2.2 to 14 mm/s, accelerations 60 to 400 mm/s2, two to four trials
    for training.
rate
    50, 100, 200 or 500 Hz alike. A sample is the mean force over one interval around its time, of an
    integration at 2 kHz.
tissue
    Heterogeneity 0, 0.03 or 0.1 alike: standard deviation of smooth random functions of depth (Gaussian
    correlation, 3 to 7 mm), one for the friction density and one for the tip force, new in each trial.
base
    Half `documented`, half `other`: one of six other reversal laws with one of four other onsets, another share
    of the tip force in reversals and a loose rim at the entry. Friction 0.028 to 0.042 N/mm, cutting 0.3 to 0.8
    N, onset 3 to 9 mm, presliding 0.08 to 0.5 mm; every parameter scatters by 8 % between trials. The nominal
    model is the documented law fitted to the mean parameters, each number 3 % off (standard deviation), in
    three digits.
noise
    3 to 30 mN RMS (log-uniform), half of the sets white; in the others 30 to 100 % of the variance has a
    correlation of 0.2 to 0.7 between samples. A noise record of 10 to 20 s.
hidden
    One of 25 documented effects, each with a law of the generator's own, or one of 23 outside of the library.
    The further library has half of the weight. What moves needle or tissue (breath, play, stick, tissue motion)
    has up to 2.5 times the weight, because small sizes already exceed the strata. `gain_error` is never drawn:
    friction and cutting absorb it. Numbers beside the size are uniform or log-uniform.
size
    From a noncentrality, counted in the variance of the sensor noise (`counted="tissue"`: in that of noise and
    tissue): equal shares of 5 to 30, 30 to 70, 70 to 100, 100 to 300 and 300 to 10,000, log-uniform within
    each, and bounded by plausible sizes from below and above. An effect that cannot reach its stratum gives way
    to another one (up to 12 draws; then the nearest remains). In a pair each has its own stratum. A pair is
    redrawn (up to 4 times) if one hides behind the other by more than 90 % of its energy.

    python benches/python/third_generator.py --out FOLDER --sets 40 --seed 1
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from third_generator_documented import DOCUMENTED_EFFECTS
from third_generator_files import write_set
from third_generator_law import DOCUMENTED, BaseLaw, Trial, deviations, documented_force, other_law
from third_generator_motion import MOTIONS, Array, paths
from third_generator_outside import OUTSIDE_EFFECTS
from third_generator_size import KEYS, STRATA, SensorNoise, Sizing, Tissue, fitted_base
from third_generator_state import Effect, HiddenEffect, simulate

KINDS = ("none", "single", "pair", "outside")
RATES_HZ = (50, 100, 200, 500)
HETEROGENEITIES = (0.0, 0.03, 0.1)
BASES = ("documented", "other")
COUNTED = ("noise", "tissue")
LIBRARIES = {
    **{each.name: "documented" for each in DOCUMENTED_EFFECTS}, **{each.name: "none" for each in OUTSIDE_EFFECTS},
}  # fmt: skip
Record = tuple[str, str, dict[str, Array]]


@dataclass(frozen=True)
class DataSet:
    """What the diagnosing engineer has (`nominal` base parameters, `records`), and what is true."""

    nominal: dict[str, float]
    records: list[Record]
    truth: dict[str, Any]


def kind_of(seed: int, index: int) -> str:
    """Give the kind of a set in the default mixture."""
    kinds = np.repeat(KINDS, (5, 8, 3, 4))
    return str(np.random.default_rng([seed, index // 20, 900]).permutation(kinds)[index % 20])


def strata_of(seed: int, index: int, count: int) -> list[tuple[float, float]]:
    """Give the strata of the noncentrality; five consecutive indices have all five."""
    block = np.random.default_rng([seed, index // 5, 901])
    return [STRATA[int(block.permutation(5)[index % 5])] for _ in range(count)]


def _picked(rng: Generator, choices: tuple[Any, ...], given: Any, weights: tuple[float, ...] | None = None) -> Any:
    drawn = choices[int(rng.choice(len(choices), p=weights))]
    if given is None:
        return drawn
    if given not in choices:
        raise ValueError(f"{given!r} must be one of {choices}")
    return given


def _hide(rng: Generator, sizing: Sizing, effects: tuple[Effect, ...], base: dict[str, float], deep: float,
          stratum: tuple[float, float], without: tuple[str, ...] = ()) -> tuple[HiddenEffect, int]:  # fmt: skip
    """Draw an effect with a size in the stratum, and say how many effects gave way before."""
    target = float(np.exp(rng.uniform(*np.log(stratum))))
    weights = np.array([0.0 if each.name.startswith(without or ("?",)) else each.weight for each in effects])
    nearest: tuple[float, HiddenEffect] | None = None
    for tried, number in enumerate(rng.choice(len(effects), 12, replace=False, p=weights / weights.sum())):
        effect = effects[int(number)]
        numbers, sign = effect.draw(rng, deep), float(rng.choice(effect.signs))
        highest = min(effect.high, effect.limit(numbers, base, deep) if sign < 0 else np.inf)
        size, value = sizing.sized(effect, numbers, sign, highest, stratum, target)
        found = HiddenEffect(effect, float(f"{size:.5g}"), numbers)
        if stratum[0] <= value <= stratum[1]:
            return found, tried
        far = abs(np.log(max(value, 1e-12) / target))
        if nearest is None or far < nearest[0]:
            nearest = (far, found)
    assert nearest is not None
    return nearest[1], 12


def _pair(rng: Generator, sizing: Sizing, base: dict[str, float], deep: float,
          strata: list[tuple[float, float]]) -> tuple[list[HiddenEffect], int]:  # fmt: skip
    for attempt in range(5):
        first, gave = _hide(rng, sizing, DOCUMENTED_EFFECTS, base, deep, strata[0])
        family = first.effect.name.removesuffix("_by_trial")
        second, more = _hide(rng, sizing, DOCUMENTED_EFFECTS, base, deep, strata[1], (family,))
        both = [first, second]
        if attempt == 4 or all(
            each["noncentrality_beside_other"] > 0.1 * each["noncentrality"] for each in _weighed(sizing, both)
        ):
            break
    return both, gave + more


def _weighed(sizing: Sizing, hidden: list[HiddenEffect]) -> list[dict[str, float]]:
    """Give RMS and noncentrality of each effect, and what of it no multiple of the other effect can imitate."""
    full = sizing.forces(hidden)
    signals = []
    for each in hidden:
        rest = sizing.forces([other for other in hidden if other is not each]) if len(hidden) > 1 else sizing.plain
        signals.append([a - b for a, b in zip(full, rest, strict=True)])
    left = [sizing.remaining(signal) for signal in signals]
    weighed = []
    for number, signal in enumerate(signals):
        mine = left[number]
        value = alone = sizing.product(mine, mine)
        if len(hidden) > 1:
            other = left[1 - number]
            alone -= sizing.product(mine, other) ** 2 / max(sizing.product(other, other), 1e-30)
        rms = float(np.sqrt(np.mean(np.concatenate(signal) ** 2)))
        weighed.append({
            "rms_n": rms, "noise_multiple": rms / sizing.noise.rms,
            "noncentrality": value, "noncentrality_with_tissue": sizing.product(mine, mine, with_tissue=True),
            "noncentrality_beside_other": alone,
        })  # fmt: skip
    return weighed


def _told(each: HiddenEffect, weighed: dict[str, float]) -> dict[str, Any]:
    effect = each.effect
    return {
        "name": effect.name, "library": LIBRARIES[effect.name], "tier": effect.tier,
        "axis": effect.axis, "axes_also_right": list(effect.also), "size": each.size, "unit": effect.unit,
        "numbers": each.numbers, **{key: float(f"{value:.5g}") for key, value in weighed.items()},
    }  # fmt: skip


def _trials(rng: Generator, motion: str, rate_hz: int, heterogeneity: float, deep: float,
            base: dict[str, float]) -> tuple[list[Trial], list[str], Tissue]:  # fmt: skip
    tissue = Tissue(heterogeneity, float(rng.uniform(3, 7)))
    trials, families = [], []
    for number, (family, path) in enumerate(paths(rng, motion, deep, rate_hz, int(rng.integers(2, 5)))):
        own = {key: base[key] * float(np.exp(0.08 * rng.standard_normal())) for key in KEYS}
        both = [deviations(rng, heterogeneity, tissue.length_mm) for _ in range(2)]
        trials.append(Trial(f"trial_{number + 1}", "train", number, rate_hz, path, own, *both))
        families.append(family)
    last = trials.pop()
    held = Trial(
        "held_out", "holdout", last.number, rate_hz, last.path, last.base, last.shaft_deviation, last.tip_deviation
    )
    return [*trials, held], families, tissue


def make(
    seed: int, index: int, *, kind: str | None = None, motion: str | None = None, rate_hz: int | None = None,
    heterogeneity: float | None = None, base: str | None = None, counted: str = "noise",
) -> DataSet:  # fmt: skip
    """Make one data set; equal arguments give equal data. What is None is drawn as the module says.

    `counted` is the variance in which the strata are counted: that of the sensor noise (`noise`), or with that of the
    tissue (`tissue`).
    """
    if counted not in COUNTED:
        raise ValueError(f"{counted!r} must be one of {COUNTED}")
    plan, physics, hiding, noises = (np.random.default_rng([seed, index, stream]) for stream in range(4))
    drawn = kind_of(seed, index)
    kind = _picked(plan, KINDS, kind if kind is not None else drawn)
    motion = _picked(plan, MOTIONS, motion, (0.6, 0.2, 0.2))
    rate_hz = _picked(plan, RATES_HZ, rate_hz)
    heterogeneity = _picked(plan, HETEROGENEITIES, heterogeneity)
    base = _picked(plan, BASES, base)

    law, detail = other_law(physics)
    if base == "documented":
        law, detail = DOCUMENTED, {}
    mean = {
        "friction": 0.035 * float(physics.uniform(0.8, 1.2)), "cutting": float(physics.uniform(0.3, 0.8)),
        "onset_mm": float(physics.uniform(3, 9)), "presliding_mm": float(np.exp(physics.uniform(*np.log((0.08, 0.5))))),
    }  # fmt: skip
    deep = float(physics.uniform(40, 70))
    off = np.exp(0.03 * physics.standard_normal(4))
    coloured = physics.random() < 0.5
    noise = SensorNoise(
        float(np.exp(physics.uniform(*np.log((0.003, 0.03))))), float(physics.uniform(0.2, 0.7)) if coloured else 0.0,
        float(physics.uniform(0.3, 1.0)) if coloured else 0.0,
    )  # fmt: skip
    trials, families, tissue = _trials(physics, motion, rate_hz, heterogeneity, deep, mean)
    training = trials[:-1]

    equal, own, apart = _equivalents(training, law, mean, noise)
    strata = strata_of(seed, index, 2)
    hidden: list[HiddenEffect] = []
    weighed: list[dict[str, float]] = []
    gave_way = 0
    if kind != "none":
        sizing = Sizing(training, law, noise, own, tissue, counts_tissue=counted == "tissue")
        if kind == "pair":
            hidden, gave_way = _pair(hiding, sizing, mean, deep, strata)
        else:
            effects = OUTSIDE_EFFECTS if kind == "outside" else DOCUMENTED_EFFECTS
            one, gave_way = _hide(hiding, sizing, effects, mean, deep, strata[0])
            hidden = [one]
        weighed = _weighed(sizing, hidden)

    records: list[Record] = []
    for trial in trials:
        force = simulate(trial, law, hidden)
        records.append((trial.name, trial.role, {
            "time_s": np.arange(force.size) / rate_hz, "depth_mm": np.round(trial.points(trial.path.depth_mm), 5),
            "velocity_mm_s": np.round(trial.points(trial.path.velocity_mm_s), 5),
            "force_n": force + noise.draw(noises, force.size),
        }))  # fmt: skip
    still = round(noises.uniform(10, 20) * rate_hz)
    records.append(("at_rest", "noise", {"time_s": np.arange(still) / rate_hz, "force_n": noise.draw(noises, still)}))
    truth = {
        "schema": "needleplan.third_generator/1", "seed": seed, "index": index, "kind": kind, "motion": motion,
        "rate_hz": rate_hz, "heterogeneity": heterogeneity, "correlation_mm": tissue.length_mm, "base": base,
        "hidden": [_told(each, numbers) for each, numbers in zip(hidden, weighed, strict=True)],
        "strata": [list(each) for each in strata[: len(hidden)]], "counted": counted, "gave_way": gave_way,
        "families": families, "noise": {"rms_n": noise.rms, "correlation": noise.correlation, "share": noise.share},
        "base_detail": {**detail, **apart, "mean": mean, "equivalent": equal,
                        "trials": [trial.base for trial in trials]},
    }  # fmt: skip
    nominal = {key: float(f"{equal[key] * factor:.3g}") for key, factor in zip(KEYS, off, strict=True)}
    return DataSet(nominal, records, truth)


def _equivalents(trials: list[Trial], law: BaseLaw, mean: dict[str, float], noise: SensorNoise) -> tuple[
    dict[str, float], list[dict[str, float]], dict[str, float]]:  # fmt: skip
    """Give the nearest documented parameters, those of each trial, and how far both laws are apart."""
    if law is DOCUMENTED:
        return dict(mean), [trial.base for trial in trials], {"noncentrality": 0.0, "rms_n": 0.0, "rms_share": 0.0}
    flat = [Trial(t.name, t.role, t.number, t.rate_hz, t.path, mean, *[np.zeros(2)] * 2) for t in trials]
    forces = [simulate(trial, law, ()) for trial in flat]
    equal = fitted_base(flat[:2], forces[:2], mean)
    own = [{key: equal[key] * trial.base[key] / mean[key] for key in KEYS} for trial in trials]
    probe = Sizing(flat, law, noise, [equal] * len(flat))
    gaps = [f - documented_force(t, equal) for t, f in zip(flat, forces, strict=True)]
    rms, whole = (float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for each in (gaps, forces))
    apart = {"noncentrality": probe.noncentrality(gaps), "rms_n": rms, "rms_share": rms / whole}
    return equal, own, {key: float(f"{value:.5g}") for key, value in apart.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for one folder per set")
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="index of the first set")
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--motion", choices=MOTIONS)
    parser.add_argument("--rate", type=int, choices=RATES_HZ, help="Hz")
    parser.add_argument("--heterogeneity", type=float, choices=HETEROGENEITIES)
    parser.add_argument("--base", choices=BASES)
    parser.add_argument("--counted", choices=COUNTED, default="noise", help="variance in which the strata are counted")
    given = parser.parse_args()
    for index in range(given.first, given.first + given.sets):
        made = make(
            given.seed, index, kind=given.kind, motion=given.motion, rate_hz=given.rate,
            heterogeneity=given.heterogeneity,
            base=given.base, counted=given.counted,
        )  # fmt: skip
        write_set(given.out / f"{given.seed}-{index:04d}", made.nominal, made.records, made.truth)


if __name__ == "__main__":
    main()
