"""Limits of an insertion in the anatomy file: length, direction, and the workspace of the robot."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.config import ConfigTable, Maybe, Number, Numbers, TableList, ruled
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["HalfSpace", "SpaceLimits"]


@dataclass(frozen=True)
class HalfSpace(ConfigTable, key="limits.half_spaces", error=ScenarioError):
    """Points p in RAS mm with `normal` . p at most `at_most_mm`; `normal` is a unit vector."""

    normal: tuple[float, float, float] = ruled(Numbers(3, unit_length=True))
    at_most_mm: float = ruled(Number("mm", at_least=-1e5, at_most=1e5))


_CORNER = Maybe(Numbers(3))


def _both(toward: object, toward_deg: object) -> Iterator[Mistake]:
    if (toward is None) != (toward_deg is None):
        missing, given = ("toward", "toward_deg") if toward is None else ("toward_deg", "toward")
        yield Mistake(missing, "", f"is missing: {given} is given")


def _ordered(low_mm: tuple[float, ...] | None, high_mm: tuple[float, ...] | None) -> Iterator[Mistake]:
    if low_mm and high_mm and not all(low < high for low, high in zip(low_mm, high_mm, strict=True)):
        yield Mistake("high_mm", str(list(high_mm)), f"must be above low_mm = {list(low_mm)} along each axis")


@dataclass(frozen=True)
class SpaceLimits(ConfigTable, key="limits", error=ScenarioError, between=(_both, _ordered)):
    """Limits that an entry keeps.

    - `insertion_mm`: greatest length of the path without noise.
    - `toward`, `toward_deg`: the direction of the entry lies in this cone about a direction in RAS.
    - `low_mm`, `high_mm`, `half_spaces`: the entry point lies in the workspace of the robot, a box and half-spaces in
      RAS mm.
    """

    insertion_mm: float | None = ruled(Maybe(Number("mm", above=0, at_most=1000)), None)
    toward: tuple[float, float, float] | None = ruled(Maybe(Numbers(3, unit_length=True)), None)
    toward_deg: float | None = ruled(Maybe(Number("degrees", above=0, at_most=90)), None)
    low_mm: tuple[float, float, float] | None = ruled(_CORNER, None)
    high_mm: tuple[float, float, float] | None = ruled(_CORNER, None)
    half_spaces: tuple[HalfSpace, ...] = ruled(TableList(HalfSpace, at_most=20), ())

    def reachable(self, points_mm: NDArray[np.float64]) -> Iterator[tuple[str, NDArray[np.bool_]]]:
        """Yield the key of each rule on the workspace, and which points in RAS mm, shape (n, 3), keep it."""
        if self.low_mm is not None:
            yield "limits.low_mm", np.asarray((points_mm >= self.low_mm).all(-1))
        if self.high_mm is not None:
            yield "limits.high_mm", np.asarray((points_mm <= self.high_mm).all(-1))
        for number, half_space in enumerate(self.half_spaces, start=1):
            yield f"limits.half_spaces {number}", points_mm @ np.array(half_space.normal) <= half_space.at_most_mm

    def permits(self, directions: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which unit vectors in RAS, shape (n, 3), lie in the cone about `toward`; all without one."""
        if self.toward is None or self.toward_deg is None:
            return np.ones(len(directions), bool)
        return np.asarray(directions @ np.array(self.toward) >= math.cos(math.radians(self.toward_deg)) - 1e-12)
