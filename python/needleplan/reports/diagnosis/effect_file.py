"""An effect file: Python source of an effect with the shape of an unexplained gap, to be completed by the user."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from needleplan.diagnosis import Curve, Curves, GapAxis
from needleplan.signals import Array

__all__ = ["effect_file_text"]

# Argument of `drawn` that holds the variable of an axis.
_VARIABLES = {
    GapAxis.TIME: "time_s", GapAxis.DEPTH: "depth_mm", GapAxis.SPEED: "abs(velocity_mm_s)", GapAxis.FORCE: "force_n",
    GapAxis.DWELL: "dwell_s", GapAxis.PERIOD: "depth_mm", GapAxis.ACCELERATION: "acceleration_mm_s2",
}  # fmt: skip

# Share of the variance of the curves about cubic polynomials from which a wave describes a gap along the position.
_WAVE_SHARE = 0.5
# Powers of these polynomials, and number of periods that a wave has at least within the visited range.
_POWERS, _LEAST_PERIODS = range(4), 2
# Share of the energy of the curves below which the polynomials describe them exactly.
_EXACT = 1e-9
# Shortest period of a wave, in intervals between the nodes of a curve, and number of frequencies tried per 1/range.
_NODES_OF_PERIOD, _FINER = 3.0, 40

# Factor in `drawn` that is 1 while the needle moves in this way, else 0; for a way not listed: 1 at rest.
_WAYS = {"advance": "(sign > 0)", "retraction": "(sign < 0)", "any": "1.0"}


_TEMPLATE = Path(__file__).with_name("effect_draft.txt")


def effect_file_text(course: Curves, name: str = "my_effect") -> str:
    """Return Python source of the effect `name` with the shape of a gap: a wave of the position, or a table of curves.

    A gap along the position that is no single wave is a table too.
    """
    axis = course.axis.label
    wave = _wave(course) if course.axis is GapAxis.PERIOD else None
    if wave:
        amplitude, period_mm, phase_rad = wave
        what = f"a wave of the position with a period of {period_mm:.4g} mm"
        description = (
            f"The gap is {what} and an amplitude of {amplitude:.3g} N.\n"
            "A screw, a gear or a guide may cause it."
        )  # fmt: skip
        phase = f"{'-' if phase_rad < 0 else '+'} {abs(phase_rad):.4g}"
        expression = f"{math.sqrt(2):.6g} * sin(2 * pi * position_mm / {period_mm:.6g} {phase})"
        size = amplitude / math.sqrt(2)
    else:
        what = f"a table along the {axis}"
        description = f"The gap depends on the {axis}. The table below is its curve within the visited range."
        expression, size = _table(course.axis, course, course.rms), course.rms
    return _TEMPLATE.read_text(encoding="utf-8").format(
        description=description,
        expression=expression,
        name=json.dumps(name),
        typical=float(f"{size:.3g}"),
        axis=f"the {axis}",
        equation=json.dumps(f"{what}, see drawn"),
    )


def _wave(curves: Curves) -> tuple[float, float, float] | None:
    """Return amplitude (N), period (mm) and phase (rad) of the wave that fits all curves of a gap best.

    Each curve has its own cubic polynomial beside the wave: an error of the base model. Returns None if the wave
    explains less than half of the variance about these polynomials.
    """
    kept = [curve for curve in curves.curves if curve.inside.sum() > 2 * _NODES_OF_PERIOD]
    if not kept:
        return None
    places = np.concatenate([each.places[each.inside] for each in kept])
    values = np.concatenate([each.mean[each.inside] for each in kept])
    weights = 1 / np.maximum(np.concatenate([each.sd[each.inside] for each in kept]), 1e-12)
    which = np.repeat(np.arange(len(kept)), [int(each.inside.sum()) for each in kept])
    middle, half = (places.max() + places.min()) / 2, np.ptp(places) / 2
    smooth = [
        mask * ((places - middle) / half) ** power
        for mask in which == np.arange(len(kept))[:, None]
        for power in _POWERS
    ]
    span, apart = float(np.ptp(places)), float(kept[0].places[1] - kept[0].places[0])

    def fitted(columns: Sequence[Array]) -> tuple[float, Array]:
        table = np.column_stack(columns) * weights[:, None]
        found = np.linalg.lstsq(table, values * weights, rcond=None)[0]
        return float(np.sum((values * weights - table @ found) ** 2)), found

    alone, _ = fitted(smooth)
    if alone <= _EXACT * float(np.sum((values * weights) ** 2)):
        return None
    best: tuple[float, float, Array] | None = None
    for per_mm in np.arange(_LEAST_PERIODS / span, 1 / (_NODES_OF_PERIOD * apart), 1 / (_FINER * span)):
        angle = 2 * math.pi * places * per_mm
        left, found = fitted([np.sin(angle), np.cos(angle), *smooth])
        if best is None or left < best[0]:
            best = left, float(per_mm), found
    if best is None or best[0] > (1 - _WAVE_SHARE) * alone:
        return None
    sine, cosine = best[2][:2]
    return math.hypot(sine, cosine), 1 / best[1], math.atan2(cosine, sine)


def _table(axis: GapAxis, curves: Curves, rms: float) -> str:
    parts = [_part(axis, curve, rms) for curve in curves.curves if curve.inside.any()]
    return "(\n        " + "\n        + ".join(parts or ["0.0 * depth_mm"]) + "\n    )"


def _part(axis: GapAxis, curve: Curve, rms: float) -> str:
    places = [float(f"{each:.5g}") for each in curve.places[curve.inside]]
    values = [float(f"{each / rms:.4g}") for each in curve.mean[curve.inside]]
    way = _WAYS.get(curve.way, "(dwell_s > 0)")
    return f"{way} * interp({_VARIABLES[axis]}, {places}, {values})"
