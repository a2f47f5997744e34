"""The scale of the errors of single reversals and trials, which is summed over."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from needleplan.diagnosis._components import Components
from needleplan.diagnosis._fit import fit_hypothesis
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._posterior import FAR, Posterior, combined
from needleplan.diagnosis._reversal import blended_by
from needleplan.diagnosis._search import search
from needleplan.diagnosis.catalogue import Library

__all__ = ["ERROR_SCALES", "search_errors"]

# Sets of effects that are known from another scale, and fitted at the next one.
_KNOWN = 2

ERROR_SCALES = (0.1, 1.0, 3.0)
"""Scales of the errors of single reversals and trials, equally probable."""


def search_errors(fitted: Hypothesis, library: Library, tell: Callable[[str], None] = lambda _: None) -> Posterior:
    """Return the posterior with the scale of the errors of single reversals and trials summed over.

    `fitted` is the fitted empty set. A base without such errors, as that of the tip's path, has one scale. A scale is
    left out if a smaller one was searched, and the gain of effects there, which a larger scale lowers, leaves it far
    below the best.
    """
    empty = {fitted.problem.error_scale: fitted}
    for scale in ERROR_SCALES if blended_by(fitted.trials[0].model).size else ():
        if scale not in empty:
            own = replace(fitted.problem, error_scale=scale)
            empty[scale] = fit_hypothesis(own, fitted.effects, fitted.trials, like=fitted, most_steps=0, sought=False)
    found: dict[float, Posterior] = {}
    components = Components(fitted.problem)
    for scale, each in sorted(empty.items(), key=lambda each: -each[1].hope):
        floor = max((one.log_total for one in found.values()), default=-math.inf)
        gains = [one.log_total - empty[smaller].log_evidence for smaller, one in found.items() if smaller <= scale]
        if not gains or each.hope + max(gains) > floor - FAR:
            tell(f"searching missing effects, scale of errors {len(found) + 1} of at most {len(empty)}")
            if each is not fitted:
                each = fit_hypothesis(each.problem, each.effects, each.trials, like=each, sought=False)
                empty[scale] = each
            known = _best_sets(max(found.values(), key=lambda one: one.log_total)) if found else []
            found[scale] = search(each.problem, library, components.of(each.problem), each, known, floor)
    return combined(list(found.values()))


def _best_sets(posterior: Posterior) -> list[Hypothesis]:
    """Return the most probable fitted sets of effects."""
    names = dict.fromkeys(tuple(sorted(names)) for _, names, _ in posterior.ranked if names)
    fitted = [posterior.hypotheses[each] for each in names if each in posterior.hypotheses]
    return fitted[:_KNOWN]
