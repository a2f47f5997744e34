"""The figure of `needleplan identify deflection`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from needleplan.identification.bent_path import PathFit
from needleplan.models import Fit, simulate
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION, title
from needleplan.signals import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw"]

_COLOURS = (BLUE, ORANGE, GREEN, VERMILLION, SKY, BLACK)


def draw(
    figure: Figure, paths: Sequence[PathFit], axial: Fit | None, records: Sequence[Record], skip_mm: float
) -> None:
    """Draw measured and fitted deflection, what is left, and measured and fitted axial force where there is one."""
    panels = figure.subplots(3 if axial else 2, 1, sharex=True, squeeze=False)[:, 0]
    for path, colour in zip(paths, _COLOURS * len(paths), strict=False):
        motion, y = path.record.motion(), path.record["y_mm"]
        panels[0].plot(motion.depth_mm, y, ".", color=colour, markersize=2, alpha=0.5, rasterized=True)
        panels[0].plot(
            motion.depth_mm, simulate(path.model, motion).output, color=colour, label=path.record.trial or "fit"
        )
        panels[1].plot(motion.depth_mm, 1000 * path.fit.residuals[0], ".", color=colour, markersize=2)
    for axes in panels:
        axes.axvspan(0, skip_mm, color="#f0f0f0", zorder=0)
    panels[1].axhline(0, color=GREY, linewidth=0.8)
    panels[0].set_ylabel("lateral (mm)")
    panels[1].set_ylabel("measured - fitted (um)")
    title(panels[0], "Deflection: points measured, lines fitted; the entry (grey) does not count")
    if len(paths) <= len(_COLOURS):
        panels[0].legend(frameon=False, fontsize=8)
    if axial:
        for record, colour in zip(records, _COLOURS * len(records), strict=False):
            motion = record.motion()
            panels[2].plot(motion.depth_mm, record["force_n"], ".", color=colour, markersize=2, alpha=0.5)
            order = np.argsort(motion.depth_mm)
            panels[2].plot(motion.depth_mm[order], simulate(axial.model, motion).output[order], color=colour)
        panels[2].set_ylabel("axial force (N)")
    panels[-1].set_xlabel("depth (mm)")
    panels[-1].set_xlim(left=0)
