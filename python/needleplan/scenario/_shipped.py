"""Names of the shipped scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, TypeAlias

from needleplan.config import shipped_names

__all__ = ["FOLDER", "ShippedScenario", "shipped"]

FOLDER = Path(__file__).parent.parent / "scenarios"

ShippedScenario: TypeAlias = Literal[
    "brain", "four_obstacles", "four_obstacles_thesis", "layered", "narrow_passage", "phantom", "prostate",
    "unreachable",
]  # fmt: skip
"""Names that `shipped` returns, which an editor completes."""


def shipped() -> list[str]:
    """Return the names of the scenarios that come with the package.

    Returns
    -------
    list of str
        Names in alphabetical order. `Scenario.read` accepts a name in place of a path.

    Examples
    --------
    >>> from needleplan.scenario import shipped
    >>> "four_obstacles" in shipped()
    True
    """
    return shipped_names(FOLDER)
