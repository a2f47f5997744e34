"""Name random effects on the path of the tip, for needles of any curvature.

PYTHONPATH=.:python python benches/python/diagnosis_paths.py --runs 100 --seed 8

The radius of the needle, one or two effects, their places, and amplitudes from 1 to 25 times the noise of the tracker
are drawn. The formulas are those of the library, so that each wrong or missing name is an error of the search, or an
effect that others imitate. Motions and noise are those of `tests/diagnosis/tip_trials.py`; the curvature differs
between trials by up to 3 %.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis import Library, diagnose
from needleplan.models import Channel, SpatialBicycle, simulate
from needleplan.models.effects import SIZE, Effect, effects_of
from tests.diagnosis.tip_trials import NOISE_MM, motion, recordings

# Range of the radius (mm), and of the RMS of an effect in units of the noise.
RADII_MM, MULTIPLES = (45.0, 300.0), (1.0, 25.0)
# Share of the sets that have one effect; the others have two.
SINGLES = 0.6
# Share of the range of an amplitude that is used.
INSIDE = 0.95


@dataclass(frozen=True)
class Case:
    """A needle with hidden effects."""

    base: SpatialBicycle
    hidden: dict[str, dict[str, float]]
    multiples: dict[str, float]
    """RMS of the output that each effect changes, in units of the noise."""

    seed: int


def cases(seed: int, runs: int) -> Iterator[Case]:
    """Yield random needles with hidden effects."""
    random = np.random.default_rng(seed)
    every = list(effects_of(Channel.TIP))
    for _ in range(runs):
        base = SpatialBicycle(curvature_per_mm=1 / _between(random, RADII_MM))
        library = Library(every, base)
        count = 1 if random.random() < SINGLES else 2
        hidden, multiples = {}, {}
        for index in random.choice(len(every), count, replace=False):
            effect = every[index]
            (entry,) = (each for each in library.entries([motion(0)]) if each.effect.name == effect.name)
            point = dict(entry.grid[int(random.integers(len(entry.grid)))])
            wanted = _between(random, MULTIPLES) * (1 if random.random() < 0.5 else -1)
            hidden[effect.name], multiples[effect.name] = _sized(effect, base, point, wanted)
        yield Case(base, hidden, multiples, int(random.integers(1_000_000)))


def _between(random: np.random.Generator, ends: tuple[float, float]) -> float:
    """Return a number whose logarithm is uniform."""
    return float(np.exp(random.uniform(*np.log(ends))))


def _sized(
    effect: Effect, base: SpatialBicycle, point: dict[str, float], wanted: float
) -> tuple[dict[str, float], float]:
    """Return the values of an effect of about the wanted RMS, inside the range of its amplitude, and its RMS."""
    what = effect.parameters[SIZE]
    plain = simulate(base, motion(0)).output

    def multiple(size: float) -> float:
        there = simulate(effect.apply(base, {**point, SIZE: size}), motion(0)).output
        return float(np.sqrt(np.mean((there - plain) ** 2))) / NOISE_MM

    small = 1e-3 * what.typical
    size = small * wanted / multiple(small)
    size = float(np.clip(abs(size) if what.lower >= 0 else size, INSIDE * what.lower, INSIDE * what.upper))
    return {**point, SIZE: size}, multiple(size)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true", help="print a line for each set that is not named rightly")
    given = parser.parse_args()
    outcomes: dict[int, list[tuple[bool, bool, float]]] = {1: [], 2: []}
    for case in cases(given.seed, given.runs):
        begin = time.process_time()
        library = Library(effects_of(Channel.TIP), case.base)
        found = diagnose(case.base, recordings(case.hidden, case.seed, case.base), library=library)
        right, wrong = set(found.names) == set(case.hidden), bool(set(found.names) - set(case.hidden))
        outcomes[len(case.hidden)].append((right, wrong, time.process_time() - begin))
        if given.verbose and not right:
            sizes = ", ".join(f"{name} {multiple:.1f}" for name, multiple in case.multiples.items())
            radius = 1 / case.base.curvature_per_mm
            print(f"radius {radius:.0f} mm, {sizes}: {found.verdict} {', '.join(found.names)}", flush=True)
    print("| effects | sets | named rightly | a wrong name | median processor time, s |")
    print("|--:|--:|--:|--:|--:|")
    for count, rows in outcomes.items():
        right, wrong, times = (np.array(column) for column in zip(*rows, strict=True))
        print(f"| {count} | {len(rows)} | {right.sum()} | {wrong.sum()} | {np.median(times):.1f} |")


if __name__ == "__main__":
    main()
