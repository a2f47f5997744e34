"""Many rounds, in several processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from needleplan.scenario import Scenario
from needleplan_thesis.closed_loop.hidden import Hidden, hidden_named
from needleplan_thesis.closed_loop.loop import Round, once_around
from needleplan_thesis.processes import map_in_processes

__all__ = ["run_rounds"]

_SHARING = 5
"""Insertions that share a diagnosis, which takes longer than all of them."""


def run_rounds(
    scenario: Scenario, hidden: Sequence[Hidden], seeds: Sequence[int], processes: int = 1
) -> Iterator[Round]:
    """Yield what comes of every hidden effect, in their order; five seeds share recordings and a diagnosis."""
    groups = [tuple(seeds[first : first + _SHARING]) for first in range(0, len(seeds), _SHARING)]
    tasks = [(each.name, group) for each in hidden for group in groups]
    yield from map_in_processes(partial(_round, scenario), tasks, processes)


def _round(scenario: Scenario, task: tuple[str, tuple[int, ...]]) -> Round:
    name, seeds = task
    return once_around(hidden_named(name), scenario, seeds)
