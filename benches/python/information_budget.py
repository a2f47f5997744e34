"""Say where the information on hidden effects goes: to the base, to errors of trials, to other laws, or to the tissue.

PYTHONPATH=.:python OPENBLAS_NUM_THREADS=1 python benches/python/information_budget.py --seed 201 --runs 60

The noncentrality of a generator counts what the noise and a fit of the base leave of an effect. The engine knows
neither the laws of the base exactly, nor the tissue. Each column adds one uncertainty to those before, and shows the
squared amplitude in standard deviations that is left. Scales of the tolerances and heterogeneity are those that the
engine chose beside the hidden effect. Without an answer of the engine, the information says what its model can see.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import fields, replace

import diagnosis_engines_case as cases
import numpy as np

from needleplan.diagnosis import Diagnosis, diagnose
from needleplan.diagnosis._base_law import Law
from needleplan.diagnosis._evidence import LinearModel
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._problem import Problem, TrialErrors
from needleplan.models.effects import SIZE

# Columns of the table: noise, then one more uncertainty after the other.
STAGES = ("noise", "base", "single trials", "other laws", "own law", "tissue")
# Precision of a coefficient that is known.
_KNOWN = 1e14
# Information below which an effect has little chance: four times the log odds of 90 % against a prior of 1 %.
_LITTLE = 27.0


class _Exact(Problem):
    """A problem whose single reversals and trials have no errors of their own."""

    @property
    def errors(self) -> tuple[tuple[TrialErrors, ...], ...]:
        """No errors of any trial."""
        return tuple(() for _ in self.trials)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--generator", choices=cases.GENERATORS, default="second")
    parser.add_argument("--seed", type=int, default=201)
    parser.add_argument("--runs", type=int, default=60, help="number of data sets that are drawn")
    parser.add_argument("--least", type=float, default=70.0, help="least noncentrality")
    given = parser.parse_args()
    print("| set | rate, Hz | tissue | effect | noncentrality | " + " | ".join(STAGES) + " | answer |")
    print("|---|--:|--:|---|--:|" + "--:|" * len(STAGES) + "---|")
    left = []
    for case in cases.draw(given.generator, given.runs, given.seed, ["single"], "rich", given.least):
        base, recordings, hidden, _ = case.make()
        found = diagnose(base, recordings)
        name = str(hidden[0]["name"])
        budget = budget_of(found, name)
        head = f"| {case.key.split(' single')[0]} | {case.facts['rate_hz']} | {case.facts['heterogeneity']:.0%}"
        numbers = " | ".join(f"{each:.0f}" for each in budget) if budget else " | ".join("" for _ in STAGES)
        said = f"{found.verdict}: {', '.join(found.names)}" if found.names else str(found.verdict)
        print(f"{head} | {name} | {hidden[0]['noncentrality']:.0f} | {numbers} | {said} |", flush=True)
        if budget:
            left.append((budget, found.names == (name,)))
    if not left:
        print("\nNo effect was found.")
        return
    print("\n| information that is left | sets | named |\n|---|--:|--:|")
    for low, high in ((0, _LITTLE), (_LITTLE, 100), (100, np.inf)):
        some = [named for budget, named in left if low <= budget[-1] < high]
        print(f"| {low:.0f} to {high:.0f} | {len(some)} | {sum(some)} |")
    print("\n| uncertainty | sets in which it takes the largest share |\n|---|--:|")
    losses = np.diff(np.log(np.maximum([budget for budget, _ in left], 1e-3)), axis=1)
    for stage, count in zip(STAGES[1:], np.bincount(losses.argmin(axis=1), minlength=len(STAGES) - 1), strict=True):
        print(f"| {stage} | {count} |")


def budget_of(found: Diagnosis, name: str) -> list[float]:
    """Return the squared amplitude of an effect, in standard deviations, after each stage; empty if it was not fitted.

    The stages are those of `STAGES`.
    """
    fitted = found.posterior.hypotheses.get((name,))
    if fitted is None:
        return []
    laws = [group for law, group in fitted.groups.items() if law is not Law.EFFECTS]
    own = [fitted.groups[Law.EFFECTS]]
    row = next(index for index, each in enumerate(fitted.coordinates) if each.name == SIZE)
    places = [np.setdiff1d(np.arange(len(fitted.coordinates)), [row])]
    exact = _Exact(**{each.name: getattr(fitted.problem, each.name) for each in fields(Problem)})
    without = Hypothesis.at(exact, fitted.effects, fitted.trials, None, fitted.formula_error, fitted.scales)
    homogeneous = 0
    return [
        _information(without, row, [], homogeneous, base=False),
        _information(without, row, [], homogeneous),
        _information(fitted, row, [], homogeneous),
        _information(fitted, row, laws, homogeneous),
        _information(fitted, row, [*laws, *own, *places], homogeneous, formulas=True),
        _information(fitted, row, [*laws, *own, *places], fitted.best, formulas=True),
    ]  # fmt: skip


def _information(
    fitted: Hypothesis, row: int, free: Sequence[np.ndarray], level: int, *, base: bool = True, formulas: bool = False
) -> float:
    """Return the squared amplitude, in standard deviations, if the columns `free` are uncertain, and no others."""
    linear, count = fitted.linear, fitted.trials[0].whitened.base.shape[1]
    precision = linear.precision.copy()
    shared = np.arange(fitted.first_blend - count, fitted.first_blend)
    uncertain = np.concatenate([np.array([row]), *free, *([shared] if base else [])]).astype(int)
    precision[np.setdiff1d(np.arange(len(precision)), uncertain)] = _KNOWN
    blocks, basis = list(linear.blocks), list(linear.basis)
    if not formulas:
        blocks = [replace(block, errors=None) for block in blocks]
    if not base:
        blocks = [replace(block, base=_known(block.base)) for block in blocks]
        basis = [np.vstack([each[:-count], np.zeros((count, each.shape[1]))]) for each in basis]
    matrix = LinearModel(blocks, basis, precision, linear.share).posterior_precision[level]
    others = np.setdiff1d(np.arange(len(matrix)), [row])
    inner = matrix[np.ix_(others, others)]
    scale = 1 / np.sqrt(np.diag(inner))
    half = scale * matrix[others, row]
    lost = half @ np.linalg.solve(scale[:, None] * inner * scale + 1e-12 * np.eye(len(inner)), half)
    effect = fitted.effects[0]
    amplitude = effect.effect.parameters[SIZE].coordinate(effect.values[SIZE])
    return float((matrix[row, row] - precision[row] - lost) * amplitude**2)


def _known(base: np.ndarray) -> np.ndarray:
    """Return the sensitivities of a base whose parameters are known: their priors are very narrow."""
    found, count = base.copy(), base.shape[1]
    found[-count:] = np.eye(count) * math.sqrt(_KNOWN)
    return found


if __name__ == "__main__":
    main()
