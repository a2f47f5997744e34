"""The position of the tip: how heterogeneous tissue moves it, and its competitors without a name.

A path that bends by dk(s) more, toward a direction d(s) across it, turns from there on by t x d dk, and so moves every
later place p by the cross product of that turn with p - p(s). Summed along the path that is exact to first order, and
it is how a random curvature, an integrated Wiener process of the place, shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from needleplan.diagnosis.measurand import Axis, Basis, Measurand
from needleplan.diagnosis.smooth import splines
from needleplan.diagnosis.variation import CORRELATION_MM, at_depth, functions_of_depth
from needleplan.diagnosis.verdict import Gates
from needleplan.models import Channel, Model, simulate
from needleplan.signals import Array, Motion

if TYPE_CHECKING:
    from needleplan.diagnosis.calibrate import Case

__all__ = ["TIP_POSITION", "bent", "heading_modes", "tip_bases"]

_USUAL_LAG_S = 0.005
_ROUNDS = 10
_ENTRY = ("heading_y_rad", "heading_z_rad", "entry_x_mm", "entry_y_mm", "entry_z_mm")
_BELIEFS = {"curvature_per_mm": 0.2}
"""One needle in one tissue bends alike from insertion to insertion, to a fifth where that was measured: what would need
three times the curvature elsewhere is then no rival of what needs none.
"""

_USUAL_LEVEL = 0.06
"""A curvature that varies by more than a tenth along the path is rare; without that, any layer could be chance."""

_ASIDE = 0.5
"""Heterogeneity across the bevel over that along it."""

_SLOW = 0.02
"""Share of the greatest speed below which the needle rests."""


def heading_modes(model: Model, motion: Motion) -> Array:
    """Return what the place gains for every mode of the curvature at level 1, shape (3 samples, modes)."""
    depth = np.clip(np.asarray(motion.depth_mm, float), 0.0, None)
    modes, places = functions_of_depth(float(np.ceil(max(depth.max(), 1.0))))
    at = at_depth(depth, places, modes)
    states = simulate(model, motion).states
    curvature, felt = _curvature(model), _felt_mm(model)
    return np.column_stack([
        bent(states, motion, curvature * at, _bevel(states, 0.0), felt),
        bent(states, motion, curvature * _ASIDE * at, _bevel(states, np.pi / 2), felt),
    ])  # fmt: skip


def bent(states: Array, motion: Motion, more_per_mm: Array, direction: Array, felt_mm: float = 0.0) -> Array:
    """Return how far places move for curvature `more_per_mm`, shape (samples, m): (3 samples, m).

    `states` are those of the path, `direction`, shape (3, samples), says toward where it bends. At the end of a beam
    (see `deflection.spatial`) the tip is farther aside.
    """
    tangent, place = states[3:6], states[:3]
    step = np.append(np.diff(np.maximum(motion.depth_mm, 0.0)), 0.0)
    turns = np.cross(tangent, direction, axis=0)[..., None] * (more_per_mm * step[:, None])[None]
    # sum over s before now of turn(s) x (p - p(s)): two sums along the path, each taken before the step of now
    turned = np.cumsum(turns, axis=1) - turns
    moments = _cross(turns, place[..., None])
    before = np.cumsum(moments, axis=1) - moments
    moved = _cross(turned, place[..., None]) - before
    if felt_mm:
        moved = moved + felt_mm * np.cross(turned, tangent[..., None], axis=0)
        moved = moved + felt_mm**2 / 2 * direction[..., None] * more_per_mm
    return np.asarray(moved.reshape(-1, more_per_mm.shape[1]))


def _cross(a: Array, b: Array) -> Array:
    """Return the product of vectors along the first axis: that of numpy spends most of its time on axes."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def tip_bases(cases: Sequence[Case]) -> dict[str, Basis]:
    """Return smooth bases, raw (3 samples, df) for each trial, by name: one set of sizes for all trials."""
    motions = [case.motion for case in cases]
    deepest = max(float(each.depth_mm.max()) for each in motions)
    fastest = max(float(np.abs(each.velocity_mm_s).max()) for each in motions)
    longest = max(float(each.time_s[-1]) for each in motions)
    states = [simulate(case.model, case.motion).states for case in cases]
    depth = [splines(np.clip(each.depth_mm, 0, None), 0.0, deepest, 6) for each in motions]
    speed = [splines(np.abs(each.velocity_mm_s), 0.0, fastest, 4) for each in motions]
    found: dict[str, Basis] = {}

    def shifted(name: str, axis: Axis, columns: Sequence[Array]) -> None:
        _add(found, name, axis, [case.spread(each) for case, each in zip(cases, columns, strict=True)])

    def curved(name: str, axis: Axis, columns: Sequence[Array], *, turning: bool) -> None:
        parts = []
        for case, each, state in zip(cases, columns, states, strict=True):
            more = _curvature(case.model) * each
            ways = [_bevel(state, a) if turning else _fixed(state, a) for a in (0.0, np.pi / 2)]
            parts.append(np.column_stack([bent(state, case.motion, more, way, _felt_mm(case.model)) for way in ways]))
        _add(found, name, axis, parts)

    shifted("place by depth", Axis.DEPTH, depth)
    shifted("place by time", Axis.TIME, [splines(each.time_s, 0.0, longest, 7) for each in motions])
    shifted("place by speed", Axis.SPEED, speed)
    shifted("place by angle", Axis.ANGLE, [
        np.column_stack([np.cos(each.angle_rad), np.sin(each.angle_rad), np.cos(2 * each.angle_rad)])
        for each in motions
    ])  # fmt: skip
    curved("curvature by depth", Axis.DEPTH, depth, turning=True)
    curved("pull by depth", Axis.DEPTH, depth, turning=False)
    curved("curvature by speed", Axis.SPEED, speed, turning=True)
    curved("pull by speed", Axis.SPEED, speed, turning=False)
    curved("curvature by time", Axis.TIME, [splines(each.time_s, 0.0, longest, 6) for each in motions], turning=True)
    return found


