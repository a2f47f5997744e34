"""Figures of the studies of a table set."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from needleplan.plotting.canvas import BLACK, BLUE, GREY, ORANGE, legend_below
from needleplan.sweep._studies import (
    GOALS,
    ParameterEffect,
    QuantityMap,
    TableSetEntryMap,
    WrongParameter,
)
from needleplan.sweep._study_axes import CellAxis, axis_title, cell_axis, heading, level_text
from needleplan.sweep._study_rules import QUANTITIES, key_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from needleplan.sweep._table_set import TableSet, TableSetEntry

__all__ = ["draw_entry_map", "draw_pareto", "draw_quantity_map", "draw_sensitivities", "draw_wrong_parameters"]

# Width and height of a figure in inches.
_SIZE = (6.4, 4.4)
# Width of a letter and height of a line of the labels, as shares of the width and the height of the axes of `_SIZE`.
_LETTER, _LINE = 0.019, 0.055
# Smallest width and height of a cell, as shares of the axes, in which its number is written.
_NUMBER_WIDTH, _NUMBER_HEIGHT = 5 * _LETTER * 0.8, 0.05
# Angle (degrees) of texts along x that are too long to be written level.
_SLANT_DEG = 30
# Colour of cells without a table.
_EMPTY = "#eeeeee"
# Letters of a title per inch of a figure, and of the name of a parameter beside its bar.
_TITLE_LETTERS, _NAME_LETTERS = 12, 22
# Largest number of tables in the figure of a wrong plan: those with the largest loss. A row is this high (inches).
_MOST_ROWS, _ROW_INCHES = 24, 0.24


def draw_quantity_map(
    study: QuantityMap, x: str, y: str, quantity: str = "success", *, table_set: TableSet | None = None
) -> Figure:
    """Draw a quantity over two parameters, with the number in each cell that has room for it.

    Cells lie at the values of the parameters; cells of tables that are not made are empty.

    Parameters
    ----------
    study : QuantityMap
        Result of `quantity_map`.
    x : str
        Name of the parameter along the columns.
    y : str
        Name of the parameter along the rows.
    quantity : str, default "success"
        Name of the quantity, a key of `QUANTITIES`.
    table_set : TableSet, optional
        The table set that was studied. With it, the figure shows the title of the sweep, the number of tables, and the
        titles and units of the parameters; without it, the parameters are named as given.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = _figure()
    image = _cells(axes, study.values, study.x, study.y, quantity)
    axes.set_xlabel(axis_title(x, table_set))
    axes.set_ylabel(axis_title(y, table_set))
    figure.colorbar(image, ax=axes, label=QUANTITIES[quantity])
    used = int(np.isfinite(study.values).sum())
    _headline(figure, heading(QUANTITIES[quantity].capitalize(), table_set, used, f"without {quantity}"))
    return figure


