"""Many rounds, in several processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from needleplan.scenario import Scenario
from needleplan_thesis.closed_loop.hidden import Hidden, hidden_named
from needleplan_thesis.closed_loop.loop import Round, once_around

__all__ = ["run_rounds"]

_SHARING = 5
"""Insertions that share a diagnosis, which takes longer than all of them."""


def run_rounds(
    scenario: Scenario, hidden: Sequence[Hidden], seeds: Sequence[int], processes: int = 1
) -> Iterator[Round]:
    """Yield what comes of every hidden effect, in their order; five seeds share recordings and a diagnosis."""
    groups = [tuple(seeds[first : first + _SHARING]) for first in range(0, len(seeds), _SHARING)]
    tasks = [(each.name, group) for each in hidden for group in groups]
    if processes == 1:
        yield from map(partial(_round, scenario), tasks)
        return
    # Not forked: threads of the planner would not be in the child.
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(partial(_round, scenario), tasks, chunksize=1)


def _round(scenario: Scenario, task: tuple[str, tuple[int, ...]]) -> Round:
    name, seeds = task
    return once_around(hidden_named(name), scenario, seeds)
