"""The axial force: what of it is not known well, and its competitors without a name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from needleplan.diagnosis.measurand import Axis, Basis, Measurand
from needleplan.diagnosis.smooth import splines
from needleplan.diagnosis.variation import tissue_modes
from needleplan.models import Channel
from needleplan.models.effects import presliding_of
from needleplan.models.friction import slid
from needleplan.signals import Array, Motion

if TYPE_CHECKING:
    from needleplan.diagnosis.calibrate import Case

__all__ = ["AXIAL_FORCE", "force_bases", "turning", "turns"]

_USUAL_LAG_S = 0.004
_BELIEFS = {"presliding_mm": 0.2}
"""How well friction turns round is a matter of the surfaces, and known better than its amount: to a fifth."""

_TURN_S = 0.002
_TURN_SAMPLES = 2
_SLOW = 0.002
_AT_REST = 0.02
"""Share of the greatest speed below which the needle rests."""


def force_bases(cases: Sequence[Case]) -> dict[str, Basis]:
    """Return smooth bases, raw (samples, df) for each trial, by name: one set of sizes for all trials."""
    motions = [case.motion for case in cases]
    deepest = max(float(each.depth_mm.max()) for each in motions)
    fastest = max(float(np.abs(each.velocity_mm_s).max()) for each in motions)
    longest = max(float(each.time_s[-1]) for each in motions)
    force = max(float(np.abs(case.output).max()) for case in cases) or 1.0
    found: dict[str, Basis] = {}

    def add(name: str, axis: Axis, columns: list[Array]) -> None:
        used = np.vstack(columns)
        alive = np.abs(used).max(axis=0) > 1e-9
        if alive.any():
            found[name] = Basis(axis, tuple(each[:, alive] for each in columns))

    signs = [slid(case.motion, presliding_of(case.model)) for case in cases]
    depth = [splines(np.clip(each.depth_mm, 0, None), 0.0, deepest, 9) for each in motions]
    inside = [np.clip(each.depth_mm, 0, None)[:, None] for each in motions]
    speed = [splines(np.abs(each.velocity_mm_s), 0.0, fastest, 5) for each in motions]
    add("advance by depth", Axis.DEPTH, [b * ((1 + z) / 2)[:, None] for b, z in zip(depth, signs, strict=True)])
    add("retraction by depth", Axis.DEPTH, [b * ((1 - z) / 2)[:, None] for b, z in zip(depth, signs, strict=True)])
    add("depth, either way", Axis.DEPTH, depth)
    add("friction by speed", Axis.SPEED,
        [b * L * z[:, None] for b, L, z in zip(speed, inside, signs, strict=True)])  # fmt: skip
    add("force by speed", Axis.SPEED, [b * z[:, None] for b, z in zip(speed, signs, strict=True)])
    add("time", Axis.TIME, [splines(each.time_s, 0.0, longest, 7) for each in motions])
    add("rest", Axis.HOLD, [_rests(case) for case in cases])
    powers = [_powers(case, force) for case in cases]
    add("force", Axis.FORCE, powers)
    add("force squared", Axis.FORCE, [each[:, 1:2] - each[:, 3:4] for each in powers])
    # What is left out at turns costs a power most of its gain. A single power of pushing mends no moment of turning
    # by which the base is off; beside an effect, though, it mends what its fit leaves there.
    push = [np.maximum(case.output / force, 0.0)[:, None] for case in cases]
    for name, power in (("pushing force squared", 2), ("pushing force cubed", 3)):
        found[name] = Basis(Axis.FORCE, tuple(each**power for each in push), beside_effects=False)
    return found


def turns(predicted: Array, motion: Motion) -> Array:
    """Return what an error of the moment, and of the duration, of every turn of the force would show, at one sd.

    Between two samples a motion is taken as even, and when it turns it is not: at a reversal the force changes by all
    of its friction within one or two samples, and a millisecond is worth many times the noise.
    """
    slope = np.gradient(predicted, motion.time_s)
    curve = np.gradient(slope, motion.time_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], turning(motion).astype(int), [0]])))
    sds = (_TURN_S, _TURN_S * float(np.median(motion.interval_s)) / 2)
    found = np.zeros((len(predicted), len(edges)))
    for first, (begin, end) in enumerate(zip(edges[::2], edges[1::2], strict=True)):
        for which, (values, sd) in enumerate(zip((slope, curve), sds, strict=True)):
            found[begin:end, 2 * first + which] = sd * values[begin:end]
    return found


def turning(motion: Motion) -> Array:
    """Return which samples are next to a change of direction, or to a begin or end of rest; bool (samples,)."""
    fastest = float(np.abs(motion.velocity_mm_s).max())
    sign = np.sign(np.where(np.abs(motion.velocity_mm_s) < _SLOW * fastest, 0.0, motion.velocity_mm_s))
    turned = np.concatenate([[False], np.diff(np.where(sign == 0, motion.direction, sign)) != 0])
    return np.asarray(np.convolve(turned, np.ones(2 * _TURN_SAMPLES + 1), "same") > 0)


def _powers(case: Case, scale: float) -> Array:
    """Return powers of the force, away from where it turns round: there they would mend the moment of turning."""
    force = np.where(turning(case.motion), 0.0, case.output / scale)
    push, pull = np.maximum(force, 0), np.maximum(-force, 0)
    return np.column_stack([push, push**2, push**3, pull**2])


def _rests(case: Case) -> Array:
    """Return how the force of a rest changes since it began, for four time constants; zero in movement."""
    motion: Motion = case.motion
    fastest = float(np.abs(motion.velocity_mm_s).max())
    still = np.abs(motion.velocity_mm_s) < _AT_REST * fastest
    began = np.maximum.accumulate(np.where(still, 0, np.arange(len(motion))))
    since = motion.time_s - motion.time_s[began]
    scale = np.where(still, case.output, 0.0)
    return np.column_stack([scale * -np.expm1(-since / tau) for tau in (0.15, 0.6, 2.5, 10.0)])


AXIAL_FORCE = Measurand(Channel.FORCE, _USUAL_LAG_S, _BELIEFS, tissue_modes, turns, force_bases)
"""The channel of the axial force."""