def draw_entry_map(study: TableSetEntryMap, parameter: str, edge: str, *, table_set: TableSet | None = None) -> Figure:
    """Draw the success of the best heading over entry position and one parameter.

    The row of a value lies at this value and ends in the middle between two values.

    Parameters
    ----------
    study : TableSetEntryMap
        Result of `entry_map`.
    parameter : str
        Name of the parameter.
    edge : str
        Edge of the workspace with the entries: left, right, bottom or top.
    table_set : TableSet, optional
        The table set that was studied, for title and units, as in `draw_quantity_map`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = _figure()
    along = "y" if edge in ("left", "right") else "x"
    rows = cell_axis(study.levels)
    columns = cell_axis(study.position_mm.tolist())
    image = axes.pcolormesh(columns.edges, rows.edges, study.success, cmap="viridis", vmin=0, vmax=1)
    axes.set_xlabel(f"entry on the {edge} edge, {along} (mm)")
    axes.set_ylabel(axis_title(parameter, table_set))
    _scale_y(axes, rows)
    figure.colorbar(image, ax=axes, label="success probability, best heading")
    _headline(figure, heading("Success over the entry", table_set, len(study.levels)))
    return figure


def draw_pareto(
    entries: Sequence[TableSetEntry], front: Sequence[TableSetEntry], *, table_set: TableSet | None = None
) -> Figure:
    """Draw success over every other goal, and mark the tables that no other table beats.

    Parameters
    ----------
    entries : sequence of TableSetEntry
        All tables.
    front : sequence of TableSetEntry
        Result of `pareto_front`.
    table_set : TableSet, optional
        The table set that was studied, for title and units, as in `draw_quantity_map`.

    Returns
    -------
    matplotlib.figure.Figure
        One panel for each goal that a table has, besides success.
    """
    from matplotlib.figure import Figure

    reached = [entry for entry in entries if entry.record and entry.record["reached"]]
    others = [
        name
        for name in GOALS
        if name != "success" and any((entry.record or {}).get(name) is not None for entry in reached)
    ]
    figure = Figure(figsize=(3.2 * max(len(others), 2), 3.8), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(others), sharey=True))
    known = [entry for entry in reached if all((entry.record or {}).get(name) is not None for name in others)]
    for axes, name in zip(panels, others, strict=True):
        for group, color, label, order in ((known, GREY, "all tables", 2), (front, BLUE, "not beaten", 3)):
            x, y = ([float((entry.record or {})[key]) for entry in group] for key in (name, "success"))
            axes.plot(x, y, "o", color=color, markersize=4 + order, label=label, zorder=order)
        axes.set_xlabel(QUANTITIES[name] + (" →" if GOALS[name] > 0 else " ←"))
        axes.grid(visible=True, alpha=0.3)
    panels[0].set_ylabel("success probability of the best entry →")
    legend_below(panels[0])
    text = heading("Trade-off (arrows: better)", table_set, len(known), "miss the target without noise")
    _headline(figure, text)
    return figure


def draw_sensitivities(
    effects: Sequence[ParameterEffect], quantity: str = "success", *, table_set: TableSet | None = None
) -> Figure:
    """Draw the share of each parameter in the variance of a quantity, with the range of its main effect.

    A black line marks the share that a parameter without effect has by chance.

    Parameters
    ----------
    effects : sequence of ParameterEffect
        Result of `sensitivities`.
    quantity : str, default "success"
        Name of the quantity, a key of `QUANTITIES`.
    table_set : TableSet, optional
        The table set that was studied, for title and units, as in `draw_quantity_map`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = _figure()
    names = ["\n".join(textwrap.wrap(axis_title(effect.name, table_set), _NAME_LETTERS)) for effect in effects][::-1]
    shares = [100 * effect.share for effect in effects][::-1]
    chances = [100 * effect.chance for effect in effects][::-1]
    places = range(len(names))
    axes.barh(places, shares, color=BLUE)
    axes.set_yticks(list(places), names)
    for place, effect in zip(places, effects[::-1], strict=True):
        axes.text(100 * max(effect.share, effect.chance), place, f"  range {effect.effect:.3g}", va="center")
    if any(chances):
        axes.plot(chances, places, "|", color=BLACK, markersize=18, label="parameter without effect, by chance")
        legend_below(axes)
    axes.set_xlim(0, max([*shares, *chances, 1.0]) * 1.3)
    axes.set_xlabel(f"share of the variance (%), {QUANTITIES[quantity]}")
    used = sum((entry.record or {}).get(quantity) is not None for entry in table_set or ())
    text = heading(f"Sensitivity, shares sum to {sum(shares):.0f} %", table_set, used, f"without {quantity}")
    _headline(figure, text)
    return figure


