"""The figure of `identify curvature`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from needleplan.identification._entry_population import MeanPath, TipPrediction
from needleplan.identification._insertion_path import trace
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from needleplan.identification._curvature_trial import CurvatureTrial
    from needleplan.identification._path_curvature import Curvature

__all__ = ["draw"]


def draw(
    figure: Figure, found: Sequence[CurvatureTrial], plane: str, mean: MeanPath, prediction: TipPrediction
) -> None:
    """Draw points, fitted arcs, curvatures, the mean path from the entry, and the region of the predicted tip."""
    colours = (BLUE, VERMILLION, GREEN, ORANGE, SKY, GREY)
    paths, left, bends = figure.subplots(3, 1, gridspec_kw={"height_ratios": (3, 2, 2)})
    for number, trial in enumerate(found):
        colour, path = colours[number % len(colours)], trial.path
        x, y = trial.points_mm.T
        along = np.linspace(path.first_mm, path.deepest_mm, 100)
        fitted_x, fitted_y, _ = trace(path.shape, path.x_mm, path.values, along)
        paths.plot(x, y, ".", color=colour, markersize=3, alpha=0.6, label=trial.name or "trial", rasterized=True)
        paths.plot(fitted_x, fitted_y, "-", color=colour, linewidth=1)
        left.plot(x, path.fitted.distances_mm, ".", color=colour, markersize=3, alpha=0.6)
        _draw_interval(bends, trial.whole, number, colour)
    along = np.linspace(0.0, prediction.depth_mm, 60)
    x, y, _ = trace(mean.shape, mean.x_mm, mean.values, along)
    paths.plot(
        x, y, "--", color=BLACK, linewidth=1.2, label=f"mean path, entry heading {1e3 * mean.values[1]:.0f} mrad"
    )
    low, high = prediction.y_region_mm
    reach = [[prediction.y_mm - low], [high - prediction.y_mm]]
    label = "predicted tip, 95 %"
    paths.errorbar([prediction.x_mm], [prediction.y_mm], reach, color=BLACK, capsize=4, label=label)
    title(paths, f"Tip positions and fitted arcs ({plane} plane)")
    paths.set_ylabel(f"{plane[1]} (mm)")
    paths.set_xlabel("x (mm)")
    if len(found) <= len(colours):
        paths.legend(frameon=False, fontsize=8, loc="upper left")
    title(left, "Distance of the points from the arc of their trial")
    left.axhline(0, color=GREY, linewidth=0.8)
    left.set_xlabel("x (mm)")
    left.set_ylabel("distance (mm)")
    title(bends, "Curvature with 95 % interval")
    if any(each.whole.low_per_mm <= 0 <= each.whole.high_per_mm for each in found):
        bends.axvline(0, color=GREY, linewidth=0.8)
    bends.set_yticks(range(len(found)), [each.name or "trial" for each in found], fontsize=7)
    bends.set_ylim(len(found) - 0.5, -0.5)
    bends.ticklabel_format(axis="x", style="sci", scilimits=(-2, 3), useMathText=True)
    bends.set_xlabel("curvature (1/mm)")


def _draw_interval(axes: object, bend: Curvature, row: int, colour: str) -> None:
    reach = [[bend.curvature_per_mm - bend.low_per_mm], [bend.high_per_mm - bend.curvature_per_mm]]
    axes.errorbar([bend.curvature_per_mm], [row], xerr=reach, fmt="o", color=colour, capsize=3)  # type: ignore[attr-defined]
