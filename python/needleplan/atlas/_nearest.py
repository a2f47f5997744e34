"""The table of an atlas for the curvature nearest to an identified one, as a start until a new plan is ready."""

from __future__ import annotations

import math

from needleplan.atlas._atlas import Atlas, AtlasEntry
from needleplan.config import raw_of
from needleplan.scenario import Scenario

__all__ = ["CurvatureLookup"]

# Relative difference up to which two ratios of radii are equal.
_SAME_RATIO = 1e-6


class CurvatureLookup:
    """Finds the table of an atlas that differs from a scenario in nothing but the curvature, and there the least.

    In scenarios with layers or tissues, all radii must differ by one factor. Title and solver do not matter. Tables in
    space are left out.

    Parameters
    ----------
    atlas : Atlas
        The atlas; its scenarios are made now, which takes 0.5 ms each.

    Raises
    ------
    ScenarioError
        If the scenario of the atlas cannot be read any more.
    """

    def __init__(self, atlas: Atlas) -> None:
        pairs = zip(atlas.scenarios(), atlas, strict=True)
        self._known = [(made, entry) for made, entry in pairs if isinstance(made, Scenario) and entry.record]

    def nearest(self, wanted: Scenario) -> AtlasEntry | None:
        """Return the entry with the curvature nearest to the wanted one, or None if no table fits."""
        fitting = [(made, entry) for made, entry in self._known if _same_but_curvature(made, wanted)]
        return min(fitting, key=lambda pair: _curvature_gap(pair[0], wanted))[1] if fitting else None

    def __len__(self) -> int:
        return len(self._known)


def _curvature_gap(one: Scenario, other: Scenario) -> float:
    return abs(1 / one.needle.curvature_radius_mm - 1 / other.needle.curvature_radius_mm)


def _same_but_curvature(one: Scenario, other: Scenario) -> bool:
    parts = ("workspace", "obstacles", "target", "motion", "grid", "objective")
    if any(getattr(one, name) != getattr(other, name) for name in parts):
        return False
    if _places(one) != _places(other):
        return False
    factor = one.needle.curvature_radius_mm / other.needle.curvature_radius_mm
    pairs = zip(_radii(one), _radii(other), strict=True)
    return all(math.isclose(a, factor * b, rel_tol=_SAME_RATIO) for a, b in pairs)


def _radii(scenario: Scenario) -> list[float]:
    layers = [each.curvature_radius_mm for each in scenario.needle.layers]
    return layers + [each.curvature_radius_mm for each in scenario.tissues]


def _places(scenario: Scenario) -> list[object]:
    """Return where layers and tissues are, without their radii of curvature."""
    layers: list[object] = [each.from_mm for each in scenario.needle.layers]
    return layers + [raw_of(each) | {"curvature_radius_mm": None} for each in scenario.tissues]
