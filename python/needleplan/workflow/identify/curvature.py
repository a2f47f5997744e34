"""Curvature of insertions from tracked tips: each trial, whether they agree, and whether it changes with depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.estimation import Change, Curvature, Heterogeneity, TrackerNoise, agreement, path_curvature
from needleplan.estimation.circle import fit_circle
from needleplan.models import Bicycle, Estimate, Finding
from needleplan.signals import Array, Record, Role
from needleplan.workflow.identify.identification import Identification

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Insertion", "identify", "insertion_of"]

_POINTS_A_SEGMENT = 10
_BACK = 1.0
"""A trial is taken up to its greatest depth; it counts as drawn back from where it is this far (mm) above."""


@dataclass(frozen=True)
class Insertion:
    """One trial: its points (n, 2) in mm on the way in, its curvature, that of each segment, and the changes."""

    name: str
    points_mm: Array
    whole: Curvature
    segments: tuple[Curvature, ...]
    changes: tuple[Change, ...]
    remarks: tuple[str, ...]


def identify(
    records: Sequence[Record],
    *,
    segments: int = 2,
    plane: str = "xy",
    skip_mm: float = 0.0,
    noise: TrackerNoise = TrackerNoise.CORRELATED,
    correlation_mm: float | None = None,
) -> Identification:
    """Fit circles to the tip positions of insertions without rotation.

    Columns: time_s, x_mm (along the insertion; depth_mm where it is missing) and y_mm, or z_mm with `plane` "xz". The
    part from `skip_mm` to the greatest depth counts. Trials with the role noise are left out. `segments` equal parts
    of the path have a curvature each, to see whether it changes. Raises DataError for records that cannot be used.
    """
    if plane not in ("xy", "xz") or not 1 <= segments <= 10:
        raise DataError(Mistake("plane, segments", f"{plane}, {segments}", "must be xy or xz, and 1 to 10"))
    used = [record for record in records if record.role is not Role.NOISE]
    if not used:
        raise DataError(Mistake("role", "", "there is no trial to identify from"))
    options = {"segments": segments, "plane": plane, "skip_mm": skip_mm, "noise": noise}
    found = [insertion_of(record, correlation_mm=correlation_mm, **options) for record in used]  # type: ignore[arg-type]
    together = agreement([each.whole for each in found]) if len(found) > 1 else None
    estimate = _estimate(found[0].whole, together)
    remarks = [remark for each in found for remark in each.remarks]
    remarks += [f"{len(records) - len(used)} trials of noise were left out"] * (len(records) > len(used))
    remarks += _remarks(found, together, estimate)
    return Identification(
        "curvature", Bicycle(estimate.value), {"curvature_per_mm": estimate}, tuple(_scores(found, together)),
        tuple(_findings(found, together)), tuple(remarks), partial(_draw, found=found, plane=plane),
    )  # fmt: skip


def insertion_of(
    record: Record,
    *,
    segments: int = 2,
    plane: str = "xy",
    skip_mm: float = 0.0,
    noise: TrackerNoise = TrackerNoise.CORRELATED,
    correlation_mm: float | None = None,
) -> Insertion:
    """Return the curvature of one trial. Raises DataError, with the name of the trial."""
    points, remarks = _points(record, plane, skip_mm)
    options = {"noise": noise, "correlation_mm": correlation_mm}
    try:
        (whole,), _ = path_curvature(points, **options)  # type: ignore[arg-type]
        parts: tuple[Curvature, ...] = ()
        changes: tuple[Change, ...] = ()
        if segments > 1 and len(points) >= segments * _POINTS_A_SEGMENT:
            edges = np.linspace(0, whole.high_mm, segments + 1)[1:-1]
            parts, changes = path_curvature(points, edges, **options)  # type: ignore[arg-type]
        elif segments > 1:
            remarks.append(f"{len(points)} points are too few for {segments} segments")
    except DataError as error:
        raise DataError(error.mistakes, record.trial) from None
    prefix = f"{record.trial}: " if record.trial else ""
    return Insertion(record.trial, points, whole, parts, changes, tuple(prefix + each for each in remarks))


def _points(record: Record, plane: str, skip_mm: float) -> tuple[Array, list[str]]:
    """Return the points on the way in that count, and what was left out."""
    along = record["x_mm"] if "x_mm" in record.columns else record["depth_mm"]
    across = record["y_mm" if plane == "xy" else "z_mm"]
    depth = record.columns.get("depth_mm", along)
    remarks = list(record.notes)
    known = np.isfinite(along) & np.isfinite(across) & np.isfinite(depth)
    if not known.any():
        raise DataError(Mistake("y_mm", "", "has no number beside one of x_mm or depth_mm"), record.trial)
    deepest = int(np.argmax(np.where(known, depth, -np.inf)))
    way_in = np.arange(len(record)) <= deepest
    back = int((known & ~way_in & (depth < depth[deepest] - _BACK)).sum())
    if back:
        remarks.append(f"{back} samples after the greatest depth, drawn back, do not count")
    shallow = known & way_in & (depth < skip_mm)
    if shallow.any():
        remarks.append(f"{int(shallow.sum())} samples above {skip_mm:g} mm do not count")
    kept = known & (way_in | (depth >= depth[deepest] - _BACK)) & ~shallow
    return np.column_stack([along[kept], across[kept]]), remarks


def _estimate(first: Curvature, together: Heterogeneity | None) -> Estimate:
    if together is None:
        return Estimate(
            first.curvature_per_mm, first.sd_per_mm, first.low_per_mm, first.high_per_mm, "1/mm", first.bends
        )
    low, high = together.low_per_mm, together.high_per_mm
    return Estimate(together.mean_per_mm, (high - low) / 4, low, high, "1/mm", low > 0 or high < 0)


def _scores(found: Sequence[Insertion], together: Heterogeneity | None) -> list[tuple[str, float, str]]:
    scores: list[tuple[str, float, str]] = []
    for each in found:
        name = each.name or "trial"
        scores += [
            (f"{name}: curvature", each.whole.curvature_per_mm, "1/mm"),
            (f"{name}: lower end", each.whole.low_per_mm, "1/mm"),
            (f"{name}: upper end", each.whole.high_per_mm, "1/mm"),
            (f"{name}: radius", each.whole.radius_mm, "mm"),
            (f"{name}: RMS distance", each.whole.rms_mm, "mm"),
        ]
        scores += [
            (f"{name}: curvature {part.low_mm:.0f} to {part.high_mm:.0f} mm", part.curvature_per_mm, "1/mm")
            for part in each.segments
        ]
    if together:
        scores.append(("scatter between trials", together.between_sd_per_mm, "1/mm"))
    return scores


def _findings(found: Sequence[Insertion], together: Heterogeneity | None) -> list[Finding]:
    findings = []
    if together:
        says = (
            "the intervals of the trials agree with one curvature"
            if together.agree
            else "the trials do not have one curvature: they differ by more than their intervals"
        )
        findings.append(Finding("agreement of trials", together.q, together.p_value, says))
    for each in found:
        for number, change in enumerate(each.changes):
            place = each.segments[number].high_mm
            says = f"the curvature changes at {place:.0f} mm by {change.value_per_mm:.2g} 1/mm"
            if change.p_value >= 0.05:
                says = f"no change of the curvature at {place:.0f} mm was found"
            findings.append(Finding(f"change, {each.name}".rstrip(", "), change.value_per_mm, change.p_value, says))
    return findings


def _remarks(found: Sequence[Insertion], together: Heterogeneity | None, estimate: Estimate) -> list[str]:
    remarks = []
    if not estimate.identified:
        remarks.append("the interval of the curvature contains zero: a straight path is possible")
    if together is None:
        remarks.append("one insertion says nothing about the scatter between insertions: repeat it")
    elif not together.agree:
        remarks.append("the interval is that of the mean of such insertions; the next one may lie outside of it")
    far = [each.name for each in found if each.whole.correlation_mm > 0.2 * (each.whole.high_mm - each.whole.low_mm)]
    if far:
        remarks.append(
            f"errors correlated over more than a fifth of the path in {len(far)} trials ({', '.join(far)}): an arc may "
            "not be its shape, or the tracker's field is distorted"
        )
    return remarks


def _draw(figure: Figure, found: Sequence[Insertion], plane: str) -> None:
    from needleplan.workflow.figures.canvas import BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION, title

    colours = (BLUE, VERMILLION, GREEN, ORANGE, SKY, GREY)
    paths, left, bends = figure.subplots(3, 1, gridspec_kw={"height_ratios": (3, 2, 2)})
    for number, each in enumerate(found):
        colour = colours[number % len(colours)]
        circle = fit_circle(each.points_mm)
        order = np.argsort(each.points_mm[:, 0], kind="stable")
        x, y = each.points_mm[order].T
        distance = circle.distances(each.points_mm)[order]
        normal = (-np.sin(circle.heading_rad), np.cos(circle.heading_rad))
        paths.plot(x, y, ".", color=colour, markersize=3, alpha=0.6, label=each.name or "trial")
        paths.plot(x, y - distance * normal[1], "-", color=colour, linewidth=1)
        left.plot(x, distance, ".-", color=colour, markersize=3, linewidth=0.6)
        _draw_interval(bends, each.whole, number, colour)
    title(paths, f"Tip positions and fitted circles ({plane} plane)")
    paths.set_ylabel(f"{plane[1]} (mm)")
    if len(found) <= len(colours):
        paths.legend(fontsize=7, loc="best")
    title(left, "What the circle leaves")
    left.axhline(0, color=GREY, linewidth=0.8)
    left.set_xlabel("x (mm)")
    left.set_ylabel("distance (mm)")
    title(bends, "Curvature with 95 % interval")
    bends.axvline(0, color=GREY, linewidth=0.8)
    bends.set_yticks(range(len(found)), [each.name or "trial" for each in found], fontsize=7)
    bends.set_ylim(len(found) - 0.5, -0.5)
    bends.set_xlabel("curvature (1/mm)")


def _draw_interval(axes: object, bend: Curvature, row: int, colour: str) -> None:
    reach = [[bend.curvature_per_mm - bend.low_per_mm], [bend.high_per_mm - bend.curvature_per_mm]]
    axes.errorbar([bend.curvature_per_mm], [row], xerr=reach, fmt="o", color=colour, capsize=3)  # type: ignore[attr-defined]
