"""Draw a scenario: obstacles, target, and layers and tissues filled with a darker colour the smaller their radius."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Protocol

from needleplan.plotting.canvas import BLACK, GREY, VERMILLION, axes_in_mm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

    from needleplan.scenario._obstacle import Obstacle
    from needleplan.scenario._parts import Needle, Target, Tissue, Workspace
    from needleplan.scenario._shape import Shaped

__all__ = ["Scene", "draw_scene"]

# Positions (0 to 1) in the colour map for the largest and the smallest radius.
_PALEST, _DEEPEST = 0.06, 0.36

# Share of the workspace's width below which the label of a layer is rotated by 90 degrees.
_NARROW = 0.12

# Share of the workspace's height below which the label of a region is written above it.
_LOW = 0.1

_LABEL: Any = {"ha": "center", "fontsize": 7, "color": "#5c4a2f", "zorder": 2, "clip_on": True}


class Scene(Protocol):
    """Protocol: the parts of a scenario that `draw_scene` draws."""

    @property
    def workspace(self) -> Workspace:
        """Rectangle that the tip must not leave."""

    @property
    def target(self) -> Target:
        """Disc that the tip must reach."""

    @property
    def needle(self) -> Needle:
        """Needle with its layers."""

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Regions that the tip must not touch."""

    @property
    def tissues(self) -> tuple[Tissue, ...]:
        """Regions in which the needle's arc has another radius."""


def draw_scene(axes: Axes, scene: Scene, *, on_map: bool = False) -> None:
    """Draw workspace, layers, tissues, obstacles and target.

    If `on_map`, layers and tissues are drawn as outlines without fill and labels, so that a map below stays visible.
    """
    from matplotlib.patches import Circle

    axes_in_mm(axes, scene.workspace)
    face = "white" if on_map else "#d0d0d0"
    for obstacle in scene.obstacles:
        axes.add_patch(_patch(obstacle, facecolor=face, edgecolor=BLACK, linewidth=0.9, zorder=3))
    if scene.needle.layers or scene.tissues:
        _draw_tissues(axes, scene, on_map)
    target = scene.target
    axes.add_patch(
        Circle(target.center_mm, target.radius_mm, facecolor="none", edgecolor=VERMILLION, linewidth=1.8, zorder=6)
    )
    if not on_map:
        ring = {"markerfacecolor": "none", "markeredgecolor": VERMILLION, "markersize": 8, "markeredgewidth": 1.8}
        label = f"target, radius {target.radius_mm:.3g} mm"
        axes.plot([], [], linestyle="none", marker="o", label=label, **ring)  # type: ignore[arg-type]


def _patch(shape: Shaped, **style: Any) -> Patch:
    """Return the patch of an obstacle, with its margin, or of a tissue; holes stay open."""
    from matplotlib.patches import PathPatch, Polygon
    from matplotlib.path import Path

    if shape.polygon_mm and not shape.holes_mm and not shape.reach_mm:
        return Polygon(list(shape.polygon_mm), **style)
    region = shape.region()
    parts = getattr(region, "geoms", [region])
    rings = [ring for part in parts for ring in (part.exterior, *part.interiors)]
    return PathPatch(Path.make_compound_path(*(Path(list(ring.coords), closed=True) for ring in rings)), **style)


def _draw_tissues(axes: Axes, scene: Scene, on_map: bool) -> None:
    """Fill and label layers and tissues, darker for smaller radii. If `on_map`, draw only their borders, in white."""
    from matplotlib import colormaps

    layers = list(_layers(scene))
    radii = sorted({radius for *_, radius in layers} | {tissue.curvature_radius_mm for tissue in scene.tissues})

    def tint(radius_mm: float) -> Any:
        share = 1 - radii.index(radius_mm) / max(len(radii) - 1, 1)
        return colormaps["YlOrBr"](_PALEST + (_DEEPEST - _PALEST) * share)

    width, height = scene.workspace.width_mm, scene.workspace.height_mm
    for low, high, radius in layers:
        if on_map:
            axes.plot([low, low], [0, height], color="white", linewidth=0.8, linestyle="--", zorder=2)
        else:
            axes.axvspan(low, high, facecolor=tint(radius), edgecolor="none", zorder=0)
            upright = 90 if high - low < _NARROW * width else 0
            axes.text((low + high) / 2, 0.97 * height, _label(radius), va="top", rotation=upright, **_LABEL)
    for tissue in scene.tissues:
        _draw_region(axes, tissue, "none" if on_map else tint(tissue.curvature_radius_mm))
        if not on_map:
            left, bottom, right, top = tissue.region().bounds
            below = bottom > _LOW * height
            name = ", ".join(filter(None, (tissue.name, _label(tissue.curvature_radius_mm))))
            place = bottom - 0.01 * height if below else top + 0.01 * height
            axes.text((left + right) / 2, place, name, va="top" if below else "bottom", **_LABEL)


def _layers(scene: Scene) -> Iterator[tuple[float, float, float]]:
    """Yield first x, last x and radius (mm) of each layer that is not empty, from the entry on.

    The part of the workspace in front of the first layer comes first, with the radius of the needle.
    """
    needle = scene.needle
    starts = [0.0, *(layer.from_mm for layer in needle.layers)]
    radii = [needle.curvature_radius_mm, *(layer.curvature_radius_mm for layer in needle.layers)]
    for low, high, radius in zip(starts, [*starts[1:], scene.workspace.width_mm], radii, strict=True):
        if low < high:
            yield low, high, radius


def _draw_region(axes: Axes, tissue: Tissue, face: Any) -> None:
    edge = "white" if face == "none" else GREY
    style: Any = {"facecolor": face, "edgecolor": edge, "linewidth": 0.8, "linestyle": "--", "zorder": 1}
    axes.add_patch(_patch(tissue, **style))


def _label(radius_mm: float) -> str:
    return f"R {radius_mm:.4g} mm"
