"""The message kinds of samples, events and recorder status.

A sample is read by the names of its attributes: this package must not import `needleplan.devices`, which declares them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from needleplan.recording._message_kinds import Field, Json, Packed
from needleplan.signals import FIBRE_COLUMNS, IMAGE_COLUMNS

__all__ = ["EVENT", "FIBRE", "FORCE", "IMAGE", "POSE", "STAGE", "STATUS"]

_HEAD = (
    Field("received_ns", "int64", comment="on the monotonic clock of the recording machine"),
    Field("sequence", "uint64", comment="the device's own number"),
    Field("device_time_s", comment="NaN where the device has no clock"),
)
_LOST = Field("lost", "uint32", comment="samples lost just before this one")
_HEALTH = Field("health", "uint8", ("good", "suspect", "missing"))
_MOVING = Field("moving", "bool")
_NOTES = Field("notes", "string")


def _kind(name: str, names: Iterable[str], numbers: Callable[[Any], Iterable[float]], *, moves: bool = False) -> Packed:
    """Return the kind of a sample whose fields `names` have the values that `numbers` returns for it.

    All samples have a stamp, a health and notes; `moves` tells whether they also say that an axis moves.
    """

    def row(sample: Any) -> tuple[Any, ...]:
        stamp = sample.stamp
        device_time_s = math.nan if stamp.device_time_s is None else stamp.device_time_s
        moving = (sample.moving,) if moves else ()
        end = (stamp.lost, str(sample.health), *moving, "; ".join(sample.notes))
        return (stamp.received_ns, stamp.sequence, device_time_s, *numbers(sample), *end)

    moving_field = (_MOVING,) if moves else ()
    fields = (*_HEAD, *map(Field, names), _LOST, _HEALTH, *moving_field, _NOTES)
    return Packed(f"needleplan_msgs/msg/{name}", fields, row)


def _curvatures(sample: Any) -> list[float]:
    numbers = [value for pair in sample.curvatures_per_mm for value in pair]
    return numbers + [math.nan] * (len(FIBRE_COLUMNS) - len(numbers))


FORCE = _kind(
    "Force",
    ("force_x_n", "force_y_n", "force_z_n", "torque_x_n_mm", "torque_y_n_mm", "torque_z_n_mm"),
    lambda sample: (*sample.force_n, *sample.torque_n_mm),
)
"""A sample of the force sensor: the wrench at the base of the needle, in the frame of the sensor."""

POSE = _kind(
    "Pose",
    ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz", "error_mm"),
    lambda sample: (*sample.position_mm, *sample.quaternion, sample.error_mm),
)
"""A sample of the tracker: the pose of a coil in the frame of the tracker."""

FIBRE = _kind("Fibre", FIBRE_COLUMNS, _curvatures)
"""A sample of the curvature sensors along the needle; NaN for sensors that the needle does not have."""

IMAGE = _kind("Image", IMAGE_COLUMNS, lambda sample: (sample.u_mm, sample.v_mm))
"""A detection of the tip in an ultrasound image; NaN if the tip was not detected."""

STAGE = _kind(
    "Stage",
    ("depth_mm", "velocity_mm_s", "roll_rad"),
    lambda sample: (sample.depth_mm, sample.velocity_mm_s, sample.roll_rad),
    moves=True,
)
"""A sample of the stage: depth (mm), velocity (mm/s), roll (rad), and whether an axis moves."""

EVENT = Json(
    "needleplan.Event",
    {"name": {"type": "string"}, "cause": {"type": "string"}, "text": {"type": "string"}},
)
"""An event: its name, its cause and a text; further entries are allowed."""

STATUS = Json(
    "needleplan.RecorderStatus",
    {
        "state": {"type": "string"},
        "cause": {"type": "string"},
        "written": {"type": "integer"},
        "overflowed": {"type": "object", "additionalProperties": {"type": "integer"}},
        "refused": {"type": "integer"},
    },
)
"""The status of the recorder; a message is recorded at every change."""
