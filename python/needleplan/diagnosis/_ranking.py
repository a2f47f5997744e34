"""The ranked table of hypotheses: the probability of each, and one sentence on why it lost.

The log of the posterior odds of the winner has three parts: how much better the winner fits the readings (and in which
trial most), how much more of its freedom the loser did not need (the rest of the evidence), and the prior.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from needleplan.artifacts import CallRepr
from needleplan.diagnosis._evidence import squared_residuals
from needleplan.diagnosis._posterior import log_prior
from needleplan.diagnosis._result import Diagnosis

__all__ = ["RankedHypothesis", "hypothesis_words", "ranked_hypotheses"]

# Difference (nats) that a sentence mentions: odds of about 3.
_WORTH_MENTIONING = 1.0
# Share of the misfit from which a single trial is named.
_MOSTLY = 0.5


@dataclass(frozen=True)
class RankedHypothesis(CallRepr):
    """One row of the ranked table."""

    probability: float
    effects: tuple[str, ...]
    component: str
    """Name of the nonparametric component beside the effects, or ""."""

    because: str
    """Why the hypothesis lost, in one sentence; for the first row, why it won."""

    @property
    def words(self) -> str:
        """The hypothesis in words."""
        return hypothesis_words(self.effects, self.component)


def hypothesis_words(effects: tuple[str, ...], component: str) -> str:
    """Return a hypothesis in words, a repeated effect once.

    Parameters
    ----------
    effects
        Names of the effects.
    component
        Name of the function of one variable beside the effects, or "".

    Returns
    -------
    str
        The hypothesis.

    Examples
    --------
    >>> from needleplan.diagnosis import hypothesis_words
    >>> hypothesis_words(("bump", "bump", "viscous"), "time")
    '2 x bump and viscous and a function (time)'
    """
    parts = [
        f"{effects.count(name)} x {name}" if effects.count(name) > 1 else name for name in dict.fromkeys(effects)
    ]  # fmt: skip
    parts += [f"a function ({component})"] if component else []
    return " and ".join(parts) or "nothing"


def ranked_hypotheses(found: Diagnosis, most: int = 10) -> tuple[RankedHypothesis, ...]:
    """Return the most probable hypotheses, each with the reason why it lost, or won.

    Parameters
    ----------
    found
        A diagnosis.
    most
        Largest number of hypotheses. "Nothing" is added if it is not among them.

    Returns
    -------
    tuple of RankedHypothesis
        The hypotheses, the most probable first.
    """
    posterior = found.posterior
    ranked = posterior.ranked
    shown = ranked[:most]
    shown += [hypothesis for hypothesis in ranked[most:] if hypothesis[1:] == ((), "")]
    (top, effects, component), *others = shown
    won = "it is the only hypothesis"
    if others:
        second = others[0][1:]
        lead = posterior.logs[effects, component] - posterior.logs[second]
        won = f"it leads {hypothesis_words(*second)} by {lead:.1f} nats (odds {_odds(lead)})"
    rows = [RankedHypothesis(top, effects, component, won)]
    rows += [
        RankedHypothesis(probability, names, function, _lost(found, (effects, component), (names, function)))
        for probability, names, function in others
    ]  # fmt: skip
    return tuple(rows)


def _odds(nats: float) -> str:
    return f"{math.exp(nats):.3g} to 1" if nats < 20 else "above 1e8 to 1"


def _lost(diagnosis: Diagnosis, winner: tuple[tuple[str, ...], str], loser: tuple[tuple[str, ...], str]) -> str:
    """Return one sentence on why a hypothesis lost against the winner."""
    posterior = diagnosis.posterior
    behind = posterior.logs[winner] - posterior.logs[loser]
    start = f"{behind:.1f} nats behind"
    (names, component), (best, other) = loser, winner
    if names == best and component and not other:
        return f"{start}: the function adds less to the fit than its freedom costs"
    if names == best and other and not component:
        return f"{start}: a function ({other}) is missing in the fit"
    if component:
        return f"{start}: the function beside {hypothesis_words(names, '')} does not explain what the effects explain"
    if names not in posterior.hypotheses or best not in posterior.hypotheses:
        return f"{start} by an estimate from its linear columns; therefore it was not fitted"
    parts = list(_parts(diagnosis, best, names, behind))
    return f"{start}: {'; '.join(parts)}" if parts else f"{start}: fit, freedom and prior are almost equal"


def _parts(diagnosis: Diagnosis, winner: tuple[str, ...], loser: tuple[str, ...], behind: float) -> Iterator[str]:
    """Yield the reasons why a set of effects lost: parts of its deficit that are large enough to mention.

    The deficit `behind` (nats) of the log posterior is the sum of three parts: `fit` of the readings, `prior`, and
    `freedom`, the rest: parameters that the data did not need.
    """
    posterior, settings = diagnosis.posterior, diagnosis.settings
    lost, won = posterior.hypotheses[loser], posterior.hypotheses[winner]
    lost_residuals, won_residuals = (
        squared_residuals(fitted.linear.parts[:, fitted.best], fitted.linear.mean[fitted.best])
        for fitted in (lost, won)
    )
    misfits = (lost_residuals - won_residuals) / 2
    fit = float(misfits.sum())
    library_size = len(posterior.entries)
    prior = log_prior(settings, library_size, len(winner)) - log_prior(settings, library_size, len(loser))
    if abs(fit) > _WORTH_MENTIONING:
        worst = int((misfits * math.copysign(1, fit)).argmax())
        mostly = abs(misfits[worst]) >= _MOSTLY * abs(fit) and len(misfits) > 1
        where = f", most of it in {lost.trials[worst].record.trial or f'trial {worst + 1}'}" if mostly else ""
        yield f"its fit is {'worse' if fit > 0 else 'better'} by {abs(fit):.1f} nats{where}"
    freedom = behind - fit - prior
    if abs(freedom) > _WORTH_MENTIONING:
        yield (
            f"it has freedom that the data did not need ({freedom:.1f} nats)" if freedom > 0 else
            f"it needs less freedom ({-freedom:.1f} nats)"
        )  # fmt: skip
    if abs(prior) > _WORTH_MENTIONING:
        yield f"it is {'less' if prior > 0 else 'more'} probable beforehand ({abs(prior):.1f} nats)"
