"""What `plan` and `entry` say about the lattice of an anatomy, what it changes of the file, and about breathing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import percent

if TYPE_CHECKING:
    from needleplan.anatomy import SpaceScenario
    from needleplan.planning import ResidualSuccess

__all__ = ["breath_lines", "lattice_record", "lattice_texts"]


def lattice_texts(scenario: SpaceScenario) -> dict[str, str]:
    """Return the printed lines about the lattice, by topic."""
    grid, chosen = scenario.grid, scenario.file.lattice.spacing_mm is None
    why = " (the finest of 1, 1.5 and 2 mm that states and memory permit)" if chosen else ""
    texts = {
        "lattice": f"spacing {grid.frame.spacing_mm:g} mm{why}, steps of {scenario.step_mm:g} mm, collisions in voxels "
        f"of {grid.voxel_mm:.2g} mm"
    }
    if grid.loss is not None:
        closed = grid.loss.closed_passage_mm
        widest = f"the widest passage closed has {closed:.1f} mm" if closed > 0 else "no passage is closed"
        texts["obstacles"] = (
            f"{100 * grid.loss.obstacle_share:.1f} % of their volume is free on the lattice; "
            f"{100 * grid.loss.free_share:.1f} % of the free volume is closed (margin, needle, voxels); {widest}"
        )
    return texts


def lattice_record(scenario: SpaceScenario) -> dict[str, Any]:
    """Return the JSON record of the lattice."""
    grid = scenario.grid
    return {
        "spacing_mm": grid.frame.spacing_mm,
        "spacing_chosen": scenario.file.lattice.spacing_mm is None,
        "step_mm": scenario.step_mm,
        "voxel_mm": grid.voxel_mm,
        "needle_thickness_mm": scenario.needle.thickness_mm,
        "loss": asdict(grid.loss) if grid.loss else None,
    }


def breath_lines(breaths: Sequence[ResidualSuccess], whose: str = "") -> Iterator[str]:
    """Yield the lines on the success of the ranked entries with a residual of breathing."""
    if not breaths:
        return
    title = f"  {whose}success if breathing moves the tissue by up to"
    yield f"{title}  " + "  ".join(f"{each.residual_mm:>4g} mm" for each in breaths)
    for number in range(len(breaths[0].entries)):
        yield f"  {number + 1:>4}{'':{len(title) - 6}}  " + "  ".join(
            f"{percent(each.entries[number].value):>7}" for each in breaths
        )
