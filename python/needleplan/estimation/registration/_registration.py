"""The registration of a needle (coil to tip, tracker frame to plan frame) and the registration file."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from needleplan.artifacts import Parent, ShortRepr, digest, version, write_whole
from needleplan.config import (
    ConfigTable,
    Integer,
    Number,
    Numbers,
    ParentList,
    Sign,
    Subtable,
    TableList,
    Text,
    Violation,
    build,
    parse_toml,
    ruled,
    shown,
    text_of,
    toml_text,
)
from needleplan.errors import DataError, Mistake
from needleplan.estimation.registration._rigid import RigidMotion, register
from needleplan.estimation.registration._status import RegistrationVerdict, VerdictStatus
from needleplan.signals import RigidError

__all__ = ["CoilPose", "Registration", "not_refused", "require_verdict"]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

# Largest accepted difference (mm), per coordinate, between points moved by the stored frame and by a fit to the points.
_SAME_FRAME_MM = 1e-3


class CoilPose(NamedTuple):
    """A coil in the frame of the plan: position (mm), and unit direction of the needle at the coil, towards the tip."""

    position_mm: Vector
    direction: Vector


def _made_by() -> str:
    return f"needleplan {version()}"


def _frame_fits_points(frame: _Frame, point: tuple[_Point | None, ...]) -> Iterator[Mistake]:
    """Yield a mistake if the stored frame is not the fit of the points, for example after an edit of the file.

    Also yields the mistakes of points that cannot be fitted. Does nothing if there is no point or a point is wrong.
    """
    pairs = [(pair.tracker_mm, pair.plan_mm) for pair in point if pair]
    if len(pairs) < max(len(point), 1):
        return
    tracker, plan = (np.array([pair[side] for pair in pairs]) for side in (0, 1))
    try:
        motion = register(tracker, plan, ("point.tracker_mm", "point.plan_mm"))
    except DataError as error:
        yield from error.mistakes
        return
    here = tracker @ np.array(_matrix(frame.quaternion)).T + np.array(frame.translation_mm)
    if np.abs(here - motion.apply(tracker)).max() > _SAME_FRAME_MM:
        left = float(np.sqrt(((here - plan) ** 2).sum(axis=1).mean()))
        rule = f"must be what the points give: they are off by {left:.3g} mm, at best by {motion.fre_mm:.3g} mm"
        yield Mistake("frame.quaternion", shown(frame.quaternion), rule)


@dataclass(frozen=True)
class _Coil(ConfigTable, key="coil"):
    offset_mm: float = ruled(Number("mm", at_least=0, at_most=500))
    offset_sd_mm: float = ruled(Number("mm", at_least=0, at_most=100))
    axis: int = ruled(Sign())
    rms_mm: float = ruled(Number("mm", at_least=0))
    poses: int = ruled(Integer(0, 10**9))


@dataclass(frozen=True)
class _Frame(ConfigTable, key="frame"):
    quaternion: Quaternion = ruled(Numbers(4, unit_length=True))
    translation_mm: Vector = ruled(Numbers(3))


@dataclass(frozen=True)
class _Point(ConfigTable, key="point"):
    tracker_mm: Vector = ruled(Numbers(3))
    plan_mm: Vector = ruled(Numbers(3))


@dataclass(frozen=True, kw_only=True)
class _RegistrationFile(
    ConfigTable, error=DataError, schema="needleplan.registration/1", between=(_frame_fits_points,)
):
    title: str = ruled(Text(), "")
    made_by: str = ruled(Text(), factory=_made_by)
    coil: _Coil = ruled(Subtable(_Coil))
    frame: _Frame = ruled(Subtable(_Frame))
    point: tuple[_Point, ...] = ruled(TableList(_Point), ())
    parent: tuple[Parent, ...] = ruled(ParentList(), ())
    verdict: RegistrationVerdict = ruled(Subtable(RegistrationVerdict), RegistrationVerdict())


@dataclass(frozen=True)
class Registration(ShortRepr):
    """Distance from coil to tip, and the rigid motion from the frame of the tracker to the frame of the plan.

    In the frame of the plan, x is along the insertion, y lateral to the left, and z out of the plane.

    - `quaternion` (w, x, y, z), `translation_mm`: rotation, then translation, of a point from tracker to plan
    - `coil_offset_mm`, `coil_offset_sd_mm`: distance from coil to tip, and its standard deviation
    - `coil_axis`: +1 if the z axis of the coil, which is parallel to the needle, points to the tip, else -1
    - `pivot_rms_mm`, `pivot_poses`: residual and number of poses of the pivot calibration
    - `points`: pairs (tracker, plan) of points to which the motion was fitted
    - `verdict`: whether the measurements support the registration

    Raises DataError with all mistakes; the key of a mistake is the key in the file.
    """

    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    translation_mm: Vector = (0.0, 0.0, 0.0)
    coil_offset_mm: float = 0.0
    coil_offset_sd_mm: float = 0.0
    coil_axis: int = 1
    pivot_rms_mm: float = 0.0
    pivot_poses: int = 0
    points: tuple[tuple[Vector, Vector], ...] = ()
    parents: tuple[Parent, ...] = ()
    title: str = ""
    made_by: str = field(default_factory=_made_by)
    verdict: RegistrationVerdict = RegistrationVerdict()

    def __post_init__(self) -> None:
        try:
            file = build(_RegistrationFile, self._raw())
        except Violation as broken:
            raise DataError(broken.mistakes, "registration") from None
        for name, value in _values(file).items():
            object.__setattr__(self, name, value)

    def place(self, position_mm: Vector, quaternion: tuple[float, float, float, float]) -> CoilPose:
        """Return the coil in the frame of the plan.

        Parameters
        ----------
        position_mm : tuple of float
            Position of the coil in the frame of the tracker (mm).
        quaternion : tuple of float
            Rotation (w, x, y, z) from the frame of the coil to the frame of the tracker.

        Returns
        -------
        CoilPose
        """
        at = _turned(self._matrix, position_mm)
        shift = self.translation_mm
        direction = _turned(self._matrix, _axis(quaternion))
        sign = self.coil_axis
        return CoilPose(
            (at[0] + shift[0], at[1] + shift[1], at[2] + shift[2]),
            (sign * direction[0], sign * direction[1], sign * direction[2]),
        )

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Homogeneous matrix, shape (4, 4), from tracker to plan (mm)."""
        both = np.eye(4)
        both[:3, :3], both[:3, 3] = self._matrix, self.translation_mm
        return both

    def accepted(self, reason: str) -> Registration:
        """Return the registration with the status accepted, and the reason of a person; its refusals are kept.

        Raises DataError if the reason is blank.
        """
        verdict = replace(self.verdict, status=VerdictStatus.ACCEPTED, accepted=reason.strip())
        return replace(self, verdict=verdict)

    def followed_by(self, matrix: ArrayLike, translation_mm: ArrayLike) -> Registration:
        """Return the registration to another frame, without its points.

        Parameters
        ----------
        matrix : array_like
            Rotation from the frame of the plan to the other frame, shape (3, 3).
        translation_mm : array_like
            Position of the origin of the plan in the other frame (mm), shape (3,).

        Returns
        -------
        Registration
        """
        turn = np.asarray(matrix, float)
        both = turn @ np.array(self._matrix)
        shift = (turn @ np.array(self.translation_mm) + np.asarray(translation_mm, float)).tolist()
        quaternion = _normalised(Rotation.from_matrix(both).as_quat(scalar_first=True).tolist())
        return replace(self, quaternion=quaternion, translation_mm=tuple(shift), points=())

    @cached_property
    def motion(self) -> RigidMotion | None:
        """Rigid motion fitted to the points, with its errors; None if there are no points."""
        if not self.points:
            return None
        first, second = (np.array([pair[side] for pair in self.points]) for side in (0, 1))
        return register(first, second)

    @property
    def fre_mm(self) -> float:
        """Fiducial registration error: root mean square distance of the moved points from their partners.

        NaN without points.
        """
        return self.motion.fre_mm if self.motion else math.nan

    @property
    def error(self) -> RigidError | None:
        """Error of the motion in the frame of the plan, which gives the error at any place; None without points.

        Examples
        --------
        >>> from needleplan.estimation import Registration
        >>> Registration().error is None
        True
        """
        return self.motion.error if self.motion else None

    def tre_mm(self, target_mm: Vector) -> float:
        """Return the expected root mean square error (mm) at a target in the frame of the plan; NaN without points."""
        if self.motion is None:
            return math.nan
        back = np.array(self._matrix).T @ (np.array(target_mm) - np.array(self.translation_mm))
        return self.motion.tre_mm(back)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read a registration file. Raises DataError if it cannot be read, or with every mistake: key, value, rule."""
        return cls.from_toml(text_of(path, DataError), os.fspath(path))

    @classmethod
    def from_toml(cls, content: str, source: str = "") -> Self:
        """Parse the text of a registration file.

        Parameters
        ----------
        content : str
            Text of the file.
        source : str, optional
            Name of the text in messages.

        Returns
        -------
        Registration

        Raises
        ------
        DataError
            The text is not TOML, or has mistakes. The error lists all of them.
        """
        return cls(**_values(parse_toml(content, _RegistrationFile, source)))

    def to_toml(self) -> str:
        """Return the text of a registration file that reads back as exactly this registration."""
        filled = {key: value for key, value in self._raw().items() if value not in ([], {})}
        return toml_text({"schema": _RegistrationFile.schema, **filled})

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a registration file atomically. Raises OutputError if it cannot be written."""
        write_whole(path, self.to_toml().encode())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the text of the file. Artefacts made with the registration store this digest as a parent."""
        return digest(self.to_toml())

    @cached_property
    def _matrix(self) -> tuple[Vector, Vector, Vector]:
        return _matrix(self.quaternion)

    def _raw(self) -> dict[str, Any]:
        """Return the tables of the registration file as dictionaries."""
        return {
            "title": self.title,
            "made_by": self.made_by,
            "coil": {
                "offset_mm": self.coil_offset_mm,
                "offset_sd_mm": self.coil_offset_sd_mm,
                "axis": self.coil_axis,
                "rms_mm": self.pivot_rms_mm,
                "poses": self.pivot_poses,
            },
            "frame": {"quaternion": self.quaternion, "translation_mm": self.translation_mm},
            "point": [{"tracker_mm": tracker, "plan_mm": plan} for tracker, plan in self.points],
            "parent": [{"name": parent.name, "digest": parent.digest} for parent in self.parents],
            "verdict": self.verdict.raw(),
        }


def not_refused(registration: Registration, source: str = "registration") -> Registration:
    """Return the registration. Raises DataError, with the reasons, if its verdict is that it is refused."""
    verdict = registration.verdict
    if verdict.status is VerdictStatus.REFUSED:
        why = "; ".join(verdict.reasons) or "its measurements contradict it"
        rule = f"no needle may follow it: {why}. Measure again, or accept it by `needleplan register --accept REASON`"
        raise DataError(Mistake("verdict.status", f'"{verdict.status}"', rule), source)
    return registration


def require_verdict(registration: Registration, source: str = "registration") -> Registration:
    """Return the registration. Raises DataError unless it has passed, or a person has accepted it."""
    verdict = not_refused(registration, source).verdict
    if not verdict.ok:
        rule = 'must be "passed" or "accepted" for real devices: make the file by `needleplan register`, or accept it '
        rule += (
            'with a reason (`Registration.accepted("REASON")`; in the file status = "accepted", accepted = "REASON")'
        )
        raise DataError(Mistake("verdict.status", f'"{verdict.status}"', rule), source)
    return registration


def _values(file: _RegistrationFile) -> dict[str, Any]:
    """Return the fields of `Registration` with the values of a file."""
    return {
        "quaternion": file.frame.quaternion,
        "translation_mm": file.frame.translation_mm,
        "coil_offset_mm": file.coil.offset_mm,
        "coil_offset_sd_mm": file.coil.offset_sd_mm,
        "coil_axis": file.coil.axis,
        "pivot_rms_mm": file.coil.rms_mm,
        "pivot_poses": file.coil.poses,
        "points": tuple((pair.tracker_mm, pair.plan_mm) for pair in file.point),
        "parents": file.parent,
        "title": file.title,
        "made_by": file.made_by,
        "verdict": file.verdict,
    }


def _matrix(quaternion: Quaternion) -> tuple[Vector, Vector, Vector]:
    """Return the rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _normalised(quaternion: Sequence[float]) -> Quaternion:
    w, x, y, z = (component / math.hypot(*quaternion) for component in quaternion)
    return w, x, y, z


def _turned(matrix: tuple[Vector, Vector, Vector], vector: Vector) -> Vector:
    a, b, c = vector
    (xa, xb, xc), (ya, yb, yc), (za, zb, zc) = matrix
    return (xa * a + xb * b + xc * c, ya * a + yb * b + yc * c, za * a + zb * b + zc * c)


def _axis(quaternion: tuple[float, float, float, float]) -> Vector:
    """Return the z axis rotated by a quaternion (w, x, y, z) of any length but zero."""
    w, x, y, z = quaternion
    size = w * w + x * x + y * y + z * z
    return (2 * (x * z + w * y) / size, 2 * (y * z - w * x) / size, (w * w - x * x - y * y + z * z) / size)
