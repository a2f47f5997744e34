"""Draws Figs. 2.2 to 2.9 from simulated records."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.identification import replay
from needleplan.models.force import DepthForce, ForceModel1
from needleplan.plotting.canvas import BLACK, BLUE, GREY, SKY, VERMILLION, save, title
from needleplan.signals import Record
from needleplan_thesis.chapter2.bank import BankRun, run_bank
from needleplan_thesis.chapter2.forces import SENSOR, corners
from needleplan_thesis.chapter2.parameters import IdentifiedForce

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_figures"]

# Factor by which the starting values of the bank are wrong.
_START_FACTOR = 2.0


def draw_figures(identified: list[IdentifiedForce], folder: Path) -> None:
    """Draw all figures of the chapter into `folder`. Raises OutputError if a file cannot be written."""
    fast, slow, stiff, _, thin = identified
    models = {"I": ForceModel1(**fast.published.model.values()), "II": fast.published.model}
    runs = {name: _bank(model, fast.record) for name, model in models.items()}
    _profile(fast, folder / "fig_2_2.png")
    _phases(runs, fast.record, folder / "fig_2_3.png", inward=True)
    _phases(runs, fast.record, folder / "fig_2_4.png", inward=False)
    wanted = ("sigma2", "sigma0", "f2")
    _tracks([("Model I, A/A, 10 mm/s", runs["I"], models["I"])], wanted, folder / "fig_2_5.png", deepest=50.0)
    six = _bank(slow.published.model, slow.record)
    _tracks(
        [("Model II, A/A, 10 mm/s", runs["II"], models["II"]), ("Model II, A/A, 6 mm/s", six, slow.published.model)],
        ("sigma2", "f1", "beta"), folder / "fig_2_6.png",
    )  # fmt: skip
    _loops([fast, slow], folder / "fig_2_7.png")
    _tracks(
        [(f"Model II, {loop.published.title}", _bank(loop.published.model, loop.record), loop.published.model)
         for loop in (stiff, thin)],
        ("sigma0", "sigma1", "sigma2", "f1", "beta"), folder / "fig_2_8.png",
    )  # fmt: skip
    _loops(identified[2:], folder / "fig_2_9.png")


def _bank(model: DepthForce, record: Record) -> BankRun:
    return run_bank(next(corners(model, _START_FACTOR, 1, seed=3)), record)


def _figure(rows: int, panels: int, width: float, height: float) -> tuple[Figure, np.ndarray]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, panels, squeeze=False)


def _profile(loop: IdentifiedForce, path: Path) -> None:
    figure, ((above,), (below,)) = _figure(2, 1, 6.4, 4.6)
    record = loop.record
    above.plot(record["time_s"], record["force_n"], color=BLUE, linewidth=0.9)
    below.plot(record["time_s"], record["depth_mm"], color=BLACK, linewidth=1.2)
    title(above, f"Force and depth, {loop.published.title}; simulated")
    above.set_ylabel("force (N)")
    below.set_ylabel("depth (mm)")
    below.set_xlabel("time (s)")
    save(figure, path)


def _phases(runs: dict[str, BankRun], record: Record, path: Path, *, inward: bool) -> None:
    figure, axes = _figure(1, 2, 8.6, 3.4)
    rows = record.motion().direction == (1 if inward else -1)
    for panel, (name, run) in zip(axes.flat, runs.items(), strict=True):
        shown = np.flatnonzero(rows[: len(run.track.predicted)])
        panel.plot(
            record["depth_mm"][rows], record["force_n"][rows], color=GREY, linewidth=1.6, label="simulated record"
        )
        panel.plot(run.track.depth_mm[shown], run.track.predicted[shown], color=BLUE, linewidth=0.9, label="predicted")
        seen = record["force_n"][rows][5:]
        panel.set_ylim(seen.min() - 0.3 * np.ptp(seen), seen.max() + 0.3 * np.ptp(seen))
        title(panel, f"Model {name}, {'insertion' if inward else 'retraction'}: bank, one sample ahead")
        panel.set_xlabel("depth (mm)")
    axes[0, 0].set_ylabel("force (N)")
    axes[0, 0].legend(frameon=False, fontsize=8)
    save(figure, path)


def _tracks(
    panels: list[tuple[str, BankRun, DepthForce]], names: tuple[str, ...], path: Path, *, deepest: float = 80.0
) -> None:
    rows = ("z", *names) if len(names) == 3 and "f2" in names else names
    figure, axes = _figure(len(rows), len(panels), 4.3 * len(panels), 1.5 * len(rows) + 0.6)
    for column, (text, run, model) in enumerate(panels):
        track = run.track
        turn = int(np.argmax(track.depth_mm >= min(deepest, float(track.depth_mm.max()))))
        for row, name in enumerate(rows):
            panel = axes[row, column]
            band = track.state if name == "z" else track.values[name]
            assert band is not None
            _band(panel, track.depth_mm[:turn], *(each[:turn] for each in band))
            if name != "z":
                panel.axhline(getattr(model, name), color=VERMILLION, linewidth=0.8, linestyle="--")
            unit = "" if name == "z" else f" ({model.parameters()[name].unit})"
            panel.set_ylabel(f"{name}{unit}", fontsize=8)
            if row == 0:
                title(panel, text)
        axes[-1, column].set_xlabel("depth (mm)")
    figure.legend(*_legend(), frameon=False, fontsize=8, loc="outside lower left", ncols=3)
    save(figure, path)


def _band(panel: Axes, depth: np.ndarray, low: np.ndarray, value: np.ndarray, high: np.ndarray) -> None:
    panel.fill_between(depth, low, high, color=SKY, alpha=0.4, linewidth=0)
    panel.plot(depth, value, color=BLUE, linewidth=1.0)
    settled = depth > 5.0
    if settled.any():
        bottom, top = float(low[settled].min()), float(high[settled].max())
        panel.set_ylim(bottom - 0.1 * (top - bottom), top + 0.1 * (top - bottom))


def _legend() -> tuple[list[Artist], list[str]]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color=BLUE),
        Patch(color=SKY, alpha=0.4),
        Line2D([], [], color=VERMILLION, linestyle="--"),
    ]
    return list(handles), ["estimate", "+-3 sigma", "parameter of the record"]


def _loops(identified: list[IdentifiedForce], path: Path) -> None:
    figure, axes = _figure(1, len(identified), 4.0 * len(identified), 3.4)
    for panel, loop in zip(axes.flat, identified, strict=True):
        record = loop.record
        panel.plot(record["depth_mm"], record["force_n"], color=GREY, linewidth=1.4, label="simulated record")
        panel.plot(
            record["depth_mm"], replay(loop.run.model, record, smooth=SENSOR), color=BLUE, linewidth=1.1,
            label="open loop",
        )  # fmt: skip
        title(panel, f"{loop.published.title}: {1e3 * loop.run.replay_mae[-1]:.1f} mN")
        panel.set_xlabel("depth (mm)")
    axes[0, 0].set_ylabel("force (N)")
    axes[0, 0].legend(frameon=False, fontsize=8)
    save(figure, path)
