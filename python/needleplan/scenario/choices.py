"""The choices that a scenario offers by name."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Method", "Priority", "Transition"]


class Transition(StrEnum):
    """Where the end of an arc lands on the grid."""

    NEAREST = "nearest"
    """On the nearest grid point: the thesis."""

    INTERPOLATED = "interpolated"
    """On the four grid points around it, bilinearly weighted: unbiased."""


class Method(StrEnum):
    """How the optimal values are computed."""

    SWEEP = "sweep"
    """Directional sweeps over the lattice: the fast one."""

    PPVI = "ppvi"
    """Prioritized-partitioned value iteration as in section 6.3 of the thesis."""

    VALUE_ITERATION = "vi"
    """Plain value iteration: the readable reference."""


class Priority(StrEnum):
    """By what the next partition is chosen; only `Method.PPVI` asks."""

    H1 = "H1"
    """The Bellman residual, equation (6.7)."""

    H2 = "H2"
    """The residual plus the value, equation (6.8)."""

    BOUND = "bound"
    """An upper bound on the residual: the changes of the neighbours, accumulated since the last visit."""
