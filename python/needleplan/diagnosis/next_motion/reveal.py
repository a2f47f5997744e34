"""The motion after which the smallest effects can be seen, where none was and one that matters could hide.

The size from which an effect is named falls with the root of what all trials say of it: 1 / size^2 is a sum over them,
of squares of its column with all that the base can take up projected out, and what the tissue varies by weighed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.diagnosis import Diagnosis
from needleplan.diagnosis.minimal import NAMED_FROM, Smallest
from needleplan.diagnosis.next_motion.proposal import NextMotion, Tried, predicted_case
from needleplan.diagnosis.space import Space
from needleplan.models.effects import SIZE, Effect
from needleplan.signals import Array, Role

__all__ = ["Revealed", "Revealing", "revealing"]

_LEAST = 0.01
"""Share of its size below which it does not matter by how much an effect is seen better."""


@dataclass(frozen=True)
class Revealed:
    """The size from which one effect is named: with the recordings so far, and with one more trial."""

    effect: str
    unit: str
    now: float | None
    """None where it would have to be larger than it can be, or the base takes it up."""

    after: float
    repeated: float | None
    """With the last training motion once more."""


@dataclass(frozen=True)
class Revealing(NextMotion):
    """The motion that lowers the smallest sizes most: the mean of their logarithms, of effects that could hide."""

    effects: tuple[Revealed, ...]
    """Those that could hide, the most improved first."""

    shrinks_to: float
    """Geometric mean of the sizes over those now."""

    repeated_shrinks_to: float
    considered: tuple[tuple[str, float], ...]
    """All programs: name, and to what sizes shrink."""

    @property
    def why(self) -> str:
        """By how much, and where most."""
        best = self.effects[0]
        now = "no size now" if best.now is None else f"{best.now:.3g} {best.unit} now"
        return (
            f"Effects that could hide would be named from {self.shrinks_to:.0%} of the present size on, in the mean; "
            f"with the last motion again, from {self.repeated_shrinks_to:.0%}. Most of all {best.effect}: from {now} "
            f"to {best.after:.3g} {best.unit}."
        )


def revealing(found: Diagnosis, tried: Sequence[Tried], role: Role) -> Revealing | None:
    """Return the best of the motions for what could hide; None where no effect could be seen in any of them."""
    hidden = [each for each in found.smallest if not each.visible or each.noise_multiple > found.gates.relevant]
    hidden = hidden or list(found.smallest)
    effects = {each.effect.name: each.effect for each in found.selection.steps[0].screened}
    hidden = [each for each in hidden if each.effect in effects]
    largest = np.array([_largest(effects[each.effect]) for each in hidden])
    # What would have to be larger than it can be is not seen, however it compares.
    sizes = np.array([each.size if each.visible else np.inf for each in hidden])
    now = NAMED_FROM / np.minimum(sizes, largest) ** 2
    level = np.array([found.selection.base.level])
    cases = [predicted_case(found.calibration.model, found.calibration, motion) for _, motion in tried]
    last = found.calibration.training[-1]
    more = [np.array([_seen(effects[each.effect], each, case, level) for each in hidden]) for case in cases]
    again = np.array([_seen(effects[each.effect], each, last, level) for each in hidden])
    shares = [_shares(now, each) for each in more]
    if not hidden or not any((each < 1).any() for each in shares):
        return None
    means = [float(np.exp(np.log(each).mean())) for each in shares]
    best = int(np.argmin(means))
    order = [index for index in np.argsort(shares[best], kind="stable") if now[index] + more[best][index] > 0]
    revealed = tuple(
        Revealed(
            hidden[index].effect, hidden[index].unit,
            hidden[index].size if sizes[index] <= largest[index] else None,
            _size(now[index] + more[best][index]),
            _size(now[index] + again[index]) if now[index] + again[index] > 0 else None,
        )
        for index in order
    )  # fmt: skip
    program, motion = tried[best]
    return Revealing(
        program, motion, role, revealed, means[best], float(np.exp(np.log(_shares(now, again)).mean())),
        tuple((each.name, value) for (each, _), value in zip(tried, means, strict=True)),
    )  # fmt: skip


def _seen(effect: Effect, smallest: Smallest, case: Case, level: Array) -> float:
    """Return one over the variance of an effect's size, at the place where it would just be seen, in one trial."""
    raw = effect.columns(case.model, case.motion, [dict(smallest.at)])
    column = case.lag_column[:, None] if effect.is_lag else case.whiten(raw)
    curvature = float(Space([case.block], level).scores([column]).curvature[0, 0])
    # What is left of a column that the base takes up is a rounding error.
    return curvature if curvature > 1e-6 * float((column**2).sum()) else 0.0


def _largest(effect: Effect) -> float:
    what = effect.parameters[SIZE]
    return max(abs(what.lower), abs(what.upper))


def _shares(now: Array, more: Array) -> Array:
    """Return sizes after over sizes now; one where nothing is seen either way."""
    total = now + more
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(total > 0, np.sqrt(now / total), 1.0)
    return np.asarray(np.maximum(found, _LEAST))


def _size(curvature: float) -> float:
    return float(np.sqrt(NAMED_FROM / curvature))
