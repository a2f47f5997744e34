"""Draws the moving picture of the README: 40 executions of a plan with tip noise.

Usage: python docs/site/moving_picture.py docs/images/steering.gif
"""

import io
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import needleplan as npl
from needleplan.planning import Outcome

_RUNS = 10_000  # executions that are counted; the first ones are drawn
_FRAMES, _LAST = 60, 25  # number of frames until the longest path ends, and of further ones that show the end
_FRAME_MS = 70
_COLOURS = 48  # palette of the file; fewer make it smaller
_BLUE, _VERMILLION, _BLACK = "#0072B2", "#D55E00", "#1a1a1a"


def frames() -> list[Image.Image]:
    """Return the frames."""
    table = npl.plan("four_obstacles")
    entry = table.best_entry()
    rollouts = table.rollout(entry, runs=_RUNS, seed=0)
    samples = rollouts.samples
    runs = [each.poses[:, :2] for each in samples]
    reached = [each.outcome is Outcome.TARGET for each in samples]
    longest = max(map(len, runs)) - 1
    figure = Figure(figsize=(5.6, 4.0), dpi=130, layout="constrained")
    axes = figure.subplots()
    table.scenario.plot(axes)
    colours = [_BLUE if each else _VERMILLION for each in reached]
    lines = [axes.plot([], [], color=colour, linewidth=0.9, alpha=0.8)[0] for colour in colours]
    tips = axes.scatter(*np.repeat([entry.pose[:2]], len(runs), axis=0).T, s=9, color=_BLACK, zorder=8)
    title = axes.set_title(" ", loc="left", fontsize=10)
    pictures = []
    for number in range(_FRAMES + _LAST):
        steps = longest * min(number / (_FRAMES - 1), 1.0)
        shown = [until(run, steps) for run in runs]
        for line, points in zip(lines, shown, strict=True):
            line.set_data(*points.T)
        tips.set_offsets([points[-1] for points in shown])
        if number >= _FRAMES:
            shares = f"of {_RUNS:,} {100 * rollouts.success:.1f} % ({100 * entry.success:.1f} % predicted)"
            title.set_text(f"{sum(reached)} of these {len(runs)} reach the target, {shares}")
        else:
            title.set_text(f"{len(runs)} executions with tip noise by one policy table")
        pictures.append(picture(figure))
    return pictures


def until(points: np.ndarray, steps: float) -> np.ndarray:
    """Return the part of a path that lies within a number of steps, with its interpolated end."""
    steps = min(steps, len(points) - 1)
    whole = int(steps)
    part = points[: whole + 1]
    if whole < len(points) - 1:
        end = points[whole] + (steps - whole) * (points[whole + 1] - points[whole])
        part = np.vstack([part, end])
    return part


def picture(figure: Figure) -> Image.Image:
    """Return a figure as an image."""
    data = io.BytesIO()
    figure.savefig(data, format="png")
    return Image.open(data).convert("RGB")


def write(file: Path) -> None:
    """Write the moving picture."""
    first, *others = frames()
    palette = others[-1].quantize(_COLOURS)
    reduced = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in (first, *others)]
    reduced[0].save(file, save_all=True, append_images=reduced[1:], duration=_FRAME_MS, loop=0, optimize=True)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
