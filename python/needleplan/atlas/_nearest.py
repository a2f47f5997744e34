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
    """Finds the tables of an atlas that differ from a scenario in nothing but the curvature, and there the least.

    In scenarios with layers or tissues, all radii must differ by one factor. Title and solver do not matter. Tables in
    space are left out.

    Parameters
    ----------
    atlas : Atlas
        The atlas; its scenarios are made now, which takes 0.5 ms each.
    like : Scenario, optional
        Only tables that differ from this scenario in nothing but the curvature are kept, which makes every look-up in
        a large atlas short. Default: all are.

    Raises
    ------
    ScenarioError
        If the scenario of the atlas cannot be read any more.
    """

    def __init__(self, atlas: Atlas, like: Scenario | None = None) -> None:
        pairs = zip(atlas.scenarios(), atlas, strict=True)
        known = [(made, entry) for made, entry in pairs if isinstance(made, Scenario) and entry.record]
        self._known = known if like is None else [pair for pair in known if _same_but_curvature(pair[0], like)]

    def nearest(self, wanted: Scenario, nearer_than: Scenario | None = None) -> AtlasEntry | None:
        """Return the entry with the curvature nearest to the wanted one, or None if no table fits.

        With `nearer_than`, None also if the curvature of that scenario is as near.
        """
        fitting = self._nearest_first(wanted)
        if not fitting:
            return None
        made, entry = fitting[0]
        near = nearer_than is None or _gap_per_mm(made, wanted) < _gap_per_mm(nearer_than, wanted)
        return entry if near else None

    def nearest_first(self, wanted: Scenario) -> list[AtlasEntry]:
        """Return the entries of all tables that fit, the nearest in curvature first."""
        return [entry for _, entry in self._nearest_first(wanted)]

    def _nearest_first(self, wanted: Scenario) -> list[tuple[Scenario, AtlasEntry]]:
        fitting = [pair for pair in self._known if _same_but_curvature(pair[0], wanted)]
        return sorted(fitting, key=lambda pair: _gap_per_mm(pair[0], wanted))

    def __len__(self) -> int:
        return len(self._known)


def _gap_per_mm(one: Scenario, other: Scenario) -> float:
    """Return the difference between the curvatures of two scenarios' needles (1/mm)."""
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
