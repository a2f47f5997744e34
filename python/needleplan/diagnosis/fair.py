"""A competitor without a name that is fitted like an effect: what is a power of the pushing force.

Competitors are judged beside the base as it was calibrated alone. Where tissue varies, a base that imitates a gap by
cutting twice as hard lets the tissue take up the rest, and only effects are fitted with a base of their own. What an
effect looks like to another one is to be asked on equal terms: so a power of the force, which is what a bent scale of a
sensor or a shaft that buckles shows, is fitted too wherever the effect that leads looks like one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.diagnosis.calibrate import Calibration
from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.refit import Added, Joint, added_output, refit
from needleplan.diagnosis.rivals import RivalScore
from needleplan.diagnosis.space import Space
from needleplan.models import Channel, simulate
from needleplan.models.effects import SIZE, Enters, Family, Term, TermEffect
from needleplan.models.parameter import parameter
from needleplan.signals import Array, Motion

__all__ = ["fitted_rival"]

_ALIKE = 0.5
"""Squared correlation of what two terms add from which on they may be taken for each other."""


@dataclass(frozen=True, kw_only=True)
class _PushSquared(Term):
    name: ClassVar[str] = "pushing_force_squared"
    order: ClassVar[int] = 0
    size: float = parameter("1/N", -10, 10, "what is added for the square of the pushing force", typical=0.01)

    def initial(self, motion: Motion) -> Array:  # noqa: ARG002
        return np.zeros(0)

    def rate(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        return state

    def states(self, motion: Motion, start: Array) -> Array:  # noqa: ARG002
        return np.zeros((0, len(motion)))

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        return np.asarray(np.maximum(plain, 0.0) ** 2)


_SQUARED = TermEffect(
    "pushing_force_squared", "square of the pushing force", Family.SENSOR, Enters.SENSOR, "F += size max(F, 0)^2",
    "What is pushed reads too large, or too small, the more the larger the force is.", "", term=_PushSquared,
)  # fmt: skip


def fitted_rival(best: Joint, calibration: Calibration, base: Space) -> RivalScore | None:
    """Return how the square of the pushing force does where the one effect of `best` is; None where they differ."""
    if calibration.given.channel is not Channel.FORCE:
        return None
    named = np.concatenate([added_output(best.added, case.model, case.motion) for case in best.cases])
    plain = np.concatenate([simulate(case.model, case.motion).output for case in best.cases])
    square = np.maximum(plain, 0.0) ** 2
    square_left = square - plain * float(square @ plain) / max(float(plain @ plain), 1e-300)
    named_left = named - plain * float(named @ plain) / max(float(plain @ plain), 1e-300)
    both = float(square_left @ named_left)
    energies = float(square_left @ square_left), float(named_left @ named_left)
    if both**2 < _ALIKE * energies[0] * energies[1] or not energies[0]:
        return None
    start = Added(_SQUARED, {SIZE: both / energies[0]})
    joint = refit([start], calibration, base, best.cases)
    return RivalScore("pushing force squared", Axis.FORCE, joint.gain, 1, joint.gain - base.price)
