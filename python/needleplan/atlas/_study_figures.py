"""Figures of the studies of an atlas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.atlas._studies import (
    GOALS,
    EntryMapOfAtlas,
    ParameterEffect,
    QuantityMap,
    WrongParameter,
)
from needleplan.atlas._study_rules import QUANTITIES
from needleplan.plotting.canvas import BLUE, GREY, ORANGE, legend_below, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from needleplan.atlas._atlas import AtlasEntry

__all__ = ["draw_entry_map", "draw_pareto", "draw_quantity_map", "draw_sensitivities", "draw_wrong_parameters"]

# Largest number of cells of a map along one axis in which numbers are written.
_MOST_NUMBERED = 12
# Width and height of a figure in inches.
_SIZE = (6.4, 4.4)


def draw_quantity_map(study: QuantityMap, x: str, y: str, quantity: str) -> Figure:
    """Draw a quantity over two parameters, with the number in each cell if there are few."""
    figure, axes = _figure()
    image = _cells(axes, study.values, study.x, study.y, quantity)
    axes.set_xlabel(_axis_title(x))
    axes.set_ylabel(_axis_title(y))
    if len(study.x) <= _MOST_NUMBERED and len(study.y) <= _MOST_NUMBERED:
        _numbers(axes, study.values, image)
    figure.colorbar(image, ax=axes, label=QUANTITIES[quantity])
    title(axes, QUANTITIES[quantity].capitalize())
    return figure


def draw_entry_map(study: EntryMapOfAtlas, parameter: str, edge: str) -> Figure:
    """Draw the success of the best heading over the entry position and one parameter."""
    figure, axes = _figure()
    along = "y" if edge in ("left", "right") else "x"
    step = study.position_mm[1] - study.position_mm[0] if len(study.position_mm) > 1 else 1.0
    extent = (study.position_mm[0] - step / 2, study.position_mm[-1] + step / 2, -0.5, len(study.levels) - 0.5)
    image = axes.imshow(study.success, origin="lower", aspect="auto", extent=extent, cmap="viridis", vmin=0, vmax=1)
    axes.set_xlabel(f"entry on the {edge} edge, {along} (mm)")
    axes.set_ylabel(_axis_title(parameter))
    _ticks(axes.yaxis, study.levels)
    figure.colorbar(image, ax=axes, label="success probability, best heading")
    title(axes, "Success over the entry")
    return figure


def draw_pareto(entries: Sequence[AtlasEntry], front: Sequence[AtlasEntry]) -> Figure:
    """Draw success over each other goal, with the tables that no other table beats."""
    from matplotlib.figure import Figure

    others = [name for name in GOALS if name != "success"]
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(others), sharey=True))
    for axes, name in zip(panels, others, strict=True):
        for group, color, label, order in ((entries, GREY, "all tables", 2), (front, BLUE, "not beaten", 3)):
            points = [
                (each.record[name], each.record["success"]) for each in group if each.record and each.record["reached"]
            ]
            known = [point for point in points if None not in point]
            axes.plot(*np.reshape(known, (-1, 2)).T, "o", color=color, markersize=4 + order, label=label, zorder=order)
        axes.set_xlabel(QUANTITIES[name] + (" →" if GOALS[name] > 0 else " ←"))
        axes.grid(visible=True, alpha=0.3)
    panels[0].set_ylabel("success probability →")
    legend_below(panels[0])
    title(panels[0], "Trade-off (arrows: better)")
    return figure


def draw_sensitivities(effects: Sequence[ParameterEffect], quantity: str) -> Figure:
    """Draw the share of each parameter in the variance of a quantity, with the range of its main effect."""
    figure, axes = _figure()
    names = [each.name for each in effects][::-1]
    shares = [100 * each.share for each in effects][::-1]
    bars = axes.barh(names, shares, color=BLUE)
    axes.bar_label(bars, [f" range {each.effect:.3g}" for each in effects][::-1])
    axes.set_xlim(0, max([*shares, 1.0]) * 1.3)
    axes.set_xlabel(f"share of the variance (%), {QUANTITIES[quantity]}")
    title(axes, f"Sensitivity; interactions and rest: {max(0.0, 100 - sum(shares)):.0f} %")
    return figure


def draw_wrong_parameters(found: Sequence[WrongParameter], planned: str) -> Figure:
    """Draw the realised success of one plan beside that of the right plan, for each true scenario."""
    figure, axes = _figure()
    right, wrong = [each.replanned for each in found], [each.success for each in found]
    axes.plot([0, 1], [0, 1], color=GREY, linewidth=1)
    axes.plot(right, wrong, "o", color=ORANGE)
    axes.set_xlim(-0.02, 1.02)
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("realised success of the plan for the true values")
    axes.set_ylabel("realised success of the plan for the wrong values")
    title(axes, f"Planned for {planned}")
    return figure


def _figure() -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE, layout="constrained")
    return figure, figure.subplots()


def _cells(axes: Axes, values: Any, x: Sequence[Any], y: Sequence[Any], quantity: str) -> Any:
    limits: dict[str, Any] = {"vmin": 0.0, "vmax": 1.0} if quantity.endswith("success") else {}
    image = axes.imshow(values, origin="lower", aspect="auto", cmap="viridis", **limits)
    _ticks(axes.xaxis, x)
    _ticks(axes.yaxis, y)
    return image


def _ticks(axis: Any, levels: Sequence[Any]) -> None:
    every = max(1, -(-len(levels) // _MOST_NUMBERED))
    places = range(0, len(levels), every)
    axis.set_ticks(list(places), [_level(levels[place]) for place in places])


def _numbers(axes: Axes, values: Any, image: Any) -> None:
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            dark = image.norm(value) < 0.6
            axes.text(column, row, f"{value:.2f}" if abs(value) < 10 else f"{value:.0f}",
                      ha="center", va="center", fontsize=8, color="white" if dark else "black")  # fmt: skip


def _level(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_level, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _axis_title(name: str) -> str:
    """Return the title of an axis: the name of a parameter, with its unit in brackets."""
    for ending, unit in (("_per_mm", "1/mm"), ("_mm", "mm"), ("_deg", "degrees"), ("_rad", "rad")):
        if name.endswith(ending):
            return f"{name.removesuffix(ending).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")
