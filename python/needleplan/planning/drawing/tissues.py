"""Layers and tissues of a scenario, tinted by the radius that the needle has there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from needleplan.plotting.canvas import GREY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from needleplan.scenario import Scenario, Tissue

__all__ = ["draw_tissues"]

_PALEST, _DEEPEST = 0.06, 0.36
_NARROW, _LOW = 0.12, 0.1
"""Shares of the width and height of the workspace below which a label does not fit across a layer or below a region."""

_STYLE: Any = {"ha": "center", "fontsize": 7, "color": "#5c4a2f", "zorder": 2, "clip_on": True}


def draw_tissues(axes: Axes, scenario: Scenario, *, on_colour: bool = False) -> None:
    """Tint layers and regions, the deeper the smaller the radius, and label them; `on_colour`: borders only.

    Where the radius is the same everywhere, nothing is drawn.
    """
    from matplotlib import colormaps

    if scenario.uniform:
        return
    layers = list(_layers(scenario))
    radii = sorted({radius for *_, radius in layers} | {tissue.curvature_radius_mm for tissue in scenario.tissues})

    def tint(radius_mm: float) -> Any:
        share = 1 - radii.index(radius_mm) / max(len(radii) - 1, 1)
        return colormaps["YlOrBr"](_PALEST + (_DEEPEST - _PALEST) * share)

    width, height = scenario.workspace.width_mm, scenario.workspace.height_mm
    for low, high, radius in layers:
        if on_colour:
            axes.plot([low, low], [0, height], color="white", linewidth=0.8, linestyle="--", zorder=2)
        else:
            axes.axvspan(low, high, facecolor=tint(radius), edgecolor="none", zorder=0)
            upright = 90 if high - low < _NARROW * width else 0
            axes.text((low + high) / 2, 0.97 * height, _label(radius), va="top", rotation=upright, **_STYLE)
    for tissue in scenario.tissues:
        _draw_region(axes, tissue, "none" if on_colour else tint(tissue.curvature_radius_mm))
        if not on_colour:
            x, y = zip(*tissue.polygon_mm, strict=True)
            below = min(y) > _LOW * height
            name = ", ".join(filter(None, (tissue.name, _label(tissue.curvature_radius_mm))))
            place = min(y) - 0.01 * height if below else max(y) + 0.01 * height
            axes.text((min(x) + max(x)) / 2, place, name, va="top" if below else "bottom", **_STYLE)


def _layers(scenario: Scenario) -> Iterator[tuple[float, float, float]]:
    """Yield from where to where, mm, the tissue has which radius, that before the first layer too."""
    needle = scenario.needle
    starts = [0.0, *(layer.from_mm for layer in needle.layers)]
    radii = [needle.curvature_radius_mm, *(layer.curvature_radius_mm for layer in needle.layers)]
    for low, high, radius in zip(starts, [*starts[1:], scenario.workspace.width_mm], radii, strict=True):
        if low < high:
            yield low, high, radius


def _draw_region(axes: Axes, tissue: Tissue, face: Any) -> None:
    from matplotlib.patches import Polygon

    edge = "white" if face == "none" else GREY
    style: Any = {"facecolor": face, "edgecolor": edge, "linewidth": 0.8, "linestyle": "--", "zorder": 1}
    axes.add_patch(Polygon(list(tissue.polygon_mm), **style))


def _label(radius_mm: float) -> str:
    return f"R {radius_mm:.4g} mm"
