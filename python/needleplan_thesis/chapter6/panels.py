"""Executions beside each other: one panel each, with its turn points, one caption below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path as File
from typing import TYPE_CHECKING

from needleplan.planning import Outcome, Path, PolicyTable, Pose
from needleplan.plotting import caption, save, sheet
from needleplan.plotting.canvas import BLUE, GREEN, GREY, SKY, title

if TYPE_CHECKING:
    from matplotlib.lines import Line2D

__all__ = ["Panel", "draw_panels", "ending"]

_NOISY = 30


@dataclass(frozen=True, eq=False)
class Panel:
    """One execution without noise, of `table`, under a heading."""

    heading: str
    table: PolicyTable
    path: Path

    @classmethod
    def of(cls, heading: str, table: PolicyTable, start: Sequence[float]) -> Panel:
        """Execute `table` from a pose; a missing bevel becomes the one of the lower cost."""
        return cls(heading, table, table.path(start))

    @property
    def start(self) -> Pose:
        """The first pose."""
        return self.path.start

    @property
    def turns(self) -> int:
        """Number of rotations."""
        return len(self.path.turns)

    @property
    def success(self) -> float:
        """Predicted probability of reaching the target."""
        return self.table.lookup(*self.start).success


def ending(path: Path) -> str:
    """Return how an execution ended, in words."""
    words = {
        Outcome.TARGET: "reaches the target",
        Outcome.COLLISION: "hits an obstacle",
        Outcome.EXIT: "leaves the workspace",
        Outcome.STEP_LIMIT: "does not end",
    }
    return words[path.outcome]


def draw_panels(panels: Sequence[Panel], text: str, file: File) -> None:
    """Draw the panels with some noisy executions behind each path, and save the figure."""
    figure, every = sheet(panels[0].table.scenario.workspace, len(panels))
    for axes, panel in zip(every, panels, strict=True):
        panel.table.rollout(panel.start, runs=_NOISY).plot(axes)
        panel.path.plot(axes, scene=False)
        title(axes, panel.heading)
    figure.legend(handles=_legend(), loc="outside upper right", ncols=4, frameon=False, fontsize=7.5)
    caption(figure, f"{text} Thin: {_NOISY} executions with tip noise.")
    save(figure, file)


def _legend() -> list[Line2D]:
    from matplotlib.lines import Line2D

    turn = {
        "marker": "o",
        "markersize": 6,
        "markerfacecolor": "white",
        "markeredgecolor": GREEN,
        "markeredgewidth": 1.6,
    }
    return [
        Line2D([], [], color=BLUE, linewidth=1.8, label="without noise"),
        Line2D([], [], linestyle="none", label="turn", **turn),  # type: ignore[arg-type]
        Line2D([], [], color=SKY, linewidth=0.8, label="with noise, reached"),
        Line2D([], [], color=GREY, linewidth=0.8, label="with noise, failed"),
    ]
