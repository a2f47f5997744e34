"""The ranked entries that the 3D page shows: of one target, or of several targets of an anatomy."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

from needleplan.anatomy import obstacle_distances
from needleplan.errors import InputError, Mistake
from needleplan.planning import EntryMap, SpaceEntry, TargetEntry, TargetMap, entry_map, plan_space, rank_for_targets

if TYPE_CHECKING:
    from needleplan.anatomy import Anatomy, SpaceScenario
    from needleplan.page._requests import Request
    from needleplan.planning import SpaceTable

__all__ = ["SpaceMaps"]

# Number of ranked entries, as `needleplan entry` lists them.
_TOP = 5


class SpaceMaps:
    """Entry maps by the name of the target. Making one solves the plan of each target.

    Parameters
    ----------
    scenario : SpaceScenario
        What is planned for if there is one target.
    anatomy : Anatomy, optional
        The anatomy, whose targets are taken. Default: the one target of the scenario.
    table : SpaceTable, optional
        The table of the scenario. Default: it is planned.
    """

    def __init__(self, scenario: SpaceScenario, anatomy: Anatomy | None, table: SpaceTable | None) -> None:
        self._anatomy = anatomy
        self._several: TargetMap | None = None
        if table is None and anatomy is not None and anatomy.file.anatomy.targets:
            self._several = rank_for_targets(anatomy)
            self._maps: Mapping[str, EntryMap] = self._several.maps
        else:
            self._maps = {"": entry_map(table or plan_space(scenario))}
        self._ranked: dict[int, TargetEntry] = {}

    @property
    def targets(self) -> list[str]:
        """Names of the targets in the order of the anatomy file; empty if there is one."""
        return list(self._several.names) if self._several else []

    def of(self, request: Request) -> EntryMap:
        """Return the map of the target that a request names, by default of the first. Raises InputError."""
        first = next(iter(self._maps))
        name = request.get("target") or first
        if name not in self._maps:
            rule = f"must be one of {', '.join(self.targets)}" if self._several else "is for several targets"
            raise InputError(Mistake("target", f"{name}", rule))
        return self._maps[name]

    @cached_property
    def listed(self) -> list[int]:
        """Numbers of the ranked entries: of several targets by the expected number reached."""
        if self._several is None:
            return self._maps[""].best(_TOP)
        entries = self._several.best(_TOP)
        self._ranked |= {entry.number: entry for entry in entries}
        return [entry.number for entry in entries]

    def entry(self, number: int, request: Request, runs: int | None = None) -> SpaceEntry:
        """Return an entry for the target of a request; `runs` 0 computes no executions."""
        ranked = self._ranked.get(number)
        if self._several and ranked is None and runs != 0:
            ranked = self._ranked[number] = self._several.entry(number)
        if ranked is not None:
            return ranked.targets[request.get("target") or self.targets[0]]
        return self.of(request).entry(number, runs)

    def of_targets(self, number: int) -> dict[str, Any]:
        """Return what an entry is worth for several targets, in the order of the insertions; {} if it is not known."""
        ranked = self._ranked.get(number)
        if ranked is None:
            return {}
        order = [{"name": name, "success": entry.success.value} for name, entry in ranked.targets.items()]
        return {"expected_number": ranked.expected_number, "score": ranked.score, "order": order}

    def risk(self, number: int, request: Request) -> dict[str, Any] | None:
        """Return name and distance (mm) of the obstacle nearest to the path from an entry; None if all are far.

        The distance is the clearance of the path. A table has no names of labels: the name is then "an obstacle".
        """
        entries = self.of(request)
        distance_mm = float(entries.paths.clearance_mm[number])
        if distance_mm >= float(entries.grid.clearance_mm.max()):
            return None
        names = {} if self._anatomy is None else obstacle_distances(self._anatomy, entries.path_mm(number))
        return {"name": next(iter(names), "an obstacle"), "distance_mm": distance_mm}
