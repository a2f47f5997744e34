"""The choices between the equations that were printed and the ones that hold."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["AxialTerms", "Foundation"]


class AxialTerms(StrEnum):
    """Which first-order effects of the axial load are in the beam's equation.

    With c = vf v, the friction per length, u > 0 towards the push of the bevel, in the tissue (no c and kf outside)
    """

    CONSISTENT = "consistent"
    """EI u'''' + N u'' + kf (u - path) = 0, EI u'''(L) = -Fc cos a, N(x) = Fc sin a + c (L - max(x, l1)): all of
    them. A needle that is pushed along a straight oblique line stays on it."""

    PLAIN = "plain"
    """EI u'''' + kf (u - path) = 0, EI u'''(L) = -Fc cos a: none of them."""

    PRINTED = "printed"
    """EI u'''' + kf u - c u' = 0, EI u'''(L) = -(Fc cos a + Fc sin a u'(L)): (5.6) and (5.8) of the thesis.

    Wrong: the friction pushes forward, and the tip force turns against the tip, which makes the cantilever unstable at
    Fc = 2 EI/(L^2 sin a). (The sign of Fc itself is that of a push towards the bevel; (5.3) has the other one.)"""

    FIXED = "fixed"
    """EI u'''' + kf u + c u' = 0, EI u'''(L) = -(Fc cos a - Fc sin a u'(L)): the printed terms with the right signs.

    Still half of the expansion: the axial load N, which is not there, cancels both terms exactly."""


class Foundation(StrEnum):
    """What the springs of the tissue are anchored to."""

    MEMORY = "memory"
    """To where the tip has cut the tissue: fresh tissue is unstressed. The path becomes a circle, R = EI lam/P."""

    ANCHORED = "anchored"
    """To the straight line of the insertion, as in (5.1): tissue resists as if the needle had been pressed into it
    sideways, and a constant tip force makes no arc."""
