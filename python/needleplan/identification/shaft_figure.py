"""The figure of an identified friction: loops of force and velocity, and what is left over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from needleplan.identification.shaft_models import Score
from needleplan.models import simulate
from needleplan.plotting.canvas import BLUE, GREEN, GREY, ORANGE, VERMILLION, title
from needleplan.signals import Array, Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_friction"]

_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE)


def draw_friction(
    figure: Figure, records: Sequence[Record], scores: Sequence[Score], mask: Callable[[Record], Array]
) -> None:
    """Draw the first record with the best model of each kind, and below what they leave of its force."""
    record, shown = records[0], _one_a_kind(scores)
    counts = mask(record)
    motion = record.motion()
    loops, left = figure.subplots(2, 1, gridspec_kw={"height_ratios": (3, 2)})
    loops.plot(motion.velocity_mm_s[counts], record["force_n"][counts], ".", color=GREY, markersize=1, alpha=0.5)
    for score, colour in zip(shown, _COLOURS, strict=False):
        force = simulate(score.fit.model, motion).output
        label = f"{score.candidate.label}, {1e3 * score.fit.rmse:.1f} mN"
        loops.plot(motion.velocity_mm_s[counts], force[counts], color=colour, linewidth=1.0, label=label)
    loops.set_xlabel("velocity (mm/s)")
    loops.set_ylabel("axial force (N)")
    loops.legend(frameon=False, fontsize=8, loc="upper left")
    title(loops, f"{record.trial}: friction and velocity".removeprefix(": "))
    best = scores[0]
    rest = 1e3 * (record["force_n"] - simulate(best.fit.model, motion).output)
    left.plot(motion.time_s, np.where(counts, rest, np.nan), color=_COLOURS[0], linewidth=0.5)
    left.axhline(0, color=GREY, linewidth=0.8)
    left.set_xlabel("time (s)")
    left.set_ylabel("measured - simulated (mN)")
    title(left, f"left by {best.candidate.label}")


def _one_a_kind(scores: Sequence[Score]) -> list[Score]:
    """Return the best score of each kind of model, best first."""
    kinds: dict[str, Score] = {}
    for each in scores:
        kinds.setdefault(each.candidate.label.split(",")[0], each)
    return list(kinds.values())[: len(_COLOURS)]