def _add(found: dict[str, Basis], name: str, axis: Axis, columns: list[Array]) -> None:
    alive = np.abs(np.vstack(columns)).max(axis=0) > 1e-9
    if alive.any():
        found[name] = Basis(axis, tuple(each[:, alive] for each in columns))


def _curvature(model: Model) -> float:
    """Return how much the path bends."""
    return abs(float(getattr(model, "curvature_per_mm", 1e-3)))


def _felt_mm(model: Model) -> float:
    """Return the length over which a needle that is a beam feels what is done to it; 0 for one that is none."""
    return float(getattr(model, "felt_mm", 0.0))


def _bevel(states: Array, more_rad: float) -> Array:
    """Return the direction at an angle from the bevel, shape (3, samples)."""
    return _across(states, states[9] + more_rad)


def _fixed(states: Array, angle_rad: float) -> Array:
    return _across(states, np.full(states.shape[1], angle_rad))


def _across(states: Array, angle_rad: Array) -> Array:
    tangent, normal = states[3:6], states[6:9]
    return np.asarray(np.cos(angle_rad) * normal + np.sin(angle_rad) * np.cross(tangent, normal, axis=0))


def _no_moments(predicted: Array, motion: Motion) -> Array:  # noqa: ARG001
    """Nothing of a place changes at once."""
    return np.zeros((len(predicted), 0))


def _places(motion: Motion) -> int:
    """Return the number of places along the path that have a curvature of their own, on three axes."""
    return max(round(3 * float(np.ptp(motion.depth_mm)) / CORRELATION_MM), 3)


TIP_POSITION = Measurand(
    Channel.TIP, _USUAL_LAG_S, _BELIEFS, heading_modes, _no_moments, tip_bases, _places,
    Gates(balance=10.0, balance_varied=10.0), _ENTRY, _ROUNDS, _USUAL_LEVEL,
)  # fmt: skip
"""The channel of the tip's path."""
