"""A gap without a name, described: its course along an axis, a formula that is no physics, a file to give it a name.

None of it is a cause. Curves hold where the motions went, the formula is one of several that do as well, and the file
is for a person to name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.curves import Curve, Curves, curves_along
from needleplan.diagnosis.effect_draft import draft_text
from needleplan.diagnosis.formula import Formula, FormulaTerm, find_formula, grammar
from needleplan.diagnosis.localise import Localisation
from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.rivals import RivalScore
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.verdict import Gates

__all__ = ["Described", "describe"]


@dataclass(frozen=True)
class Described:
    """The gap along its axis, in each way of moving, and a sparse formula, where one passes the gates of an effect."""

    axis: Axis
    curves: Curves
    sparse: Formula | None
    rms: float
    """Of the formula, or else of the curves, in the training data, in N."""

    @property
    def unit(self) -> str:
        """Of the places."""
        return self.curves.unit

    @property
    def main(self) -> Curve:
        """The curve that is farthest from zero, in its own standard deviations."""
        return max(self.curves.curves, key=lambda each: float((np.abs(each.mean / each.sd) * each.inside).max()))

    @property
    def places(self) -> tuple[float, ...]:
        """Where the main curve is known."""
        return tuple(map(float, self.main.places[self.main.inside]))

    @property
    def values(self) -> tuple[float, ...]:
        """The main curve there (N)."""
        return tuple(map(float, self.main.mean[self.main.inside]))

    @property
    def sds(self) -> tuple[float, ...]:
        """Its standard deviations there (N)."""
        return tuple(map(float, self.main.sd[self.main.inside]))

    @property
    def formula(self) -> tuple[FormulaTerm, ...]:
        """The products of the formula; none where no product passes."""
        return self.sparse.terms if self.sparse else ()

    def effect_file(self, name: str = "my_effect") -> str:
        """Return the source of an effect that works and that a person can edit: its words are still to be written."""
        return draft_text(name, self.axis, self.curves, self.sparse, self.rms)


def describe(
    space: Space,
    cases: Sequence[Case],
    held_out: Sequence[Case],
    rival: RivalScore,
    place: Localisation,
    gates: Gates,
) -> Described:
    """Describe the gap that the base of `space` leaves along the axis of the competitor that leads.

    `held_out` are trials on which the formula is judged, with the same base; none where that was not calibrated there.
    """
    products = grammar(
        max(5.0, *(float(case.motion.depth_mm.max()) for case in cases)),
        max(float(np.abs(case.motion.velocity_mm_s).max()) for case in cases),
        fine_waves=rival.axis is Axis.PERIOD,
        steps_mm=[each.place for each in place.changes if each.axis is Axis.DEPTH],
        steps_s=[each.place for each in place.changes if each.axis is Axis.TIME],
    )
    formula = find_formula(space, cases, held_out, gates, rival.gain, products)
    curves = curves_along(rival.axis, space, cases)
    if formula is not None:
        rows = np.concatenate([formula.values(case.motion, case.output) for case in cases])
    else:
        rows = np.concatenate([each.mean[each.inside] for each in curves.curves])
    return Described(rival.axis, curves, formula, float(np.sqrt(np.mean(rows**2))) or 1.0)
