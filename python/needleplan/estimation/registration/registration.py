"""The registration of a needle: coil to tip, and the tracker's frame to that of the plan; a value, and a file."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from needleplan.artifacts import digest, version, write_whole
from needleplan.errors import DataError, Mistake
from needleplan.estimation.registration import toml
from needleplan.estimation.registration.rigid import RigidMotion, register
from needleplan.scenario.rules import Integer, Number, Refused, Rule, Text, shown

__all__ = ["CoilPose", "Registration"]

Vector = tuple[float, float, float]


class CoilPose(NamedTuple):
    """A coil in the frame of the plan: position (mm) and the unit direction of the needle there, towards the tip."""

    position_mm: Vector
    direction: Vector


def _ruled(rule: Rule, default: Any) -> Any:
    return field(default=default, metadata={"rule": rule})


@dataclass(frozen=True)
class Registration:
    """Where the tip is before the coil, and the rigid motion from the tracker's frame to that of the plan.

    The plan has x along the insertion, y lateral, to the left, and z out of its plane. `quaternion` (w, x, y, z) and
    `translation_mm` take a point of the tracker there. The coil's own z axis lies along the needle; `coil_axis` is +1
    where it points to the tip, -1 where it points away. `points` are the pairs of points it was made from: (tracker,
    plan) each. Raises DataError with everything that cannot be.
    """

    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    translation_mm: Vector = (0.0, 0.0, 0.0)
    coil_offset_mm: float = _ruled(Number("mm", at_least=0, at_most=500), 0.0)
    coil_offset_sd_mm: float = _ruled(Number("mm", at_least=0, at_most=100), 0.0)
    coil_axis: int = _ruled(Integer(-1, 1), 1)
    pivot_rms_mm: float = _ruled(Number("mm", at_least=0), 0.0)
    pivot_poses: int = _ruled(Integer(0, 10**9), 0)
    points: tuple[tuple[Vector, Vector], ...] = ()
    parents: tuple[toml.Parent, ...] = ()
    title: str = _ruled(Text(), "")
    made_by: str = field(default_factory=lambda: f"needleplan {version()}")

    def __post_init__(self) -> None:
        mistakes = []
        for each in fields(self):
            rule = each.metadata.get("rule")
            try:
                if rule:
                    object.__setattr__(self, each.name, rule.read(getattr(self, each.name)))
            except Refused as refused:
                mistakes.append(Mistake(each.name, shown(getattr(self, each.name)), str(refused)))
        if self.coil_axis == 0:
            mistakes.append(Mistake("coil_axis", "0", "must be 1 or -1"))
        for name, count in (("quaternion", 4), ("translation_mm", 3)):
            numbers = tuple(getattr(self, name))
            if len(numbers) != count or not all(map(math.isfinite, numbers)):
                mistakes.append(Mistake(name, shown(numbers), f"must be {count} finite numbers"))
        if not mistakes and abs(math.hypot(*self.quaternion) - 1) > 1e-6:
            mistakes.append(Mistake("quaternion", shown(self.quaternion), "must be of length 1"))
        if mistakes:
            raise DataError(mistakes, "registration")

    def place(self, position_mm: Vector, quaternion: tuple[float, float, float, float]) -> CoilPose:
        """Return a coil as the plan has it, from its position and quaternion (w, x, y, z) in the tracker's frame."""
        at = _turned(self._matrix, position_mm)
        shift = self.translation_mm
        direction = _turned(self._matrix, _axis(quaternion))
        sign = self.coil_axis
        return CoilPose(
            (at[0] + shift[0], at[1] + shift[1], at[2] + shift[2]),
            (sign * direction[0], sign * direction[1], sign * direction[2]),
        )

    @cached_property
    def motion(self) -> RigidMotion | None:
        """The fit of the points again, with its errors; None where there are no points."""
        if not self.points:
            return None
        first, second = (np.array([pair[side] for pair in self.points]) for side in (0, 1))
        return register(first, second)

    @property
    def fre_mm(self) -> float:
        """Root mean square distance of the points from their partners; NaN without points."""
        return self.motion.fre_mm if self.motion else math.nan

    def tre_mm(self, target_mm: Vector) -> float:
        """Return the expected root mean square error at a target of the plan; NaN without points."""
        if self.motion is None:
            return math.nan
        back = np.array(self._matrix).T @ (np.array(target_mm) - np.array(self.translation_mm))
        return self.motion.tre_mm(back)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read a registration file. Raises DataError with every mistake of the file: key, value and rule."""
        source = os.fspath(path)
        try:
            content = Path(path).read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else "is not UTF-8 text"
            raise DataError(Mistake("", "", f"cannot be read: {reason}"), source) from error
        return cls.from_toml(content, source)

    @classmethod
    def from_toml(cls, content: str, source: str = "") -> Self:
        """Return what the text of a registration file says. Raises DataError with every mistake of the text."""
        values, mistakes = toml.parse(content)
        if not mistakes:
            try:
                found = cls(**values)
                if found.points:
                    found._require_points()
            except DataError as error:
                mistakes = list(error.mistakes)
            else:
                return found
        raise DataError(mistakes, source)

    def to_toml(self) -> str:
        """Return the text of a registration file that reads back as exactly this."""
        return toml.text(vars(self))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a registration file, whole or not at all. Raises OutputError."""
        write_whole(path, self.to_toml().encode())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the text, by which what is made with the registration names it."""
        return digest(self.to_toml())

    @cached_property
    def _matrix(self) -> tuple[Vector, Vector, Vector]:
        w, x, y, z = self.quaternion
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )

    def _require_points(self) -> None:
        """Raise DataError where quaternion and translation are not what the points say: a file edited by hand."""
        motion = self.motion
        assert motion is not None
        tracker, plan = (np.array([pair[side] for pair in self.points]) for side in (0, 1))
        here = tracker @ np.array(self._matrix).T + np.array(self.translation_mm)
        if np.abs(here - motion.apply(tracker)).max() > 1e-3:
            left = float(np.sqrt(((here - plan) ** 2).sum(axis=1).mean()))
            rule = f"must be what the points give: they are off by {left:.3g} mm, at best by {motion.fre_mm:.3g} mm"
            raise DataError(Mistake("frame.quaternion", shown(self.quaternion), rule))


def _turned(matrix: tuple[Vector, Vector, Vector], vector: Vector) -> Vector:
    a, b, c = vector
    (xa, xb, xc), (ya, yb, yc), (za, zb, zc) = matrix
    return (xa * a + xb * b + xc * c, ya * a + yb * b + yc * c, za * a + zb * b + zc * c)


def _axis(quaternion: tuple[float, float, float, float]) -> Vector:
    """Return where a rotation takes the z axis; quaternions of other lengths than 1 are normalised."""
    w, x, y, z = quaternion
    size = w * w + x * x + y * y + z * z
    return (2 * (x * z + w * y) / size, 2 * (y * z - w * x) / size, (w * w - x * x - y * y + z * z) / size)
