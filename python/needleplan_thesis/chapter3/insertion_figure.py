"""Fig. 3.6: measured and predicted force with the tip inside of the tissue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needleplan.models import Model, simulate
from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLUE, GREY, ORANGE, SKY, VERMILLION, title
from needleplan.signals import Record

__all__ = ["draw_prediction"]

_COLOURS = (VERMILLION, BLUE, ORANGE)


def draw_prediction(
    records: Sequence[tuple[str, Record, NDArray[np.bool_]]], models: Mapping[str, Model], file: Path
) -> None:
    """Draw records (name, record, where major cutting is) one above the other with the predictions."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    every = figure.subplots(len(records), 1, sharex=True, squeeze=False).flat
    for axes, (name, record, major) in zip(every, records, strict=True):
        motion = record.motion()
        axes.plot(motion.time_s, record["force_n"], color=GREY, linewidth=0.6, label="synthetic measurement")
        for (label, model), colour in zip(models.items(), _COLOURS, strict=True):
            style = "--" if label == "III-A" else "-"
            shown = f"Model {label}" + (", Fn frozen" if label == "II" else "")
            axes.plot(motion.time_s, simulate(model, motion).output, style, color=colour, linewidth=1.0, label=shown)
        low, high = axes.get_ylim()
        axes.fill_between(
            motion.time_s, low, high, where=major, color=SKY, alpha=0.25, linewidth=0, label="fresh tissue"
        )
        axes.set_ylim(low, high)
        axes.set_ylabel("axial force (N)")
        title(axes, f"{name} profile")
    axes.set_xlabel("time (s)")
    handles = axes.get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper right", ncols=5, frameon=False, fontsize=8)
    caption(
        figure,
        "Fig. 3.6: needle B in tissue A, 0.08 Hz, 25 mm, tip inside. The measurement is Model III-B with the inserted "
        "length, with cutting, minor cutting, air bubbles and noise of sizes that are ours.",
    )
    save(figure, file)
