"""Insertions that do not belong to the others: in another frame or unit, shallow, or with wrong samples.

An insertion is compared with the medians of the others: its first point, the direction of its chord, and the sign of
its curvature. Real insertions through one guide differ by millimetres and some hundredths of a radian. The limits lie
far beyond, so that scatter between insertions is not taken for another frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needleplan.identification._curvature_trial import CurvatureTrial
from needleplan.signals import Array

__all__ = ["frame_remarks", "odd_remarks"]

# Distance (mm) of first points, and angle (rad) between chords, above which frames differ.
_ORIGIN_MM, _DIRECTION_RAD = 20.0, 0.35
# Lateral range of an insertion, relative to that of the others, below which its unit is in doubt.
_UNIT = 0.02
# Distance (rad of the length, and in units of the distances of the others) of an end from the median of the others.
_AWAY_RAD, _AWAY = 0.05, 5.0
# Length of an insertion relative to the others below which it limits the depth of the predicted tip.
_SHALLOW = 0.7
# Distance (mm, and in units of the median distance) of a sample from its path from which on it is an error.
_SPIKE_MM, _SPIKE = 2.0, 20.0
# Share of the points at either end of a path that give its first and its last point.
_END = 0.05


def frame_remarks(found: Sequence[CurvatureTrial]) -> list[str]:
    """Return a remark for every insertion that seems to be in another frame than the others.

    Of two insertions, both are named, because the data do not show which of them differs.
    """
    if len(found) < 2:
        return []
    starts, chords = (np.array(array) for array in zip(*(_ends(trial.points_mm) for trial in found), strict=True))
    angles = np.arctan2(chords[:, 1], chords[:, 0])
    sides = np.array([
        0 if trial.whole.low_per_mm <= 0 <= trial.whole.high_per_mm else np.sign(trial.whole.curvature_per_mm)
        for trial in found
    ])  # fmt: skip
    remarks = []
    for number, trial in enumerate(found):
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
                f"{trial.name or 'a trial'} {' and '.join(said)}: bring all trials to one frame, or leave it out; the "
                "means are not of one insertion"
            )
    return remarks


def _ends(points: Array) -> tuple[Array, Array]:
    """Return the first point of a path and the chord to its last point, shape (2,) each."""
    count = max(1, round(_END * len(points)))
    first, last = np.median(points[:count], axis=0), np.median(points[-count:], axis=0)
    return first, last - first


def odd_remarks(found: Sequence[CurvatureTrial]) -> list[str]:
    """Return a remark for every insertion in another unit, with another end, shallow, in one plane, or with spikes."""
    remarks = []
    for trial in found:
        apart = np.abs(trial.path.fitted.distances_mm)
        spikes = apart > max(_SPIKE_MM, _SPIKE * float(np.median(apart)))
        if spikes.any():
            remarks.append(
                f"{trial.name or 'a trial'}: {int(spikes.sum())} samples lie up to {apart.max():.0f} mm beside its "
                "path: errors of the tracker bend the fitted path; leave them out"
            )
    if len(found) < 3:
        return remarks
    ends = np.array([_end(each) for each in found])
    wide = np.array([np.ptp(each.points_mm[:, 1]) for each in found])
    deep = np.array([each.path.deepest_mm for each in found])
    for number, trial in enumerate(found):
        name, others = trial.name or "a trial", np.arange(len(found)) != number
        if wide[number] < _UNIT * np.median(wide[others]):
            remarks.append(
                f"{name} moves {wide[number]:.2g} mm sideways, the others {np.median(wide[others]):.2g} mm: in metres?"
            )
        if deep[number] < _SHALLOW * np.median(deep[others]):
            remarks.append(
                f"{name} ends at {deep[number]:.3g} mm, the others at {np.median(deep[others]):.3g} mm: it limits the "
                "depth at which the tip is predicted; leave it out, or set the depth (--predict-at, at_mm)"
            )
            continue
        middle = np.median(ends[others], axis=0)
        away = float(np.linalg.norm(ends[number] - middle))
        usual = float(np.median(np.linalg.norm(ends[others] - middle, axis=1)))
        if away > max(_AWAY_RAD * deep[number], _AWAY * usual):
            remarks.append(
                f"{name} ends {away:.0f} mm beside the others: another frame (axes exchanged?), or another series"
            )
    planar = [each.name or "a trial" for each in found if each.other_mm is None]
    if planar and len(planar) < len(found):
        remarks.append(f"not tracked in the other plane: {', '.join(planar)}; the tip is predicted in one plane only")
    return remarks


def _end(trial: CurvatureTrial) -> Array:
    """Return the last lateral position (mm) in both planes, shape (2,); 0 in a plane that was not tracked."""
    planes = [trial.points_mm, trial.other_mm]
    count = max(1, round(_END * len(trial.points_mm)))
    return np.array([0.0 if points is None else float(np.median(points[-count:, 1])) for points in planes])
