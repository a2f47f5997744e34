"""Law tolerance of the base: friction may reverse by another law than Dahl's.

After a reversal the force changes by s(x) times its swing, x the travel in presliding lengths. Dahl's law is
s = 1 - exp(-x). The deviation from it is a Gaussian process of log x, with a long tail, with leading modes psi_m,

    s(x) = 1 - exp(-x) + sum_m c_m psi_m(x),        c_m ~ N(0, tolerance^2)

This is equation (3) of docs/explanation/posterior.md. Each mode is a blend of exponentials, so that it obeys the same
memory of earlier reversals as Dahl's law. One more coefficient is the share of contacts with another memory, which
close their small loops. The coefficients are part of the point at which a hypothesis is linearised (`BlendedReversal`);
beside it, the tip may deviate further, to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from needleplan.diagnosis._base_law import decaying, full_cutting, leading_modes
from needleplan.diagnosis._constants import (
    MEMORY_LAW,
    OTHER_LENGTH,
    REVERSAL_CORRELATION,
    REVERSAL_MODES,
    REVERSAL_TRAVELS,
)
from needleplan.diagnosis._problem import PRESLIDING
from needleplan.diagnosis._tangents import is_added, output_beside, relative_step
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models import Model, simulate
from needleplan.models.friction import BlendedReversal, ShaftAndTip
from needleplan.signals import Array, Motion

__all__ = ["COUNT", "blended", "blended_by", "reversal_laws", "tip_reversal"]

# Lengths of the exponentials that are blended, in presliding lengths.
_LENGTHS = np.geomspace(0.12, 170.0, 15)
COUNT = REVERSAL_MODES + 1
"""Number of coefficients of the law of reversal: its modes, and the memory."""


@cache
def _modes() -> Array:
    """Return the weights of the exponentials in each mode, shape (lengths, modes); each mode has its prior variance."""
    travel = np.geomspace(*REVERSAL_TRAVELS, 120)
    envelope, apart = decaying(travel), np.log(travel)[:, None] - np.log(travel)
    covariance = np.outer(envelope, envelope) * np.exp(-0.5 * (apart / REVERSAL_CORRELATION) ** 2)
    # Another presliding length, d(1 - exp(-x)) / d(log length), belongs to the base's own parameter.
    other = travel * np.exp(-travel)
    rest = np.eye(len(travel)) - np.outer(other, other) / float(other @ other)
    wanted = leading_modes(rest @ covariance @ rest, REVERSAL_MODES)
    shapes = np.exp(-travel)[:, None] - np.exp(-travel[:, None] / _LENGTHS)
    return np.asarray(np.linalg.solve(shapes.T @ shapes + 1e-6 * np.eye(len(_LENGTHS)), shapes.T @ wanted))


def blended(model: ShaftAndTip, coefficients: Array) -> BlendedReversal:
    """Return the model with the law of reversal that has these coefficients."""
    weights = tuple((_modes() @ coefficients[:REVERSAL_MODES]).tolist())
    closed = MEMORY_LAW * float(coefficients[REVERSAL_MODES])
    values: dict[str, Any] = {**model.values(), "curves": model.curves, "weights": weights, "closed": closed}
    return BlendedReversal(**values, shares=tuple(_LENGTHS.tolist()))


def blended_by(model: Model) -> Array:
    """Return the coefficients of the law of reversal of a model, shape (modes,); shape (0,) if it has no such law."""
    if not isinstance(model, ShaftAndTip):
        return np.zeros(0)
    weights = model.weights if isinstance(model, BlendedReversal) else ()
    closed = model.closed / MEMORY_LAW if isinstance(model, BlendedReversal) else 0.0
    return np.append(np.linalg.lstsq(_modes(), np.array(weights))[0] if weights else np.zeros(REVERSAL_MODES), closed)


def reversal_laws(trial: CalibratedTrial, effects: Sequence[FittedEffect]) -> Array:
    """Return the change of the output by each mode, shape (samples, 2 * modes + 1).

    First come the modes of shaft and tip, then those of the tip alone, and another presliding length of the tip.
    """
    model, motion = trial.model, trial.motion
    if not isinstance(model, ShaftAndTip):
        return np.zeros((len(trial.measured), 0))
    here, depth = blended_by(model), np.maximum(motion.depth_mm, 0.0)
    shaft, tip = model.friction * depth, full_cutting(model, motion) / 2
    step = relative_step(model, PRESLIDING)
    longer = model.with_values(presliding_mm=model.presliding_mm * (1 + step))
    # Without curves the force is linear in the bristle, which is linear in the modes.
    if model.curves is None and all(is_added(effect) for effect in effects):
        moved = simulate(longer, motion).states[0] - simulate(model, motion).states[0]
        same = blended(model, here)
        modes = _modes().T @ same.others(motion)
        found = (shaft + tip)[:, None] * np.column_stack([*modes, MEMORY_LAW * same.closing(motion), moved])
    else:
        laws = [blended(model, here + each) for each in np.eye(COUNT)]
        plain = output_beside(model, effects, motion)
        found = np.column_stack([output_beside(each, effects, motion) - plain for each in (*laws, longer)])
    found[:, -1] *= OTHER_LENGTH / step
    return np.hstack([found[:, :-1], found * (tip / np.maximum(shaft + tip, 1e-12))[:, None]])


def tip_reversal(model: ShaftAndTip, motion: Motion, coefficients: Array) -> Array:
    """Return the change of the tip's bristle by another law of reversal of the tip alone, shape (samples,).

    `coefficients` are those of the last columns of `reversal_laws`: the modes, and the presliding length. Half of the
    full cutting force times this change is the output that the law adds.
    """
    step = relative_step(model, PRESLIDING)
    longer = model.with_values(presliding_mm=model.presliding_mm * (1 + step))
    moved = simulate(longer, motion).states[0] - simulate(model, motion).states[0]
    modes = blended(model, coefficients[:-1]).deviation(motion)
    return np.asarray(modes + OTHER_LENGTH / step * coefficients[-1] * moved)
