"""Competitors without a name that are fitted like effects: a power of the pushing force, a step in time.

Competitors are judged beside the base as it was calibrated alone. Where tissue varies, a base that imitates a gap by
cutting twice as hard lets the tissue take up the rest, and only effects are fitted with a base of their own. What an
effect looks like to another one is to be asked on equal terms: so a power of the force, which is what a bent scale of a
sensor or a shaft that buckles shows, is fitted too wherever the effect that leads looks like one.

A step at one time of all trials is the crude version of a reading that moves on, and in a motion or two the one does
nearly as well as the other. So it is asked as effects are: fitted, and held where it is, in another motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from needleplan.diagnosis.calibrate import Calibration
from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.refit import Added, Joint, added_output, refit
from needleplan.diagnosis.rivals import BEGIN_S, RivalScore
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.verify import Verified, verify
from needleplan.models import Channel, constant, parameter, simulate
from needleplan.models.effects import SIZE, Enters, Family, Memoryless, TermEffect
from needleplan.signals import Array, Motion

__all__ = ["fitted_rivals"]

_ALIKE = 0.5
"""Squared correlation of what two terms add from which on they may be taken for each other."""

_NEAR_S = 0.2
"""How near to its very sample a step is looked for first."""

_EVERYWHERE_ALIKE = np.zeros(1)
"""Levels of heterogeneity: none."""


@dataclass(frozen=True, kw_only=True)
class _PushSquared(Memoryless):
    name: ClassVar[str] = "pushing_force_squared"
    size: float = parameter("1/N", -10, 10, "what is added for the square of the pushing force", typical=0.01)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        return np.asarray(np.maximum(plain, 0.0) ** 2)


_SQUARED = TermEffect(
    "pushing_force_squared", "square of the pushing force", Family.SENSOR, Enters.SENSOR, "F += size max(F, 0)^2",
    "What is pushed reads too large, or too small, the more the larger the force is.", "", term=_PushSquared,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _Step(Memoryless):
    name: ClassVar[str] = "step_in_time"
    size: float = parameter("N", -20, 20, "what is added from some time on", typical=0.01)
    time_s: float = constant("s", 0, 1e6, "from when on, in each trial")

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        return np.asarray(motion.time_s >= self.time_s, float)


_STEPPED = TermEffect(
    "step_in_time", "step in time", Family.SENSOR, Enters.SENSOR, "F += size from time on",
    "Something slipped, in every trial at the same time.", "", term=_Step,
)  # fmt: skip


def fitted_rivals(
    best: Joint, seen: Verified | None, rivals: Sequence[RivalScore], calibration: Calibration, base: Space
) -> tuple[RivalScore, ...]:
    """Return the competitors, on equal terms with the one effect of `best` where it looks like one of them.

    `seen` is what that effect does in another motion. The best first, as all data say.
    """
    if calibration.given.channel is not Channel.FORCE:
        return tuple(rivals)
    found = [_fitted_step(each, best, seen, calibration, base) for each in rivals]
    squared = _fitted_square(best, seen, calibration, base)
    return tuple(sorted([*found, *([squared] if squared else [])], key=lambda each: -each.support))


def _fitted_step(
    rival: RivalScore, best: Joint, seen: Verified | None, calibration: Calibration, base: Space
) -> RivalScore:
    """Return a step in time as it does where the effect is, in another motion too; any other competitor as it is."""
    if rival.time_s is None or rival.gain < _ALIKE * best.gain:
        return rival
    joint = refit([_step_at(rival.time_s)], calibration, base, best.cases)
    first = best.cases[0].motion.time_s
    begins = max(float(each.motion.time_s[0]) for each in best.cases) + BEGIN_S
    coarse = np.arange(begins, first[-1] - _NEAR_S, _NEAR_S / 2)
    for levels, times_s in ((_EVERYWHERE_ALIKE, coarse), (joint.space.levels, None)):
        here = joint.added[0].values["time_s"]
        near = first[(np.abs(first - here) < _NEAR_S) & (first > begins)] if times_s is None else times_s
        moved = refit([_step_at(_better_time_s(joint, near, levels))], calibration, base, joint.cases)
        joint = max(joint, moved, key=lambda each: each.gain)
    gain = max(joint.gain, rival.gain)
    elsewhere = _elsewhere(joint, seen, calibration)
    return replace(rival, gain=gain, balance=gain - rival.freedom * base.price, elsewhere=elsewhere)


def _elsewhere(joint: Joint, seen: Verified | None, calibration: Calibration) -> float:
    """Return what a competitor brings in another motion beyond the effect; 0 where there is none."""
    there = verify(joint, calibration) if seen else None
    return there.gain - seen.gain if there and seen else 0.0


def _step_at(time_s: float) -> Added:
    return Added(_STEPPED, {SIZE: _STEPPED.parameters[SIZE].typical, "time_s": time_s})


def _better_time_s(joint: Joint, times_s: Array, levels: Array) -> float:
    """Return at which of some times a fitted step fits best, beside the base as it is with the step.

    The base alone imitates a large step, and tissue that varies at will takes up one at a wrong time: a few samples off
    it is worth much less.
    """
    step = joint.added[0]
    columns = [case.whiten(np.asarray(case.motion.time_s[:, None] >= times_s, float)) for case in joint.cases]
    blocks = [
        replace(case.block, residual=case.block.residual + case.whiten(added_output([step], case.model, case.motion)))
        for case in joint.cases
    ]
    gains, _ = Space(blocks, levels).scores(columns).gains()
    return float(times_s[gains.argmax()])


def _fitted_square(best: Joint, seen: Verified | None, calibration: Calibration, base: Space) -> RivalScore | None:
    """Return how the square of the pushing force does where the one effect of `best` is; None where they differ."""
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
    elsewhere = _elsewhere(joint, seen, calibration)
    return RivalScore("pushing force squared", Axis.FORCE, joint.gain, 1, joint.gain - base.price, elsewhere=elsewhere)
