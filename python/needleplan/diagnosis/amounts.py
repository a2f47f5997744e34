"""How much of each effect there is: its parameters with 95 % intervals, what it adds, its share of the gap.

The size enters the output almost linearly, and its interval is that of the linearised fit. Where, when and how fast do
not: a layer that begins between two samples, a time constant longer than the trial. Their intervals are of the profile
likelihood: the parameter is moved, the output simulated anew, all others follow, and where twice the log likelihood has
fallen by 3.84 the interval ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.diagnosis import FoundEffect
from needleplan.diagnosis.refit import Added, Joint, added_output, effect_columns
from needleplan.diagnosis.rounds import USUAL_LAGS
from needleplan.diagnosis.select import Selection
from needleplan.diagnosis.size import DIRECTION, interval_of, is_there
from needleplan.diagnosis.space import Space
from needleplan.models import Estimate, Parameter, Scale
from needleplan.models.effects import SIZE, AddedEffect

__all__ = ["found_effects"]

_FALL = 3.84
_NORMAL = 1.96
_TRIES = 5
_NEAR = 0.15
"""How near to the fall that is sought a profile must come, as a share of it."""

_FORMULA = 0.04
"""Standard deviation of a size, as a share of it, for what lumped formulas and sampled motions are only nearly."""

_PLACE = "depth_mm"
_ABOUT_MM = 1.0

_FURTHEST = 6.0
"""Of a coordinate's interval on either side, in units of its linearised half width."""


def found_effects(selection: Selection) -> tuple[FoundEffect, ...]:
    """Return what was accepted, with its amounts; nothing where nothing was."""
    joint = selection.joint
    if joint is None:
        return ()
    whole = sum(member.gain for member in selection.members)
    found = []
    for index, (each, member) in enumerate(zip(joint.added, selection.members, strict=True)):
        if member.rivals:
            continue
        estimates = {name: _estimate(joint, index, name) for name in each.values}
        rows = [added_output([each], case.model, case.motion) for case in joint.cases]
        rms = float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
        added = AddedEffect(each.effect.name, each.values, estimates, "", each.effect.version)
        share = float(member.gain / max(whole, 1e-12))
        found.append(FoundEffect(each.effect, added, rms, share, member.balance, member.p_value))
    return tuple(found)


def _estimate(joint: Joint, index: int, name: str) -> Estimate:
    what, value = joint.added[index].effect.parameters[name], joint.added[index].values[name]
    sd = joint.sd(index, name) if what.free else 0.0
    if not what.free or name in (SIZE, DIRECTION):
        low, high = interval_of(joint, index, name)
        if name == SIZE:
            low, high = _widened(value, (low, high), what)
        if name == SIZE and joint.added[index].effect.is_lag:
            # As late as that is many a sensor by its own filter, which delays as a line does: the two are one.
            low = max(low - USUAL_LAGS * measurand_of(joint.cases[0].model.channel).usual_lag_s, what.lower)
        return Estimate(value, sd, low, high, what.unit, name != SIZE or is_there(joint, index))
    low, high = (_end(joint, index, name, sign) for sign in (-1, 1))
    if name == _PLACE:
        grain = _grain_mm(joint, value)
        low, high = max(low - grain, what.lower), min(high + grain, what.upper)
    return Estimate(value, sd, min(low, value), max(high, value), what.unit, low > what.lower or high < what.upper)


def _widened(value: float, ends: tuple[float, float], what: Parameter) -> tuple[float, float]:
    """Return the interval of a size with the uncertainty of its formula, which is apart from that of the noise."""
    more = _NORMAL * _FORMULA * abs(value)
    low, high = value - math.hypot(value - ends[0], more), value + math.hypot(ends[1] - value, more)
    if ends[0] * ends[1] > 0 >= low * high:  # that it is there is not of its formula
        low, high = (ends[0], high) if value > 0 else (low, ends[1])
    return max(low, what.lower), min(high, what.upper)


def _grain_mm(joint: Joint, depth_mm: float) -> float:
    """Return half the way from one sample to the next where the tip is at a depth: between the two nobody looks."""
    ways = []
    for case in joint.cases:
        depth = case.motion.depth_mm
        near = np.abs(depth[1:] - depth_mm) < _ABOUT_MM
        ways.append(np.abs(np.diff(depth))[near])
    every = np.concatenate(ways)
    moving = every[every > 0]
    return float(np.median(moving)) / 2 if moving.size else 0.0


def _end(joint: Joint, index: int, name: str, sign: int) -> float:
    """Return where the profile has fallen by enough, or how far it was followed.

    The root of the fall is almost a straight line: two or three secants reach it.
    """
    added = joint.added[index]
    what, value = added.effect.parameters[name], added.values[name]
    centre = what.coordinate(value)
    half = _NORMAL * min(joint.sd(index, name) / what.slope(value), 2.0)
    bound = _coordinate(what, what.lower if sign < 0 else what.upper)
    step, short, far = half, 0.0, math.inf
    for _ in range(_TRIES):
        here = centre + sign * step
        beyond = sign * (here - bound) >= 0
        here = bound if beyond else here
        step = abs(here - centre)
        fall = _fall(joint, index, name, _within(what, here))
        if abs(fall - _FALL) < _NEAR * _FALL or (fall < _FALL and beyond):
            break
        if fall < _FALL:
            short = max(short, step)
        else:
            far = min(far, step)
        wanted = step * math.sqrt(_FALL / max(fall, 0.05 * _FALL))
        step = wanted if short < wanted < far else (short + far) / 2 if far < math.inf else 2 * step
        if step > _FURTHEST * half:
            step = _FURTHEST * half
            break
    return _within(what, centre + sign * step)


def _fall(joint: Joint, index: int, name: str, value: float) -> float:
    """Return how much less likely the data are with one parameter at `value`, twice the log, all others best."""
    level = np.array([joint.space.level])
    values = {**joint.added[index].values, name: value}
    moved: Sequence[Added] = [
        replace(each, values=values) if place == index else each for place, each in enumerate(joint.added)
    ]
    others = tuple(each for each in joint.names if each != (index, name))
    blocks = []
    for case in joint.cases:
        before = added_output(joint.added, case.model, case.motion)
        more = case.whiten(added_output(moved, case.model, case.motion) - before)
        columns = case.whiten(effect_columns(moved, others, case.model, case.motion))
        blocks.append(replace(case.block, residual=case.block.residual - more, shared=columns))
    return Space(blocks, level).energy() - joint.space.energy()


def _within(what: Parameter, coordinate: float) -> float:
    ends = [_coordinate(what, each) for each in (what.lower, what.upper)]
    return float(np.clip(what.value(min(max(coordinate, ends[0]), ends[1])), what.lower, what.upper))


def _coordinate(what: Parameter, bound: float) -> float:
    return what.coordinate(max(bound, 1e-300) if what.scale is Scale.LOG else bound)
