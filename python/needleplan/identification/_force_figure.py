"""Figure of an identified force: measured and simulated force over depth, and the residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from needleplan.identification._passes import replay
from needleplan.models import Model
from needleplan.plotting.canvas import BLUE, GREY, ORANGE, SKY, VERMILLION, title
from needleplan.signals import Array, MovingAverage, Record, Role

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_force"]


def draw_force(figure: Figure, *, model: Model, records: Sequence[Record], sensor: MovingAverage,
    counts: Callable[[Record], Array],
) -> None:  # fmt: skip
    """Draw the force over depth of every trial, and, in a panel below, the residuals of the samples not masked."""
    figure.set_layout_engine("constrained")
    above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [2.4, 1]})
    seen: set[str] = set()
    for record in records:
        held = record.role is Role.HOLDOUT
        depth, measured, simulated = record["depth_mm"], record["force_n"], replay(model, record, smooth=sensor)
        for values, colour, label in (
            (measured, ORANGE if held else GREY, "measured, held out" if held else "measured"),
            (simulated, VERMILLION if held else BLUE, "open loop, held out" if held else "open loop"),
        ):
            above.plot(depth, values, color=colour, linewidth=1.0, label=None if label in seen else label)
            seen.add(label)
        left = np.where(counts(record), 1e3 * (measured - simulated), np.nan)
        below.plot(depth, left, color=ORANGE if held else SKY, linewidth=0.7)
    title(above, f"Axial force, {model.name}")
    above.set_ylabel("force (N)")
    above.legend(frameon=False, fontsize=8)
    below.axhline(0, color=GREY, linewidth=0.6)
    below.set_xlabel("depth (mm)")
    below.set_ylabel("residual (mN)")
    title(below, "Measured minus open loop")
