"""The ranked entries that the 3D page shows: of one target, or of several targets of an anatomy.

Code that reproduces what the 3D page shows.

Surfaces of bodies on a grid, as triangles for the 3D view.

Surface nets: S. F. F. Gibson, Constrained elastic surface nets, MICCAI 1998. Every cell of eight grid points that
the surface crosses has one vertex, at the mean of the crossed edges' midpoints; every crossed edge has a square between
the four cells around it. The vertices are then smoothed, each within its cell.
"""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import obstacle_distances
from needleplan.errors import InputError, Mistake
from needleplan.planning import EntryMap, SpaceEntry, TargetEntry, TargetMap, entry_map, plan_space, rank_for_targets

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy import Anatomy, SpaceScenario
    from needleplan.page._requests import Request
    from needleplan.planning import SpaceTable

__all__ = ["SpaceCode", "SpaceMaps", "surface"]


# Number of times that every vertex moves to the mean of its neighbours. More make the surface smoother; two are enough
# for the eye, and vertices stay within their cells in any case.
_SMOOTHED = 2


def surface(body: NDArray[np.bool_], spacing_mm: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Return the surface of a body.

    Parameters
    ----------
    body : numpy.ndarray
        Which grid points belong to the body, shape (nx, ny, nz). The surface is closed at the border of the grid.
    spacing_mm : float
        Distance of grid points.

    Returns
    -------
    vertices : numpy.ndarray
        Positions in mm from grid point 0, shape (n, 3).
    triangles : numpy.ndarray
        Numbers of the vertices, counter-clockwise seen from outside, shape (m, 3).
    """
    inside = np.pad(body, 1)
    crossed, vertices = _vertices(inside)
    number = np.full(crossed.shape, -1, np.int64)
    number[crossed] = np.arange(len(vertices))
    squares = _squares(inside, number)
    vertices = _smooth(vertices, squares, np.argwhere(crossed))
    triangles = squares[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    # Index 1 of the padded grid is grid point 0.
    return ((vertices - 1) * spacing_mm).astype(np.float32), triangles.astype(np.uint32)


def _vertices(inside: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return which cells the surface crosses, and for each of them the mean of the midpoints of its crossed edges."""
    size = np.array(inside.shape) - 1

    def corner(at: tuple[int, ...]) -> NDArray[np.bool_]:
        return inside[tuple(slice(a, a + n) for a, n in zip(at, size, strict=True))]

    corners = list(itertools.product((0, 1), repeat=3))
    count = sum(corner(at).astype(np.uint8) for at in corners)
    crossed = np.asarray((count > 0) & (count < 8))
    total, crossings = np.zeros((int(crossed.sum()), 3)), np.zeros(int(crossed.sum()))
    for one, other in itertools.combinations(corners, 2):
        if sum(abs(a - b) for a, b in zip(one, other, strict=True)) == 1:
            differs = (corner(one) != corner(other))[crossed]
            total += np.outer(differs, (np.array(one) + other) / 2)
            crossings += differs
    return crossed, np.argwhere(crossed) + total / crossings[:, None]


def _squares(inside: NDArray[np.bool_], number: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the numbers of the vertices of every square, counter-clockwise seen from outside, shape (m, 4)."""
    found = []
    for axis in range(3):
        ahead, behind = (np.delete(inside, end, axis) for end in (0, -1))
        edges = np.argwhere(ahead != behind)
        one, other = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        around = [edges - a * one - b * other for a, b in ((1, 1), (0, 1), (0, 0), (1, 0))]
        square = np.stack([number[tuple(cells.T)] for cells in around], -1)
        inward = ahead[tuple(edges.T)]  # the body lies ahead, so outside is behind
        square[inward] = square[inward][:, ::-1]
        found.append(square)
    return np.concatenate(found)


def _smooth(vertices: NDArray[np.float64], squares: NDArray[np.int64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
    ends = np.concatenate([squares[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 3), (3, 0))])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    neighbours = np.bincount(ends.ravel(), minlength=len(vertices))
    for _ in range(_SMOOTHED):
        total = np.zeros_like(vertices)
        for axis in range(3):
            for here, there in (ends.T, ends.T[::-1]):
                total[:, axis] += np.bincount(here, vertices[there, axis], len(vertices))
        vertices = np.clip(total / np.maximum(neighbours, 1)[:, None], cells, cells + 1)
    return vertices


@dataclass(frozen=True)
class SpaceCode:
    """Where a 3D plan comes from, and how to compute it again.

    Attributes
    ----------
    source
        The policy table (.h5) or the anatomy (.toml); empty if the plan is from no file.
    is_table
        Whether it is a policy table.
    several
        Whether it is an anatomy with several targets.
    recording
        The recording of an insertion by this plan; empty without one.
    """

    source: str
    is_table: bool
    several: bool = False
    recording: str = ""

    def python(self, number: int) -> str:
        """Return Python that prints the numbers of an entry or replays the insertion; an empty text without a file."""
        if not self.source:
            return ""
        read = f"SpaceTable.read({self.source!r})" if self.is_table else (
            f"plan_space(SpaceScenario.of(Anatomy.read({self.source!r})))"
        )  # fmt: skip
        imports = [] if self.is_table else ["from needleplan.anatomy import Anatomy, SpaceScenario"]
        names = ["SpaceTable"] if self.is_table else ["plan_space"]
        if self.recording:
            lines = [
                *imports,
                "from needleplan.control import replay",
                f"from needleplan.planning import {names[0]}",
                "from needleplan.recording import Recording",
                "",
                f"table = {read}",
                f"report = replay(Recording.read({self.recording!r}), table).report",
                "print(report.outcome, round(report.error_in_space_mm, 2), report.turns)",
            ]
        elif self.several:
            lines = [
                "from needleplan.anatomy import Anatomy",
                "from needleplan.planning import rank_for_targets",
                "",
                f"entries = rank_for_targets(Anatomy.read({self.source!r}))",
                f"entry = entries.entry({number})",
                "print(entry.expected_number, entry.position_mm, list(entry.targets))",
            ]
        else:
            lines = [
                *imports,
                f"from needleplan.planning import {', '.join(sorted(['entry_map', *names]))}",
                "",
                f"entries = entry_map({read})",
                f"entry = entries.entry({number})",
                'print(f"success {entry.success}")',
                "print(entry.position_mm, entry.direction)",
            ]
        return "\n".join([*lines, ""])

    def command(self) -> str:
        """Return commands that rank the entries or replay the insertion; an empty text without a file."""
        if not self.source:
            return ""
        file = shlex.quote(self.source)
        if self.recording:
            lines = [] if self.is_table else [f"needleplan plan {file} -o table.h5"]
            table = file if self.is_table else "table.h5"
            lines.append(f"needleplan recording replay {shlex.quote(self.recording)} --table {table}")
        elif self.is_table:
            lines = [f"needleplan view {file}"]
        else:
            lines = [f"needleplan entry {file}"]
        return "\n".join([*lines, ""])


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
