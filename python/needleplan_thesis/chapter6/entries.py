"""Predicted and realised success from many entries, which says whether a table is to be believed.

Entries are chosen by a rule, not by hand: on the left edge at every whole 10 mm, with the headings nearest to -30, 0
and +30 degrees and the bevel of the lower cost, wherever the interpolated table at 0.5 mm predicts more than 1 %. All
tables of a scenario are asked about the same entries.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from needleplan.planning import MOST_STEPS, PolicyTable, plan, wilson
from needleplan.scenario import Grid, Method, Scenario, Transition

__all__ = ["SEED", "Execution", "Study", "choose_entries", "execute", "planned"]

SEED = 6
_EVERY_MM = 10.0
_HEADINGS_DEG = (-30.0, 0.0, 30.0)
_LEAST_SUCCESS = 0.01


@dataclass(frozen=True)
class Execution:
    """How a table is executed: by the policy of the nearest state, or greedily by values interpolated at the true pose.

    `arc_samples` is the number of points of an arc that are tested for events; None means that of the scenario.
    """

    greedy: bool = False
    arc_samples: int | None = None

    def __str__(self) -> str:
        arcs = f", {self.arc_samples} points an arc" if self.arc_samples else ""
        return ("greedy" if self.greedy else "nearest state") + arcs


@dataclass(frozen=True)
class Study:
    """Success from entries [n, 4] (x_mm, y_mm, heading_rad, bevel): predicted, realised [n], 95 % interval [n, 2]."""

    scenario: str
    grid: Grid
    execution: Execution
    entries: NDArray[np.float64]
    predicted: NDArray[np.float64]
    realised: NDArray[np.float64]
    interval: NDArray[np.float64]

    @property
    def points(self) -> NDArray[np.float64]:
        """Predicted less realised in percentage points, [n]."""
        return 100 * (self.predicted - self.realised)


def planned(scenario: Scenario, transition: Transition, spacing_mm: float, refinement: int = 1) -> PolicyTable:
    """Plan `scenario` on a square grid of `spacing_mm`, by sweeps; success on one `refinement` times finer."""
    grid = Grid((spacing_mm, spacing_mm), transition, refinement)
    return plan(replace(scenario, grid=grid, solver=replace(scenario.solver, method=Method.SWEEP, partitions=None)))


def choose_entries(table: PolicyTable) -> NDArray[np.float64]:
    """Return the entries [n, 4] that the rule gives for `table`, which is the reference of its scenario."""
    scenario = table.scenario
    step = 2 * math.pi / scenario.motion.headings
    headings = [step * round(math.radians(degrees) / step) for degrees in _HEADINGS_DEG]
    heights = np.arange(_EVERY_MM, scenario.workspace.height_mm, _EVERY_MM)
    poses = np.array([(0.0, y, heading, bevel) for y in heights for heading in headings for bevel in (-1, 1)])
    answers = table.lookup_many(poses)
    better = np.arange(0, len(poses), 2) + np.argmin(answers.value.reshape(-1, 2), axis=1)
    entries: NDArray[np.float64] = poses[better[answers.success[better] > _LEAST_SUCCESS]]
    return entries


def execute(name: str, table: PolicyTable, entries: NDArray[np.float64], execution: Execution, runs: int) -> Study:
    """Execute `table` of the scenario `name` `runs` times from every entry."""
    ended = table.lattice.rollout(
        policy=table.policy,
        values=table.values,
        starts=np.ascontiguousarray(entries),
        runs=runs,
        seed=SEED,
        greedy=execution.greedy,
        arc_samples=execution.arc_samples,
        max_steps=MOST_STEPS,
    )
    target = 1
    reached = np.count_nonzero(ended["outcome"] == target, axis=1)
    return Study(
        scenario=name,
        grid=table.scenario.grid,
        execution=execution,
        entries=entries,
        predicted=table.lookup_many(entries).success.astype(np.float64),
        realised=reached / runs,
        interval=np.array([wilson(int(each), runs) for each in reached]),
    )
