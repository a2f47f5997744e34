"""Figures of a diagnosis report as SVG text without external fonts or files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.diagnosis import Curves, Isolability
from needleplan.plotting.canvas import BLACK, BLUE, GREY, ORANGE, VERMILLION
from needleplan.reports.diagnosis.traces import TrialTrace, correlation, gap_map
from needleplan.signals import Motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "correlation_figure",
    "course_figure",
    "gap_figure",
    "isolability_figure",
    "map_figure",
    "motion_figure",
    "trial_figure",
]

_STYLE: Any = {"font.size": 9, "axes.linewidth": 0.8, "svg.fonttype": "path", "svg.hashsalt": "needleplan"}
# Number of lags (samples) of the autocorrelation.
_LAGS = 40


def trial_figure(trace: TrialTrace, unit: str, axes_names: Sequence[str]) -> str:
    """Return an SVG figure of one trial over time: measured and modelled output, residual, and depth.

    `axes_names` names the rows of the output; `unit` is their unit.
    """
    rows = len(trace.measured)
    figure, panels = _sheet(2 * rows + 1, 1, (7.4, 1.4 + 2.8 * rows), _Margins(top=0.3, between=0.12), sharex=True)
    time = trace.motion.time_s
    for ax, name, measured, before, after in zip(
        panels[:rows], axes_names, trace.measured, trace.before,
        trace.after if trace.after is not None else [None] * rows, strict=True,
    ):  # fmt: skip
        ax.plot(time, measured, color=GREY, lw=0.7, label="measured")
        ax.plot(time, before, color=VERMILLION, lw=1.1, ls="--", label="model before")
        if after is not None:
            ax.plot(time, after, color=BLUE, lw=1.1, label="model after")
        ax.set_ylabel(f"{name} ({unit})")
        ax.grid(alpha=0.25)
    for ax, name, measured, before, after in zip(
        panels[rows:-1], axes_names, trace.measured, trace.before,
        trace.after if trace.after is not None else [None] * rows, strict=True,
    ):  # fmt: skip
        ax.plot(time, measured - before, color=VERMILLION, lw=0.7)
        if after is not None:
            ax.plot(time, measured - after, color=BLUE, lw=0.6)
        ax.set_ylabel(f"residual {name}")
        ax.grid(alpha=0.25)
    panels[0].legend(ncols=3, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2, frameon=False)
    panels[-1].plot(time, trace.motion.depth_mm, color=BLACK, lw=0.9)
    panels[-1].set(xlabel="time (s)", ylabel="depth (mm)")
    panels[-1].grid(alpha=0.25)
    _aligned(panels)
    return _svg(figure)


def gap_figure(noise: float, traces: Sequence[TrialTrace], unit: str) -> str:
    """Return an SVG figure of bars: the residual RMS without and with effects, for the trials of each role.

    A dotted line marks the RMS `noise` of the sensor.
    """
    groups = [(words, [trace for trace in traces if trace.words == words])
              for words in dict.fromkeys(trace.words for trace in traces)]  # fmt: skip
    figure, (ax,) = _sheet(1, 1, (5.0, 1.0 + 0.7 * len(groups)))
    for place, (_, part) in enumerate(groups):
        bars = [("before", VERMILLION, "//", _rms([each.measured - each.before for each in part]))]
        if part[0].after is not None:
            bars.append(("after", BLUE, "", _rms([each.measured - each.after for each in part
                                                 if each.after is not None])))  # fmt: skip
        for row, (name, colour, hatch, value) in enumerate(bars):
            y = place + 0.34 * row - 0.17 * (len(bars) - 1)
            ax.barh(y, value, 0.3, color=colour, hatch=hatch, edgecolor="white")
            ax.text(value, y, f" {name} {value:.3g} {unit}", va="center", fontsize=8)
    ax.axvline(noise, color=BLACK, lw=1, ls=":")
    ax.text(noise, -0.42, f" noise {noise:.3g} {unit}", fontsize=8, va="bottom")
    ax.set_yticks(range(len(groups)), [name for name, _ in groups])
    ax.set(xlabel=f"residual RMS ({unit})", ylim=(len(groups) - 0.5, -0.75))
    ax.set_xlim(0, 1.35 * ax.get_xlim()[1])
    return _svg(figure)


def map_figure(traces: Sequence[TrialTrace]) -> str:
    """Return an SVG figure of the whitened residual by depth, and of its mean square by depth and phase of motion.

    The first two panels show the model before adding effects. If effects were added, two more show the model after.
    """
    from matplotlib.colors import LogNorm

    both = traces[0].left_after is not None
    maps = [gap_map(traces, after=after) for after in (False, True)[: 1 + both]]
    rows = len(maps[0][0])
    heights = [1.4, 0.5 + 0.28 * rows] * len(maps)
    size = 7.4, 0.6 + sum(heights)
    words = max(len(str(each)) for each in maps[0][0])
    margins = _Margins(left=max(0.95, 0.2 + 0.066 * words), right=1.0, top=0.25, between=0.25)
    figure, panels = _sheet(2 * len(maps), 1, size, margins, sharex=True, height_ratios=heights)
    top = max(20.0, *(float(np.nanmax(energy)) for _, _, energy in maps))
    colours = LogNorm(0.5, top)
    for index, (phases, edges, energy) in enumerate(maps):
        _residual_panel(panels[2 * index], traces, after=index > 0)
        ax = panels[2 * index + 1]
        image = ax.imshow(energy, cmap="viridis_r", norm=colours, aspect="auto",
                          extent=(edges[0], edges[-1], len(phases) - 0.5, -0.5))  # fmt: skip
        middle = (edges[1:] + edges[:-1]) / 2
        for row, column in zip(*np.nonzero(np.isfinite(energy)), strict=True):
            value = float(energy[row, column])
            colour = "white" if colours(max(value, 0.5)) > 0.5 else "black"
            text = f"{value:.2g}" if value < 100 else f"{value:.0f}" if value < 1e4 else f"{value:.0e}"
            ax.text(middle[column], row, text, ha="center", va="center", fontsize=7, color=colour)
        ax.set_yticks(range(len(phases)), [str(phase) for phase in phases])
    panels[-1].set_xlabel("depth (mm)")
    _aligned(panels)
    scale = figure.add_axes((1 - 0.85 / size[0], 0.15, 0.14 / size[0], 0.7))
    figure.colorbar(image, cax=scale, label="energy (noise alone: 1)", format=_plain)
    return _svg(figure)


def _residual_panel(ax: Axes, traces: Sequence[TrialTrace], *, after: bool) -> None:
    for trace in traces:
        left = trace.left_after if after else trace.left_before
        if left is not None:
            ax.plot(trace.motion.depth_mm[trace.sample], left, ".", ms=1.2, color=BLUE if after else VERMILLION,
                    rasterized=True)  # fmt: skip
    ax.axhspan(-2.576, 2.576, color=GREY, alpha=0.3, lw=0)
    ax.set_title("model after" if after else "model before", loc="left", fontsize=9)
    ax.set_ylabel("residual\n(noise sd)")
    ax.grid(alpha=0.25)


def correlation_figure(traces: Sequence[TrialTrace]) -> str:
    """Return an SVG figure of the autocorrelation of the whitened residual, with the 99 % band of white noise.

    The first panel shows the model before adding effects; if effects were added, a second shows the model after.
    """
    both = traces[0].left_after is not None
    figure, panels = _sheet(1, 1 + both, (7.4 if both else 4.2, 2.2), _Margins(top=0.25, between=0.2), sharey=True)
    for ax, after in zip(panels, (False, True), strict=False):
        values, bound = correlation(traces, _LAGS, after=after)
        ax.axhspan(-bound, bound, color=GREY, alpha=0.3, lw=0)
        ax.vlines(range(1, _LAGS + 1), 0, values, color=BLUE if after else VERMILLION, lw=1.5)
        ax.axhline(0, color=BLACK, lw=0.6)
        ax.set_title("model after" if after else "model before", loc="left", fontsize=9)
        ax.set_xlabel("lag (samples)")
    panels[0].set_ylabel("correlation")
    return _svg(figure)


def isolability_figure(matrix: Isolability) -> str:
    """Return an SVG figure of a matrix: the share of each effect (row) that every other effect (column) imitates."""
    names, count = matrix.effects, len(matrix.effects)
    words = 0.058 * max(map(len, names))
    margins = _Margins(left=0.4 + words, bottom=0.45 + 0.87 * words)
    across, down = 0.29 * count + margins.left + margins.right, 0.26 * count + margins.bottom + margins.top
    figure, (ax,) = _sheet(1, 1, (across, down), margins)
    ax.imshow(matrix.imitated, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i in range(count):
        for j in range(count):
            value = matrix.imitated[i, j]
            if i != j and np.isfinite(value) and value >= 0.095:
                ax.text(j, i, f"{value:.1f}".lstrip("0"), ha="center", va="center", fontsize=6.5,
                        color="white" if value > 0.55 else "black")  # fmt: skip
    ax.set_xticks(range(count), names, rotation=60, ha="right", fontsize=7)
    ax.set_yticks(range(count), names, fontsize=7)
    ax.set(xlabel="imitated by", ylabel="effect")
    return _svg(figure)


def motion_figure(motion: Motion) -> str:
    """Return an SVG figure of the depth of a motion over time."""
    figure, (ax,) = _sheet(1, 1, (7.4, 1.9))
    ax.plot(motion.time_s, motion.depth_mm, color=BLUE, lw=1.2)
    ax.set(xlabel="time (s)", ylabel="depth (mm)")
    ax.grid(alpha=0.25)
    return _svg(figure)


def course_figure(course: Curves, unit: str) -> str:
    """Return an SVG figure of the unexplained gap along the axis on which the gap depends.

    Each curve has a band of +-2 standard deviations and is drawn only within the range that the recordings visit.
    `unit` is the unit of the gap.
    """
    figure, (ax,) = _sheet(1, 1, (7.4, 2.4))
    for curve, colour in zip(course.curves, (BLUE, ORANGE, VERMILLION, GREY), strict=False):
        mean, sd = (np.where(curve.inside, each, np.nan) for each in (curve.mean, curve.sd))
        ax.fill_between(curve.places, mean - 2 * sd, mean + 2 * sd, color=colour, alpha=0.25, lw=0)
        ax.plot(curve.places, mean, color=colour, label=str(curve.way))
    if len(course.curves) > 1:
        ax.legend(fontsize=8)
    ax.axhline(0, color=BLACK, lw=0.6)
    ax.set(xlabel=f"{course.axis.label} ({course.unit})", ylabel=f"missing ({unit})")
    ax.grid(alpha=0.25)
    return _svg(figure)


def _rms(rows: Sequence[Any]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate([np.ravel(row) for row in rows]) ** 2)))


@dataclass(frozen=True)
class _Margins:
    """Margins (inches) around and between panels, fixed because automatic layout would double the drawing time."""

    left: float = 0.75
    right: float = 0.1
    bottom: float = 0.45
    top: float = 0.1
    between: float = 0.1


def _sheet(
    rows: int,
    columns: int,
    size: tuple[float, float],
    margins: _Margins = _Margins(),
    *,
    sharex: bool = False,
    sharey: bool = False,
    height_ratios: Sequence[float] | None = None,
) -> tuple[Figure, list[Axes]]:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    width, height = size
    inner = width - margins.left - margins.right, height - margins.bottom - margins.top
    between = margins.between
    panel = [(whole - (n - 1) * between) / n for whole, n in zip(inner, (columns, rows), strict=True)]
    place = {
        "left": margins.left / width, "right": 1 - margins.right / width,
        "bottom": margins.bottom / height, "top": 1 - margins.top / height,
        "wspace": between / panel[0], "hspace": between / panel[1],
    }  # fmt: skip
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=size)
        panels = figure.subplots(
            rows, columns, squeeze=False, sharex=sharex, sharey=sharey, height_ratios=height_ratios, gridspec_kw=place
        )
        return figure, list(panels.flat)


def _aligned(panels: Sequence[Axes]) -> None:
    """Place the y labels of all panels 0.55 inch to the left of the axes, so that they line up."""
    for ax in panels:
        figure = ax.figure
        ax.yaxis.set_label_coords(-0.55 / (ax.get_position().width * float(figure.bbox.width) / figure.dpi), 0.5)


def _plain(value: float, _: float | None = None) -> str:
    """Return the tick label of a value as plain text, because mathtext of matplotlib is slow."""
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def _svg(figure: Figure) -> str:
    import matplotlib as mpl

    text = io.StringIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(text, format="svg", dpi=200, metadata={"Date": None, "Creator": None})
    return text.getvalue()
