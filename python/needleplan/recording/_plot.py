"""Figures of a recording: channels over time, force over depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from needleplan.plotting.canvas import BLUE, GREEN, VERMILLION, stack, title
from needleplan.recording._align import good_samples
from needleplan.recording._sample_kinds import FORCE, POSE, STAGE
from needleplan.signals import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plot_channels"]

_COLOURS = (BLUE, VERMILLION, GREEN)

# Drawn fields and axis label of each kind of sample; of other kinds, all fields of type float64 are drawn
_FIELDS = {
    FORCE.name: (("force_x_n", "force_y_n", "force_z_n"), "force (N)"),
    STAGE.name: (("depth_mm",), "depth (mm)"),
    POSE.name: (("x_mm", "y_mm", "z_mm"), "position (mm)"),
}
_NOT_DRAWN = frozenset(("time_s", "device_time_s"))


def plot_channels(
    channels: Sequence[tuple[str, str, Mapping[str, Any]]], trial: Record | None, heading: str
) -> list[Axes]:
    """Draw one panel for each channel, and a panel of force against depth if `trial` has both; return all axes.

    `channels` holds (topic, name of the message kind, columns) of each channel.
    """
    by_depth = trial is not None and {"force_n", "depth_mm"} <= trial.columns.keys()
    _, axes = stack(len(channels) + by_depth)
    for panel, (topic, kind, columns) in zip(axes, channels, strict=False):
        if panel is not axes[0]:
            panel.sharex(axes[0])
        _draw_channel(panel, kind, columns)
        panel.set_xlabel("time (s)")
        title(panel, topic)
    if trial is not None and by_depth:
        axes[-1].plot(trial["depth_mm"], trial["force_n"], color=BLUE, linewidth=0.9)
        axes[-1].set_xlabel("depth (mm)")
        axes[-1].set_ylabel("axial force (N)")
        title(axes[-1], "force over depth")
    axes[0].figure.suptitle(heading, x=0.01, ha="left", fontsize=10)
    return axes


def _draw_channel(panel: Axes, kind: str, columns: Mapping[str, Any]) -> None:
    numbers = [name for name, values in columns.items() if values.dtype.kind == "f" and name not in _NOT_DRAWN]
    names, label = _FIELDS.get(kind, (tuple(numbers), ""))
    values = {name: columns[name] for name in names}
    if "health" in columns:
        values = good_samples(columns, values)
    for number, (name, column) in enumerate(values.items()):
        panel.plot(columns["time_s"], column, label=name, color=_COLOURS[number % len(_COLOURS)], linewidth=0.9)
    panel.set_ylabel(label or ", ".join(names))
    if len(names) > 1:
        panel.legend(fontsize=8, loc="upper left")
