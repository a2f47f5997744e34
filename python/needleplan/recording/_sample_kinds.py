"""The message kinds of samples, events and recorder status.

Samples are typed by their attributes (protocols), because this package must not import `needleplan.devices`.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

from needleplan.recording._message_kinds import Field, Json, Packed
from needleplan.signals import FIBRE_COLUMNS, IMAGE_COLUMNS

__all__ = ["EVENT", "FIBRE", "FORCE", "IMAGE", "POSE", "STAGE", "STATUS"]


class _Stamp(Protocol):
    @property
    def received_ns(self) -> int: ...
    @property
    def sequence(self) -> int: ...
    @property
    def lost(self) -> int: ...
    @property
    def device_time_s(self) -> float | None: ...


class _Sample(Protocol):
    @property
    def stamp(self) -> _Stamp: ...
    @property
    def health(self) -> str: ...
    @property
    def notes(self) -> tuple[str, ...]: ...


class _Force(_Sample, Protocol):
    @property
    def force_n(self) -> tuple[float, float, float]: ...
    @property
    def torque_n_mm(self) -> tuple[float, float, float]: ...


class _Pose(_Sample, Protocol):
    @property
    def position_mm(self) -> tuple[float, float, float]: ...
    @property
    def quaternion(self) -> tuple[float, float, float, float]: ...
    @property
    def error_mm(self) -> float: ...


class _Fibre(_Sample, Protocol):
    @property
    def curvatures_per_mm(self) -> tuple[tuple[float, float], ...]: ...


class _Image(_Sample, Protocol):
    @property
    def u_mm(self) -> float: ...
    @property
    def v_mm(self) -> float: ...


class _Stage(_Sample, Protocol):
    @property
    def depth_mm(self) -> float: ...
    @property
    def velocity_mm_s(self) -> float: ...
    @property
    def roll_rad(self) -> float: ...
    @property
    def moving(self) -> bool: ...


def _start(sample: _Sample) -> tuple[Any, ...]:
    stamp = sample.stamp
    device_time_s = math.nan if stamp.device_time_s is None else stamp.device_time_s
    return stamp.received_ns, stamp.sequence, device_time_s


def _force_row(sample: _Force) -> tuple[Any, ...]:
    end = (sample.stamp.lost, str(sample.health), "; ".join(sample.notes))
    return (*_start(sample), *sample.force_n, *sample.torque_n_mm, *end)


def _pose_row(sample: _Pose) -> tuple[Any, ...]:
    end = (sample.stamp.lost, str(sample.health), "; ".join(sample.notes))
    return (*_start(sample), *sample.position_mm, *sample.quaternion, sample.error_mm, *end)


def _fibre_row(sample: _Fibre) -> tuple[Any, ...]:
    numbers = [value for pair in sample.curvatures_per_mm for value in pair]
    numbers += [math.nan] * (len(FIBRE_COLUMNS) - len(numbers))
    return (*_start(sample), *numbers, sample.stamp.lost, str(sample.health), "; ".join(sample.notes))


def _image_row(sample: _Image) -> tuple[Any, ...]:
    end = (sample.stamp.lost, str(sample.health), "; ".join(sample.notes))
    return (*_start(sample), sample.u_mm, sample.v_mm, *end)


def _stage_row(sample: _Stage) -> tuple[Any, ...]:
    numbers = (sample.depth_mm, sample.velocity_mm_s, sample.roll_rad)
    end = (sample.stamp.lost, str(sample.health), sample.moving, "; ".join(sample.notes))
    return (*_start(sample), *numbers, *end)


_HEAD = (
    Field("received_ns", "int64", comment="on the monotonic clock of the recording machine"),
    Field("sequence", "uint64", comment="the device's own number"),
    Field("device_time_s", comment="NaN where the device has no clock"),
)
_LOST = Field("lost", "uint32", comment="samples lost just before this one")
_HEALTH = Field("health", "uint8", ("good", "suspect", "missing"))
_NOTES = Field("notes", "string")


def _numbers(names: str) -> tuple[Field, ...]:
    return tuple(Field(name) for name in names.split())


FORCE = Packed(
    "needleplan_msgs/msg/Force",
    (*_HEAD, *_numbers("force_x_n force_y_n force_z_n torque_x_n_mm torque_y_n_mm torque_z_n_mm"),
     _LOST, _HEALTH, _NOTES),
    _force_row,
)  # fmt: skip
"""A sample of the force sensor: the wrench at the base of the needle, in the frame of the sensor."""

POSE = Packed(
    "needleplan_msgs/msg/Pose",
    (*_HEAD, *_numbers("x_mm y_mm z_mm qw qx qy qz error_mm"), _LOST, _HEALTH, _NOTES),
    _pose_row,
)
"""A sample of the tracker: the pose of a coil in the frame of the tracker."""

FIBRE = Packed(
    "needleplan_msgs/msg/Fibre",
    (*_HEAD, *_numbers(" ".join(FIBRE_COLUMNS)), _LOST, _HEALTH, _NOTES),
    _fibre_row,
)
"""A sample of the curvature sensors along the needle; NaN for sensors that the needle does not have."""

IMAGE = Packed(
    "needleplan_msgs/msg/Image",
    (*_HEAD, *_numbers(" ".join(IMAGE_COLUMNS)), _LOST, _HEALTH, _NOTES),
    _image_row,
)
"""A detection of the tip in an ultrasound image; NaN if the tip was not detected."""

STAGE = Packed(
    "needleplan_msgs/msg/Stage",
    (*_HEAD, *_numbers("depth_mm velocity_mm_s roll_rad"), _LOST, _HEALTH, Field("moving", "bool"), _NOTES),
    _stage_row,
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
