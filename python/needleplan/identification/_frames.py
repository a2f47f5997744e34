"""Insertions in different frames of coordinates: another origin, another direction, a flipped axis.

An insertion is compared with the medians of the others: its first point, the direction of its chord, and the sign of
its curvature. Real insertions through one guide differ by millimetres and some hundredths of a radian. The limits lie
far beyond, so that scatter between insertions is not taken for another frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needleplan.identification._curvature_trial import CurvatureTrial
from needleplan.signals import Array

__all__ = ["frame_remarks"]

# Distance (mm) of first points, and angle (rad) between chords, above which frames differ.
_ORIGIN_MM, _DIRECTION_RAD = 20.0, 0.35
# Share of the points at either end of a path that give its first and its last point.
_END = 0.05


def frame_remarks(found: Sequence[CurvatureTrial]) -> list[str]:
    """Return a remark for every insertion that seems to be in another frame than the others.

    With two insertions nothing says which of them differs; both are then named.
    """
    if len(found) < 2:
        return []
    starts, chords = (np.array(each) for each in zip(*(_ends(each.points_mm) for each in found), strict=True))
    angles = np.arctan2(chords[:, 1], chords[:, 0])
    sides = np.array([
        0 if each.whole.low_per_mm <= 0 <= each.whole.high_per_mm else np.sign(each.whole.curvature_per_mm)
        for each in found
    ])  # fmt: skip
    remarks = []
    for number, each in enumerate(found):
        others = np.arange(len(found)) != number
        said = []
        away = float(np.linalg.norm(starts[number] - np.median(starts[others], axis=0)))
        if away > _ORIGIN_MM:
            said.append(f"starts {away:.0f} mm away from the others (another origin?)")
        turned = float(np.median(np.angle(np.exp(1j * (angles[number] - angles[others])))))
        if abs(turned) > _DIRECTION_RAD:
            said.append(f"runs at {np.degrees(turned):.0f} degrees to the others (axes exchanged, flipped or rotated?)")
        elif sides[number] and (sides[others] == -sides[number]).all():
            said.append("bends to the other side than all others (an axis flipped, or the bevel turned?)")
        if said:
            remarks.append(
                f"{each.name or 'a trial'} {' and '.join(said)}: bring all trials to one frame, or leave it out; the "
                "means are not of one insertion"
            )
    return remarks


def _ends(points: Array) -> tuple[Array, Array]:
    """Return the first point of a path and the chord to its last point, shape (2,) each."""
    count = max(1, round(_END * len(points)))
    first, last = np.median(points[:count], axis=0), np.median(points[-count:], axis=0)
    return first, last - first
