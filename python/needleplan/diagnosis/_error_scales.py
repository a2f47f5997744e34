"""The scale of the errors of single reversals and trials, which is chosen by its evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from needleplan.diagnosis._components import Components
from needleplan.diagnosis._fit import EMPTY_STEPS, fit_hypothesis
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._posterior import Posterior
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis._result import most_probable
from needleplan.diagnosis._reversal import blended_by
from needleplan.diagnosis._search import search
from needleplan.diagnosis.catalogue import Library

__all__ = ["ERROR_SCALES", "search_errors"]

ERROR_SCALES = (0.1, 1.0, 3.0)
"""Scales of the errors of single reversals and trials."""
# Log evidence (nats) by which another scale must be better.
_BETTER = 1.0


def search_errors(fitted: Hypothesis, library: Library, tell: Callable[[str], None] = lambda _: None) -> Posterior:
    """Return the posterior at the scale of the errors of single reversals and trials that has the largest evidence.

    `fitted` is the fitted empty set. A base without such errors, as that of the tip's path, has one scale. The scale is
    chosen for the empty set, and again for the best set of effects, which may leave less for the errors.
    """
    own = fitted.problem
    scales = [each for each in ERROR_SCALES if each != own.error_scale and blended_by(fitted.trials[0].model).size]
    problems = [own, *(replace(own, error_scale=each) for each in scales)]
    components, empty, known = Components(own), _at_best_scale(fitted, problems), None
    found: dict[float, Posterior] = {}
    while (scale := empty.problem.error_scale) not in found:
        tell(f"searching missing effects, errors of single reversals times {scale:g}")
        if empty is not fitted:
            empty = fit_hypothesis(
                empty.problem, empty.effects, empty.trials, most_steps=EMPTY_STEPS, like=empty, sought=False
            )
        found[scale] = search(empty.problem, library, components.of(empty.problem), empty, known)
        best = most_probable(found[scale])
        known = _at_best_scale(best, problems) if best.names else best
        empty = _with(known.problem, fitted)
    return max(found.values(), key=lambda each: each.log_total)


def _at_best_scale(here: Hypothesis, problems: Sequence[Problem]) -> Hypothesis:
    """Return a hypothesis at the scale of the errors with the largest evidence, or at its own if that is as good."""
    best = max((_with(each, here) for each in problems), key=lambda each: each.log_evidence)
    return best if best.log_evidence > here.log_evidence + _BETTER else here


def _with(problem: Problem, here: Hypothesis) -> Hypothesis:
    """Return a hypothesis at the same values with the scale of the errors of a problem."""
    if problem.error_scale == here.problem.error_scale:
        return here
    return fit_hypothesis(problem, here.effects, here.trials, like=here, most_steps=0, sought=False)
