"""Poses in message bodies (TRANSFORM, POSITION, TDATA, QTDATA): encoding, and validation. Positions are in mm.

A tool has 70 bytes in TDATA and 50 bytes in QTDATA (source: `igtl_tdata.h` and `igtl_qtdata.h` of the OpenIGTLink
library; its manual gives a wrong length of the name in QTDATA). POSITION has 28 bytes, 24 bytes without the w component
of the quaternion, or 12 bytes without orientation. Quaternions of poses are (w, x, y, z).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from needleplan.artifacts import CallRepr
from needleplan.devices._base import PoseSample, PoseValidator, Stamp
from needleplan.devices.igtl.messages import padded, text_of
from needleplan.errors import DeviceFault, ProtocolError

__all__ = [
    "FrameTimes",
    "IgtlPose",
    "IgtlPoseLimits",
    "IgtlPoseValidator",
    "IgtlTool",
    "ToolKind",
    "decode_position",
    "decode_qtdata",
    "decode_tdata",
    "decode_transform",
    "encode_position",
    "encode_qtdata",
    "encode_tdata",
    "encode_transform",
]

_MATRIX = struct.Struct(">12f")
_POSITION = struct.Struct(">7f")
_TDATA = struct.Struct(">20sBx12f")
_QTDATA = struct.Struct(">20sBx7f")


@dataclass(frozen=True)
class IgtlPose(CallRepr):
    """A pose with position (mm) and unit quaternion (w, x, y, z).

    `distortion` measures how much the received matrix or quaternion deviates from a rotation: 0 for an exact rotation,
    NaN if no rotation can be computed (the quaternion is then the identity). `oriented` is False if only a position was
    received.
    """

    position_mm: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    distortion: float = 0.0
    oriented: bool = True


class ToolKind(IntEnum):
    """Type of a tool in TDATA and QTDATA, by its measured degrees of freedom."""

    TRACKER = 1
    SIX_DOF = 2
    POSITION_ONLY = 3
    FIVE_DOF = 4
    UNKNOWN = 0


_KINDS = frozenset(map(int, ToolKind))


@dataclass(frozen=True)
class IgtlTool(CallRepr):
    """One tool in TDATA or QTDATA."""

    name: str
    pose: IgtlPose
    kind: ToolKind = ToolKind.SIX_DOF


def encode_transform(pose: IgtlPose) -> bytes:
    """Return the body of TRANSFORM: the columns of the rotation matrix, then the position."""
    return _MATRIX.pack(*_columns(pose))


def decode_transform(content: bytes) -> IgtlPose:
    """Return the pose in the body of TRANSFORM. Raises ProtocolError for a wrong length."""
    if len(content) != _MATRIX.size:
        raise ProtocolError(f"OpenIGTLink: TRANSFORM of {len(content)} bytes")
    return _from_columns(_MATRIX.unpack(content))


def encode_position(pose: IgtlPose) -> bytes:
    """Return the body of POSITION: the position, then the quaternion with w last."""
    w, x, y, z = pose.quaternion
    return _POSITION.pack(*pose.position_mm, x, y, z, w)


def decode_position(content: bytes) -> IgtlPose:
    """Return the pose in the body of POSITION, which has 28, 24 or 12 bytes. Raises ProtocolError otherwise."""
    if len(content) not in (12, 24, 28):
        raise ProtocolError(f"OpenIGTLink: POSITION of {len(content)} bytes")
    numbers = struct.unpack(f">{len(content) // 4}f", content)
    if len(numbers) == 3:
        return IgtlPose((numbers[0], numbers[1], numbers[2]), oriented=False)
    if len(numbers) == 6:
        numbers += (math.sqrt(max(1 - math.fsum(number * number for number in numbers[3:]), 0.0)),)
    return _from_quaternion(numbers)


def encode_tdata(tools: Sequence[IgtlTool]) -> bytes:
    """Return the body of TDATA. Raises InputError if a name is longer than 20 bytes."""
    return b"".join(_TDATA.pack(padded(tool.name, 20, "tool"), tool.kind, *_columns(tool.pose)) for tool in tools)


def decode_tdata(content: bytes) -> tuple[IgtlTool, ...]:
    """Return the tools in the body of TDATA. Raises ProtocolError for a wrong length."""
    if len(content) % _TDATA.size:
        raise ProtocolError(f"OpenIGTLink: TDATA of {len(content)} bytes")
    return tuple(
        IgtlTool(text_of(name), _from_columns(numbers), _kind(kind))
        for name, kind, *numbers in _TDATA.iter_unpack(content)
    )  # fmt: skip


def encode_qtdata(tools: Sequence[IgtlTool]) -> bytes:
    """Return the body of QTDATA. Raises InputError if a name is longer than 20 bytes."""
    return b"".join(
        padded(tool.name, 20, "tool") + bytes([tool.kind, 0]) + encode_position(tool.pose) for tool in tools
    )


def decode_qtdata(content: bytes) -> tuple[IgtlTool, ...]:
    """Return the tools in the body of QTDATA. Raises ProtocolError for a wrong length."""
    if len(content) % _QTDATA.size:
        raise ProtocolError(f"OpenIGTLink: QTDATA of {len(content)} bytes")
    return tuple(
        IgtlTool(text_of(name), _from_quaternion(numbers), _kind(kind))
        for name, kind, *numbers in _QTDATA.iter_unpack(content)
    )


def _kind(number: int) -> ToolKind:
    return ToolKind(number) if number in _KINDS else ToolKind.UNKNOWN


def _columns(pose: IgtlPose) -> tuple[float, ...]:
    w, x, y, z = pose.quaternion
    return (
        w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y),
        2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x),
        2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z,
        *pose.position_mm,
    )  # fmt: skip


def _from_columns(numbers: Sequence[float]) -> IgtlPose:
    a, b, c = numbers[0:3], numbers[3:6], numbers[6:9]
    position = (numbers[9], numbers[10], numbers[11])
    products = [_dot(a, a) - 1, _dot(b, b) - 1, _dot(c, c) - 1, _dot(a, b), _dot(b, c), _dot(c, a)]
    handed = _dot(a, (b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]))
    distortion = max(map(abs, products))
    if not math.isfinite(distortion) or not handed > 0:
        return IgtlPose(position, distortion=math.nan)
    # The largest quaternion component is computed first, then the others from it by division (Shepperd 1978).
    squares = (1 + a[0] + b[1] + c[2], 1 + a[0] - b[1] - c[2], 1 - a[0] + b[1] - c[2], 1 - a[0] - b[1] + c[2])
    sums = (b[2] - c[1], c[0] - a[2], a[1] - b[0], b[0] + a[1], a[2] + c[0], c[1] + b[2])
    largest = max(range(4), key=squares.__getitem__)
    rows = (
        (squares[0], sums[0], sums[1], sums[2]), (sums[0], squares[1], sums[3], sums[4]),
        (sums[1], sums[3], squares[2], sums[5]), (sums[2], sums[4], sums[5], squares[3]),
    )  # fmt: skip
    norm = math.hypot(*rows[largest])
    w, x, y, z = (component / norm for component in rows[largest])
    return IgtlPose(position, (w, x, y, z), distortion)


def _from_quaternion(numbers: Sequence[float]) -> IgtlPose:
    x, y, z, w = numbers[3:7]
    norm = math.hypot(w, x, y, z)
    position = (numbers[0], numbers[1], numbers[2])
    if not math.isfinite(norm) or norm < 0.5:
        return IgtlPose(position, distortion=math.nan)
    return IgtlPose(position, (w / norm, x / norm, y / norm, z / norm), abs(norm - 1))


def _dot(first: Sequence[float], second: Sequence[float]) -> float:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


_NANO = 1_000_000_000
_SHORTEST_S = 0.001  # shortest time (s) from which the speed of a pose is computed; shorter times amplify noise

# PLUS sends this pose for a coil that is not visible; header version 1 has no field for the status of the coil.
_IDENTITY = IgtlPose((0.0, 0.0, 0.0))


@dataclass(frozen=True)
class IgtlPoseLimits:
    """Limits above which a pose is SUSPECT, or the tracker raises an error."""

    start_s: float = 3.0  # longest time from the start to the first pose; then ConfigurationError
    silence_s: float = 0.5  # time without a new pose after which the tracker raises DeviceFault
    late_s: float = 0.1  # transmission time beyond the shortest one so far above which a pose is SUSPECT (outdated)
    damaged: int = 10  # number of damaged messages in succession at which the tracker raises DeviceFault
    speed_mm_s: float = 200.0  # speed between two poses above which a pose is SUSPECT
    distortion: float = 0.01  # `IgtlPose.distortion` (deviation from a rotation) above which a pose is SUSPECT


class FrameTimes:
    """Validates the times of the frames of one device; `rate_hz` is their rate, 0 if unknown."""

    def __init__(self, limits: IgtlPoseLimits, rate_hz: float = 0.0, noun: str = "tracker") -> None:
        self._limits, self._rate_hz, self._noun = limits, rate_hz, noun
        self._timestamp = 0
        self._number: int | None = None
        self._fastest_ns: int | None = None

    def take(self, timestamp: int, now_ns: int) -> tuple[Stamp, tuple[str, ...]] | None:
        """Return the stamp of a new frame and its notes, or None if the frame is repeated.

        `timestamp` is in units of 2**-32 s, 0 if unknown. Raises DeviceFault if it goes back, also to 0.
        """
        if timestamp and timestamp == self._timestamp:
            return None
        if timestamp < self._timestamp:
            back_s = (self._timestamp - timestamp) / (1 << 32)
            raise DeviceFault(
                f"{self._noun}: its time went back by {back_s:.3g} s: it was restarted, or its clock was changed"
            )
        lost = 0
        if self._number is not None and self._rate_hz and timestamp:
            lost = max(round((timestamp - self._timestamp) / (1 << 32) * self._rate_hz) - 1, 0)
        self._number = 0 if self._number is None else self._number + 1 + lost
        self._timestamp = timestamp
        stamp = Stamp(now_ns, self._number, lost, timestamp / (1 << 32) if timestamp else None)
        return stamp, self._notes(timestamp, now_ns)

    def _notes(self, timestamp: int, now_ns: int) -> tuple[str, ...]:
        if not timestamp:
            return ("without a time: the sample may be outdated",)
        took_ns = now_ns - (timestamp * _NANO >> 32)
        self._fastest_ns = took_ns if self._fastest_ns is None else min(self._fastest_ns, took_ns)
        late_s = (took_ns - self._fastest_ns) / _NANO
        return (f"{late_s:.3g} s late",) if late_s > self._limits.late_s else ()


class IgtlPoseValidator(PoseValidator):
    """Validates the poses of one tool; `rate_hz` is the frame rate of the tracker, 0 if unknown."""

    limits: IgtlPoseLimits
    rate_hz: float
    last: PoseSample | None

    def __init__(self, limits: IgtlPoseLimits, rate_hz: float = 0.0) -> None:
        super().__init__()
        self.limits, self.rate_hz = limits, rate_hz
        self._times = FrameTimes(limits, rate_hz)

    def validate(self, pose: IgtlPose | None, timestamp: int, status: str, now_ns: int) -> PoseSample | None:
        """Return the sample of a new frame, or None if the frame is repeated.

        `pose` is None if the tool is not in the frame. `timestamp` is in units of 2**-32 s, 0 if unknown. `status` is
        the status of the tool that the server reports, or "". Raises DeviceFault if `timestamp` goes back, also to 0.
        """
        timed = self._times.take(timestamp, now_ns)
        if timed is None:
            return None
        self.last = self._sample(pose, status, *timed)
        return self.last

    def _sample(self, pose: IgtlPose | None, status: str, stamp: Stamp, notes: tuple[str, ...]) -> PoseSample:
        if pose is None:
            return self.missing(stamp, "not seen", notes)
        if status not in ("", "OK"):
            return self.missing(stamp, f"not seen: {status}", notes)
        if not status and pose == _IDENTITY:
            return self.missing(stamp, "not seen, or exactly at the origin", notes)
        if not self.are_plausible((*pose.position_mm, pose.distortion)):
            return self.missing(stamp, "not a pose", notes)
        if not pose.oriented:
            notes += ("position without orientation",)
        if pose.distortion > self.limits.distortion:
            notes += (f"not a rotation: deviation {pose.distortion:.3g}",)
        most_step_mm = self.limits.speed_mm_s * max(self._passed_s(stamp), _SHORTEST_S)
        return self.sample(stamp, pose.position_mm, pose.quaternion, math.nan, notes, most_step_mm)

    def _passed_s(self, stamp: Stamp) -> float:
        """Return the time (s) since the last sample, on the clock of the tracker if both samples have its time."""
        last = stamp if self.last is None else self.last.stamp
        if stamp.device_time_s is None or last.device_time_s is None:
            return (stamp.received_ns - last.received_ns) / _NANO
        return stamp.device_time_s - last.device_time_s
