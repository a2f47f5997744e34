"""Loops of force and velocity: over that of the needle, over that against the tissue, and over that of the observer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from needleplan.models import LumpedOnTissue, simulate
from needleplan.plotting.canvas import BLUE, GREY, VERMILLION, title
from needleplan.signals import MovingAverage, Projection, Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_tissue_motion"]

_SKIPPED_S = 1.0


def draw_tissue_motion(
    figure: Figure, record: Record, model: LumpedOnTissue, projection: Projection | None, average: int
) -> None:
    """Draw a record with the fitted model; the last panel stays away where there is no slow observer."""
    motion, force = record.motion(), record["force_n"]
    done = simulate(model, motion)
    simulated = MovingAverage(average).apply(done.output)
    shown = motion.time_s - motion.time_s[0] >= _SKIPPED_S
    relative = motion.velocity_mm_s - done.states[2]
    panels = [
        (
            "velocity: needle (mm/s)",
            f"{record.trial}: measured and fitted".removeprefix(": "),
            motion.velocity_mm_s,
            simulated,
            force,
        ),
        ("against tissue (mm/s)", "less the fitted tissue", relative, simulated, force),
    ]
    if projection is not None:
        slow = projection.slow.observe(motion.depth_mm)
        late = projection.fast.normalised
        heading = f"alpha1 = {projection.slow.alpha1:.1f}"
        panels.append(("slow observer (mm/s)", heading, slow, late.apply(simulated), late.apply(force)))
    axes = np.atleast_1d(figure.subplots(1, len(panels), sharey=True))
    for each, (label, heading, velocity, fitted, measured) in zip(axes, panels, strict=True):
        each.axhline(0, color=GREY, linewidth=0.6)
        each.axvline(0, color=GREY, linewidth=0.6)
        each.plot(velocity[shown], measured[shown], ".", color=BLUE, markersize=1, alpha=0.4, label="measured")
        each.plot(velocity[shown], fitted[shown], color=VERMILLION, linewidth=1.0, label="fitted")
        each.set_xlabel(label)
        title(each, heading)
    axes[0].set_ylabel("axial force (N)")
    axes[0].legend(frameon=False, fontsize=8, loc="upper left")
