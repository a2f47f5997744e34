"""Entry maps for other programs: markups of 3D Slicer, and the success as a volume."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import image_bytes
from needleplan.planning._vtp import vtp_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.planning._space import EntryMap
    from needleplan.planning._success import Success
    from needleplan.planning._targets import TargetEntry, TargetMap

__all__ = ["entries_vtp", "markups_text", "success_bytes", "targets_markups_text"]

_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
# Description in the file of a success field, at most 80 bytes.
_FIELD = "success by the table; at entries by executions where known and 3 points off"
# Number of pieces of a path between two control points of a curve.
_EVERY = 4
_OF_LINES = ("rank", "execution", "reached", "success", "success_low", "success_high", "success_runs")


def markups_text(entries: EntryMap, numbers: Sequence[int]) -> str:
    """Return markups of 3D Slicer, in RAS mm: the chosen entries, and for each a curve, its path without noise.

    Parameters
    ----------
    entries : EntryMap
        Map of the entries.
    numbers : sequence of int
        Numbers of the chosen entries, best first.

    Returns
    -------
    str
        JSON.
    """
    places = entries.grid.frame.world(entries.poses[list(numbers), :3])
    successes = [entries.estimate(each) for each in numbers]
    labels = [f"entry {rank}: {success.shown} %" for rank, success in enumerate(successes, start=1)]
    markups = [_markup("Fiducial", "entries", places, labels, [f"success {success}" for success in successes])]
    for rank, number in enumerate(numbers, start=1):
        markups.append(_curve(f"path {rank}", entries.path_mm(number)))
    return json.dumps({"@schema": _SCHEMA, "markups": markups}, indent=1) + "\n"


def targets_markups_text(targets: TargetMap, ranked: Sequence[TargetEntry]) -> str:
    """Return markups of 3D Slicer, in RAS mm: ranked entries for several targets, and a curve for each insertion.

    Parameters
    ----------
    targets : TargetMap
        Map of the entries.
    ranked : sequence of TargetEntry
        The chosen entries, best first.

    Returns
    -------
    str
        JSON.
    """
    count = len(targets.names)
    labels = [f"entry {rank}: {entry.expected_number:.2f} of {count}" for rank, entry in enumerate(ranked, start=1)]
    words = [", ".join(f"{name} {one.success.shown} %" for name, one in entry.targets.items()) for entry in ranked]
    places = np.array([entry.position_mm for entry in ranked], float).reshape(-1, 3)
    markups = [_markup("Fiducial", "entries", places, labels, words)]
    for rank, entry in enumerate(ranked, start=1):
        for number, name in enumerate(entry.targets, start=1):
            curve = f"path {rank}.{number} {name}"
            markups.append(_curve(curve, targets.maps[name].path_mm(entry.number)))
    return json.dumps({"@schema": _SCHEMA, "markups": markups}, indent=1) + "\n"


def success_bytes(entries: EntryMap) -> bytes:
    """Return `EntryMap.success_field` as a compressed NIfTI file, in RAS mm, with a description."""
    frame = entries.grid.frame
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = frame.axes.T * frame.spacing_mm, frame.origin_mm
    return image_bytes(entries.success_field(), affine, _FIELD)


def entries_vtp(entries: EntryMap, numbers: Sequence[int], runs: int = 40, seed: int = 0) -> bytes:
    """Return the entry map as a VTP file in RAS mm.

    Points are the entry points, with `success` (`EntryMap.exported_success`), `success_by_the_table`, `clearance_mm`,
    `length_mm` and `turns`. Lines are the
    paths of the chosen entries without noise (`rank` 1, 2 ...; `execution` 0), and executions with noise from the first
    one (`rank` 1; `execution` 1, 2 ...). Their `success`, with `success_low`, `success_high` and `success_runs`, is the
    success of their entry by executions. `reached` is 1 for lines that end in the target, else 0.

    Parameters
    ----------
    entries : EntryMap
        Map of the entries.
    numbers : sequence of int
        Numbers of the chosen entries, best first.
    runs : int, default 40
        Number of executions with noise.
    seed : int, default 0
        Seed of the noise.

    Returns
    -------
    bytes
    """
    world, chosen = entries.grid.frame.world, list(numbers)
    lines = [entries.path_mm(number) for number in chosen]
    success = [_numbers(entries.estimate(number)) for number in chosen]
    rows = [(rank, 0, entries.paths.reached[number], *success[rank - 1]) for rank, number in enumerate(chosen, start=1)]
    if chosen:
        executions = entries.table.executions(entries.poses[chosen[0]], runs, seed)
        lines += [world(executions.points(run)) for run in range(runs)]
        rows += [(1, run + 1, executions.reached[run], *success[0]) for run in range(runs)]
    columns = np.array(rows, float).reshape(-1, len(_OF_LINES)).T
    of_lines = dict(zip(_OF_LINES, columns, strict=True))
    paths = entries.paths
    of_points = {
        "success": entries.exported_success(), "success_by_the_table": entries.success,
        "clearance_mm": paths.clearance_mm, "length_mm": paths.length_mm, "turns": paths.turns,
    }  # fmt: skip
    return vtp_bytes(lines, world(entries.poses[:, :3]), of_lines, of_points)


def _numbers(success: Success) -> tuple[float, float, float, int]:
    """Return the fields of a line on the success of its entry."""
    low, high = success.interval or (0.0, 1.0)
    return success.value, low, high, success.runs


def _curve(name: str, path_mm: NDArray[np.float64]) -> dict[str, Any]:
    points = np.concatenate([path_mm[:-1:_EVERY], path_mm[-1:]])
    return _markup("Curve", name, points, [f"{number}" for number in range(1, len(points) + 1)])


def _markup(
    kind: str, name: str, points_mm: NDArray[np.float64], labels: Sequence[str], words: Sequence[str] = ()
) -> dict[str, Any]:
    return {
        "type": kind,
        "name": name,
        "coordinateSystem": "RAS",
        "coordinateUnits": "mm",
        "controlPoints": [
            {
                "id": f"{number}",
                "label": label,
                "position": point,
                "positionStatus": "defined",
                **({"description": words[number - 1]} if words else {}),
            }
            for number, (point, label) in enumerate(zip(points_mm.tolist(), labels, strict=True), start=1)
        ],
    }
