"""Figs. 6.4 and 6.5: plans with and without noise, and with other costs of insertion and rotation.

The start is (0, 20) mm, the (0, 2) cm of the thesis. The scene of the thesis is not known. In the scene used here, the
published heading of -30 degrees leads into an obstacle, so Fig. 6.4 is drawn with the nearest heading that has a
predicted success of at least 0.75.
Costs per centimetre in the thesis are divided by ten to give costs per millimetre. With the literal costs (collision
200, exit 100, discount 0.95) a failure is cheaper than a detour. The figures therefore use a failure cost of 10,000
without discount; the literal plans are drawn separately.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as File
from typing import TYPE_CHECKING

import numpy as np

from needleplan.planning import Outcome, Path, PolicyTable, Pose, plan
from needleplan.plotting import caption, save, sheet
from needleplan.plotting.canvas import BLUE, GREEN, GREY, SKY, title
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured
from needleplan_thesis.chapter6.entries import sampled
from needleplan_thesis.chapter6.tables import OTHER_SCENE

if TYPE_CHECKING:
    from matplotlib.lines import Line2D

__all__ = ["Panel", "draw_panels", "ending", "nearest_heading", "paths"]

# Number of executions with tip noise that are drawn behind each path.
_NOISY = 30


@dataclass(frozen=True, eq=False)
class Panel:
    """One execution of `table` without noise, drawn in a panel with the title `heading`."""

    heading: str
    table: PolicyTable
    path: Path

    @classmethod
    def of(cls, heading: str, table: PolicyTable, start: Sequence[float]) -> Panel:
        """Return the panel of an execution of `table` from a pose. A missing bevel is set to that of the lower cost."""
        return cls(heading, table, table.path(start, nearest=True))

    @property
    def start(self) -> Pose:
        """The first pose of the execution."""
        return self.path.start

    @property
    def turns(self) -> int:
        """Number of rotations."""
        return len(self.path.turns)

    @property
    def success(self) -> float:
        """Predicted probability of reaching the target from the start."""
        return self.table.lookup(*self.start, nearest=True).success


def ending(path: Path) -> str:
    """Return the outcome of an execution in words."""
    words = {
        Outcome.TARGET: "reaches the target",
        Outcome.COLLISION: "hits an obstacle",
        Outcome.EXIT: "leaves the workspace",
        Outcome.STEP_LIMIT: "does not end",
    }
    return words[path.outcome]


def draw_panels(panels: Sequence[Panel], text: str, file: File) -> None:
    """Draw all panels in one figure, each with noisy executions behind its path, and save the figure to `file`.

    `text` is the caption.
    """
    figure, every = sheet(panels[0].table.scenario.workspace, len(panels))
    for axes, panel in zip(every, panels, strict=True):
        panel.table.rollout(panel.start, runs=_NOISY, nearest=True).plot(axes)
        panel.path.plot(axes, scene=False)
        title(axes, panel.heading)
    figure.legend(handles=_legend(), loc="outside upper left", ncols=4, frameon=False, fontsize=8)
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
        Line2D([], [], linestyle="none", label="turns", **turn),  # type: ignore[arg-type]
        Line2D([], [], color=SKY, linewidth=0.8, label="with tip noise, reached the target"),
        Line2D([], [], color=GREY, linewidth=0.8, label="with tip noise, failed"),
    ]


# Start of all executions: x and y (mm).
_START_MM = (0.0, 20.0)

# Smallest predicted success with which a heading is accepted for the start of Fig. 6.4.
_MOST = 0.75

# Number of executions with tip noise for a realised success.
_RUNS = 10_000
_SECTION = "ch6/figures"
_LETTERS = "abc"
_COSTS = ((10, 40, 11), (10, 100, 9), (1, 100, 3))
"""Fig. 6.5: cost of insertion per cm, cost of a rotation, published number of turns."""


def paths(folder: File | None, note: Callable[[str], None]) -> list[Comparison]:
    """Plan for both figures and return the comparisons; draw the figures if a folder is given."""
    note("Figs. 6.4 and 6.5")
    return [*_noise(folder), *_costs(folder)]


def nearest_heading(table: PolicyTable, wanted_rad: float) -> float:
    """Return the heading (rad) nearest to `wanted_rad` with a predicted success of at least 0.75 from (0, 20) mm."""
    headings = np.remainder(table.scenario.headings_rad - wanted_rad + math.pi, 2 * math.pi) - math.pi
    poses = [(*_START_MM, heading + wanted_rad, bevel) for heading in headings for bevel in (-1, 1)]
    success = table.lookup_many(poses, nearest=True).success.reshape(-1, 2).max(axis=1)
    fit = headings[success >= _MOST]
    return float(fit[np.abs(fit).argmin()]) + wanted_rad


def _noise(folder: File | None) -> list[Comparison]:
    four = sampled("four_obstacles")
    scenario = replace(four, objective=replace(four.objective, rotation=40.0))
    noisy = plan(scenario)
    calm = plan(replace(scenario, motion=replace(scenario.motion, tip_noise=(1.0,))))
    # The policy planned without noise is executed with noise.
    exposed = replace(calm, scenario=scenario)
    wanted = math.radians(-30)
    start = (*_START_MM, nearest_heading(noisy, wanted))
    without, having = Panel.of("", exposed, start), Panel.of("", noisy, start)
    realised = [panel.table.rollout(panel.start, _RUNS, nearest=True).success for panel in (without, having)]
    clear = [panel.path.clearance_mm for panel in (without, having)]
    degrees = f"{round(math.degrees(start[2]))} deg"
    if folder:
        names = ("(a) planned without noise", "(b) planned with noise")
        panels = [
            replace(panel, heading=f"{name}: {panel.turns} turns, success {success:.2f}")
            for name, panel, success in zip(names, (without, having), realised, strict=True)
        ]
        text = (
            f"Fig. 6.4 in the scene four_obstacles, from (0, 20) mm, {degrees}: the heading nearest to -30 deg "
            "(thesis) with a success of at least 0.75. $C_i$ = 10 per cm, $C_r$ = 40, failures 10,000, no discount. "
            f"The thesis has 4 and 6 turns. Smallest clearance {clear[0]:.1f} and {clear[1]:.1f} mm."
        )
        draw_panels(panels, text, folder / "fig_6_4.png")
    blocked = float(noisy.lookup_many([(*_START_MM, wanted, bevel) for bevel in (-1, 1)], nearest=True).success.max())
    why = f"{OTHER_SCENE}; started at {degrees}"
    more = having.turns > without.turns and clear[1] > clear[0]
    return [
        Comparison(
            f"{_SECTION}/6.4 success from (0, 20) mm at -30 deg", None, round(blocked, 4), "1", Agreement.IMPOSSIBLE,
            "in the assumed scene an obstacle is in the way; the thesis prints no coordinates",
            kind=Evidence.IMPOSSIBLE,
        ),
        measured(
            f"{_SECTION}/6.4a turns, planned without noise", 4, without.turns, "turns", why, kind=Evidence.COMPUTED,
        ),
        measured(f"{_SECTION}/6.4b turns, planned with noise", 6, having.turns, "turns", why, kind=Evidence.COMPUTED),
        measured(f"{_SECTION}/6.4b steps", 26, len(having.path.actions), "steps", why, kind=Evidence.COMPUTED),
        Comparison(
            f"{_SECTION}/6.4 planning with noise gives more turns and more clearance", "yes, 4 and 6 turns",
            f"{without.turns} and {having.turns} turns, {clear[0]:.1f} and {clear[1]:.1f} mm, realised success "
            f"{realised[0]:.2f} and {realised[1]:.2f}", "",
            Agreement.REPRODUCED if more else Agreement.NOT_REPRODUCED, why,
            kind=Evidence.QUALITATIVE,
        ),
    ]  # fmt: skip


def _costs(folder: File | None) -> list[Comparison]:
    start = (*_START_MM, 0.0)
    drawn, comparisons = {}, []
    for name, base in (("safe", sampled("four_obstacles")), ("literal", sampled("four_obstacles_thesis"))):
        panels = []
        for letter, (insertion, rotation, _) in zip(_LETTERS, _COSTS, strict=True):
            objective = replace(base.objective, insertion_per_mm=insertion / 10, rotation=float(rotation))
            table = plan(replace(base, objective=objective))
            panel = Panel.of("", table, start)
            costs = f"$C_i$ = {insertion}, $C_r$ = {rotation}"
            heading = f"({letter}) {costs}: {panel.turns} turns, success {panel.success:.2f}"
            panels.append(replace(panel, heading=heading))
        drawn[name] = panels
    if folder:
        origin = "from (0, 20) mm, 0 deg, in the scene four_obstacles."
        draw_panels(
            drawn["safe"], f"Fig. 6.5 {origin} Failures cost 10,000, no discount. The thesis has 11, 9 and 3 turns.",
            folder / "fig_6_5.png",
        )  # fmt: skip
        text = (
            f"Fig. 6.5 with the literal costs of the thesis, {origin} Collision 200, exit 100, discount 0.95: failing "
            "is cheaper than a detour, so the plans give up."
        )
        draw_panels(drawn["literal"], text, folder / "fig_6_5_literal.png")
    for letter, (*_, published), safe, literal in zip(_LETTERS, _COSTS, drawn["safe"], drawn["literal"], strict=True):
        why = f"{OTHER_SCENE}; failures 10,000, no discount; success {safe.success:.2f}"
        gives_up = f"{ending(literal.path)}, {literal.turns} turns, success {literal.success:.2f}"
        comparisons += [
            measured(f"{_SECTION}/6.5{letter} turns", published, safe.turns, "turns", why, kind=Evidence.COMPUTED),
            Comparison(
                f"{_SECTION}/6.5{letter} with the literal costs", f"reached, {published} turns", gives_up, "",
                Agreement.IMPOSSIBLE, "with these costs failing is cheaper than a long detour in the assumed scene",
                kind=Evidence.IMPOSSIBLE,
            ),
        ]  # fmt: skip
    dear, dearer, long = (panel.turns for panel in drawn["safe"])
    return [
        *comparisons,
        _fewer("dearer rotations, fewer turns", "11 > 9", dear, dearer, ""),
        _fewer(
            "cheaper insertion, a longer way with fewer turns", "9 > 3", dearer, long,
            "with failures of 10,000 the cost of insertion hardly matters, and every turn improves safety",
        ),
    ]  # fmt: skip


def _fewer(what: str, published: str, before: int, after: int, reason: str) -> Comparison:
    verdict = Agreement.REPRODUCED if after < before else Agreement.NOT_REPRODUCED
    return Comparison(
        f"{_SECTION}/6.5 {what}", published, f"{before}, {after}", "", verdict, reason, kind=Evidence.QUALITATIVE
    )
