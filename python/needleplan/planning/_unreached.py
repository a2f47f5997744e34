"""Whether the entries of an anatomy hardly ever reach the target, and what ends their executions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy import FREE, OBSTACLE, OUTSIDE
from needleplan.artifacts import ShortRepr

if TYPE_CHECKING:
    from needleplan.planning._space import EntryMap

__all__ = ["Unreached", "impossible_message", "unreached"]

# Success below which an entry counts as hopeless: the upper end of its 95 % interval must be below.
_HOPELESS = 0.01
# Number of the best entries by the table that are estimated before all count as hopeless.
_TRIED = 20
# Number of executions with noise that show what ends them, from each of so many entries.
_RUNS, _SHOWN = 100, 4
# Success by the table below which executions show nothing: if all ways fail, the policy takes the shortest one.
_TRYING = 0.02


@dataclass(frozen=True)
class Unreached(ShortRepr):
    """No entry that was tried reaches the target in 1 % of executions.

    Parameters
    ----------
    highest : float
        Upper end of the 95 % interval of the success of the best entry.
    tried : int
        Number of entries whose success was estimated: the best ones by the table.
    ended : dict
        Share of the executions from the best of them that leave the cone ("cone"), meet an obstacle or its margin
        ("obstacle"), or leave the body or the volume ("outside"). Empty if the policy does not try to reach the target.
    reason : str
        What ends most of the executions, and which settings may help.
    """

    highest: float
    tried: int
    ended: dict[str, float]
    reason: str

    def __str__(self) -> str:
        entries = "the entry" if self.tried == 1 else f"the {self.tried} best entries by the table"
        return (
            f"not found with these settings: no entry reaches the target in more than {100 * self.highest:.1f} % of "
            f"executions, as far as {entries} show{'s' if self.tried == 1 else ''}: {self.reason}"
        )


def impossible_message(entries: EntryMap) -> str:
    """Return the message that no path exists, with the bounds of the proof: cone, radius of curvature and voxels."""
    scenario = entries.table.scenario
    return (
        "impossible: no path leads from the entry region to the target through the free voxels of the file, within "
        f"{scenario.file.lattice.cone_deg:g} degrees of the axis and with a radius of curvature of at least "
        f"{min(scenario.grid.radii_mm):g} mm, straight steps included; a wider cone, another entry region or a more "
        "curved needle may change that (lattice.cone_deg, anatomy.entry, needle.curvature_radius_mm)"
    )


def unreached(entries: EntryMap, numbers: Sequence[int] = ()) -> Unreached | None:
    """Return why the needle misses the target, or None if an entry may reach the target in at least 1 % of executions.

    Parameters
    ----------
    entries : EntryMap
        The entries.
    numbers : sequence of int, optional
        Indices of entries to try first; their success estimates are already computed.

    Returns
    -------
    Unreached or None
        None as soon as the 95 % interval of the success of an entry reaches 1 %.
    """
    by_table = entries.ranking.candidates
    best = [*by_table(_TRIED), *by_table(_TRIED, exact=True)] or [int(each) for each in entries.order[:_TRIED]]
    tried: dict[int, float] = {}
    for number in (*numbers, *best):
        if number not in tried:
            tried[number] = (entries.estimate(number).interval or (0.0, 1.0))[1]
        if tried[number] >= _HOPELESS:
            return None
    trying = [number for number in tried if entries.success[number] >= _TRYING]
    shown = sorted(trying, key=lambda number: -tried[number])[:_SHOWN]
    ended: dict[str, float] = {}
    if shown:
        runs = [entries.table.executions(entries.poses[number], _RUNS, seed=number).ends for number in shown]
        kinds = {"cone": FREE, "obstacle": OBSTACLE, "outside": OUTSIDE}
        ended = {name: float((np.concatenate(runs) == code).mean()) for name, code in kinds.items()}
    return Unreached(max(tried.values()), len(tried), ended, _reason(entries, ended))


def _reason(entries: EntryMap, ended: dict[str, float]) -> str:
    """Return a text with the most frequent end of the executions, and the settings that may help."""
    file = entries.table.scenario.file
    margin = f"{file.anatomy.largest_margin_mm:g} mm"
    if not ended:
        return (
            f"the cone of {file.lattice.cone_deg:g} degrees, the radius of curvature of "
            f"{file.needle.curvature_radius_mm:g} mm or the margin of {margin} leaves no way at "
            "this tip noise (lattice.cone_deg, needle.curvature_radius_mm, anatomy.margin_mm, needle.tip_noise_deg)"
        )
    most = max(ended, key=lambda name: ended[name])
    words = {
        "cone": f"leave the cone of {file.lattice.cone_deg:g} degrees, so that a wider one may help (lattice.cone_deg)",
        "obstacle": f"meet an obstacle or its margin of {margin}, so that a smaller margin, a "
        "smaller radius of curvature or another entry region may help (anatomy.margin_mm, needle.curvature_radius_mm, "
        "anatomy.entry)",
        "outside": f"pass the target, so that a smaller radius of curvature than {file.needle.curvature_radius_mm:g} "
        "mm, less tip noise or another entry region may help (needle.curvature_radius_mm, needle.tip_noise_deg, "
        "anatomy.entry)",
    }
    return f"{100 * ended[most]:.0f} % of executions {words[most]}"
