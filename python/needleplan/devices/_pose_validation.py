"""Validation of tracker poses, common to all tracker protocols."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from needleplan.devices._base import Health, PoseSample, Stamp

__all__ = ["PoseValidator"]

_FARTHEST_MM = 1e5  # largest coordinate of a coil; larger numbers are not a pose
_NAN = math.nan

_Triple = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]


class PoseValidator:
    """Base class that converts the poses of one tool to samples and compares each pose with the previous one.

    A sample with notes is SUSPECT. The subclass of each protocol also checks status fields and times, and stores each
    sample in `last`.
    """

    def __init__(self) -> None:
        self.last: PoseSample | None = None

    @staticmethod
    def are_plausible(numbers: Iterable[float]) -> bool:
        """Return whether all `numbers` of a pose are finite and at most 1e5 (100 m if they are lengths in mm)."""
        return all(math.isfinite(each) and abs(each) <= _FARTHEST_MM for each in numbers)

    @staticmethod
    def missing(stamp: Stamp, reason: str, notes: tuple[str, ...]) -> PoseSample:
        """Return a MISSING sample, with `reason` as its first note; position, quaternion and error are NaN."""
        return PoseSample(stamp, (_NAN,) * 3, (_NAN,) * 4, _NAN, Health.MISSING, (reason, *notes))

    def sample(
        self,
        stamp: Stamp,
        position_mm: _Triple,
        quaternion: _Quaternion,
        error_mm: float,
        notes: tuple[str, ...],
        most_step_mm: float,
    ) -> PoseSample:
        """Return the sample of a pose: GOOD without `notes`, else SUSPECT.

        The sample gets a further note if its position is more than `most_step_mm` from the last position. The
        quaternions q and -q describe the same rotation; the sample gets the quaternion closer to the last one. Without
        a last pose, or if the last sample is MISSING, nothing is compared.
        """
        last = None if self.last is None or self.last.health is Health.MISSING else self.last
        if last is not None:
            step_mm = math.dist(position_mm, last.position_mm)
            if step_mm > most_step_mm:
                notes += (f"a step of {step_mm:.3g} mm",)
        health = Health.SUSPECT if notes else Health.GOOD
        found = PoseSample(stamp, position_mm, quaternion, error_mm, health, notes)
        if last is None or math.fsum(map(float.__mul__, quaternion, last.quaternion)) >= 0:
            return found
        w, x, y, z = (-each for each in quaternion)
        return replace(found, quaternion=(w, x, y, z))
