"""Prove that no path of a needle leads to a target, by an over-approximation of the poses that it can reach.

The path of the tip satisfies x' = cos t, y' = sin t, where the curvature t' is -1/R or +1/R. The needle may turn at
any place. The proof allows every curvature from -1/R to 1/R. A target that cannot be reached then cannot be reached
by the needle.

A path is looked at after every step of a fixed length. A step leads from one cell (rrt_cells.py) to every cell that
the end of any path from the first cell may be in. Cells inside obstacles and places outside of the workspace are left
out. Obstacles between the ends of a step are ignored, which allows more paths, never fewer.

A grid keeps only the cells that can be reached from the start and from which the target can be reached. The next grid
is twice as fine and takes only cells that were kept. All grids have the same step, so a path that visits cells of a
fine grid visits those cells of the coarse grid that contain them. If no cell is left, no path exists. If cells are
left on the finest grid, the question is open.
"""

from typing import Any

from rrt_cells import Cells, Grid, grid
from rrt_scenes import Scene

# Number of grids: the finest cell is 0.125 mm wide.
GRIDS = 4


def proof(scene: Scene, grids: int = GRIDS) -> dict[str, Any]:
    """Return whether the target is proven to be out of reach, with the cells left on every grid.

    The keys are `infeasible` (bool) and `levels`. A level holds `cell_mm`, `headings`, the number of cells `reached`
    from the start, and the number of cells `left` that also lead to the target.
    """
    levels: list[dict[str, Any]] = []
    kept: Cells = []
    while len(levels) < grids and (not levels or levels[-1]["left"]):
        at = grid(len(levels))
        free = at.free(scene)
        alive = [each & free for each in grid(at.level - 1).refined(kept)] if levels else [free] * at.headings
        reached = spread(at, at.containing(scene.start), alive)
        last = at.before_target(scene)
        kept = spread(at, [a & b for a, b in zip(reached, last, strict=True)], reached, backward=True)
        counts = {"reached": count(reached), "left": count(kept)}
        levels.append({"cell_mm": at.cell_mm, "headings": at.headings, **counts})
    return {"infeasible": levels[-1]["left"] == 0, "levels": levels}


def count(cells: Cells) -> int:
    """Return the number of cells."""
    return sum(each.bit_count() for each in cells)


def spread(at: Grid, seeds: Cells, alive: Cells, backward: bool = False) -> Cells:
    """Return the cells of `alive` that paths reach from `seeds` or, with `backward`, from which they reach `seeds`."""
    reached = [seed & each for seed, each in zip(seeds, alive, strict=True)]
    front = {k: cells for k, cells in enumerate(reached) if cells}
    way = -1 if backward else 1
    while front:
        found = dict.fromkeys(range(at.headings), 0)
        for k, cells in front.items():
            # Low zeros are left out while the cells are shifted: the front is small beside the workspace.
            base = (cells & -cells).bit_length() - 1
            part = cells >> base
            for j in range(-at.turn, at.turn + 1):
                other = (k + way * j) % at.headings
                shifts = [way * each for each in at.shifts[other if backward else k][j + at.turn]]
                low = min(shifts)
                local = 0
                for shift in shifts:
                    local |= part << (shift - low)
                base_of_local = base + low
                found[other] |= local << base_of_local if base_of_local >= 0 else local >> -base_of_local
        front = {}
        for k, cells in found.items():
            if new := cells & alive[k] & ~reached[k]:
                reached[k] |= new
                front[k] = new
    return reached
