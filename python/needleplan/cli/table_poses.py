"""Starts and poses of a table for commands: in the plane as they are, in 3D in RAS."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.cli.options import pose_record, split_numbers, start_pose
from needleplan.errors import InputError, Mistake, PoseError
from needleplan.planning import Path, PolicyTable, Pose, SpacePose, SpaceTable, Table, what_helps

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["TablePoses", "poses_of"]


class TablePoses(ABC):
    """How commands read and write the poses of a table."""

    def __init__(self, table: Table) -> None:
        self.table: Any = table

    def start(self, text: str | None) -> Any:
        """Return the start of `--start`, checked; without it, the best entry. Raises PoseError."""
        return self.table.best_entry().pose if text is None else self._start(text)

    @abstractmethod
    def _start(self, text: str) -> Any: ...

    @property
    @abstractmethod
    def better_prediction(self) -> str:
        """What brings predictions by the table closer to executions."""

    @abstractmethod
    def nearest_choice(self, nearest: bool) -> dict[str, Any]:
        """Return `--nearest` as arguments of the table's methods. Raises InputError in 3D."""

    @abstractmethod
    def pose(self, row: list[float]) -> Any:
        """Return the pose of a row of a path's poses."""

    @abstractmethod
    def text(self, pose: Any) -> str:
        """Return a pose as a text."""

    @abstractmethod
    def place_text(self, pose: Any) -> str:
        """Return the position of a pose as a text, in mm."""

    @abstractmethod
    def steps_text(self, path: Any) -> str:
        """Return the number of steps of a path as a text; a path in 3D has points instead of steps."""

    @abstractmethod
    def record(self, pose: Any) -> dict[str, Any]:
        """Return the JSON record of a pose."""

    @abstractmethod
    def rows(self, poses: NDArray[np.float64]) -> list[list[float]]:
        """Return the rows of the poses of a path for JSON."""


class _PlanePoses(TablePoses):
    @property
    def better_prediction(self) -> str:
        return what_helps(self.table.scenario)

    def _start(self, text: str) -> Any:
        return self.table.start(start_pose(text))

    def nearest_choice(self, nearest: bool) -> dict[str, Any]:
        return {"nearest": nearest}

    def pose(self, row: list[float]) -> Pose:
        return Pose.wound(row)

    def text(self, pose: Pose) -> str:
        return str(pose)

    def place_text(self, pose: Pose) -> str:
        return f"({pose.x_mm:.1f}, {pose.y_mm:.1f})"

    def steps_text(self, path: Path) -> str:
        return f" in {len(path.actions)} steps"

    def record(self, pose: Pose) -> dict[str, Any]:
        return pose_record(pose)

    def rows(self, poses: NDArray[np.float64]) -> list[list[float]]:
        rows: list[list[float]] = poses.tolist()
        return rows


class _SpacePoses(TablePoses):
    @property
    def better_prediction(self) -> str:
        return "`needleplan entry` estimates the success of entries by executions"

    @property
    def _frame(self) -> Any:
        return self.table.scenario.grid.frame

    def _start(self, text: str) -> SpacePose:
        numbers = np.array(split_numbers(text))
        if numbers.shape != (6,) or not numbers[3:].any():
            raise PoseError(Mistake("--start", text, "must be R,A,S,DR,DA,DS: position in RAS mm, and direction"))
        direction = numbers[3:] / abs(numbers[3:]).max()  # the norm of very large or small numbers is not finite or 0
        tangent = self._frame.axes @ (direction / np.linalg.norm(direction))
        pose = SpacePose(*self._frame.local(numbers[:3]).tolist(), *tangent.tolist())
        if not self.table.contains(pose):
            cone = self.table.scenario.file.lattice.cone_deg
            rule = f"must lie in the lattice, with a direction at most {cone:g} deg from its axis"
            raise PoseError(Mistake("--start", text, rule))
        return pose

    def nearest_choice(self, nearest: bool) -> dict[str, Any]:
        if nearest:
            raise InputError(Mistake("--nearest", "", "needs a table in the plane, and this is one in 3D"))
        return {}

    def pose(self, row: list[float]) -> SpacePose:
        return SpacePose(*row)

    def text(self, pose: SpacePose) -> str:
        r, a, s, *direction = self.rows(np.array(pose))
        along = ", ".join(f"{x:.3f}" for x in direction)
        return f"R {r:.1f}, A {a:.1f}, S {s:.1f} mm, direction {along}"

    def place_text(self, pose: SpacePose) -> str:
        r, a, s = self._frame.world(pose.position_mm).tolist()
        return f"({r:.1f}, {a:.1f}, {s:.1f})"

    def steps_text(self, path: Any) -> str:  # noqa: ARG002
        return ""

    def record(self, pose: SpacePose) -> dict[str, Any]:
        row = self.rows(np.array(pose))
        return {"position_mm": row[:3], "direction": row[3:]}

    def rows(self, poses: NDArray[np.float64]) -> Any:
        frame = self._frame
        return np.concatenate([frame.world(poses[..., :3]), poses[..., 3:] @ frame.axes], -1).tolist()


@singledispatch
def poses_of(table: Table) -> TablePoses:
    """Return how commands read and write the poses of a table."""
    raise NotImplementedError(type(table))


poses_of.register(PolicyTable, _PlanePoses)
poses_of.register(SpaceTable, _SpacePoses)
