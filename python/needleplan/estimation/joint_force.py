"""The joint system of the force-depth model in closed form, in coordinates in which it cannot become unstable.

All parameters are estimated as logarithms, but for f2, which may be negative, and f1:

    f1 = max(0, -f2) + exp(u),

so that g(l) = f1 + f2 exp(-alpha l) is positive at every depth whatever the filter does. z takes the exponential step,
which is bounded for any step. With these two a start that is wrong by a factor of six is a start like another; without
them, as the thesis says of f2(0) = -0.01, "the filter tended to be unstable".
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.estimation.joint import Joint
from needleplan.models import Model
from needleplan.models.force import DepthForce
from needleplan.models.force.sensitivity import NAMES, Row, Values, exponential_step, force
from needleplan.signals import Array, Motion

__all__ = ["JointForce"]

_F1, _F2 = NAMES.index("f1"), NAMES.index("f2")
_F2_SCALE = 0.02
_FURTHEST = 40.0
"""Bound of the coordinates, e^40: a filter that gets there has diverged, and shall do so without an overflow."""


class JointForce(Joint):
    """z and the free parameters of a force-depth model; see the module for the coordinates."""

    def __init__(self, model: DepthForce, free: Sequence[str] | None = None) -> None:
        """Raise ModelError where g(l) is not positive at some depth, or `free` names no parameter of it."""
        super().__init__(model, free)
        if not model.proper:
            raise ModelError(Mistake("f1", f"{model.f1:g}", "f1 and f1 + f2 must be positive"), model.name)
        self.states = 1
        self._fixed = [getattr(model, name) for name in NAMES]
        self._identity = np.eye(1 + len(self.free))
        self._places = [NAMES.index(name) for name in self.free]

    def initial(self, model: Model, motion: Motion) -> Array:  # noqa: ARG002
        """Return z = 0 and the coordinates of the parameters."""
        return np.array([0.0, *(self._coordinate(model, name) for name in self.free)])

    def predict(self, x: Array, before: Motion, after: Motion) -> tuple[Array, Array]:
        """Return the next x and its derivative; the depth is held at the middle of the step."""
        z, *coordinates = x.tolist()
        values, slopes, floor_moves = self._natural(coordinates)
        middle = (float(before.depth_mm) + float(after.depth_mm)) / 2
        step = float(after.time_s) - float(before.time_s)
        row = exponential_step(z, values, middle, step)
        change = self._identity.copy()
        change[0] = self._chain(row, slopes, floor_moves)
        return np.array([row[0], *coordinates]), change

    def measure(self, x: Array, motion: Motion) -> tuple[float, Array]:
        """Return the force (N) and its derivative."""
        z, *coordinates = x.tolist()
        values, slopes, floor_moves = self._natural(coordinates)
        row = force(z, values, float(motion.depth_mm), float(motion.direction))
        return row[0], np.array(self._chain(row, slopes, floor_moves))

    def values(self, x: Array) -> dict[str, float]:
        """Return the values of the free parameters."""
        values, _, _ = self._natural(x[1:].tolist())
        return {name: values[place] for name, place in zip(self.free, self._places, strict=True)}

    def _coordinate(self, model: Model, name: str) -> float:
        value = getattr(model, name)
        if name == "f2":
            return float(value / _F2_SCALE)
        floor = max(0.0, -model.values()["f2"]) if name == "f1" else 0.0
        return log(value - floor)

    def _natural(self, coordinates: list[float]) -> tuple[Values, list[float], bool]:
        """Return all seven values, the slopes of the free ones, and whether f1 moves with f2."""
        values, slopes = self._fixed.copy(), []
        for place, u in zip(self._places, coordinates, strict=True):
            bounded = min(max(u, -_FURTHEST), _FURTHEST)
            value = bounded * _F2_SCALE if place == _F2 else exp(bounded)
            values[place] = value
            slopes.append(_F2_SCALE if place == _F2 else value)
        floor = max(0.0, -values[_F2])
        free_f1 = _F1 in self._places
        if free_f1:
            values[_F1] += floor
        sigma0, sigma1, sigma2, f1, f2, alpha, beta = values
        return (sigma0, sigma1, sigma2, f1, f2, alpha, beta), slopes, free_f1 and floor > 0

    def _chain(self, row: Row, slopes: list[float], floor_moves: bool) -> list[float]:
        _, by_z, by_values = row
        chained = [by_z]
        for place, slope in zip(self._places, slopes, strict=True):
            by = by_values[place] - by_values[_F1] if place == _F2 and floor_moves else by_values[place]
            chained.append(by * slope)
        return chained
