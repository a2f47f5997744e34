"""The workspace with its obstacles and target, and executions in it (Figs. 6.4, 6.5 and 6.7 to 6.9 of the thesis)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from needleplan.planning import Outcome, Path
from needleplan.planning.drawing.tissues import draw_tissues
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, SKY, VERMILLION, axes_in_mm

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from needleplan.scenario import Scenario

__all__ = ["draw_noisy", "draw_path", "draw_scene"]

_ENDS = {Outcome.COLLISION: "X", Outcome.EXIT: "X", Outcome.STEP_LIMIT: "P"}


def draw_scene(axes: Axes, scenario: Scenario, *, on_colour: bool = False) -> None:
    """Draw the workspace, tissues tinted, obstacles in grey and the target as a ring; `on_colour`: over a map."""
    from matplotlib.patches import Circle, Polygon

    axes_in_mm(axes, scenario.workspace)
    for obstacle in scenario.obstacles:
        axes.add_patch(
            Polygon(
                list(obstacle.polygon_mm),
                facecolor="white" if on_colour else "#d0d0d0",
                edgecolor=BLACK,
                linewidth=0.9,
                zorder=3,
            )
        )
    draw_tissues(axes, scenario, on_colour=on_colour)
    target = scenario.target
    axes.add_patch(
        Circle(target.center_mm, target.radius_mm, facecolor="none", edgecolor=VERMILLION, linewidth=1.8, zorder=6)
    )


def draw_noisy(axes: Axes, paths: Sequence[Path]) -> None:
    """Draw many executions, thin: those that reach the target and those that fail."""
    reached = [path for path in paths if path.outcome is Outcome.TARGET]
    failed = [path for path in paths if path.outcome is not Outcome.TARGET]
    for group, colour, word in ((failed, GREY, "failed"), (reached, SKY, "reached the target")):
        for path in group:
            axes.plot(*path.poses[:, :2].T, color=colour, linewidth=0.5, alpha=0.6, zorder=2)
        if group:
            axes.plot([], [], color=colour, linewidth=0.8, label=f"with tip noise, {word} ({len(group)})")


def draw_path(axes: Axes, path: Path, *, label: str = "") -> None:
    """Draw one execution with its turn points as green circles."""
    axes.plot(*path.poses[:, :2].T, color=BLUE, linewidth=1.8, zorder=4, label=label or "without noise")
    start = path.poses[0]
    axes.plot(start[0], start[1], marker=">", markersize=7, color=BLUE, zorder=5, clip_on=False)
    if len(path.turns):
        axes.plot(
            *path.turns[:, :2].T,
            linestyle="none",
            marker="o",
            markersize=6,
            markerfacecolor="white",
            markeredgecolor=GREEN,
            markeredgewidth=1.6,
            zorder=7,
            label=f"turns ({len(path.turns)})",
        )
    if path.outcome in _ENDS:
        # An exit lies outside; its mark stands on the edge.
        axes.plot(
            min(max(path.poses[-1, 0], 0), axes.get_xlim()[1]),
            min(max(path.poses[-1, 1], 0), axes.get_ylim()[1]),
            linestyle="none",
            marker=_ENDS[path.outcome],
            markersize=8,
            color=VERMILLION,
            zorder=7,
            clip_on=False,
            label=str(path.outcome),
        )
