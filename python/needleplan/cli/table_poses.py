"""Starts and poses of a table, in the plane or in 3D, for commands; those of 3D are in RAS."""

from __future__ import annotations

from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.cli.options import pose_record, split_numbers, start_pose
from needleplan.errors import InputError, Mistake, PoseError
from needleplan.planning import Path, PolicyTable, Pose, SpacePose, SpaceTable, Table, what_helps

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "better_prediction",
    "nearest_choice",
    "place_text",
    "pose_from",
    "pose_text",
    "poses_record",
    "start_in",
    "steps_text",
    "table_pose_record",
]


@singledispatch
def start_in(table: Table, text: str | None) -> Any:
    """Return the start of `--start`, checked; without it, the best entry. Raises PoseError."""
    raise NotImplementedError(type(table))


@start_in.register(PolicyTable)
def _plane_start(table: PolicyTable, text: str | None) -> Pose:
    return table.best_entry().pose if text is None else table.start(start_pose(text))


@start_in.register(SpaceTable)
def _space_start(table: SpaceTable, text: str | None) -> SpacePose:
    if text is None:
        return table.best_entry().pose
    numbers = np.array(split_numbers(text))
    if numbers.shape != (6,) or not numbers[3:].any():
        raise PoseError(Mistake("--start", text, "must be R,A,S,DR,DA,DS: position in RAS mm, and direction"))
    frame = table.scenario.grid.frame
    tangent = frame.axes @ (numbers[3:] / np.linalg.norm(numbers[3:]))
    pose = SpacePose(*frame.local(numbers[:3]).tolist(), *tangent.tolist())
    if not table.contains(pose):
        cone = table.scenario.file.lattice.cone_deg
        rule = f"must lie in the lattice, with a direction at most {cone:g} deg from its axis"
        raise PoseError(Mistake("--start", text, rule))
    return pose


@singledispatch
def nearest_choice(table: Table, nearest: bool) -> dict[str, Any]:
    """Return `--nearest` as arguments of the table's methods. Raises InputError in 3D."""
    raise NotImplementedError(type(table))


@nearest_choice.register(PolicyTable)
def _plane_nearest(table: PolicyTable, nearest: bool) -> dict[str, Any]:  # noqa: ARG001
    return {"nearest": nearest}


@nearest_choice.register(SpaceTable)
def _space_nearest(table: SpaceTable, nearest: bool) -> dict[str, Any]:  # noqa: ARG001
    if nearest:
        raise InputError(Mistake("--nearest", "", "needs a table in the plane, and this is one in 3D"))
    return {}


@singledispatch
def pose_from(table: Table, row: list[float]) -> Any:
    """Return the pose of a row of a path's poses."""
    raise NotImplementedError(type(table))


@pose_from.register(PolicyTable)
def _plane_pose(table: PolicyTable, row: list[float]) -> Pose:  # noqa: ARG001
    return Pose.wound(row)


@pose_from.register(SpaceTable)
def _space_pose(table: SpaceTable, row: list[float]) -> SpacePose:  # noqa: ARG001
    return SpacePose(*row)


@singledispatch
def pose_text(table: Table, pose: Any) -> str:
    """Return a pose as a text."""
    raise NotImplementedError(type(table))


@pose_text.register(PolicyTable)
def _plane_text(table: PolicyTable, pose: Pose) -> str:  # noqa: ARG001
    return str(pose)


@pose_text.register(SpaceTable)
def _space_text(table: SpaceTable, pose: SpacePose) -> str:
    frame = table.scenario.grid.frame
    r, a, s = frame.world(pose.position_mm).tolist()
    along = ", ".join(f"{x:.3f}" for x in pose.tangent @ frame.axes)
    return f"R {r:.1f}, A {a:.1f}, S {s:.1f} mm, direction {along}"


@singledispatch
def place_text(table: Table, pose: Any) -> str:
    """Return the position of a pose as a text, in mm."""
    raise NotImplementedError(type(table))


@place_text.register(PolicyTable)
def _plane_place(table: PolicyTable, pose: Pose) -> str:  # noqa: ARG001
    return f"({pose.x_mm:.1f}, {pose.y_mm:.1f})"


@place_text.register(SpaceTable)
def _space_place(table: SpaceTable, pose: SpacePose) -> str:
    r, a, s = table.scenario.grid.frame.world(pose.position_mm).tolist()
    return f"({r:.1f}, {a:.1f}, {s:.1f})"


@singledispatch
def poses_record(table: Table, poses: NDArray[np.float64]) -> list[list[float]]:
    """Return the rows of the poses of a path for JSON."""
    raise NotImplementedError(type(table))


@poses_record.register(PolicyTable)
def _plane_poses(table: PolicyTable, poses: NDArray[np.float64]) -> list[list[float]]:  # noqa: ARG001
    rows: list[list[float]] = poses.tolist()
    return rows


@poses_record.register(SpaceTable)
def _space_poses(table: SpaceTable, poses: NDArray[np.float64]) -> list[list[float]]:
    frame = table.scenario.grid.frame
    rows: list[list[float]] = np.concatenate([frame.world(poses[:, :3]), poses[:, 3:] @ frame.axes], -1).tolist()
    return rows


@singledispatch
def steps_text(table: Table, path: Any) -> str:
    """Return the number of steps of a path as a text; a path in 3D has points instead of steps."""
    raise NotImplementedError(type(table), path)


@steps_text.register(PolicyTable)
def _plane_steps(table: PolicyTable, path: Path) -> str:  # noqa: ARG001
    return f" in {len(path.actions)} steps"


@steps_text.register(SpaceTable)
def _space_steps(table: SpaceTable, path: Any) -> str:  # noqa: ARG001
    return ""


@singledispatch
def table_pose_record(table: Table, pose: Any) -> dict[str, Any]:
    """Return the JSON record of a pose."""
    raise NotImplementedError(type(table))


@table_pose_record.register(PolicyTable)
def _plane_record(table: PolicyTable, pose: Pose) -> dict[str, Any]:  # noqa: ARG001
    return pose_record(pose)


@table_pose_record.register(SpaceTable)
def _space_record(table: SpaceTable, pose: SpacePose) -> dict[str, Any]:
    frame = table.scenario.grid.frame
    return {
        "position_mm": frame.world(pose.position_mm).tolist(),
        "direction": (pose.tangent @ frame.axes).tolist(),
    }


@singledispatch
def better_prediction(table: Table) -> str:
    """Return what brings predictions by the table closer to executions."""
    raise NotImplementedError(type(table))


@better_prediction.register(PolicyTable)
def _plane_prediction(table: PolicyTable) -> str:
    return what_helps(table.scenario)


@better_prediction.register(SpaceTable)
def _space_prediction(table: SpaceTable) -> str:  # noqa: ARG001
    return "`needleplan entry` estimates the success of entries by executions"
