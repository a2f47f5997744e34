"""Actions and outcomes: text for people, numbers in arrays."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from typing import Self

__all__ = ["Action", "CodedEnum", "Outcome"]


class CodedEnum(StrEnum):
    """Base of enumerations whose members equal their text and have a number, the `code`, in arrays of uint8.

    `Action("insert")` and `Action(0)` return the same member. A comparison with a number or an array is by code:
    `path.actions == Action.ROTATE` is an array of bool. The hash is that of the text: keys of a
    mapping are texts.
    """

    code: int
    """Number of the member in arrays."""

    # With None, NumPy leaves comparisons with an array or one of its elements to `__eq__` and `__ne__` of this class.
    __array_ufunc__ = None

    def __new__(cls, text: str | int, code: int = 0) -> Self:
        """Make a member from its text and its code. Once the class is made, either of them finds its member."""
        member = str.__new__(cls, text)
        member._value_, member.code = str(member), code
        return member

    @classmethod
    def _missing_(cls, value: object) -> Self | None:
        if isinstance(value, int | np.integer) and not isinstance(value, bool):
            return next((member for member in cls if member.code == value), None)
        return None

    def __eq__(self, other: object) -> Any:
        """Compare by text with a text, and by code with a number or an array."""
        return self._like(other) == other

    def __ne__(self, other: object) -> Any:
        """Compare by text with a text, and by code with a number or an array."""
        return self._like(other) != other

    def _like(self, other: object) -> str | int:
        """Return the code for a comparison with a number or an array of numbers, else the text."""
        if isinstance(other, int | np.integer) or (isinstance(other, np.ndarray) and other.dtype.kind in "iu"):
            return self.code
        return str.__str__(self)

    __hash__ = StrEnum.__hash__


class Action(CodedEnum):
    """Action of the policy. A member equals its text; its `code` is its number in arrays such as `table.policy`.

    Examples
    --------
    >>> import needleplan as npl
    >>> print(npl.Action(1))
    rotate, then insert
    >>> npl.Action("insert") == "insert", npl.Action.ROTATE.code
    (True, 1)
    """

    INSERT = "insert", 0
    ROTATE = "rotate, then insert", 1
    """Rotate by half a turn, then insert."""

    STRAIGHT = "insert straight", 2
    """Insert with duty-cycled rotation, nearly straight, and end with the same bevel; in scenarios that allow it."""


class Outcome(CodedEnum):
    """How an execution ended. A member equals its text; its `code` is its number in arrays.

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> table.path(table.best_entry()).outcome == "target"
    True
    >>> print(npl.Outcome.STEP_LIMIT, npl.Outcome.STEP_LIMIT.code)
    step limit 4
    """

    TARGET = "target", 1
    COLLISION = "collision", 2
    EXIT = "exit", 3
    STEP_LIMIT = "step limit", 4