def draw_wrong_parameters(
    found: Sequence[WrongParameter], planned: str | Mapping[str, Any], *, table_set: TableSet | None = None
) -> Figure:
    """Draw the realised success of one plan beside the success of the right plan, with 95 % intervals.

    Each table has one row. Of more than 24 tables, those with the largest loss are drawn.

    Parameters
    ----------
    found : sequence of WrongParameter
        Result of `wrong_parameters`.
    planned : str or mapping
        Values that were planned for, by name of the parameter or as a text.
    table_set : TableSet, optional
        The table set that was studied, for title and units, as in `draw_quantity_map`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    shown = sorted(found, key=lambda row: row.success - row.replanned)[:_MOST_ROWS][::-1]
    figure = Figure(figsize=(_SIZE[0] + 1, 1.8 + _ROW_INCHES * len(shown)), layout="constrained")
    axes = figure.subplots()
    for shift, color, label, numbers in (
        (0.15, BLUE, "plan for the true values", [(row.replanned, row.replanned_interval) for row in shown]),
        (-0.15, ORANGE, "plan for the wrong values", [(row.success, row.success_interval) for row in shown]),
    ):
        success = np.array([number for number, _ in numbers])
        limits = np.array([interval for _, interval in numbers]).reshape(-1, 2)
        bars = np.maximum(np.stack([success - limits[:, 0], limits[:, 1] - success]), 0)
        places = np.arange(len(shown)) + shift
        axes.errorbar(success, places, xerr=bars, fmt="o", color=color, markersize=4, capsize=2, label=label)
    names = [name for name in (shown[0].values if shown else ()) if len({str(row.values[name]) for row in found}) > 1]
    texts = [", ".join(level_text(key_of(row.values[name])) for name in names) for row in shown]
    axes.set_yticks(range(len(shown)), texts)
    axes.set_ylabel("true " + ",\n".join(axis_title(name, table_set) for name in names))
    axes.set_xlabel("realised success probability, 95 % interval")
    axes.set_xlim(-0.02, 1.02)
    axes.grid(visible=True, axis="x", alpha=0.3)
    legend_below(axes)
    if not isinstance(planned, str):
        planned = ", ".join(
            f"{axis_title(name, table_set)} {level_text(key_of(level))}" for name, level in planned.items()
        )
    largest = f", the {len(shown)} largest losses of {len(found)}" if len(shown) < len(found) else ""
    _headline(figure, heading(f"Planned for {planned}{largest}", table_set, len(found), "with another grid"))
    return figure


def _headline(figure: Figure, text: str) -> None:
    """Write the title of a figure above all panels, in lines that are not wider than the figure."""
    lines = textwrap.wrap(text, int(figure.get_figwidth() * _TITLE_LETTERS))
    figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=10)


def _figure() -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE, layout="constrained")
    return figure, figure.subplots()


def _cells(axes: Axes, values: NDArray[np.float64], x: Sequence[Any], y: Sequence[Any], quantity: str) -> Any:
    limits: dict[str, Any] = {"vmin": 0.0, "vmax": 1.0} if quantity.endswith("success") else {}
    columns, rows = cell_axis(x), cell_axis(y)
    image = axes.pcolormesh(columns.edges, rows.edges, values, cmap="viridis", **limits)
    axes.set_facecolor(_EMPTY)
    if not np.isfinite(values).all():
        axes.plot([], [], "s", color=_EMPTY, markeredgecolor=GREY, label="no table, or without this quantity")
        legend_below(axes)
    _scale_x(axes, columns)
    _scale_y(axes, rows)
    norm: Any = image.norm
    widths, heights = columns.shares.tolist(), rows.shares.tolist()
    for row, column in np.argwhere(np.isfinite(values)).tolist():
        if widths[column] > _NUMBER_WIDTH and heights[row] > _NUMBER_HEIGHT:
            value = float(values[row, column])
            text = f"{value:.2f}" if abs(value) < 10 else f"{value:.0f}"
            color = "white" if float(norm(value)) < 0.6 else "black"
            place = float(columns.centres[column]), float(rows.centres[row])
            axes.text(*place, text, ha="center", va="center", fontsize=8, color=color)
    return image


def _scale_x(axes: Axes, cells: CellAxis) -> None:
    if cells.logarithmic:
        axes.set_xscale("log")
    widths = [_LETTER * (len(text) + 2) for text in cells.texts]
    slanted = bool(np.any(np.array(widths) > 1 / len(widths))) and not _is_numeric(cells)
    chosen = cells.labelled([_LINE] * len(widths) if slanted else widths)
    axes.set_xticks(cells.centres[chosen], [cells.texts[cell] for cell in chosen])
    axes.set_xticks([], minor=True)
    if slanted:
        axes.tick_params(axis="x", labelrotation=_SLANT_DEG)
        for label in axes.get_xticklabels():
            label.set_horizontalalignment("right")


def _scale_y(axes: Axes, cells: CellAxis) -> None:
    if cells.logarithmic:
        axes.set_yscale("log")
    chosen = cells.labelled([_LINE] * len(cells.texts))
    axes.set_yticks(cells.centres[chosen], [cells.texts[cell] for cell in chosen])
    axes.set_yticks([], minor=True)


def _is_numeric(cells: CellAxis) -> bool:
    try:
        [float(text) for text in cells.texts]
    except ValueError:
        return False
    return True
