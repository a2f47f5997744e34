"""Measured deviations of friction and cutting force from the laws of `ShaftAndTip`, as curves.

With the friction S and the cutting force C of the model, and the cutting force C1 of a tip that is always loaded::

    S' = S (1 + a(L) + b(|v|) + g(S + C) + d sign S)
    C' = C (1 + h(L) + k(|v|) + g(S + C)) + p (C1 - C)

L is the inserted length, and |v| the mean speed over the last half millimetre of travel: at rest, friction keeps the
value of the movement before. The functions are linear between their nodes and constant beyond them. A diagnosis finds
them as laws of the base (docs/explanation/posterior.md, equation 2).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from needleplan.config import ConfigTable, Number, NumberList, ruled
from needleplan.errors import Mistake, ModelError
from needleplan.signals import Array, Motion, recurrence

__all__ = ["LawCurves", "mean_speed"]

# Travel (mm) over which the speed is averaged: at rest, friction keeps the value of the movement before.
_SPEED_TRAVEL_MM = 0.5

_MOST_NODES = 200


def _places(unit: str) -> NumberList:
    return NumberList(unit, 0, _MOST_NODES, "each place once, in ascending order")


_SHARES = NumberList("", 0, _MOST_NODES)
_SHARE = Number(at_least=-1000, at_most=1000)


# The curves along each axis.
_CURVES = {
    "depth_mm": ("friction_by_depth", "cutting_by_depth"),
    "speed_mm_s": ("friction_by_speed", "cutting_by_speed"),
    "force_n": ("both_by_force",),
}


def _shares_have_places(
    depth_mm: tuple[float, ...], friction_by_depth: tuple[float, ...], cutting_by_depth: tuple[float, ...],
    speed_mm_s: tuple[float, ...], friction_by_speed: tuple[float, ...], cutting_by_speed: tuple[float, ...],
    force_n: tuple[float, ...], both_by_force: tuple[float, ...],
) -> Iterator[Mistake]:  # fmt: skip
    given = locals()
    for where, names in _CURVES.items():
        for name in names:
            if given[name] and len(given[name]) != len(given[where]):
                rule = f"must have one for each of the {len(given[where])} of {where}"
                yield Mistake(name, f"{len(given[name])} numbers", rule)


@dataclass(frozen=True, kw_only=True)
class LawCurves(ConfigTable, key="options.curves", error=ModelError, between=(_shares_have_places,)):
    """Curves by which friction and cutting force deviate from the laws of a `ShaftAndTip`, as shares of these forces.

    Raises ModelError with every value outside of its rule.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.models.friction import LawCurves
    >>> from needleplan.signals import insertion_cycles
    >>> curves = LawCurves(depth_mm=(0.0, 50.0), friction_by_depth=(0.0, 0.5))
    >>> model = npl.models.ShaftAndTip(
    ...     friction=0.01, cutting=0.5, onset_mm=3.0, presliding_mm=0.5, curves=curves
    ... )
    >>> print(f"{npl.models.simulate(model, insertion_cycles(50.0, 5.0)).output.max():.2f} N")
    1.25 N
    """

    depth_mm: tuple[float, ...] = ruled(_places("mm"), ())
    friction_by_depth: tuple[float, ...] = ruled(_SHARES, ())
    cutting_by_depth: tuple[float, ...] = ruled(_SHARES, ())
    speed_mm_s: tuple[float, ...] = ruled(_places("mm/s"), ())
    friction_by_speed: tuple[float, ...] = ruled(_SHARES, ())
    cutting_by_speed: tuple[float, ...] = ruled(_SHARES, ())
    force_n: tuple[float, ...] = ruled(_places("N"), ())
    both_by_force: tuple[float, ...] = ruled(_SHARES, ())
    friction_by_direction: float = ruled(_SHARE, 0.0)
    """Share that is added to the friction during insertion, and taken from it on retraction."""

    cutting_pulled: float = ruled(_SHARE, 0.0)
    """Share of the cutting force that stays on retraction."""

    def changed(self, shaft_n: Array, tip_n: Array, full_n: Array, motion: Motion) -> tuple[Array, Array]:
        """Return friction and cutting force with these curves.

        Parameters
        ----------
        shaft_n, tip_n, full_n : numpy.ndarray
            Friction, cutting force, and that of a tip that is always loaded, of the laws (N), shape (...).
        motion : Motion
            Motion or instant, of the shape (...).

        Returns
        -------
        tuple of numpy.ndarray
            Friction and cutting force (N), shape (...) each.
        """
        depth = np.maximum(motion.depth_mm, 0.0)
        both = _share(shaft_n + tip_n, self.force_n, self.both_by_force)
        friction = 1 + both + _share(depth, self.depth_mm, self.friction_by_depth)
        cutting = 1 + both + _share(depth, self.depth_mm, self.cutting_by_depth)
        if self.speed_mm_s:
            speed = mean_speed(motion.velocity_mm_s, depth, (self.speed_mm_s[0], self.speed_mm_s[-1]))
            friction = friction + _share(speed, self.speed_mm_s, self.friction_by_speed)
            cutting = cutting + _share(speed, self.speed_mm_s, self.cutting_by_speed)
        friction = friction + self.friction_by_direction * np.sign(shaft_n)
        return np.asarray(shaft_n * friction), np.asarray(tip_n * cutting + self.cutting_pulled * (full_n - tip_n))

    def after(self, first: LawCurves | None) -> LawCurves:
        """Return the curves that act like `first` and then these, without products of shares along different axes.

        Parameters
        ----------
        first : LawCurves, optional
            Curves of the forces that these curves multiply.

        Returns
        -------
        LawCurves
        """
        if first is None:
            return self
        found: dict[str, Any] = {}
        for where, names in _CURVES.items():
            own, other = getattr(self, where), getattr(first, where)
            places = found[where] = tuple(sorted({*own, *other})[:_MOST_NODES])
            for name in names:
                shares = [1 + _share(np.array(places), *each) for each in (
                    (own, getattr(self, name)), (other, getattr(first, name))
                )]  # fmt: skip
                found[name] = tuple(np.broadcast_to(shares[0] * shares[1] - 1, len(places)).tolist())
        for name in ("friction_by_direction", "cutting_pulled"):
            found[name] = getattr(self, name) + getattr(first, name)
        return LawCurves(**found)


def mean_speed(velocity_mm_s: ArrayLike, depth_mm: ArrayLike, reach_mm_s: tuple[float, float]) -> Array:
    """Return the speed within a range, averaged over the travel, shape (...).

    Parameters
    ----------
    velocity_mm_s, depth_mm : array_like
        Velocity (mm/s) and depth (mm), shape (..., samples), or an instant, whose speed is not averaged.
    reach_mm_s : tuple of float
        Least and largest speed (mm/s).

    Returns
    -------
    Array
        Speed (mm/s).
    """
    speed, depth = np.clip(np.abs(np.asarray(velocity_mm_s, float)), *reach_mm_s), np.asarray(depth_mm, float)
    if speed.ndim == 0 or depth.shape != speed.shape:
        return np.asarray(speed)
    keep = np.exp(-np.abs(np.diff(depth)) / _SPEED_TRAVEL_MM)
    rows = [
        recurrence(kept, (1 - kept) * own[1:], float(own[0]))
        for kept, own in zip(keep.reshape(-1, keep.shape[-1]), speed.reshape(-1, speed.shape[-1]), strict=True)
    ]
    return np.asarray(np.clip(np.reshape(rows, speed.shape), *reach_mm_s))


def _share(values: Array, places: tuple[float, ...], shares: tuple[float, ...]) -> Array | float:
    return np.asarray(np.interp(values, places, shares)) if shares else 0.0
