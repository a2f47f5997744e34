"""Buckling of the shaft between its last support and the tissue.

The unsupported part of the length l, from the chuck or the end of a guide to the surface of the tissue, is an Euler
column: EI u'''' + N u'' = 0, clamped at its base. It buckles at the axial force of equation (3) of
docs/explanation/mechanics.md ::

    N = EI (x / l)^2,   x = pi/2 (end free), 4.4934 (pinned, tan x = x), 2 pi (clamped),

which is pi^2 EI / (K l)^2 with K = 2, 0.699 and 0.5 (Euler; any textbook of strength of materials). The tissue holds
the shaft laterally and resists its rotation partly, so the load is between those of the pinned and the clamped end; the
pinned end is the safe assumption. Before the tip sticks in the tissue, its end is free. As the needle goes in by d, the
length falls to l - d, and the load rises.

The load is that of a straight elastic shaft. An initial bend lowers the force at which it bows visibly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from needleplan.config import Choice, ConfigTable, Number, ruled
from needleplan.errors import ModelError
from needleplan.signals import Array

__all__ = ["ShaftEnd", "UnsupportedShaft"]


class ShaftEnd(StrEnum):
    """How the tissue holds the end of the unsupported shaft."""

    FREE = "free"
    """Not at all: the tip slides on the surface."""

    PINNED = "pinned"
    """Laterally: the shaft may rotate at the surface."""

    CLAMPED = "clamped"
    """Laterally and against rotation."""


# x of the module docstring.
_ROOTS = {ShaftEnd.FREE: math.pi / 2, ShaftEnd.PINNED: 4.493409457909064, ShaftEnd.CLAMPED: 2 * math.pi}


@dataclass(frozen=True)
class UnsupportedShaft(ConfigTable, error=ModelError):
    """The part of a needle between its last support and the tissue, as an Euler column.

    The constructor raises ModelError unless stiffness and length are positive and finite.

    Parameters
    ----------
    stiffness_n_mm2 : float
        Bending stiffness EI, `NeedleShaft.bending_stiffness_n_mm2`.
    length_mm : float
        Unsupported length when the tip is at the surface: from the chuck, or from the end of the guide, to the tip.
    end : ShaftEnd
        How the tissue holds the shaft.

    Examples
    --------
    >>> from needleplan.models.deflection import UnsupportedShaft
    >>> shaft = UnsupportedShaft(stiffness_n_mm2=230.0, length_mm=150.0)
    >>> print(f"{float(shaft.buckling_n(0.0)):.2f} N, {float(shaft.buckling_n(50.0)):.2f} N")
    0.21 N, 0.46 N
    """

    stiffness_n_mm2: float = ruled(Number("N mm2", above=0))
    length_mm: float = ruled(Number("mm", above=0))
    end: ShaftEnd = ruled(Choice(ShaftEnd), ShaftEnd.PINNED)

    def buckling_n(self, inserted_mm: ArrayLike) -> Array:
        """Return the axial force at which the shaft buckles.

        Parameters
        ----------
        inserted_mm : array_like
            Inserted length of the needle.

        Returns
        -------
        Array
            Force (N), in the shape of `inserted_mm`; infinite where nothing is unsupported.
        """
        left = self.length_mm - np.asarray(inserted_mm, float)
        some = left > 0
        load = self.stiffness_n_mm2 * (_ROOTS[self.end] / np.where(some, left, 1.0)) ** 2
        return np.where(some, load, np.inf)

    def holds_from_mm(self, force_n: float) -> float:
        """Return the inserted length from which the shaft carries a force.

        Parameters
        ----------
        force_n : float
            Axial force (N), above 0.

        Returns
        -------
        float
            Inserted length (mm); 0 if the shaft carries the force from the surface on.
        """
        return max(self.length_mm - _ROOTS[self.end] * math.sqrt(self.stiffness_n_mm2 / force_n), 0.0)
