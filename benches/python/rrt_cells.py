"""Grids of cells of poses, and the cells that one step of a needle may lead to, for `rrt_reach.py`.

A cell is a square of `cell_mm` times a heading interval of 2 pi / `headings`, both closed. The set of cells of one
heading is a Python integer: cell (i, j) is bit i * stride + j. A displacement is a shift of the bits. The bits
between two rows receive what leaves the workspace along y.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from rrt_scenes import GOAL_TOLERANCE_MM, RADIUS_MM, SIDE_MM, Scene

# Cells of every heading.
Cells = list[int]
# Coarsest grid; its headings and the turn of a step fix the length of a step on all grids.
COARSEST_CELL_MM = 1.0
COARSEST_HEADINGS = 144
COARSEST_TURN = 2
# Pieces of a step over which the bounds of the heading are integrated.
_PIECES = 64
# Pieces of a last step that may touch the target.
_LAST_PIECES = 8
# Widening of all rectangles (mm), far above rounding errors.
_ROUNDING_MM = 1e-6


@dataclass(frozen=True)
class Grid:
    """A grid of cells; each level is twice as fine as the one before in all three directions."""

    level: int

    @property
    def cell_mm(self) -> float:
        """Side of a cell."""
        return COARSEST_CELL_MM / 2**self.level

    @property
    def headings(self) -> int:
        """Number of heading intervals."""
        return COARSEST_HEADINGS * 2**self.level

    @property
    def turn(self) -> int:
        """Largest change of the heading in one step, in heading intervals."""
        return COARSEST_TURN * 2**self.level

    @property
    def side(self) -> int:
        """Number of cells along x and along y."""
        return round(SIDE_MM / self.cell_mm)

    @property
    def angle(self) -> float:
        """Width of a heading interval in rad."""
        return 2 * np.pi / self.headings

    @property
    def step_mm(self) -> float:
        """Length of a step, the same on every grid."""
        return self.turn * self.angle * RADIUS_MM

    @property
    def stride(self) -> int:
        """Bits from one row to the next, a multiple of 8: no step leads from one row into another one."""
        return 8 * -(-(self.side + int(self.step_mm / self.cell_mm) + 3) // 8)

    @cached_property
    def shifts(self) -> list[list[list[int]]]:
        """For every heading and change of the heading (from -turn to turn): shifts to cells that a step may lead to."""
        changes = range(-self.turn, self.turn + 1)
        return [
            [[a * self.stride + b for a, b in self._met(k, j).tolist()] for j in changes] for k in range(self.headings)
        ]

    def _met(self, k: int, j: int) -> NDArray[np.int64]:
        """Return the displacements in cells of steps from heading interval k to k + j.

        The heading at a distance s is within s / R of the first interval, and within (step - s) / R of the last one.
        """
        middle = (k + j / 2 + 0.5) * self.angle
        edges = np.linspace(0, self.step_mm, _PIECES + 1)
        first, last = edges / RADIUS_MM, edges[::-1] / RADIUS_MM
        low = np.maximum(k * self.angle - first, (k + j) * self.angle - last) - middle
        high = np.minimum((k + 1) * self.angle + first, (k + j + 1) * self.angle + last) - middle
        # Between two edges a bound exceeds its values at the edges by at most the turn over half a piece.
        piece = self.step_mm / _PIECES
        slack = piece / RADIUS_MM / 2
        low = np.minimum(low[:-1], low[1:]) - slack
        high = np.maximum(high[:-1], high[1:]) + slack
        least = np.where((low <= 0) & (high >= 0), 0.0, np.minimum(abs(low), abs(high)))
        most = np.maximum(abs(low), abs(high))
        widening = np.array([-_ROUNDING_MM, _ROUNDING_MM])
        forward = np.array([np.cos(most).sum(), np.cos(least).sum()]) * piece + widening
        lateral = np.array([np.sin(low).sum(), np.sin(high).sum()]) * piece + widening
        return self._cells_met(middle, forward, lateral)

    def _cells_met(
        self, heading: float, forward: NDArray[np.float64], lateral: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Return the displacements in cells whose square, two cells wide, meets a rectangle along a heading.

        The places of two cells at a displacement d differ by the vectors of such a square around d. The square and the
        rectangle meet if their projections on both axes and on both sides of the rectangle meet.
        """
        along = np.array([np.cos(heading), np.sin(heading)])
        across = np.array([-along[1], along[0]])
        corners = np.array([f * along + s * across for f in forward for s in lateral]) / self.cell_mm
        low, high = np.ceil(corners.min(axis=0) - 1).astype(int), np.floor(corners.max(axis=0) + 1).astype(int)
        candidates = np.stack(np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1], axis=-1).reshape(-1, 2)
        reach = self.cell_mm * np.abs(along).sum()
        f, s = candidates @ along * self.cell_mm, candidates @ across * self.cell_mm
        met = (f >= forward[0] - reach) & (f <= forward[1] + reach)
        met &= (s >= lateral[0] - reach) & (s <= lateral[1] + reach)
        return candidates[met]

    def free(self, scene: Scene) -> int:
        """Return the cells of one heading that are not inside an obstacle."""
        low = np.arange(self.side) * self.cell_mm
        x, y = np.meshgrid(low, low, indexing="ij")
        boxes = shapely.box(x, y, x + self.cell_mm, y + self.cell_mm)
        shapely.prepare(scene.blocked)
        return self.packed(~np.asarray(shapely.covers(scene.blocked, boxes)))

    def before_target(self, scene: Scene) -> Cells:
        """Return the cells from which a path of up to one step may touch the target."""
        center = (np.arange(self.side) + 0.5) * self.cell_mm
        dx, dy = np.meshgrid(scene.target[0] - center, scene.target[1] - center, indexing="ij")
        reach = GOAL_TOLERANCE_MM + self.cell_mm * np.sqrt(0.5) + _ROUNDING_MM
        box = np.hypot(dx, dy) <= reach + self.step_mm
        dx, dy = dx[box], dy[box]
        result = []
        for k in range(self.headings):
            heading = (k + 0.5) * self.angle
            f, s = dx * np.cos(heading) + dy * np.sin(heading), np.abs(dy * np.cos(heading) - dx * np.sin(heading))
            met = np.zeros(len(dx), dtype=bool)
            for low, high in pairwise(np.linspace(0, self.step_mm, _LAST_PIECES + 1)):
                off = self.angle / 2 + high / RADIUS_MM
                beyond = np.maximum(np.maximum(low * np.cos(off) - f, f - high), 0)
                met |= np.hypot(beyond, np.maximum(s - high * np.sin(off), 0)) <= reach
            cells = np.zeros(box.shape, dtype=bool)
            cells[box] = met
            result.append(self.packed(cells))
        return result

    def containing(self, pose: tuple[float, float, float]) -> Cells:
        """Return the cells that contain a pose, or are within 1e-9 of a cell of it."""
        result = [0] * self.headings
        for k in _touching(np.mod(pose[2], 2 * np.pi) / self.angle):
            for i in _touching(pose[0] / self.cell_mm):
                for j in _touching(pose[1] / self.cell_mm):
                    if 0 <= i < self.side and 0 <= j < self.side:
                        result[k % self.headings] |= 1 << (i * self.stride + j)
        return result

    def packed(self, cells: NDArray[np.bool_]) -> int:
        """Return an array of cells, [side, side], as an integer."""
        rows = np.zeros((self.side, self.stride), dtype=bool)
        rows[:, : self.side] = cells
        return int.from_bytes(np.packbits(rows, bitorder="little").tobytes(), "little")

    def unpacked(self, bits: int) -> NDArray[np.bool_]:
        """Return cells as an array, [side, side]."""
        size = self.side * self.stride
        flat = np.frombuffer(bits.to_bytes(size // 8, "little"), dtype=np.uint8)
        return np.unpackbits(flat, bitorder="little").reshape(self.side, self.stride)[:, : self.side].astype(bool)

    def refined(self, cells: Cells) -> Cells:
        """Return the cells of the next finer grid that lie in these cells."""
        finer = grid(self.level + 1)
        halves = [
            finer.packed(self.unpacked(each).repeat(2, axis=0).repeat(2, axis=1)) if each else 0 for each in cells
        ]
        return [half for half in halves for _ in range(2)]


@cache
def grid(level: int) -> Grid:
    """Return the grid of a level; its shifts are computed once."""
    return Grid(level)


def _touching(value: float) -> range:
    return range(int(np.floor(value - 1e-9)), int(np.floor(value + 1e-9)) + 1)
